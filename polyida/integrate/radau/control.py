"""The ladder of steps that follows the local error, so that factors are kept and come back: `first` 2^(k/2), k any whole number."""

import numpy as np

from polyida.jit import entry, part

SAFETY = 0.65
RUNGS = 2.0  # a factor of two
MOST_UP, MOST_DOWN = 6.0, 12.0  # rungs at once
CUT = 4.0  # rungs down where a step fails


@part
def length(first, rung):
    """The step, s."""
    return first * 2.0 ** (rung / RUNGS)


@part
def followed(rung, error, order):
    """Where the error, which is of that order in h, is expected to be allowed; down at least a rung where it is not."""
    rungs = -MOST_DOWN
    if np.isfinite(error):
        rungs = np.floor(RUNGS * np.log2(SAFETY * max(error, 1e-12) ** (-1.0 / order)))
    return rung + (min(max(rungs, 0.0), MOST_UP) if error <= 1.0 else min(max(rungs, -MOST_DOWN), -1.0))


@part
def below(first, rung, most):
    """Down to where the step is not above `most`."""
    if length(first, rung) > most * (1.0 + 1e-9):
        return np.floor(RUNGS * np.log2(most / first) + 1e-9)
    return rung


@part
def next_step(t, end, h, last):
    """(step, where it ends): the last two before the end are equal, and equal to one that there are factors for up to round-off of t."""
    rest = end - t
    if abs(rest - h) <= 1e-9 * h:
        return h, end
    known = min(h, last)
    if abs(rest - known) <= 1e-9 * known:
        return known, end
    if rest < h:
        return rest, end
    if rest < 2.0 * h * (1.0 - 1e-9):
        return 0.5 * rest, t + 0.5 * rest
    return h, t + h


@entry
def cut(first, rung, h):
    """The rung behind a step of h that failed."""
    return below(first, rung, h) - CUT
