"""Trajectories: what is derived from them, and that a file brings back the same."""

import numpy as np
import pytest

import polyida as pi

STEP = pi.GeneralizedAlpha(h=1e-3)
FRAMES = ("t", "q", "v", "a", "lam")


def test_frames_come_back_to_the_bit(run, file):
    again = pi.load(file)
    for name in FRAMES:
        assert np.array_equal(getattr(again, name), getattr(run, name)), name
    assert (again.status, again.message, again.counts, again.machine) == (run.status, run.message, run.counts, run.machine)
    assert (again.cpu_seconds, again.wall_seconds, again.compile_seconds) == (run.cpu_seconds, run.wall_seconds, run.compile_seconds)
    assert again.integrator == run.integrator
    assert set(again.memory) == set(run.memory) and np.array_equal(again.memory["a_alg"], run.memory["a_alg"])
    assert again.success and again.summary() == run.summary()


def test_what_is_derived_comes_back_too(run, file):
    again = pi.load(file)
    for name in ("tip", "joint", "push"):
        assert np.array_equal(again.position(name), run.position(name))
    for name in ("joint", "revolute 1", "revolute 2"):
        assert np.allclose(again.reaction(name), run.reaction(name), rtol=1e-14)
    for name in ("kinetic", "potential", "strain", "total"):
        assert np.allclose(getattr(again.energy, name), getattr(run.energy, name), rtol=1e-12, atol=1e-14)
    assert np.array_equal(again.stress(-1), run.stress(-1)) and np.array_equal(again.node_positions(-1), run.node_positions(-1))
    assert list(again.model.parts) == list(run.model.parts)


def test_a_profile_of_the_user_s_own_is_followed_by_its_values(run, file):
    again = pi.load(file)
    for t in run.t:
        assert np.allclose(again.model.drives(t)[:, :2], run.model.drives(t)[:, :2], atol=1e-9)
    assert again.drift.max() < 1e-9 and again.velocity_drift.max() == pytest.approx(run.velocity_drift.max(), rel=1e-3)


@pytest.mark.parametrize("name", ["a/b", "/a", ".", "..", "x/../y", "tip mass (2 kg), left", "Gelenk ä", "5"])
def test_any_name_survives(scenes, tmp_path, name):
    scene, upper = scenes.hinged()
    scene.add(pi.AngleMotor(pi.ground, upper.section("left"), angle=lambda t: 0.1 * t * t, name=name))
    run = pi.solve(scene.build(), 0.005, STEP)
    run.save(tmp_path / "named.h5")
    again = pi.load(tmp_path / "named.h5")
    assert np.allclose(again.reaction(name), run.reaction(name))


def test_energies_are_those_of_the_model(run):
    frame = 20
    model, q, v = run.model, run.q[frame], run.v[frame]
    assert run.energy.kinetic[frame] == pytest.approx(0.5 * v @ (model.mass() @ v))
    assert run.energy.potential[frame] + run.energy.strain[frame] == pytest.approx(model.potential(q))
    assert np.array_equal(run.energy.total, run.energy.kinetic + run.energy.potential + run.energy.strain)
    assert len(run) == len(run.drift) == len(run.velocity_drift) == len(run.energy.total) == 31
