"""Accuracy of gradients of runs at each Newton tolerance and at the default one, by objective and kind of parameter."""

from gradient_errors.measure import KINDS, OBJECTIVES, SCENES, error_row
from polyida.cli.study import main
from polyida.show.styles import legend_above, marker_style
from polyida.study.plotting import line_picture, panels, study_figure
from polyida.study.rows import column, distinct, largest, pick
from polyida.study.tasks import Study

TOLERANCES = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10)
AIM = 1e-6  # at a tolerance of 1e-10


def tasks(quick):
    """Each scene and tolerance with all objectives; None: the default tolerance, from the local error."""
    size = {"cells": 6, "t_end": 0.1} if quick else {"cells": 60, "t_end": 0.5}
    tolerances = (1e-4, 1e-6, 1e-8, 1e-10, None) if quick else (*TOLERANCES, None)
    return [
        {"scene": scene, "tolerance": tolerance, "objective": objective, **size}
        for scene in SCENES
        for tolerance in tolerances
        for objective in OBJECTIVES
    ]


def run(**task):
    """One row."""
    return error_row(**task)


def figures(rows):
    """Largest error of all at the default tolerance and at 1e-10; at the default tolerance also for each objective and kind of parameter."""
    result = {
        "gradient_error_default": largest(rows, "slope_error", tolerance=None),
        "gradient_error_1e-10": largest(rows, "slope_error", tolerance=1e-10),
    }
    for objective in OBJECTIVES:
        result[f"gradient_error_default_{objective.replace(' ', '_')}"] = largest(rows, "slope_error", tolerance=None, objective=objective)
    for kind in KINDS:
        numbers = [row[kind] for row in pick(rows, tolerance=None) if kind in row]
        if numbers:
            result[f"gradient_error_default_in_{kind}"] = max(numbers)
    return result


def notes(rows):
    """Definition of the errors, and missed targets."""
    result = figures(rows)["gradient_error_1e-10"]
    return [
        "errors: of slopes along a change of the whole parameter, beside differences of fourth order of the same steps at a Newton's "
        "tolerance of 1e-12; relative to the difference, or to a thousandth of J where that is larger; the largest of each kind",
        *([f"the largest error at a tolerance of 1e-10 is {result:.2g}, aim at most {AIM:g}"] if result > AIM else []),
    ]


@study_figure
def draw(rows):
    """Largest relative error of the slopes against Newton's tolerance for each objective; dotted: at the default tolerance."""
    scenes = distinct([row for row in pick(rows) if row["tolerance"]], "scene")
    fig, axes = panels(len(scenes), width=9.0, columns=3)
    for axis, scene in zip(axes, scenes):
        for i, objective in enumerate(OBJECTIVES):
            own = sorted(
                (row for row in pick(rows, scene=scene, objective=objective) if row["tolerance"]), key=lambda row: row["tolerance"]
            )
            axis.plot(column(own, "tolerance"), column(own, "slope_error"), label=objective, **marker_style(i))
            for row in pick(rows, scene=scene, objective=objective, tolerance=None):
                axis.axhline(row["slope_error"], linestyle=":", linewidth=0.8, color=marker_style(i)["color"])
        axis.set(xscale="log", yscale="log", title=scene, xlabel="Newton's tolerance")
    axes[0].set_ylabel("relative error of slopes")
    legend_above(fig, axes, columns=5)
    return line_picture(fig, "gradient-errors")


study = Study(
    "gradient_errors",
    "Accuracy of gradients",
    tasks,
    run,
    figures,
    draw,
    notes=notes,
    headline=("gradient_error_default", "gradient_error_1e-10"),
    columns=("scene", "objective", "tolerance", "n", "steps", "iterations", "slope_error", *KINDS),
)

if __name__ == "__main__":
    main(study)
