"""Estimated beside measured errors of quantities of runs: of time steps, meshes, modes, and of random scenes, with their cost."""

from itertools import product

import numpy as np

from error_bars import cases
from polyida.cli.study import main
from polyida.show.styles import legend_above, marker_style
from polyida.study.plotting import line_picture, panels, study_figure
from polyida.study.rows import column, pick
from polyida.study.tasks import Study

RUNS = {
    "time": cases.time_row,
    "mesh": cases.mesh_row,
    "adapted": cases.adapted_row,
    "modes": cases.modes_row,
    "fall": cases.fall_row,
    "random": cases.random_row,
}
MEANS = ("mean place", "mean strain energy")


def tasks(quick):
    """Each scene, step and objective; each mesh; each number of modes; falling pendulums; random scenes."""
    result = []
    for scene, steps in cases.STEPS.items():
        names = ["mean place", "mean lam^2", "peak reaction" if scene == "slider crank" else MEANS[1], "place at the end", "lam at the end"]
        if not quick:
            result += [{"part": "time", "scene": scene, "h": h, "objective": name} for h in steps for name in names]
        elif scene != "double plate":
            result += [{"part": "time", "scene": scene, "h": steps[1], "objective": name} for name in names]
    for scene, cells in cases.CELLS.items():
        result += [
            {"part": "mesh", "scene": scene, "cells": count, "objective": name}
            for count in (cells[:1] if quick else cells)
            for name in MEANS
        ]
    result += [{"part": "modes", "modes": modes} for modes in (cases.MODES[:2] if quick else cases.MODES)]
    if not quick:
        result += [{"part": "adapted", "refinements": k} for k in range(4)]
    falls = [dict(zip(cases.FALLS, values)) for values in product(*cases.FALLS.values())]
    result += [{"part": "fall"} | each for each in (falls[4::9] if quick else falls)]
    return result + [{"part": "random", "seed": seed} for seed in range(4 if quick else 40)]


def run(part, **task):
    """One row."""
    return RUNS[part](**task)


def figures(rows):
    """Numbers of trusted estimates outside a factor of 1.5 and of false alarms, extreme ratios and the cost."""
    timed, result = pick(rows, part="time"), {}
    if timed:
        result["missed"] = sum(row["trusted"] and row["outside"] for row in timed)
        result["false_alarms"] = sum(not row["trusted"] and not row["outside"] for row in timed)
        result["cost_over_gradient"] = float(np.median(column(timed, "cost")))
    gains = column(pick(rows, part="adapted"), "uniform_over_adapted")
    if len(gains):
        result["uniform_over_adapted"] = float(gains[-1])
    for part in ("mesh", "adapted", "modes"):
        ratios = column(pick(rows, part=part), "ratio")
        if len(ratios):
            result |= {f"{part}_ratio_min": float(np.min(ratios)), f"{part}_ratio_max": float(np.max(ratios))}
    falls = pick(rows, part="fall")
    good = [row["ratio"] for row in falls if row["trusted"]]
    if good:
        result |= {"fall_trusted": len(good), "fall_ratio_min": min(good), "fall_ratio_max": max(good)}
        result["fall_wrong"] = sum(row["outside"] for row in falls)
    trusted = [row for row in pick(rows, part="random") if row["trusted"]]
    if trusted:
        result["random_within"] = float(np.mean([not row["outside"] for row in trusted]))
        result["random_worst"] = float(max(max(abs(row["ratio"]), 1 / abs(row["ratio"])) for row in trusted))
        result["random_trusted"] = len(trusted) / len(pick(rows, part="random"))
    return result


def notes(rows):
    """The meaning of the ratios, and the trusted estimates that are wrong."""
    wrong = [row for row in pick(rows) if row["trusted"] and row["outside"]]
    return [
        "ratio: estimate over error, beside extrapolated runs (time), extrapolated meshes, or the full plate (modes); missed: trusted estimates "
        "of the error of time with a ratio outside 2/3 to 3/2; false alarms: good ones that are not trusted; fall_wrong: estimates with such a "
        "ratio for falling pendulums",
        *(
            f"{row['part']}, {row.get('scene', '')} {row.get('objective', '')} {row.get('seed', '')}: trusted, ratio {row['ratio']:.2f}"
            for row in wrong
        ),
    ]


@study_figure
def draw(rows):
    """Ratio of estimate and error against the relative change by another phase of lost vibrations; grey: a factor of 1.5."""
    parts = "time", "fall", "random"
    timed = [row for row in pick(rows) if row["part"] in parts]
    fig, axes = panels(1 if timed else 0, width=6.4)
    for i, part in enumerate(parts):
        own = pick(timed, part=part)
        if own:
            style = marker_style(i) | {"linestyle": "none"}
            axes[0].plot(np.maximum(column(own, "fast_share"), 1e-4), np.clip(column(own, "ratio"), -2.0, 4.0), label=part, **style)
    if timed:
        axes[0].axhspan(1 / cases.FACTOR, cases.FACTOR, color="0.9", zorder=0)
        axes[0].set(xscale="log", xlabel="relative change by another phase of lost vibrations", ylabel="estimate over error")
    legend_above(fig, axes, columns=3)
    return line_picture(fig, "error-bars")


study = Study(
    "error_bars",
    "Estimated errors of quantities of runs",
    tasks,
    run,
    figures,
    draw,
    notes=notes,
    headline=("missed", "false_alarms"),
    columns=(
        "part",
        "scene",
        "objective",
        "h",
        "rho_inf",
        "t_end",
        "cells",
        "modes",
        "refinements",
        "uniform_over_adapted",
        "seed",
        "exact_error",
        "estimate",
        "ratio",
        "fast_share",
        "trusted",
        "twice",
        "cost",
    ),
)

if __name__ == "__main__":
    main(study)
