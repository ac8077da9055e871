"""Conservation of energy and momentum over a long time by every integrator."""

import numpy as np

from energy.long_run import balance
from polyida.cli.study import main
from polyida.show.styles import legend_above, marker_style
from polyida.study.plotting import line_picture, panels, setting_label, short_number, study_figure
from polyida.study.rows import largest, pick, unfinished_notes
from polyida.study.tasks import Study
from work_precision.integrators import by_tolerance

STEP = 2e-3
MEMBERS = {
    "alpha": STEP,
    "alpha, rho 0.99": STEP,
    "alpha, rho 0.5": STEP,
    "alpha, stabilised": STEP,
    "alpha, Richardson": STEP,
    "HHT": STEP,
    "Newmark": STEP,
    "energy-momentum": STEP,
    "IDA ggl2": 1e-5,
    "IDA ggl1": 1e-5,
    "IDA index1": 1e-5,
}
SLOW = ("IDA ggl1", "IDA index1")  # the short selection has one form of IDA
FINE, DEFAULT = "swinging, default mesh", 160  # what each loses in all, J; cells a plate
LOSING = (("alpha", 1e-3), ("energy-momentum", 1e-3), ("radau, fixed", 5e-3), ("radau, fixed", 2.5e-3), ("radau", 1e-6))
DRAWN = ("alpha", "alpha, rho 0.5", "alpha, Richardson", "Newmark", "energy-momentum", "IDA ggl2", "radau, fixed")
LOST = 1.0  # relative change beyond which a run has nothing to do with the motion any more


def tasks(quick):
    cells, time, tight = (12, 10.0, 1e-6) if quick else (60, 10.0, 1e-7)
    members = [(member, x) for member, x in MEMBERS.items() if not (quick and member in SLOW)]
    members += [("energy-momentum", STEP / 2), ("alpha", STEP / 2), ("IDA ggl2", tight)]
    members += [("radau, fixed", 5e-3), ("radau, fixed", 2.5e-3), ("radau", 1e-5), ("radau", tight)]
    selection = [
        {"scene": scene, "integrator": member, "x": x, "time": time, "cells": cells}
        for scene in ("swinging", "thrown")
        for member, x in members
    ]
    return selection + [{"scene": FINE, "integrator": member, "x": x, "time": time, "cells": DEFAULT} for member, x in LOSING]


def run(scene, integrator, x, time, cells):
    return balance(scene, integrator, x, time, cells)


def headline(rows):
    return {"energy_momentum_relative_drift": largest(rows, "energy_drift", scene="swinging", integrator="energy-momentum")}


def drifts(rows):
    result = {f"energy_drift_{short(row)}": row["energy_drift"] for row in pick(rows, scene="swinging")}
    for row in pick(rows, scene="thrown"):
        result[f"angular_momentum_drift_{short(row)}"] = row["angular_drift"]
        result[f"linear_momentum_drift_{short(row)}"] = row["linear_drift"]
    return result


def losses(rows):
    """Energy change over the whole run on the default mesh, J."""
    return {f"energy_change_J_{short(row)}": row["energy_change"] for row in pick(rows, scene=FINE)}


def short(row):
    name = row["integrator"].replace(",", "").replace(" ", "_").replace("-", "_").replace(".", "")
    return f"{name}_{short_number(row['x'])}"


def label(row):
    return f"{row['integrator']}, {setting_label('rtol' if by_tolerance(row['integrator']) else 'h', row['x'])}"


def stop_notes(rows):
    """Unfinished runs; their drifts end where they stop."""
    return [f"{line}; drifts are up to there" for line in unfinished_notes(rows, "scene", "integrator", "x", length=140)]


def loss_notes(rows):
    """Energy change and cost of each run."""
    texts = [
        f"{label(row)} {row['energy_change']:+.2g} J, {row['steps']} steps, {row['cpu_s']:.2g} CPU s"
        for row in pick(rows, scene=FINE, outcome="done")
    ]
    return [f"{FINE}, 10 s without damping: {'; '.join(texts)}"] if texts else []


def gain_notes(rows):
    return [
        f"{row['scene']}, {label(row)} gains {max(row['energy']):.3g} times the scale of its energy"
        for row in pick(rows)
        if max(row["energy"]) > 1e-3
    ]


def running(row, what):
    """(t, largest |change| so far, True if the curve ends early): the curve ends when the change exceeds LOST or the run stops."""
    t, size = np.asarray(row["t"], float), np.maximum.accumulate(np.abs(np.asarray(row[what], float)))
    lost = size > LOST
    return t[~lost], np.maximum(size[~lost], 1e-16), bool(lost.any()) or row["outcome"] != "done"


def draw_change(axis, rows, scene, what):
    for i, member in enumerate(DRAWN):
        for dash, row in zip(("-", (0, (4, 1.6))), pick(rows, scene=scene, integrator=member)):
            t, size, cut = running(row, what)
            style = marker_style(i) | {"linestyle": dash, "markerfacecolor": "none", "markevery": (0.03 * i, 0.25)}
            axis.semilogy(t[1:], size[1:], label=label(row), **style)
            if cut and len(t) > 1:
                axis.plot(t[-1], size[-1], "x", color=style["color"], markersize=7, markeredgewidth=1.8)


@study_figure
def energy_figure(rows):
    """Largest relative change of energy and of angular momentum so far; a cross marks the end of a run that stopped or lost the motion."""
    fig, axes = panels(3, width=7.4, height=3.4, columns=3)
    for axis, scene, what in zip(axes, ("swinging", "thrown", "thrown"), ("energy", "energy", "angular")):
        draw_change(axis, rows, scene, what)
        axis.set(xlabel="t, s", title=f"{scene}: {'energy' if what == 'energy' else 'angular momentum'}")
    axes[0].set_ylabel("largest relative change so far")
    legend_above(fig, axes, 3)
    return line_picture(fig, "energy")


def figure_notes(rows):
    drawn_rows = [row for row in pick(rows) if row["integrator"] in DRAWN and row["scene"] != FINE]
    ended = [f"{row['scene']} {label(row)}" for row in drawn_rows if running(row, "energy")[2]]
    crosses = f"; a cross is where a run stopped or had changed by more than {LOST:g}: {'; '.join(ended)}" if ended else ""
    others = sorted({row["integrator"] for row in pick(rows)} - set(DRAWN))
    absent = f"; not drawn, but in the table: {'; '.join(others)}" if others else ""
    return [f"the figure shows the largest change so far{crosses}{absent}"] if pick(rows) else []


COLUMNS = (
    "scene",
    "integrator",
    "x",
    "dof",
    "steps",
    "cpu_s",
    "energy_change",
    "energy_drift",
    "linear_drift",
    "angular_drift",
    "outcome",
    "error",
)
STUDY = Study(
    "energy",
    "long-time energy and momentum; x is the step, s, or the tolerance",
    tasks,
    run,
    (headline, drifts, losses),
    energy_figure,
    COLUMNS,
    notes=(stop_notes, loss_notes, gain_notes, figure_notes),
    headline=("energy_momentum_relative_drift",),
)

if __name__ == "__main__":
    main(STUDY)
