"""Iterative refinement with a stale factor: when a column has converged, and when a factor is too old.

Each correction dw of w is measured, |.| the sum of absolute values, since squares may underflow:

    contraction = |dw| / |dw of the correction before|,    error of w ~ |dw| contraction / (1 - contraction)

The first correction of a step takes the contraction measured in a step before. A contraction above `FactorRecord.slowest` means that the
factor is too old, and so does a number of solves that would have paid for a new one. In: sizes of corrections. Out: decisions, and the
FactorRecord of the factor, which is changed.
"""

from typing import NamedTuple

import numpy as np

from polyida.jit import pack, part

# constants of compiled code
FRESHEN = 30  # steps after which the contraction is measured again
RENEWAL = 36.0  # solves, with their products, that a new factor must save: it takes the time of 12 at 1e3 coordinates, of 19 at 1e4
SMOOTHING = 0.125  # weight of the last step in FactorRecord.lately
ROUND_OFF = 1e-9  # of |w|: below it a correction need not fall any more
NEGLIGIBLE = 1e-14  # of what w would be without constraints: below it corrections of a w that these hold to zero are nothing
OF_MU = 100.0  # accepted relative error of mu over that of w: mu has the error of w times M / h^2
OLD = 0.5  # contraction above which a factor is made anew
FRESH = 0.8  # contraction above which a factor that was made for the step does not serve


@pack
class FactorRecord(NamedTuple):
    """What a table has measured of a factor, arrays (1,) but for (columns,) ones."""

    solves: np.ndarray  # number since `at_work`
    slowest: np.ndarray  # the largest accepted contraction
    steps: np.ndarray  # number of steps with the factor
    work: np.ndarray  # number of solves in them; one of a further column counts half
    lately: np.ndarray  # mean number of solves in the last steps
    contraction: np.ndarray  # (columns,) of a correction
    measured: np.ndarray  # (columns,) number of steps at which that was measured, or 0
    moved: np.ndarray  # (columns,) |dw| of the last correction


def new_record(slowest, columns):
    """The FactorRecord of a new factor, or of one that a table takes over: nothing is measured, the contraction counts as 1."""
    record = FactorRecord(*np.zeros((5, 1)), *np.zeros((3, columns)))
    record.slowest[0] = slowest
    record.contraction[:] = 1.0
    return record


@part
def too_old(record):
    """True if the last steps cost more than the mean of all steps with the factor, its making included: lately > (work + RENEWAL) / steps."""
    return record.lately[0] * record.steps[0] > record.work[0] + RENEWAL


@part
def convergence(record, column, iteration, moved, size, mu_moved, mu_size, enough, unconstrained):
    """(True if the error of a column after a correction is small enough or round-off, True if it will not become so).

    moved, size: |dw| and |w|; mu_moved, mu_size: the same of mu. enough: accepted error of w over |w|. unconstrained: |w| without constraints.
    The error of mu is that of w times M / h^2, and an error of the adjoint of the state before: it is estimated by its own last correction.
    """
    last, steps = record.moved[column], record.steps[0]
    known_contraction, measured_at = record.contraction[column], record.measured[column]
    contraction, measured = known_contraction, iteration > 0 and last > 0.0
    record.moved[column] = moved
    if measured:
        contraction = moved / last
        record.contraction[column] = max(contraction, (0.5 if iteration == 1 else 1.0) * known_contraction)
        record.measured[column] = steps
    elif measured_at > 0.0 and steps < measured_at + FRESHEN:
        contraction *= steps / measured_at  # it grows with the distance from the state of the factor
    else:
        contraction = np.inf
    slow = measured and not contraction <= record.slowest[0]
    factor = contraction / (1.0 - contraction) if contraction < 1.0 else np.inf
    small = moved * factor <= enough * size and mu_moved * factor <= OF_MU * enough * mu_size
    return small or (slow and moved <= ROUND_OFF * size) or moved <= NEGLIGIBLE * unconstrained, slow


@part
def count_work(record, solves):
    """Count a step with its solves."""
    record.steps[0] += 1.0
    record.work[0] += solves
    record.lately[0] += (SMOOTHING if record.steps[0] > 1.0 else 1.0) * (solves - record.lately[0])
