"""Velocity rows psi of own models against closed forms, in every integrator."""

import numpy as np
import pytest

import polyida as pi


class Skate(pi.Model):
    """A skate (x, y, angle) on a slope along x: it moves along its blade alone."""

    n, m, p = 3, 0, 1
    needs = pi.Needs(mass_varies=False, velocity_forces=False, driven=False, phi_q_varies=False)

    def mass(self, q):
        return np.eye(3)

    def force(self, t, q, v):
        return np.array([-2.0, 0.0, 0.0])

    def potential(self, q):
        return -2.0 * q[0]

    def psi(self, t, q, v):
        return np.array([v[1] * np.cos(q[2]) - v[0] * np.sin(q[2])])


class Disc(pi.Model):
    """A homogeneous disc (x, y, angle) of 2 kg and radius 0.1 m rolls on a belt along y = 0, whose speed is 0.3 t m/s."""

    n, m, p = 3, 1, 1
    needs = pi.Needs(mass_varies=False, velocity_forces=False, phi_q_varies=False)

    def mass(self, q):
        return np.diag([2.0, 2.0, 0.01])

    def force(self, t, q, v):
        return np.array([0.0, 2.0 * 9.81, 0.0])

    def potential(self, q):
        return 2.0 * 9.81 * q[1]

    def phi(self, t, q):
        return q[1:2] - 0.1

    def phi_q(self, t, q):
        return np.array([[0.0, 1.0, 0.0]])

    def psi(self, t, q, v):
        return v[:1] + 0.1 * v[2] - 0.3 * t


@pi.compiled
class CompiledSkate(Skate):
    """The same; numba compiles none of the functions of a model with psi."""


class WrittenSkate(Skate):
    """The same with W."""

    def psi_v(self, t, q):
        return np.array([[-np.sin(q[2]), np.cos(q[2]), 0.0]])


INTEGRATORS = {  # with a tolerance
    "alpha": (pi.GeneralizedAlpha(h=1e-3), 1e-5),
    "alpha stabilised": (pi.GeneralizedAlpha(h=1e-3, form="stabilised"), 1e-5),
    "alpha kkt": (pi.GeneralizedAlpha(h=2e-3, linear="kkt"), 1e-4),
    "Radau": (pi.RadauIIA(rtol=1e-9), 1e-8),
    "Radau 2": (pi.RadauIIA(rtol=1e-7, stages=2), 1e-5),
    "Radau index3": (pi.RadauIIA(rtol=1e-9, form="index3"), 1e-8),
    "Radau kkt": (pi.RadauIIA(rtol=1e-9, linear="kkt"), 1e-8),
    "IDA": (pi.IDA(rtol=1e-9), 1e-6),
    "IDA kkt": (pi.IDA(rtol=1e-9, linear="kkt"), 1e-6),
    "IDA index2": (pi.IDA(rtol=1e-9, form="index2"), 1e-6),
    "IDA index1": (pi.IDA(rtol=1e-9, form="index1"), 1e-6),
    "energy": (pi.EnergyMomentum(h=1e-3), 1e-5),
}


@pytest.mark.parametrize(
    "kind, name",
    [(Skate, name) for name in INTEGRATORS]
    + [(kind, name) for kind in (WrittenSkate, CompiledSkate) for name in ("alpha", "Radau", "IDA kkt", "energy")],
)
def test_a_skate_on_a_slope_draws_cycloids(kind, name):
    """Neimark and Fufaev (1972): x = g / (2 w^2) sin^2(w t), y = g / (2 w^2) (w t - sin(2 w t) / 2)."""
    (integrator, tolerance), w, t = INTEGRATORS[name], 1.5, 0.5
    run = pi.solve(kind(), t, integrator, v0=[0.0, 0.0, w])
    assert run.success, run.message
    expected = [np.sin(w * t) ** 2 / w**2, (w * t - np.sin(2 * w * t) / 2) / w**2, w * t]
    assert np.abs(run.q[-1] - expected).max() < tolerance
    side = 2.0 * np.sin(w * t) * 2.0  # of the slope, and of the turning speed: W^T nu balances g sin(angle) and w speed
    assert run.lam.shape[1] == 1 and abs(abs(run.lam[-1, 0]) - side) < 100 * tolerance


@pytest.mark.parametrize("name", INTEGRATORS)
def test_a_disc_on_a_belt(name):
    """The belt's acceleration a gives the disc a third of it."""
    (integrator, tolerance), t = INTEGRATORS[name], 0.5
    run = pi.solve(Disc(), t, integrator, q0=[0.0, 0.1, 0.0])
    assert run.success, run.message
    assert np.abs(run.q[-1] - [0.1 * 0.5 * t**2, 0.1, 0.2 / 0.1 * 0.5 * t**2]).max() < tolerance
    assert np.abs(run.lam[-1] - [-2.0 * 9.81, -2.0 * 0.1]).max() < 100 * tolerance
    assert run.drift.max() < 1e-7


def test_the_energy_of_a_skate_is_kept():
    run = pi.solve(Skate(), 5.0, pi.EnergyMomentum(h=1e-2), v0=[0.0, 0.0, 1.5])
    assert np.ptp(run.energy.total) < 1e-10


def test_derivatives_and_files(tmp_path):
    assert max(pi.check_derivatives(Disc()).values()) < 1e-6
    run = pi.solve(Skate(), 0.1, pi.RadauIIA(rtol=1e-6), v0=[0.0, 0.0, 1.5], out=tmp_path / "skate.h5")
    assert np.array_equal(pi.load(tmp_path / "skate.h5").lam, run.lam)


class Quadratic(Skate):
    def psi(self, t, q, v):
        return super().psi(t, q, v) + v[2] ** 2


class WrongSlope(WrittenSkate):
    def psi_v(self, t, q):
        return -super().psi_v(t, q)


class WrongShape(Skate):
    def psi(self, t, q, v):
        return np.zeros(2)


class Short(Disc):
    def psi(self, q, v):
        return v[:1]


class NoPsi(Skate):
    psi = pi.Model.psi


class Moving(Disc):
    needs = pi.Needs(driven=False)


class Dependent(Disc):
    def psi(self, t, q, v):
        return v[1:2]


@pytest.mark.parametrize(
    "model, words",
    [
        (Quadratic(), r"Quadratic\.psi must be linear in v"),
        (WrongSlope(), r"WrongSlope\.psi must be linear in v, with psi_v"),
        (WrongShape(), r"WrongShape\.psi must return an array of shape \(1,\), not \(2,\)"),
        (Short(), r"Short\.psi must be a function psi\(self, t, q, v\); it takes \(q, v\)"),
        (NoPsi(), r"NoPsi: p = 1 velocity rows, but its class gives no psi"),
        (Moving(), r"Moving\.psi is not zero at v = 0.* driven=True"),
        (Dependent(), r"phi\[0\].* psi\[0\]|psi\[0\].* phi\[0\]"),
    ],
    ids=lambda value: type(value).__name__,
)
def test_wrong_velocity_rows_are_named(model, words):
    with pytest.raises(pi.InputError, match=words):
        pi.solve(model, 0.1, pi.RadauIIA(), q0=[0.0, 0.1, 0.0])


class Driven(Disc):
    """The disc with a motor whose torque, N m, follows 0.3 with the time constant 0.1 s; the belt is at rest."""

    k = 1
    needs = pi.Needs(mass_varies=False, driven=False)

    def force(self, t, q, v, x):
        return np.array([0.0, 2.0 * 9.81, -x[0]])

    def rates(self, t, q, v, x):
        return (0.3 - x) / 0.1

    def psi(self, t, q, v):
        return v[:1] + 0.1 * v[2]


@pytest.mark.parametrize(
    "integrator", [pi.RadauIIA(rtol=1e-9), pi.GeneralizedAlpha(h=1e-3), pi.IDA(rtol=1e-9)], ids=lambda one: type(one).__name__
)
def test_velocity_rows_beside_states(integrator):
    """`3 x'' = -10 s`, the state `s = 0.3 (1 - exp(-10 t))`."""
    run = pi.solve(Driven(), 0.5, integrator, q0=[0.0, 0.1, 0.0])
    assert run.success, run.message
    way = 0.3 * (0.5**2 / 2.0 - 0.1 * 0.5 + 0.01 * (1.0 - np.exp(-5.0)))
    assert run.q[-1, 0] == pytest.approx(-10.0 / 3.0 * way, abs=2e-6)
    assert run.x[-1, 0] == pytest.approx(0.3 * (1.0 - np.exp(-5.0)), abs=2e-6)
