"""Ablation of the optimisations: each is switched off in turn, and CPU time and the number of additional computations are measured."""

import numpy as np

from polyida.cli.study import main
from polyida.study.plotting import picture, study_figure
from polyida.study.rows import distinct, pick
from polyida.study.tasks import Study
from skip import savings


def tasks(quick):
    """Every optimisation at one size, cells of a plate and time in s; in the full selection at two sizes."""
    sizes = ((120, 0.2, 3),) if quick else ((120, 1.0, 3), (1300, 0.03, 3))
    return [
        {"saving": name, "cells": cells, "t_end": t_end, "repeats": repeats} for cells, t_end, repeats in sizes for name in savings.SAVINGS
    ]


def run(saving, cells, t_end, repeats):
    return savings.measure(saving, cells, t_end, repeats)


def figures(rows):
    """CPU time without the optimisation relative to that with it: `<optimisation>_<cells>`."""
    names = {row["saving"]: "_".join("".join(c if c.isalnum() else " " for c in row["saving"].lower()).split()) for row in rows}
    return {f"{names[row['saving']]}_{row['cells']}": row["times"] for row in rows if not row.get("error")}


def notes(rows):
    return list(savings.FIXED)


@study_figure
def draw(rows):
    """CPU time without each optimisation relative to that with it."""
    from polyida.show.styles import PALETTE, figure

    names, sizes = distinct(rows, "saving"), distinct(rows, "cells")
    if not pick(rows):
        raise LookupError("no rows to draw")
    fig, axes = figure(6.4, 1.0 + 0.26 * len(names))
    for k, cells in enumerate(sizes):
        result = {row["saving"]: row["times"] for row in rows if row["cells"] == cells and not row.get("error")}
        places = np.arange(len(names)) + (k - (len(sizes) - 1) / 2) * 0.8 / len(sizes)
        values = np.array([result.get(name, np.nan) for name in names])
        label = f"{cells} cells a plate"
        axes.barh(places, values - 1.0, 0.8 / len(sizes), left=1.0, color=PALETTE[k], label=label)
    axes.set_xscale("log")
    axes.set_xticks([1, 2, 5, 10, 20], ["1", "2", "5", "10", "20"], minor=False)
    axes.set_xticks([], minor=True)
    axes.set_yticks(range(len(names)), names)
    axes.set(xlabel="CPU time without the saving over CPU time with it")
    axes.invert_yaxis()
    axes.legend(loc="lower right")
    return picture(fig, "skip")


study = Study(
    "skip",
    "Ablation of the optimisations",
    tasks,
    run,
    figures,
    draw,
    notes=notes,
    columns=("saving", "cells", "off", "counted", "count_on", "count_off", "cpu_on_s", "cpu_off_s", "times"),
)

if __name__ == "__main__":
    main(study)
