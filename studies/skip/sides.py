"""The two sides of an optimisation, measured alternately, and their parts."""

import numpy as np

from polyida.body.plate import Plate
from polyida.problems import plates
from step_cost.measure import cpu


def sides(on, off, repeats):
    """Both sides in turn: medians of CPU seconds and the counts that they return, as a row."""
    on(), off()
    pairs = [(cpu(on), cpu(off)) for _ in range(repeats)]
    (on_s, off_s), (count_on, count_off) = (np.median([[a[0], b[0]] for a, b in pairs], axis=0), [side[1] for side in pairs[-1]])
    return {"count_on": count_on, "count_off": count_off, "cpu_on_s": float(on_s), "cpu_off_s": float(off_s), "times": float(off_s / on_s)}


def done(run):
    """The run; raises an exception if it failed."""
    if not run.success:
        raise RuntimeError(run.message)
    return run


def plate_at(mesh, name, x):
    """A plate of the double plate's kind, its left end at x, m."""
    return Plate(mesh, plates.RUBBER, thickness=plates.THICKNESS, origin=(x, 0.0), name=name)
