"""A run of generalized-alpha backward: the steps of each segment by a compiled sweep (alpha_sweep.py), its beginning on a tape.

What a segment began with is made again from the states by the method's own code (integrate/start.py), and so is its adjoint. Times of
kinks that move with a parameter change h: in Newmark's formulas, `-dh/dp sum y . (2 (q_1 - q_0)/h - v_0) + z . (v_1 - v_0)/h`, and in what
a segment begins with, by differences of that.
"""

from dataclasses import replace

import numpy as np

from polyida.adjoint.alpha_sweep import AdjointState, Sweep
from polyida.adjoint.history import step_history, stored_state
from polyida.adjoint.parameter import AdjointMultipliers, SharedStates, stacked
from polyida.adjoint.run import RunAdjoint
from polyida.adjoint.taped import Tape, TapedModel, add_to
from polyida.errors import InputError
from polyida.integrate.alpha.start import started
from polyida.integrate.discontinuities import inner_side
from polyida.integrate.state import State
from polyida.linear.lu import FactorCache

CHUNK = 4_000_000  # bytes of multipliers that are held at once
LONGEST = 256  # steps of a sweep at once
SMALL = 1e-4  # of h, by which it is changed in differences


class AlphaAdjoint(RunAdjoint):
    """Backward sweep over a run.

    ready: {first number of a segment: (its State, the State after `started`)}; ahead: {first number of a stretch: A there}, if needed. A
    class that `observes` gets the multipliers of all steps.
    """

    history_of = staticmethod(step_history)
    observes = False

    def __init__(self, run, objective, names, memory_limit):
        """Make the beginnings of all segments again, and A at each stretch, if they are needed."""
        super().__init__(run, objective, names, memory_limit)
        self.sweeps = FactorCache()
        self.ready, self.ahead = {}, {}
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
        """(q, v, a, A) of the states from number `first` to `last`, both included, (last - first + 1, n) each.

        A: the method's acceleration-like variable, that of `(1 - alpha_m) A_1 + alpha_m A_0 = (1 - alpha_f) a_1 + alpha_f a_0`. The first
        state of a segment has the q, v and a with which its steps begin, not those stored.
        """
        _, *vectors, _ = self.history.states(first, last + 1)
        if first == segment.first:
            begun = self.ready[first][1]
            vectors = [np.concatenate([x[None], rest[1:]]) for x, rest in zip((begun.q, begun.v, begun.a), vectors)]
        c, a = self.settings.coefficients, vectors[2]
        ahead, mean = np.empty_like(a), (1.0 - c.alpha_f) * a[1:] + c.alpha_f * a[:-1]
        ahead[0] = self.ahead[first]
        for k in range(len(mean)):
            ahead[k + 1] = (mean[k] - c.alpha_m * ahead[k]) / (1.0 - c.alpha_m)
        return *vectors, ahead

    def _slips(self, h, q, v, a, ahead):
        """What the stabilised form adds to Newmark's q, `q_1 - (q_0 + h v_0 + h^2 ((1/2 - beta) A_0 + beta A_1))`, of steps of h."""
        beta = self.settings.coefficients.beta
        return q[1:] - (q[:-1] + h * v[:-1] + h * h * ((0.5 - beta) * ahead[:-1] + beta * ahead[1:]))

    def stretches_backward(self, sweeps):
        """Sweep over one stretch after the other and yield its time; return the adjoints of q, v, a and lam of the run's first state for
        each objective, none if the class `observes`.
        """
        each = [(AdjointState(*np.zeros((4, self.model.n))), np.zeros(self.model.m)) for _ in sweeps]
        for segment in reversed(self.history.segments):
            adjoints = yield from self._steps(segment, sweeps, *zip(*each))
            if self.observes:
                self.observe_start(segment, adjoints[0])
                if not segment.first:  # the multipliers of all steps are known, and nobody reads the adjoints of the run's first state
                    return []
            each = []
            for sweep, after, (before, lam, entries) in zip(sweeps, adjoints, self._segment_start(segment, adjoints)):
                if self.events.speeds:
                    sweep.events.add_step_slope(segment, *self._start_slopes(segment, after))
                if entries:
                    at = stacked(entries)
                    sweep.add(at, np.repeat(self.history.states(segment.first, segment.first + 1)[0], len(at.t)))
                each.append((before, lam))
        return [(*adjoints[:3], lam) for adjoints, lam in each]

    def _steps(self, segment, sweeps, adjoints, lam):
        """The AdjointStates at the start of a segment, by sweeping over it; lam: the adjoints of the multipliers of its last state."""
        key, end = f"{segment.h:.9e}", segment.first + segment.count
        if (shared := self.sweeps.get(key)) is None:
            shared = Sweep(self.model, self.settings, segment.h, self.counts, len(sweeps))
        self.sweeps.keep(key, shared)
        for first, last in self._stretches(segment):
            t, q, v, a, rows = self.history.states(first + 1, last + 1)
            slopes, inner = [sweep.objective_slopes.at_states(first + 1, last + 1) for sweep in sweeps], t
            own = slopes[0]
            if last == end:
                inner = np.append(t[:-1], inner_side(self.model, t[-1], segment.h))
                slopes = [_with_last(one, adjoint, rows) for one, adjoint in zip(slopes, lam)]
            motion = self._motion(segment, first, last) if self.ready else None
            slip = self._slips(segment.h, *motion) if self.stabilised else None
            keep = bool(self.events.speeds or self.observes)
            results = shared.back(inner, self.linearised(first + 1, q, v), v, a, rows, slopes, adjoints, keep, slip)
            self._add_works(sweeps, results, (inner, q, v, a, rows), t, shared.out.w[: len(t)])
            if self.events.speeds:
                for sweep, one, result in zip(sweeps, slopes, results):
                    sweep.events.add_step_slope(segment, self._step_slope(segment, *motion[:2], slip, *result.keep))
                    if (by_time := one.by_time()) is not None:
                        sweep.events.add_at(t, by_time)
            if self.observes:
                self.observe(segment, first, inner, motion, own, results[0])
            adjoints = [result.adjoints for result in results]
            yield float(t[0])
        return adjoints

    def _add_works(self, sweeps, results, states, t, w):
        """Add the slopes of the multipliers of steps that end at states (t, q, v, a, lam); t: their times; w (k, columns, n): all w."""
        works = SharedStates([AdjointMultipliers(*states, each.w, each.mu, each.kappa) for each in results], w)
        sweeps[0].totals.prepare(works)
        for sweep, work, result in zip(sweeps, works, results):
            sweep.add(work, t)
            if self.stabilised:
                (ahead, slipped, eta), still = result.slips, np.zeros_like(work.q)
                sweep.add(AdjointMultipliers(*states[:2], still, slipped, eta, ahead), t)
                sweep.add(AdjointMultipliers(*states[:2], still, still, np.zeros_like(eta), -ahead), t)

    def linearised(self, number, q, v):
        """The places (count, n) at which steps are linearised; q, v: their ends, the first of this number."""
        return q

    def observe(self, segment, first, t, motion, slopes, result):
        """Take the multipliers of steps from state number `first`.

        t (count,): times of their ends, beside kinks; motion: of `_motion`; slopes: of the objective; result: SweepResult with y and z.
        """

    def observe_start(self, segment, adjoints):
        """Take the AdjointState of the state from which the steps of a segment begin."""

    def _step_slope(self, segment, q, v, slip, y, z):
        """The slope in h of steps with multipliers y and z; q and v: of `_motion`; slip: what the stabilised form adds to q, or None."""
        moved = np.diff(q, axis=0) - (0.0 if slip is None else slip)
        by_h = np.sum(y * (2.0 * moved / segment.h - v[:-1])) + np.sum(z * np.diff(v, axis=0)) / segment.h
        return -by_h

    def _start_slopes(self, segment, adjoints):
        """The slopes of a segment's start in h, and in h of the segment before."""
        (state, _), slopes = self.ready[segment.first], [0.0, 0.0]
        for k, h in enumerate((segment.h, segment.before)[: 1 + (segment.kind == "on")]):
            for s, weight in ((SMALL, 0.5), (-SMALL, -0.5)):
                moved = state if k == 0 else replace(state, memory=state.memory | {"h": h * (1.0 + s)})
                ready = started(self.settings, self.model, moved, segment.h * (1.0 + s) if k == 0 else segment.h)
                vectors = ready.q, ready.v, ready.a, ready.memory["a_alg"]
                slopes[k] += weight * sum(float(adjoint @ x) for adjoint, x in zip(adjoints, vectors)) / (SMALL * h)
        return slopes

    def _segment_start(self, segment, adjoints):
        """Yield (AdjointState, adjoint of lam (m,), entries for parameters) of the state before a segment's start, one per objective.

        The start procedure gives consistent accelerations and a_alg. adjoints: for each objective the adjoints of q, v, a and a_alg after
        it, (n,) each.
        """
        state, tape = stored_state(self.history, segment.first), Tape()
        taped = TapedModel(self.model, tape)
        first = q, v, a, lam, ahead = [tape.var(x) for x in (state.q, state.v, state.a, state.lam, state.a)]
        ready = started(self.settings, taped, State(state.t, q, v, a, lam, segment.memory(ahead)), segment.h)
        for number, after in enumerate(adjoints, 1):
            for var in first:
                var.adjoint = np.zeros_like(var.value)
            taped.entries = []
            for var, adjoint in zip((ready.q, ready.v, ready.a, ready.memory["a_alg"]), after):
                add_to(var, adjoint)
            tape.back(again=number < len(adjoints))
            yield AdjointState(q.adjoint, v.adjoint, a.adjoint, ahead.adjoint), lam.adjoint, taped.entries


def _with_last(slopes, adjoint, rows):
    """The Slopes with the adjoint of the multipliers of the last state, (m,); rows (count, m)."""
    if not adjoint.any():
        return slopes
    lam = np.zeros(rows.shape) if slopes.lam is None else np.array(slopes.lam)
    lam[-1] += adjoint
    return replace(slopes, lam=lam)
