"""Flexible bodies of polyhedra in space, as a model of a user's own outside the package: patch test, comparison with quadratic tetrahedra, and
the paper's two bars out of their plane in every integrator. `python studies/polyhedra/pictures.py FOLDER` writes pictures and VTU files.
"""

import numpy as np

from polyhedra import cases
from polyida.cli.study import main
from polyida.show.styles import marker_style
from polyida.study.plotting import line_picture, panels, study_figure
from polyida.study.rows import column, number, pick
from polyida.study.tasks import Study

STIFF, SOFT = 50e6, 0.5e6  # Pa
ROWS = {name.removesuffix("_row"): getattr(cases, name) for name in vars(cases) if name.endswith("_row")}
TIGHT = {"radau": 1e-9, "ida": 1e-9, "alpha extrapolated": 1e-4, "energy": 5e-5}
SETTINGS = {
    "alpha": (8e-3, 4e-3, 2e-3, 1e-3),
    "energy": (8e-3, 4e-3, 2e-3, 1e-3),
    "radau": (1e-3, 1e-4, 1e-5, 1e-6),
    "ida": (1e-4, 1e-5, 1e-6),
}
EXACT = {"integrator": "radau", "setting": 1e-8}
AIMS = "patch 1e-12; cantilever 2 % with 1000 cells, 1 % with 8000; bending, torsion 2 %; orders 2.0 and 5.0 +- 0.2; integrators apart 1e-6 m; "
AIMS += "energy 1e-9; step over factor solve and residual 1.5; gradient 1e-6; hinge: momentum 1e-9"


def tasks(quick):
    """Each row of the table, then work against precision and conditioning; quick: with few cells and without the long runs."""
    plan = [("patch", {"cells": cells, "seed": seed}) for cells in ((20, 60) if quick else (20, 200, 1000)) for seed in (1, 2)]
    plan += [("cantilever", {"cells": cells}) for cells in ((60,) if quick else (125, 1000, 8000))]
    plan += [("free", {"cells": cells, "lumped": lumped}) for cells in ((60,) if quick else (125, 1000)) for lumped in (True, False)]
    counts = {"alpha": (100, 200) if quick else (200, 400, 800, 1600), "radau": (25, 50) if quick else (25, 50, 100, 200)}
    plan += [
        ("order", {"cells": 8, "integrator": name, "counts": counts[name], "E": E})
        for name in counts
        for E in ((SOFT,) if quick else (STIFF, SOFT))
    ]
    runs = [] if quick else [(8, name, setting, 1.0) for name, setting in TIGHT.items()] + [(60, *EXACT.values(), 0.5)]
    runs += [] if quick else [(60, name, setting, 0.5) for name in SETTINGS for setting in SETTINGS[name]]
    runs += [(8, "energy", 2e-3, 0.5 if quick else 10.0)]
    plan += [("run", dict(zip(("cells", "integrator", "setting", "t_end"), one))) for one in runs]
    plan += [("hinge", {"cells": 8, "t_end": 0.2 if quick else 2.0})]
    plan += [("step", {"cells": 60 if quick else 1000, "h": h, "steps": 40}) for h in (1e-3, 3e-4, 1e-4)[: 1 if quick else 3]]
    plan += [("gradient", {"cells": 8, "t_end": 0.02 if quick else 0.1})]
    return [{"part": part} | row for part, row in plan + [("conditioning", {"cells": 8, "h": h}) for h in (1e-2, 1e-3, 1e-4, 1e-5)]]


def run(part, **arguments):
    """One row."""
    return ROWS[part](**arguments)


def accuracy(rows):
    """Errors against exact and converged solutions."""
    result = {"patch": max(column(pick(rows, part="patch"), "deviation"), default=np.nan)}
    result |= {f"cantilever_{row['cells']}": row["deviation"] for row in pick(rows, part="cantilever")}
    free = pick(rows, part="free", lumped=True)
    return result | {f"{name}_{row['cells']}": row[f"{name}_error"] for row in free for name in ("bending", "torsion")}


def motion(rows):
    """Orders, distances of integrators, energy, drift and gradients."""
    result = {f"order_{row['integrator']}_{'stiff' if row['E'] == STIFF else 'soft'}": row["order"] for row in pick(rows, part="order")}
    tips = [row["tip"] for row in pick(rows, part="run", cells=8, t_end=1.0)]
    result["integrators_apart_m"] = max((float(np.linalg.norm(np.subtract(tip, tips[0]))) for tip in tips), default=np.nan)
    result["energy"] = number(rows, "energy", part="run", integrator="energy", setting=2e-3, cells=8)
    return result | {
        "drift": max(column(pick(rows, part="run"), "drift"), default=np.nan),
        "gradient": number(rows, "deviation", part="gradient"),
        "hinge_momentum": number(rows, "momentum", part="hinge"),
    }


def cost(rows):
    """Generalized-alpha at each h: a step over one residual and one solve, over those that it takes, and their number; then milliseconds."""
    names, at = ("step_over_one", "step_over_iterations", "iterations"), pick(rows, part="step")
    times = {name: number(rows, name, part="step", h=1e-3) for name in ("residual_ms", "solve_ms", "factor_ms")}
    return {f"{name}_{row['h']:.0e}": row[name] for row in at for name in names} | times


@study_figure
def polyhedra_figure(rows):
    """Condition numbers against h; errors of q against h; errors of the bar's form against coordinates; error of the tip against CPU time."""
    fig, axes = panels(4, width=10.6, height=3.8)
    runs = pick(rows, part="run", cells=60)
    exact = [row["tip"] for row in pick(runs, **EXACT)]
    for i, name in enumerate(SETTINGS if exact else ()):
        points = [row for row in pick(runs, integrator=name) if row["tip"] != exact[0]]
        axes[3].loglog(
            column(points, "cpu_s"), [np.linalg.norm(np.subtract(row["tip"], exact[0])) for row in points], label=name, **marker_style(i)
        )
    at = pick(rows, part="conditioning")
    for i, name in enumerate(f"{method}_{scaling}" for method in ("alpha", "radau", "ida") for scaling in ("scaled", "none")):
        axes[0].loglog(column(at, "h"), column(at, name), label=name.replace("_", ", ").replace("none", "raw"), **marker_style(i))
    for i, row in enumerate(pick(rows, part="order")):
        axes[1].loglog(row["sizes"], row["errors"], label=f"{row['integrator']}, E = {1e-6 * row['E']:g} MPa", **marker_style(i))
    lines = {"cantilever": ("deviation", pick(rows, part="cantilever"))}
    for name in ("bending", "torsion"):
        for mass, lumped in (("lumped", True), ("consistent", False)):
            lines[f"{name}, {mass}"] = f"{name}_error", pick(rows, part="free", lumped=lumped)
    for i, (label, (name, points)) in enumerate(lines.items()):
        axes[2].loglog(column(points, "n"), column(points, name), label=label, **marker_style(i))
    below, beside = (
        ("h, s", "h, s", "n", "CPU time, s"),
        ("condition number", "largest error of q, m", "relative error", "error of the tip, m"),
    )
    for axis, x, y in zip(axes, below, beside):
        axis.set(xlabel=x, ylabel=y, visible=bool(axis.lines))
        if axis.lines:
            axis.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    return line_picture(fig, "polyhedra")


COLUMNS = ("part", "cells", "n", "integrator", "setting", "E", "h", "deviation", "bending_error", "torsion_error", "order", "energy", "momentum",
           "drift", "step_over_one", "cpu_s", "steps", "iterations", "factorizations", "outcome")  # fmt: skip
STUDY = Study("polyhedra", "Polyhedra in space: a user's own model in every integrator", tasks, run, (accuracy, motion, cost), polyhedra_figure,
              COLUMNS, notes=lambda rows: [f"aims: {AIMS}"], headline=("patch", "energy", "gradient", "hinge_momentum", "step_over_one_1e-03"))  # fmt: skip

if __name__ == "__main__":
    main(STUDY)
