"""The first crossing of a step: the time at which the first of a model's gaps changes sign.

Gaps and their rates are known at a few times of the step, and can be evaluated at others. A gap crosses if it falls below zero on its side; its
minimum within the step is bracketed by its rate, and the time of the crossing then found by bisection.
"""

from typing import NamedTuple

import numpy as np

DIPS, SPLITS = 24, 6  # bisections of a part of a step for the minimum of a gap: if its rate changes sign, and otherwise
STEEP = 1.5  # bound of the rates within a part, over those at its ends
HALVINGS = 40  # of a bracket of a root


class GapValues(NamedTuple):
    """Gaps (gaps,) and their rates at a time."""

    t: float
    gap: np.ndarray
    rate: np.ndarray


class Crossing(NamedTuple):
    """The first crossing of a step: of the gaps `which` (gaps,), about at `guess`, s; at `beyond` one of them has crossed."""

    guess: float
    beyond: float
    which: np.ndarray


def first_crossing(values, at, gaps, sides, near, allowed):
    """The first Crossing in a step, or None.

    values: GapValues at times of the step, in order; at: function of t that gives further ones; gaps: function of t that gives the gaps alone. For
    each gap, (gaps,): sides, 1 open, -1 closed, 0 not examined; near: distance from zero at which a step may end; allowed: distance on the far
    side that is no crossing.
    """
    crossing, may_cross = None, np.zeros(len(sides), bool)
    for first, last in zip(values[:-1], values[1:]):
        steepest = STEEP * np.maximum(np.abs(first.rate), np.abs(last.rate))
        may_cross |= sides * (first.gap + last.gap) - steepest * (last.t - first.t) < -2 * allowed
    for k in np.flatnonzero(may_cross & (sides != 0)):
        bracket = _bracket(k, values, at, sides[k], -allowed[k])
        if bracket and (crossing is None or bracket[1] < crossing.beyond):
            a, b = bracket
            for _ in range(HALVINGS):
                c = 0.5 * (a + b)
                a, b = (a, c) if sides[k] * gaps(c)[k] < 0.5 * near[k] else (c, b)
            crossing = Crossing(a, bracket[1], np.arange(len(sides)) == k)
    return crossing


def _bracket(k, values, at, side, least):
    """Times before and behind the first crossing of gap k, in the order of time, or None if it does not cross.

    The gap times its side falls below `least` there. Parts of the step are halved where the gap may have a minimum: bounds of its rate, or the
    cubic between rates of different sign, exclude the others.
    """

    def search(first, last, depth):
        """The bracket in a part of the step between two points (time, gap, rate); depth: halvings that are left."""
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
        middle = point(at(0.5 * (a + b)))
        remaining = depth - (1 if dip else DIPS / SPLITS)
        return search(first, middle, remaining) or search(middle, last, remaining) or ((a, b) if fb < least else None)

    def point(values):
        """(time, gap, rate) of GapValues, positive on the gap's side."""
        return values.t, side * float(values.gap[k]), side * float(values.rate[k])

    brackets = (search(point(first), point(last), DIPS) for first, last in zip(values[:-1], values[1:]))
    return next((bracket for bracket in brackets if bracket), None)
