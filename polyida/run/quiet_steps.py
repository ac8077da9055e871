"""Steps of a motion with contact and friction in which certainly no status ends, so that nobody need look into them.

A step is quiet if each function of a row with a law stays away from zero by more than half of what it changes within two steps.
"""

import numpy as np

from polyida.model.row_laws import Slipping
from polyida.run.event_search import OFFSET

CERTAIN = 0.5  # of `Slipping.contraction`: below it no look at friction's uniqueness is needed
LONGEST = 64.0  # steps that are taken before they are looked at


class QuietSteps:
    """The functions of the rows with laws over the steps that an integrator takes in one call, for all batches of one motion."""

    def __init__(self, mode, before):
        """Begin at the first state of a motion of a mode."""
        self.mode = mode
        self.vectors = None  # keeps the vectors that a Stretch computes when they are first read
        self.values = None  # (steps, rows) of the functions at the ends of the batch's steps
        self.earlier = None  # (rows,) one step before the end of the last batch; None: not known
        self.looked = before.t  # time at which the contraction of friction was found last
        self.contraction = mode.contraction(before.t, before.q) if isinstance(mode, Slipping) else 0.0
        self.certain_until = before.t  # time up to which it certainly stays below CERTAIN
        mode.longest_stretch = 1

    def next(self, stretch):
        """Go on to the next batch; returns the values one step before its begin, or None."""
        earlier = self.earlier
        self.earlier = None
        self.vectors = stretch.computed()
        return earlier

    def certain(self, after):
        """True if friction that slips has certainly a unique force up to a state: it did where that was found last, and it changes slowly."""
        largest = self.contraction
        if isinstance(self.mode, Slipping) and after.t > self.certain_until:
            now = self.mode.contraction(after.t, after.q)
            change = abs(now - self.contraction) / (after.t - self.looked)
            self.certain_until = after.t + min(2.0 * (after.t - self.looked), (CERTAIN - now) / change if change else np.inf)
            largest = max(self.contraction, now)
            self.looked = after.t
            self.contraction = now
        return largest < CERTAIN

    def quiet(self, earlier, begin, values, sides, sizes):
        """True for the quiet steps, (steps,); sets how many steps the next batch may have.

        earlier, begin: values one step before the batch and at its begin. values: at the ends of its steps. sides, sizes: of the functions.
        """
        self.values = values
        ends = np.vstack([begin if earlier is None else earlier, begin, values])
        around = np.array([ends[:-2], ends[1:-1], ends[2:]])
        least, change = (sides * around).min(axis=0), np.ptp(around, axis=0)
        quiet = ((least > OFFSET * np.maximum(sizes, least)) & (2.0 * least > change)).all(axis=1)
        quiet[0] &= earlier is not None
        self.earlier = ends[-2]
        moves = np.abs(values[-1] - ends[-2])
        left = np.min(np.abs(values[-1]) / np.where(moves > 0.0, moves, 1e-300), initial=LONGEST)  # steps until one is zero
        self.mode.longest_stretch = int(max(1, min(2 * self.mode.longest_stretch, left))) if quiet.all() else 1
        return quiet
