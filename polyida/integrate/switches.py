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
FIXED, VARIABLE = 0.1, 0.5  # of a gap's largest rate since it closed: allowed change in a fixed step, in a variable one
BENT = 1e-3  # of the same: allowed error of a step of second order, `h / 12` times the change of the gap's acceleration
SMALL = 1e-2  # of the largest rate so far: a gap that closed more slowly is treated as if it had closed at that rate
FINEST = 256  # parts of a fixed step, at most
FAR = 4.0  # a gap whose distance from zero is more than so many steps at its largest rate is not examined within the step
STRETCH = 256  # steps, at most
TRIALS, PATIENCE = 60, 3  # steps that are tried for one switch; of those that do not halve its bracket, before bisection
AGAIN, STANDING = 20, 1e-9  # switches of one gap in a row, each within that share of the run, that end the run
BETWEEN = 1e-2  # of a jump of q'': a step that ends farther from the near side's value has ended within the jump
PRESERVED = ("sizes", "rtol", "tolerances", "mu", "ladder")  # of the memory of a state, behind a jump of forces
FAILURES = 6  # fixed steps in a row that fail, each a quarter of the one before
ROWS = ("sides", "speeds", "peaks", "offsets", "flips", "turns", "times")  # of the memory, for each gap


def steps_of(own_steps, integrator, model, state, t_end, counts):
    """The states of a run, from the integrator's `own_steps(integrator, state, t_end)`, with steps that end at the switches of the model.

    Raises StepFailure.
    """
    return Switches(own_steps, integrator, model, state, t_end, counts).run() if model.switching else own_steps(integrator, state, t_end)


def unresolved(model, integrator, state):
    """Message of a model with switches about the gaps whose rate changes too much in the shortest steps, up to a state; empty if there are none."""
    memory = state.memory.get("switches", ())
    turns, times = np.reshape(memory[2:], (len(ROWS), -1))[-2:] if len(memory) else np.zeros((2, 0))
    least = f"h/{FINEST}" if integrator.fixed_step() else f"{STANDING:g} of the run's time"
    return "; ".join(
        f"at t = {times[k]:.6g} s the shortest step, {least}, is too long for {model.gap_names()[k]}: the rate of its gap changes there by "
        f"{100 * turns[k]:.3g} % of the largest since it closed; take a smaller h or rtol"
        for k in np.flatnonzero(turns)
    )


class Switches:
    """The states of a run of a model with gaps, from `state` to t_end: `run` yields them.

    own_steps: a function (integrator, state, t_end) that gives the states of the integrator's own steps.

    A run goes on from two entries of State.memory: "switches" is `bound`, `goal` and for each gap the arrays of ROWS, all below; "stretch" is the
    number of steps that may be taken from there before any is examined.
    """

    def __init__(self, own_steps, integrator, model, state, t_end, counts):
        """Prepare a run; the memory of the state may be that of an earlier run."""
        self.model, self.counts, self.t_end, self.span = model, counts, t_end, t_end - state.t
        self.own_steps, self.integrator = own_steps, integrator.without_halving()
        self.h = integrator.fixed_step()  # s; 0 if steps vary
        self.coarse = bool(self.h) or integrator.second_order  # the rate of a closed gap may change less in a step
        self.finest = self.h / FINEST if self.h else STANDING * self.span  # s: the shortest step
        speed = float(np.abs(state.v).max(initial=0.0))
        self.distance = 1e-6 * min(extent(model, state.q) / speed if speed else np.inf, self.span)  # of central differences in t
        self.state = State(state.t, state.q, state.v, state.a, state.lam, {"sizes": sizes_of_run(model, state, t_end)} | state.memory)
        self.whole = self.state  # the last state from which a run can go on
        self.since = 0  # states accepted behind it
        self.switched = {}  # {gap: (t, times in a row)}
        self.jumped = False  # the next state from which a run can go on is marked "jumped"
        # of the step examined last; near (gaps,), the distance from zero at which a step may end, is set there too
        self.here = self.ahead = self._values(state.t, state.q, state.v)  # GapValues at its ends
        self.changed = 0.0  # largest change of a closed gap's rate over the allowed one
        self.turned = None  # (gaps,) these changes over the largest rates, if even the shortest step exceeds the allowed one
        self._recall()

    def _recall(self):
        """Take what is known of each gap from the memory of the state, or set it at the beginning of a run."""
        state, here = self.state, self.here
        memory, count = state.memory.get("switches"), len(here.gap)
        if np.shape(memory) != (2 + len(ROWS) * count,):
            near, rate = np.abs(here.gap) <= self._zero(state.q), np.abs(here.rate)
            sides = np.where(near, np.sign(here.rate), np.sign(here.gap))
            rows = sides, np.where(sides < 0, rate, 0.0), rate, np.where(near, np.abs(here.gap), 0.0), *np.zeros((3, count))
            memory = np.concatenate([np.zeros(2), *rows])
        self.bound = float(memory[0])  # s: no step is longer; 0 without a bound
        self.goal = float(memory[1])  # s: a time at which a step ends; 0 without one
        known = dict(zip(ROWS, np.array(memory[2:]).reshape(-1, count)))
        self.sides = known["sides"]  # 1 open, -1 closed, 0 unknown
        self.speeds = known["speeds"]  # largest rate since the gap closed, 0 if it is open or was closed from the start
        self.peaks = known["peaks"]  # largest rate so far
        self.offsets = known["offsets"]  # distance from zero when the gap switched last
        self.flips = known["flips"]  # 1 if it switches at the goal
        self.turns = known["turns"]  # largest change of the rate in a step of the least size, over `speeds`
        self.times = known["times"]  # s: the end of that step

    def _values(self, t, q, v):
        """GapValues at t, the rates by central differences along the motion."""
        s = self.distance
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
        self.bound, self.goal, self.flips = bound, 0.0, np.zeros(len(self.flips))

    def _accept(self, after):
        """The accepted state, with the memory from which a run goes on."""
        self.here, length = self.ahead, after.t - self.state.t
        rate = np.abs(self.here.rate)
        self.peaks = np.maximum(self.peaks, rate)
        self.speeds = np.where(self.speeds > 0, np.maximum(self.speeds, rate), 0.0)
        self.sides = np.where((self.sides == 0) & (np.abs(self.here.gap) > self._zero(after.q)), np.sign(self.here.gap), self.sides)
        if self.turned is not None:
            self.times = np.where(self.turned > self.turns, after.t, self.times)
            self.turns = np.maximum(self.turns, self.turned)
            after = self._with_forces(after, after.a, after.lam) if self.turned.max() > VARIABLE else after
        if self.goal and after.t >= self.goal:
            after = self._at_goal(after, length)
        self.state, self.since = after, self.since + 1
        if after.restart:
            self._store(after, length)
        return after

    def _at_goal(self, after, length):
        """The state at the goal, where gaps may switch; without a switch the bound of steps may grow. length: of the step before, s."""
        self.goal, which = 0.0, self.flips > 0
        if which.any():
            return self._flipped(after, which)
        if self.bound:
            grown = 2 * self.bound if self.changed < 0.4 else self.bound
            goes_on = grown < self.h if self.h else self.coarse and length > 0.4 * self.bound
            self.bound = grown if goes_on and (self.sides < 0).any() else 0.0
        return after

    def _store(self, state, length):
        """Store in the memory of a state what a run goes on from; length: of the step that ends there, s."""
        self.whole, self.since, steps = state, 0, 1
        if self.h:  # half of the steps to the next switch, at the present rates
            steps = 0.5 * float((np.abs(self.here.gap) / np.maximum(np.abs(self.here.rate) * length, 1e-300)).min())
        state.memory["switches"] = np.concatenate([[self.bound, self.goal], *(getattr(self, name) for name in ROWS)])
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
        self.sides = np.where(which, -self.sides, self.sides)
        self.speeds = np.where(which, np.where(self.sides < 0, np.abs(here.rate), 0.0), self.speeds)
        self.offsets, self.flips, self.bound = np.where(which, np.abs(here.gap), self.offsets), np.zeros(len(which)), 0.0
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
        force = lambda s: self.model.force(state.t, state.q + s * state.v, state.v)  # noqa: E731
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
        length, closed = after.t - state.t, (self.sides < 0) & (self.speeds > 0)
        if after.within is None and not closed.any():
            fastest = np.maximum(np.abs(self.here.rate), np.abs(self.ahead.rate))
            if (np.minimum(self.sides * self.here.gap, self.sides * self.ahead.gap) > FAR * length * fastest).all():
                return None, 0.0

        def at(t):
            """GapValues at t within the step."""
            inner = between(state, after, t)
            return self._values(t, inner.q, inner.v)

        values = self.here, at(state.t + 0.5 * length), self.ahead
        if closed.any() and (shorter := self._too_long(values, state, after, closed)):
            return None, shorter
        self.near = NEAR * np.abs([each.gap for each in values]).max(axis=0) + self._zero(state.q)
        allowed = np.where(self._just_switched(), 4 * np.maximum(self.near, self.offsets), 0.0)
        crossing = first_crossing(values, at, lambda t: self.model.gaps(t, between(state, after, t).q), self.sides, self.near, allowed)
        if crossing is None:
            distance = self.sides * self.ahead.gap
            reached = (distance >= 0) & (distance <= self.near) & (self.sides * self.ahead.rate < 0) & ~self._just_switched()
            if reached.any() and self._ends_within_jump(after, reached):
                return Crossing(after.t, after.t, reached), 0.0
        return crossing, 0.0

    def _just_switched(self):
        """True for gaps that have just switched; round-off may put them on either side of zero."""
        return np.abs(self.here.gap) <= self.offsets

    def _too_long(self, values, state, after, closed):
        """The bound of a shorter step if this one changes the rate of a closed gap by too much; otherwise 0."""
        length, changes = after.t - state.t, np.ptp([each.rate for each in values], axis=0)
        share = np.where(closed, 1.0 / np.maximum(np.maximum(self.speeds, SMALL * self.peaks), 1e-300), 0.0)
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

        It is bracketed by `near`, the end of the best steps that do not cross (`states`), and `beyond`, the least time at which a trial crossed
        or failed. The search ends when a gap is within `self.near`, when the bracket is round-off, or after TRIALS.
        """
        state, whole = self.state, after.t - self.state.t
        near, beyond, t, which, states, slow = state.t, after.t, crossing.guess, crossing.which, [], 0
        if t - state.t < TOGETHER * whole:
            self.state = self._flipped(state, which)
            return
        for _ in range(TRIALS):
            width = beyond - near
            tried, crossing = self._tried(t)
            if crossing is None and tried:
                states, near = tried, t
                reached, left = self._reached(which, whole)
                if reached.any():
                    which = reached
                    break
                t = near + left
            else:
                beyond = min(t, beyond)  # not the time of its crossing: behind a jump of forces a shorter step has another motion
                which, t = (which, near) if crossing is None else (crossing.which, crossing.guess)
            self.counts.rejected += 1
            slow = slow + 1 if beyond - near > 0.5 * width else 0
            if beyond - near <= 8 * math.ulp(beyond):
                break
            if not near < t < beyond or slow > PATIENCE:
                t = 0.5 * (near + beyond)
        else:
            if not states:
                raise StepFailure("switching", f"no step ends where the gap of {self._names(which)} changes sign", beyond)
            which = np.zeros(len(which), bool)
        if not states:
            self.state = self._flipped(state, which)
            return
        is_last = tried is states
        if not is_last:  # so that the steps taken last are those of the run
            states, _ = self._tried(near)
        self.goal, self.flips = near if which.any() else 0.0, which.astype(float)
        for state in states:
            self.counts.steps += 1
            self._examine(self.state, state)
            yield self._accept(state)

    def _reached(self, which, whole):
        """(gaps that switch at the end of the step examined last, none if none is near; time from there to the first of `which` at its rate).

        whole: the step that crossed first, s.
        """
        distance, speed = self.sides * self.ahead.gap, -self.sides * self.ahead.rate
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
