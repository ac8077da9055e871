"""Loads and motors of a scene at the stages of steps: many steps at once where it is known which are to come."""

import numpy as np

from polyida.assembly.rows.increments import stage_tables
from polyida.integrate.kinks import inner_side
from polyida.integrate.stepping.grid import Grid

CHUNK = 64  # steps that are looked at together


class Loads:
    """Of a scene and a tableau's nodes c."""

    def __init__(self, model, c):
        self.model, self.c, none = model, c, np.empty((len(c) + 1, 0, 3))
        self.nothing = None if model.profiles else (none, none[1:])
        self.expect(Grid(0.0, 0.0, 1), None)

    def expect(self, grid, clamp):
        """Be told of the steps of a Grid; clamp(times): these held beside the kinks that the run goes between."""
        self.grid, self.h, self.clamp, self.first, self.drives = grid, grid.h, clamp, 0, ()

    def of(self, t, h, times):
        """drives (s + 1, profiles, 3) of a step's start and stages, gains (s, profiles, 3) from there to these."""
        if self.nothing:
            return self.nothing
        grid = self.grid
        k = round((t - grid.begin) / h)
        if h != self.h or not 0 <= k < grid.count or grid.time(k) != t:
            drives, gains = self._tables(np.array([t]), h, np.array([times]))
            return drives[0], gains[0]
        if not self.first <= k < self.first + len(self.drives):
            some = np.array([grid.time(i) for i in range(k, min(k + CHUNK, grid.count))])
            self.first, (self.drives, self.gains) = k, self._tables(some, h, self.clamp(some[:, None] + self.c * h))
        return self.drives[k - self.first], self.gains[k - self.first]

    def _tables(self, starts, h, times):
        return stage_tables(self.model, starts, times, inner_side(self.model, starts[0], -h), self.c * h)
