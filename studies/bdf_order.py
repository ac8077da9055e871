"""Cost of high BDF orders: orders 3 to 5 are unstable near the imaginary axis, where the undamped modes of a mesh lie.

The study also measures the cost of an error test that weights v as strongly as q: velocities of stiff modes change with every change of the
step.
"""

from bdf_order.order import run_order, run_tested
from polyida.cli.study import main
from polyida.show.styles import marker_style
from polyida.study.plotting import line_picture, panels, study_figure
from polyida.study.rows import column, distinct, last, number, pick, unfinished_notes, value
from polyida.study.tasks import Study

ORDERS = (1, 2, 3, 4, 5)
TESTED = ("q sharply", "q and v alike")


def tasks(quick):
    cells, time, cap = (20, 0.5, 6_000) if quick else (100, 1.0, 60_000)
    materials = (0.0, 1e-4) if quick else (0.0, 1e-6, 1e-5, 1e-4, 1e-3)
    orders = [
        {"viscosity": viscosity, "max_order": order, "rtol": 1e-5, "cells": cells, "time": time, "cap": cap}
        for viscosity in materials
        for order in ORDERS
    ]
    plates = {"cells": 12, "time": 0.3, "cap": 2_000} if quick else {"cells": 40, "time": 1.0, "cap": 20_000}
    moduli = (5e7, 1e12) if quick else (5e7, 1e9, 1e10, 1e11, 1e12)
    return orders + [{"modulus": E, "tested": what, "rtol": rtol} | plates for E in moduli for rtol in (1e-5, 1e-6) for what in TESTED]


def run(**task):
    """One run of either part."""
    return run_tested(**task) if "tested" in task else run_order(**task)


def ratios(rows):
    """Steps per simulated second at order 5 relative to order 2, for each material."""
    result = {}
    for viscosity in distinct(rows, "viscosity"):
        high, low = (number(rows, "steps_per_s", viscosity=viscosity, max_order=order) for order in (5, 2))
        result["steps_order5_over_order2" + (f"_viscosity_{viscosity:.0e}" if viscosity else "")] = high / low
    return result


def undamped(rows):
    low, high = (last(rows, viscosity=0.0, max_order=order) for order in (2, 5))
    return {
        "steps_order2": value(low, "steps"),
        "steps_order5": value(high, "steps"),
        "tip_error_order2": value(low, "tip_error"),
        "cpu_order5_over_order2": value(high, "cpu_s") / value(low, "cpu_s"),
    }


def weights(rows):
    """Steps per simulated second with v weighted like q, relative to the default."""
    result = {}
    for row in pick(rows, tested="q and v alike"):
        other = number(rows, "steps_per_s", **{key: row[key] for key in ("modulus", "rtol")}, tested="q sharply")
        result[f"steps_v_alike_over_default_{row['modulus']:.0e}_rtol_{row['rtol']:.0e}"] = row["steps_per_s"] / other
    return result


def weight_notes(rows):
    """Result of both error tests, one line for each modulus and tolerance."""
    texts = {
        key: [f"{what}: {row['steps']} steps, {row['rejected']} rejected, {_end(row)}" for what, row in runs.items()]
        for key, runs in _by_plate(rows).items()
    }
    return [f"E = {E:.0e} Pa, rtol {rtol:.0e}, tested are {'; '.join(lines)}" for (E, rtol), lines in texts.items()]


def _end(row):
    return f"tip {row['tip_error']:.1e} m" if row["outcome"] == "done" else f"stopped at {row['t_reached']:.3g} s"


def _by_plate(rows):
    """{(modulus, rtol): {weights: row}}."""
    result = {}
    for row in pick(rows):
        if "tested" in row:
            result.setdefault((row["modulus"], row["rtol"]), {})[row["tested"]] = row
    return result


def notes(rows):
    rows = [row for row in rows if "max_order" in row]
    capped = [row for row in pick(rows) if row["outcome"] != "done"]
    lines = unfinished_notes(rows, "viscosity", "max_order", length=140)
    covered = "; ".join(f"order {row['max_order']} at viscosity {row['viscosity']:g} s {row['t_reached']:.3g} s" for row in capped)
    if capped:
        lines.append(f"ratios compare steps per simulated second, as {len(capped)} of {len(rows)} runs stopped early: {covered}")
    return lines


@study_figure
def bdf_order_figure(rows):
    """IDA's steps per second against its largest order; its steps over time; its steps per second against stiffness for two error tests."""
    fig, axes = panels(3 if pick(rows) else 0, width=10.6, height=3.8)
    steps_panel(axes[0], rows)
    history_panel(axes[1], rows)
    weights_panel(axes[2], rows)
    for axis in [axis for axis in axes if axis.lines]:
        axis.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    return line_picture(fig, "bdf-order")


def steps_panel(axis, rows):
    """Steps per simulated second against the largest order; unfinished runs have hollow markers."""
    for i, viscosity in enumerate(distinct(rows, "viscosity")):
        runs = pick(rows, viscosity=viscosity)
        label = f"viscosity {viscosity:g} s" if viscosity else "undamped"
        axis.semilogy(column(runs, "max_order"), column(runs, "steps_per_s"), label=label, **marker_style(i))
    ended = [row for row in pick(rows) if row["outcome"] != "done"]
    if ended:
        axis.plot(
            column(ended, "max_order"),
            column(ended, "steps_per_s"),
            "o",
            markersize=9,
            markerfacecolor="none",
            color="#222222",
            markeredgewidth=0.8,
            label="stopped before the end",
        )
    axis.set(xlabel="highest order of BDF", ylabel="steps per simulated second", xticks=ORDERS)


def history_panel(axis, rows):
    """Steps over time of the undamped plates; a cross marks an unfinished run."""
    for i, order in enumerate(ORDERS):
        row = last(rows, viscosity=0.0, max_order=order)
        if row is None:
            continue
        axis.semilogy(row["t"], row["h"], label=f"order {order}", **marker_style(i) | {"marker": "", "linestyle": "-"})
        if row["outcome"] != "done":
            axis.plot(
                row["t"][-1],
                row["h"][-1],
                "x",
                color=marker_style(i)["color"],
                markersize=8,
                markeredgewidth=2.0,
                zorder=5,
                label=f"order {order} stopped, {row['t_reached']:.3g} s",
            )
    axis.set(xlabel="t, s", ylabel="step of the undamped plates, s")


def weights_panel(axis, rows):
    """Steps per simulated second against Young's modulus for both error tests; unfinished runs have hollow markers."""
    colours = {key: marker_style(i) for i, key in enumerate((rtol, what) for rtol in distinct(rows, "rtol") for what in TESTED)}
    for (rtol, what), style in colours.items():
        runs = sorted(pick(rows, rtol=rtol, tested=what), key=lambda row: row["modulus"])
        if runs:
            axis.loglog(column(runs, "modulus"), column(runs, "steps_per_s"), label=f"tested: {what}, rtol {rtol:.0e}", **style)
            ended = [row for row in runs if row["outcome"] != "done"]
            hollow = {"markersize": 9, "markerfacecolor": "none", "color": "#222222", "markeredgewidth": 0.8}
            axis.plot(column(ended, "modulus"), column(ended, "steps_per_s"), "o", **hollow)
    axis.set(xlabel="Young's modulus, Pa", ylabel="steps per simulated second, order 2")


COLUMNS = (
    "viscosity",
    "max_order",
    "modulus",
    "tested",
    "rtol",
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
    "IDA on the swinging double plate: largest order of BDF, and weights of the error test",
    tasks,
    run,
    (ratios, undamped, weights),
    bdf_order_figure,
    COLUMNS,
    notes=(notes, weight_notes),
    headline=("steps_order5_over_order2", "steps_v_alike_over_default_1e+12_rtol_1e-06"),
)

if __name__ == "__main__":
    main(STUDY)
