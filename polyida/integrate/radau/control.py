"""The ladder of steps that follows the local error, so that factors are kept and come back."""

import numpy as np

SAFETY = 0.65
RUNGS = 2  # a factor of two
MOST_UP, MOST_DOWN = 6, 12  # rungs at once
CUT = 4  # rungs down where a step fails


class Ladder:
    """Steps `first` 2^(k/2), k any whole number: where the run stands is `rung`."""

    def __init__(self, first, rung=0):
        self.first, self.rung = first, rung

    @property
    def h(self):
        """The step, s."""
        return self.first * 2.0 ** (self.rung / RUNGS)

    def follow(self, error, order):
        """Go to where the error, which is of that order in h, is expected to be allowed; down at least a rung where it is not."""
        rungs = np.floor(RUNGS * np.log2(SAFETY * max(error, 1e-12) ** (-1 / order))) if np.isfinite(error) else -MOST_DOWN
        self.rung += int(np.clip(rungs, 0, MOST_UP)) if error <= 1.0 else int(np.clip(rungs, -MOST_DOWN, -1))

    def below(self, most):
        """Down to where the step is not above `most`."""
        if self.h > most * (1 + 1e-9):
            self.rung = int(np.floor(RUNGS * np.log2(most / self.first) + 1e-9))
