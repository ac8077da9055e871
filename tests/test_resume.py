"""Runs that go on from a file: the frames are those of a run that was never interrupted, also after a kill."""

import os
import subprocess
import sys

import numpy as np
import pytest

import polyida as pi
from polyida.problems import plates

FRAMES = ("t", "q", "v", "a", "lam")
ALPHA = pi.GeneralizedAlpha(h=1e-3)


class Stop(Exception):
    pass


def stopping(after):
    def progress(t):
        if t > after:
            raise Stop

    return progress


def equal(one, other, count=None):
    return all(np.array_equal(getattr(one, name)[:count], getattr(other, name)[:count]) for name in FRAMES)


def interrupted(path, after, model, t_end, integrator, **settings):
    with pytest.raises(Stop):
        pi.solve(model, t_end, integrator, out=path, progress=stopping(after), **settings)


@pytest.fixture(scope="module")
def model():
    return plates.double_plate_motors(cells=10).build()


def pendulum():
    return pi.problems.get("pendulum").model, {"q0": [-1.0, 0.0]}


KKT = pi.GeneralizedAlpha(h=4e-3, linear="kkt", rho_inf=0.5)
SETTINGS = ({}, {"every": 7}, {"output": np.linspace(0.01, 0.79, 40)}, {"flush_every": 1}, {"until": lambda t, q, v: q[-1] + 0.9})


@pytest.mark.parametrize("integrator, settings", [(ALPHA, settings) for settings in SETTINGS] + [(KKT, {}), (KKT, {"every": 7})])
def test_a_scene_goes_on_bit_by_bit(model, tmp_path, integrator, settings):
    path, until = tmp_path / "run.h5", settings.get("until")
    interrupted(path, 0.42, model, 0.8, integrator, **settings)
    run, expected = pi.resume(path, until=until), pi.solve(model, 0.8, integrator, **settings)
    assert run.success and equal(run, expected) and equal(pi.load(path), expected) and run.counts.steps == expected.counts.steps
    assert (run.status, run.message) == (expected.status, expected.message) and os.listdir(tmp_path) == ["run.h5"]


def test_across_kinks_bit_by_bit(tmp_path):
    scene = plates.double_plate(cells=8)
    upper = next(iter(scene.parts.values()))
    scene.add(pi.AngleMotor(pi.ground, upper.section("left"), angle=pi.profile.linear(0.0, 0.3, duration=0.2, begin=0.1), name="drive"))
    model = scene.build()
    expected = pi.solve(model, 0.35, ALPHA)
    for after in (0.0985, 0.1, 0.3):
        interrupted(tmp_path / f"{after}.h5", after, model, 0.35, ALPHA, flush_every=1)
        assert equal(pi.resume(tmp_path / f"{after}.h5"), expected)


def test_ida_goes_on_to_its_tolerance(model, tmp_path):
    """Against a method of another family."""
    path, ida = tmp_path / "run.h5", pi.IDA(rtol=1e-6)
    interrupted(path, 0.3, model, 0.6, ida)
    run, expected, exact = pi.resume(path), pi.solve(model, 0.6, ida), pi.solve(model, 0.6, pi.RadauIIA(rtol=1e-9))
    assert run.success and run.t[-1] == 0.6 and equal(run, expected, int((run.t <= 0.3).sum()))
    assert max(np.abs(other.q[-1] - exact.q[-1]).max() for other in (run, expected)) < 100 * ida.rtol


def test_a_function_of_the_users_own_must_be_given_again(tmp_path):
    def build():
        scene = plates.double_plate(cells=8)
        upper = next(iter(scene.parts.values()))
        scene.add(pi.AngleMotor(pi.ground, upper.section("left"), angle=lambda t: 0.1 * np.sin(3 * t), name="drive"))
        return scene.build()

    path = tmp_path / "run.h5"
    interrupted(path, 0.1, build(), 0.2, ALPHA, until=lambda t, q, v: t - 0.15)
    seen = pi.load(path)
    assert abs(seen.model.parts["drive"].angle(0.05) - 0.1 * np.sin(0.15)) < 1e-9
    with pytest.raises(pi.InputError, match="'drive' has functions of the user's own"):
        pi.resume(path, until=False)
    for until in (lambda t: t - 0.15, 0):
        with pytest.raises(pi.InputError, match="resume: until = .* must be a function of t, q and v$"):
            pi.resume(path, model=build(), until=until)
    with pytest.raises(pi.InputError, match="give until="):
        pi.resume(path, model=build())
    assert equal(pi.resume(path, model=build(), until=False), pi.solve(build(), 0.2, ALPHA))


def test_what_cannot_go_on_is_told(model, tmp_path):
    path = tmp_path / "run.h5"
    pi.solve(model, 0.1, ALPHA, out=path)
    with pytest.raises(pi.InputError, match="run.h5: the run has reached t = 0.1 s"):
        pi.resume(path)
    with pytest.raises(pi.InputError, match="resume: t_end = '0.2' must be"):
        pi.resume(path, "0.2")
    with pytest.raises(pi.InputError, match="no such file"):
        pi.resume(tmp_path / "other.h5")
    with pytest.raises(pi.InputError, match="the model is another"):
        pi.resume(path, 0.2, model=pendulum()[0])
    assert len(pi.load(path)) == 101


def test_a_run_that_is_still_written_cannot_go_on(model, tmp_path):
    told = []

    def progress(t):
        if t > 0.05 and not told:
            child = "import polyida as pi, sys\ntry: pi.resume(sys.argv[1])\nexcept pi.InputError as error: print(error)"
            done = subprocess.run([sys.executable, "-c", child, tmp_path / "run.h5"], capture_output=True, text=True, check=True)
            told.append(done.stdout)

    assert pi.solve(model, 0.1, pi.GeneralizedAlpha(h=1e-3, linear="kkt"), out=tmp_path / "run.h5", progress=progress).success
    assert "another process is still writing it" in told[0]
