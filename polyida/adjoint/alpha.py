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

The driver calls the entry ADJOINT of the model's table (adjoint/tables.py) with right, below, bar, w, mu and products. The entry solves the
system above at the end of step k. w and mu hold a prediction before the call and the solution after it. bar (n,) is P_q + j_q. products (3, n)
receives K^T w + B^T mu, C^T w, and M w, which is not used here.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from polyida.adjoint.history import step_history, stored_state
from polyida.adjoint.parameter import AdjointMultipliers, stacked
from polyida.adjoint.run import RunAdjoint, sweep_with_fallback
from polyida.adjoint.tables import DenseAdjoint, PythonAdjoint
from polyida.adjoint.taped import Tape, TapedModel, add_to
from polyida.errors import DONE, InputError
from polyida.integrate.alpha.step import nearest
from polyida.integrate.discontinuities import inner_side
from polyida.integrate.start import started
from polyida.integrate.state import State
from polyida.jit import entry, fast, pack
from polyida.jit.intrinsics import address, call
from polyida.linear.lu import FactorCache
from polyida.system import ADJOINT
from polyida.system.python import small_own, small_table

# constants of compiled code
Q, V, A, AHEAD = range(4)  # rows of Memory.bars
SEEN, SHARE = range(2)  # of Memory.marks
MARKS = 3
W, RIGHT, BAR, STIFF, DAMPED = range(5)  # rows of Trial.now, which has one more
MU, BELOW = range(2)  # of Trial.rows
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
    """Results of a sweep: the bars of the state before, and w (count, n) and mu (count, m), multipliers of r and phi.

    With velocity rows or in the stabilised form also kappa (count, m), multipliers of phi's rate; in that form (y', slip, eta) of
    `y' . (M slip + B^T eta)`. Else None.
    """

    bars: AdjointState
    w: np.ndarray
    mu: np.ndarray
    kappa: np.ndarray | None = None
    slips: tuple | None = None


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
class FrameSlopes(NamedTuple):
    """The objective's slopes at the steps' ends, (count, .), or (0, .) where they are zero."""

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    lam: np.ndarray


@pack
class Memory(NamedTuple):
    """State of the sweep: bars (4, n); w (3, n) and mu (3, m): those of the last step with first and second backward differences.

    marks: SEEN, number of steps since the prediction started; from SHARE on the coefficients of both differences in a prediction.
    """

    bars: np.ndarray
    w: np.ndarray
    mu: np.ndarray
    marks: np.ndarray


@pack
class Trial(NamedTuple):
    """Scratch of a step: now (6, n), rows (2, m)."""

    now: np.ndarray
    rows: np.ndarray


@pack
class SweepOutput(NamedTuple):
    """Results of the steps: w (count, n), mu (count, m), and y and z (count, n), or (0, n) if they are not needed."""

    w: np.ndarray
    mu: np.ndarray
    y: np.ndarray
    z: np.ndarray


@fast
def begin(p, j, k, y, z):
    """Set the right-hand sides of step k, and predict w and mu."""
    right, bar, below, bars = z.now[RIGHT], z.now[BAR], z.rows[BELOW], y.bars
    b = 1.0 / (p.beta * p.h * p.h)
    for i in range(right.shape[0]):
        right[i] = -bars[Q, i] - p.to_v * bars[V, i] - p.to_a * bars[A, i] - b * bars[AHEAD, i]
        bar[i] = bars[Q, i]
    for i in range(below.shape[0]):
        below[i] = 0.0
    add_slope(j.q, k, -1.0, right)
    add_slope(j.q, k, 1.0, bar)
    add_slope(j.v, k, -p.to_v, right)
    add_slope(j.a, k, -p.to_a, right)
    add_slope(j.lam, k, -1.0, below)
    predict(y.marks[SHARE], y.marks[SHARE + 1], y.w, z.now[W])
    predict(y.marks[SHARE], y.marks[SHARE + 1], y.mu, z.rows[MU])


@fast
def predict(first, second, past, out):
    """The next value, from the last one and its differences."""
    for i in range(out.shape[0]):
        out[i] = past[0, i] + first * past[1, i] + second * past[2, i]


@fast
def add_slope(j, k, factor, out):
    """out += factor j[k], unless j is (0, .)."""
    if j.shape[0]:
        for i in range(out.shape[0]):
            out[i] += factor * j[k, i]


@fast
def finish(p, j, k, y, z, out):
    """Write w, mu, y and z of step k, and the bars of the step's start."""
    bars, now, h, scale = y.bars, z.now, p.h, 1.0 / (1.0 - p.alpha_m)
    add_slope(j.v, k, 1.0, bars[V])
    for i in range(bars.shape[1]):
        b, c = -now[BAR, i] - now[STIFF, i], -bars[V, i] - now[DAMPED, i]
        a = (h * h * p.beta * b + h * p.gamma * c - bars[AHEAD, i]) * scale
        bars[Q, i] = -b
        bars[V, i] = -c - h * b
        bars[A, i] = -p.alpha_f * a
        bars[AHEAD, i] = p.alpha_m * a - h * h * (0.5 - p.beta) * b - h * (1.0 - p.gamma) * c
        out.w[k, i] = now[W, i]
        if out.y.shape[0]:
            out.y[k, i], out.z[k, i] = b, c
    for i in range(out.mu.shape[1]):
        out.mu[k, i] = z.rows[MU, i]


@fast
def shift(now, past):
    """Store one more value, with its backward differences."""
    for i in range(now.shape[0]):
        change = now[i] - past[0, i]
        past[0, i], past[1, i], past[2, i] = now[i], change, change - past[1, i]


@fast
def fit(y, w):
    """The coefficients of the differences that fit the change of w best; 0 while too few steps are known."""
    aa = ab = bb = ad = bd = 0.0
    n, past = w.shape[0], y.w
    for i in range(0, n, n // SAMPLES | 1):
        first, second, d = past[1, i], past[2, i], w[i] - past[0, i]
        aa += first * first
        ab += first * second
        bb += second * second
        ad += first * d
        bd += second * d
    first, second = nearest(aa, ab, bb, ad, bd)
    if not abs(first) + abs(second) < WILD:
        first = second = 0.0
    count = y.marks[SEEN]
    y.marks[SHARE] = first if count > 3.0 else 1.0 if count == 3.0 else 0.0
    y.marks[SHARE + 1] = second if count > 3.0 else 0.0


@entry
def stretch(f, workspace, p, j, first, last, y, z, out):
    """Sweep backward over the steps from last - 1 to first: (the first step that is done, status of the one before).

    f: addresses of the table's functions; workspace: address of the model's.
    """
    right, below, bar = address(z.now[RIGHT]), address(z.rows[BELOW]), address(z.now[BAR])
    w, mu, products = address(z.now[W]), address(z.rows[MU]), address(z.now[STIFF])
    for k in range(last - 1, first - 1, -1):
        begin(p, j, k, y, z)
        ended = call(f[ADJOINT], workspace, k, right, below, bar, w, mu, products)
        if ended != DONE:
            return k + 1, ended
        finish(p, j, k, y, z, out)
        y.marks[SEEN] += 1.0
        fit(y, z.now[W])
        shift(z.now[W], y.w)
        shift(z.rows[MU], y.mu)
    return first, DONE


def adjoint_table(model, settings, h, counts):
    """The table of a model for steps of h. counts: Counts to be increased."""
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
            return SceneAdjoint(model, [[to_v]], [[to_a]], [(to_a, to_v, one, one)], factor, enough, counts)
        if small_own(model):
            return DenseAdjoint(small_table(model), [[to_v]], [[to_a]], counts)
    return PythonAdjoint(model, settings, h, counts)


class Sweep:
    """Backward sweep over steps of h of a model. counts: Counts to be increased; table: that of `adjoint_table`, if it is known."""

    def __init__(self, model, settings, h, counts, table=None):
        c, n, m = settings.coefficients, model.n, model.m
        self.model, self.settings, self.counts = model, settings, counts
        self.method = Method(h, c.alpha_m, c.alpha_f, c.beta, c.gamma, *c.rates(h))
        self.memory = Memory(np.zeros((4, n)), np.zeros((3, n)), np.zeros((3, m)), np.zeros(MARKS))
        self.trial = Trial(np.zeros((6, n)), np.zeros((2, m)))
        self.table, self.before = table or adjoint_table(model, settings, h, counts), np.inf

    def back(self, t, q, v, a, lam, slopes, bars, keep=None, slips=None):
        """The SweepResult of steps that end at these states, in order of time, (count, .) each. Raises SingularSystem.

        slopes: of the objective at these states; bars: the AdjointState from the step behind the last one. keep (2, count, n): for y and z,
        or None. slips (count, n): of the stabilised form, the part of q from eta.
        """
        if abs(t[-1] - self.before) > 0.5 * self.method.h:
            self._forget()
        self.memory.bars[:], self.before = bars, t[0] - self.method.h
        table, states, n, m = self.table, (t, q, v, a, lam), self.model.n, self.model.m
        self.out = SweepOutput(np.empty_like(q), np.empty_like(lam), *(np.empty((2, 0, n)) if keep is None else keep))
        parts = (slopes.q, n), (slopes.v, n), (slopes.a, n), (slopes.lam, m)
        slopes_here = FrameSlopes(*(np.zeros((0, size)) if part is None else np.ascontiguousarray(part, float) for part, size in parts))
        self.frame_slopes, done = slopes_here, len(t)
        table.set_states(*states, slips)

        def exact_table():
            self._forget()
            exact = PythonAdjoint(self.model, self.settings, self.method.h, self.counts)
            exact.set_states(*states)
            return exact

        sweep_with_fallback(
            table,
            exact_table,
            done,
            lambda *at: stretch(*at[:2], self.method, self.frame_slopes, *at[2:], self.memory, self.trial, self.out),
        )
        return SweepResult(AdjointState(*self.memory.bars.copy()), self.out.w, self.out.mu, table.kappa, table.slips)

    def _forget(self):
        """Restart the prediction."""
        self.memory.w[:], self.memory.mu[:], self.memory.marks[:] = 0.0, 0.0, 0.0


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
        self.sweeps, self.tables, self.ready, self.ahead = FactorCache(), FactorCache(), {}, {}
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

    def beside(self, run, objective):
        """The sweep for another objective, which shares the tables with this one."""
        other = super().beside(run, objective)
        other.sweeps = FactorCache()
        return other

    def stretches_backward(self):
        """Sweep over one stretch after the other and yield its time; return the bars of q, v, a and lam of the run's first state."""
        bars, lam = AdjointState(*np.zeros((4, self.model.n))), np.zeros(self.model.m)
        for segment in reversed(self.history.segments):
            bars = yield from self._steps(segment, bars, lam)
            if self.observes:
                self.observe_start(segment, bars)
            if self.events.speeds:
                self._add_start_slopes(segment, bars)
            bars, lam, entries = self._segment_start(segment, bars)
            if entries:
                at = stacked(entries)
                self.add(at, np.repeat(self.history.states(segment.first, segment.first + 1)[0], len(at.t)))
        return *bars[:3], lam

    def _steps(self, segment, bars, lam):
        """The AdjointState at the start of a segment, by sweeping over it; lam: the bar of the multipliers of its last state."""
        key, end = f"{segment.h:.9e}", segment.first + segment.count
        if (sweep := self.sweeps.get(key)) is None:
            table = self.tables.get(key)
            sweep = Sweep(self.model, self.settings, segment.h, self.counts, table and table.beside())
            self.tables.keep(key, table or sweep.table)
        self.sweeps.keep(key, sweep)
        for first, last in self._stretches(segment):
            t, q, v, a, rows = self.history.states(first + 1, last + 1)
            slopes_here, inner = self.objective_slopes.at_states(first + 1, last + 1), t
            own = slopes_here
            if last == end:
                inner = np.append(t[:-1], inner_side(self.model, t[-1], segment.h))
                if lam.any():
                    slopes_here = replace(slopes_here, lam=np.zeros(rows.shape) if slopes_here.lam is None else np.array(slopes_here.lam))
                    slopes_here.lam[-1] += lam
            motion = self._motion(segment, first, last) if self.ready else None
            slip = self._slips(segment.h, *motion) if self.stabilised else None
            keep = np.empty((2, *q.shape)) if self.events.speeds or self.observes else None
            result = sweep.back(inner, q, v, a, rows, slopes_here, bars, keep, slip)
            self.add(AdjointMultipliers(inner, q, v, a, rows, result.w, result.mu, result.kappa), t)
            if self.stabilised:
                (ahead, slipped, eta), still = result.slips, np.zeros_like(q)
                self.add(AdjointMultipliers(inner, q, still, slipped, eta, ahead), t)
                self.add(AdjointMultipliers(inner, q, still, still, np.zeros_like(eta), -ahead), t)
            if self.observes:
                self.observe(segment, first, inner, motion, own, result, keep)
            if self.events.speeds:
                self._add_step_slopes(segment, *motion[:2], slip, *keep)
                if (by_time := slopes_here.by_time()) is not None:
                    self.events.add_at(t, by_time)
            bars = result.bars
            yield float(t[0])
        return bars

    def observe(self, segment, first, t, motion, slopes, result, keep):
        """Take the multipliers of steps from state number `first`.

        t (count,): times of their ends, beside kinks; motion: of `_motion`; slopes: of the objective; result: SweepResult; keep: y and z (count, n).
        """

    def observe_start(self, segment, bars):
        """Take the AdjointState of the state from which the steps of a segment begin."""

    def _add_step_slopes(self, segment, q, v, slip, y, z):
        """Add the slope in h of steps with multipliers y and z; q and v: of `_motion`; slip: what the stabilised form adds to q, or None."""
        moved = np.diff(q, axis=0) - (0.0 if slip is None else slip)
        by_h = np.sum(y * (2.0 * moved / segment.h - v[:-1])) + np.sum(z * np.diff(v, axis=0)) / segment.h
        self.events.add_step_slope(segment, -by_h)

    def _add_start_slopes(self, segment, bars):
        """Add the slopes of a segment's start in h, and in h of the segment before."""
        (state, _), slopes = self.ready[segment.first], [0.0, 0.0]
        for k, h in enumerate((segment.h, segment.before)[: 1 + (segment.kind == "on")]):
            for s, weight in ((SMALL, 0.5), (-SMALL, -0.5)):
                moved = state if k == 0 else replace(state, memory=state.memory | {"h": h * (1.0 + s)})
                ready = started(self.settings, self.model, moved, segment.h * (1.0 + s) if k == 0 else segment.h)
                vectors = ready.q, ready.v, ready.a, ready.memory["a_alg"]
                slopes[k] += weight * sum(float(bar @ x) for bar, x in zip(bars, vectors)) / (SMALL * h)
        self.events.add_step_slope(segment, *slopes)

    def _segment_start(self, segment, bars):
        """(AdjointState, bar of lam, entries for parameters) of the state before a segment's start procedure; bars: of the state after it."""
        state, tape = stored_state(self.history, segment.first), Tape()
        taped = TapedModel(self.model, tape)
        q, v, a, lam, ahead = (tape.var(x) for x in (state.q, state.v, state.a, state.lam, state.a))
        ready = started(self.settings, taped, State(state.t, q, v, a, lam, segment.memory(ahead)), segment.h)
        for var, bar in zip((ready.q, ready.v, ready.a, ready.memory["a_alg"]), bars):
            add_to(var, bar)
        tape.back()
        return AdjointState(q.bar, v.bar, a.bar, ahead.bar), lam.bar, taped.entries
