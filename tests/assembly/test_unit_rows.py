"""The compiled proof that rows of phi_q stay independent: never more than the singular values say, and no singular position is passed over."""

from types import SimpleNamespace

import numpy as np
import pytest

import polyida as pi
from polyida.assembly.independence import SHARE, UnitRows
from polyida.integrate.state import State
from polyida.linear.lu import dense
from polyida.linear.saddle import coordinate_sizes, least, rows_of
from polyida.model.compiled import Compiled
from polyida.model.guarded import guard


def bars(points, links):
    """A scene of bars between points {name: (x, y)}, pinned to the ground at points "A.." and to each other elsewhere."""
    scene, at = pi.Scene(gravity=(0.0, -9.81)), {}
    for first, second in links:
        (x0, y0), (x1, y1) = points[first], points[second]
        length, middle = np.hypot(x1 - x0, y1 - y0), ((x0 + x1) / 2, (y0 + y1) / 2)
        ends = {first: (x0, y0), second: (x1, y1)}
        bar = scene.add(pi.RigidBody(1.0, length**2 / 12, center=middle, points=ends, name=first + second))
        for end in (first, second):
            at.setdefault(end, []).append(bar.at(end))
    for end, sides in at.items():
        before = [pi.ground.at(points[end])] if end.startswith("A") else []
        for k, (one, other) in enumerate(zip(before + sides, (before + sides)[1:])):
            scene.add(pi.Revolute(one, other, name=f"{end}{k}"))
    return scene


def chain(count):
    """A chain of bars that hangs from the ground."""
    points = {"A": (0.0, 0.0)} | {f"P{k}": (k + 1.0, 0.0) for k in range(count)}
    names = list(points)
    return bars(points, list(zip(names, names[1:])))


def four_bars(count, turned=1.0):
    """Parallelograms side by side, their links 1 m, cranks at an angle to the ground."""
    feet = {f"A{k}": (float(k), 0.0) for k in range(count + 1)}
    points = feet | {f"P{k}": (k + np.cos(turned), np.sin(turned)) for k in range(count + 1)}
    return bars(points, [(f"A{k}", f"P{k}") for k in range(count + 1)] + [(f"P{k}", f"P{k + 1}") for k in range(count)])


@pytest.mark.parametrize("scene", [chain(1), chain(6), four_bars(1), four_bars(5), four_bars(2, 0.02)])
@pytest.mark.parametrize("size", [0.0, 0.05, 0.5])
def test_the_bound_is_below_the_least_singular_value(scene, size):
    model, rng = scene.build(), np.random.default_rng(1)
    start = pi.consistent_state(model)
    proof, sizes = UnitRows(model, start), coordinate_sizes(model, start.q)
    for _ in range(20):
        state = State(0.0, start.q + size * rng.standard_normal(model.n), start.v, start.a, start.lam)
        proof.begin(state)
        found, exact = proof.workspace.least[0], least(rows_of(model.phi_q(0.0, state.q), sizes))
        assert exact / np.sqrt(model.m) * (1 - 1e-6) <= found <= exact * (1 + 1e-6)


@pytest.mark.parametrize("scene", [chain(6), four_bars(5), four_bars(20)])
def test_a_state_keeps_the_reference_only_if_the_spectral_norm_of_the_change_allows_it(scene):
    model, rng, kept = scene.build(), np.random.default_rng(2), {"by the spectral norm alone": 0, "all": 0}
    start = pi.consistent_state(model)
    proof, sizes = UnitRows(model, start), coordinate_sizes(model, start.q)
    first = rows_of(model.phi_q(0.0, start.q), sizes)
    for size in np.geomspace(1e-3, 0.1, 30):
        proof.begin(start)
        q = start.q + size * rng.standard_normal(model.n)
        list(proof.unproven(SimpleNamespace(t=[1.0], q=[q], state=lambda k, q=q: State(1.0, q, start.v, start.a, start.lam))))
        rows = rows_of(model.phi_q(1.0, q), sizes)
        change = dense(rows.unit) - dense(first.unit)
        if proof.workspace.past[0, 0] == 0.0:
            limit = SHARE * proof.workspace.least[0]
            assert np.linalg.norm(change, 2) < limit
            kept["all"] += 1
            kept["by the spectral norm alone"] += np.linalg.norm(change) > limit
        else:
            assert 0.0 < proof.workspace.least[0] <= least(rows) * (1 + 1e-6)
    assert kept["by the spectral norm alone"] > 0 and kept["all"] < 30


@pi.compiled
class Crank(pi.Model):
    """A crank of radius `radius`, a rod, and a line through the origin whose slope is `rate` t, on which the rod's end runs."""

    name, n, m = "crank", 4, 3

    def __init__(self, radius, rate):
        self.radius, self.rate = radius, rate

    def mass(self, q):
        return np.eye(4)

    def force(self, t, q, v):
        return np.zeros(4)

    def phi(self, t, q):
        pin, end = q[:2], q[2:]
        return np.array([(pin @ pin) / self.radius - self.radius, (end - pin) @ (end - pin) - 1.0, end[1] - self.rate * t * end[0]])

    def phi_q(self, t, q):
        x, y, w, z = q[0] / self.radius, q[1] / self.radius, q[2] - q[0], q[3] - q[1]
        return np.array([[2.0 * x, 2.0 * y, 0.0, 0.0], [-2.0 * w, -2.0 * z, 2.0 * w, 2.0 * z], [0.0, 0.0, -self.rate * t, 1.0]])


def test_of_a_compiled_model_every_state_is_examined_with_the_numbers_of_self_and_at_its_own_time():
    model, angles, times = guard(Crank(0.25, 3.0)), np.linspace(0.3, 0.32, 5), np.linspace(0.1, 0.11, 5)
    places = np.stack([0.25 * np.cos(angles), 0.25 * np.sin(angles), np.cos(angles) + 1.0, 3.0 * times], axis=1)
    states = [State(t, q, np.zeros(4), np.zeros(4), np.zeros(3)) for t, q in zip(times, places)]
    proof = UnitRows(model, states[0], Compiled(model, ("phi_q",)))
    assert proof.begin(states[0])
    exact = rows_of(model.phi_q(times[0], places[0]), proof.sizes)
    assert least(exact) / np.sqrt(3.0) * (1 - 1e-6) <= proof.workspace.least[0] <= least(exact) * (1 + 1e-6)
    assert list(proof.unproven(SimpleNamespace(t=times[1:], q=places[1:], state=lambda k: states[k + 1]))) == []
    exact = dense(rows_of(model.phi_q(times[-1], places[-1]), proof.sizes).unit)
    np.testing.assert_allclose(proof.workspace.rows[1].reshape(3, 4)[:, : exact.shape[1]], exact, rtol=1e-12, atol=1e-12)
