"""Switches of a model: where one of its `gaps` changes sign, a force comes or goes. Steps end there, and none hides one between its ends.

Each step is looked at between its ends, on the motion that its integrator gives or on the cubic through q and v: for changes of sign of every
gap, and for its least value, which its rate brackets (integrate/gaps.py). A step that crosses is discarded. Shorter ones are tried until one
ends on the near side of the switch, and the run goes on from there, with the forces of the far side where they jump.

While a gap is closed a step may change its rate only by a share of the largest one since it closed; by less where steps are of fixed size or
of second order. Where the shortest step changes it by more, the run says so (`unresolved`), and begins anew behind a step in which the forces
turn round.

Generalized-alpha takes stretches of steps at once and gives a memory to go on from at the end of one only. Equal steps are as many as are
far from a switch; where one of them is discarded all the same, the stretch is taken again up to it. Adaptive steps, whose times depend on
where a stretch began, are single.
"""

import math
from functools import partial

import numpy as np

from polyida.errors import StepFailure
from polyida.integrate.gaps import Crossing, Gaps
from polyida.integrate.sizes import sizes_of_run
from polyida.integrate.start import consistent_acceleration
from polyida.integrate.state import State, between

NEAR = 1e-9  # of a gap's size in a step: so near to zero a step ends
TOGETHER = 1e-4  # of a step: gaps that switch within it switch together, and one so near to its beginning there
FIXED, VARIABLE = 0.1, 0.5  # of a gap's largest rate since it closed: by how much a step may change it
BENT = 1e-3  # of the same: by how much a step of second order may be wrong in it, `h / 12` times the change of what forces make of it
SMALL = 1e-2  # of the largest rate seen: a gap that closed with less is taken as if it had closed with that
FINEST = 256  # parts of a fixed step, at most
FAR = 4.0  # gaps that are farther from zero than so many steps at their largest rate are not looked at between the ends of one
STRETCH = 256  # steps, at most
TRIALS, PATIENCE = 60, 3  # steps tried to end at one switch; of those that bring its bounds nearer by less than half, before bisection
AGAIN, STANDING = 20, 1e-9  # a gap that switches so often in a row, each time within that share of the run, does so without end
BETWEEN = 1e-2  # of a jump of q'': a step that ends there and is off its near side by more has ended within the jump
KEPT = ("sizes", "rtol", "tolerances", "mu", "ladder")  # of the memory of a state, behind a jump of forces
FAILURES = 6  # fixed steps in a row that fail, each a quarter of the one before
ROWS = ("sides", "speeds", "peaks", "offsets", "flips", "turns", "times")  # of what is remembered of each gap


def steps_of(taken, integrator, model, state, t_end, counts):
    """The states of a run: those of the integrator's own steps, `taken(integrator, state, t_end)`, which end at the switches of the model.

    Raises StepFailure.
    """
    return Switches(taken, integrator, model, state, t_end, counts).run() if model.switching else taken(integrator, state, t_end)


def unresolved(model, integrator, state):
    """In words, the gaps whose rate changes too much in steps that can be no shorter, up to a state; empty where there are none."""
    kept = state.memory.get("switches", ()) if model.switching else ()
    turns, times = np.reshape(kept[2:], (len(ROWS), -1))[-2:] if len(kept) else np.zeros((2, 0))
    least = f"h/{FINEST}" if integrator.fixed_step() else f"{STANDING:g} of the run's time"
    return "; ".join(
        f"at t = {times[k]:.6g} s the shortest step, {least}, is too long for {model.gap_names()[k]}: the rate of its gap changes there by "
        f"{100 * turns[k]:.3g} % of the largest since it closed; take a smaller h or rtol"
        for k in np.flatnonzero(turns)
    )


class Switches:
    """The states of a run of a model with gaps, from `state` to t_end: `run` yields them.

    taken: a function (integrator, state, t_end) that gives the states of the integrator's own steps. State.memory "switches" is what a run
    goes on from: bound: no step is longer, 0 where any may be; goal: a time at which a step ends, 0 where none is known; and for each gap
    sides: 1 open, -1 closed, 0 not known yet; speeds: its largest rate since it closed, 0 where it was closed from the start or is open;
    peaks: its largest rate so far; offsets: how far from zero it was when it switched last; flips: 1 where it switches at the goal; turns,
    times: the largest change of its rate in a step that could be no shorter, over `speeds`, and the end of that step, s. State.memory
    "stretch": how many steps may be taken from there before any is looked at.
    """

    def __init__(self, taken, integrator, model, state, t_end, counts):
        self.model, self.counts, self.t_end, self.span = model, counts, t_end, t_end - state.t
        self.h = integrator.fixed_step()
        self.coarse = bool(self.h) or integrator.second_order
        self.finest = self.h / FINEST if self.h else STANDING * self.span
        self.taken, self.integrator = taken, integrator.without_halving()
        self.gaps, self.switched, self.jumped = Gaps(model, state, self.span), {}, False
        self.state = State(state.t, state.q, state.v, state.a, state.lam, {"sizes": sizes_of_run(model, state, t_end)} | state.memory)
        self.whole, self.since = self.state, 0
        self._recall()

    def _recall(self):
        state = self.state
        self.here = seen = self.gaps.at(state.t, state.q, state.v)
        kept, count = state.memory.get("switches"), len(seen.gap)
        if np.shape(kept) != (2 + len(ROWS) * count,):
            near, rate = np.abs(seen.gap) <= self.gaps.least(state.q), np.abs(seen.rate)
            sides = np.where(near, np.sign(seen.rate), np.sign(seen.gap))
            rows = sides, np.where(sides < 0, rate, 0.0), rate, np.where(near, np.abs(seen.gap), 0.0), *np.zeros((3, count))
            kept = np.concatenate([np.zeros(2), *rows])
        self.bound, self.goal = float(kept[0]), float(kept[1])
        for name, row in zip(ROWS, np.array(kept[2:]).reshape(-1, count)):
            setattr(self, name, row)

    def run(self):
        """Yield the states. Raises StepFailure."""
        failed = 0
        while self.state.t < self.t_end:
            before, t = self.counts.steps, self.state.t
            try:
                yield from self._piece()
                failed = 0
            except StepFailure:
                failed = failed + 1 if self.state.t == t else 1
                if not self.h or failed > FAILURES:
                    raise
                self.counts.steps, self.counts.rejected = max(before, self.counts.steps), self.counts.rejected + 1
                self._shorter((self.bound or self.h) / 4)

    def _piece(self):
        """Yield states up to the goal, the end or the first step that is discarded."""
        if self.bound and not self.goal:
            self.goal = self.state.t + self.bound if self.state.t + 1.5 * self.bound < self.t_end else self.t_end
        self.end = end = self.goal or self.t_end
        steps = self.counts.steps
        for after in self.taken(self.integrator, self.state, end):
            crossing, shorter = self._look(self.state, after)
            if crossing or shorter:
                self.counts.steps, self.counts.rejected = steps, self.counts.rejected + 1
                self._take_stretch_again()
                if crossing:
                    yield from self._to_switch(after, crossing)
                else:
                    self._shorter(shorter)
                return
            accepted = self._accept(after)
            yield accepted
            steps = self.counts.steps
            if accepted is not after or end != (self.goal or self.t_end):
                return

    def _take_stretch_again(self):
        """Have the last accepted state, which may be within a stretch, remember all that a run goes on from."""
        if self.state.restart:
            return
        begin, steps = self.whole, self.counts.steps
        memory = begin.memory | {"stretch": self.since}
        for state in self.taken(self.integrator, State(begin.t, begin.q, begin.v, begin.a, begin.lam, memory), self.end):
            if state.t >= self.state.t:
                break
        self.counts.steps, self.state = steps, state

    def _shorter(self, bound):
        self._take_stretch_again()
        self.bound, self.goal, self.flips = bound, 0.0, np.zeros(len(self.flips))

    def _accept(self, after):
        """The state, accepted, with all that the run goes on from."""
        self.here, length = self.ahead, after.t - self.state.t
        rate = np.abs(self.here.rate)
        self.peaks, self.speeds = np.maximum(self.peaks, rate), np.where(self.speeds > 0, np.maximum(self.speeds, rate), 0.0)
        self.sides = np.where((self.sides == 0) & (np.abs(self.here.gap) > self.gaps.least(after.q)), np.sign(self.here.gap), self.sides)
        if self.turned is not None:
            self.times = np.where(self.turned > self.turns, after.t, self.times)
            self.turns = np.maximum(self.turns, self.turned)
            after = self._anew(after, after.a, after.lam) if self.turned.max() > VARIABLE else after
        if self.goal and after.t >= self.goal:
            self.goal, hit = 0.0, self.flips > 0
            if hit.any():
                after = self._flipped(after, hit)
            elif self.bound:
                grown = 2 * self.bound if self.changed < 0.4 else self.bound
                goes_on = grown < self.h if self.h else self.coarse and length > 0.4 * self.bound
                self.bound = grown if goes_on and (self.sides < 0).any() else 0.0
        self.state, self.since = after, self.since + 1
        if after.restart:
            self.whole, self.since = after, 0
            after.memory["switches"] = np.concatenate([[self.bound, self.goal], *(getattr(self, name) for name in ROWS)])
            after.memory["stretch"] = float(self._far(length) if self.h else 1)
            if self.jumped:
                after.memory["jumped"], self.jumped = 1.0, False
        return after

    def _far(self, length):
        """How many steps of a length may be taken before one is looked at: half of those to the next switch at the present rates."""
        most = 0.5 * float((np.abs(self.here.gap) / np.maximum(np.abs(self.here.rate) * length, 1e-300)).min())
        return int(min(max(most, 1.0), STRETCH))

    def _flipped(self, state, hit):
        """The state at which gaps switch, with the forces of the far side, where they jump."""
        seen = self.here
        for k in np.flatnonzero(hit):
            t, times = self.switched.get(k, (-np.inf, 0))
            times = times + 1 if state.t - t < STANDING * self.span else 0
            self.switched[k] = state.t, times
            if times > AGAIN:
                raise StepFailure("switching", f"the gap of {self.gaps.names(k)} opens and closes without end", state.t)
        self.sides = np.where(hit, -self.sides, self.sides)
        self.speeds = np.where(hit, np.where(self.sides < 0, np.abs(seen.rate), 0.0), self.speeds)
        self.offsets, self.flips, self.bound = np.where(hit, np.abs(seen.gap), self.offsets), np.zeros(len(hit)), 0.0
        s = self.gaps.jump(state, hit, seen)
        return self._anew(state, *consistent_acceleration(self.model, state.t, state.q + s * state.v, state.v)) if s else state

    def _anew(self, state, a, lam):
        """The state as one from which the integrator begins anew, with these a and lam: what it remembers is of other forces."""
        self.jumped = True
        memory = {name: value for name, value in state.memory.items() if name in KEPT}
        return State(state.t, state.q, state.v, a, lam, memory | {"cut": 0.0, "h": 0.0})

    def _within_jump(self, after, hit):
        """Whether a step ended on a jump of forces, with a force between those of both sides: no motion of either side goes there."""
        s = self.gaps.jump(after, hit, self.ahead)
        if not s:
            return False
        ahead, behind = (consistent_acceleration(self.model, after.t, after.q + e * after.v, after.v)[0] for e in (s, -s))
        found = after.memory.get("a_end", after.a)
        return np.abs(found - behind).max() > BETWEEN * np.abs(ahead - behind).max()

    def _look(self, state, after):
        """(the first Crossing in a step or None, the bound of a shorter one or 0)."""
        self.ahead, self.turned, self.changed = self.gaps.at(after.t, after.q, after.v), None, 0.0
        length, closed = after.t - state.t, (self.sides < 0) & (self.speeds > 0)
        if after.within is None and not closed.any():
            fastest = np.maximum(np.abs(self.here.rate), np.abs(self.ahead.rate))
            if (np.minimum(self.sides * self.here.gap, self.sides * self.ahead.gap) > FAR * length * fastest).all():
                return None, 0.0
        place, middle = partial(_place, state, after), state.t + 0.5 * length
        seen = self.here, self.gaps.at(middle, *place(middle)), self.ahead
        if closed.any() and (shorter := self._too_long(seen, state, after, closed)):
            return None, shorter
        self.near = NEAR * np.abs([each.gap for each in seen]).max(axis=0) + self.gaps.least(state.q)
        fresh = self._fresh()
        allowed = np.where(fresh, 4 * np.maximum(self.near, self.offsets), 0.0)
        crossing = self.gaps.first(seen, place, self.sides, allowed, self.near)
        if crossing is None:
            left = self.sides * self.ahead.gap
            reached = (left >= 0) & (left <= self.near) & (self.sides * self.ahead.rate < 0) & ~fresh
            if reached.any() and self._within_jump(after, reached):
                return Crossing(after.t, after.t, reached), 0.0
        return crossing, 0.0

    def _fresh(self):
        """Which gaps have just switched, and may be on either side of zero by the round-off of that."""
        return np.abs(self.here.gap) <= self.offsets

    def _too_long(self, seen, state, after, closed):
        """A shorter bound of the step, where it changes the rate of a closed gap by too much; 0 where it does not."""
        length, changes = after.t - state.t, np.ptp([each.rate for each in seen], axis=0)
        share = np.where(closed, 1.0 / np.maximum(np.maximum(self.speeds, SMALL * self.peaks), 1e-300), 0.0)
        self.changed = float((share * changes).max()) / (FIXED if self.coarse else VARIABLE)
        if self.coarse:
            bent = length / 12 * np.abs(self.gaps.pull(after) - self.gaps.pull(state))
            self.changed = max(self.changed, math.sqrt(float((share * bent).max()) / BENT))
        if self.changed <= 1.0:
            return 0.0
        if length > 1.01 * self.finest:
            return max(self.finest, 0.5 * length)
        self.turned = share * changes
        return 0.0

    def _to_switch(self, after, crossing):
        """Yield the states of a step, or a few, to the first switch; none where that is at its beginning."""
        state, whole = self.state, after.t - self.state.t
        near, beyond, t, hit, states, slow = state.t, after.t, crossing.guess, crossing.which, [], 0
        if t - state.t < TOGETHER * whole:
            self.state = self._flipped(state, hit)
            return
        for _ in range(TRIALS):
            wide = beyond - near
            tried, found = self._tried(t)
            if found is None and tried:
                states, near = tried, t
                left, falls = self.sides * self.ahead.gap, -self.sides * self.ahead.rate
                there = (left > 0) & (falls > 0) & ~self._fresh()
                if (there & (left <= self.near)).any():
                    hit = there & (left <= np.maximum(self.near, TOGETHER * falls * whole))
                    break
                ways = np.where(hit & (falls > 0), (left - 0.5 * self.near) / np.where(falls > 0, falls, 1.0), np.inf)
                t = near + float(ways.min())
            else:
                beyond = min(t, beyond)  # not where that step crosses: behind a jump of forces its motion is not that of a shorter one
                hit, t = (hit, near) if found is None else (found.which, found.guess)
            self.counts.rejected += 1
            slow = slow + 1 if beyond - near > 0.5 * wide else 0
            if beyond - near <= 8 * math.ulp(beyond):
                break
            if not near < t < beyond or slow > PATIENCE:
                t = 0.5 * (near + beyond)
        else:
            if not states:
                raise StepFailure("switching", f"no step ends where the gap of {self.gaps.names(hit)} changes sign", beyond)
            hit = np.zeros(len(hit), bool)
        if not states:
            self.state = self._flipped(state, hit)
            return
        if tried is not states:
            states, _ = self._tried(near)  # so that the steps taken last are those of the run
        self.goal, self.flips = near if hit.any() else 0.0, hit.astype(float)
        for state in states:
            self.counts.steps += 1
            self._look(self.state, state)
            yield self._accept(state)

    def _tried(self, t):
        """(states of a step, or a few, to t; their first Crossing or None), which count as no steps; no states where they fail."""
        here, steps, state, states = self.here, self.counts.steps, self.state, []
        try:
            for after in self.taken(self.integrator, state, t):
                crossing, _ = self._look(state, after)
                if crossing is not None:
                    return states, crossing
                state = after
                states.append(after)
                self.here = self.ahead
            return states, None
        except StepFailure:
            return [], None
        finally:
            self.here, self.counts.steps = here, steps


def _place(before, after, t):
    """(q, v) at t within a step."""
    state = between(before, after, t)
    return state.q, state.v
