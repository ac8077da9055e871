"""A step of IDA relative to one of generalized-alpha, within runs, measured alternately."""

import numpy as np

from step_cost.measure import MEMBERS, model_of
from step_cost.side import LARGE, one_run, two_runs

SPANS = {  # s: (IDA, generalized-alpha), IDA behind the growth of its first steps
    1_000: ((0.1, 1.0), (0.01, 1.01)),
    10_000: ((0.1, 0.3), (0.01, 0.21)),
    100_000: ((0.02, 0.06), (0.01, 0.05)),
}


def ratio_row(dof, repeats):
    """Medians over `repeats` alternations of the CPU milliseconds of both steps and of their ratio, without frames; counts of IDA's steps.

    An alternation before loads the kernels; large models need none, because a step is the difference of two times of one run.
    """
    model, turns = model_of("scene 1", dof), []
    first = int(model.n < LARGE)
    for _ in range(first + repeats):
        turns.append([_step(model, name, *span) for name, span in zip(("ida", "alpha"), SPANS[dof])])
    ida, alpha = (np.array([turn[k]["ms"] for turn in turns[first:]]) for k in (0, 1))
    counts = {f"{key}_per_step": value for key, value in turns[-1][0].items() if key != "ms"}
    return {
        "n": model.n,
        "ida_ms": float(np.median(ida)),
        "alpha_ms": float(np.median(alpha)),
        "ratio": float(np.median(ida / alpha)),
    } | counts


def _step(model, name, short, long):
    """{"ms"} of a step, and its counts."""
    (begin, first), (end, last) = (two_runs if model.n < LARGE else one_run)(model, MEMBERS[name], short, long)
    steps, kinds = last.steps - first.steps, ("residuals", "solves", "factorizations")
    return {"ms": 1e3 * (end - begin) / steps} | {kind: (getattr(last, kind) - getattr(first, kind)) / steps for kind in kinds}


def notes(rows):
    """A step of IDA compared with one of generalized-alpha, and its counts."""
    return [
        f"{row['n']} coordinates: a step of IDA {row['ida_ms']:.3g} ms, of generalized-alpha {row['alpha_ms']:.3g}, in turn {row['ratio']:.2f}; "
        f"IDA's takes {row['residuals_per_step']:.2f} residuals, {row['factorizations_per_step']:.3f} factorizations and "
        f"{row['solves_per_step']:.2f} solves, those of the border with every factor among them"
        for row in rows
    ]
