"""Accuracy with default settings except for a step or a tolerance: errors of the tip of scenes 1 and 2 after 1 s.

The scenes are the problems "double-plate" and "double-plate-motors" on their default meshes with their digits. Only h or rtol is set, so
that the defaults are tested.
"""

from functools import lru_cache

import numpy as np

from polyida import problems
from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.integrate.ida.integrator import IDA
from polyida.integrate.radau.radau_iia import RadauIIA
from polyida.run.solve import solve
from polyida.study.rows import column, fit_slope

SCENES = {"scene 1, 1 s": "double-plate", "scene 2, 1 s": "double-plate-motors"}  # in the table: problem
ALPHA, IDA_DEFAULT, RADAU_DEFAULT = "alpha, as it comes", "IDA, as it comes", "radau, as it comes"
BY_TOLERANCE = {IDA_DEFAULT: IDA, RADAU_DEFAULT: RadauIIA}
STEPS = (2e-3, 1e-3, 5e-4, 2.5e-4)
TOLERANCES = tuple(float(f"1e-{k}") for k in range(3, 9))
TIGHT = 1e-10  # Newton's tolerance that does not show

problem_of = lru_cache(maxsize=2)(problems.get)


def tasks(quick):
    """Newton's share and Radau's error beside rtol on both scenes, IDA's slope on the undamped one: all but IDA's tightest tolerance in
    the short selection.
    """
    steps = [(scene, ALPHA, h) for scene in SCENES for h in STEPS]
    tolerances = [("scene 1, 1 s", IDA_DEFAULT, rtol) for rtol in (TOLERANCES[:-1] if quick else TOLERANCES)]
    tolerances += [(scene, RADAU_DEFAULT, rtol) for scene in SCENES for rtol in TOLERANCES]
    return [{"problem": scene, "integrator": name, "x": x, "quick": quick} for scene, name, x in steps + tolerances]


def measure(scene, name, x):
    """error_tip: distance of the tip from the digits, m; newton_tip: distance from the same run with Newton's TIGHT tolerance.

    known_tip: accuracy of the digits. A failed run has its message as outcome and no errors.
    """
    problem = problem_of(SCENES[scene])
    runs = [solve(problem.model, problem.t_end, chosen, every=10**9) for chosen in _runs(name, x)]
    failed = [run.message for run in runs if not run.success]
    row = {"outcome": failed[0] if failed else "done", "steps": runs[0].counts.steps, "cpu_s": runs[0].cpu_seconds}
    row |= {"residuals": runs[0].counts.residuals, "factorizations": runs[0].counts.factorizations}
    row |= {"reference": problem.source, "known": problem.known_to, "known_tip": problem.known_to["tip"]}
    if failed:
        return row
    ends = [run.position("tip")[-1] for run in runs]
    row["error_tip"] = float(np.linalg.norm(ends[0] - problem.reference["tip"]))
    return row | ({"newton_tip": float(np.linalg.norm(ends[0] - ends[1]))} if len(ends) > 1 else {})


def _runs(name, x):
    """The integrator that is judged, and the one beside which its Newton iteration is judged."""
    if name in BY_TOLERANCE:
        return (BY_TOLERANCE[name](rtol=x),)
    return GeneralizedAlpha(h=x), GeneralizedAlpha(h=x, tolerance=TIGHT)


def of_integrator(rows, name):
    """All rows of an integrator, failed ones included."""
    return [row for row in rows if row["problem"] in SCENES and row["integrator"] == name]


def newton_share(rows):
    """Largest newton_tip / error_tip of the points whose error is above the accuracy of the digits; NaN if a run failed."""
    runs = of_integrator(rows, ALPHA)
    error, newton, known = (column(runs, name) for name in ("error_tip", "newton_tip", "known_tip"))
    above = error > known
    whole = above.any() and np.isfinite(error + newton).all()
    return {"newton_share": float((newton[above] / error[above]).max()) if whole else float("nan")}


def ida_error_slope(rows):
    """Fitted slope of error_tip over rtol for the points above the accuracy of the digits; NaN if a run failed."""
    runs = of_integrator(rows, IDA_DEFAULT)
    rtol, error, known = (column(runs, name) for name in ("x", "error_tip", "known_tip"))
    whole = len(runs) and np.isfinite(error).all()
    return {"ida_error_slope": fit_slope(rtol[error > known], error[error > known]) if whole else float("nan")}


def notes(rows):
    """Error of each point, and the part of it that comes from Newton's iteration."""
    lines = []
    for row in [row for name in (ALPHA, *BY_TOLERANCE) for row in of_integrator(rows, name)]:
        if "error_tip" in row:
            part = f", Newton's part {row['newton_tip'] / row['error_tip']:.2g}" if "newton_tip" in row else ""
            name, what = row["integrator"], "h =" if "newton_tip" in row else "rtol"
            lines.append(f"{row['problem']}: {name}, {what} {row['x']:g}: tip off by {row['error_tip']:.2e} m{part}")
    return lines
