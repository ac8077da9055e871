"""One run, measured: its cost, its work, and how far its end is from a reference."""

from statistics import median

import numpy as np

from polyida.study.rows import NAN
from polyida.study.subject import PARTS

COUNTS = ("steps", "rejected", "newton_iterations", "residuals", "tangents", "factorizations", "solves")


def measured(subject, integrator, repeats=1):
    """(row, Trajectory of the ends alone): status, message, CPU seconds (the median of the repeats) and exact counts."""
    runs = [subject.run(integrator, every=10**9) for _ in range(repeats)]
    run = runs[0]
    row = {"status": run.status, "message": run.message, "t": float(run.t[-1]), "cpu_s": float(median(run.cpu_seconds for run in runs))}
    return row | {key: int(getattr(run.counts, key)) for key in COUNTS}, run


def errors(run, reference):
    """{"error_q", "error_v", "error_lam"}: the largest absolute deviation of each part at the end; NaN where the run did not come there,
    there is no reference, or nothing in the part.
    """
    return {f"error_{part}": _error(run, part, reference) for part in PARTS}


def _error(run, part, reference):
    if not run.success or not np.size(reference.get(part, ())):
        return NAN
    return float(np.abs(getattr(run, part)[-1] - reference[part]).max())


def smallest_errors(runs):
    """Function of a reference -> {part: the smallest error above zero of all runs}."""

    def of(reference):
        found = {part: [_error(run, part, reference) for run in runs] for part in PARTS}
        return {part: min((e for e in values if e > 0), default=0.0) for part, values in found.items()}

    return of
