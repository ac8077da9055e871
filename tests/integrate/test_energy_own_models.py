"""The energy-momentum method on models of one's own: the discrete derivative keeps what they call their energy."""

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
