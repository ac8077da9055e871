"""Full, reduced and rigid plates: error against CPU time, and cost of a step and of the reduction."""

import warnings

from levels import costs, runs
from levels.scenes import FULL, RIGID, goes_at_any_level
from polyida import registry
from polyida.cli.study import main
from polyida.errors import ReductionWarning
from polyida.show.styles import INK, legend_above, marker_style
from polyida.study.plotting import line_picture, loglog, panels, study_figure, target_line
from polyida.study.rows import column, distinct, number, pick, unfinished_notes
from polyida.study.tasks import Study

MODES = {"double-plate": (3, 5, 8, 10, 12), "double-plate-motors": (5, 10), "spin-up-beam": (3, 5, 8, 12, 16)}  # problem: numbers of modes
OTHERS = (3, 5, 10)  # of problems that go at any level by themselves
QUICK = {"double-plate": (5, 10), "spin-up-beam": (12,), "two-link-arm": (5,)}
STEPS = {"spin-up-beam": (5e-4, 2.5e-4, 1.25e-4, 6e-5, 3e-5)}  # h over the time
COMMON = (4e-3, 2e-3, 1e-3, 5e-4, 2.5e-4, 1.25e-4)  # of the other problems
CELLS = (160, 400, 1000, 4000)
MEASURES = {"run": runs.measure, "step": costs.step, "reduction": costs.reduction}
AIMS, AIM_STEP = ((5, 1e-4), (10, 1e-5), (12, 1e-4)), 25e-6  # modes and distance, m, of the last the spin-up beam's; s


def tasks(quick):
    modes = QUICK if quick else MODES | {name: OTHERS for name in registry.problems if goes_at_any_level(name)}
    return [
        *(
            {"part": "run", "problem": name, "level": level, "x": x}
            for name, numbers in modes.items()
            for level in (FULL, *numbers, RIGID)
            for x in (None, *STEPS.get(name, COMMON)[slice(0, 4, 2) if quick else slice(None)])
        ),
        *({"part": "step", "cells": cells, "level": level} for cells in (CELLS[::3] if quick else CELLS) for level in (FULL, 5, 10, RIGID)),
        *({"part": "reduction", "cells": cells, "level": 5} for cells in (CELLS[::3] if quick else CELLS)),
    ]


def run(part, **task):
    """One task, without the warning about omitted modes: their effect is measured here."""
    with warnings.catch_warnings(action="ignore", category=ReductionWarning):
        return MEASURES[part](**task)


def distances(rows):
    """Largest distance of the tip with reduced and rigid plates from that with full plates, m, all by Radau IIA with a small tolerance."""
    wanted = {
        "reduced_gap_5": ("double-plate", 5),
        "reduced_gap_10": ("double-plate", 10),
        "rigid_gap": ("double-plate", RIGID),
        "reduced_spin_gap": ("spin-up-beam", 12),
    }
    return {name: number(rows, "distance", part="run", problem=problem, level=level, x=None) for name, (problem, level) in wanted.items()}


def costs_of(rows):
    """Microseconds of a step with 5 modes for each plate, the speed-up over full plates, and seconds of a reduction."""

    def seconds(cells, level):
        return number(rows, "step_s", part="step", cells=cells, level=level)

    result = {f"reduced_step_us_{cells}": 1e6 * seconds(cells, 5) for cells in (160, 4000)}
    result |= {"rigid_step_us": 1e6 * seconds(160, RIGID), "reduced_speedup_4000": seconds(4000, FULL) / seconds(4000, 5)}
    return result | {"reduction_s_4000": number(rows, "reduction_s", part="reduction", cells=4000)}


def place(level):
    """Position of a level in a legend: full, most modes first, rigid."""
    return -level if isinstance(level, int) else {FULL: -1000, RIGID: 0}[level]


def words(level):
    """Name of a level in a legend."""
    return f"{level} modes" if isinstance(level, int) else level


def stop_notes(rows):
    return unfinished_notes(rows, "problem", "level", "x")


def table_notes(rows):
    """Distance of each level, and its cost with the longest step that adds no larger error."""
    lines = []
    for name in distinct(rows, "problem"):
        for level in distinct(pick(rows, problem=name), "level"):
            result = pick(rows, problem=name, level=level)
            own = number(result, "distance", x=None)
            good = [row for row in result if row["x"] is not None and row["distance"] <= 2 * own]
            cost = f"; CPU {min(column(good, 'cpu_s')):.2g} s within twice of that" if good else ""
            anywhere = number(result, "anywhere", x=None)
            lines.append(f"{name}, {words(level)}, {result[0]['n']} coordinates: {own:.2g} m off, joints {anywhere:.2g} m{cost}")
    return lines


@study_figure
def runs_figure(rows):
    """CPU seconds against the distance of the tip from that with full plates, one panel for each problem, from long to short steps."""
    result = [row for row in rows if row.get("x") is not None]
    problems, levels = distinct(result, "problem"), sorted(distinct(result, "level"), key=place)
    fig, axes = panels(len(problems), height=3.2)
    for axis, name in zip(axes, problems):
        for i, level in enumerate(levels):
            points = pick(result, problem=name, level=level)
            loglog(axis, column(points, "distance"), column(points, "cpu_s"), i, words(level))
        axis.set(title=name, xlabel="distance from full plates, m", ylabel="CPU seconds")
    legend_above(fig, axes, 5)
    return line_picture(fig, "levels")


@study_figure
def modes_figure(rows):
    """Distance of the tip with reduced plates from that with full plates against the number of modes."""
    result = [row for row in pick(rows, part="run", x=None) if isinstance(row["level"], int)]
    fig, (axes,) = panels(1, width=5.0)
    for i, name in enumerate(distinct(result, "problem")):
        points = pick(result, problem=name)
        axes.semilogy([row["level"] for row in points], column(points, "distance"), label=name, **marker_style(i))
    axes.semilogy(*zip(*AIMS), label="aims", color=INK, marker="_", markersize=9, linestyle="")
    axes.set(xlabel="modes a plate", ylabel="distance from full plates, m")
    legend_above(fig, axes, 3)
    return line_picture(fig, "levels_modes")


@study_figure
def steps_figure(rows):
    """CPU time of a step against the cells of a plate; the dashed line is the target."""
    result = pick(rows, part="step")
    fig, (axes,) = panels(1 if result else 0, width=5.0)
    for i, level in enumerate(distinct(result, "level")):
        points = pick(result, level=level)
        loglog(axes, column(points, "cells"), 1e6 * column(points, "step_s"), i, words(level))
    target_line(axes, 1e6 * AIM_STEP, "aim, 5 modes")
    axes.set(xlabel="cells a plate", ylabel="CPU time of a step, µs")
    legend_above(fig, axes, 4)
    return line_picture(fig, "levels_steps")


STUDY = Study(
    "levels",
    "full, reduced and rigid plates; x is h of generalized-alpha relative to the time, empty for Radau IIA with a small tolerance",
    tasks,
    run,
    (distances, costs_of),
    (runs_figure, modes_figure, steps_figure),
    (
        "part",
        "problem",
        "level",
        "cells",
        "n",
        "x",
        "distance",
        "anywhere",
        "cpu_s",
        "steps",
        "step_s",
        "iterations",
        "reduction_s",
        "outcome",
        "error",
    ),
    notes=(table_notes, stop_notes),
    headline=(
        "reduced_gap_5",
        "reduced_gap_10",
        "reduced_spin_gap",
        "reduced_step_us_160",
        "reduced_step_us_4000",
        "reduced_speedup_4000",
        "reduction_s_4000",
    ),
)

if __name__ == "__main__":
    main(STUDY)
