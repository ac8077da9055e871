"""The step from 1e-1 to 1e-9 s on motors and weighted joints: order, round-off, Newton's stall, with each scaling and
way to take phi.
"""

import numpy as np

from polyida.cli_study import main
from polyida.linear.kkt import SCALINGS
from polyida.study.drawing import drawn, fitted, legend, loglog, panels, saved, slope_line
from polyida.study.harness import Study
from polyida.study.sensitivity import PARTS, decades, order_errors, tiny_steps

THEORY = {
    "q": (3, 0),
    "v": (2, -1),
    "a": (2, -2),
    "lam": (2, -2),
}  # in h after a few steps: method, round-off of phi from positions
COARSEST, HALVINGS, TIME = 1e-2, 5, 0.25
WAYS = {"carried": True, "from positions": False}  # how phi is taken
SOLVES = (*SCALINGS, "compiled")  # the whole matrix in a scaling, or the compiled steps through the Schur complement
SCENES = ("scene 2", "smooth motors")


def tasks(quick):
    cells, made, largest = 8 if quick else 12, [], 1e-2 if quick else 1e-1
    for kind in ("load", "motors"):
        made += [
            {"part": "order", "scene": kind, "cells": cells, "form": form, "halvings": k}
            for form in ("index3", "stabilised", "index3, plain start")
            for k in range(HALVINGS)
        ]
    return made + [
        {"part": "tiny", "scene": scene, "cells": cells, "phi": phi, "solve": solve, "h": h, "largest": largest}
        for scene in SCENES
        for phi in WAYS
        for solve in SOLVES
        for h in decades(1e-9, largest)
    ]


def run(part, scene, cells, **options):
    if part == "order":
        form, _, start = options["form"].partition(", ")
        errors = order_errors(
            scene, cells, COARSEST, options["halvings"], TIME, form=form, start="plain" if start else "consistent"
        )
        return {f"error_{name}": value for name, value in errors.items()} | {"h": COARSEST / 2 ** options["halvings"]}
    compiled = options["solve"] == "compiled"
    how = {"linear": "auto"} if compiled else {"linear": "kkt", "scaling": options["solve"]}
    return tiny_steps(scene, cells, options["h"], 1e-9, options["largest"], incremental_phi=WAYS[options["phi"]], **how)


def pick(rows, **wanted):
    kept = [row for row in rows if not row.get("error") and all(row.get(key) == value for key, value in wanted.items())]
    return sorted(kept, key=lambda row: row["h"])


def column(rows, name):
    return np.array([np.nan if row.get(name) is None else row[name] for row in rows], float)


def slope(rows, name, low, high):
    kept = [row for row in rows if low * 0.99 <= row["h"] <= high * 1.01]
    return fitted(column(kept, "h"), column(kept, name))


def figures(rows):
    found = {}
    for part in PARTS:
        for kind in ("load", "motors"):
            runs = pick(rows, part="order", scene=kind, form="index3")
            found[f"order_{part}_{kind}"] = fitted(column(runs, "h"), column(runs, f"error_{part}"))
        found[f"order_{part}"] = min(
            found[f"order_{part}_load"], found[f"order_{part}_motors"], key=lambda order: -abs(order - 2)
        )
    plain = pick(rows, part="order", scene="motors", form="index3, plain start")
    found["order_a_plain_start"] = fitted(column(plain, "h"), column(plain, "error_a"))
    for phi, name in (("carried", ""), ("from positions", "_phi_from_positions")):
        end = pick(rows, part="tiny", scene="scene 2", phi=phi, solve="compiled", h=1e-9)[0]
        found[f"lam_error_h1e-9{name}"], found[f"acceleration_error_h1e-9{name}"] = end["error_lam"], end["error_a"]
    runs = pick(rows, part="tiny", scene="smooth motors", phi="from positions", solve="physical")
    for part in PARTS:
        found[f"slope_method_{part}"] = slope(runs, f"error_{part}", 1e-4, 1e-2)
        found[f"slope_round_off_{part}"] = slope(runs, f"error_{part}", 1e-9, 1e-7)
    for phi in WAYS:
        runs = pick(rows, part="tiny", scene="scene 2", phi=phi, solve="physical")
        found[f"stall_slope_phi_{phi.replace(' ', '_')}"] = slope(runs, "stall_q", 1e-9, 1e-5)
    return found


def notes(rows):
    found = figures(rows)
    lines = [
        f"slopes after a few steps, {part}: method {found[f'slope_method_{part}']:+.2f} (theory {method:+d}), "
        f"round-off of phi from positions {found[f'slope_round_off_{part}']:+.2f} (theory {round_off:+d})"
        for part, (method, round_off) in THEORY.items()
    ]
    lines += [
        f"order in {part} is {found[f'order_{part}']:.3f}, not within 0.05 of 2"
        for part in ("q", "v", "lam")
        if abs(found[f"order_{part}"] - 2) > 0.05
    ]
    lines += [
        f"{row['scene']}, phi {row['phi']}, {row['solve']}, h {row['h']:g}: {row['outcome'][:120]}"
        for row in pick(rows, part="tiny")
        if row["outcome"] != "done"
    ]
    return lines + [
        "no scaling lowers the round-off that phi from positions puts into lam: it acts on the linear solve only"
    ]


@drawn
def draw(rows, folder):
    return (
        order_figure(rows, folder)
        + tiny_figure(rows, folder, "scene 2")
        + tiny_figure(rows, folder, "smooth motors")
        + newton_figure(rows, folder)
    )


def order_figure(rows, folder):
    made, axes = panels(2, height=3.0, sharey=True)
    for axis, kind in zip(axes, ("load", "motors")):
        runs = pick(rows, part="order", scene=kind, form="index3")
        for i, part in enumerate(PARTS):
            loglog(axis, column(runs, "h"), column(runs, f"error_{part}"), i, part)
        plain = pick(rows, part="order", scene=kind, form="index3, plain start")
        loglog(axis, column(plain, "h"), column(plain, "error_a"), 4, "a, plain start")
        slope_line(axis, 2, [1e-2, 1e-3], np.nanmin([column(runs, f"error_{part}")[-1] for part in PARTS]) / 2)
        axis.set(xlabel="step h, s", title=f"smooth {kind}")
    axes[0].set_ylabel("largest relative error")
    legend(made, axes, 5)
    return saved(made, folder, "order")


def tiny_figure(rows, folder, scene):
    made, axes = panels(4, height=2.3)
    for axis, part in zip(axes, PARTS):
        for i, (phi, solve) in enumerate((phi, solve) for phi in WAYS for solve in SOLVES):
            runs = pick(rows, part="tiny", scene=scene, phi=phi, solve=solve)
            loglog(axis, column(runs, "h"), column(runs, f"error_{part}"), i, f"phi {phi}, {solve}")
        axis.set(title=f"{part}, {scene}", xlabel="step h, s", ylabel="relative error")
    legend(made, axes, 3)
    return saved(made, folder, f"tiny-steps-{scene.replace(' ', '-')}")


def newton_figure(rows, folder):
    made, axes = panels(2, height=2.8)
    for axis, name, title in zip(
        axes, ("stall_q", "iterations"), ("Newton stalls at |dq| / (beta h² |a|)", "Newton iterations a step")
    ):
        for i, (phi, solve) in enumerate((phi, solve) for phi in WAYS for solve in SCALINGS):
            runs = pick(rows, part="tiny", scene="scene 2", phi=phi, solve=solve)
            loglog(axis, column(runs, "h"), column(runs, name), i, f"phi {phi}, {solve}")
        axis.set(title=title, xlabel="step h, s")
    legend(made, axes, 3)
    return saved(made, folder, "newton")


COLUMNS = (
    "part",
    "scene",
    "form",
    "phi",
    "solve",
    "h",
    "error_q",
    "error_v",
    "error_a",
    "error_lam",
    "iterations",
    "stall_q",
    "error",
)
STUDY = Study(
    "step_size_sensitivity",
    "generalized-alpha against its step; errors relative to the largest value",
    tasks,
    run,
    figures,
    draw,
    COLUMNS,
    notes=notes,
)

if __name__ == "__main__":
    main(STUDY)
