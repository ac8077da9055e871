"""The times of equal steps, and how a run that is resumed finds the times it stood on."""

from typing import NamedTuple

import numpy as np


class Grid(NamedTuple):
    """`count` equal steps from begin to end, of which `done` are taken."""

    begin: float
    end: float
    count: int  # type: ignore[assignment]  # a tuple has a method of this name, of no use here
    done: int = 0

    @property
    def h(self):
        """The step, s."""
        return (self.end - self.begin) / self.count

    def time(self, k):
        """The time after k steps; exactly `end` after the last."""
        return self.begin + k * self.h if k < self.count else self.end

    def times(self, first, last):
        """The times after `first` to `last` steps, (last - first + 1,)."""
        times = self.begin + np.arange(first, last + 1) * self.h
        times[self.count - first :] = self.end
        return times

    def after(self, done):
        """What a State's memory holds of the grid after `done` steps."""
        return np.array([self.begin, self.end, self.count, done], float)


def grid_of(state, begin, end, count):
    """The grid that the state's memory says it is on, in the middle of the way to the same end; a new one otherwise."""
    stored = state.memory.get("grid")
    if stored is not None and np.shape(stored) == (4,):
        grid = Grid(float(stored[0]), float(stored[1]), int(stored[2]), int(stored[3]))
        if grid.end == end and 0 < grid.done < grid.count and grid.time(grid.done) == begin == state.t:
            return grid
    return Grid(begin, end, count)


def goes_on(model, state, grid, key):
    """Whether Newton's memory in the state (it has `key`) is of use: the same h, and no kink here to start anew at."""
    near = 1e-12 * max(abs(state.t), abs(grid.end))
    same = key in state.memory and np.isclose(state.memory["h"], grid.h, rtol=1e-9, atol=0.0)
    return same and not model.kinks(state.t - near, state.t + near)
