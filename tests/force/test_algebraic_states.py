"""Force elements with algebraic states, `0 = f(t, x, v, s)`, against the same elements with these states eliminated by hand."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

import polyida as pi

VOLTS = pi.profile.sine(12.0, 3.0)


@dataclass(frozen=True, eq=False)
class Drive(pi.ForceElement):
    """A force along x that follows with a lag s the thrust of two flows: `c p + p |p| = 1 - x' + s`, `p - w = x`, `T s' = w - s`."""

    at: Any
    T: float = 0.05
    c: float = 0.3
    name: str | None = None
    states = ("s",)
    algebraic = ("p", "w")

    def sides(self):
        return (self.at,)

    def start(self):
        return [0.1, 0.0, 0.0]

    def rates(self, t, x, v, s):
        flow = self.c * s[1] + s[1] * abs(s[1]) - 1.0 + v[0, 0] - s[0]
        return np.array([(s[2] - s[0]) / self.T, flow, s[1] - s[2] - x[0, 0]])

    def forces(self, t, x, v, s):
        f = np.zeros((1, 2))
        f[0, 0] = s[1] - 4.0 * x[0, 0]
        return f


@dataclass(frozen=True, eq=False)
class ByHand(Drive):
    """The same with the roots of the quadratic equation."""

    algebraic = ()

    def start(self):
        return [0.1]

    def pressure(self, v, s):
        b = 1.0 - v[0, 0] + s[0]
        return np.sign(b) * (np.sqrt(0.25 * self.c**2 + abs(b)) - 0.5 * self.c)

    def rates(self, t, x, v, s):
        return np.array([(self.pressure(v, s) - x[0, 0] - s[0]) / self.T])

    def forces(self, t, x, v, s):
        f = np.zeros((1, 2))
        f[0, 0] = self.pressure(v, s) - 4.0 * x[0, 0]
        return f


CompiledDrive = pi.compiled(type("CompiledDrive", (Drive,), {}))
ALL = [pi.GeneralizedAlpha(h=0.01, tolerance=1e-11), pi.RadauIIA(h=0.02, tolerance=1e-12), pi.IDA(rtol=1e-9), pi.EnergyMomentum(h=0.01)]


def on_rail(kind, **changes):
    scene = pi.Scene()
    body = scene.add(pi.RigidBody(mass=1.0, inertia=0.1, points={"c": (0.0, 0.0)}, velocity=(0.5, 0.0), name="body"))
    scene.add(pi.Prismatic(pi.ground.at((0.0, 0.0), direction=(1.0, 0.0)), body.at("c"), name="rail"))
    scene.add(kind(body.at("c"), **{"name": "drive"} | changes))
    return scene.build()


@pytest.mark.parametrize("integrator, kind", [*((one, CompiledDrive) for one in ALL), (ALL[0], Drive), (ALL[2], Drive)])
def test_algebraic_states_are_those_eliminated_by_hand(kind, integrator):
    run, exact = (pi.solve(on_rail(one), 0.5, integrator) for one in (kind, ByHand))
    assert run.v[-1] == pytest.approx(exact.v[-1], abs=1e-8)
    s, p, w = run.states("drive").T
    assert s[-1] == pytest.approx(exact.x[-1, 0], abs=1e-8) and np.array_equal(run.x[:, 0], s)
    x, speed = run.q[:, 0], run.v[:, 0]
    assert np.abs(0.3 * p + p * np.abs(p) - 1.0 + speed - s).max() < 1e-12 and np.abs(p - w - x).max() < 1e-12


@pi.compiled
@dataclass(frozen=True, eq=False)
class Resistive(pi.ForceElement):
    """The torque `k n i` with the current `i = (volts - k n angle')/R`."""

    at: Any
    volts: Any
    name: str | None = None

    def sides(self):
        return (self.at.d,)

    def forces(self, t, x, v):
        size = x[0, 0] ** 2 + x[0, 1] ** 2
        rate = (x[0, 0] * v[0, 1] - x[0, 1] * v[0, 0]) / size
        torque = 0.4 * (self.volts(t) - 0.4 * rate) / 1.5
        return np.array([[-torque * x[0, 1] / size, torque * x[0, 0] / size]])


@pytest.mark.parametrize("integrator", ALL, ids=lambda one: type(one).__name__)
def test_a_motor_without_inductance(integrator):
    """`R i = volts - k n angle'` in the torque k n i."""

    def model(drive):
        scene = pi.Scene()
        rotor = scene.add(pi.RigidBody(mass=1.0, inertia=0.02, points={"c": (0.0, 0.0)}, name="rotor"))
        scene.add(pi.Revolute(pi.ground, rotor.at("c"), name="pin"))
        scene.add(drive(rotor.at("c")))
        return scene.build()

    run = pi.solve(model(lambda at: pi.DCMotor(at, VOLTS, k=0.2, L=0.0, R=1.5, gear=2.0, name="motor")), 0.5, integrator)
    exact = pi.solve(model(lambda at: Resistive(at, VOLTS, name="motor")), 0.5, integrator)
    assert run.q[-1] == pytest.approx(exact.q[-1], abs=1e-9) and run.success
    d = run.q[:, 2:4] + [np.sqrt(0.02), 0.0]  # a direction times the radius of gyration
    rate = (d[:, 0] * run.v[:, 3] - d[:, 1] * run.v[:, 2]) / (d**2).sum(axis=1)
    current = (np.array([VOLTS(t) for t in run.t]) - 0.4 * rate) / 1.5
    assert run.states("motor")[:, 0] == pytest.approx(current, abs=1e-10) and run.x.shape == (len(run), 0)
    assert "motor.current" in run.to_dataframe()


def test_a_singular_slope_is_refused_by_name():
    model = on_rail(type("Flat", (Drive,), {"rates": flat}))
    with pytest.raises(pi.InputError, match="algebraic states p, w of 'drive' have no solution: their slope d rates/ds is singular"):
        pi.solve(model, 0.1, pi.GeneralizedAlpha(h=0.01))


@pytest.mark.parametrize("changes, words", [({"algebraic": ("s",)}, "'s' is in states and in algebraic"), ({"algebraic": "p"}, "tuple")])
def test_wrong_names_are_refused(changes, words):
    with pytest.raises(pi.InputError, match=words):
        on_rail(type("Wrong", (Drive,), changes))


def test_a_rest_and_its_roots():
    rest, by_hand = (pi.static(on_rail(kind)) for kind in (CompiledDrive, ByHand))
    assert rest.q[0] == pytest.approx(by_hand.q[0], abs=1e-9)
    roots = [np.sort_complex(pi.linearise(on_rail(kind), rest).A.ravel()) for kind in (CompiledDrive, ByHand)]
    assert roots[0] == pytest.approx(roots[1], abs=1e-5)


def flat(self, t, x, v, s):
    return np.array([(s[2] - s[0]) / self.T, s[1] - s[2] - v[0, 0], 2.0 * (s[1] - s[2]) - x[0, 0]])
