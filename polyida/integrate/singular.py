"""Watches from state to state, the same for every integrator, whether the constraints stay independent of each other.

Where phi_q loses rank a mechanism can branch: what comes behind follows from round-off. With the rows of phi_q made of
length one, a state is singular where their smallest singular value s is zero. Between two states it was zero where
s_0 + s_1 is not more than the way that the rows went (no singular value changes by more than the matrix) and their space
came back reversed: then `det(B_0 B_1^T) < 0`, which no smooth step does. Of a scene compiled code proves for nearly every state
that it is neither (assembly/independence.py), and only the others are looked at here.
"""

from polyida.assembly.independence import UnitRows
from polyida.errors import StepFailure
from polyida.linear.saddle import between, coordinate_sizes, cosine, involved, least, rows_of, way
from polyida.model.guarded import Compiled, unguarded
from polyida.system.python import small_own

ZERO = 1e-6  # a smallest singular value that counts as none
NEAR = 1e-3  # one that is told beside a failure
AHEAD = 0.1  # of the last step, over which the speed of the rows is measured
MOST = 32  # steps from look to look: what rests may begin to turn
REVERSED = 0.5  # cosine of the turn of the rows' space below which the way between two states led through zero


class SingularPosition(StepFailure):
    """The constraints of a state, or on the way to it, were not independent of each other."""


class Watch:
    """Begins at a state; `look` looks at the next ones. Of rows that do not vary nothing is looked at.

    Where it looks at every state of a model that is no scene, it looks again when the rows, at the pace they have, will have gone a
    quarter of the way to zero.
    """

    def __init__(self, model, state):
        varies = model.m > 0 and (model.needs.phi_q_varies or model.needs.driven)
        self.model, self.steps, self.state, self.h, self.pace = model, 0, state, 0.0, 0.0
        self.every = model.looks_apart if varies else 0
        self.proof = self._proof(state) if self.every == 1 else None
        if varies:
            self.sizes = self.proof.sizes if self.proof else coordinate_sizes(model, state.q)
            self.t = self.due = state.t
            if not (self.proof and self.proof.begin(state)):
                self.rows, self.least = self._look(state)

    def _proof(self, state):
        """What proves in compiled code that states are sound, or None."""
        if self.model.is_scene:
            return UnitRows(self.model, state)
        compiled = small_own(self.model) and unguarded(self.model).by_numba
        return UnitRows(self.model, state, Compiled(self.model, ("phi_q",))) if compiled else None

    def look(self, stretch):
        """Look at the next accepted states: (how many are sound, the StepFailure where the next one, or the way to it, is singular, or None)."""
        k, before = 0, self.state.t
        try:
            for k in self._asked(stretch):
                state = stretch.state(k)
                self.state, self.h = state, state.t - (stretch.t[k - 1] if k else before)
                self._step(state)
        except SingularPosition as failure:
            return k, failure
        self.steps, self.state = self.steps + len(stretch), stretch.last
        self.h = self.state.t - (float(stretch.t[-2]) if len(stretch) > 1 else before)
        return len(stretch), None

    def _asked(self, stretch):
        """The numbers of the states of a stretch that are to be looked at."""
        if self.proof:
            for k in self.proof.unproven(stretch):
                self._recall(stretch.t[k])
                yield k
        elif self.every:
            yield from (k for k in range(-(self.steps + 1) % self.every, len(stretch), self.every) if not stretch.t[k] < self.due)

    def _recall(self, t):
        """Take the last state before t that the proof refers to for the one that was looked at last."""
        self.t, q = self.proof.before(t)
        self.rows = rows_of(self.model.phi_q(self.t, q), self.sizes)
        self.least = least(self.rows)

    def _step(self, state):
        rows, now = self._look(state)
        if self.every == 1:
            self._require_no_passage(state.t, rows, now)
        self.pace = self._pace(now)
        self.t, self.rows, self.least = state.t, rows, now

    def _pace(self, now):
        """How fast the square of the smallest singular value falls, 1/s, since the last look: straight to where a motion ends."""
        since = self.state.t - self.t
        return (self.least**2 - now**2) / since if since else self.pace

    def _look(self, state):
        rows = rows_of(self.model.phi_q(state.t, state.q), self.sizes)
        size = least(rows)
        if size <= ZERO:
            raise self._failure(rows, state.t)
        return rows, size

    def _require_no_passage(self, t, rows, now):
        before, products = self.least, between(self.rows, rows)
        gone, since = way(products), t - self.t
        if now + before <= gone and cosine(self.rows, rows, products) < REVERSED:
            raise self._failure(rows if now < before else self.rows, self.t + since * before / (before + now))
        if self.proof:
            return
        speed = max(gone / since if since else 0.0, self._speed(rows))
        self.due = t + min(2.0 * since, MOST * self.h, 0.25 * now / max(speed, 1e-300))

    def _speed(self, rows):
        """How fast the unit rows go at the last state, 1/s: from one look to the next they may come round to where they were."""
        ahead, state = AHEAD * self.h, self.state
        if not ahead:
            return 0.0
        q = state.q + ahead * state.v
        return way(between(rows, rows_of(self.model.phi_q(state.t + ahead, q), self.sizes))) / ahead

    def suspicion(self, t):
        """What to say beside a failure at t where phi_q was about to lose its rank, or nothing."""
        if not self.every:
            return ""
        if self.proof:
            self._recall(self.state.t)
        rows = rows_of(self.model.phi_q(self.state.t, self.state.q), self.sizes)
        now, left = least(rows), 2.0 * max(t - self.state.t, self.h)  # s: within the next two steps
        if now < NEAR or now**2 < left * self._pace(now):
            return f"; the constraints {involved(self.model, rows)} are near a singular position"
        return ""

    def _failure(self, rows, t):
        names = involved(self.model, rows)
        reason = f"a singular position: there the constraints {names} are not independent of each other and the motion can branch"
        return SingularPosition("singular", reason, t)
