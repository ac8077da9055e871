"""What the highest order of BDF costs: 3 to 5 are unstable beside the imaginary axis, where undamped mesh modes lie."""

from polyida.cli_study import main
from polyida.study.drawing import drawn, look, panels, saved
from polyida.study.harness import Study
from polyida.study.order import run_order

ORDERS = (1, 2, 3, 4, 5)


def tasks(quick):
    cells, time, cap = (20, 0.25, 20_000) if quick else (100, 1.0, 60_000)
    materials = (0.0, 1e-4) if quick else (0.0, 1e-6, 1e-5, 1e-4, 1e-3)
    return [
        {"viscosity": viscosity, "max_order": order, "rtol": 1e-5, "cells": cells, "time": time, "cap": cap}
        for viscosity in materials
        for order in ORDERS
    ]


def pick(rows, **wanted):
    return [row for row in rows if not row.get("error") and all(row.get(key) == value for key, value in wanted.items())]


def figures(rows):
    found = {}
    for viscosity in dict.fromkeys(row["viscosity"] for row in pick(rows)):
        per_second = {row["max_order"]: row["steps_per_s"] for row in pick(rows, viscosity=viscosity)}
        name = "steps_order5_over_order2" + (f"_viscosity_{viscosity:.0e}" if viscosity else "")
        found[name] = per_second[5] / per_second[2]
    undamped = {row["max_order"]: row for row in pick(rows, viscosity=0.0)}
    return found | {
        "steps_order2": undamped[2]["steps"],
        "steps_order5": undamped[5]["steps"],
        "tip_error_order2": undamped[2]["tip_error"],
        "cpu_order5_over_order2": undamped[5]["cpu_s"] / undamped[2]["cpu_s"],
    }


def notes(rows):
    lines = [
        f"viscosity {row['viscosity']:g} s, order {row['max_order']}: {row['outcome'][:140]}"
        for row in pick(rows)
        if row["outcome"] != "done"
    ]
    return lines + [
        "ratios compare steps per simulated second, so that a run that met its cap counts with what it covered"
    ]


@drawn
def draw(rows, folder):
    made, axes = panels(2, height=3.0)
    for i, viscosity in enumerate(dict.fromkeys(row["viscosity"] for row in rows)):
        runs = pick(rows, viscosity=viscosity)
        label = f"viscosity {viscosity:g} s" if viscosity else "undamped"
        axes[0].semilogy(
            [row["max_order"] for row in runs], [row["steps_per_s"] for row in runs], label=label, **look(i)
        )
    for i, row in enumerate(pick(rows, viscosity=0.0)):
        axes[1].semilogy(
            row["t"], row["h"], label=f"order {row['max_order']}", **look(i) | {"marker": "", "linestyle": "-"}
        )
    axes[0].set(xlabel="highest order", ylabel="steps per simulated second", xticks=ORDERS)
    axes[1].set(xlabel="t, s", ylabel="step, s (mean of ten)", title="undamped")
    for axis in axes:
        axis.legend(loc="best", fontsize=7)
    return saved(made, folder, "bdf-order")


COLUMNS = (
    "viscosity",
    "max_order",
    "dof",
    "steps",
    "steps_per_s",
    "rejected",
    "residuals",
    "factorizations",
    "cpu_s",
    "tip_error",
    "outcome",
    "error",
)
STUDY = Study(
    "bdf_order",
    "IDA on the swinging double plate: the highest order of BDF",
    tasks,
    run_order,
    figures,
    draw,
    COLUMNS,
    notes=notes,
)

if __name__ == "__main__":
    main(STUDY)
