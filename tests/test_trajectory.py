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
    assert (again.cpu_seconds, again.wall_seconds, again.integrator) == (run.cpu_seconds, run.wall_seconds, run.integrator)
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


@pytest.mark.parametrize("what", ["stress", "von_mises", "node_positions"])
@pytest.mark.parametrize("frame", ["x", None, 1.5, 10**9, -(10**9), True, [0]])
def test_a_frame_that_is_none_is_refused(run, what, frame):
    with pytest.raises(pi.InputError, match="frame = "):
        getattr(run, what)(frame)


def test_frames_count_from_the_end_too(run):
    for what in ("stress", "von_mises", "node_positions"):
        read, last = getattr(run, what), len(run) - 1
        assert np.array_equal(read(-1), read(last)) and np.array_equal(read(-len(run)), read(np.int64(0)))


def test_a_profile_of_the_user_s_own_is_followed_by_its_values(run, file):
    again = pi.load(file)
    for t in run.t:
        assert np.allclose(again.model.drives(t)[:, :2], run.model.drives(t)[:, :2], atol=1e-9)
    assert again.drift.max() < 1e-9 and again.velocity_drift.max() == pytest.approx(run.velocity_drift.max(), rel=1e-3)


def test_a_loaded_run_goes_on(run, file):
    from polyida.integrate.state import State

    again = pi.load(file)
    last = State(again.t[-1], again.q[-1], again.v[-1], again.a[-1], again.lam[-1], again.memory)
    rest = pi.solve(run.model, 0.04, STEP, state=last)
    assert rest.success and rest.t[0] == run.t[-1] and len(rest) == 11


def test_a_file_is_not_overwritten_unasked(run, file):
    before = file.read_bytes()
    with pytest.raises(pi.InputError, match="run.h5 exists"):
        run.save(file)
    assert file.read_bytes() == before
    run.save(file, overwrite=True)
    assert list(file.parent.iterdir()) == [file]


def test_saving_into_no_folder(run, tmp_path):
    with pytest.raises(pi.InputError, match="nowhere"):
        run.save(tmp_path / "nowhere" / "run.h5")


def test_a_failed_run_is_kept_too(scenes, tmp_path):
    scene, upper = scenes.hinged((0.0, 0.0))
    jump = pi.profile.from_function(lambda t: 0.0 if t < 0.0095 else np.pi, lambda t: 0.0, lambda t: 0.0)
    scene.add(pi.AngleMotor(pi.ground, upper.section("left"), angle=jump, name="drive"))
    run = pi.solve(scene.build(), 0.02, STEP)
    run.save(tmp_path / "failed.h5")
    again = pi.load(tmp_path / "failed.h5")
    assert not again.success and again.message == run.message and len(again) == 10


def test_a_run_of_a_user_s_model(tmp_path):
    run = pi.solve(pi.problems.get("pendulum").model, 0.1, STEP, q0=[-1.0, 0.0])
    run.save(tmp_path / "pendulum.h5")
    again = pi.load(tmp_path / "pendulum.h5")
    assert np.array_equal(again.q, run.q) and "done" in again.summary()
    with pytest.raises(pi.InputError, match="model"):
        again.energy


def test_an_ida_run(scenes, tmp_path):
    run = pi.solve(scenes.hinged()[0].build(), 0.02, pi.IDA(rtol=1e-5, atol=(1e-7, 1e-4)))
    run.save(tmp_path / "ida.h5")
    again = pi.load(tmp_path / "ida.h5")
    assert again.integrator == run.integrator and np.array_equal(again.lam, run.lam)


@pytest.mark.parametrize("name", ["a/b", "/a", ".", "..", "x/../y", "tip mass (2 kg), left", "Gelenk ä", "5"])
def test_any_name_survives(scenes, tmp_path, name):
    scene, upper = scenes.hinged()
    scene.add(pi.AngleMotor(pi.ground, upper.section("left"), angle=lambda t: 0.1 * t * t, name=name))
    run = pi.solve(scene.build(), 0.005, STEP)
    run.save(tmp_path / "named.h5")
    again = pi.load(tmp_path / "named.h5")
    assert np.allclose(again.reaction(name), run.reaction(name))


@pytest.mark.parametrize(
    "ask, match",
    [
        (lambda run: run.position("nobody"), "nobody.*tip"),
        (lambda run: run.reaction("tip"), "tip.*joint"),
        (lambda run: run.reaction("nobody"), "nobody"),
    ],
)
def test_unknown_names_are_answered_by_the_known(run, ask, match):
    with pytest.raises(pi.InputError, match=match):
        ask(run)


def test_position_of_an_attachment(run):
    lower = run.model.parts["lower"]
    assert np.allclose(run.position(lower.section("right")), run.position("tip"), atol=1e-15)
    assert np.allclose(run.position(lower.node((1.0, 0.0)))[0], run.position("tip")[0])


def test_position_of_what_is_not_in_the_scene(run, file, scenes):
    strange = scenes.plate("strange").section("right")
    with pytest.raises(pi.InputError, match="strange"):
        run.position(strange)
    with pytest.raises(pi.InputError):
        pi.load(file).position(run.model.parts["lower"].section("right"))


def test_position_of_a_part(run):
    """The part itself does as well as its name."""
    assert np.array_equal(run.position(run.model.parts["tip"]), run.position("tip"))


def test_energies_are_those_of_the_model(run):
    frame = 20
    model, q, v = run.model, run.q[frame], run.v[frame]
    assert run.energy.kinetic[frame] == pytest.approx(0.5 * v @ (model.mass() @ v))
    assert run.energy.potential[frame] + run.energy.strain[frame] == pytest.approx(model.potential(q))
    assert np.array_equal(run.energy.total, run.energy.kinetic + run.energy.potential + run.energy.strain)
    assert len(run) == len(run.drift) == len(run.velocity_drift) == len(run.energy.total) == 31


def test_a_model_without_potential_has_no_energy():
    run = pi.solve(pi.problems.get("car-axis").model, 0.01, STEP, q0=[0, 0.5, 1, 0.5], v0=[-0.5, 0, -0.5, 0])
    assert np.isnan(run.energy.potential).all() and np.isfinite(run.energy.kinetic).all()
    with pytest.raises(pi.InputError, match="CarAxis"):
        run.position("tip")
