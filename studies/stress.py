"""Robustness limits: scenes with increasingly extreme parameters, run by every integrator. The study classifies each run."""

import numpy as np

from polyida.cli.study import main
from polyida.show.styles import figure
from polyida.study.plotting import picture, study_figure
from polyida.study.tasks import Study
from stress.axes import meanings, run, tasks
from stress.outcome import OUTCOMES, figures, limits, outcome_in

COLUMNS = ("axis", "value", "integrator", "outcome", "checked", "deviation", "bound", "steps", "cpu_s", "status", "reason")
COLOURS = {
    "right": "#0072B2",
    "stated_stop": "#56B4E9",
    "unforeseen_stop": "#E69F00",
    "wrong": "#D55E00",
    "crash": "#000000",
    "hang": "#CC79A7",
}


@study_figure
def draw(rows):
    """Draw a map of the outcomes: a row for each axis, a column for each integrator, a coloured square for each value from mild to
    extreme.
    """
    axes = list(dict.fromkeys(row["axis"] for row in rows))
    names = list(dict.fromkeys(row["integrator"] for row in rows))
    fig, panel = figure(1.2 + 1.1 * len(names), 1.0 + 0.24 * len(axes))
    for row_number, axis in enumerate(axes):
        for column, name in enumerate(names):
            of_cell = [row for row in rows if row["axis"] == axis and row["integrator"] == name]
            x = column + (np.arange(len(of_cell)) + 0.5) / max(8, len(of_cell)) * 0.9
            panel.scatter(x, np.full(len(x), row_number), marker="s", s=14, color=[COLOURS[outcome_in(row)] for row in of_cell])
    panel.set_yticks(range(len(axes)), axes)
    panel.set_xticks(np.arange(len(names)) + 0.4, names)
    panel.invert_yaxis()
    panel.grid(False)
    for outcome in OUTCOMES:
        panel.scatter([], [], marker="s", s=14, color=COLOURS[outcome], label=outcome.replace("_", " "))
    fig.legend(loc="outside upper center", ncols=len(OUTCOMES))
    return picture(fig, "stress")


def notes(rows):
    """Lines of text: what a correct run is on each axis, and the limits of the integrators."""
    axes = dict.fromkeys(row["axis"] for row in rows)
    return [f"right: {line}" for line in meanings(axes)] + [f"breaks: {line}" for line in limits(rows)]


STUDY = Study("stress", "Robustness limits", tasks, run, figures, draw, COLUMNS, isolated=True, limit=300.0, notes=notes, fresh=False)

if __name__ == "__main__":
    main(STUDY)
