"""The energy-momentum method on models of one's own: the discrete derivative keeps what they call their energy."""

from dataclasses import dataclass

import numpy as np
import pytest

import polyida as pi
from polyida.problems.equations import Pendulum

G = 9.81


class Chain(pi.Model):
    """Masses in a row, held at one end, between springs of potential `e^2/2 + 40 e^4`."""

    n, m = 4, 0
    needs = pi.Needs(mass_varies=False, velocity_forces=True, driven=False, phi_q_varies=False)
    damping = 0.0

    def mass(self, q):
        return np.diag([1.0, 2.0, 1.0, 0.5])

    def force(self, t, q, v):
        e = np.diff(q, prepend=0.0)
        pull = e + 160.0 * e**3
        return pull - np.append(pull[1:], 0.0) + self.damping * v

    def potential(self, q):
        e = np.diff(q, prepend=0.0)
        return float(np.sum(e**2 / 2 + 40.0 * e**4))


def swing(h, t_end=1.0, **settings):
    run = pi.solve(Pendulum(), t_end, pi.EnergyMomentum(h=h, **settings), q0=[1.0, 0.0])
    assert run.success, run.message
    return run


def test_pendulum_keeps_its_energy_for_long():
    run = swing(5e-3, 10.0)
    assert np.ptp(run.energy.total) < 1e-10 * np.ptp(run.energy.kinetic)
    assert run.drift.max() < 1e-14 and run.velocity_drift.max() < 1e-14
    assert np.ptp(swing(1e-2, 10.0, tolerance=1e-13).energy.total) < 2e-11


def test_quartic_potential_is_kept_and_second_order():
    v0 = [0.0, 1.0, 0.0, -1.0]
    runs = [pi.solve(Chain(), 4.0, pi.EnergyMomentum(h=h), v0=v0) for h in (4e-2, 2e-2, 1e-2)]
    for run in runs:
        assert np.ptp(run.energy.total) < 1e-9 * run.energy.total[0]
    exact = pi.solve(Chain(), 4.0, pi.IDA(rtol=1e-10, atol=1e-12), v0=v0)
    errors = [np.abs(run.q[-1] - exact.q[-1]).max() for run in runs]
    assert np.log2(errors[1] / errors[2]) == pytest.approx(2.0, abs=0.1)


class Wavy(pi.Model):
    """A mass over `V = -5 cos 10 q`: a step of 0.05 s passes a third of a wave."""

    n, m = 1, 0
    needs = pi.Needs(mass_varies=False, velocity_forces=False, driven=False)

    def mass(self, q):
        return np.eye(1)

    def force(self, t, q, v):
        return 50.0 * np.sin(10.0 * q)

    def potential(self, q):
        return -5.0 * np.cos(10.0 * q[0])


class Barrier(Wavy):
    """A mass between walls at q = 1 and -1, of `V = -ln(1 - q^2)`, which is not a number beyond them."""

    def force(self, t, q, v):
        return 2.0 * q / (1.0 - q * q)

    def potential(self, q):
        return float(-np.log(1.0 - q[0] ** 2)) if abs(q[0]) < 1.0 else np.nan


@pytest.mark.parametrize("kind, h, q0", [(Wavy, 0.05, 10.5), (Barrier, 5e-3, 0.5)])
@pytest.mark.parametrize("solved", ["compiled", "dense", "large"])
def test_potentials_that_are_no_polynomials_are_kept(kind, h, q0, solved):
    """Differences of fourth order left 2e-3 J of both, of 9 J and 5 J."""
    model = kind()
    if solved == "compiled":
        model = pi.compiled(type("Compiled", (kind,), {"potential": compiled_barrier} if kind is Barrier else {}))()
    elif solved == "large":
        total = lambda self, q: sum(kind.potential(self, [x]) for x in q)  # noqa: E731
        model = type("Many", (kind,), {"n": 60, "mass": lambda self, q: np.eye(60), "potential": total})()
    run = pi.solve(model, 1.0, pi.EnergyMomentum(h=h), q0=np.full(model.n, q0), v0=np.full(model.n, 4.0))
    assert run.success, run.message
    assert np.ptp(run.energy.total) < 1e-6 * np.ptp(run.energy.kinetic)
    assert kind is Wavy or np.abs(run.q).max() < 1.0


def compiled_barrier(self, q):
    return -np.log(1.0 - q[0] ** 2) if abs(q[0]) < 1.0 else np.nan


def test_forces_beyond_the_potential_take_energy():
    model = Chain()
    model.damping = 0.3
    run = pi.solve(model, 2.0, pi.EnergyMomentum(h=1e-2), v0=[0.0, 1.0, 0.0, -1.0])
    assert (np.diff(run.energy.total) < 0).all()
    taken = 0.3 * ((np.diff(run.q, axis=0) / 1e-2) ** 2).sum(axis=1) * 1e-2
    assert np.abs(np.diff(run.energy.total) + taken).max() < 1e-10


class Silent(Pendulum):
    def potential(self, q):
        return None


class Heavy(Pendulum):
    needs = pi.Needs(driven=False)

    def mass(self, q):
        return (1.0 + q @ q) * np.eye(2)


class Bent(Pendulum):
    def phi(self, t, q):
        return np.array([q[1] + np.cos(q[0]) - 1.0])

    def phi_q(self, t, q):
        return np.array([[-np.sin(q[0]), 1.0]])


@pytest.mark.parametrize("model, words", [(Silent(), "no potential"), (Heavy(), "mass varies"), (Bent(), "not quadratic")])
def test_what_it_cannot_take_is_refused(model, words):
    with pytest.raises(pi.InputError, match=f"{type(model).__name__}.*{words}"):
        pi.solve(model, 1.0, pi.EnergyMomentum(h=1e-2), q0=[1.0, 0.0])


def test_a_potential_that_is_not_that_of_the_force_is_named():
    wrong = type("Wrong", (Pendulum,), {"potential": lambda self, q: 1.01 * Pendulum.potential(self, q)})
    assert pi.check_derivatives(wrong())["potential"] > 5e-3 and pi.check_derivatives(Pendulum())["potential"] < 1e-8
    with pytest.raises(pi.InputError, match=r"Wrong\.potential\(q\) must have force\(t, q, 0\) as its slope"):
        pi.solve(wrong(), 0.1, pi.EnergyMomentum(h=1e-2), q0=[1.0, 0.0])
    told = type("Told", (wrong,), {"powers": lambda self, t, q, v, lam: {}})
    assert pi.solve(told(), 0.1, pi.EnergyMomentum(h=1e-2), q0=[1.0, 0.0]).success


@dataclass(frozen=True, eq=False)
class Wall(pi.ForceElement):
    """A wall of `V = -ln(1 - r^2)` around a point; beyond it V is not a number, and the force is one."""

    a: object
    b: object
    name: str | None = None

    def sides(self):
        return self.a, self.b

    def forces(self, t, x, v):
        w = x[1] - x[0]
        f = 2.0 / (1.0 - w @ w) * w
        return np.stack((f, -f))

    def energy(self, x):
        w = x[1] - x[0]
        return -np.log(1.0 - w @ w) if w @ w < 1.0 else np.nan


@pi.compiled
@dataclass(frozen=True, eq=False)
class CompiledWall(Wall):
    pass


@pytest.mark.parametrize("kind", [Wall, CompiledWall])
def test_a_step_to_where_an_energy_is_not_a_number_is_halved(kind):
    scene = pi.Scene()
    ball = scene.add(pi.RigidBody(1.0, 0.1, {"c": (0.0, 0.0)}, origin=(0.5, 0.0), velocity=(4.0, 0.0), name="ball"))
    scene.add(kind(pi.ground.at((0.0, 0.0)), ball.at("c"), name="wall"))
    run = pi.solve(scene.build(), 1.0, pi.EnergyMomentum(h=0.01))
    assert run.success and run.counts.rejected > 0, run.message
    assert run.position(ball.at("c"))[:, 0].max() < 1.0 and np.ptp(run.energy.total) < 1e-7
    assert max(pi.check_derivatives(scene.build()).values()) < 1e-6  # at places within the wall
    failed = pi.solve(scene.build(), 1.0, pi.EnergyMomentum(h=0.2))  # 64 parts of it are too long
    assert failed.status == "not finite" and np.abs(failed.position(ball.at("c"))).max() < 1.0
