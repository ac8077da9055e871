"""Sensors: functions at every accepted step, whatever becomes a frame and wherever frames go."""

import os
import signal
import subprocess
import sys
import textwrap

import numpy as np
import pytest

import polyida as pi
from polyida.problems import plates

ALPHA = pi.GeneralizedAlpha(h=1e-3)


@pytest.fixture(scope="module")
def model():
    return plates.double_plate_motors(cells=10).build()


def looking(model):
    """A number, a vector and a matrix of one run, one of them under a name that is no path."""
    return {
        "energy": lambda t, q, v: model.potential(q),
        "a/tip": lambda t, q, v: model.position("tip", q[None])[0],
        "first": lambda t, q, v: np.array([q[:4], v[:4]]),
    }


@pytest.fixture(scope="module")
def whole(model):
    return pi.solve(model, 0.1, ALPHA, sensors=looking(model))


def same(one, other):
    return list(one) == list(other) and np.array_equal(one.t, other.t) and all(np.array_equal(one[name], other[name]) for name in one)


def test_they_see_what_frames_hold(whole):
    sensors = whole.sensors
    assert list(sensors) == ["energy", "a/tip", "first"] and np.array_equal(sensors.t, whole.t) and len(sensors) == 3
    assert np.allclose(sensors["a/tip"], whole.position("tip"), rtol=0.0, atol=1e-14)  # sums of one frame and of many differ in their order
    assert np.allclose(sensors["energy"], whole.energy.potential + whole.energy.strain, rtol=1e-13)
    assert sensors["first"].shape == (len(whole), 2, 4) and np.array_equal(sensors["first"][:, 1], whole.v[:, :4])


def test_ready_ones(model):
    lower = model.parts["lower"]
    ready = {
        "tip": pi.sensor.position("tip"),
        "end": pi.sensor.position(lower.section("right")),
        "shoulder": pi.sensor.reaction("shoulder"),
        "motor": pi.sensor.reaction("elbow motor"),
        "push": pi.sensor.state(lambda state: [state.a[0], state.lam[-1]]),
    }
    run = pi.solve(model, 0.02, ALPHA, sensors=ready)
    assert np.allclose(run.sensors["tip"], run.position("tip"), rtol=0.0, atol=1e-14)
    assert np.allclose(run.sensors["end"], run.position("tip"), atol=1e-14)
    assert np.allclose(run.sensors["shoulder"], run.reaction("shoulder"), rtol=1e-14)
    assert np.allclose(run.sensors["motor"], run.reaction("elbow motor"), rtol=1e-14)
    assert np.array_equal(run.sensors["push"], np.stack([run.a[:, 0], run.lam[:, -1]], axis=1))


def test_a_run_without(model):
    run = pi.solve(model, 0.002, ALPHA)
    assert not run.sensors and not len(run.sensors.t)
    with pytest.raises(KeyError, match="no sensor is called 'tip'; known: none"):
        run.sensors["tip"]


def test_a_killed_run_goes_on(model, whole, tmp_path):
    script = f"""
        import os, signal, sys
        sys.path.insert(0, {os.path.dirname(__file__)!r})
        import polyida as pi
        from test_sensors import ALPHA, looking, plates
        model = plates.double_plate_motors(cells=10).build()
        kill = lambda t: os.kill(os.getpid(), signal.SIGKILL) if t > 0.0855 else None
        pi.solve(model, 0.1, ALPHA, sensors=looking(model), out="run.h5", flush_every=20, every=30, progress=kill)
    """
    ended = subprocess.run([sys.executable, "-c", textwrap.dedent(script)], cwd=tmp_path, capture_output=True)
    assert ended.returncode == -signal.SIGKILL, ended.stderr
    path = tmp_path / "run.h5"
    cut = pi.load(path)
    assert cut.status == "interrupted" and 0 < len(cut.sensors.t) < 101
    assert np.array_equal(cut.sensors["a/tip"], whole.sensors["a/tip"][: len(cut.sensors.t)])
    with pytest.raises(pi.InputError, match="run.h5: the run had the sensors 'energy', 'a/tip', 'first', functions which no file holds"):
        pi.resume(path)
    with pytest.raises(pi.InputError, match="it cannot go on with 'other'"):
        pi.resume(path, sensors={"other": lambda t, q, v: t})
    run = pi.resume(path, sensors=looking(model), model=model)
    assert run.success and same(run.sensors, whole.sensors) and same(pi.load(path).sensors, whole.sensors)


def test_damage_is_found(model, tmp_path):
    """A byte in a whole block of what sensors gave; the frames are whole."""
    import h5py

    path = tmp_path / "run.h5"
    run = pi.solve(pi.problems.get("pendulum").model, 1.2, ALPHA, q0=[-1.0, 0.0], sensors={"q": lambda t, q, v: q}, every=100, out=path)
    with h5py.File(path) as file:
        place = file["sensors"].id.get_chunk_info(0).byte_offset
    with open(path, "r+b") as file:
        file.seek(place + 100)
        file.write(b"\xff\xff")
    again = pi.load(path)
    assert again.status == "damaged" and "of sensors, steps 0 to 1200 are damaged" in again.message
    assert np.array_equal(again.q, run.q) and not len(again.sensors.t)


@pytest.mark.parametrize(
    "late, match", [(lambda t: [t, t], r"an array of shape \(2,\) at t = 0.005"), (lambda t: np.inf, "not finite at t = 0.005")]
)
def test_what_goes_wrong_on_the_way(model, late, match):
    with pytest.raises(pi.InputError, match=f"sensors: 'x' gave .*{match}") as raised:
        pi.solve(model, 0.01, ALPHA, sensors={"x": lambda t, q, v: t if t < 0.0045 else late(t)})
    run = raised.value.trajectory
    assert run.status == "error" and len(run.sensors.t) == 5
