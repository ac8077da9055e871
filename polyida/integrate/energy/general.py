"""Steps of the energy-momentum method on models of one's own, by the discrete derivative, and the same on scenes with force elements.

The work of the force at the middle is not the difference of the potential; Gonzalez (J. Nonlinear Sci. 6 (1996) 449-467) adds what is
missing, along M dq:

    M (v_1 - v_0)/h + g(t_m, q_m, v_m) + [V_1 - V_0 - V'] M dq / (dq^T M dq) + phi_q(q_m)^T lam = 0,     V' = grad V(q_m) . dq

Forces beyond the potential act at the middle. With a constraint that is at most quadratic `phi_q(q_m) dq = phi_1 - phi_0`, so it does
no work. The matrix, one a step, leaves out the derivative of the bracket, which is of second order in dq: Newton contracts without.
"""

from types import SimpleNamespace

import numpy as np

from polyida.assembly.own.laws import NOISE
from polyida.errors import InputError, StepFailure
from polyida.integrate.energy.steps import SLOW, Steps
from polyida.linear.kkt import KKT
from polyida.linear.lu import SingularSystem
from polyida.model.differences import FIRST_ORDER_STEP, along
from polyida.model.guarded import guard, require_constraints
from polyida.system.table import DONE, INVERTED, NOT_FINITE, REFACTOR, SINGULAR

EPS = np.finfo(float).eps
SPAN = 0.125 / FIRST_ORDER_STEP  # V' from values at +-1/8 and +-1/4 of dq: the nearer, the more round-off
SAME = 1e-9  # of its size, by which what ought to be equal may differ


def missing(potential, x0, x1, metric, slope=None):
    """`[V_1 - V_0 - V'] M dx / (dx^T M dx)` from x0 to x1, metric being M dx; zero where round-off is all there is.

    slope: grad V at the middle, in the shape of x; None: V' by differences, which a kink of V near the middle makes wrong.
    """
    dx, middle = x1 - x0, 0.5 * (x0 + x1)
    size, first, last = np.vdot(dx, metric), potential(x0), potential(x1)
    along_dx = along(lambda s: potential(middle + s * dx), SPAN) if slope is None else np.vdot(slope, dx)
    bracket = last - first - along_dx
    if not (size > 0.0 and abs(bracket) > NOISE * max(abs(first), abs(last))):
        return np.zeros_like(dx)
    return bracket / size * metric


class General(Steps):
    """Steps by the discrete derivative of the model's potential; Newton with the whole saddle-point matrix, kept while it contracts."""

    extent = 0.0

    def _room(self):
        n, m = self.model.n, self.model.m
        return SimpleNamespace(u0=np.zeros(n), v0=np.zeros(n), u1=np.zeros(n), lam=np.zeros(m), phi=np.zeros(m))

    def _solve(self, t):
        middle, end = (min(s, self.until) for s in (t - self.h / 2, t))
        w, before, self.fresh = self.room, 0.0, self.system is None
        for iteration in range(self.settings.max_iterations):
            ended, r = self._residual(middle)
            w.phi[:] = self.model.phi(end, w.u1.ravel())
            self.counts.residuals += 1
            if ended != DONE or not (np.isfinite(r).all() and np.isfinite(w.phi).all()):
                return (NOT_FINITE if ended == DONE else ended), before
            if (self.system is None or not iteration) and not self._factor(middle, end):
                return SINGULAR, before
            moved, size, pull = self._correct(*self.system.solve(r, w.phi))
            rate = moved / before if before > 0.0 else 1.0
            small = iteration and rate < 1.0 and moved * rate / (1.0 - rate) <= self.settings.tolerance * self.h**2 * pull
            if moved <= 4.0 * EPS * size or small:
                return self._accepted(end), moved
            if iteration > 1 and rate > SLOW:
                return (self._accepted(end) if moved <= 256.0 * EPS * (size + self.extent) else REFACTOR), moved
            before = moved
        return REFACTOR, before

    def _residual(self, t):
        """(DONE, r) at the middle."""
        w, h, model = self.room, self.h, self.model
        w.um, w.vm = 0.5 * (w.u0 + w.u1), (w.u1 - w.u0) / h
        w.a = 2.0 * (w.vm - w.v0) / h
        r = model.residual(t, w.um, w.vm, w.a, w.lam)
        if np.isfinite(r).all():
            r = r + missing(model.potential, w.u0, w.u1, model.mass(w.um) @ (w.u1 - w.u0))
        return DONE, r

    def _factor(self, middle, end):
        """Make the matrix; False where it is singular."""
        w, h, model = self.room, self.h, self.model
        matrix = model.tangent(middle, w.um.ravel(), w.vm.ravel(), w.a.ravel(), w.lam, 2.0 / h**2, 1.0 / h, 0.5)
        self.counts.tangents += 1
        self.counts.factorizations += 1
        try:
            self.system = KKT(matrix, model.phi_q(end, w.u1.ravel()), pull=model.phi_q(middle, w.um.ravel()))
        except SingularSystem:
            return False
        return True

    def _correct(self, dq, dlam):
        """Move the end; the largest entries of dq, q and the acceleration."""
        w = self.room
        self.counts.solves += 1
        self.counts.newton_iterations += 1
        w.u1[:] += dq.reshape(w.u1.shape)
        w.lam[:] += dlam
        return tuple(float(np.abs(x).max()) for x in (dq, w.u1, w.a))

    def _accepted(self, t):
        objection = self.model.objection(t, self.room.u1.ravel())
        if objection:
            raise StepFailure("objection", objection, t)
        return DONE


class WithForces(General):
    """Steps of a scene with force elements or bodies of one's own: plates, loads, masses and joints by the exact form of
    `scene.equilibrium`, each force element and elastic body by the discrete derivative of its own energy on its own places.
    """

    def _room(self):
        model = self.model
        self.extent, lam = model.extent, np.zeros(model.m)
        states, (r, rotation, v0) = np.zeros((5, model.n_nodes, 2)), np.zeros((3, model.n_nodes, 2))
        u0, u1, um, vm, a = states
        points = dict(zip(("dz", "forces"), np.zeros((2, model.n_points, 2))))
        return SimpleNamespace(
            states=states, u0=u0, u1=u1, um=um, vm=vm, a=a, v0=v0, lam=lam, phi=lam.copy(), r=r, rotation=rotation, **points
        )

    def _residual(self, t):
        """(how it ended, r) at the middle."""
        from polyida.integrate.energy.scene import equilibrium

        w, h, model = self.room, self.h, self.model
        w.vm[:] = (w.u1 - w.u0) / h
        w.a[:], w.um[:] = 2.0 * (w.vm - w.v0) / h, 0.5 * (w.u0 + w.u1)
        det = equilibrium(model.arrays, model.drives(t), h, w.states, w.lam, w.phi, w.dz, w.forces, w.r, w.rotation)
        r = w.r.ravel().copy() if model.uneven_mass is None else w.r.ravel() + model.uneven_mass @ w.a.ravel()
        if model.uneven_drag is not None:
            r += model.uneven_drag @ w.vm.ravel()
        for own in model.own_forces.each:
            r -= own.A.T @ self._own(own, t).ravel()
        return (DONE if det > 0.0 else INVERTED if det <= 0.0 else NOT_FINITE), r

    def _own(self, own, t):
        """Forces of one of them, (sides, 2)."""
        w = self.room
        x0, x1 = own.places(w.u0.ravel()), own.places(w.u1.ravel())
        middle = 0.5 * (x0 + x1)
        force = own.forces(t, middle, own.velocities(w.vm.ravel()))
        if not np.isfinite(force).all():
            return force
        held = own.conservative(t, middle)
        return force - missing(own.energy, x0, x1, x1 - x0, None if held is None else -held)


def require_general(model):
    """Raise InputError, naming what is in the way, unless the discrete derivative takes a model of one's own.

    What its functions are like is seen at places drawn at random.
    """
    model, random = guard(model, "EnergyMomentum"), np.random.default_rng(0)
    require_constraints(model)
    q, d = random.standard_normal((2, model.n))
    part, else_ = f"EnergyMomentum: {model.name}", "; use GeneralizedAlpha or IDA"
    if model.potential(q) is None:
        raise InputError(f"{part} gives no potential(q), so there is no energy to keep{else_}")
    if model.needs.mass_varies and not _equal(model.mass(q), model.mass(q + d)):
        raise InputError(f"{part}: its mass varies with q; it must be constant{else_}")
    if model.m and not _equal(model.phi(0.0, q + d) - model.phi(0.0, q - d), 2.0 * model.phi_q(0.0, q) @ d):
        raise InputError(f"{part}: its phi(t, q) is not quadratic in q, at most, which its constraints must be to do no work{else_}")


def _equal(one, other):
    return abs(one - other).max() <= SAME * (abs(one).max() + abs(other).max())
