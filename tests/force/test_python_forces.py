"""Forces in Python within compiled steps: what they raise, threads, copies, what they are asked for, and when."""

import gc
import pickle
import threading
import weakref
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import pytest

import polyida as pi
from polyida.assembly.python_functions import arguments_read
from polyida.integrate.alpha.steps import Steps
from polyida.system.scene import SceneTable

METHODS = [
    pi.GeneralizedAlpha(h=1e-3),
    pi.GeneralizedAlpha(h=1e-3, form="stabilised"),
    pi.RadauIIA(h=1e-3),
    pi.EnergyMomentum(h=1e-3),
    pi.IDA(rtol=1e-6),
]


@dataclass(frozen=True, eq=False)
class Push(pi.ForceElement):
    """A force on a point by any function of t, x and v."""

    at: object
    function: object
    name: str | None = None

    def sides(self):
        return (self.at,)

    def forces(self, t, x, v):
        return self.function(t, x, v)


@dataclass(frozen=True, eq=False)
class Spring(pi.ForceElement):
    """A spring to the ground that does not read t and v, and a note of its calls."""

    at: object
    calls: list
    k: float = 40.0
    name: str | None = None

    def sides(self):
        return (self.at,)

    def forces(self, t, x, v):
        self.calls.append(x)
        return -self.k * x

    def energy(self, x):
        return 0.5 * self.k * float(x[0] @ x[0])


@pi.compiled
@dataclass(frozen=True, eq=False)
class CompiledSpring(Spring):
    """The same, compiled."""

    def forces(self, t, x, v):
        return -self.k * x

    def energy(self, x):
        return 0.5 * self.k * (x[0, 0] ** 2 + x[0, 1] ** 2)


def pendulum(kind, *arguments):
    """Two hinged bars with an element on the end."""
    scene, before = pi.Scene(gravity=(0.0, -9.81)), pi.ground.at((0.0, 0.0))
    for k in range(2):
        bar = scene.add(pi.RigidBody.bar(1.0, 1.0, (k, 0.0), name=f"bar {k}"))
        scene.add(pi.Revolute(before, bar.at("left")))
        before = bar.at("right")
    scene.add(kind(before, *arguments, name="push"))
    return scene.build()


@pytest.mark.parametrize("method", METHODS, ids=repr)
def test_it_takes_the_steps_of_the_compiled_force(method):
    slow, fast = (pi.solve(pendulum(kind, []), 0.05, method) for kind in (Spring, CompiledSpring))
    assert slow.success and abs(slow.counts.residuals - fast.counts.residuals) <= 0.03 * fast.counts.residuals
    assert np.abs(slow.q[-1] - fast.q[-1]).max() < 1e-8
    assert "the Python of 'push'" in slow.summary() and "Python" not in fast.summary()


def test_its_scene_has_the_table_of_compiled_steps():
    assert type(Steps(METHODS[0], pendulum(Spring, []), pi.Counts()).table) is SceneTable


def failing(error):
    """A function that raises the error from 5 ms on."""

    def function(t, x, v):
        if t > 5e-3:
            raise error
        return np.zeros((1, 2))

    return function


@pytest.mark.parametrize("method", METHODS, ids=repr)
def test_what_it_raises_ends_the_run_at_its_time(method):
    error = ValueError("late")
    with pytest.raises(ValueError, match="late") as raised:
        pi.solve(pendulum(Push, failing(error)), 0.02, method)
    assert raised.value is error
    interrupted = pi.solve(pendulum(Push, failing(KeyboardInterrupt())), 0.02, method)
    assert interrupted.status == "interrupted" and 2e-3 < interrupted.t[-1] < 6.5e-3


@pytest.mark.parametrize("method", METHODS, ids=repr)
@pytest.mark.parametrize(
    "late, words",
    [
        (lambda v: np.zeros((2, 2)), r"push: forces must return real numbers of shape \(1, 2\), not ndarray of shape \(2, 2\)"),
        (lambda v: 1j * v, "push: forces must return real numbers"),
        (lambda v: v.fill(0.0), "push: forces writes into its arguments"),
    ],
    ids=["shape", "complex", "writing"],
)
def test_what_it_returns_is_checked_within_steps(method, late, words):
    with pytest.raises(pi.InputError, match=words):
        pi.solve(pendulum(Push, lambda t, x, v: late(v) if t > 5e-3 else np.zeros((1, 2))), 0.02, method)


@pytest.mark.parametrize("method", METHODS, ids=repr)
def test_numbers_that_are_not_finite_are_named(method):
    run = pi.solve(pendulum(Push, lambda t, x, v: np.full((1, 2), np.nan if t > 5e-3 else 0.0)), 0.02, method)
    assert not run.success and "forces of 'push' gave numbers that are not finite" in run.message and 2e-3 < run.t[-1] < 6.5e-3


def test_threads_share_a_model_and_each_raises_its_own_error():
    gate = threading.Barrier(4)

    def function(t, x, v):
        if t > 5e-3 and threading.current_thread().name.endswith("1"):
            raise ValueError(threading.current_thread().name)
        return -3.0 * v

    model, ended = pendulum(Push, function), {}

    def work(name):
        threading.current_thread().name = name
        gate.wait()
        try:
            ended[name] = pi.solve(model, 0.02, METHODS[0]).q
        except ValueError as error:
            ended[name] = str(error)

    alone = pi.solve(model, 0.02, METHODS[0]).q
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(work, ["a1", "b1", "c2", "d2"]))
    assert ended.pop("a1") == "a1" and ended.pop("b1") == "b1"
    assert all(np.array_equal(q, alone) for q in ended.values())


def test_a_model_is_given_free_at_once():
    model = pendulum(Spring, [])
    run, watched = pi.solve(model, 5e-3, METHODS[0]), weakref.ref(model.callbacks[0].functions)
    gc.collect()
    gc.disable()
    try:
        del model, run
        assert watched() is None
    finally:
        gc.enable()


def test_a_pickled_model_has_callbacks_of_its_own():
    model = pendulum(Spring, [])
    other = pickle.loads(pickle.dumps(model))
    assert other.callbacks[0].addresses["forces"] != model.callbacks[0].addresses["forces"]
    q = [pi.solve(each, 0.01, METHODS[0]).q for each in (model, other)]
    assert np.array_equal(*q)


def test_it_gets_read_only_arrays_of_its_own():
    calls = []
    model = pendulum(Spring, calls)
    pi.solve(model, 0.01, METHODS[0])
    copies = [x.copy() for x in calls]
    pi.solve(model, 0.01, METHODS[2])
    assert all(np.array_equal(x, copy) and not x.flags.writeable for x, copy in zip(calls, copies))
    assert len({x.tobytes() for x in copies}) > 5


def test_a_function_that_changed_is_asked_again():
    push = [1.0]
    model = pendulum(Push, lambda t, x, v: np.array([[push[0], 0.0]]))
    zero = np.zeros(model.n)
    before = model.force(0.0, zero, zero)
    push[0] = 2.0
    assert np.abs(model.force(0.0, zero, zero) - before).max() > 0.1


def test_arguments_that_are_read_are_seen_in_the_code():
    def none(self, t, x, v):
        return np.zeros(2)

    def inner(self, t, x, v):
        return sum(v[k] for k in range(2)) + (lambda: x)()

    def hidden(self, t, x, v):
        return locals()["v"]

    def any_number(self, *arguments):
        return arguments[0]

    names = ["t", "x", "v"]
    assert arguments_read(none, names) == [False] * 3
    assert arguments_read(inner, names) == [False, True, True]
    assert arguments_read(hidden, names) == arguments_read(any_number, names) == arguments_read(np.cos, names) == [True] * 3


def test_a_pushed_profile_reaches_it():
    """As linear systems ask for the slope in an input."""

    @dataclass(frozen=True, eq=False)
    class Driven(pi.ForceElement):
        at: object
        move: object
        name: str | None = None

        def sides(self):
            return (self.at,)

        def forces(self, t, x, v):
            return np.array([[3.0 * self.move(t), 0.0]])

    model = pendulum(Driven, pi.profile.sine(2.0, 1.5))
    state = 0.3, np.zeros(model.n), np.zeros(model.n)
    change = model.pushed(0.3, model.profiles.index(model.own_forces[0].element.move), 0.5).force(*state) - model.force(*state)
    expected = -model.own_forces[0].A.T @ [1.5, 0.0]
    assert np.abs(change - expected).max() < 1e-12
