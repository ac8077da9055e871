"""Gaps of a model along its motion: their rates, the first that changes sign within a step, and where forces jump as one does."""

from typing import NamedTuple

import numpy as np

from polyida.integrate.sizes import extent

LEAST = 1e-13  # of the model's size: so near to zero a gap is zero
DIPS, SPLITS = 24, 6  # how often a piece of a step is halved to find the least of a gap: where its rate changes sign, and elsewhere
STEEP = 1.5  # rates within a piece over those at its ends, at most
HALVINGS = 40  # of a bracket of a root
JUMP = 2.0  # forces that change by less than that when the distance to the switch is taken four times jump there


class Seen(NamedTuple):
    """Gaps (gaps,) and their rates at a time."""

    t: float
    gap: np.ndarray
    rate: np.ndarray


class Crossing(NamedTuple):
    """Gaps `which` (gaps,) of a step cross first at about `guess`, s; at `beyond` one of them has crossed."""

    guess: float
    beyond: float
    which: np.ndarray


class Gaps:
    """The gaps of a model in a run from a state that takes `span`, s."""

    def __init__(self, model, state, span):
        speed = float(np.abs(state.v).max(initial=0.0))
        self.model, self.reach = model, 1e-6 * min(extent(model, state.q) / speed if speed else np.inf, span)

    def at(self, t, q, v):
        """What is Seen at t; rates by central differences along the motion."""
        s = self.reach
        ahead, behind = (self.model.gaps(t + e, q + e * v) for e in (s, -s))
        return Seen(t, self.model.gaps(t, q), (ahead - behind) / (2 * s))

    def least(self, q):
        """The distance from zero that is none, m."""
        return LEAST * extent(self.model, q)

    def pull(self, state):
        """What the accelerations of a state add to the second derivatives of the gaps, (gaps,)."""
        s = 1e-6 * extent(self.model, state.q) / max(float(np.abs(state.a).max()), 1e-300)
        ahead, behind = (self.model.gaps(state.t, state.q + e * state.a) for e in (s, -s))
        return (ahead - behind) / (2 * s)

    def names(self, which):
        """In words, what some of the gaps belong to."""
        return " and ".join(np.atleast_1d(np.array(self.model.gap_names(), object)[which]))

    def first(self, seen, place, sides, allowed, near):
        """The first Crossing in a step, None where no gap goes beyond zero by more than is allowed.

        seen: at times of the step, in order. place: a function t -> (q, v). sides: on which each is, as of Switches; near (gaps,): beyond
        zero is what is less than half of it.
        """
        found = None
        for k in np.flatnonzero(_may_cross(seen, sides, allowed)):
            bracket = self._bracket(k, seen, place, sides[k], -allowed[k])
            if bracket and (found is None or bracket[1] < found.beyond):
                root = self._root(k, *bracket, place, sides[k], 0.5 * near[k])
                found = Crossing(root, bracket[1], np.arange(len(sides)) == k)
        return found

    def _bracket(self, k, seen, place, side, least):
        """Times before and behind the first crossing of a gap, or None."""

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
            middle = point(self.at(0.5 * (a + b), *place(0.5 * (a + b))))
            less = depth - (1 if dip else DIPS / SPLITS)
            return search(first, middle, less) or search(middle, last, less) or ((a, b) if fb < least else None)

        def point(seen):
            return seen.t, side * float(seen.gap[k]), side * float(seen.rate[k])

        pieces = (search(point(first), point(last), DIPS) for first, last in zip(seen[:-1], seen[1:]))
        return next((piece for piece in pieces if piece), None)

    def _root(self, k, a, b, place, side, least):
        """About where a gap is zero between two times."""
        for _ in range(HALVINGS):
            c = 0.5 * (a + b)
            a, b = (a, c) if side * self.model.gaps(c, place(c)[0])[k] < least else (c, b)
        return a

    def jump(self, state, hit, seen):
        """The time on both sides of a state within which forces jump as the gaps `hit` (gaps,) switch, s; 0 where they do not."""
        fast = hit & (np.abs(seen.rate) > 0)
        if not fast.any():
            return 0.0
        s = float(np.max((4 * np.abs(seen.gap) + 10 * self.least(state.q))[fast] / np.abs(seen.rate)[fast]))
        force = lambda s: self.model.force(state.t, state.q + s * state.v, state.v)  # noqa: E731
        ahead = force(s)
        change, more = (float(np.abs(x).max()) for x in (ahead - force(-s), force(4 * s) - force(-4 * s)))
        return s if change > 1e-6 * np.abs(ahead).max() and more < JUMP * change else 0.0


def _may_cross(seen, sides, allowed):
    """Which gaps (gaps,) may be beyond zero by more than is allowed anywhere in a step."""
    may = np.zeros(len(sides), bool)
    for first, last in zip(seen[:-1], seen[1:]):
        steepest = STEEP * np.maximum(np.abs(first.rate), np.abs(last.rate))
        may |= sides * (first.gap + last.gap) - steepest * (last.t - first.t) < -2 * allowed
    return may & (sides != 0)
