"""Detection of singular positions from state to state, the same for every integrator: constraints that depend on each other.

If phi_q loses rank, a mechanism can branch and the further motion follows from round-off. With the rows of phi_q scaled to length one, a state is
singular if their smallest singular value s is zero. Between two states s was zero if s_0 + s_1 is not more than the distance that the rows moved
(no singular value changes by more than the matrix) and their space is reversed: `det(B_0 B_1^T) < 0`. In a step in which a body turns far, rows
are reversed too, and regular all the time: so this must hold for one half of the step, one half of this, and so on.

`Watch.look` takes accepted states in this order: which of them to examine (`_to_examine`), the rows and s of each (`_examined`), whether s
was zero since the state examined before (`_require_no_passage`, `_require_no_passage_within` for parts of a step), and when the next one is due
(`_time_to_wait`). For nearly every state of a scene compiled code proves that s is not zero there and was not before
(assembly/independence.py); only the others are examined here.
"""

from typing import NamedTuple

import numpy as np

from polyida.assembly.independence import UnitRows
from polyida.errors import StepFailure
from polyida.integrate.state import between as state_between
from polyida.linear.saddle import coordinate_sizes, cosine, involved, least, path_length, rows_of
from polyida.model.compiled import Compiled
from polyida.system.own import small_own

ZERO = 1e-6  # a smallest singular value that is zero
NEAR = 1e-3  # one that a failure reports
AHEAD = 0.1  # of the last step: distance over which the speed of the rows is measured
MOST = 32  # steps between two examinations, because what rests may begin to turn
REVERSED = 0.5  # cosine of the turn of the rows' space below which s was zero between two states
BISECTIONS = 6  # of a step in whose parts the same must hold
OFF = 0.02  # of the model's size: |phi| of an interpolated state beyond which it does not show how the bodies moved in a step


class SingularPosition(StepFailure):
    """The constraints of a state, or between two states, were not independent."""


class Examined(NamedTuple):
    """The rows of phi_q at a time, scaled to length one, and their smallest singular value."""

    t: float
    rows: np.ndarray
    least: float


class Watch:
    """Begins at a state; `look` examines the next ones. For models whose phi_q varies.

    A model that is no scene is examined again before the rows, at their present speed, have moved a quarter of the distance to a singular
    position.
    """

    def __init__(self, model, state):
        """Begin at a state, which is examined unless it is proved to be regular."""
        self.model = model
        self.state = state  # the last one that was taken
        self.h = 0.0  # s: its step
        self.speed = 0.0  # rate, 1/s, at which s^2 falls
        self.steps = 0  # number of states taken
        self.every = model.looks_apart  # one in so many states is examined
        self.proof = None  # of regular states
        if self.every == 1 and model.is_scene:
            self.proof = UnitRows(model, state)
        elif self.every == 1 and small_own(model) and model.by_numba:
            self.proof = UnitRows(model, state, Compiled(model, ("phi_q",)))
        self.sizes = self.proof.sizes if self.proof else coordinate_sizes(model, state.q)
        self.due = state.t  # none is examined before; known, below: the Examined of the last state that was
        if not (self.proof and self.proof.begin(state)):
            self.known = self._examined(state)

    def look(self, stretch):
        """Examine the next accepted states: (number of regular ones, the StepFailure if the next one is singular or behind a singular position)."""
        k, begin = 0, self.state
        before = begin.t
        try:
            for k in self._to_examine(stretch):
                state = stretch.state(k)
                self.state, self.h = state, state.t - (stretch.t[k - 1] if k else before)
                now = self._examined(state)
                if self.every == 1:
                    self._require_no_passage(stretch.state(k - 1) if k else begin, now)
                self.speed = self._speed_of_least(now.least)
                self.known = now
        except SingularPosition as failure:
            return k, failure
        self.steps, self.state = self.steps + len(stretch), stretch.last
        self.h = self.state.t - (float(stretch.t[-2]) if len(stretch) > 1 else before)
        return len(stretch), None

    def _to_examine(self, stretch):
        """Numbers of the states of a stretch that are examined."""
        if self.proof:
            for k in self.proof.unproven(stretch):
                self._recall(stretch.t[k])
                yield k
        else:
            yield from (k for k in range(-(self.steps + 1) % self.every, len(stretch), self.every) if not stretch.t[k] < self.due)

    def _recall(self, t):
        """Set the state that was examined last to the last one before t that the proof refers to."""
        t, q = self.proof.before(t)
        rows = self._rows(t, q)
        self.known = Examined(t, rows, least(rows))

    def _rows(self, t, q):
        """phi_q with rows scaled to length one."""
        return rows_of(self.model.phi_q(t, q), self.sizes)

    def _speed_of_least(self, size):
        """Mean rate, 1/s, at which s^2 has fallen to size^2 since the last examination; s is the smallest singular value of the unit rows.

        s^2 falls in proportion to time before a singular position at which the motion ends.
        """
        since = self.state.t - self.known.t
        return (self.known.least**2 - size**2) / since if since else self.speed

    def _examined(self, state):
        """The Examined of a state. Raises SingularPosition."""
        rows = self._rows(state.t, state.q)
        size = least(rows)
        if size <= ZERO:
            raise self._failure(rows, state.t)
        return Examined(state.t, rows, size)

    def _require_no_passage(self, previous, now):
        """Raise SingularPosition if s was zero between the state examined before and the present one; previous: the State before it."""
        moved = path_length(self.known.rows, now.rows)
        if _reversed(self.known, now, moved):
            begin = self._examined(previous)
            self._require_no_passage_within(None, None, self.known, begin, 0)
            self._require_no_passage_within(previous, self.state, begin, now, BISECTIONS)
        if not self.proof:
            self.due = now.t + self._time_to_wait(now, moved)

    def _time_to_wait(self, now, moved):
        """Time from the present state until the next one must be examined, s; moved: how far the rows moved since the last examination."""
        state, since, ahead = self.state, now.t - self.known.t, AHEAD * self.h
        speed = moved / since if since else 0.0
        if ahead:  # the speed at the last state: since the last examination the rows may have come back to where they were
            q = state.q + ahead * state.v
            speed = max(speed, path_length(now.rows, self._rows(state.t + ahead, q)) / ahead)
        return min(2.0 * since, MOST * self.h, 0.25 * now.least / max(speed, 1e-300))

    def _require_no_passage_within(self, before, after, begin, end, depth):
        """Raise SingularPosition if s was zero between `begin` and `end`, Examined within the step between two States, which is halved.

        depth: number of halvings that are left.
        """
        if not _reversed(begin, end, path_length(begin.rows, end.rows)):
            return
        if depth == 0:
            t = begin.t + (end.t - begin.t) * begin.least / (begin.least + end.least)
            raise self._failure(end.rows if end.least < begin.least else begin.rows, t)
        state = state_between(before, after, 0.5 * (begin.t + end.t))
        if np.abs(self.model.phi(state.t, state.q)).max() > OFF * (self.model.extent or 1.0):
            return  # the polynomial of a step in which bodies turn far may pass through zero, where their directions have no length
        middle = self._examined(state)
        self._require_no_passage_within(before, after, begin, middle, depth - 1)
        self._require_no_passage_within(before, after, middle, end, depth - 1)

    def suspicion(self, t):
        """Text beside a failure at t if phi_q was about to lose rank, else empty."""
        if self.proof:
            self._recall(self.state.t)
        rows = self._rows(self.state.t, self.state.q)
        size, time = least(rows), 2.0 * max(t - self.state.t, self.h)  # s: within the next two steps
        if size < NEAR or size**2 < time * self._speed_of_least(size):
            return f"; the constraints {involved(self.model, rows)} are near a singular position"
        return ""

    def _failure(self, rows, t):
        """The SingularPosition at t, which names the constraints of these rows that depend on each other."""
        names = involved(self.model, rows)
        reason = f"a singular position: there the constraints {names} are not independent of each other and the motion can branch"
        return SingularPosition("singular", reason, t)


def _reversed(begin, end, moved):
    """True if the rows of two Examined may have lost rank between them; moved: how far they have moved."""
    return begin.least + end.least <= moved and cosine(begin.rows, end.rows) < REVERSED
