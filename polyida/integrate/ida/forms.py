"""The forms in which IDA solves a model: the constraint rows beside the equations of motion, and the unknowns.

Unknowns y = (q, v, multipliers); equations

    q' - v + B^T mu = 0,   M v' + g + B^T lam = 0,   c(t, q, v, v') = 0,   B = phi_q

| form | c | mu | multipliers |
|---|---|---|---|
| ggl2 | phi and phi' | yes | lam, mu |
| ggl1 | phi and phi' | yes | their integrals: lam = L', mu = N' |
| index2 | phi' | no | lam |
| index1 | phi'' | no | lam |
| baumgarte | phi'' + 2 w phi' + w^2 phi | no | lam |
| index3 | phi | no | lam |

Sources: Gear, Gupta, Leimkuhler 1985 (ggl2); Gear 1988 and Anantharaman, Hiller 1991 (ggl1); Baumgarte 1972.
"""

from dataclasses import dataclass, replace

import numpy as np

from polyida.integrate.state import State
from polyida.linear.lu import dense
from polyida.model.differences import along, reach_along

# constants of compiled code
NEAR = np.finfo(float).eps ** (1 / 3)  # of phi_q's slopes, which only Newton sees: two values are enough
UNTESTED = 1e9  # absolute tolerance of what carries no error estimate, as multipliers: far above any size of theirs


@dataclass(frozen=True)
class Form:
    """Data of a form. `rows`: which derivatives of phi are constraint rows; `combined`: as one, Baumgarte's sum."""

    rows: tuple
    stabilised: bool = False
    integrated: bool = False
    combined: bool = False


FORMS = {
    "ggl2": Form((0, 1), stabilised=True),
    "ggl1": Form((0, 1), stabilised=True, integrated=True),
    "index2": Form((1,)),
    "index1": Form((2,)),
    "baumgarte": Form((0, 1, 2), combined=True),
    "index3": Form((0,)),
}


@dataclass(frozen=True)
class Blocks:
    """Blocks of the iteration matrix at one state: M, C (or None), B (m, n) and the rows P + cj Q0 + cj^2 Q1 on dq."""

    M: np.ndarray
    C: np.ndarray
    B: np.ndarray
    P: np.ndarray
    Q0: np.ndarray
    Q1: np.ndarray
    stabilised: bool
    integrated: bool

    @property
    def border(self):
        """Whether there are constraints at all."""
        return self.B.shape[0] > 0

    @property
    def n(self):
        return self.B.shape[1]

    @property
    def m(self):
        return self.B.shape[0]

    def rows(self, cj):
        """(rows on dq, rows on dv) at this cj, the first with dv = cj dq already in."""
        velocity = self.Q0 + cj * self.Q1
        return self.P + cj * velocity, velocity

    def columns(self, cj):
        """The border's columns: B^T for lam and, where there is mu, (cj M + C) B^T, side by side."""
        lam = self.B.T
        return np.hstack([lam, self.damping_product(cj, lam)]) if self.stabilised else lam

    def damping_product(self, cj, x):
        """(cj M + C) x."""
        product = cj * (self.M @ x)
        return product if self.C is None else product + self.C @ x


class System:
    """A model in one form: IDA's residual F(t, y, y'), its blocks, and the way from a State to (y, y') and back.

    `limits`: t is held to this range, so that at a kink a smooth piece sees its own side. `rate`: w of Baumgarte.
    """

    def __init__(self, model, form, rate):
        self.model, self.form, self.rate = model, FORMS[form], rate
        self.limits = (-np.inf, np.inf)
        self._seen = np.nan, np.zeros(0), None
        self.size = 2 * model.n + (2 if self.form.stabilised else 1) * model.m

    def split(self, y, yp):
        """q, v, a, lam, mu (None without) as views of y and y'."""
        n, m = self.model.n, self.model.m
        multipliers = (yp if self.form.integrated else y)[2 * n :]
        return y[:n], y[n : 2 * n], yp[n : 2 * n], multipliers[:m], multipliers[m:] if self.form.stabilised else None

    def pack(self, state):
        """(y, y') at a consistent State."""
        n, m = self.model.n, self.model.m
        y, yp = np.zeros(self.size), np.zeros(self.size)
        y[:n], y[n : 2 * n], yp[:n], yp[n : 2 * n] = state.q, state.v, state.v, state.a
        (yp if self.form.integrated else y)[2 * n : 2 * n + m] = state.lam
        return y, yp

    def state(self, t, y, yp):
        """The State at (t, y, y'); mu, zero but for truncation, is kept in its memory."""
        q, v, a, lam, mu = self.split(y, yp)
        return State(t, q, v, a, lam, {} if mu is None else {"mu": mu})

    def tolerances(self, atol_q, atol_v):
        """Absolute tolerances of y, (size,), from those of q and v."""
        n, atol = self.model.n, np.empty(self.size)
        atol[:n], atol[n : 2 * n], atol[2 * n :] = atol_q, atol_v, UNTESTED
        return atol

    def residual(self, t, y, yp, res):
        """IDA's F(t, y, y') into `res`; nan, IDA's sign to try a smaller step, where the model objects."""
        n, model, t = self.model.n, self.model, self.clamp(t)
        q, v, a, lam, mu = self.split(y.copy(), yp.copy())
        if self.objection(t, q):
            res[:] = np.nan
            return
        np.subtract(yp[:n], v, out=res[:n])
        res[n : 2 * n] = model.residual(t, q, v, a, lam)
        if model.m:
            B = None if self.form.rows == (0,) else self.phi_q(t, q)
            res[2 * n :] = self.constraint_rows(t, q, v, a, B)
            if mu is not None:
                res[:n] += B.T @ mu

    def along_rates(self, t, y, yp, x):
        """dF/dy' x at (t, y, y'), x (size,)."""
        n, m, model, t = self.model.n, self.model.m, self.model, self.clamp(t)
        q, product = y[:n].copy(), np.zeros(self.size)
        product[:n], product[n : 2 * n] = x[:n], model.mass(q) @ x[n : 2 * n]
        B = self.phi_q(t, q) if m and (self.form.integrated or 2 in self.form.rows) else None
        if B is not None and self.form.integrated:
            product[n : 2 * n] += B.T @ x[2 * n : 2 * n + m]
            product[:n] += B.T @ x[2 * n + m :]
        if B is not None and 2 in self.form.rows:
            product[2 * n :] = B @ x[n : 2 * n]
        return product

    def phi_q(self, t, q):
        """The model's; made once for a residual and the solve that follows it."""
        at, where, B = self._seen
        if t != at or not np.array_equal(q, where):
            B = self.model.phi_q(t, q)
            self._seen = t, q.copy(), B
        return B

    def objection(self, t, q):
        """Why the model cannot stand at an accepted (t, q), or None."""
        return self.model.objection(self.clamp(t), q)

    @property
    def holds_phi(self):
        """Whether phi itself is a row."""
        return 0 in self.form.rows and not self.form.combined

    def opened(self, state, allowed):
        """What has drifted from phi = 0 by more than `allowed`, in q, at a State, or None; of a form that holds phi nothing has."""
        if not self.model.m or self.holds_phi:
            return None
        t, model = self.clamp(state.t), self.model
        apart = np.abs(model.phi(t, state.q)) / np.linalg.norm(dense(model.phi_q(t, state.q)), axis=1)
        worst = int(apart.argmax())
        return None if apart[worst] <= allowed else f"{model.constraint_name(worst)} has drifted apart by {apart[worst]:.2g}"

    def clamp(self, t):
        """t held to `limits`."""
        return min(max(t, self.limits[0]), self.limits[1])

    def constraint_rows(self, t, q, v, a, B):
        """c(t, q, v, a), one block of m rows after the other."""
        model = self.model
        values = {0: lambda: model.phi(t, q), 1: lambda: B @ v + model.phi_t(t, q), 2: lambda: B @ a + model.phi_bias(t, q, v)}
        rows = [values[order]() for order in self.form.rows]
        return self._sum(rows) if self.form.combined else np.concatenate(rows)

    def _sum(self, rows):
        position, velocity, acceleration = rows
        return acceleration + 2 * self.rate * velocity + self.rate**2 * position

    def at(self, t, y, yp):
        """(t, q, v, a, lam) for the model."""
        return self.clamp(t), *self.split(y.copy(), yp.copy())[:4]

    def blocks(self, t, y, yp):
        """The Blocks at (t, y, y')."""
        model, (t, q, v, a, _) = self.model, self.at(t, y, yp)
        C = model.force_v(t, q, v) if model.needs.velocity_forces else None
        return Blocks(model.mass(q), C, *self._rows(t, q, v, a), self.form.stabilised, self.form.integrated)

    @property
    def rows_vary(self):
        """Whether phi_q does, in rows of phi and its first derivative; those of the second cost too much to be made anew."""
        needs = self.model.needs
        return self.model.m > 0 and (needs.driven or needs.phi_q_varies) and max(self.form.rows) < 2

    def with_rows_at(self, blocks, t, y, yp):
        """The Blocks with the constraint rows of (t, y, y')."""
        B, P, Q0, Q1 = self._rows(*self.at(t, y, yp)[:4])
        return replace(blocks, B=B, P=P, Q0=Q0, Q1=Q1)

    def _rows(self, t, q, v, a):
        """B and the form's rows (P, Q0, Q1)."""
        B = dense(self.phi_q(t, q))
        triples = [self._derivatives(order, t, q, v, a, B) for order in self.form.rows]
        return B, *(self._sum(rows) if self.form.combined else np.vstack(rows) for rows in zip(*triples))

    def _derivatives(self, order, t, q, v, a, B):
        """(c_q, c_v, c_a) of one derivative of phi; d(phi_q v)/dq is phi_q's slope along v, by symmetry."""
        zero = np.zeros_like(B)
        if order == 0:
            return B, zero, zero
        slope = self._phi_q_along(1.0, v, t, q)
        if order == 1:
            return slope, B, zero
        reach = reach_along(q, v)
        curvature = along(lambda s: self._phi_q_along(1.0, v, t + s, q + s * v), reach) if slope.any() else zero
        return curvature + self._phi_q_along(0.0, a, t, q), 2 * slope, B

    def _phi_q_along(self, time, direction, t, q):
        """d/ds phi_q(t + s time, q + s direction) at s = 0, (m, n)."""
        needs = self.model.needs
        if not (needs.phi_q_varies or (needs.driven and time)):
            return np.zeros((self.model.m, self.model.n))
        step = NEAR * reach_along(q, direction)
        ahead, behind = (dense(self.model.phi_q(t + s * time, q + s * direction)) for s in (step, -step))
        return (ahead - behind) / (2 * step)
