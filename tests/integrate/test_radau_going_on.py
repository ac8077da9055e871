"""Radau IIA in files and at kinks: what its memory holds can be written and gone on from; long runs; what a failure names."""

import pickle
import tracemalloc

import numpy as np
import pytest

import polyida as pi
from polyida.integrate.radau import accepted
from polyida.integrate.radau.loop import MADE
from polyida.integrate.radau.tables.scene import FEW_NODES
from polyida.problems import plates


def pulled(profile):
    """A bar on a pin at rest, without weight, pulled sideways at its end."""
    scene = pi.Scene(gravity=(0.0, 0.0))
    bar = pi.Plate(pi.mesh.rectangle(1.0, 0.1, cells=10, seed=1), pi.Material(E=5e6, nu=0.3, rho=1100.0), thickness=0.01, name="bar")
    scene.add(bar)
    scene.add(pi.Revolute(pi.ground, bar.section("left"), name="pin"))
    scene.add(pi.PointLoad(bar.section("right"), (0.0, 5.0), profile, name="pull"))
    return scene.build()


def pressed():
    """A soft bar on a pin, pressed along itself until it collapses."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    bar = pi.Plate(pi.mesh.rectangle(1.0, 0.1, cells=10, seed=1), pi.Material(E=2e4, nu=0.3, rho=1100.0), thickness=0.01, name="bar")
    scene.add(bar)
    scene.add(pi.Revolute(pi.ground, bar.section("left"), name="pin"))
    scene.add(pi.PointLoad(bar.section("right"), (-60.0, 0.0), name="press"))
    return scene.build()


@pytest.mark.parametrize("settings", [{"h": 2e-3}, {"rtol": 1e-4}, {"h": 2e-3, "linear": "kkt"}], ids=str)
def test_a_collapse_is_placed_and_the_run_up_to_it_is_in_the_file(settings, tmp_path):
    run = pi.solve(pressed(), 0.5, pi.RadauIIA(**settings), out=tmp_path / "run.h5", flush_every=1)
    assert run.message.startswith("cell 8 of 'bar' at (0.898508, -0.025) is turned inside out") and len(run) > 5
    assert np.array_equal(pi.load(tmp_path / "run.h5").q, run.q)


def test_a_run_of_very_many_steps_begins_at_once():
    model = pulled(pi.profile.sine(1.0, 2.0))
    tracemalloc.start()
    try:
        run = pi.solve(model, 1.0, pi.RadauIIA(h=2e-7), until=lambda t, q, v: t - 5e-7)
        assert run.status == "stopped" and tracemalloc.get_traced_memory()[1] < 30e6
    finally:
        tracemalloc.stop()


def test_a_run_that_becomes_singular_ends_with_what_its_last_stage_had(monkeypatch):
    """a and lam of large scenes are made when they are asked for: by then nothing may stop the run any more."""

    def singular(*at):
        raise pi.InputError("singular")

    monkeypatch.setattr(accepted, "consistent_acceleration", singular)
    model = plates.double_plate(cells=14).build()
    assert model.n_nodes > FEW_NODES
    run = pi.solve(model, 0.01, pi.RadauIIA(h=1e-3), every=100)
    assert run.success and np.array_equal(run.a[-1], run.restart.state.memory["a_end"])


def hanging():
    """Three rigid bars in a row on a pin."""
    scene, before = pi.Scene(gravity=(0.0, -9.81)), pi.ground.at((0.0, 0.0))
    for k in range(3):
        bar = scene.add(pi.RigidBody.bar(1.0, 1.0, (k, 0.0), name=f"bar {k}"))
        scene.add(pi.Revolute(before, bar.at("left"), name=f"pin {k}"))
        before = bar.at("right")
    return scene.build()


@pytest.mark.parametrize("settings", [{"rtol": 1e-6}, {"rtol": 1e-5, "stages": 2}, {"h": 2e-3}, {"h": 2e-3, "form": "index3"}], ids=str)
def test_a_scene_whose_factors_compiled_code_makes_goes_on_from_any_step_bit_by_bit(settings):
    """The memory of a state within a stretch holds where the factors made in this stretch were made; they are made again from it."""
    model, method, counts = hanging(), pi.RadauIIA(**settings), pi.Counts()
    begin = pi.solve(model, 0.01, method).state
    states = list(method.steps(model, begin, 1.0, counts))
    assert "h" in settings or 5 <= counts.tangents < MADE
    for state in states[3 :: len(states) // 6]:
        rest = list(method.steps(model, pickle.loads(pickle.dumps(state)), 1.0, pi.Counts()))
        later = [other for other in states if other.t > state.t]
        assert len(rest) == len(later)
        for one, other in zip(rest, later):
            assert np.array_equal(one.q, other.q) and np.array_equal(one.v, other.v) and np.array_equal(one.lam, other.lam)
