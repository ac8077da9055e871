"""Topology optimisation of plates in motion with gradients of a run, compared with the best static design, a thinner plate and a narrower
one.
"""

from itertools import zip_longest

import numpy as np

from designed_in_motion import designs, pictures
from designed_in_motion.machines import MACHINES
from designed_in_motion.solids import LEVELS
from polyida.cli.study import main
from polyida.show.html import Movie
from polyida.show.styles import legend_above, marker_style
from polyida.study.plotting import line_picture, panels, picture, study_figure
from polyida.study.rows import distinct, last, pick, value
from polyida.study.tasks import Study

MOTION, STATIC, PLAIN = "in motion", tuple(designs.LOADS), ("uniform", "bar")
DESIGNS = (MOTION, *STATIC, *PLAIN)
CELLS = {"arm": 1000, "two arms": 800}  # of a plate
QUICK = {"arm": 400}


def tasks(quick):
    return [
        {"machine": machine, "design": design, "cells": cells, "effort": "short" if quick else "full"}
        for machine, cells in (QUICK if quick else CELLS).items()
        for design in DESIGNS
    ]


def run(**task):
    return designs.design(**task)


def best_static(rows, machine):
    """The row of the static design with the smallest J after thresholding, None if there is none: the comparison is with this one."""
    result = [row for name in STATIC for row in pick(rows, machine=machine, design=name)]
    return min(result, key=lambda row: row["J"], default=None)


def gains(rows):
    """J of the static optimum relative to the design in motion, both thresholded, and the time that the design of the arm takes."""
    moving, still = last(rows, machine="arm", design=MOTION), best_static(rows, "arm")
    plain = {name: value(last(rows, machine="arm", design=name), "J") / value(moving, "J") for name in PLAIN}
    return {
        "design_gain_over_static": value(still, "J") / value(moving, "J"),
        **{f"design_gain_over_{name}": gain for name, gain in plain.items()},
        "design_wall_s": value(moving, "wall_s"),
        "design_cpu_s": value(moving, "cpu_s"),
    }


def measures(rows):
    """J, the largest deviation, the largest deviation after the motors stop, and the peak torque of every thresholded design."""
    names = {"J": "J_m2", "largest": "deviation_m", "after": "deviation_after_m", "torque": "torque_Nm"}
    return {f"{short(row)}_{name}": row[key] for row in pick(rows) for key, name in names.items()}


def short(row):
    return "_".join(f"{row['machine']} {row['design']}".replace(",", "").split())


def design_notes(rows):
    """One line for each thresholded design, and the method of the designs."""
    lines = [
        f"{row['machine']}, {row['design']}: J {row['J']:.3g} m2, at most {1e3 * row['largest']:.3g} mm off, "
        f"{1e3 * row['after']:.2g} once the motors stand, torque {row['torque']:.3g} N m, "
        f"{1e3 * row['thickness']:.4g} mm thick"
        for row in pick(rows)
    ]
    return lines + [
        f"{row['machine']}, {row['design']}: {row['evaluations']} evaluations in {row['wall_s']:.3g} s ({row['cpu_s']:.3g} CPU s), "
        f"{row['first']:.3g} to {row['grey_J']:.3g} on densities, "
        f"{100 * row['grey']:.2g} % grey; what has a density of {row['at']:.2f} and more is solid"
        for row in pick(rows)
        if "rho" in row
    ]


def what_is_compared(rows):
    levels = ", ".join(f"{at:g}" for at in LEVELS)
    return [
        "all designs of a machine have the same mass: the thickness of a solid design makes up for cells that are more or fewer than the volume "
        f"asks for. Of the densities {levels} from which a cell is solid each design has the one with which it moves best, and the static design "
        "that is compared with is the one of both that moves best",
        "the design in motion begins with both static ones, a stage earlier, and goes on with the better after its own first stage; its evaluations "
        "are those of this way, its seconds those of all. The optimiser ends in one of many optima: other starts end elsewhere, up to a third off",
    ]


@study_figure
def densities_figure(rows):
    """Densities of the designs from the start through the projection stages to the end; black is solid."""
    result = [row for row in pick(rows) if "rho" in row]
    count = max((len(row["stages"]) + 1 for row in result), default=0)
    fig, axes = panels(count * len(result), width=9.0, height=0.75, columns=count)
    for line, row in zip(axes.reshape(len(result), count), result):
        meshes = pictures.meshes_of(row)
        for axis, rho in zip_longest(line, [*row["stages"], row["rho"]]):
            axis.set_visible(rho is not None)
            if rho is not None:
                pictures.draw_densities(axis, meshes, rho)
        line[0].set_title(f"{row['machine']}, {row['design']}", loc="left", fontsize=7)
    return picture(fig, "densities")


@study_figure
def solids_figure(rows):
    """The thresholded designs, all of the same mass."""
    result = pick(rows)
    fig, axes = panels(len(result), width=9.0, height=1.25)
    for axis, row in zip(axes, result):
        pictures.draw_meshes(axis, pictures.solids_of(row), MACHINES[row["machine"]].height)
        axis.set_title(f"{row['machine']}, {row['design']}: J = {row['J']:.3g} m2", loc="left")
    return picture(fig, "solids")


@study_figure
def history_figure(rows):
    """Objective relative to its initial value against evaluations; the projection becomes sharper from stage to stage."""
    result = [row for row in pick(rows) if "rho" in row]
    fig, (axis,) = panels(1 if result else 0, width=5.6)
    for i, row in enumerate(result):
        values = np.array(row["history"]) / row["history"][0]
        axis.semilogy(range(1, len(values) + 1), values, **marker_style(i) | {"marker": ""}, label=f"{row['machine']}, {row['design']}")
    axis.set(xlabel="evaluation", ylabel="of the value at the start")
    legend_above(fig, axis, 2)
    return line_picture(fig, "history")


@study_figure
def motion_figure(rows):
    """Deviation of the tip from that of a rigid machine, and torque of the first motor, against time; thresholded designs."""
    machines = distinct(pick(rows), "machine")
    fig, axes = panels(2 * len(machines), width=8.0, height=2.6)
    for (off, torque), machine in zip(axes.reshape(-1, 2), machines):
        for row in pick(rows, machine=machine):
            style = marker_style(DESIGNS.index(row["design"])) | {"marker": ""}
            off.semilogy(row["t"], np.maximum(1e3 * np.array(row["off"]), 1e-3), label=row["design"], **style)
            torque.plot(row["t"], row["torques"][0], label=row["design"], **style)
        off.set(xlabel="t, s", ylabel="deviation of the tip, mm", title=machine)
        torque.set(xlabel="t, s", ylabel="torque, N m", title=machine)
    legend_above(fig, axes, 5)
    return line_picture(fig, "motion")


@study_figure
def movie(rows):
    """The arm in motion: the design in motion, the static design and the bar of the same mass."""
    shown = [last(rows, machine="arm", design=MOTION), best_static(rows, "arm"), last(rows, machine="arm", design="bar")]
    if not any(shown):
        raise LookupError("no rows to draw")
    names = [row["design"] for row in shown if row]
    caption = f"The arm, solid and of equal mass, from left to right: {'; '.join(names)}. Coloured by von Mises stress."
    return [Movie(pictures.beside_each_other([row for row in shown if row]), caption, 6.0)]


STUDY = Study(
    "designed_in_motion",
    "plates designed in motion: the mean square deviation J of the tip, of solid designs of equal mass",
    tasks,
    run,
    (gains, measures),
    (densities_figure, solids_figure, history_figure, motion_figure, movie),
    (
        "machine",
        "design",
        "cells",
        "J",
        "largest",
        "after",
        "torque",
        "thickness",
        "at",
        "evaluations",
        "wall_s",
        "cpu_s",
        "grey_J",
        "grey",
        "error",
    ),
    notes=(design_notes, what_is_compared),
    headline=("design_gain_over_static", "design_wall_s"),
)

if __name__ == "__main__":
    main(STUDY)
