"""What IDA is given in place of its residual and its linear system.

Its residual is `J^-1 F` (integrate/ida/step.py), which has the same zeros as F and the same Newton corrections: its own linear system is then
that of the identity, and its GMRES, without a preconditioner, is done after one product that hands the vector through. IDA tells cj
only with that product, after the residual; it is known before from what IDA predicts (`Predicted`). Should it be another, the next iteration
has the one that was told.

This solve as IDA's preconditioner would be told cj. It takes the same steps, but two calls more an iteration, of five arrays each, which the
binding wraps one by one: 1.15 times the time of a run on the pendulum, 1.19 where numba compiles its class, 1.0 to 1.1 on the car axis, Andrews'
mechanism, chains of bars and plates (`python studies/step_cost.py`).
"""

import math

import numpy as np

from polyida.errors import DONE, HALF_TURN, INVERTED, NO_MATRIX, NOT_FINITE, REASONS, SINGULAR, StepFailure
from polyida.integrate.ida.step import correction, equations, iterate
from polyida.integrate.ida.tables import table_of
from polyida.integrate.state import Counts
from polyida.jit import typed
from polyida.linear.lu import SingularSystem
from polyida.model.guarded import unguarded, writes
from polyida.system import MATRICES, RESIDUAL

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
    """IDA's callbacks around the table of a System (integrate/ida/forms.py).

    IDA itself would keep a factor while cj moves by up to 5/3. Here S is factored whenever cj has moved: with a stale cj
    Newton contracts at up to 0.5, needs up to 1.7 times the residuals, and on flexible bodies stops further from the
    solution; the factors saved are few.

    Rows are those of each iterate, where they vary: with those of the factor's state phi falls only as Newton contracts. Where phi is a row and
    not linear, what it bends by on the way is taken out too: one iteration closes it.
    """

    def __init__(self, system, counts, order, linear="auto", scaling="characteristic"):
        self.system, self.counts, self.predicted, self.cj = system, counts, Predicted(system.model.n, order), math.nan
        self.table, self.renews = table_of(system, linear, scaling)
        self.iterate = iterate(system, system.rows_vary and system.holds_phi and self.renews)
        self.equations, self.correction = typed(equations), typed(correction)
        model = unguarded(system.model)
        self.objects = writes(model, "rejection_reason") and not (model.is_scene and self.table.single)

    def begin(self, t, y):
        """IDA starts anew from y at t."""
        n = self.system.model.n
        self.predicted.begin(t, y[:n])
        self.table.hold_constant(t, y[:n].copy())
        self.tried = math.nan

    def accept(self, t, y):
        """IDA has taken a step, to y at t."""
        self.predicted.accept(t, y[: self.system.model.n])

    def residual(self, t, y, yp, z):
        """z = J^-1 F, nan where there is no inverse. False where F is not finite, or the model objects."""
        anew, system = self.due(t, y), self.system
        made = anew and not self.table.functions[RESIDUAL]  # of a scene, whose functions are compiled for its factor
        if made:
            self._make(t, y, yp)
        if not (self.objects and system.rejection_reason(t, y[: system.model.n].copy())) and self.evaluate(t, y, yp):
            self.correct(t, y, yp, anew, z, made)
            return True
        self.cj = math.nan if anew else self.cj
        return False

    def F(self, t, y, yp, res):
        """F(t, y, y') into res. False where it is not finite."""
        if not self.table.functions[RESIDUAL]:
            self.cj = 1.0
            self._make(t, y, yp)
        n, z, sound = self.system.model.n, self.iterate, self.evaluate(t, y, yp)
        res[:n], res[n : 2 * n], res[2 * n :] = z.first, z.r, z.closing.ravel()[: self.system.size - 2 * n]
        return sound

    def evaluate(self, t, y, yp):
        """Whether the equations could be evaluated."""
        table = self.table
        if not table.functions[RESIDUAL]:
            return False
        table.stand(self.system.clamp(t))
        ended = self.equations(table.functions, table.workspace, self.iterate, y, yp)
        return ended == DONE or self._told(ended, t)

    def _told(self, ended, t):
        """False, where a smaller step may help; else it raises."""
        self.table.raise_left()
        if ended in (NOT_FINITE, INVERTED, HALF_TURN):
            return False
        raise StepFailure(*REASONS[ended], t)

    def correct(self, t, y, yp, anew, z, made=False):
        """z = J^-1 F of what was evaluated, nan where there is no inverse; anew: with the matrices of here, which may be made."""
        counts, table, ended = self.counts, self.table, SINGULAR
        counts.tangents += anew
        counts.factorizations += anew
        counts.solves += 1
        if anew and not made and not table.functions[MATRICES]:
            self._make(t, y, yp)
        if not math.isnan(self.cj):
            fresh = anew or self.renews
            ended = self.correction(table.functions, table.workspace, self.iterate, self.cj, anew, fresh, z)
        if ended in (SINGULAR, NO_MATRIX) or (ended != DONE and not self._told(ended, t)):
            self.cj, z[:] = math.nan, math.nan

    def _make(self, t, y, yp):
        made = Counts()
        try:
            self.table.make(0, 1.0 / self.cj, np.concatenate([np.ravel(x) for x in self.system.at(t, y, yp)]), made)
        except SingularSystem:
            self.cj = math.nan
        self.counts.backend, self.counts.solves = made.backend, self.counts.solves + made.solves

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
        """The vector itself; cj is that of the next iteration."""
        result[:], self.expected = vector, cj if abs(cj - self.cj) > SAME_CJ * cj else self.expected
