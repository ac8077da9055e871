"""Energy and momentum over a long time, every integrator."""

import numpy as np

from polyida.cli_study import main
from polyida.study.drawing import drawn, legend, look, panels, saved
from polyida.study.harness import Study
from polyida.study.long_run import balance

STEP = 2e-3
MEMBERS = {
    "alpha": STEP,
    "alpha, rho 0.99": STEP,
    "alpha, rho 0.5": STEP,
    "alpha, stabilised": STEP,
    "alpha, Richardson": STEP,
    "HHT": STEP,
    "Newmark": STEP,
    "energy-momentum": STEP,
    "IDA ggl2": 1e-5,
    "IDA ggl1": 1e-5,
    "IDA index1": 1e-5,
}


def tasks(quick):
    cells, time, tight = (12, 10.0, 1e-6) if quick else (60, 10.0, 1e-7)
    members = list(MEMBERS.items()) + [("energy-momentum", STEP / 2), ("alpha", STEP / 2), ("IDA ggl2", tight)]
    return [
        {"scene": scene, "integrator": member, "x": x, "time": time, "cells": cells}
        for scene in ("swinging", "thrown")
        for member, x in members
    ]


def run(scene, integrator, x, time, cells):
    return balance(scene, integrator, x, time, cells)


def pick(rows, **wanted):
    return [row for row in rows if not row.get("error") and all(row.get(key) == value for key, value in wanted.items())]


def figures(rows):
    found = {
        "energy_momentum_relative_drift": max(
            row["energy_drift"] for row in pick(rows, scene="swinging", integrator="energy-momentum")
        )
    }
    for row in pick(rows, scene="swinging"):
        found[f"energy_drift_{short(row)}"] = row["energy_drift"]
    for row in pick(rows, scene="thrown"):
        found[f"angular_momentum_drift_{short(row)}"], found[f"linear_momentum_drift_{short(row)}"] = (
            row["angular_drift"],
            row["linear_drift"],
        )
    return found


def short(row):
    name = row["integrator"].replace(",", "").replace(" ", "_").replace("-", "_").replace(".", "")
    return f"{name}_{row['x']:.0e}"


def notes(rows):
    lines = [
        f"{row['scene']}, {row['integrator']} at {row['x']:g}: {row['outcome'][:140]}"
        for row in pick(rows)
        if row["outcome"] != "done"
    ]
    gains = [row for row in pick(rows) if max(row["energy"]) > 1e-3]
    return lines + [
        f"{row['scene']}, {row['integrator']} at {row['x']:g} gains {max(row['energy']):.1%} of its energy"
        for row in gains
    ]


@drawn
def draw(rows, folder):
    made, axes = panels(3, width=7.4, height=3.2, columns=3)
    for scene, axis, what in (
        ("swinging", axes[0], "energy"),
        ("thrown", axes[1], "energy"),
        ("thrown", axes[2], "angular"),
    ):
        for i, row in enumerate(pick(rows, scene=scene)):
            size = np.maximum(np.abs(row[what]), 1e-16)
            axis.semilogy(row["t"], size, label=f"{row['integrator']} {row['x']:.0e}", **look(i) | {"marker": ""})
        axis.set(xlabel="t, s", title=f"{scene}: {'energy' if what == 'energy' else 'angular momentum'}")
    axes[0].set_ylabel("relative change")
    legend(made, axes, 4)
    return saved(made, folder, "energy")


COLUMNS = (
    "scene",
    "integrator",
    "x",
    "dof",
    "steps",
    "cpu_s",
    "energy_change",
    "energy_drift",
    "linear_drift",
    "angular_drift",
    "outcome",
    "error",
)
STUDY = Study(
    "energy",
    "long-time energy and momentum; x is the step, s, or the tolerance",
    tasks,
    run,
    figures,
    draw,
    COLUMNS,
    notes=notes,
)

if __name__ == "__main__":
    main(STUDY)
