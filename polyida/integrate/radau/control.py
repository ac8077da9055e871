"""The local error of a step, and the ladder of steps that follows it, so that factors are kept and come back."""

import numpy as np

from polyida.integrate.radau.frames import conj, turned

SAFETY = 0.75
RUNGS = 2  # a factor of two
MOST_UP, MOST_DOWN = 6, 12  # rungs at once
CUT = 4  # rungs down where a step fails


def local_error(matrices, tableau, state, stages, h, shares):
    """|q_ - q| of the step's end against a method of order s: what the last step's q' and v' at the start are off this polynomial's.

    One solve with the real matrix (or the real part of one with the complex) keeps what no step resolves out of it.
    """
    off_v = state.v + tableau.start @ stages.q / h
    off_a = state.memory.get("a_end", state.a) + tableau.start @ stages.v / h
    rows, zero = matrices.rows, np.zeros(len(matrices.rows.B))
    off_v, force = turned(off_v, conj(rows.p)), turned(matrices.M @ off_a, conj(rows.p))
    dq = matrices.solve(0, -off_v, -force, zero, zero[: len(rows.H)])[0]
    return float(np.sqrt(shares @ dq.real**2))


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
