"""One scene through both loops of an integrator: the compiled one, and the plain one on the scene's own step matrix."""

import numpy as np
import pytest

import polyida as pi
from polyida.assembly.scene_step_matrix import SceneStepMatrix
from polyida.integrate.alpha.steps import Steps
from polyida.integrate.start import consistent_state
from polyida.problems import plates


def models(scene):
    """The scene's model for the compiled loop, and for the plain one."""
    compiled, plain = scene.build(), scene.build()
    plain.compiled, plain.step_matrix = False, lambda: SceneStepMatrix(plain)
    return compiled, plain


FEW = "motor between", "slot"
DAMPED = {"viscosity": 1e-3, "mass_damping": 2.0}
RADAU = [{"stages": 2}, {"form": "index3"}, {"form": "index3", "project": False}]


@pytest.mark.parametrize("form", ["index3", "stabilised"])
def test_the_same_iterations_in_every_step(monkeypatch, form):
    monkeypatch.setattr(Steps, "chunk_bytes", 1)  # the compiled loop gives every step back too
    found, settings = [], pi.GeneralizedAlpha(h=1e-3, form=form)
    for model in models(plates.double_plate_motors(cells=16)):
        counts, start = pi.Counts(), consistent_state(model, 0.0, np.zeros(model.n), np.zeros(model.n))
        found.append([(counts.newton_iterations, counts.factorizations) for _ in settings.steps(model, start, 0.2, counts)])
    assert found[0] == found[1] and len(found[0]) == 200


def require_the_same_states(scene, **settings):
    """To 1e-12 where Newton goes on to below that: the factor is in single precision, and a looser one leaves its round-off."""
    integrator = pi.GeneralizedAlpha(h=2e-3, tolerance=1e-8, **settings)
    compiled, plain = (pi.solve(model, 0.05, integrator) for model in models(scene))
    assert compiled.counts.steps == plain.counts.steps and np.array_equal(compiled.t, plain.t)
    assert np.abs(compiled.q - plain.q).max() < 1e-12
    assert np.abs(compiled.lam - plain.lam).max() < 1e-9 * np.abs(compiled.lam).max()


def test_the_same_states(scenes, kind):
    require_the_same_states(scenes.jointed(kind))


@pytest.mark.parametrize(
    "kind, settings",
    list(zip(FEW * 2, [{"incremental_phi": False}, {"form": "stabilised"}, {"rtol": 1e-5}, {"extrapolate": True}])),
    indirect=["kind"],
    ids=str,
)
def test_the_same_states_with_other_settings(scenes, kind, settings):
    require_the_same_states(scenes.jointed(kind), **settings)


def require_the_same_stages(scene, **settings):
    """Radau IIA: the plain path has no frame for each stage, so that Newton takes another way to the same end."""
    integrator = pi.RadauIIA(h=5e-3, tolerance=1e-16, **settings)
    compiled, plain = (pi.solve(model, 0.05, integrator) for model in models(scene))
    assert compiled.success and compiled.counts.steps == plain.counts.steps == 10
    assert np.abs(compiled.q - plain.q).max() < 1e-12
    assert np.abs(compiled.v - plain.v).max() < 1e-9
    assert np.abs(compiled.lam - plain.lam).max() < 1e-9 * np.abs(compiled.lam).max()
    assert np.abs(compiled.drift).max() < 1e-14 or not compiled.model.m


def test_the_same_stages(scenes, kind):
    require_the_same_stages(scenes.jointed(kind, cells=12))


@pytest.mark.parametrize(
    "kind, settings, damping",
    [(kind, *more) for kind, more in zip(FEW * 3, [*((settings, {}) for settings in RADAU), ({}, DAMPED), ({"stages": 2}, DAMPED)])],
    indirect=["kind"],
    ids=str,
)
def test_the_same_stages_with_other_settings_and_damping(scenes, kind, settings, damping):
    require_the_same_stages(scenes.jointed(kind, cells=12, material=damping), **settings)


def test_the_same_stages_with_the_whole_matrix(scenes):
    model, found = scenes.jointed("motor between", cells=12).build(), []
    for linear in ("auto", "kkt"):
        run = pi.solve(model, 0.05, pi.RadauIIA(h=2.5e-3, tolerance=1e-16, linear=linear))
        found.append(run.q[-1])
    assert np.abs(found[0] - found[1]).max() < 1e-12
