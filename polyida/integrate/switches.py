"""Switches of a model: where one of its `gaps` changes sign, a force comes or goes. Steps end there, and none hides one between its ends.

Each step is looked at between its ends, on the motion that its integrator gives or on the cubic through q and v: for changes of sign of every
gap, and for its least value, which its rate brackets. A step that crosses is discarded. Shorter ones are tried until one ends on the near
side of the switch, and the run goes on from there. While a gap is closed a step may change its rate only by a share of the largest one since
it closed; by less where steps are of fixed size or of second order. Where the shortest step changes it by more, the run says so
(`unresolved`), and begins anew behind a step in which the forces turn round.
"""

import math
from dataclasses import is_dataclass, replace
from typing import NamedTuple

import numpy as np

from polyida.integrate.running.hermite import cubic
from polyida.integrate.sizes import extent, sizes_of_run
from polyida.integrate.start import consistent_acceleration
from polyida.integrate.state import State, StepFailure, constant_step

NEAR = 1e-9  # of a gap's size in a step: so near to zero a step ends
LEAST = 1e-13  # of the model's size: the same where the gap is as good as zero in all of the step
TOGETHER = 1e-4  # of a step: gaps that switch within it switch together, and one so near to its beginning there
FIXED, VARIABLE = 0.1, 0.5  # of a gap's largest rate since it closed: by how much a step may change it
BENT = 1e-3  # of the same: by how much a step of second order may be wrong in it, `h / 12` times the change of what forces make of it
SMALL = 1e-2  # of the largest rate seen: a gap that closed with less is taken as if it had closed with that
FINEST = 256  # parts of a fixed step, at most
DIPS, SPLITS = 24, 6  # how often a piece of a step is halved to find the least of a gap: where its rate changes sign, and elsewhere
STEEP = 1.5  # rates within a piece over those at its ends, at most
TRIALS, PATIENCE = 60, 3  # steps tried to end at one switch; of those that bring its bounds nearer by less than half, before bisection
AGAIN, STANDING = 20, 1e-9  # a gap that switches so often in a row, each time within that share of the run, does so without end
JUMP = 2.0  # forces that change by less than that when the distance to the switch is taken four times jump there
BETWEEN = 1e-2  # of a jump of q'': a step that ends there and is off its near side by more has ended within the jump
KEPT = ("sizes", "rtol", "tolerances", "mu", "ladder")  # of the memory of a state, behind a jump of forces
FAILURES = 6  # fixed steps in a row that fail, each a quarter of the one before


class Crossing(NamedTuple):
    """Gaps `which` (gaps,) of a step cross first at about `guess`, s; at `beyond` one of them has crossed."""

    guess: float
    beyond: float
    which: np.ndarray


def steps_of(taken, integrator, model, state, t_end, counts):
    """The states of a run: those of the integrator's own steps, `taken(integrator, state, t_end)`, which end at the switches of the model.

    Raises StepFailure.
    """
    return Switches(taken, integrator, model, state, t_end, counts).run() if model.switching else taken(integrator, state, t_end)


def unresolved(model, integrator, state):
    """In words, the gaps whose rate changes too much in steps that can be no shorter, up to a state; empty where there are none."""
    kept = state.memory.get("switches", ()) if model.switching else ()
    turns, times = np.reshape(kept[2:], (7, -1))[-2:] if len(kept) else np.zeros((2, 0))
    least = f"h/{FINEST}" if constant_step(integrator) else f"{STANDING:g} of the run's time"
    return "; ".join(
        f"at t = {times[k]:.6g} s the shortest step, {least}, is too long for {name}: the rate of its gap changes there by "
        f"{100 * turns[k]:.3g} % of the largest since it closed; take a smaller h or rtol"
        for k, name in zip(np.flatnonzero(turns), np.array(model.gap_names(), object)[turns > 0] if turns.any() else ())
    )


class Switches:
    """The states of a run of a model with gaps, from `state` to t_end: `run` yields them.

    taken: a function (integrator, state, t_end) that gives the states of the integrator's own steps. State.memory "switches" is what a run
    goes on from: bound: no step is longer, 0 where any may be; goal: a time at which a step ends, 0 where none is known; and for each gap
    sides: 1 open, -1 closed, 0 not known yet; speeds: its largest rate since it closed, 0 where it was closed from the start or is open; peaks: its
    largest rate so far; offsets: how far from zero it was when it switched last; flips: 1 where it switches at the goal; turns, times: the
    largest change of its rate in a step that could be no shorter, over `speeds`, and the end of that step, s.
    """

    def __init__(self, taken, integrator, model, state, t_end, counts):
        self.model, self.counts, self.t_end, self.span = model, counts, t_end, t_end - state.t
        self.h = constant_step(integrator)
        parts = is_dataclass(integrator) and self.h and hasattr(integrator, "max_halvings")
        self.coarse = bool(self.h) or getattr(integrator, "second_order", False)
        self.taken, self.integrator = taken, replace(integrator, max_halvings=0) if parts else integrator
        speed = float(np.abs(state.v).max(initial=0.0))
        self.reach = 1e-6 * min(extent(model, state.q) / speed if speed else np.inf, self.span)
        self.switched, self.changed, self.jumped, self.rough = {}, 0.0, False, False
        self.state = State(state.t, state.q, state.v, state.a, state.lam, {"sizes": sizes_of_run(model, state, t_end)} | state.memory)
        self._recall(state)

    def _recall(self, state):
        self.here = g, rate = self._gaps(state.t, state.q, state.v)
        kept, count = state.memory.get("switches"), len(g)
        if np.shape(kept) == (2 + 7 * count,):
            self.bound, self.goal = float(kept[0]), float(kept[1])
            self.sides, self.speeds, self.peaks, self.offsets, self.flips, self.turns, self.times = np.array(kept[2:]).reshape(7, count)
            return
        self.bound = self.goal = 0.0
        near = np.abs(g) <= self._least(state.q)
        self.sides, self.peaks = np.where(near, np.sign(rate), np.sign(g)), np.abs(rate)
        self.flips, self.turns, self.times = np.zeros((3, count))
        self.speeds, self.offsets = np.where(self.sides < 0, self.peaks, 0.0), np.where(near, np.abs(g), 0.0)

    def _least(self, q):
        return LEAST * extent(self.model, q)

    def _gaps(self, t, q, v):
        """(gaps, their rates by central differences along the motion)."""
        s = self.reach
        ahead, behind = (self.model.gaps(t + e, q + e * v) for e in (s, -s))
        return self.model.gaps(t, q), (ahead - behind) / (2 * s)

    def _pull(self, state):
        """What the accelerations of a state add to the second derivatives of the gaps."""
        s = 1e-6 * extent(self.model, state.q) / max(float(np.abs(state.a).max()), 1e-300)
        ahead, behind = (self.model.gaps(state.t, state.q + e * state.a) for e in (s, -s))
        return (ahead - behind) / (2 * s)

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
        end, steps = self.goal or self.t_end, self.counts.steps
        for after in self.taken(self.integrator, self.state, end):
            crossing, shorter = self._look(self.state, after)
            if crossing is None and not shorter:
                yield self._accept(after)
                steps = self.counts.steps
                if end != (self.goal or self.t_end):
                    return
                continue
            self.counts.steps, self.counts.rejected = steps, self.counts.rejected + 1
            if shorter:
                self._shorter(shorter)
            else:
                yield from self._to_switch(after, crossing)
            return

    def _shorter(self, bound):
        self.bound, self.goal, self.flips = bound, 0.0, np.zeros(len(self.flips))

    def _accept(self, after):
        """The state, accepted, with all that the run goes on from."""
        self.here = g, rate = self._gaps(after.t, after.q, after.v)
        self.peaks = np.maximum(self.peaks, np.abs(rate))
        self.speeds = np.where(self.speeds > 0, np.maximum(self.speeds, np.abs(rate)), 0.0)
        self.sides = np.where((self.sides == 0) & (np.abs(g) > self._least(after.q)), np.sign(g), self.sides)
        if self.goal and after.t >= self.goal:
            self.goal, hit = 0.0, self.flips > 0
            if hit.any():
                after = self._flipped(after, hit)
            elif self.bound:
                grown, length = 2 * self.bound if self.changed < 0.4 else self.bound, after.t - self.state.t
                goes_on = grown < self.h if self.h else self.coarse and length > 0.4 * self.bound
                self.bound = grown if goes_on and (self.sides < 0).any() else 0.0
        if self.rough:
            self.rough = False
            after = self._anew(after, after.a, after.lam)
        if self.jumped:
            after.memory["jumped"], self.jumped = 1.0, False
        lasting = [[self.bound, self.goal], self.sides, self.speeds, self.peaks, self.offsets, self.flips, self.turns, self.times]
        after.memory["switches"] = np.concatenate(lasting)
        self.state = after
        return after

    def _flipped(self, state, hit):
        """The state at which gaps switch."""
        g, rate = self.here
        for k in np.flatnonzero(hit):
            t, times = self.switched.get(k, (-np.inf, 0))
            times = times + 1 if state.t - t < STANDING * self.span else 0
            self.switched[k] = state.t, times
            if times > AGAIN:
                raise StepFailure("switching", f"the gap of {self._names(k)} opens and closes without end", state.t)
        self.sides = np.where(hit, -self.sides, self.sides)
        self.speeds = np.where(hit, np.where(self.sides < 0, np.abs(rate), 0.0), self.speeds)
        self.offsets, self.flips, self.bound = np.where(hit, np.abs(g), self.offsets), np.zeros(len(g)), 0.0
        return self._behind_jump(state, hit)

    def _behind_jump(self, state, hit):
        """The state with the forces of the far side, where they jump."""
        s = self._jump(state, hit, *self.here)
        if not s:
            return state
        return self._anew(state, *consistent_acceleration(self.model, state.t, state.q + s * state.v, state.v))

    def _anew(self, state, a, lam):
        """The state as one from which the integrator begins anew, with these a and lam: what it remembers is of other forces."""
        self.jumped = True
        memory = {name: value for name, value in state.memory.items() if name in KEPT}
        return State(state.t, state.q, state.v, a, lam, memory | {"cut": 0.0, "h": 0.0})

    def _jump(self, state, hit, g, rate):
        """The time on both sides of a state within which forces jump as gaps switch; 0 where they do not."""
        fast = hit & (np.abs(rate) > 0)
        if not fast.any():
            return 0.0
        s = float(np.max((4 * np.abs(g) + 10 * self._least(state.q))[fast] / np.abs(rate)[fast]))
        force = lambda s: self.model.force(state.t, state.q + s * state.v, state.v)  # noqa: E731
        ahead = force(s)
        change, more = (float(np.abs(x).max()) for x in (ahead - force(-s), force(4 * s) - force(-4 * s)))
        return s if change > 1e-6 * np.abs(ahead).max() and more < JUMP * change else 0.0

    def _within_jump(self, after, hit, g, rate):
        """Whether a step ended on a jump of forces, with a force between those of both sides: no motion of either side goes there."""
        s = self._jump(after, hit, g, rate)
        if not s:
            return False
        ahead, behind = (consistent_acceleration(self.model, after.t, after.q + e * after.v, after.v)[0] for e in (s, -s))
        found = after.memory.get("a_end", after.a)
        return np.abs(found - behind).max() > BETWEEN * np.abs(ahead - behind).max()

    def _look(self, state, after):
        """(the first Crossing in a step or None, the bound of a shorter one or 0)."""
        place, length = _between(state, after), after.t - state.t
        middle = state.t + 0.5 * length
        seen = [(state.t, *self.here), (middle, *self._gaps(middle, *place(middle))), (after.t, *self._gaps(after.t, after.q, after.v))]
        if shorter := self._too_long(seen, state, after):
            return None, shorter
        g = np.abs([found for _, found, _ in seen]).max(axis=0)
        self.near = NEAR * g + self._least(state.q)
        allowed = np.where(self._fresh(self.here[0]), 4 * np.maximum(self.near, self.offsets), 0.0)
        first = None
        for k in np.flatnonzero(self._may_cross(seen, allowed)):
            bracket = self._bracket(k, seen, place, -allowed[k])
            if bracket and (first is None or bracket[1] < first.beyond):
                which = np.arange(len(g)) == k
                first = Crossing(self._root(k, *bracket, place), bracket[1], which)
        if first is None:
            _, g, rate = seen[-1]
            left = self.sides * g
            reached = (left >= 0) & (left <= self.near) & (self.sides * rate < 0) & ~self._fresh(self.here[0])
            if reached.any() and self._within_jump(after, reached, g, rate):
                first = Crossing(after.t, after.t, reached)
        return first, 0.0

    def _fresh(self, g):
        """Which gaps have just switched, and may be on either side of zero by the round-off of that."""
        return np.abs(g) <= self.offsets

    def _too_long(self, seen, state, after):
        """A shorter bound of the step, where it changes the rate of a closed gap by too much; 0 where it does not."""
        g, length, self.changed = self.here[0], after.t - state.t, 0.0
        closed = (self.sides < 0) & (self.speeds > 0)
        if not closed.any():
            return 0.0
        rates = np.array([rate for _, _, rate in seen])
        size = np.maximum(np.maximum(self.speeds, SMALL * self.peaks), 1e-300)[closed]
        self.changed = float((np.ptp(rates, axis=0)[closed] / size).max()) / (FIXED if self.coarse else VARIABLE)
        if self.coarse:
            turned = np.abs(self._pull(after) - self._pull(state))[closed]
            bent = float((length / 12 * turned / size).max())
            self.changed = max(self.changed, math.sqrt(bent / BENT))
        if self.changed <= 1.0:
            return 0.0
        finest = self.h / FINEST if self.h else STANDING * self.span
        if length > 1.01 * finest:
            return max(finest, 0.5 * length)
        turned = np.zeros(len(g))
        turned[closed] = np.ptp(rates, axis=0)[closed] / size
        self.times = np.where(turned > self.turns, after.t, self.times)
        self.turns, self.rough = np.maximum(self.turns, turned), bool(turned.max() > VARIABLE)
        return 0.0

    def _may_cross(self, seen, allowed):
        """Which gaps (gaps,) may be beyond zero by more than is allowed anywhere in a step."""
        may = np.zeros(len(allowed), bool)
        for (a, ga, ra), (b, gb, rb) in zip(seen[:-1], seen[1:]):
            least = self.sides * (ga + gb) - STEEP * np.maximum(np.abs(ra), np.abs(rb)) * (b - a)
            may |= least < -2 * allowed
        return may & (self.sides != 0)

    def _bracket(self, k, seen, place, least):
        """Times before and behind the first crossing of a gap, or None."""
        side = self.sides[k]
        points = [(t, side * float(g[k]), side * float(rate[k])) for t, g, rate in seen]

        def search(first, last, depth):
            (a, fa, da), (b, fb, db) = first, last
            dip = da < 0 < db
            if dip and fb >= least:
                lowest = fa + da * (fb - fa - db * (b - a)) / (da - db)
                if lowest >= least:
                    return None
            elif fb >= least and fa + fb - STEEP * max(abs(da), abs(db)) * (b - a) >= 2 * least:
                return None
            if depth <= 0:
                return (a, b) if fb < least else None
            c = 0.5 * (a + b)
            g, rate = self._gaps(c, *place(c))
            middle = c, side * float(g[k]), side * float(rate[k])
            less = depth - (1 if dip else DIPS / SPLITS)
            return search(first, middle, less) or search(middle, last, less) or ((a, b) if fb < least else None)

        for first, last in zip(points[:-1], points[1:]):
            found = search(first, last, DIPS)
            if found:
                return found
        return None

    def _root(self, k, a, b, place):
        """About where a gap is zero between two times."""
        for _ in range(40):
            c = 0.5 * (a + b)
            beyond = self.sides[k] * self.model.gaps(c, place(c)[0])[k] < 0.5 * self.near[k]
            a, b = (a, c) if beyond else (c, b)
        return a

    def _to_switch(self, after, crossing):
        """Yield the states of a step, or a few, to the first switch; none where that is at its beginning."""
        state, whole = self.state, after.t - self.state.t
        near, beyond, t, hit, states, slow = state.t, after.t, crossing.guess, crossing.which, [], 0
        if t - state.t < TOGETHER * whole:
            g, rate = self.here
            self.state = self._flipped(state, hit)
            return
        for _ in range(TRIALS):
            steps, wide = self.counts.steps, beyond - near
            tried, found = self._tried(t)
            self.counts.steps = steps
            if found is None and tried:
                states, near = tried, t
                g, rate = self._gaps(tried[-1].t, tried[-1].q, tried[-1].v)
                left, falls = self.sides * g, -self.sides * rate
                there = (left > 0) & (falls > 0) & ~self._fresh(self.here[0])
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
                raise StepFailure("switching", f"no step ends where the gap of {self._names(hit)} changes sign", beyond)
            hit = np.zeros(len(hit), bool)
        if not states:
            self.state = self._flipped(state, hit)
            return
        if tried is not states:
            states = self._tried(near)[0]  # so that the steps taken last are those of the run
            self.counts.steps = steps
        self.counts.steps += len(states)
        self.goal, self.flips = near if hit.any() else 0.0, hit.astype(float)
        for state in states:
            yield self._accept(state)

    def _names(self, which):
        return " and ".join(np.atleast_1d(np.array(self.model.gap_names(), object)[which]))

    def _tried(self, t):
        """(states of a step, or a few, to t; their first Crossing or None); no states where they fail."""
        here, state, states = self.here, self.state, []
        try:
            for after in self.taken(self.integrator, state, t):
                crossing, _ = self._look(state, after)
                if crossing is not None:
                    return states, crossing
                state = after
                states.append(after)
                self.here = self._gaps(after.t, after.q, after.v)
            return states, None
        except StepFailure:
            return [], None
        finally:
            self.here = here


def _between(before, after):
    """A function t -> (q, v) within a step."""
    if after.within is not None:

        def inside(t):
            state = after.within(t)
            return state.q, state.v

        return inside
    h = after.t - before.t
    return lambda t: cubic(before.q, before.v, after.q, after.v, h, (t - before.t) / h)
