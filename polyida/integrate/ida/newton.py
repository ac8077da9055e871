"""The callbacks of IDA for a System: its residual `J^-1 F` and the factors that it needs (ida/equations.py computes both).

IDA's residual is `J^-1 F`, which has the same zeros and Newton corrections as F. Its own linear system is then that of the identity, and its
GMRES ends after one product that returns the vector. IDA gives cj only with that product, after the residual; before, it is computed from
what IDA predicts (`Predicted`). If it was wrong, the next iteration has the right one.

With this solve as IDA's preconditioner, which is given cj, IDA takes the same steps, but makes two calls more in each iteration, of five arrays
each, which the binding wraps one by one: 1.15 times the time of a run on the pendulum, 1.19 if numba compiles its class, 1.0 to 1.1 on the car
axis, Andrews' mechanism, chains of bars and plates (`python studies/step_cost.py`).
"""

import math

import numpy as np

from polyida.errors import DONE, HALF_TURN, INVERTED, NO_MATRIX, NOT_FINITE, REASONS, SINGULAR, StepFailure
from polyida.integrate.ida.equations import Iterate, correction, equations
from polyida.integrate.ida.tables import table_of
from polyida.integrate.state import Counts
from polyida.jit import typed
from polyida.linear.lu import SingularSystem
from polyida.model.functions import writes
from polyida.system import MATRICES, RESIDUAL

MAX_ORDER = 5  # of a backward differentiation formula
CJ_H = np.cumsum(1 / np.arange(1, MAX_ORDER + 1)).tolist()  # cj h of each order, whatever the steps before
SHORTEST = float(np.finfo(float).tiny)  # s
SAME_CJ = 1e-3  # relative change of cj up to which the factor is kept
LARGEST_CJ = 1e60  # 1/s: there is no factor for a larger one, of a step within the round-off of t; its powers would overflow
LATE = 2  # iterations of one step after which the factor is made anew


class Predicted:
    """The cj of the step that IDA is trying, which it does not give before it asks for the residual.

    A step of order k begins with the polynomial through the last k + 1 accepted states; the order is that of the nearest polynomial. Of each
    q (n,) one number is stored: its product with a random vector.
    """

    def __init__(self, n, max_order):
        """Draw the random vector (n,), and begin without states; max_order: largest order that IDA uses."""
        self.vector, self.max_order = np.random.default_rng(0).uniform(0.5, 1.5, n), max_order
        self.times, self.differences = [], []

    def begin(self, t, q):
        """Start from a state: IDA begins with order 1."""
        self.times, self.differences = [t], [float(self.vector @ q)]

    def accept(self, t, q):
        """Add the accepted state at t to the divided differences of vector @ q, from which `cj` guesses the next step's order.

        Nothing if t is still the last time (a step below round-off).
        """
        if t == self.times[0]:
            return
        times, differences = [t, *self.times[: self.max_order]], [float(self.vector @ q)]
        for earlier, before in zip(times[1:], self.differences):
            differences.append((differences[-1] - before) / (t - earlier))
        self.times, self.differences = times, differences

    def cj(self, t, q):
        """The cj of a step to t that begins with q."""
        begin, value, product, order, nearest = float(self.vector @ q), self.differences[0], 1.0, 1, np.inf
        for k in range(1, len(self.times)):
            product *= t - self.times[k - 1]
            value += product * self.differences[k]
            if abs(value - begin) < nearest:
                order, nearest = k, abs(value - begin)
        return CJ_H[order - 1] / max(t - self.times[0], SHORTEST)


class Correction:
    """IDA's callbacks for a System.

    IDA itself would keep a factor while cj changes by up to 5/3. Here S is factored whenever cj has changed: with an old cj Newton's method
    contracts at up to 0.5, needs up to 1.7 times the residuals, and on flexible bodies ends farther from the solution; few factors would be
    saved.

    Rows that vary are those of each iterate: with those of the factor's state phi falls only as Newton contracts. If phi is a row and not
    linear, its curvature over the correction is removed too, so that one iteration satisfies it. Tables that keep the rows of the factor make
    it anew in each step: Newton's method ends by the errors of q and v, and old rows leave an error in the multipliers, which IDA's
    prediction of the next step enlarges up to 2^order times.

    A factor is made in `residual` before the functions are compiled (`factored`), in `correct` by Python, or
    in `correction` by the table's MATRICES.
    """

    def __init__(self, system, counts, order, linear="auto", scaling="characteristic"):
        """Make the model's table, the prediction of cj, and an iterate without a factor.

        order: the largest one that IDA may use, for that prediction; counts: Counts of work; linear, scaling: settings of IDA.
        """
        model, n, m = system.model, system.model.n, system.model.m
        self.system, self.counts = system, counts
        self.predicted = Predicted(n, order)
        self.predicted.vector[model.hidden] = 0.0
        self.table, self.renews = table_of(system, linear, scaling)
        self.keeps_rows = system.rows_vary and not self.renews
        self.objects = writes(model, "rejection_reason") and not (model.is_scene and self.table.single)
        self.equations, self.correction = typed(equations), typed(correction)
        self.cj = math.nan  # of the factor in use; NaN: there is none, or it must be made anew
        self.expected = math.nan  # cj of the next correction
        self.tried = math.nan  # t of the present attempt
        self.iterations = 0  # of it so far
        self.iterate = Iterate(
            levels=system.levels,
            flags=np.array([system.form.integrated, system.rows_vary and system.holds_phi and self.renews], np.int64),
            velocity_rows=model.velocity_rows,
            c=np.zeros(3),
            q=np.zeros(n),
            v=np.zeros(n),
            a=np.zeros(n),
            lam=np.zeros(m),
            mu=np.zeros(m),
            first=np.zeros(n),
            r=np.zeros(n),
            rows=np.zeros((2, m)),
            phi=np.zeros(m),
            derivative=np.zeros(m),
            vector=np.zeros(n),
            force=np.zeros(n),
            rates=np.zeros((2, m)),
            dq=np.zeros(n),
            multipliers=np.zeros((2, m)),
        )

    def begin(self, t, y):
        """Forget earlier steps: IDA starts anew from y at t."""
        n = self.system.model.n
        self.predicted.begin(t, y[:n])
        self.table.evaluate_constants(t, y[:n].copy())
        self.tried = math.nan

    def accept(self, t, y):
        """IDA has taken a step, to y at t."""
        self.predicted.accept(t, y[: self.system.model.n])

    def residual(self, t, y, yp, z):
        """Fill z with J^-1 F, or NaN if there is no inverse. False if F is not finite or the model rejects the state."""
        anew, system = self.count_iteration(t, y), self.system
        factored = anew and not self.table.functions[RESIDUAL]  # a scene's functions are compiled for the type of its factor
        if factored:
            self._factor(t, y, yp)
        if not (self.objects and system.rejection_reason(t, y[: system.model.n].copy())) and self.evaluate(t, y, yp):
            self.correct(t, y, yp, anew, z, factored)
            return True
        self.cj = math.nan if anew else self.cj
        return False

    def F(self, t, y, yp, res):
        """Write F(t, y, y') to res. False if it is not finite."""
        if not self.table.functions[RESIDUAL]:
            self.cj = 1.0
            self._factor(t, y, yp)
        n, z, finite = self.system.model.n, self.iterate, self.evaluate(t, y, yp)
        res[:n], res[n : 2 * n], res[2 * n :] = z.first, z.r, z.rows.ravel()[: self.system.size - 2 * n]
        return finite

    def evaluate(self, t, y, yp):
        """Evaluate F at (t, y, y') in the iterate. False if a smaller step may help; raises for other failures."""
        table = self.table
        if not table.functions[RESIDUAL]:
            return False
        table.stand(self.system.clamp(t))
        ended = self.equations(table.functions, table.workspace, self.iterate, y, yp)
        if ended == DONE:
            return True
        self._raise_unless_recoverable(ended, t)
        return False

    def _raise_unless_recoverable(self, ended, t):
        """Return if a smaller step may help; otherwise raise."""
        self.table.raise_error()
        if ended not in (NOT_FINITE, INVERTED, HALF_TURN):
            raise StepFailure(*REASONS[ended], t)

    def correct(self, t, y, yp, anew, z, factored=False):
        """Fill z with J^-1 F behind `evaluate`, or NaN if there is no inverse; anew: with the matrices of this iterate, which may be factored."""
        table, ended = self.table, SINGULAR
        if anew:
            self.counts.add(factors=1)
        self.counts.solves += 1
        if anew and not factored and not table.functions[MATRICES]:
            self._factor(t, y, yp)
        if not math.isnan(self.cj):
            fresh = anew or self.renews
            ended = self.correction(table.functions, table.workspace, self.iterate, self.cj, anew, fresh, z)
        if ended not in (DONE, SINGULAR, NO_MATRIX):
            self._raise_unless_recoverable(ended, t)
        if ended != DONE:
            self.cj, z[:] = math.nan, math.nan

    def _factor(self, t, y, yp):
        """Factor the matrices at (t, y, y') for cj by the table in Python; cj becomes NaN if they are singular."""
        work = Counts()  # without the tangents and factorizations, which `correct` counts
        try:
            self.table.make(0, 1.0 / self.cj, np.concatenate([np.ravel(x) for x in self.system.at(t, y, yp)]), work)
        except SingularSystem:
            self.cj = math.nan
        self.counts.add(system=work)

    def count_iteration(self, t, y):
        """Count an iteration at the cj that is expected. True if a factor is to be made; no factor is possible if cj is NaN."""
        if t != self.tried:
            self.tried, self.iterations, self.expected = t, 0, self.predicted.cj(t, y[: self.system.model.n])
        old_rows = self.iterations == 0 and self.keeps_rows
        anew = not abs(self.expected - self.cj) <= SAME_CJ * self.expected or self.iterations == LATE or old_rows
        if anew:
            self.cj = self.expected if self.expected < LARGEST_CJ else math.nan
        self.iterations += 1
        self.counts.newton_iterations += 1
        return anew and not math.isnan(self.cj)

    def product(self, t, y, yp, res, vector, result, cj):
        """The product of the preconditioned system, the identity: result = vector. IDA gives cj here, which the next iteration then has."""
        result[:] = vector
        if abs(cj - self.cj) > SAME_CJ * cj:
            self.expected = cj
