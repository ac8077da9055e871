"""Cost of storing every frame, in memory or in an HDF5 file, relative to runs with two frames, measured alternately."""

import tempfile
from functools import partial
from pathlib import Path

import numpy as np

from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.run.solve import solve
from step_cost.measure import H, model_of
from step_cost.side import NO_FRAMES, cpu

RUNS = {  # figure: coordinates, steps of a run, pairs of runs, the same of the short selection, whether to a file
    "frames_over_none_1e3": (1_000, (3000, 15), (1000, 7), False),
    "frames_over_none_1e4": (10_000, (600, 9), (150, 5), False),
    "frames_over_none_1e5": (100_000, (150, 5), (24, 2), False),
    "frames_beyond_memory_over_none_1e5": (100_000, (300, 3), None, False),
    "hdf5_over_none_1e3": (1_000, (3000, 9), None, True),
    "hdf5_over_none_1e4": (10_000, (800, 7), (400, 2), True),
}


def tasks(quick):
    """A task for each figure."""
    selection = []
    for name, (dof, whole, short, streams) in RUNS.items():
        if chosen := short if quick else whole:
            selection.append({"part": "frames", "figure": name, "dof": dof, "steps": chosen[0], "pairs": chosen[1], "streams": streams})
    return selection


def frames_row(figure, dof, steps, pairs, streams):
    """CPU time of a run with every frame relative to one with two: the median of the ratios of pairs; the first pair separately.

    In the first pair the memory for the frames is new, later pairs reuse it. new_memory_us: time to fill a frame's part of new memory.
    """
    model = model_of("scene 1", dof)
    with tempfile.TemporaryDirectory(prefix="polyida-frames-") as folder:
        file = {"out": Path(folder) / "run.h5", "overwrite": True} if streams else {}
        run_to = partial(solve, model, integrator=GeneralizedAlpha(h=H))
        run_to(3 * H, **file)  # compiles or loads the kernels
        seconds = np.array([_pair(run_to, steps, file) for _ in range(pairs)])
    ratios = seconds[:, 1] / seconds[:, 0]
    return {
        "n": model.n,
        "ratio": float(np.median(ratios)),
        "first_ratio": float(ratios[0]),
        "none_ms": 1e3 * float(np.median(seconds[:, 0])) / steps,
        "extra_us": 1e6 * float(np.median(seconds[:, 1] - seconds[:, 0])) / steps,
        "new_memory_us": 1e6 * cpu(partial(np.ones, steps * (3 * model.n + model.m + 1)))[0] / steps,
    }


def _pair(run_to, steps, file):
    """CPU seconds of a run with two frames and of one with all. Raises an error if they differ in their work."""
    none, (counts, few) = _timed(run_to, steps * H, every=NO_FRAMES)
    every, (same, many) = _timed(run_to, steps * H, **file)
    if (counts, few, many) != (same, 2, steps + 1):
        raise RuntimeError(f"{few} and {many} frames, with {counts} and {same}")
    return none, every


def _timed(run_to, t_end, **settings):
    """(CPU seconds, (counts, frames)) of a run, which is over with then."""
    seconds, run = cpu(lambda: run_to(t_end, **settings))
    return seconds, (run.counts, len(run))


def good(rows):
    """Rows that went well."""
    return [row for row in rows if row["part"] == "frames" and not row.get("error")]


def figures(rows):
    """{figure: ratio}."""
    return {row["figure"]: row["ratio"] for row in good(rows)}


def notes(rows):
    """Cost of a frame, and its cost in memory that the process has not used before."""
    return [
        f"{row['figure']}: {row['ratio']:.3f}; {row['extra_us']:.3g} us a frame beside a step of {row['none_ms']:.3g} ms "
        f"({row['first_ratio']:.2f} the first time, in new memory, of which a frame's costs {row['new_memory_us']:.3g} us by itself)"
        for row in good(rows)
    ]
