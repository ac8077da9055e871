"""Radau IIA against its step: order on smooth motion, and round-off at tiny steps, with each form."""

import numpy as np

from polyida.integrate.radau.radau_iia import RadauIIA
from polyida.show.styles import legend_above
from polyida.study.plotting import line_picture, nested_style, panels, slope_line, study_figure
from polyida.study.rows import column, fit_slope, last, value
from step_size_sensitivity.errors import after_steps, decades, order_errors, reference_floor
from step_size_sensitivity.slopes import PARTS, above_floor, runs_of

FORMS = {"ggl": {}, "index3": {"form": "index3"}, "index3, v as it is": {"form": "index3", "project": False}}
ORDER, TINY = "order of radau", "radau at tiny steps"  # parts of the table
COARSEST, HALVINGS, TIME = 2.5e-2, 5, 0.25
KINDS, SCENE = ("load", "motors"), "scene 2"


def tasks(cells, largest):
    """Every form on both smooth motions, and from 1e-9 s up."""
    selection = [
        {"part": ORDER, "scene": kind, "cells": cells, "form": form, "halvings": k}
        for kind in KINDS
        for form in FORMS
        for k in range(HALVINGS)
    ]
    return selection + [
        {"part": TINY, "scene": SCENE, "cells": cells, "form": form, "h": h, "largest": largest}
        for form in FORMS
        for h in decades(1e-9, largest)
    ]


def run(part, scene, cells, form, halvings=0, h=0.0, largest=0.0):
    """The row of a task."""

    def method(h, **more):
        return RadauIIA(h=h, **FORMS[form], **more)

    if part == TINY:
        return after_steps(scene, cells, h, 1e-9, largest, method(h, max_halvings=0))[0]
    errors = order_errors(scene, cells, COARSEST, halvings, TIME, method)
    floor = reference_floor(scene, cells, COARSEST, TIME)
    result = {f"error_{name}": x for name, x in errors.items()} | {f"floor_{name}": x for name, x in floor.items()}
    return result | {"h": COARSEST / 2**halvings}


def figures(rows):
    """Fitted orders of each form on smooth motion, the errors of lam and a at the smallest step."""
    result = {}
    for form in FORMS:
        name = form.replace(",", "").replace(" ", "_")
        for kind in KINDS:
            for part in PARTS:
                runs = above_floor(runs_of(rows, part=ORDER, scene=kind, form=form), part)
                result[f"radau_{name}_order_{part}_{kind}"] = fit_slope(column(runs, "h"), column(runs, f"error_{part}"))
        for part in ("lam", "a"):
            result[f"radau_{name}_{part}_error_h1e-9"] = value(last(rows, part=TINY, form=form, h=1e-9), f"error_{part}")
    return {name: x for name, x in result.items() if np.isfinite(x)}


@study_figure
def figure(rows):
    """Errors of q, v and lam against the step: on smooth motion driven by motors, and after four tiny steps."""
    fig, axes = panels(6, width=7.4, height=2.6, columns=3)
    for row, (part, scene, title) in enumerate(((ORDER, "motors", "smooth motors"), (TINY, SCENE, "four steps, scene 2"))):
        for axis, name in zip(axes[3 * row : 3 * row + 3], ("q", "v", "lam")):
            for i, form in enumerate(FORMS):
                runs = runs_of(rows, part=part, scene=scene, form=form)
                good = [row for row in runs if value(row, f"error_{name}") > 0]
                axis.plot(column(good, "h"), column(good, f"error_{name}"), label=form, **nested_style(i, i, len(FORMS)))
            finest = runs_of(rows, part=ORDER, scene=scene, form="ggl")
            if len(finest) > 1:
                slope_line(axis, 5, [finest[0]["h"], finest[-1]["h"]], value(finest[0], f"error_{name}"), offset=(-3, 2))
            axis.set(title=f"{name}, {title}", xlabel="step h, s")
            if any(len(line.get_xdata()) for line in axis.get_lines()):
                axis.set(xscale="log", yscale="log")
        axes[3 * row].set_ylabel("largest relative error")
    legend_above(fig, axes, 3)
    return line_picture(fig, "radau")
