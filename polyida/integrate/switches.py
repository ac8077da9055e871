"""Switches of a model: forces that begin or end where one of its `gaps` changes sign. Steps end there and do not cross a switch.

Each step is examined for sign changes of every gap, and for its minimum, which its rate brackets, on the integrator's own motion between the
ends of the step or on the cubic through q and v. A step that crosses a switch is discarded. Shorter ones are tried until one ends just before
the switch; the run goes on from there, with the forces of the far side if they jump.

While a gap is closed, a step may change its rate only by a share of the largest rate since it closed, and by less if steps are of fixed size
or of second order. If the shortest step changes it by more, the run reports it (`unresolved`), and starts anew behind a step in which the
forces reverse.

Generalized-alpha takes stretches of steps at once, and a run can go on from the end of a stretch only. Stretches of equal steps are as long as
the distance to the next switch allows; if one of their steps is discarded, the stretch is taken again up to it. Adaptive steps, whose times
depend on the beginning of the stretch, are single.
"""

import math
from dataclasses import dataclass, fields

import numpy as np

from polyida.errors import StepFailure
from polyida.integrate.crossings import Crossing, GapValues, first_crossing
from polyida.integrate.sizes import extent, sizes_of_run
from polyida.integrate.start import consistent_acceleration
from polyida.integrate.state import State, between

ZERO = 1e-13  # of the model's size: a gap of that size is zero
JUMP = 2.0  # forces jump if they change by less than that factor when the distance from the switch is four times as large
NEAR = 1e-9  # of a gap's size in a step: how near to zero a step ends
TOGETHER = 1e-4  # of a step: gaps that switch within that time switch together
FIXED = 0.1  # of a gap's largest rate since it closed: allowed change in a fixed step
VARIABLE = 0.5  # the same in a variable step
BENT = 1e-3  # of the same: allowed error of a step of second order, `h / 12` times the change of the gap's acceleration
SMALL = 1e-2  # of the largest rate so far: a gap that closed more slowly is treated as if it had closed at that rate
FINEST = 256  # parts of a fixed step, at most
FAR = 4.0  # a gap whose distance from zero is more than so many steps at its largest rate is not examined within the step
STRETCH = 256  # steps, at most
TRIALS = 60  # steps that are tried for one switch
PATIENCE = 3  # of those, that do not halve the bracket of the switch, before bisection
AGAIN = 20  # switches of one gap in a row that end the run, each within STANDING
STANDING = 1e-9  # of the run's time
BETWEEN = 1e-2  # of a jump of q'': a step that ends farther from the near side's value has ended within the jump
PRESERVED = ("sizes", "rtol", "tolerances", "mu", "ladder")  # of the memory of a state, behind a jump of forces
FAILURES = 6  # fixed steps in a row that fail, each a quarter of the one before


@dataclass
class GapRecord:
    """What a run knows of each gap: arrays (gaps,), in the order in which a memory stores them."""

    sides: np.ndarray  # 1 open, -1 closed, 0 unknown
    speeds: np.ndarray  # (unit of the gap)/s: largest rate since the gap closed, 0 if it is open or was closed from the start
    peaks: np.ndarray  # the same unit: largest rate so far
    offsets: np.ndarray  # the gap's unit: distance from zero when the gap switched last
    flips: np.ndarray  # 1 if the gap switches at the goal, else 0
    turns: np.ndarray  # largest change of the rate in a step of the least size, over `speeds`
    times: np.ndarray  # s: the end of that step

    @classmethod
    def begun(cls, here, near):
        """The record at the beginning of a run, from GapValues; near (gaps,): True for gaps that are zero up to round-off."""
        rate, zeros = np.abs(here.rate), np.zeros((3, len(near)))
        sides = np.where(near, np.sign(here.rate), np.sign(here.gap))
        return cls(sides, np.where(sides < 0, rate, 0.0), rate, np.where(near, np.abs(here.gap), 0.0), *zeros)

    @classmethod
    def of_memory(cls, memory):
        """The record in the entry "switches" of a memory, without its first two numbers; that of no gap if the entry is empty."""
        return cls(*np.array(memory[2:]).reshape(ROWS, -1))

    def to_memory(self, bound, goal):
        """The entry "switches" of a memory, (2 + 7 gaps,): bound and goal of Switches, and the arrays."""
        return np.concatenate([[bound, goal], self.sides, self.speeds, self.peaks, self.offsets, self.flips, self.turns, self.times])


ROWS = len(fields(GapRecord))


@dataclass
class Bracket:
    """The search for the first switch in a step."""

    near: float  # s: end of the best steps that do not cross
    beyond: float  # s: the least time at which a trial crossed or failed
    t: float  # s: end of the next trial
    which: np.ndarray  # (gaps,) True for the gaps that switch
    states: list  # the States of the best steps, up to `near`


def steps_of(own_steps, integrator, model, state, t_end, counts):
    """The states of a run, from the integrator's `own_steps(integrator, state, t_end)`, with steps that end at the switches of the model.

    Raises StepFailure.
    """
    return Switches(own_steps, integrator, model, state, t_end, counts).run() if model.switching else own_steps(integrator, state, t_end)


def unresolved(model, integrator, state):
    """Message of a model with switches about the gaps whose rate changes too much in the shortest steps, up to a state; empty if there are none."""
    memory = state.memory.get("switches", ())
    gaps = GapRecord.of_memory(memory)
    least = f"h/{FINEST}" if integrator.fixed_step() else f"{STANDING:g} of the run's time"
    return "; ".join(
        f"at t = {gaps.times[k]:.6g} s the shortest step, {least}, is too long for {model.gap_names()[k]}: the rate of its gap changes there by "
        f"{100 * gaps.turns[k]:.3g} % of the largest since it closed; take a smaller h or rtol"
        for k in np.flatnonzero(gaps.turns)
    )


class Switches:
    """The states of a run of a model with gaps, from `state` to t_end: `run` yields them.

    own_steps: a function (integrator, state, t_end) that gives the states of the integrator's own steps.

    `_piece` takes steps up to the goal, and `_examine` looks at each. A step that is refused is discarded (`_repeat_stretch`); then `_to_switch`
    goes to a crossing, and `_shorter` takes shorter steps. `_accept` takes the other ones, and `_store` writes what a run goes on from.

    A run goes on from two entries of State.memory: "switches" is that of `GapRecord.to_memory`; "stretch" is the number of steps that may be
    taken from there before any is examined.
    """

    def __init__(self, own_steps, integrator, model, state, t_end, counts):
        """Prepare a run; the memory of the state may be that of an earlier run."""
        self.model = model
        self.counts = counts
        self.t_end = t_end
        self.span = t_end - state.t
        self.own_steps = own_steps
        self.integrator = integrator.without_halving()
        self.h = integrator.fixed_step()  # s; 0 if steps vary
        self.coarse = bool(self.h) or integrator.second_order  # the rate of a closed gap may change less in a step
        self.finest = self.h / FINEST if self.h else STANDING * self.span  # s: the shortest step
        speed = float(np.abs(state.v).max(initial=0.0))
        self.difference_step = 1e-6 * min(extent(model, state.q) / speed if speed else np.inf, self.span)  # s: of central differences
        self.state = State(state.t, state.q, state.v, state.a, state.lam, {"sizes": sizes_of_run(model, state, t_end)} | state.memory)
        self.whole = self.state  # the last state from which a run can go on
        self.since = 0  # states accepted behind it
        self.switched = {}  # {gap: (t, times in a row)}
        self.jumped = False  # the next state from which a run can go on is marked "jumped"
        self.end = t_end  # s: of the present piece
        # of the step examined last:
        self.here = self.ahead = self._values(state.t, state.q, state.v)  # GapValues at its ends
        self.near = np.zeros(len(self.here.gap))  # (gaps,) the distance from zero at which it may end
        self.changed = 0.0  # largest change of a closed gap's rate over the allowed one
        self.turned = None  # (gaps,) these changes over the largest rates, if even the shortest step exceeds the allowed one
        memory, count = self.state.memory.get("switches"), len(self.here.gap)
        known = np.shape(memory) == (2 + ROWS * count,)
        self.bound = float(memory[0]) if known else 0.0  # s: no step is longer; 0 without a bound
        self.goal = float(memory[1]) if known else 0.0  # s: a time at which a step ends; 0 without one
        near = np.abs(self.here.gap) <= self._zero(state.q)
        self.gaps = GapRecord.of_memory(memory) if known else GapRecord.begun(self.here, near)

    def _values(self, t, q, v):
        """GapValues at t, the rates by central differences along the motion."""
        s = self.difference_step
        ahead, behind = (self.model.gaps(t + e, q + e * v) for e in (s, -s))
        return GapValues(t, self.model.gaps(t, q), (ahead - behind) / (2 * s))

    def _zero(self, q):
        """The distance that is zero up to round-off, m."""
        return ZERO * extent(self.model, q)

    def _names(self, which):
        """Names of the gaps `which`, an index or a mask, joined by "and"."""
        return " and ".join(np.atleast_1d(np.array(self.model.gap_names(), object)[which]))

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
        for after in self.own_steps(self.integrator, self.state, end):
            crossing, shorter = self._examine(self.state, after)
            if crossing or shorter:
                self.counts.steps, self.counts.rejected = steps, self.counts.rejected + 1
                self._repeat_stretch()
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

    def _repeat_stretch(self):
        """Take the stretch again up to the last accepted state, so that this state has the memory from which a run goes on."""
        if self.state.restart:
            return
        begin, steps = self.whole, self.counts.steps
        memory = begin.memory | {"stretch": self.since}
        for state in self.own_steps(self.integrator, State(begin.t, begin.q, begin.v, begin.a, begin.lam, memory), self.end):
            if state.t >= self.state.t:
                break
        self.counts.steps, self.state = steps, state

    def _shorter(self, bound):
        """Go on from the last accepted state with steps of at most `bound`, s."""
        self._repeat_stretch()
        self.bound = bound
        self.goal = 0.0
        self.gaps.flips = np.zeros(len(self.gaps.flips))

    def _accept(self, after):
        """The accepted state, with the memory from which a run goes on."""
        self.here, length = self.ahead, after.t - self.state.t
        rate = np.abs(self.here.rate)
        self.gaps.peaks = np.maximum(self.gaps.peaks, rate)
        self.gaps.speeds = np.where(self.gaps.speeds > 0, np.maximum(self.gaps.speeds, rate), 0.0)
        self.gaps.sides = np.where(
            (self.gaps.sides == 0) & (np.abs(self.here.gap) > self._zero(after.q)), np.sign(self.here.gap), self.gaps.sides
        )
        if self.turned is not None:
            self.gaps.times = np.where(self.turned > self.gaps.turns, after.t, self.gaps.times)
            self.gaps.turns = np.maximum(self.gaps.turns, self.turned)
            after = self._with_forces(after, after.a, after.lam) if self.turned.max() > VARIABLE else after
        if self.goal and after.t >= self.goal:
            after = self._at_goal(after, length)
        self.state, self.since = after, self.since + 1
        if after.restart:
            self._store(after, length)
        return after

    def _at_goal(self, after, length):
        """The state at the goal, where gaps may switch; without a switch the bound of steps may grow. length: of the step before, s."""
        self.goal, which = 0.0, self.gaps.flips > 0
        if which.any():
            return self._flipped(after, which)
        if self.bound:
            grown = 2 * self.bound if self.changed < 0.4 else self.bound
            goes_on = grown < self.h if self.h else self.coarse and length > 0.4 * self.bound
            self.bound = grown if goes_on and (self.gaps.sides < 0).any() else 0.0
        return after

    def _store(self, state, length):
        """Store in the memory of a state what a run goes on from; length: of the step that ends there, s."""
        self.whole, self.since, steps = state, 0, 1
        if self.h:  # half of the steps to the next switch, at the present rates
            steps = 0.5 * float((np.abs(self.here.gap) / np.maximum(np.abs(self.here.rate) * length, 1e-300)).min())
        state.memory["switches"] = self.gaps.to_memory(self.bound, self.goal)
        state.memory["stretch"] = float(int(min(max(steps, 1.0), STRETCH)))
        if self.jumped:
            state.memory["jumped"], self.jumped = 1.0, False

    def _flipped(self, state, which):
        """The state at which gaps switch, with the forces of the far side if they jump."""
        here = self.here
        for k in np.flatnonzero(which):
            t, times = self.switched.get(k, (-np.inf, 0))
            times = times + 1 if state.t - t < STANDING * self.span else 0
            self.switched[k] = state.t, times
            if times > AGAIN:
                raise StepFailure("switching", f"the gap of {self._names(k)} opens and closes without end", state.t)
        self.gaps.sides = np.where(which, -self.gaps.sides, self.gaps.sides)
        self.gaps.speeds = np.where(which, np.where(self.gaps.sides < 0, np.abs(here.rate), 0.0), self.gaps.speeds)
        self.gaps.offsets = np.where(which, np.abs(here.gap), self.gaps.offsets)
        self.gaps.flips = np.zeros(len(which))
        self.bound = 0.0
        s = self._jump(state, which, here)
        state.memory["switched"] = 1.0  # what Newton's method has measured does not hold for the forces of the far side
        return self._with_forces(state, *consistent_acceleration(self.model, state.t, state.q + s * state.v, state.v)) if s else state

    def _with_forces(self, state, a, lam):
        """The state with other a and lam; the integrator starts anew from it."""
        self.jumped = True
        memory = {name: value for name, value in state.memory.items() if name in PRESERVED}
        return State(state.t, state.q, state.v, a, lam, memory | {"cut": 0.0, "h": 0.0})

    def _jump(self, state, which, values):
        """Time before and behind a state within which forces jump as the gaps `which` (gaps,) switch, s; 0 if they do not jump."""
        fast = which & (np.abs(values.rate) > 0)
        if not fast.any():
            return 0.0
        s = float(np.max((4 * np.abs(values.gap) + 10 * self._zero(state.q))[fast] / np.abs(values.rate)[fast]))

        def force(s):
            """Forces (n,) at the place s seconds along v from the state."""
            return self.model.force(state.t, state.q + s * state.v, state.v)

        ahead = force(s)
        change, more = (float(np.abs(x).max()) for x in (ahead - force(-s), force(4 * s) - force(-4 * s)))
        return s if change > 1e-6 * np.abs(ahead).max() and more < JUMP * change else 0.0

    def _ends_within_jump(self, after, which):
        """True if a step ended on a jump of forces, with a force between those of both sides, which no motion of either side has."""
        s = self._jump(after, which, self.ahead)
        if not s:
            return False
        ahead, behind = (consistent_acceleration(self.model, after.t, after.q + e * after.v, after.v)[0] for e in (s, -s))
        return np.abs(after.memory.get("a_end", after.a) - behind).max() > BETWEEN * np.abs(ahead - behind).max()

    def _examine(self, state, after):
        """(the first Crossing in a step or None, the bound of a shorter one or 0)."""
        self.ahead, self.turned, self.changed = self._values(after.t, after.q, after.v), None, 0.0
        length, closed = after.t - state.t, (self.gaps.sides < 0) & (self.gaps.speeds > 0)
        if after.within is None and not closed.any():
            fastest = np.maximum(np.abs(self.here.rate), np.abs(self.ahead.rate))
            if (np.minimum(self.gaps.sides * self.here.gap, self.gaps.sides * self.ahead.gap) > FAR * length * fastest).all():
                return None, 0.0

        def at(t):
            """GapValues at t within the step."""
            inner = between(state, after, t)
            return self._values(t, inner.q, inner.v)

        values = self.here, at(state.t + 0.5 * length), self.ahead
        if closed.any() and (shorter := self._too_long(values, state, after, closed)):
            return None, shorter
        self.near = NEAR * np.abs([each.gap for each in values]).max(axis=0) + self._zero(state.q)
        allowed = np.where(self._just_switched(), 4 * np.maximum(self.near, self.gaps.offsets), 0.0)
        crossing = first_crossing(values, at, lambda t: self.model.gaps(t, between(state, after, t).q), self.gaps.sides, self.near, allowed)
        if crossing is None:
            openings = self.gaps.sides * self.ahead.gap  # distances from zero on the present side
            reached = (openings >= 0) & (openings <= self.near) & (self.gaps.sides * self.ahead.rate < 0) & ~self._just_switched()
            if reached.any() and self._ends_within_jump(after, reached):
                return Crossing(after.t, after.t, reached), 0.0
        return crossing, 0.0

    def _just_switched(self):
        """True for gaps that have just switched; round-off may put them on either side of zero."""
        return np.abs(self.here.gap) <= self.gaps.offsets

    def _too_long(self, values, state, after, closed):
        """The bound of a shorter step if this one changes the rate of a closed gap by too much; otherwise 0."""
        length, changes = after.t - state.t, np.ptp([each.rate for each in values], axis=0)
        share = np.where(closed, 1.0 / np.maximum(np.maximum(self.gaps.speeds, SMALL * self.gaps.peaks), 1e-300), 0.0)
        self.changed = float((share * changes).max()) / (FIXED if self.coarse else VARIABLE)
        if self.coarse:
            accelerations = []
            for x in (after, state):  # what a adds to the second derivatives of the gaps, by central differences
                s = 1e-6 * extent(self.model, x.q) / max(float(np.abs(x.a).max()), 1e-300)
                ahead, behind = (self.model.gaps(x.t, x.q + e * x.a) for e in (s, -s))
                accelerations.append((ahead - behind) / (2 * s))
            bent = length / 12 * np.abs(accelerations[0] - accelerations[1])
            self.changed = max(self.changed, math.sqrt(float((share * bent).max()) / BENT))
        if self.changed <= 1.0:
            return 0.0
        if length > 1.01 * self.finest:
            return max(self.finest, 0.5 * length)
        self.turned = share * changes
        return 0.0

    def _to_switch(self, after, crossing):
        """Yield the states of a step, or of a few, to the first switch; none if that is at the step's beginning.

        The switch is bracketed. The search ends when a gap is within `self.near`, when the bracket is round-off, or after TRIALS.
        """
        whole = after.t - self.state.t
        bracket = Bracket(self.state.t, after.t, crossing.guess, crossing.which, [])
        slow = 0  # trials that did not halve the bracket, in a row
        if bracket.t - bracket.near < TOGETHER * whole:
            self.state = self._flipped(self.state, bracket.which)
            return
        for _ in range(TRIALS):
            width = bracket.beyond - bracket.near
            tried, crossing = self._tried(bracket.t)
            if self._shrink(bracket, tried, crossing, whole):
                break
            self.counts.rejected += 1
            slow = slow + 1 if bracket.beyond - bracket.near > 0.5 * width else 0
            if bracket.beyond - bracket.near <= 8 * math.ulp(bracket.beyond):
                break
            if not bracket.near < bracket.t < bracket.beyond or slow > PATIENCE:
                bracket.t = 0.5 * (bracket.near + bracket.beyond)
        else:
            if not bracket.states:
                raise StepFailure("switching", f"no step ends where the gap of {self._names(bracket.which)} changes sign", bracket.beyond)
            bracket.which = np.zeros(len(bracket.which), bool)
        if not bracket.states:
            self.state = self._flipped(self.state, bracket.which)
        else:
            yield from self._finish(bracket, tried)

    def _shrink(self, bracket, tried, crossing, whole):
        """Shrink the bracket by a trial, and choose the time of the next one. Returns True if the trial ends at the switch.

        tried, crossing: what `_tried` returned for bracket.t. whole: the step that crossed first, s.
        """
        if crossing is None and tried:
            bracket.states, bracket.near = tried, bracket.t
            reached, left = self._reached(bracket.which, whole)
            if reached.any():
                bracket.which = reached
                return True
            bracket.t = bracket.near + left
            return False
        # not the time of its crossing: behind a jump of forces a shorter step has another motion
        bracket.beyond = min(bracket.t, bracket.beyond)
        if crossing is None:
            bracket.t = bracket.near
        else:
            bracket.which, bracket.t = crossing.which, crossing.guess
        return False

    def _finish(self, bracket, tried):
        """Yield the accepted states of the best steps of a bracket; tried: the states of the last trial."""
        states = bracket.states
        if tried is not states:  # so that the steps taken last are those of the run
            states, _ = self._tried(bracket.near)
        self.goal = bracket.near if bracket.which.any() else 0.0
        self.gaps.flips = bracket.which.astype(float)
        for state in states:
            self.counts.steps += 1
            self._examine(self.state, state)
            yield self._accept(state)

    def _reached(self, which, whole):
        """(gaps that switch at the end of the step examined last, none if none is near; time from there to the first of `which` at its rate).

        whole: the step that crossed first, s.
        """
        distance, speed = self.gaps.sides * self.ahead.gap, -self.gaps.sides * self.ahead.rate
        closing = (distance > 0) & (speed > 0) & ~self._just_switched()
        is_near = (closing & (distance <= self.near)).any()
        reached = closing & is_near & (distance <= np.maximum(self.near, TOGETHER * speed * whole))
        times = np.where(which & (speed > 0), (distance - 0.5 * self.near) / np.where(speed > 0, speed, 1.0), np.inf)
        return reached, float(times.min())

    def _tried(self, t):
        """(states of a step, or of a few, to t; their first Crossing or None), which are not counted as steps; no states if they fail."""
        here, steps, state, states = self.here, self.counts.steps, self.state, []
        try:
            for after in self.own_steps(self.integrator, state, t):
                crossing, _ = self._examine(state, after)
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
