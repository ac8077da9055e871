"""A run of generalized-alpha backward: the steps of each segment by a sweep, its beginning on a tape.

What a segment began with is made again from the states by the method's own code (integrate/alpha/start.py), and so is its adjoint. Times of
kinks that move with a parameter change h: in Newmark's formulas, `-dh/dp sum y . (2 (q_1 - q_0)/h - v_0) + z . (v_1 - v_0)/h`, and in what a
segment begins with, by differences of that.
"""

from collections import deque
from dataclasses import replace

import numpy as np

from polyida.adjoint.alpha.sweep import AdjointState, Sweep
from polyida.adjoint.history import replayed_state, step_history
from polyida.adjoint.parameters.parameter import AdjointMultipliers, stacked
from polyida.adjoint.run import RunAdjoint
from polyida.adjoint.taped import Tape, TapedModel, add_to
from polyida.errors import InputError
from polyida.integrate.alpha.start import started
from polyida.integrate.kinks import inner_side
from polyida.integrate.state import State
from polyida.linear.lu import Kept

CHUNK = 4_000_000  # bytes of multipliers that are held at once
LONGEST = 256  # steps of a sweep at once
AT_ONCE = 64  # steps that are read at once
SMALL = 1e-4  # of h, by which it is changed in differences


class AlphaAdjoint(RunAdjoint):
    """A run backward; ready: of each segment's first number (its State, the State `started` made of it), where these are asked for."""

    history_of = staticmethod(step_history)

    def __init__(self, run, objective, names, memory_limit):
        super().__init__(run, objective, names, memory_limit)
        self.sweeps, self.ready = Kept(), {}
        self.stabilised = self.settings.form == "stabilised" and self.model.m > 0
        if self.stabilised or self.events.speeds:
            ahead = None
            for segment in self.history.segments:
                state = replayed_state(self.history, segment.first, segment.memory(ahead))
                self.ready[segment.first] = state, started(self.settings, self.model, state, segment.h)
                ahead = deque(self._formula_steps(segment), maxlen=1).pop()[1]

    @staticmethod
    def require_settings(settings):
        """Raise InputError if frames are those of two runs."""
        if settings.extrapolate:
            raise InputError("gradient: extrapolate = True makes frames of two runs; take the gradient of one without")

    def _formula_steps(self, segment):
        """(slip, A) at the end of each step of a segment: `slip = q_1 - (q_0 + h v_0 + h^2 ((1/2 - beta) A_0 + beta A_1))`."""
        (_, ready), c, h, end = self.ready[segment.first], self.settings.coefficients, segment.h, segment.first + segment.count + 1
        q, v, a, ahead = ready.q, ready.v, ready.a, ready.memory["a_alg"]
        for first in range(segment.first + 1, end, AT_ONCE):
            _, *vectors, _ = self.history.states(first, min(first + AT_ONCE, end))
            for q1, v1, a1 in zip(*vectors):
                ahead_1 = ((1 - c.alpha_f) * a1 + c.alpha_f * a - c.alpha_m * ahead) / (1 - c.alpha_m)
                yield q1 - (q + h * v + h * h * ((0.5 - c.beta) * ahead + c.beta * ahead_1)), ahead_1
                q, v, a, ahead = q1, v1, a1, ahead_1

    def through(self, progress):
        """The bars of q, v, a and lam of the run's first state."""
        bars, lam = AdjointState(*np.zeros((4, self.model.n))), np.zeros(self.model.m)
        for segment in reversed(self.history.segments):
            bars = self._steps(segment, bars, lam, progress)
            if self.events.speeds:
                self._stretch_beginning(segment, bars)
            bars, lam, entries = self._beginning(segment, bars)
            if entries:
                at = stacked(entries)
                self.add(at, np.repeat(self.history.states(segment.first, segment.first + 1)[0], len(at.t)))
        return *bars[:3], lam

    def _steps(self, segment, bars, lam, progress):
        """The AdjointState of what a segment began with; lam: the bar of the multipliers of its last state."""
        sweep, end = self._sweep(segment.h), segment.first + segment.count
        slips = np.array([slip for slip, _ in self._formula_steps(segment)]) if self.stabilised else None
        longest = int(max(1, min(LONGEST, CHUNK // (8 * self.model.n))))
        for last in range(end, segment.first, -longest):
            first = max(segment.first, last - longest)
            t, q, v, a, rows = self.history.states(first + 1, last + 1)
            own, inner = self.own.of(first + 1, last + 1), t
            if last == end:
                inner, own = np.append(t[:-1], inner_side(self.model, t[-1], segment.h)), _with_last(own, lam, rows.shape)
            slip = slips[first - segment.first : last - segment.first] if self.stabilised else None
            keep = tuple(np.empty((2, *q.shape))) if self.events.speeds else None
            swept = sweep.back(inner, q, v, a, rows, own, bars, keep, slip)
            self.add(AdjointMultipliers(inner, q, v, a, rows, swept.w, swept.mu, swept.kappa), t)
            if self.stabilised:
                (ahead, slipped, eta), still = swept.slips, np.zeros_like(q)
                self.add(AdjointMultipliers(inner, q, still, slipped, eta, ahead), t)
                self.add(AdjointMultipliers(inner, q, still, still, np.zeros_like(eta), -ahead), t)
            if keep:
                self._stretch(segment, first, q - slip if self.stabilised else q, v, *keep)
                if (by_time := own.by_time()) is not None:
                    self.events.at(t, by_time)
            bars = swept.bars
            progress(float(t[0]))
        return bars

    def _sweep(self, h):
        """The sweep of steps of this size, with the factor that it has where it is one of the last."""
        key = f"{h:.9e}"
        found = self.sweeps.take(key) or Sweep(self.model, self.settings, h, self.counts)
        self.sweeps.keep(key, found)
        return found

    def _stretch(self, segment, first, q, v, y, z):
        """Add the slope in h of steps from state number `first` to q and v, slips of q left out, with their multipliers y and z."""
        _, q0, v0, _, _ = self.history.states(first, first + len(q))
        if first == segment.first:
            v0 = np.concatenate([self.ready[first][1].v[None], v0[1:]])
        self.events.stretch(segment, -(np.sum(y * (2.0 * (q - q0) / segment.h - v0)) + np.sum(z * (v - v0)) / segment.h))

    def _stretch_beginning(self, segment, bars):
        """Add the slopes in h, and in h of the segment before, of what a segment's first step began with."""
        (state, _), slopes = self.ready[segment.first], [0.0, 0.0]
        for k, h in enumerate((segment.h, segment.before)[: 1 + (segment.kind == "on")]):
            for s, weight in ((SMALL, 0.5), (-SMALL, -0.5)):
                moved = state if k == 0 else replace(state, memory=state.memory | {"h": h * (1.0 + s)})
                ready = started(self.settings, self.model, moved, segment.h * (1.0 + s) if k == 0 else segment.h)
                made = ready.q, ready.v, ready.a, ready.memory["a_alg"]
                slopes[k] += weight * sum(float(bar @ x) for bar, x in zip(bars, made)) / (SMALL * h)
        self.events.stretch(segment, *slopes)

    def _beginning(self, segment, bars):
        """(AdjointState, bar of lam, entries for parameters) of the state that a segment began from; bars: of what its first step began with."""
        state, tape = replayed_state(self.history, segment.first), Tape()
        taped = TapedModel(self.model, tape)
        q, v, a, lam, ahead = (tape.var(x) for x in (state.q, state.v, state.a, state.lam, state.a))
        ready = started(self.settings, taped, State(state.t, q, v, a, lam, segment.memory(ahead)), segment.h)
        for var, bar in zip((ready.q, ready.v, ready.a, ready.memory["a_alg"]), bars):
            add_to(var, bar)
        tape.back()
        return AdjointState(q.bar, v.bar, a.bar, ahead.bar), lam.bar, taped.entries


def _with_last(own, bar, shape):
    """Slopes with more of the multipliers of the last state."""
    if not bar.any():
        return own
    lam = np.zeros(shape) if own.lam is None else np.array(own.lam)
    lam[-1] += bar
    return replace(own, lam=lam)
