"""IDA's equations and their Newton corrections, by the functions of a model's table: one compiled driver for every model.

IDA asks for `J d = -F`, J = dF/dy + cj dF/dy'. With y = (q, v, lam, mu), mu only if the form has it:

    |  cj I     -I               B^T |  |dq  |   |r1|     q' - v + B^T mu
    |  K      cj M + C   B^T         |  |dv  | = |r2|     M v' + g + B^T lam
    |  P         Q                   |  |dlam|   |rc|     the form's constraint rows c(t, q, v, v')
                                        |dmu |            P = c_q,  Q = c_v + cj c_a

The first row gives dv; the rest is

    |  S       B^T   D B^T | |dq  |   |r2 + D r1|     S = K + cj D,  D = cj M + C
    |  P + cj Q      Q B^T | |dlam| = |rc + Q r1|
                             |dmu |

the system of a real mode of Radau IIA with c = cj and D = 1 for mu (polyida.system), solved by the same entries of the tables.

IDA's residual is `J^-1 F`, which has the same zeros and Newton corrections as F. Its own linear system is then that of the identity, and its
GMRES ends after one product that returns the vector. IDA gives cj only with that product, after the residual; before, it is computed from
what IDA predicts (`Predicted`). If it was wrong, the next iteration has the right one.

With this solve as IDA's preconditioner, which is given cj, IDA takes the same steps, but makes two calls more in each iteration, of five arrays
each, which the binding wraps one by one: 1.15 times the time of a run on the pendulum, 1.19 if numba compiles its class, 1.0 to 1.1 on the car
axis, Andrews' mechanism, chains of bars and plates (`python studies/step_cost.py`).
"""

import math
from typing import NamedTuple

import numpy as np

from polyida.errors import DONE, HALF_TURN, INVERTED, NO_MATRIX, NOT_FINITE, REASONS, SINGULAR, StepFailure
from polyida.integrate.ida.forms import INSTANT
from polyida.integrate.ida.tables import table_of
from polyida.integrate.state import Counts
from polyida.jit import entry, pack, part, typed
from polyida.linear.dense import put
from polyida.linear.lu import SingularSystem
from polyida.model.functions import writes
from polyida.system import CONSTRAINTS, MATRICES, RESIDUAL
from polyida.system import instant as ask
from polyida.system.dense import finite

# constants of compiled code
INTEGRATED, BENDS = range(2)  # of Iterate.flags; BENDS: phi is a row and not linear
SLOT = 0  # of the matrices
MAX_ORDER = 5  # of a backward differentiation formula
CJ_H = np.cumsum(1 / np.arange(1, MAX_ORDER + 1)).tolist()  # cj h of each order, whatever the steps before
SHORTEST = float(np.finfo(float).tiny)  # s
SAME_CJ = 1e-3  # relative change of cj up to which the factor is kept
LARGEST_CJ = 1e60  # 1/s: there is no factor for a larger one, of a step within the round-off of t; its powers would overflow
LATE = 2  # iterations of one step after which the factor is made anew


@pack
class Iterate(NamedTuple):
    """An iterate of a form with k blocks of m constraint rows, and its correction.

    levels (k, 3): weights of phi, phi' and phi'' in each block; c (3,): cj as SELECT takes it; q, v, a, lam, mu: the iterate; first, r (n,),
    rows (2, m): F; velocity_rows: their numbers; phi, derivative (m,), vector, force (n,), rates (2, m): workspace; dq, multipliers (2, m): the correction.
    """

    levels: np.ndarray
    flags: np.ndarray
    velocity_rows: np.ndarray
    c: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    lam: np.ndarray
    mu: np.ndarray
    first: np.ndarray
    r: np.ndarray
    rows: np.ndarray
    phi: np.ndarray
    derivative: np.ndarray
    vector: np.ndarray
    force: np.ndarray
    rates: np.ndarray
    dq: np.ndarray
    multipliers: np.ndarray


@entry
def equations(functions, workspace, iterate, y, yp):
    """F at (y, y'). Returns a status."""
    model, velocity_rows = (functions, workspace), iterate.velocity_rows
    n, m, blocks = iterate.q.shape[0], iterate.lam.shape[0], iterate.levels.shape[0]
    multipliers = yp if iterate.flags[INTEGRATED] else y
    for i in range(n):
        iterate.q[i], iterate.v[i], iterate.a[i] = y[i], y[n + i], yp[n + i]
        iterate.first[i] = yp[i] - y[n + i]
    for k in range(m):
        iterate.lam[k] = multipliers[2 * n + k]
        iterate.mu[k] = multipliers[2 * n + m + k] if blocks == 2 else 0.0
    status = DONE
    if m and (has_order(iterate, 1) or has_order(iterate, 2)):
        status = ask.reaction(model, INSTANT, iterate.q, iterate.mu, iterate.first, 0)
    if status == DONE:
        status = ask.residual(model, INSTANT, iterate.q, iterate.v, iterate.a, iterate.lam, iterate.r, iterate.phi)
    for block in range(blocks):
        for k in range(m):
            iterate.rows[block, k] = iterate.levels[block, 0] * iterate.phi[k]
    if status == DONE and m and has_order(iterate, 1):
        status = ask.rate(model, INSTANT, iterate.q, iterate.v, iterate.derivative, 1)
        add_derivative(iterate, 1)
    if status == DONE and velocity_rows.shape[0] and blocks == 2:
        put(1.0, yp[:n], iterate.vector)
        status = ask.rate(model, INSTANT, iterate.q, iterate.vector, iterate.derivative, 0)
        for i in range(velocity_rows.shape[0]):
            iterate.rows[0, velocity_rows[i]] = iterate.derivative[velocity_rows[i]]
    if status == DONE and m and has_order(iterate, 2):
        status = ask.bias(model, INSTANT, iterate.q, iterate.v, iterate.a, iterate.derivative)
        add_derivative(iterate, 2)
    is_finite = finite(iterate.r) and finite(iterate.rows[0]) and finite(iterate.rows[1])
    return NOT_FINITE if status == DONE and not is_finite else status


@part
def has_order(iterate, order):
    """True if the derivative of phi of that order is in the rows."""
    return iterate.levels[0, order] != 0.0 or iterate.levels[iterate.levels.shape[0] - 1, order] != 0.0


@part
def add_derivative(iterate, order):
    """Add a derivative of phi to the rows."""
    for block in range(iterate.levels.shape[0]):
        for k in range(iterate.derivative.shape[0]):
            iterate.rows[block, k] += iterate.levels[block, order] * iterate.derivative[k]


@part
def renew_matrices(model, iterate, cj, anew, fresh):
    """Make or select the matrices of this iterate if `anew`, and compute its rows if `fresh`. Returns a status."""
    status, made = DONE, anew and ask.provides(model, MATRICES)
    if made:
        status = ask.matrices(model, INSTANT, iterate.q, iterate.v, iterate.a, iterate.lam, SLOT, None)
    if anew:
        iterate.c[0] = cj
        ask.select(model, SLOT, iterate.c)
    if status == DONE and fresh:
        known = 0 if made else 1  # matrices may be made with differences of phi_q, so that B is not that of the last residual
        status = ask.rows(model, INSTANT, iterate.q, iterate.v, iterate.a, known)
    return status


@part
def right_side(model, iterate, cj):
    """Make r and rows those of the system in (dq, dlam, dmu): the first block row of J is eliminated. Returns a status."""
    for i in range(iterate.q.shape[0]):
        iterate.vector[i] = cj * iterate.first[i]
    status = ask.inertia(model, INSTANT, iterate.first, iterate.vector, iterate.force, None, iterate.q, iterate.rates)
    for i in range(iterate.q.shape[0]):
        iterate.r[i] += iterate.force[i]
    for i in range(iterate.velocity_rows.shape[0] if iterate.levels.shape[0] == 2 else 0):
        iterate.rows[0, iterate.velocity_rows[i]] /= cj
    for block in range(iterate.levels.shape[0]):
        for k in range(iterate.lam.shape[0]):
            iterate.rows[block, k] += iterate.rates[block, k]
    return status


@part
def solve(model, iterate):
    """The correction from r and rows. Returns a status."""
    return ask.solve_real(model, INSTANT, iterate.r, iterate.rows, iterate.lam, iterate.dq, iterate.multipliers)


@part
def solve_again(model, iterate):
    """The correction that removes the curvature of phi over the present one too. Returns a status."""
    for i in range(iterate.q.shape[0]):
        iterate.vector[i] = iterate.q[i] + iterate.dq[i]
    status = ask.constraints(model, INSTANT, iterate.vector, None, None, iterate.derivative, iterate.phi)
    for k in range(iterate.lam.shape[0]):
        iterate.rows[0, k] += iterate.derivative[k]
    return solve(model, iterate) if status == DONE else status


@entry
def correction(functions, workspace, iterate, cj, anew, fresh, out):
    """out = J^-1 F behind `equations`; anew: with the matrices of this iterate; fresh: with its rows. Returns a status."""
    model, n, m = (functions, workspace), iterate.q.shape[0], iterate.lam.shape[0]
    tied = iterate.levels.shape[0] == 2
    status = renew_matrices(model, iterate, cj, anew, fresh)
    if status == DONE:
        status = right_side(model, iterate, cj)
    if status == DONE:
        status = solve(model, iterate)
    if status == DONE and iterate.flags[BENDS] and ask.provides(model, CONSTRAINTS):
        status = solve_again(model, iterate)
    if status != DONE:
        return status
    for i in range(n):
        out[i] = -iterate.dq[i]
        iterate.vector[i] = iterate.first[i] + cj * iterate.dq[i]
    if tied and m:
        status = ask.reaction(model, INSTANT, iterate.q, iterate.multipliers[1], iterate.vector, 1)
    for i in range(n):
        out[n + i] = -iterate.vector[i]
    for k in range(2 * m if tied else m):
        change = iterate.multipliers[k // m, k % m]
        out[2 * n + k] = -change / cj if iterate.flags[INTEGRATED] else -change
    return status


class Predicted:
    """The cj of the step that IDA is trying, which it does not give before it asks for the residual.

    A step of order k begins with the polynomial through the last k + 1 accepted states; the order is that of the nearest polynomial. Of each
    q (n,) one number is stored: its product with a random vector.
    """

    def __init__(self, n, max_order):
        self.vector, self.max_order = np.random.default_rng(0).uniform(0.5, 1.5, n), max_order
        self.times, self.differences = [], []

    def begin(self, t, q):
        """Start from a state: IDA begins with order 1."""
        self.times, self.differences = [t], [float(self.vector @ q)]

    def accept(self, t, q):
        """Take the end of a step, unless the step is within the round-off of t."""
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

    cj: of the factor in use; NaN: there is none, or it must be made anew. expected: cj of the next correction. tried: t of the present attempt;
    iterations: its iterations so far. A factor is made in `residual` before the functions are compiled (`factored`), in `correct` by Python, or
    in `correction` by the table's MATRICES.
    """

    def __init__(self, system, counts, order, linear="auto", scaling="characteristic"):
        self.system, self.counts, self.predicted, self.cj = system, counts, Predicted(system.model.n, order), math.nan
        self.predicted.vector[system.model.hidden] = 0.0
        self.table, self.renews = table_of(system, linear, scaling)
        self.keeps_rows = system.rows_vary and not self.renews
        n, m, bends = system.model.n, system.model.m, system.rows_vary and system.holds_phi and self.renews
        shapes = (3,), (n,), (n,), (n,), (m,), (m,), (n,), (n,), (2, m), (m,), (m,), (n,), (n,), (2, m), (n,), (2, m)
        flags = np.array([system.form.integrated, bends], np.int64)
        self.iterate = Iterate(system.levels, flags, system.model.velocity_rows, *map(np.zeros, shapes))
        self.equations, self.correction = typed(equations), typed(correction)
        model = system.model
        self.objects = writes(model, "rejection_reason") and not (model.is_scene and self.table.single)

    def begin(self, t, y):
        """IDA starts anew from y at t."""
        n = self.system.model.n
        self.predicted.begin(t, y[:n])
        self.table.evaluate_constants(t, y[:n].copy())
        self.tried = math.nan

    def accept(self, t, y):
        """IDA has taken a step, to y at t."""
        self.predicted.accept(t, y[: self.system.model.n])

    def residual(self, t, y, yp, z):
        """z = J^-1 F, NaN if there is no inverse. False if F is not finite or the model rejects the state."""
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
        """F(t, y, y') into res. False if it is not finite."""
        if not self.table.functions[RESIDUAL]:
            self.cj = 1.0
            self._factor(t, y, yp)
        n, z, finite = self.system.model.n, self.iterate, self.evaluate(t, y, yp)
        res[:n], res[n : 2 * n], res[2 * n :] = z.first, z.r, z.rows.ravel()[: self.system.size - 2 * n]
        return finite

    def evaluate(self, t, y, yp):
        """True if F could be evaluated."""
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
        """z = J^-1 F behind `evaluate`, NaN if there is no inverse; anew: with the matrices of this iterate, which may be factored."""
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
        """The vector itself; cj is that of the next iteration."""
        result[:], self.expected = vector, cj if abs(cj - self.cj) > SAME_CJ * cj else self.expected
