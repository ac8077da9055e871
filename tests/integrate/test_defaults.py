"""What integrators choose where no step and no tolerance is given: errors about 1e-4 of the model's size, and a summary that says it."""

from functools import cache

import numpy as np
import pytest

import polyida as pi

OWN = {"alpha": pi.GeneralizedAlpha(), "radau": pi.RadauIIA(), "ida": pi.IDA()}
WORST = 3e-4  # of the size; 1e-3 is what a user may still take for right


def fine(model, t_end, **start):
    """A run far below the defaults' errors at 21 times."""
    exact = pi.solve(model, t_end, pi.RadauIIA(rtol=1e-9), output=np.linspace(0.0, t_end, 21), **start)
    assert exact.success, exact.message
    return exact


@pytest.fixture(scope="module")
def jointed(scenes):
    """Function (kind) -> fine run of a scene with such a joint over 0.2 s, made once."""
    return cache(lambda kind: fine(scenes.jointed(kind).build(), 0.2))


def error(exact, integrator, **start):
    """The largest error of q over the model's size."""
    model = exact.model
    run = pi.solve(model, exact.t[-1], integrator, output=exact.t, **start)
    assert run.success, run.message
    return np.abs(run.q - exact.q).max() / (model.extent or np.abs(exact.q).max())


@pytest.mark.parametrize("integrator", OWN.values(), ids=OWN)
@pytest.mark.parametrize("name", ["pendulum", "car-axis", "andrews"])
def test_published_digits_of_rigid_systems(name, integrator):
    p = pi.problems.get(name)
    run = pi.solve(p.model, p.t_end, integrator, q0=p.q0, v0=p.v0)
    assert run.success and p.compare(run)["q"] < WORST * np.abs(run.q).max()


@pytest.mark.parametrize("integrator", OWN.values(), ids=OWN)
@pytest.mark.parametrize("kind", ["motor between", "clamp to ground", "slot", "path"], indirect=True)
def test_joints(jointed, kind, integrator):
    assert error(jointed(kind), integrator) < WORST


@pytest.mark.parametrize("kinks", [(0.05, 0.055), ()], ids=["kinks told", "kinks found"])
def test_a_pulse_is_seen(scenes, kinks):
    """A plate at rest, struck for 5 ms; without the pulse the error would be all of the motion, 5e-2."""
    scene, plate = scenes.cantilever()
    blow = lambda t: float(np.sin(np.pi * (t - 0.05) / 5e-3) ** 2) if 0.05 < t < 0.055 else 0.0  # noqa: E731
    scene.add(pi.PointLoad(plate.section("right"), (0.0, -40.0), pi.profile.from_function(blow, kinks=kinks), name="blow"))
    exact = fine(scene.build(), 0.1)
    assert max(error(exact, integrator) for integrator in OWN.values()) < WORST


@pytest.mark.parametrize(
    "settings", [{"form": "stabilised"}, {"linear": "kkt"}, {"rho_inf": 0.5}, {"member": (0.0, 0.05, 0.275625, 0.55)}], ids=str
)
def test_every_form_of_generalized_alpha_chooses_its_steps(jointed, settings):
    assert error(jointed("motor between"), pi.GeneralizedAlpha(**settings)) < WORST


def test_the_error_of_a_run_follows_its_tolerance(scenes, jointed):
    rtols = (1e-3, 1e-4, 1e-5)
    assert scenes.slope(rtols, [error(jointed("revolute"), pi.GeneralizedAlpha(rtol=rtol)) for rtol in rtols]) == pytest.approx(
        1.0, abs=0.25
    )


def test_ringing_mesh_modes_force_no_short_steps():
    """Plates of E = 1e13 Pa under gravity that sets in at once: told from one step each, errors took 940 steps, mostly of ringing."""
    p = pi.problems.get("rigid-limit")
    run = pi.solve(p.model, 1.0, pi.GeneralizedAlpha())
    assert p.compare(run)["q"] < 2 * WORST and run.counts.steps + run.counts.rejected < 500


def test_summaries_say_what_was_chosen_and_why(scenes):
    p = pi.problems.get("pendulum")
    alpha, radau, ida = (pi.solve(p.model, 10.0, method, q0=p.q0).summary() for method in OWN.values())
    assert "steps by local errors of q that add up to 3.5e-05 + 5.0e-05 |q| in 10 s" in alpha
    assert "rtol 9.6e-06 for a motion over 31 times the model's length, atol 6.8e-06 of q" in radau
    assert "rtol 9.6e-07 for a motion over 31 times the model's length, atol 6.8e-07 of q, 2.1e-06 of v" in ida
    given = (pi.GeneralizedAlpha(h=1e-2), pi.RadauIIA(rtol=1e-4, atol=1e-4), pi.IDA(rtol=1e-4, atol=1e-4))
    for method in given:
        summary = pi.solve(p.model, 0.1, method, q0=p.q0).summary()
        assert "way" not in summary and "add up" not in summary


@pytest.mark.parametrize("integrator", OWN.values(), ids=OWN)
def test_a_run_that_goes_on_keeps_what_it_chose(jointed, integrator, tmp_path):
    exact = jointed("revolute")
    model = exact.model
    first = pi.solve(model, 0.1, integrator, out=tmp_path / "run.h5")
    sizes = first.state.memory["sizes"].tolist()
    assert pi.resume(tmp_path / "run.h5", 0.2).state.memory["sizes"].tolist() == sizes
    again = pi.solve(model, 0.2, integrator, state=first.state)
    assert again.success and again.state.memory["sizes"].tolist() == sizes
    assert np.abs(again.q[-1] - exact.q[-1]).max() < WORST * model.extent


@pytest.mark.parametrize("integrator", OWN.values(), ids=OWN)
def test_a_run_that_goes_on_for_longer_chooses_for_what_is_to_come(scenes, integrator):
    """What is allowed, and the longest step, of a first look at a motion are not those of all of it."""
    model = scenes.jointed("revolute").build()
    look = pi.solve(model, 1e-3, integrator)
    run, whole = pi.solve(model, 0.401, integrator, state=look.state), pi.solve(model, 0.4, integrator)
    ways = look.state.memory["sizes"][3]
    assert run.state.memory["sizes"][2:] == pytest.approx([0.4, 400 * ways]) and run.steps < 2 * whole.steps
    exact = pi.solve(model, 0.401, pi.RadauIIA(rtol=1e-9), every=10**9)
    assert np.abs(run.q[-1] - exact.q[-1]).max() < WORST * model.extent
