"""The steps of NonsmoothAlpha and MoreauJean on one model, and the Newton's method of both, with a factor and columns that are kept.

A step of `NonsmoothAlpha` has three stages (in spirit Capobianco, Harsch, Eugster, Leine 2021; decoupled as Cosimo and others 2020).

1. Generalized-alpha with the rows that are closed at its start: their forces satisfy the laws at the velocities of its end, like those of the
   equations in the stabilised form.
2. Positions: the equations and the pressed contacts are closed, and penetration is removed, in the metric of M.
3. Velocities: impulses of impacts for all contacts that are closed now, with restitution, and friction; P is the total of a step.

Where a contact closes or opens, or friction begins or ends to slip, the next step begins with consistent accelerations. `Steps._alpha` has the
three stages in this order; `_newton` solves the first, and the step of `MoreauJean`:

    S dq + B_e^T dlam + B^T dp = -r,   B_e dq = -(rate of the equations)/v_q,   v_q = dv/dq in a step, S = c_m M + v_q C + K
    rates of the active rows with laws, over v_q: u = rate/v_q + B dq, with p in the cone of the laws of contact and friction

A step of `MoreauJean` has impulses only: `M (v_1 - v_0) + h g_theta + phi_q^T P = 0`, laws at the velocities of its end for the contacts that are
closed at a predicted position. It is of first order, and positions drift.
"""

from typing import Any, NamedTuple

import numpy as np

from polyida.errors import StepFailure
from polyida.integrate.discontinuities import at_kink
from polyida.integrate.nonsmooth.contacts import FIXED, TOUCH, Contacts, Problem
from polyida.integrate.sizes import extent, weights
from polyida.integrate.state import State
from polyida.linear.lu import SingularSystem
from polyida.model.differences import beside

SLOW = 0.3  # contraction of Newton's method beyond which columns are made again
MANY = 6  # iterations beyond which S is factored again
PRICE = 5  # solves that an iteration costs
TURNED = 0.05  # change of the rows with laws beyond which their columns are made again
JUMPED = 1e-2  # of the force of friction in the step before: a larger change is that of an impact
EXACT = 1e-13  # of |q| and the model's extent: change of q that is round-off


class Together(NamedTuple):
    """Columns of the k rows asked for last."""

    key: bytes  # the numbers of the rows
    slopes: Any = None  # (k, n) where the columns were made
    X: Any = None  # (k, n), transposed
    Y: Any = None  # (k, equations), transposed


class Product(NamedTuple):
    """G = B X of the rows asked for last."""

    slopes: Any = None  # B (k, n), compared by identity
    G: Any = None  # (k, k)


NO_ROWS = Together(b"")


class Columns:
    """Columns (X, Y) of the rows with laws by the factor of S, as Newton's method only needs them nearly: kept from one step to the next.

    They are made again where rows turn, where the method is slow, and where its iterations beyond the least cost more than new ones.

    known: {row: (slope, X, Y)} of single rows. together, product: Together and Product of the rows asked for last. least: fewest iterations of a
    step; wasted: those beyond it since the columns were made.
    """

    def __init__(self, contacts):
        """Take the contacts whose rows have laws, and begin without columns."""
        self.contacts = contacts
        self.forget()

    def forget(self):
        """Drop all columns, so that they are made again."""
        self.known = {}
        self.together = NO_ROWS
        self.product = Product()
        self.least = np.inf
        self.wasted = 0

    def of(self, active, B, system, *at):
        """(X (n, k), Y (equations, k), G = B X) of the active rows with the slopes B, and the number of new ones. at: t, q, lam of the equations."""

        def solve(r, phi):
            """(dq, dlam) of `S dq + B_e^T dlam = -r`, `B_e dq = -phi`, for columns r and phi."""
            return system.saddle(*at, r, phi)

        key, count = active.tobytes(), 0
        if not len(B):
            return *self.contacts.columns(solve, B), np.zeros((0, 0)), 0
        if self.together.key != key:
            rows = active.tolist()
            new = [k for k, row in enumerate(rows) if row not in self.known]
            if count := len(new):
                made = self.contacts.columns(solve, B[new])
                self.known |= {rows[k]: (B[k], x, y) for k, x, y in zip(new, *map(np.transpose, made))}
            self.together = Together(key, *map(np.array, zip(*(self.known[row] for row in rows))))
            self.product = Product()
        X, Y = self.together.X, self.together.Y
        if self.contacts.turning and np.abs(B - self.together.slopes).max() > TURNED * np.abs(B).max():
            self.forget()
            return self.of(active, B, system, *at)
        if self.product.slopes is not B:
            self.product = Product(B, B @ X.T)
        return X.T, Y.T, self.product.G, count

    def served(self, iterations, k):
        """Count the iterations of a step with k columns."""
        self.least, self.wasted = min(self.least, iterations), self.wasted + max(iterations - self.least, 0)
        if k and self.wasted * PRICE > k:
            self.forget()


class Unknowns(NamedTuple):
    """Unknowns of Newton's method at a step's end: q, v, a (n,), lam of the equations, and p of rows with laws."""

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    lam: np.ndarray
    p: np.ndarray


class StepEquations(NamedTuple):
    """What Newton's method solves in a step.

    residual: r of (model, q, v, a, lam of all rows). c_m: the factor of M in S; v_q = dv/dq, 1/s; a_q = da/dq, 1/s^2. back (k,), or 0: rates
    after impacts are at least -back. scale: of the friction's constant.
    """

    residual: Any
    c_m: float
    v_q: float
    a_q: float
    back: Any = 0.0
    scale: float = 1.0


class Steps:
    """Steps of one method on one model. S is factored again if h changes or Newton's method is slow."""

    def __init__(self, settings, model, counts):
        """Split the rows of a model by its laws; the first step factors."""
        self.settings, self.model, self.counts = settings, model, counts
        self.contacts = Contacts(model)
        self.base = self.contacts.base
        self.system = self.factored_for = self.shares = None
        self.columns = Columns(self.contacts)
        self.impulsive = settings.impulsive

    def restarted(self, state, v):
        """A new State at `state.t` from q and memory of `state` and the velocities v (n,), with consistent accelerations and forces.

        At a kink the State is at the next time behind it, and its v is that after the impact that the jump of the motors' rates causes.
        Elsewhere, at a sample of a controller, v are the velocities behind the sample.
        """
        contacts, t, q = self.contacts, state.t, state.q
        closed = np.asarray(state.memory["closed"], bool)
        if at_kink(self.model, t):
            before = contacts.rates(t, q, v)[contacts.rows]
            t = beside(t, 1.0)
            v = contacts.impact(t, q, v, before, closed, np.zeros(len(contacts.rows)), np.zeros(len(contacts.equations)), 0.0)[0]
        return contacts.with_forces(t, q, v, closed)

    def step(self, state, t, h):
        """The State after a step of h to t."""
        return (self._moreau if self.impulsive else self._alpha)(state, t, h)

    def _factor(self, h, step, *at):
        """Factor `S = c_m M + v_q C + K` of the equations for steps of h; at: t, q, v, a, lam."""
        self.system = self.system or self.base.step_matrix()
        self.system.factor(*at, step.c_m, step.v_q)
        self.counts.add(factors=1, system=self.system)
        self.factored_for = h, step.c_m, step.v_q
        self.tolerances = self.settings.newton_tolerance(step.a_q * h * h)
        self.columns.forget()

    def _newton(self, t, h, start, active, step, size):
        """The Unknowns with r = 0 and the laws at the rates of the end, p of all rows with laws, by the StepEquations. Raises StepFailure.

        It ends if the error left by a correction, |dq| k/(1 - k) with the contraction k, is below the tolerance of q'', or if dq is round-off; S
        is factored again after MANY iterations.

        start: the first guess, with a of the step's start. active: rows with laws that can carry a force. size: of the model, m.
        """
        contacts, model = self.contacts, self.model.facing(start.q)
        if self.shares is None or model.needs.mass_varies:
            self.shares = weights(model, start.q)
        group, still = contacts.group(active), contacts.still(start.v)
        q, v, a, lam, p = start._replace(p=start.p[group.rows])
        factored = self.factored_for == (h, step.c_m, step.v_q)
        last, count, contraction = 0.0, 0, 1.0  # |dq| of the iteration before, iterations with this factor
        for _ in range(self.settings.max_iterations):
            if not factored:
                self._factor(h, step, t, q, v, a, lam)
                factored, last, count = True, 0.0, 0
            if count > 2 and contraction > SLOW:
                self.columns.forget()
            r, rate = step.residual(model, q, v, a, contacts.all_multipliers(lam, p, group)), model.phi_rate(t, q, v)
            dq, dlam, p = self._correction(t, model, Unknowns(q, v, a, lam, p), step, group, r, rate, still)
            q, v, a, lam = q + dq, v + step.v_q * dq, a + step.a_q * dq, lam + dlam
            moved, count = self._norm(dq), count + 1
            if not np.isfinite(moved):
                why = "Newton's method diverges, take smaller steps" if last else "the residual is not finite"
                raise StepFailure("not finite", self.model.not_finite or why, t)
            contraction = moved / last if last else 1.0
            left = moved * contraction / (1.0 - contraction) if contraction < 1.0 else np.inf
            if moved <= EXACT * size or left <= self._allowed(start.a, a) / step.a_q:
                self.columns.served(count, len(group.rows))
                return Unknowns(q, v, a, lam, contacts.spread(group, p))
            factored, last = count < MANY, moved
        raise StepFailure("newton", f"Newton's method does not converge in {self.settings.max_iterations} iterations", t)

    def _correction(self, t, model, iterate, step, group, r, rate, still):
        """(dq, dlam, p of the active rows) of an iteration: the equations' correction, then the cone problem. Raises StepFailure."""
        contacts = self.contacts
        B = contacts.slopes(t, iterate.q, group.rows, model)
        try:
            dq, dlam = self.system.saddle(t, iterate.q, iterate.lam, r, rate[contacts.equations] / step.v_q)
            X, Y, G, new = self.columns.of(group.rows, B, self.system, t, iterate.q, iterate.lam)
        except SingularSystem as error:
            raise StepFailure("singular", str(error), t) from None
        self.counts.solves += new
        self.counts.add(residuals=1, iterations=1)
        if not len(B):
            return dq, dlam, iterate.p
        back = step.back[group.rows] / step.v_q if np.any(step.back) else 0.0
        now = rate[group.of_model] / step.v_q + back + B @ dq
        slip, held_below = contacts.signs_of_slip(group, rate, still), FIXED * contacts.mobility(B) / step.c_m
        problem = Problem(G, now - G @ iterate.p, iterate.p, iterate.lam + dlam - Y @ iterate.p, Y, held_below, slip)
        p, _ = contacts.solve(t, group, problem, step.scale)
        change = p - iterate.p
        return dq + X @ change, dlam + Y @ change, p

    def _allowed(self, a0, a):
        """The norm of a change of q'' that Newton's method may leave in a step from a0 to a."""
        least, most, share = self.tolerances
        size = max(self._norm(a0), self._norm(a))
        return min(max(least * size, share * self._norm(a - a0)), most * size)

    def _norm(self, x):
        """Mass-weighted norm of x (n,)."""
        return float(np.sqrt(self.shares @ (x * x)))

    def _alpha(self, state, t, h):
        """The State after a step of NonsmoothAlpha."""
        contacts, c, memory = self.contacts, self.settings.coefficients, state.memory
        size, closed = extent(self.model, state.q), np.asarray(memory["closed"], bool)
        # 1. generalized-alpha
        smooth = self._smooth_motion(state, t, h, closed, size)
        a = smooth.a
        a_alg = ((1.0 - c.alpha_f) * a + c.alpha_f * state.a - c.alpha_m * memory["a_alg"]) / (1.0 - c.alpha_m)
        # 2. positions
        q, touching = contacts.place(t, smooth.q, contacts.contact & (smooth.p > 0.0), size)
        # 3. velocities
        before, free = contacts.rates(state.t, state.q, state.v)[contacts.rows], contacts.rates(t, q, smooth.v)[contacts.rows]
        impact, rate, remaining = self._velocities(state, t, h, q, smooth, before, touching)
        impacts = _impacts(contacts, touching & ~closed, impact.impulses, free, rate, h * state.lam[contacts.rows])

        v, status = impact.v, impact.status
        mean_p = p = impact.impulses / h
        lam_of_all_rows = contacts.all_multipliers(smooth.lam + impact.change / h, mean_p)
        if (remaining != closed).any() or (status != memory.get("status", status))[~contacts.contact].any():
            a, _, p, _ = contacts.accelerations(t, q, v, remaining, mean_p, status=status)
            a_alg = a
        return self._accepted(t, q, v, a, lam_of_all_rows, {"a_alg": a_alg, "closed": remaining, "p": p, "status": status} | impacts)

    def _velocities(self, state, t, h, q, smooth, before, touching):
        """(ImpactResult, rates of the rows with laws after it, contacts that stay closed) at a step's end; once more where slip reverses.

        q: the position at the end. smooth: the Unknowns of the smooth motion. before: rates of the rows with laws at the step's start.
        """
        contacts = self.contacts
        impact = contacts.impact(t, q, smooth.v, before, touching, smooth.p, smooth.lam, h)
        rate, remaining = contacts.remaining(t, q, impact.v, touching, impact.status)
        wanted = contacts.reversals(state, t, q, impact.v, before, remaining, smooth.p)
        if wanted is not None:
            p, lam = impact.impulses / h, smooth.lam + impact.change / h
            impact = contacts.impact(t, q, impact.v, before, touching, p, lam, h, wanted)
            rate, remaining = contacts.remaining(t, q, impact.v, touching, impact.status)
        return impact, rate, remaining

    def _smooth_motion(self, state, t, h, closed, size):
        """The Unknowns of generalized-alpha at a step's end, with the rows that are closed at its start."""
        contacts, c, a_alg = self.contacts, self.settings.coefficients, state.memory["a_alg"]
        active, (a_q, v_q) = contacts.active(closed), c.rates(h)
        ahead = (state.a - c.alpha_m * a_alg) / (1.0 - c.alpha_m)  # a_alg at the end, for q'' = a_0
        q = state.q + h * state.v + h * h * ((0.5 - c.beta) * a_alg + c.beta * ahead)
        v = state.v + h * ((1.0 - c.gamma) * a_alg + c.gamma * ahead)
        start = Unknowns(q, v, state.a, state.lam[contacts.equations], np.where(active, state.memory["p"], 0.0))
        step = StepEquations(lambda model, *at: model.residual(t, *at), a_q, v_q, a_q)
        try:
            return self._newton(t, h, start, active, step, size)
        except StepFailure as failure:
            if failure.status not in ("contact", "newton") or not active.any():
                raise
        # friction has no force, as behind a point of Painleve's: contact acts by its impulse alone, to first order
        return self._newton(t, h, start._replace(p=np.zeros(len(active))), np.zeros(len(active), bool), step, size)

    def _moreau(self, state, t, h):
        """The State after a step of MoreauJean; _newton has the equation over h theta, so with lam and p over theta."""
        contacts, model, theta = self.contacts, self.model, self.settings.theta
        q0, v0, size = state.q, state.v, extent(model, state.q)
        force = model.force(state.t, q0, v0)
        before, v_q = model.phi_rate(state.t, q0, v0)[contacts.rows], 1.0 / (h * theta)
        closed = contacts.contact & (contacts.gaps(state.t, q0) + 0.5 * h * before <= TOUCH * size)
        active = contacts.active(closed)
        back = np.where(closed, contacts.restitution * np.minimum(before, 0.0), 0.0)

        def residual(model, q, v, a, lam):
            """r(t, q, v, a/theta, lam) + (1/theta - 1) force, (n,); force: that of the step's start."""
            return model.residual(t, q, v, a / theta, lam) + (1.0 / theta - 1.0) * force

        p = np.where(active, -state.lam[contacts.rows] / theta, 0.0)
        start = Unknowns(q0 + h * v0, v0, np.zeros(model.n), state.lam[contacts.equations] / theta, p)
        step = StepEquations(residual, v_q * v_q, v_q, v_q / h, back, 1.0 / theta)
        q, v, a, lam, p = self._newton(t, h, start, active, step, size)
        p, approaching = theta * p, closed & (before < -contacts.still(v0))
        after, last = model.phi_rate(t, q, v)[contacts.rows], h * state.lam[contacts.rows]
        impacts = _impacts(contacts, approaching, h * p, before, after, last)
        return self._accepted(t, q, v, a, contacts.all_multipliers(theta * lam, p), {"a_alg": a, "closed": closed, "p": p} | impacts)

    def _accepted(self, t, q, v, a, lam, memory):
        """The State of these values. Raises StepFailure if the model gives a reason to reject q at t."""
        if objection := self.model.rejection_reason(t, q):
            raise StepFailure("objection", objection, t)
        return State(t, q, v, a, lam, memory)


def _impacts(contacts, rows, P, before, after, last):
    """{"impacts": (k, 3)}: number of the law, impulse, and energy lost, of the contacts in `rows` that were hit with their friction; or {}.

    So are rows of friction elsewhere whose force jumped in that step.

    rows (k,): bool. P (k,), N s. before, after (k,): rates. last (k,): their lam of the step before, times h.
    """
    hit, lost = rows & (P > 0.0), -0.5 * P * (before + after)
    if not hit.any():
        return {}
    of_contact, pressing = contacts.on_laws[contacts.contact[contacts.on_laws[:, 1]]].T
    lost += np.bincount(pressing, lost[of_contact], len(lost))
    elsewhere = ~contacts.contact & (np.abs(P + last) > JUMPED * np.abs(last))
    elsewhere[of_contact[hit[pressing]]] = False
    listed = np.flatnonzero(hit | elsewhere)
    return {"impacts": np.stack([listed, np.abs(P[listed]), lost[listed]], axis=1)}
