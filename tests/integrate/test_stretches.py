"""Stretches of states give the run that states one by one give, whatever looks at them."""

import itertools
from types import SimpleNamespace

import numpy as np
import pytest

import polyida as pi
from polyida.integrate.state import Counts, States, Stretch
from polyida.model.guarded import guard
from polyida.system import own

ALPHA = pi.GeneralizedAlpha(h=1e-3)


RADAU = pi.RadauIIA(h=1e-3)


class OneByOne(pi.GeneralizedAlpha):
    """A user's own: its states come one by one and are copied."""

    def steps(self, *arguments, **more):
        yield from super().steps(*arguments, **more)


class RadauOneByOne(pi.RadauIIA):
    """The same of RadauIIA, taken for polyida's own: its states keep what they know of the motion within a step."""

    __module__ = "polyida.test"
    trusted = True

    def steps(self, *arguments, **more):
        yield from super().steps(*arguments, **more)


@pytest.fixture(scope="module")
def model():
    scene = pi.Scene(gravity=(0.0, -9.81))
    upper = scene.add(pi.RigidBody.bar(1.0, 1.0, name="upper"))
    lower = scene.add(pi.RigidBody.bar(1.0, 1.0, origin=(1.0, 0.0), name="lower"))
    scene.add(pi.Revolute(pi.ground, upper.at("left")))
    scene.add(pi.Revolute(upper.at("right"), lower.at("left")))
    return scene.build()


def stretch_of(count, bad=None):
    """States whose numbers tell their number."""
    numbers = np.arange(1.0, count + 1)
    q = np.repeat(numbers[:, None], 2, axis=1)
    if bad is not None:
        q[bad, 1] = np.nan
    return Stretch(numbers, q, q + 100.0, q + 200.0, np.zeros((count, 0)), None)


WAYS = {
    "plain": {},
    "every": {"every": 7},
    "output": {"output": [0.0, 1e-4, 0.1, 0.10005, 0.2999, 0.3]},
    "until": {"until": lambda t, q, v: t - 0.1234},
    "sensors": {"sensors": {"turned": lambda t, q, v: q}},
    "single precision": {"precision": "single"},
    "little memory": {"memory_limit": 20_000},
}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("integrator, single, filed", [(ALPHA, OneByOne(h=1e-3), True), (RADAU, RadauOneByOne(h=1e-3), False)])
def test_runs_are_those_of_states_one_by_one(model, integrator, single, way, filed, tmp_path):
    places = ({"out": tmp_path / "a.h5", "flush_every": 30}, {"out": tmp_path / "b.h5", "flush_every": 30}) if filed else ({}, {})
    run = pi.solve(model, 0.3, integrator, **WAYS[way], **places[0])
    other = pi.solve(model, 0.3, single, **WAYS[way], **places[1])
    assert run.success and run.counts == other.counts and run.message == other.message
    assert all(np.array_equal(getattr(run, name), getattr(other, name)) for name in ("t", "q", "v", "a", "lam"))
    assert np.array_equal(run.sensors.t, other.sensors.t) and run.sensors.t.size == (301 if way == "sensors" else 0)
    assert run.state.t == other.state.t and run.state.memory.keys() == other.state.memory.keys()
    if way == "plain":
        assert run.t.tolist() == pytest.approx(np.arange(301) * 1e-3) and run.counts.steps == 300


class Free(pi.Model):
    n, m = 2, 0

    def mass(self, q):
        return np.eye(2)

    def force(self, t, q, v):
        return np.zeros(2)


def test_a_stretch_that_is_not_finite_in_its_middle_gives_the_states_before():
    class Torn(pi.GeneralizedAlpha):
        def steps(self, model, state, t_end, counts, rows=None):
            def stretches():
                counts.steps += 5
                yield stretch_of(5, bad=3)

            return States(stretches(), counts)

    Torn.__module__ = "polyida.test"
    run = pi.solve(Free(), 5.0, Torn(h=1.0), q0=[0.0, 0.0])
    assert run.status == "not finite" and "q[1] = nan at t = 4 s" in run.message
    assert run.t.tolist() == [0.0, 1.0, 2.0, 3.0] and run.counts.steps == 4


@pytest.mark.parametrize("integrator", [pi.GeneralizedAlpha(rtol=1e-6), pi.RadauIIA(h=1e-3)])
@pytest.mark.parametrize("tick", [0.0, 1.0])
def test_steps_of_a_model_in_python_come_in_stretches_that_take_some_ms(integrator, tick, monkeypatch):
    """By a clock that stands still they become long; by one on which each takes a second they are single steps."""
    clock = itertools.count()
    monkeypatch.setattr(own, "time", SimpleNamespace(perf_counter=lambda: tick * next(clock)))
    p = pi.problems.get("pendulum")
    taken = [len(stretch) for stretch in integrator.steps(guard(p.model), pi.consistent_state(p.model, q0=p.q0), 0.5, Counts()).stretches]
    assert max(taken) == 1 if tick else max(taken) > 16
