"""IDA's Newton correction: one n x n factor and a small border solve its whole iteration matrix exactly.

IDA asks for `J d = -F`, J = dF/dy + cj dF/dy'. With y = (q, v, lam, mu) and mu only where the form has it:

    |  cj I     -I               B^T |  |dq  |   |r1|     q' - v + B^T mu
    |  K      cj M + C   B^T         |  |dv  | = |r2|     M v' + g + B^T lam
    |  P         Q                   |  |dlam|   |rc|     the form's constraint rows c(t, q, v, v')
                                        |dmu |            P = c_q,  Q = c_v + cj c_a

The first row gives dv; what remains is `S = K + cj C + cj^2 M` bordered by as many rows as there are multipliers.

What IDA is given as its residual is `J^-1 F`, which has the same zeros and the same Newton corrections: its own linear system is then
that of the identity, and its GMRES, without a preconditioner, is done after one product that hands the vector through. IDA tells cj
only with that product, after the residual; it is known before from what IDA predicts (`Predicted`). Should it be another, the product
is the true one, `J(expected)^-1 J(cj) = 1 + (cj - expected) J(expected)^-1 dF/dy'`.

This solve as IDA's preconditioner would be told cj. It takes the same steps, but two calls more an iteration, of five arrays each, which the
binding wraps one by one: 1.1 times the time of a run on the pendulum, 1.17 where numba compiles its class, 1.05 to 1.07 on the car axis, 1.04
or less on Andrews' mechanism, chains of bars and plates (`python studies/step_cost.py`).
"""

import math
from contextlib import suppress

import numpy as np

from polyida.linear.lu import SingularSystem
from polyida.linear.step_matrix import MANY, Border, StepMatrix

MOST = 5  # order of a backward differentiation formula, at most
LEADS = np.cumsum(1 / np.arange(1, MOST + 1)).tolist()  # cj h of the orders, whatever the steps before
SHORTEST = float(np.finfo(float).tiny)  # s
SAME_CJ = 1e-3  # relative change of cj below which the factor serves on
STEEPEST = 1e60  # 1/s: cj above it, of a step that is lost in the round-off of t, has no factor: its powers would overflow
LATE = 2  # iterations of one step after which the factor is made anew where it is


class Predicted:
    """The order of the step that IDA is trying, and its cj. IDA does not give them before it asks for the residual.

    In a step of order k IDA begins with the polynomial through the last k + 1 accepted states. Of each q (n,) one number is kept: its product
    with a vector of no direction in particular.
    """

    def __init__(self, n, most):
        self.vector, self.most = np.random.default_rng(0).uniform(0.5, 1.5, n), most
        self.times, self.differences = [], []

    def begin(self, t, q):
        """Nothing but the state at t is known: IDA starts with order 1."""
        self.times, self.differences = [t], [float(self.vector @ q)]

    def accept(self, t, q):
        """A step ended with q at t; one that is lost in the round-off of t tells nothing."""
        if t == self.times[0]:
            return
        times, differences = [t, *self.times[: self.most]], [float(self.vector @ q)]
        for earlier, before in zip(times[1:], self.differences):
            differences.append((differences[-1] - before) / (t - earlier))
        self.times, self.differences = times, differences

    def order(self, t, q):
        """The order whose prediction for t is nearest to q."""
        seen, value, product, found, nearest = float(self.vector @ q), self.differences[0], 1.0, 1, np.inf
        for k in range(1, len(self.times)):
            product *= t - self.times[k - 1]
            value += product * self.differences[k]
            if abs(value - seen) < nearest:
                found, nearest = k, abs(value - seen)
        return found

    def cj(self, t, q):
        """The cj of a step to t."""
        return LEADS[self.order(t, q) - 1] / max(t - self.times[0], SHORTEST)


class Correction:
    """IDA's callbacks around a solve with the whole iteration matrix: `setup` factors at a cj, `reduced` solves.

    IDA itself would keep a factor while cj moves by up to 5/3. Here S is factored whenever cj has moved: with a stale cj
    Newton contracts at up to 0.5, needs up to 1.7 times the residuals, and on flexible bodies stops further from the
    solution; the factors saved are few.
    """

    def __init__(self, system, counts, order):
        self.system, self.counts, self.predicted = system, counts, Predicted(system.model.n, order)
        self.cj, self.right = math.nan, np.empty(system.size)

    def begin(self, t, y):
        """IDA starts anew from y at t."""
        self.predicted.begin(t, y[: self.system.model.n])
        self.tried = math.nan

    def accept(self, t, y):
        """IDA has taken a step, to y at t."""
        self.predicted.accept(t, y[: self.system.model.n])

    def residual(self, t, y, yp, z):
        """z = J^-1 F, nan where there is no inverse. False where F is not finite."""
        self.system.residual(t, y, yp, self.right)
        if not (math.isfinite(self.right.dot(self.right)) or np.isfinite(self.right).all()):
            return False
        self.correct(t, y, yp, self.right, z)
        return True

    def correct(self, t, y, yp, r, z):
        """z = J^-1 r at the cj that is expected; nan where there is no inverse."""
        if self.due(t, y):
            self.setup(t, y, yp, self.cj)
        self._solve(t, y, yp, r, z)

    def due(self, t, y):
        """Count an iteration at the cj that is expected. Whether a factor is to be made; there is none where cj is nan."""
        if t != self.tried:
            self.tried, self.iterations, self.expected = t, 0, self.predicted.cj(t, y[: self.system.model.n])
        anew = not abs(self.expected - self.cj) <= SAME_CJ * self.expected or self.iterations == LATE
        if anew:
            self.cj = self.expected if self.expected < STEEPEST else math.nan
        self.iterations += 1
        self.counts.newton_iterations += 1
        return anew and not math.isnan(self.cj)

    def product(self, t, y, yp, res, vector, result, cj):
        """J(expected)^-1 J(cj) vector: the vector itself where the expected cj is that."""
        result[:] = vector
        if abs(cj - self.cj) > SAME_CJ * cj:
            self.expected, change = cj, np.empty(len(vector))
            self._solve(t, y, yp, self.system.along_rates(t, y, yp, vector), change)
            result += (cj - self.cj) * change

    def _solve(self, t, y, yp, r, z):
        self.counts.solves += 1
        try:
            if math.isnan(self.cj):
                raise SingularSystem("there is no factor")
            self.reduced(t, y, yp, r, z)
        except SingularSystem:
            z[:] = math.nan


class ReducedSolve(Correction):
    """The correction of `system` (integrate/ida/forms.py) for any model: its step matrix with a border."""

    def __init__(self, system, counts, order):
        super().__init__(system, counts, order)
        self.step = StepMatrix(system.model)

    def setup(self, t, y, yp, cj):
        """Factor S at (t, y, y')."""
        self.cj, self.D, self.border = cj, self.system.slope(t, y, yp, cj), None
        self.counts.tangents += 1
        self.counts.factorizations += 1
        with suppress(SingularSystem):  # then it has no solve
            self.step.factor(*self.system.at(t, y, yp), cj * cj, cj)

    def reduced(self, t, y, yp, r, z):
        """z = J^-1 r, constraint rows and columns those of (t, y, y'): with those of the factor's state phi falls only as Newton contracts.

        Where phi is a row and not linear, what it bends by on the way to q - dq is taken out too: one iteration closes it.
        """
        system, model = self.system, self.system.model
        n, m, vary, q, r1 = model.n, model.m, system.rows_vary, y[: model.n].copy(), r[: model.n]
        if self.border is None or (vary and m <= MANY):
            self._make_border(t, y, yp, q)
        free, below = self.step.solve(q, r[n : 2 * n] + self.D @ r1), r[2 * n :] + self.Q @ r1
        dq, w = self.border.solve(free, self.rows, below, self.corner)
        if vary and system.holds_phi:
            at = system.clamp(t)
            below[:m] += model.phi(at, q - dq) - model.phi(at, q) + r[2 * n : 2 * n + m]
            dq, w = self.border.solve(free, self.rows, below, self.corner)
        z[:n], z[n : 2 * n], z[2 * n :] = dq, self.cj * dq - r1, w / self.cj if system.form.integrated else w
        if system.form.stabilised:
            z[n : 2 * n] += self.B.T @ w[m:]

    def _make_border(self, t, y, yp, q):
        """Rows, columns and corner of (t, y, y') on the factor at hand: B^T for lam, D B^T for mu."""
        self.B, P, self.Q = self.system.rows(t, y, yp, self.cj)
        self.rows, columns = P + self.cj * self.Q, self.B.T
        self.corner = np.zeros((len(P), len(P)))
        if self.system.form.stabilised:
            self.corner[:, self.system.model.m :] = self.Q @ columns
            columns = np.hstack([columns, self.D @ columns])
        self.border = Border(self.step.solve(q, columns))
