"""A run of generalized-alpha backward: the steps of each segment by a compiled sweep, its beginning on a tape.

What a segment began with is made again from the states by the method's own code (integrate/start.py), and so is its adjoint. Times of
kinks that move with a parameter change h: in Newmark's formulas, `-dh/dp sum y . (2 (q_1 - q_0)/h - v_0) + z . (v_1 - v_0)/h`, and in what a
segment begins with, by differences of that.

The sweep is the adjoint of each step's own equations. Step n solves `r(q, v, a, lam) = 0`, `phi(q) = 0`, the recursion of the algorithmic
acceleration A and Newmark's formulas, with multipliers w, mu, x, y and z. The step behind it sends the bars P_q, P_v, P_a, P_A of the state
it begins from; j are the objective's own slopes:

    [[S^T, B^T], [B, 0]] (w, mu) = (-(P_q + j_q) - gamma' (P_v + j_v) - beta' (P_a + j_a) - P_A/(beta h^2), -j_lam)
    y = -(P_q + j_q) - K^T w - B^T mu        z = -(P_v + j_v) - C^T w        x = (h^2 beta y + h gamma z - P_A)/(1 - alpha_m)
    P_q = -y,  P_v = -z - h y,  P_a = -alpha_f x,  P_A = alpha_m x - h^2 (1/2 - beta) y - h (1 - gamma) z    for the step before

with `S = beta' M + gamma' C + K`, C = dr/dv and K = dr/dq at the accepted state, and `dJ/dp += w . dr/dp + mu . dphi/dp`. y is taken from
K^T w: from the recursion it would carry the error of w, divided by h^2.

Several objectives are columns: all of them have the matrices of a step in common. The driver calls the entry ADJOINT of the model's table
(adjoint/tables.py) with right, below, bar, w, mu and products, (columns, .) each. The entry solves the system above at the end of step k. w and mu
hold a prediction before the call and the solution after it. bar is P_q + j_q. products (3, columns, n) receives K^T w + B^T mu and C^T w; M w is not
used here.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from polyida.adjoint.history import step_history, stored_state
from polyida.adjoint.parameter import AdjointMultipliers, SharedStates, stacked
from polyida.adjoint.run import RunAdjoint, sweep_with_fallback
from polyida.adjoint.tables import DenseAdjoint, PythonAdjoint
from polyida.adjoint.taped import Tape, TapedModel, add_to
from polyida.errors import DONE, InputError
from polyida.integrate.alpha.start import started
from polyida.integrate.alpha.step import nearest
from polyida.integrate.discontinuities import inner_side
from polyida.integrate.state import State
from polyida.jit import entry, fast, pack
from polyida.jit.intrinsics import pointer
from polyida.linear.dense import zero
from polyida.linear.lu import FactorCache
from polyida.system import instant as ask
from polyida.system.own import small_own, small_table

# constants of compiled code
Q, V, A, AHEAD = range(4)  # of Memory.bars; but for AHEAD, columns of `slope_addresses`
LAM = AHEAD  # of `slope_addresses`
PAST = 3  # steps from which the multipliers of the one before are predicted
SEEN, SHARE = range(2)  # of Memory.marks
MARKS = 3
STIFF, DAMPED = range(2)  # of Memory.products
WILD = 16.0  # a prediction with larger coefficients of differences is useless: w has grown from zero
OF_NEWTON = 1e-2  # accepted error of w over Newton's tolerance
SAMPLES = 300  # coordinates used to fit the coefficients


class AdjointState(NamedTuple):
    """Bars (slopes of the objective) of q, v, a and of the algorithmic acceleration of the state that a step begins from, each (n,)."""

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    ahead: np.ndarray


class SweepResult(NamedTuple):
    """Results of a sweep for a column: the bars of the state before, and w (count, n) and mu (count, m), multipliers of r and phi.

    With velocity rows or in the stabilised form also kappa (count, m), multipliers of phi's rate; in that form (y', slip, eta) of
    `y' . (M slip + B^T eta)`. Else None. keep: y and z (2, count, n), or None.
    """

    bars: AdjointState
    w: np.ndarray
    mu: np.ndarray
    kappa: np.ndarray | None = None
    slips: tuple | None = None
    keep: np.ndarray | None = None


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
    """State of the sweep: right (columns, n), below (columns, m); bars (4, columns, n), with the objectives' slopes at the end of the next step;
    products (3, columns, n).

    marks (columns, MARKS): SEEN, number of steps since the prediction started; from SHARE on the coefficients of both differences in a prediction.
    """

    right: np.ndarray
    below: np.ndarray
    bars: np.ndarray
    products: np.ndarray
    marks: np.ndarray


@pack
class SweepOutput(NamedTuple):
    """Results of the steps: w (count + PAST, columns, n) and mu (count + PAST, columns, m), and y and z (columns, count, n), or (columns, 0, n) if
    they are not needed. The last PAST rows of w and mu belong to the later steps, which were swept before.
    """

    w: np.ndarray
    mu: np.ndarray
    y: np.ndarray
    z: np.ndarray


@fast
def begin(method, slopes, step, memory, out, column):
    """Set the right-hand sides of a step in a column, and predict w and mu."""
    right, below, bars = memory.right[column], memory.below[column], memory.bars[:, column]
    q, v, a, ahead = bars[Q], bars[V], bars[A], bars[AHEAD]
    b = 1.0 / (method.beta * method.h * method.h)
    for i in range(right.shape[0]):
        right[i] = -q[i] - method.to_v * v[i] - method.to_a * a[i] - b * ahead[i]
    zero(below)
    add_slope(slopes[column, LAM], step, -1.0, below)
    predict(memory.marks[column], out.w[:, column], step)
    predict(memory.marks[column], out.mu[:, column], step)


@fast
def predict(marks, history, step):
    """Predict history[step] from the values of the next three steps and their differences."""
    first, second = marks[SHARE], marks[SHARE + 1]
    now, last, before, earlier = history[step], history[step + 1], history[step + 2], history[step + 3]
    for i in range(now.shape[0]):
        change = last[i] - before[i]
        now[i] = last[i] + first * change + second * (change - (before[i] - earlier[i])) if marks[SEEN] > 0.0 else 0.0


@fast
def add_slopes(slopes, step, bars, column):
    """Add the slopes of an objective at the end of a step to the bars of a column."""
    for kind in (Q, V, A):
        add_slope(slopes[column, kind], step, 1.0, bars[kind, column])


@fast
def add_slope(source, step, factor, out):
    """out += factor times the row of a step of the array at the address `source`, unless that is 0."""
    if source:
        slopes, at = pointer(source), step * out.shape[0]
        for i in range(out.shape[0]):
            out[i] += factor * slopes[at + i]


@fast
def finish(method, step, memory, out, column):
    """Write the bars of the start of a step in a column, and y and z of the step."""
    bars, stiff, damped = memory.bars[:, column], memory.products[STIFF, column], memory.products[DAMPED, column]
    q, v, a, ahead = bars[Q], bars[V], bars[A], bars[AHEAD]
    h, scale, keep = method.h, 1.0 / (1.0 - method.alpha_m), out.y.shape[1] > 0
    for i in range(q.shape[0]):
        b, d = -q[i] - stiff[i], -v[i] - damped[i]
        x = (h * h * method.beta * b + h * method.gamma * d - ahead[i]) * scale
        q[i] = -b
        v[i] = -d - h * b
        a[i] = -method.alpha_f * x
        ahead[i] = method.alpha_m * x - h * h * (0.5 - method.beta) * b - h * (1.0 - method.gamma) * d
        if keep:
            out.y[column, step, i], out.z[column, step, i] = b, d


@fast
def fit(marks, history, step):
    """Set the coefficients of the differences that fit the change of the last step best; 0 while too few steps are known."""
    marks[SEEN] += 1.0
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
    count = marks[SEEN]
    marks[SHARE] = first if count > 3.0 else 1.0 if count == 3.0 else 0.0
    marks[SHARE + 1] = second if count > 3.0 else 0.0


@entry
def sweep_back(functions, workspace, method, slopes, first, last, memory, out):
    """Sweep backward over the steps from last - 1 to first: (the first step that is done, status of the one before).

    functions, workspace: of the model's table (system/instant.py); slopes: of `slope_addresses`.
    """
    model, columns = (functions, workspace), memory.right.shape[0]
    for k in range(last - 1, first - 1, -1):
        for column in range(columns):
            begin(method, slopes, k, memory, out, column)
        status = ask.adjoint(model, k, memory.right, memory.below, memory.bars[Q], out.w[k], out.mu[k], memory.products)
        if status != DONE:
            return k + 1, status
        for column in range(columns):
            finish(method, k, memory, out, column)
            if k > 0:
                add_slopes(slopes, k - 1, memory.bars, column)
            fit(memory.marks[column], out.w[:, column], k)
    return first, DONE


def adjoint_table(model, settings, h, counts, columns):
    """The table of a model for steps of h and a number of columns. counts: Counts to be increased."""
    to_a, to_v = settings.coefficients.rates(h)
    if settings.form == "index3" and settings.linear != "kkt" and not model.velocity_rows.size:
        if model.compiled:
            from polyida.adjoint.scene_table import EXACT, SceneAdjoint

            def factor(t, q, v, a, lam, modes):
                system = settings.step_matrix(model)
                system.factor(float(t), q, v, a, lam, *modes[0])
                counts.solves += system.solves
                counts.backend = system.backend
                return [(system.corotated, system.workspace)]

            enough, one = max(EXACT, OF_NEWTON * settings.newton_tolerance(0.0)[1]), np.ones(1)
            return SceneAdjoint(model, [[to_v]], [[to_a]], [(to_a, to_v, one, one)], factor, enough, counts, columns=columns)
        if small_own(model):
            return DenseAdjoint(small_table(model), [[to_v]], [[to_a]], counts, columns=columns)
    return PythonAdjoint(model, settings, h, counts, columns)


class Sweep:
    """Backward sweep over steps of h of a model. counts: Counts to be increased; columns: number of objectives."""

    def __init__(self, model, settings, h, counts, columns=1):
        c, n, m = settings.coefficients, model.n, model.m
        self.model, self.settings, self.counts, self.columns = model, settings, counts, columns
        self.method = Method(h, c.alpha_m, c.alpha_f, c.beta, c.gamma, *c.rates(h))
        self.table, self.before = adjoint_table(model, settings, h, counts, columns), np.inf
        products = np.zeros((3, columns, n)) if self.table.products is None else self.table.products.reshape(3, columns, n)
        self.memory = Memory(
            *(np.zeros(size) for size in ((columns, n), (columns, m), (4, columns, n))), products, np.zeros((columns, MARKS))
        )
        self.past = [np.zeros((PAST, columns, size)) for size in (n, m)]

    def back(self, t, q, v, a, lam, slopes, bars, keep=False, slips=None):
        """The SweepResult of each column over steps that end at these states, in order of time, (count, .) each. Raises SingularSystem.

        slopes: of the objectives at these states; bars: the AdjointStates from the step behind the last one; a list for each. keep: True if y and
        z are needed. slips (count, n): of the stabilised form, the part of q from eta.
        """
        if abs(t[-1] - self.before) > 0.5 * self.method.h:
            self._forget()
        table, states, done, columns = self.table, (t, q, v, a, lam), len(t), range(self.columns)
        w, mu = (np.concatenate([np.empty((done, *past.shape[1:])), past]) for past in self.past)
        kept = np.empty((2, self.columns, done if keep else 0, self.model.n))
        out = self.out = SweepOutput(w, mu, *kept)
        j, _arrays = slope_addresses(slopes)
        self.memory.bars[:], self.before = np.swapaxes(bars, 0, 1), t[0] - self.method.h
        add_last_slopes(j, done - 1, self.memory.bars)
        table.set_states(*states, slips)

        def exact_table():
            self._forget()
            exact = PythonAdjoint(self.model, self.settings, self.method.h, self.counts, self.columns)
            exact.set_states(*states)
            return exact

        sweep_with_fallback(table, exact_table, done, lambda *at: sweep_back(*at[:2], self.method, j, *at[2:], self.memory, out))
        self.past = [x[:PAST].copy() for x in (w, mu)]
        return [
            SweepResult(
                AdjointState(*self.memory.bars[:, c].copy()),
                w[:done, c],
                mu[:done, c],
                None if table.kappa is None else table.kappa[c],
                None if table.slips is None else tuple(part[c] for part in table.slips),
                kept[:, c] if keep else None,
            )
            for c in columns
        ]

    def _forget(self):
        """Restart the prediction."""
        self.memory.marks[:] = 0.0


def slope_addresses(slopes):
    """(addresses (columns, 4) of the objectives' slopes in q, v, a and lam, (count, .) each, 0 for None; the arrays, which the caller keeps alive)."""
    parts = [[getattr(one, name) for name in ("q", "v", "a", "lam")] for one in slopes]
    arrays = [[None if part is None else np.ascontiguousarray(part, float) for part in one] for one in parts]
    return np.array([[0 if part is None else part.ctypes.data for part in one] for one in arrays]), arrays


@entry
def add_last_slopes(slopes, step, bars):
    """Add the slopes of all objectives at the end of a step."""
    for c in range(slopes.shape[0]):
        add_slopes(slopes, step, bars, c)


CHUNK = 4_000_000  # bytes of multipliers that are held at once
LONGEST = 256  # steps of a sweep at once
SMALL = 1e-4  # of h, by which it is changed in differences


@entry
def recursion(alpha_m, alpha_f, a, ahead):
    """Fill ahead (count, n), algorithmic accelerations A of which the first is known, from accelerations a."""
    for k in range(1, a.shape[0]):
        for i in range(a.shape[1]):
            ahead[k, i] = ((1.0 - alpha_f) * a[k, i] + alpha_f * a[k - 1, i] - alpha_m * ahead[k - 1, i]) / (1.0 - alpha_m)


class AlphaAdjoint(RunAdjoint):
    """Backward sweep over a run.

    ready: {first number of a segment: (its State, the State after `started`)}; ahead: {first number of a stretch: A there}, if needed. A class that
    `observes` gets the multipliers of all steps.
    """

    history_of = staticmethod(step_history)
    observes = False

    def __init__(self, run, objective, names, memory_limit):
        super().__init__(run, objective, names, memory_limit)
        self.sweeps, self.ready, self.ahead = FactorCache(), {}, {}
        self.longest = int(max(1, min(LONGEST, CHUNK // (8 * self.model.n))))
        self.stabilised = self.settings.form == "stabilised" and self.model.m > 0
        if self.stabilised or self.events.speeds or self.observes:
            ahead = None
            for segment in self.history.segments:
                state = stored_state(self.history, segment.first, segment.memory(ahead))
                begun = started(self.settings, self.model, state, segment.h)
                self.ready[segment.first], ahead = (state, begun), begun.memory["a_alg"]
                for first, last in reversed(self._stretches(segment)):
                    self.ahead[first] = ahead
                    ahead = self._motion(segment, first, last)[3][-1]

    @staticmethod
    def require_settings(settings):
        """Raise InputError if frames are those of two runs."""
        if settings.extrapolate:
            raise InputError("gradient: extrapolate = True makes frames of two runs; take the gradient of one without")

    def _stretches(self, segment):
        """(first, last) of the stretches of a segment that are swept at once, from the last one to the first."""
        end = segment.first + segment.count
        return [(max(segment.first, last - self.longest), last) for last in range(end, segment.first, -self.longest)]

    def _motion(self, segment, first, last):
        """q, v, a and A of the states from number `first` to `last`, (count, n) each; the first of a segment as its steps begin."""
        _, *vectors, _ = self.history.states(first, last + 1)
        if first == segment.first:
            begun = self.ready[first][1]
            vectors = [np.concatenate([x[None], rest[1:]]) for x, rest in zip((begun.q, begun.v, begun.a), vectors)]
        c, ahead = self.settings.coefficients, np.empty_like(vectors[2])
        ahead[0] = self.ahead[first]
        recursion(c.alpha_m, c.alpha_f, np.ascontiguousarray(vectors[2]), ahead)
        return *vectors, ahead

    def _slips(self, h, q, v, a, ahead):
        """What the stabilised form adds to Newmark's q, `q_1 - (q_0 + h v_0 + h^2 ((1/2 - beta) A_0 + beta A_1))`, of steps of h."""
        beta = self.settings.coefficients.beta
        return q[1:] - (q[:-1] + h * v[:-1] + h * h * ((0.5 - beta) * ahead[:-1] + beta * ahead[1:]))

    def stretches_backward(self, sweeps):
        """Sweep over one stretch after the other and yield its time; return the bars of q, v, a and lam of the run's first state for each objective,
        none if the class `observes`.
        """
        each = [(AdjointState(*np.zeros((4, self.model.n))), np.zeros(self.model.m)) for _ in sweeps]
        for segment in reversed(self.history.segments):
            bars = yield from self._steps(segment, sweeps, *zip(*each))
            if self.observes:
                self.observe_start(segment, bars[0])
                if not segment.first:  # the multipliers of all steps are known, and nobody reads the bars of the run's first state
                    return []
            each = []
            for sweep, after, (before, lam, entries) in zip(sweeps, bars, self._segment_start(segment, bars)):
                if self.events.speeds:
                    sweep.events.add_step_slope(segment, *self._start_slopes(segment, after))
                if entries:
                    at = stacked(entries)
                    sweep.add(at, np.repeat(self.history.states(segment.first, segment.first + 1)[0], len(at.t)))
                each.append((before, lam))
        return [(*bars[:3], lam) for bars, lam in each]

    def _steps(self, segment, sweeps, bars, lam):
        """The AdjointStates at the start of a segment, by sweeping over it; lam: the bars of the multipliers of its last state."""
        key, end = f"{segment.h:.9e}", segment.first + segment.count
        if (shared := self.sweeps.get(key)) is None:
            shared = Sweep(self.model, self.settings, segment.h, self.counts, len(sweeps))
        self.sweeps.keep(key, shared)
        for first, last in self._stretches(segment):
            t, q, v, a, rows = self.history.states(first + 1, last + 1)
            own, inner = [sweep.objective_slopes.at_states(first + 1, last + 1) for sweep in sweeps], t
            slopes_here = own
            if last == end:
                inner = np.append(t[:-1], inner_side(self.model, t[-1], segment.h))
                slopes_here = [_with_last(one, bar, rows) for one, bar in zip(own, lam)]
            motion = self._motion(segment, first, last) if self.ready else None
            slip = self._slips(segment.h, *motion) if self.stabilised else None
            keep = bool(self.events.speeds or self.observes)
            results = shared.back(inner, self.linearised(first + 1, q, v), v, a, rows, slopes_here, bars, keep, slip)
            works = [AdjointMultipliers(inner, q, v, a, rows, each.w, each.mu, each.kappa) for each in results]
            works = SharedStates(works, shared.out.w[: len(t)])
            sweeps[0].totals.prepare(works)
            for sweep, work in zip(sweeps, works):
                sweep.add(work, t)
            for sweep, slopes, result in zip(sweeps, slopes_here, results):
                if self.stabilised:
                    (ahead, slipped, eta), still = result.slips, np.zeros_like(q)
                    sweep.add(AdjointMultipliers(inner, q, still, slipped, eta, ahead), t)
                    sweep.add(AdjointMultipliers(inner, q, still, still, np.zeros_like(eta), -ahead), t)
                if self.events.speeds:
                    sweep.events.add_step_slope(segment, self._step_slope(segment, *motion[:2], slip, *result.keep))
                    if (by_time := slopes.by_time()) is not None:
                        sweep.events.add_at(t, by_time)
            if self.observes:
                self.observe(segment, first, inner, motion, own[0], results[0])
            bars = [result.bars for result in results]
            yield float(t[0])
        return bars

    def linearised(self, number, q, v):
        """The places (count, n) at which steps are linearised; q, v: their ends, the first of this number."""
        return q

    def observe(self, segment, first, t, motion, slopes, result):
        """Take the multipliers of steps from state number `first`.

        t (count,): times of their ends, beside kinks; motion: of `_motion`; slopes: of the objective; result: SweepResult with y and z.
        """

    def observe_start(self, segment, bars):
        """Take the AdjointState of the state from which the steps of a segment begin."""

    def _step_slope(self, segment, q, v, slip, y, z):
        """The slope in h of steps with multipliers y and z; q and v: of `_motion`; slip: what the stabilised form adds to q, or None."""
        moved = np.diff(q, axis=0) - (0.0 if slip is None else slip)
        by_h = np.sum(y * (2.0 * moved / segment.h - v[:-1])) + np.sum(z * np.diff(v, axis=0)) / segment.h
        return -by_h

    def _start_slopes(self, segment, bars):
        """The slopes of a segment's start in h, and in h of the segment before."""
        (state, _), slopes = self.ready[segment.first], [0.0, 0.0]
        for k, h in enumerate((segment.h, segment.before)[: 1 + (segment.kind == "on")]):
            for s, weight in ((SMALL, 0.5), (-SMALL, -0.5)):
                moved = state if k == 0 else replace(state, memory=state.memory | {"h": h * (1.0 + s)})
                ready = started(self.settings, self.model, moved, segment.h * (1.0 + s) if k == 0 else segment.h)
                vectors = ready.q, ready.v, ready.a, ready.memory["a_alg"]
                slopes[k] += weight * sum(float(bar @ x) for bar, x in zip(bars, vectors)) / (SMALL * h)
        return slopes

    def _segment_start(self, segment, bars):
        """Yield (AdjointState, bar of lam, entries for parameters) of the state before a segment's start procedure; bars: of the state after it, for
        each objective.
        """
        state, tape = stored_state(self.history, segment.first), Tape()
        taped = TapedModel(self.model, tape)
        first = q, v, a, lam, ahead = [tape.var(x) for x in (state.q, state.v, state.a, state.lam, state.a)]
        ready = started(self.settings, taped, State(state.t, q, v, a, lam, segment.memory(ahead)), segment.h)
        for number, after in enumerate(bars, 1):
            for var in first:
                var.bar = np.zeros_like(var.value)
            taped.entries = []
            for var, bar in zip((ready.q, ready.v, ready.a, ready.memory["a_alg"]), after):
                add_to(var, bar)
            tape.back(again=number < len(bars))
            yield AdjointState(q.bar, v.bar, a.bar, ahead.bar), lam.bar, taped.entries


def _with_last(slopes, bar, rows):
    """The Slopes with the bar of the multipliers of the last state, (m,); rows (count, m)."""
    if not bar.any():
        return slopes
    lam = np.zeros(rows.shape) if slopes.lam is None else np.array(slopes.lam)
    lam[-1] += bar
    return replace(slopes, lam=lam)
