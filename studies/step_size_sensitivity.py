"""Accuracy for steps from 1e-1 to 1e-9 s on motors and weighted joints: order, round-off and stagnation of Newton's iteration, with each
scaling and evaluation of phi.
"""

import numpy as np

from polyida.cli.study import main
from polyida.linear.saddle import SCALINGS
from polyida.show.styles import legend_above
from polyida.study.plotting import line_picture, loglog, nested_style, panels, slope_line, study_figure
from polyida.study.rows import column, distinct, farthest, last, number, pick, unfinished_notes, value
from polyida.study.tasks import Study
from step_size_sensitivity import radau, slopes
from step_size_sensitivity.errors import decades, order_errors, reference_floor, tiny_steps
from step_size_sensitivity.slopes import PARTS, SOLVES, WAYS, runs_of

COARSEST, HALVINGS, TIME = 1e-2, 5, 0.25
SCENES = ("scene 2", "smooth motors")
PLAIN = "index3, plain start"


def tasks(quick):
    cells, selection, largest = 8 if quick else 12, [], 1e-2 if quick else 1e-1
    for kind in ("load", "motors"):
        selection += [
            {"part": "order", "scene": kind, "cells": cells, "form": form, "halvings": k}
            for form in ("index3", "stabilised", PLAIN)
            for k in range(HALVINGS)
        ]
    return (
        selection
        + [
            {"part": "tiny", "scene": scene, "cells": cells, "phi": phi, "solve": solve, "h": h, "largest": largest}
            for scene in SCENES
            for phi in WAYS
            for solve in SOLVES
            for h in decades(1e-9, largest)
        ]
        + radau.tasks(cells, largest)
    )


def run(part, scene, cells, **options):
    if part in (radau.ORDER, radau.TINY):
        return radau.run(part, scene, cells, **options)
    if part == "tiny":
        compiled = options["solve"] == "compiled"
        how = {"linear": "auto"} if compiled else {"linear": "kkt", "scaling": options["solve"]}
        return tiny_steps(scene, cells, options["h"], 1e-9, options["largest"], incremental_phi=WAYS[options["phi"]], **how)
    form, _, plain = options["form"].partition(", ")
    start = "plain" if plain else "consistent"
    errors = order_errors(scene, cells, COARSEST, options["halvings"], TIME, form=form, start=start)
    floor = reference_floor(scene, cells, COARSEST, TIME)
    result = {f"error_{name}": value for name, value in errors.items()} | {f"floor_{name}": value for name, value in floor.items()}
    return result | {"h": COARSEST / 2 ** options["halvings"]}


def orders(rows):
    result = {f"order_{part}_{kind}": slopes.order(rows, kind, part) for part in PARTS for kind in ("load", "motors")}
    for part in PARTS:
        result[f"order_{part}"] = farthest([result[f"order_{part}_load"], result[f"order_{part}_motors"]], 2)
    return result | {"order_a_plain_start": slopes.order(rows, "motors", "a", PLAIN)}


def smallest_step(rows):
    result = {}
    for phi, name in (("carried", ""), ("from positions", "_phi_from_positions")):
        end = last(rows, part="tiny", scene="scene 2", phi=phi, solve="compiled", h=1e-9)
        result[f"lam_error_h1e-9{name}"] = value(end, "error_lam")
        result[f"acceleration_error_h1e-9{name}"] = value(end, "error_a")
    return result


def fitted_slopes(rows):
    return {name: slope for name, _, _, slope, _ in slopes.table(rows)}


def order_notes(rows):
    result = orders(rows)
    lines = [
        f"order in {part} is {order:.3f}, not within 0.05 of 2" for part in PARTS if abs((order := result[f"order_{part}"]) - 2) > 0.05
    ]
    for kind in ("load", "motors"):
        runs = runs_of(rows, part="order", scene=kind, form="index3")
        for part in PARTS:
            if len(fitted_runs := slopes.above_floor(runs, part)) < len(runs):
                lines.append(
                    f"order in {part}, smooth {kind}: the reference is known to {value(runs[0], f'floor_{part}'):.1e}; "
                    f"{len(fitted_runs)} of {len(runs)} steps are fitted"
                )
    return lines


def range_notes(rows):
    """The range of the steps, and cases without a stagnation level."""
    tiny = pick(rows, part="tiny")
    lines = [f"h runs from {min(distinct(tiny, 'h')):g} to {max(distinct(tiny, 'h')):g} s"] if tiny else []
    blind = [row for row in tiny if row["outcome"] == "done" and not np.isfinite(value(row, "stall_q"))]
    for scene, h in dict.fromkeys((row["scene"], row["h"]) for row in blind):
        lines.append(f"{scene}, h = {h:g} s: no stall level, as the iteration with the matrix of the step's begin runs away")
    return lines + unfinished_notes(tiny, "scene", "phi", "solve", "h", length=120)


def scaling_notes(rows):
    """Effect of the scaling on the round-off of lam with phi from positions."""
    errors = {
        solve: number(rows, "error_lam", part="tiny", scene="scene 2", phi="from positions", solve=solve, h=1e-9) for solve in SCALINGS
    }
    errors = {solve: error for solve, error in errors.items() if np.isfinite(error)}
    if len(errors) < 2:
        return []
    low, high = min(errors, key=errors.get), max(errors, key=errors.get)
    carried = number(rows, "error_lam", part="tiny", scene="scene 2", phi="carried", solve=low, h=1e-9)
    return [
        f"phi from positions at h = 1e-9: lam is off by {errors[low]:.2g} (scaling {low}) to {errors[high]:.2g} "
        f"(scaling {high}), a factor of {errors[high] / errors[low]:.2g} between scalings; "
        f"carried phi, scaling {low}: {carried:.2g}"
    ]


@study_figure
def order_figure(rows):
    """Largest relative error over smooth motion against the step, and a line of slope 2."""
    fig, axes = panels(2, height=3.0, sharey=True)
    for axis, kind in zip(axes, ("load", "motors")):
        runs = runs_of(rows, part="order", scene=kind, form="index3")
        for i, part in enumerate(PARTS):
            loglog(axis, column(runs, "h"), column(runs, f"error_{part}"), i, part)
        plain = runs_of(rows, part="order", scene=kind, form=PLAIN)
        loglog(axis, column(plain, "h"), column(plain, "error_a"), 4, "a, plain start")
        if runs:
            lowest = np.nanmin([value(runs[0], f"error_{part}") for part in PARTS]) / 3
            slope_line(axis, 2, [runs[0]["h"], runs[-1]["h"]], lowest, "slope 2", offset=(-1, -20))
        axis.set(xlabel="step h, s", title=f"smooth {kind}")
    axes[0].set_ylabel("largest relative error")
    legend_above(fig, axes, 5)
    return line_picture(fig, "order")


def nest(axis, rows, scene, solves, name):
    """Lines of both evaluations of phi (colours) with each solver (nested hollow markers)."""
    for colour, phi in enumerate(WAYS):
        for ring, solve in enumerate(solves):
            runs = runs_of(rows, part="tiny", scene=scene, phi=phi, solve=solve)
            good = [row for row in runs if value(row, name) > 0]
            look = nested_style(colour, ring, len(solves), "-" if phi == "carried" else (0, (4, 2)))
            axis.plot(column(good, "h"), column(good, name), label=f"phi {phi}, {solve}", **look)


def theory_lines(axis, rows, scene, part):
    """Theoretical slopes: of the method, and of the round-off of phi from positions."""

    def at(phi, h):
        return number(rows, f"error_{part}", part="tiny", scene=scene, phi=phi, solve="physical", h=h)

    if np.isfinite(at("carried", 1e-4)):
        slope_line(axis, slopes.METHOD[part], [1e-4, 1e-2], 20 * at("carried", 1e-4), offset=(-3, 2))
    if np.isfinite(at("from positions", 1e-6)):
        slope_line(axis, slopes.ROUND_OFF[part], [1e-6, 1e-8], 20 * at("from positions", 1e-6), offset=(3, 2))


def tiny_figure(rows, scene):
    fig, axes = panels(4, height=2.5)
    for axis, part in zip(axes, PARTS):
        nest(axis, rows, scene, SOLVES, f"error_{part}")
        axis.set(title=f"{part}, {scene}", xlabel="step h, s", ylabel="relative error", xscale="log", yscale="log")
        theory_lines(axis, rows, scene, part)
    legend_above(fig, axes, 2)
    return line_picture(fig, f"tiny-steps-{scene.replace(' ', '-')}")


@study_figure
def tiny_scene_2_figure(rows):
    """Relative errors after four steps on scene 2 against the step, with phi from increments and from positions; dashed: theoretical
    slopes.
    """
    return tiny_figure(rows, "scene 2")


@study_figure
def tiny_smooth_figure(rows):
    """Relative errors after four steps on smooth motors against the step, with phi from increments and from positions; dashed: theoretical
    slopes.
    """
    return tiny_figure(rows, "smooth motors")


@study_figure
def newton_figure(rows):
    """Stagnation level and iterations of Newton's method against the step."""
    fig, axes = panels(2, height=2.8)
    nest(axes[0], rows, "scene 2", SCALINGS, "stall_q")
    nest(axes[1], rows, "scene 2", SCALINGS, "iterations")
    axes[0].set(xscale="log", yscale="log", title="Newton's stall, scene 2", ylabel="|dq| / (beta h² |a|)", xlabel="step h, s")
    axes[1].set(xscale="log", title="Newton's work, scene 2", ylabel="iterations a step", xlabel="step h, s", ylim=(0, None))
    level = number(rows, "stall_q", part="tiny", scene="scene 2", phi="from positions", solve="physical", h=1e-6)
    if np.isfinite(level):
        slope_line(axes[0], slopes.STALL["from positions"], [1e-5, 1e-8], 0.2 * level, offset=(3, 2))
    legend_above(fig, axes, 2)
    return line_picture(fig, "newton")


COLUMNS = ("part", "scene", "form", "phi", "solve", "h", "error_q", "error_v", "error_a", "error_lam", "iterations", "stall_q", "error")
STUDY = Study(
    "step_size_sensitivity",
    "generalized-alpha and Radau IIA against their step; errors relative to the largest value",
    tasks,
    run,
    (orders, smallest_step, fitted_slopes, radau.figures),
    (order_figure, tiny_scene_2_figure, tiny_smooth_figure, newton_figure, radau.figure),
    COLUMNS,
    notes=(order_notes, slopes.in_words, range_notes, scaling_notes),
    headline=("order_q", "order_v", "order_lam", "lam_error_h1e-9", "acceleration_error_h1e-9"),
)

if __name__ == "__main__":
    main(STUDY)
