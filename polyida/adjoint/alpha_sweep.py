"""The compiled backward sweep over steps of generalized-alpha.

It is the adjoint of each step's own equations. Step n solves `r(q, v, a, lam) = 0`, `phi(q) = 0`, the recursion of the algorithmic
acceleration A and Newmark's formulas, with multipliers w, mu, x, y and z. The step behind it sends P_q, P_v, P_a and P_A, the adjoints of
the state that it begins from; j are the objective's own slopes:

    [[S^T, B^T], [B, 0]] (w, mu) = (-(P_q + j_q) - gamma' (P_v + j_v) - beta' (P_a + j_a) - P_A/(beta h^2), -j_lam)
    y = -(P_q + j_q) - K^T w - B^T mu        z = -(P_v + j_v) - C^T w        x = (h^2 beta y + h gamma z - P_A)/(1 - alpha_m)
    P_q = -y,  P_v = -z - h y,  P_a = -alpha_f x,  P_A = alpha_m x - h^2 (1/2 - beta) y - h (1 - gamma) z    for the step before

with `S = beta' M + gamma' C + K`, C = dr/dv and K = dr/dq at the accepted state, and `dJ/dp += w . dr/dp + mu . dphi/dp`. y is taken from
K^T w: from the recursion it would carry the error of w, divided by h^2.

Several objectives are columns: all of them have the matrices of a step in common. The entry ADJOINT of the model's table (tables.py) solves
the system above at the end of step k. It gets right, below and P_q + j_q, (columns, .) each, and w and mu with a prediction, which it
replaces by the solution; products (3, columns, n) receives K^T w + B^T mu and C^T w. Its M w is not used here.
"""

from typing import NamedTuple

import numpy as np

from polyida.adjoint.dense_steps import DenseAdjoint
from polyida.adjoint.exact_steps import OneStageSteps, StabilisedSteps
from polyida.adjoint.tables import sweep_with_fallback
from polyida.errors import DONE
from polyida.integrate.alpha.step import nearest
from polyida.jit import entry, fast, pack
from polyida.jit.intrinsics import pointer
from polyida.linear.dense import zero
from polyida.system import instant as ask
from polyida.system.own import small_own, small_table
from polyida.system.scene_factors import Factor

# constants of compiled code
Q, V, A, AHEAD = range(4)  # of Memory.adjoints; but for AHEAD, columns of `slope_addresses`
LAM = AHEAD  # of `slope_addresses`
PAST = 3  # steps from which the multipliers of the one before are predicted
STIFF, DAMPED = range(2)  # of Memory.products
WILD = 16.0  # a prediction with larger coefficients of differences is useless: w has grown from zero
OF_NEWTON = 1e-2  # accepted error of w over Newton's tolerance
SAMPLES = 300  # coordinates used to fit the coefficients


class AdjointState(NamedTuple):
    """Adjoints (slopes of the objective) of q, v, a and of the algorithmic acceleration of the state that a step begins from, each (n,)."""

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    ahead: np.ndarray


class SweepResult(NamedTuple):
    """Results of a sweep for a column."""

    adjoints: AdjointState  # of the state before the steps
    w: np.ndarray  # (count, n) multipliers of r
    mu: np.ndarray  # (count, m) multipliers of phi
    kappa: np.ndarray | None = None  # (count, m) multipliers of phi's rate: of velocity rows, and in the stabilised form
    slips: tuple | None = None  # in that form (y', slip, eta) of `y' . (M slip + B^T eta)`
    keep: np.ndarray | None = None  # (2, count, n) y and z, on request


@pack
class Method(NamedTuple):
    """Numbers of the method at one h."""

    h: float
    alpha_m: float
    alpha_f: float
    beta: float
    gamma: float
    to_a: float
    to_v: float


@pack
class Memory(NamedTuple):
    """State of the backward sweep between two steps: right-hand sides, adjoints, products and data of the prediction."""

    right: np.ndarray  # (columns, n) right sides of a step
    below: np.ndarray  # (columns, m)
    adjoints: np.ndarray  # (4, columns, n) of q, v, a and A, with the objectives' slopes at the end of the next step
    products: np.ndarray  # (3, columns, n) K^T w + B^T mu, C^T w, M w
    seen: np.ndarray  # (columns,) number of steps since the prediction started
    first: np.ndarray  # (columns,) coefficients of the first and second differences in a prediction
    second: np.ndarray


@pack
class SweepOutput(NamedTuple):
    """Results of the steps. The last PAST rows of w and mu belong to the later steps, which were swept before."""

    w: np.ndarray  # (count + PAST, columns, n)
    mu: np.ndarray  # (count + PAST, columns, m)
    y: np.ndarray  # (columns, count, n), or (columns, 0, n) if y and z are not needed
    z: np.ndarray


@entry
def sweep_back(functions, workspace, method, slopes, first, last, memory, out):
    """Sweep backward over the steps from last - 1 to first: (the first step that is done, status of the one before).

    functions, workspace: of the model's table (system/instant.py); slopes: of `slope_addresses`.
    """
    model, columns = (functions, workspace), memory.right.shape[0]
    for k in range(last - 1, first - 1, -1):
        for column in range(columns):
            begin(method, slopes, k, memory, out, column)
        status = ask.adjoint(model, k, memory.right, memory.below, memory.adjoints[Q], out.w[k], out.mu[k], memory.products)
        if status != DONE:
            return k + 1, status
        for column in range(columns):
            finish(method, k, memory, out, column)
            if k > 0:
                add_slopes(slopes, k - 1, memory.adjoints, column)
            fit(memory, column, out.w[:, column], k)
    return first, DONE


@fast
def begin(method, slopes, step, memory, out, column):
    """Set the right-hand sides of a step in a column, and predict w and mu."""
    right, below, adjoints = memory.right[column], memory.below[column], memory.adjoints[:, column]
    q, v, a, ahead = adjoints[Q], adjoints[V], adjoints[A], adjoints[AHEAD]
    b = 1.0 / (method.beta * method.h * method.h)
    for i in range(right.shape[0]):
        right[i] = -q[i] - method.to_v * v[i] - method.to_a * a[i] - b * ahead[i]
    zero(below)
    add_slope(slopes[column, LAM], step, -1.0, below)
    predict(memory, column, out.w[:, column], step)
    predict(memory, column, out.mu[:, column], step)


@fast
def predict(memory, column, history, step):
    """Predict history[step] from the values of the next three steps and their differences."""
    first, second, known = memory.first[column], memory.second[column], memory.seen[column] > 0
    now, last, before, earlier = history[step], history[step + 1], history[step + 2], history[step + 3]
    for i in range(now.shape[0]):
        change = last[i] - before[i]
        now[i] = last[i] + first * change + second * (change - (before[i] - earlier[i])) if known else 0.0


@fast
def fit(memory, column, history, step):
    """Set the coefficients of the differences that fit the change of the last step best; 0 while too few steps are known."""
    memory.seen[column] += 1
    aa = ab = bb = ad = bd = 0.0
    now, last, before, earlier, n = history[step], history[step + 1], history[step + 2], history[step + 3], history.shape[1]
    for i in range(0, n, n // SAMPLES | 1):
        first, d = last[i] - before[i], now[i] - last[i]
        second = first - (before[i] - earlier[i])
        aa += first * first
        ab += first * second
        bb += second * second
        ad += first * d
        bd += second * d
    first, second = nearest(aa, ab, bb, ad, bd)
    if not abs(first) + abs(second) < WILD:
        first = second = 0.0
    count = memory.seen[column]
    memory.first[column] = first if count > 3 else 1.0 if count == 3 else 0.0
    memory.second[column] = second if count > 3 else 0.0


@fast
def finish(method, step, memory, out, column):
    """Write the adjoints of the start of a step in a column, and y and z of the step."""
    adjoints, stiff, damped = memory.adjoints[:, column], memory.products[STIFF, column], memory.products[DAMPED, column]
    q, v, a, ahead = adjoints[Q], adjoints[V], adjoints[A], adjoints[AHEAD]
    h, scale, keep = method.h, 1.0 / (1.0 - method.alpha_m), out.y.shape[1] > 0
    for i in range(q.shape[0]):
        y, z = -q[i] - stiff[i], -v[i] - damped[i]
        x = (h * h * method.beta * y + h * method.gamma * z - ahead[i]) * scale
        q[i] = -y
        v[i] = -z - h * y
        a[i] = -method.alpha_f * x
        ahead[i] = method.alpha_m * x - h * h * (0.5 - method.beta) * y - h * (1.0 - method.gamma) * z
        if keep:
            out.y[column, step, i], out.z[column, step, i] = y, z


@fast
def add_slopes(slopes, step, adjoints, column):
    """Add the slopes of an objective at the end of a step to the adjoints of a column."""
    for kind in (Q, V, A):
        add_slope(slopes[column, kind], step, 1.0, adjoints[kind, column])


@fast
def add_slope(source, step, factor, out):
    """out += factor times the row of a step of the array at the address `source`, unless that is 0."""
    if source:
        slopes, at = pointer(source), step * out.shape[0]
        for i in range(out.shape[0]):
            out[i] += factor * slopes[at + i]


def slope_addresses(slopes):
    """(addresses (columns, 4) of the objectives' slopes in q, v, a and lam, (count, .) each, 0 for None; the arrays, which the caller keeps
    alive).
    """
    parts = [[getattr(one, name) for name in ("q", "v", "a", "lam")] for one in slopes]
    arrays = [[None if part is None else np.ascontiguousarray(part, float) for part in one] for one in parts]
    return np.array([[0 if part is None else part.ctypes.data for part in one] for one in arrays]), arrays


class Sweep:
    """Backward sweep over steps of h of a model. counts: Counts to be increased; columns: number of objectives."""

    def __init__(self, model, settings, h, counts, columns=1):
        """Choose the table, and begin with adjoints and predictions of zero."""
        c, n, m = settings.coefficients, model.n, model.m
        self.model, self.settings, self.counts, self.columns = model, settings, counts, columns
        self.method = Method(h, c.alpha_m, c.alpha_f, c.beta, c.gamma, *c.rates(h))
        self.table = self._table()
        self.begun = np.inf  # time at which the steps that were swept last begin
        products = np.zeros((3, columns, n)) if self.table.products is None else self.table.products.reshape(3, columns, n)
        vectors = (np.zeros(size) for size in ((columns, n), (columns, m), (4, columns, n)))
        self.memory = Memory(*vectors, products, np.zeros(columns, np.int64), *np.zeros((2, columns)))
        self.past = [np.zeros((PAST, columns, size)) for size in (n, m)]

    def _table(self):
        """The table of the model: with stored factors or compiled if it can be, else an exact one."""
        model, settings, to_v, to_a = self.model, self.settings, [[self.method.to_v]], [[self.method.to_a]]
        if settings.form == "stabilised" and model.m:
            return StabilisedSteps(model, to_v, to_a, self.counts, columns=self.columns)
        if settings.linear == "kkt" or model.velocity_rows.size:
            return self._exact_table()
        if model.compiled:
            from polyida.adjoint.scene_table import EXACT, SceneAdjoint

            enough, one_mode = max(EXACT, OF_NEWTON * settings.newton_tolerance(0.0)[1]), [(np.ones(1), np.ones(1))]
            return SceneAdjoint(model, to_v, to_a, one_mode, self._factors, enough, self.counts, columns=self.columns)
        if small_own(model):
            return DenseAdjoint(small_table(model), to_v, to_a, self.counts, columns=self.columns)
        return self._exact_table()

    def _exact_table(self):
        """A table with a factor of each step."""
        return OneStageSteps(self.model, [[self.method.to_v]], [[self.method.to_a]], self.counts, columns=self.columns)

    def _factors(self, t, q, v, a, lam, _):
        """[Factor] of the step matrix of a scene at a state."""
        system, c = self.settings.step_matrix(self.model), (self.method.to_a, self.method.to_v)
        system.factor(float(t), q, v, a, lam, *c)
        self.counts.solves += system.solves
        self.counts.backend = system.backend
        return [Factor(np.array(c), system.corotated, system.workspace, np.zeros((0, 2, 2)))]

    def back(self, t, q, v, a, lam, slopes, adjoints, keep=False, slips=None):
        """The SweepResult of each column over steps that end at these states, in order of time, (count, .) each. Raises SingularSystem.

        slopes: of the objectives at these states; adjoints: the AdjointStates from the step behind the last one; a list for each. keep:
        True if y and z are needed. slips (count, n): of the stabilised form, the part of q from eta.
        """
        if abs(t[-1] - self.begun) > 0.5 * self.method.h:
            self._forget()
        table, states, done = self.table, (t, q, v, a, lam), len(t)
        w, mu = (np.concatenate([np.empty((done, *past.shape[1:])), past]) for past in self.past)
        kept = np.empty((2, self.columns, done if keep else 0, self.model.n))
        self.out = SweepOutput(w, mu, *kept)
        addresses, _arrays = slope_addresses(slopes)
        self.memory.adjoints[:] = np.swapaxes(adjoints, 0, 1)
        self.begun = t[0] - self.method.h
        for c, one in enumerate(slopes):
            for kind, slope in enumerate((one.q, one.v, one.a)):
                self.memory.adjoints[kind, c] += 0.0 if slope is None else slope[-1]
        table.set_states(*states, slips)

        def exact_table():
            """A table with a factor of each step, at the same states."""
            self._forget()
            exact = table if isinstance(table, OneStageSteps) else self._exact_table()
            exact.set_states(*states, slips)
            return exact

        def steps(functions, workspace, first, last):
            """The result of the compiled sweep back over the steps first to last - 1, for the functions and workspace of a table."""
            return sweep_back(functions, workspace, self.method, addresses, first, last, self.memory, self.out)

        sweep_with_fallback(table, exact_table, done, steps)
        self.past = [x[:PAST].copy() for x in (w, mu)]
        return [self._result(c, w[:done, c], mu[:done, c], kept[:, c] if keep else None) for c in range(self.columns)]

    def _result(self, column, w, mu, keep):
        """The SweepResult of a column."""
        table, rows, kappa, slips = self.table, self.model.velocity_rows, None, None
        if table.slips is not None:
            kappa, slips = table.kappa[column], tuple(part[column] for part in table.slips)
        elif rows.size:  # the multipliers of velocity rows are those of rates
            kappa, mu = np.zeros_like(mu), mu.copy()
            kappa[:, rows], mu[:, rows] = mu[:, rows], 0.0
        return SweepResult(AdjointState(*self.memory.adjoints[:, column].copy()), w, mu, kappa, slips, keep)

    def _forget(self):
        """Restart the prediction of w and mu from zero."""
        self.memory.seen[:] = 0
        self.memory.first[:] = 0.0
        self.memory.second[:] = 0.0
