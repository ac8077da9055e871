"""Accuracy of Radau IIA: orders fitted over fixed steps, errors at a small tolerance, error of the tip relative to rtol."""

import numpy as np

from polyida.study.rows import column, farthest, fit_slope, number, pick
from work_precision import tip_accuracy

FIXED = "radau, fixed"
ORDER, PARTS = 5, ("q", "v", "lam")
ASYMPTOTIC = {"pendulum": 6.25e-2, "car-axis": 1.25e-2, "andrews": 1.5e-4, "damped-ramp": 5e-4}  # problem: largest step that is fitted, s
COARSER, FINER, SHORT = 4, 7, 4  # steps a factor of sqrt 2 apart, on either side of that; in the short selection every second one, to there
ABOVE = 10.0  # an error is fitted where it is so many times what is known
TIGHT = 1e-10  # rtol at which the classical problems are judged
CLASSICAL = ("pendulum", "car-axis", "andrews")
JUDGED = 1e-5, 1e-8  # rtol between which the tip's error is set beside it


def steps(problem, quick):
    """Steps from four times the largest that is fitted down, s."""
    taken = range(-COARSER, SHORT + 1, 2) if quick else range(-COARSER, FINER + 1)
    return [ASYMPTOTIC[problem] / 2 ** (k / 2) for k in taken]


def fitted_rows(rows, problem, part):
    """Runs with steps in the asymptotic range whose error is well above the accuracy of the reference."""
    runs = [row for row in pick(rows, problem=problem, integrator=FIXED) if row["x"] < 1.01 * ASYMPTOTIC[problem]]
    return [row for row in runs if row.get(f"error_{part}", 0) > ABOVE * row["known"].get(part, np.inf)]


def order(rows, problem, part):
    """Fitted order of a part at t_end in the steps that were taken, which divide the time evenly."""
    runs = fitted_rows(rows, problem, part)
    return -fit_slope(column(runs, "steps"), column(runs, f"error_{part}"))


def orders(rows):
    """Fitted orders, and for each part the one farthest from 5."""
    result = {}
    for part in PARTS:
        each = {f"radau_order_{part}_{problem.replace('-', '_')}": order(rows, problem, part) for problem in ASYMPTOTIC}
        result |= each | {f"radau_order_{part}": farthest(list(each.values()), ORDER)}
    return result


def at_tight_tolerance(rows):
    """Errors of q with error control at TIGHT, in the units of the problems; not in the quick selection."""
    runs = {
        problem: [row for row in rows if (row["problem"], row["integrator"], row["x"]) == (problem, "radau", TIGHT)]
        for problem in CLASSICAL
    }
    return {f"radau_{problem.replace('-', '_')}_error_q": number(result, "error_q") for problem, result in runs.items() if result}


def error_over_rtol(rows):
    """The largest tip error over rtol, m, on both scenes; NaN if a run failed."""
    runs = [row for row in tip_accuracy.of_integrator(rows, tip_accuracy.RADAU_DEFAULT) if JUDGED[1] / 1.01 < row["x"] < 1.01 * JUDGED[0]]
    shares = column(runs, "error_tip") / column(runs, "x")
    return {"radau_error_over_rtol": float(shares.max()) if len(shares) else float("nan")}


def notes(rows):
    """Ranges of the fits."""
    lines = []
    for problem in ASYMPTOTIC:
        texts = [
            f"{part} {order(rows, problem, part):.2f} ({len(runs)} steps)" for part in PARTS if (runs := fitted_rows(rows, problem, part))
        ]
        lines += [f"{problem}: order of {FIXED}, steps below {ASYMPTOTIC[problem]:g} s: {', '.join(texts)}"] if texts else []
    return lines
