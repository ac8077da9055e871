"""Contact and friction: work against precision of events and of time stepping, energy, random scenes, a chain, a bouncing bar, a thrown plate.

Also what friction costs in a step, and random mechanisms with laws in every integrator.
"""

import numpy as np

from nonsmooth import bar, cases, chain, energy, friction, plate, random_laws, random_scenes
from polyida.cli.study import main
from polyida.show.styles import legend_above, marker_style
from polyida.study.plotting import line_picture, loglog, panels, study_figure
from polyida.study.rows import column, distinct, fit_slope, largest, pick, unfinished_notes
from polyida.study.tasks import Study

SEEDS = 20  # of a row
BARS = [(40, 0.5, 0.8, 2, 1.0), (40, 0.5, 0.8, 4, 0.1), (40, 0.5, 0.3, 4, 0.1), (40, 0.5, 0.3, 2, 1.0)]  # cells, CFL, rho_inf, across, mass
BARS += [(20, 0.5, 0.3, 2, 1.0), (80, 0.5, 0.3, 2, 1.0), (40, 0.25, 0.3, 2, 1.0), (40, 1.0, 0.3, 2, 1.0)]
MECHANISMS = 500  # random scenes with laws
FAR = 1e-3  # m: a distance of the ends from those of Radau IIA, rtol 1e-7
LIMIT = 1e-13  # smaller errors are round-off


def tasks(quick):
    seeds = [(first, e, 5 if quick else SEEDS) for e in (True, False) for first in range(0, 5 if quick else 200, SEEDS)]
    random = [{"part": "random", "first": first, "count": count, "bounces": e} for first, e, count in seeds]
    names = ("cells", "courant", "rho_inf", "across", "contact_mass")
    bars = [{"part": "bar"} | dict(zip(names, one)) for one in (BARS[:2] if quick else BARS)]
    plates = [{"part": "plate", "cells": 40 if quick else 365}]
    firsts = range(0, 10 if quick else MECHANISMS, 10)
    laws = [{"part": "laws", "first": first, "count": 5 if quick else 10} for first in firsts]
    return cases.tasks(quick) + energy.tasks(quick) + random + chain.tasks(quick) + bars + plates + friction.tasks(quick) + laws


def run(part, **task):
    parts = {"precision": cases.measure, "energy": energy.measure, "random": random_row, "chain": chain.measure}
    parts |= {"bar": bar.measure, "plate": plate.measure, "friction": friction.measure, "starts": friction.start, "laws": law_row}
    return parts[part](**task)


def random_row(first, count, bounces):
    """The worst of some seeds."""
    rows = [random_scenes.kept(seed, restitution=bounces) for seed in range(first, first + count)]
    failed = [f"seed {first + k}: {row['outcome']}" for k, row in enumerate(rows) if row["outcome"] != "done"]
    done = [row for row in rows if row["outcome"] == "done"]
    keys = ("beyond_cone", "pull", "energy_growth", "energy_growth_in_all", "momentum_in_a_step", "momentum_in_all")
    worst = {key: max(row[key] for row in done) for key in keys} | {"lowest_gap": min(row["lowest_gap"] for row in done)}
    return worst | {"outcome": "; ".join(failed) or "done"}


def law_row(first, count):
    """Runs of some seeds in all integrators: how many are done, end for a stated reason, and end far from the first, m, without its coarse ways."""
    stops, stated, apart = [], 0, [0.0]
    for seed in range(first, first + count):
        name, runs = random_laws.measure(seed)
        for way, (outcome, distance, _) in runs.items():
            stated += outcome.startswith("stated")
            if outcome.startswith("stop"):
                stops.append(f"seed {seed} ({name}), {way}: {outcome}")
            elif outcome == "done" and way not in random_laws.COARSE:
                apart.append(distance)
    far = sum(distance > FAR for distance in apart)
    runs = count * len(random_laws.WAYS)
    return {"runs": runs, "stated": stated, "stops": len(stops), "far": far, "apart": max(apart), "outcome": "; ".join(stops) or "done"}


def orders(rows):
    """Fitted orders of the ways with one step, from errors above round-off."""
    result = {}
    for row in pick(rows, part="precision"):
        runs = [one for one in pick(rows, part="precision", scene=row["scene"], integrator=row["integrator"]) if one.get("error_q")]
        good = [one for one in runs if one["error_q"] > LIMIT]
        if row["integrator"] in cases.FIXED and len(good) > 2:
            result[f"order_{short(row)}"] = fit_slope(column(good, "x"), column(good, "error_q"))
    return result


def short(row):
    return f"{row['scene']}_{row['integrator']}".replace(",", "").replace(" ", "_").replace("-", "_").replace(".", "").lower()


def kept(rows):
    """The worst of all random scenes, with restitution and without."""
    result = {}
    for bounces, label in ((True, "bouncing"), (False, "plastic")):
        of_kind = pick(rows, part="random", bounces=bounces)
        for key in ("energy_growth", "energy_growth_in_all", "beyond_cone", "momentum_in_a_step", "momentum_in_all"):
            result[f"random_{label}_{key}"] = largest(of_kind, key)
        result[f"random_{label}_penetration"] = -min(column(of_kind, "lowest_gap"), default=np.nan)
    return result


def energies(rows):
    return {f"energy_change_{short(row)}": row["energy_change"] for row in pick(rows, part="energy") if "energy_change" in row}


def frictions(rows):
    """CPU time of a step with friction over that of one without, and the starts and random scenes that are done."""
    result = {f"friction_{short(row)}": row["friction_over_none"] for row in pick(rows, part="friction", outcome="done")}
    starts, laws = pick(rows, part="starts"), pick(rows, part="laws")
    result["starts_done"] = len(pick(starts, outcome="done"))
    return result | {f"laws_{key}": sum(column(laws, key)) for key in ("runs", "stated", "stops", "far")}


def friction_notes(rows):
    lines = []
    for row in pick(rows, part="friction", outcome="done"):
        text = "a step with friction takes {friction_over_none:.3g} of the CPU time of one without, {with_ms:.3g} ms against {without_ms:.3g} ms"
        lines.append(f"{row['scene']}, {row['integrator']}: {text.format(**row)}; {row['events']} events in {row['steps']} steps")
    if starts := pick(rows, part="starts"):
        lines.append(f"a flexible slider-crank from rest: Radau IIA ends {len(pick(starts, outcome='done'))} of {len(starts)} runs")
    if laws := pick(rows, part="laws"):
        runs, stated, stops, far = (sum(column(laws, key)) for key in ("runs", "stated", "stops", "far"))
        lines.append(
            f"random scenes with laws: {runs:g} runs, {stated:g} end for a stated reason, {stops:g} for another one, {far:g} end {FAR:g} m apart"
        )
    return lines


def stop_notes(rows):
    return unfinished_notes(rows, "part", "scene", "integrator", "x", "first", "stiffness")


def at_home(rows):
    """The cheapest run of each scene with an error below 1e-4 and 1e-6."""
    lines = []
    for scene in distinct(pick(rows, part="precision"), "scene"):
        for level in (1e-4, 1e-6):
            good = [row for row in pick(rows, part="precision", scene=scene, outcome="done") if row["error_q"] <= level]
            if good:
                best = min(good, key=lambda row: row["cpu_s"])
                text = f"{best['integrator']} at {best['x']:g}, {best['cpu_s']:.2g} CPU s"
                lines.append(f"{scene}: an error of {level:.0e} costs least by {text}, {best['steps']} steps")
    return lines


def chain_notes(rows):
    lines = []
    for row in pick(rows, part="chain", outcome="done"):
        stiff = f", stiffness {row['stiffness']:g} N/m" if row["stiffness"] else ""
        ends = f"joints end at {row['place']:.3f} m, {row['height']:.3f} m on average"
        cost = f"{row['cpu_s']:.3g} CPU s, penetration {row['penetration']:.2g} m"
        lines.append(f"chain: {row['integrator']}, h = {row['x']:g} s{stiff}: {cost}, {ends}")
    return lines


def plate_notes(rows):
    """What a step in contact costs."""
    text = "a step in contact takes {cost_of_contact:.2f} of the CPU time of one without, {iterations_in_contact:.2f} Newton iterations against "
    text += "{iterations_without:.2f}, {solves_in_contact:.2f} solves; {factors} factor in {steps} steps"
    return [f"thrown plate, {row['n']} coordinates: {text.format(**row)}" for row in pick(rows, part="plate", outcome="done")]


@study_figure
def precision_figure(rows):
    """CPU time against the error, case by case; errors below 1e-16 are drawn there."""
    of_part = pick(rows, part="precision")
    scenes = distinct(of_part, "scene")
    fig, axes = panels(len(scenes), width=7.4, height=2.3, columns=3)
    for k, (axis, scene) in enumerate(zip(axes, scenes)):
        for i, way in enumerate(cases.MAKERS):
            runs = [row for row in pick(of_part, scene=scene, integrator=way) if row.get("error_q") is not None]
            loglog(axis, np.maximum(column(runs, "error_q"), 1e-16), column(runs, "cpu_s"), i, way)
        axis.set(title=scene, xlabel=f"error, {cases.CASES[scene].unit}", ylabel="" if k % 3 else "CPU seconds")
    legend_above(fig, axes, 3)
    return line_picture(fig, "nonsmooth-precision")


@study_figure
def energy_figure(rows):
    """Relative change of energy over many impacts with e = 1."""
    of_part = pick(rows, part="energy")
    scenes = distinct(of_part, "scene")
    fig, axes = panels(len(scenes), width=7.4, height=3.0)
    for axis, scene in zip(axes, scenes):
        for i, row in enumerate(pick(of_part, scene=scene)):
            size = np.maximum(np.abs(np.array(row["energy"], float)), 1e-16)
            axis.semilogy(row["t"], size, label=row["integrator"], **marker_style(i) | {"markevery": 0.2})
        axis.set(title=scene, xlabel="t, s", ylabel="relative change of energy")
    legend_above(fig, axes, 3)
    return line_picture(fig, "nonsmooth-energy")


@study_figure
def bar_figure(rows):
    """The bouncing bar: force of the floor and height of the lower end, with the exact solution, black."""
    of_part = pick(rows, part="bar", outcome="done")
    fig, (force, bottom) = panels(2, width=7.4, height=3.0)
    for i, row in enumerate(of_part[:2]):
        style = marker_style(i) | {"marker": "", "label": f"{row['across']} cells across, mass {row['contact_mass']:g}"}
        t = np.array(row["t"]) / bar.HIT
        force.plot(t, row["force"], **style)
        bottom.plot(t, row["bottom"], **style)
    t = np.linspace(0.0, 11 / 3, 600)
    exact = {"color": "k", "linewidth": 0.8, "label": "exact"}
    force.plot(t, bar.exact_force(t * bar.HIT, 1.0) / bar.exact_force(bar.LEAVES * 0.999999, 1.0), **exact)
    bottom.plot(t, bar.exact_bottom(t * bar.HIT) / bar.FALL, **exact)
    force.set(xlabel="t over the time of the fall", ylabel="force over its largest")
    bottom.set(xlabel="t over the time of the fall", ylabel="height over that of the fall")
    legend_above(fig, (force, bottom), 3)
    return line_picture(fig, "nonsmooth-bar")


COLUMNS = (
    "part",
    "scene",
    "integrator",
    "x",
    "error_q",
    "cpu_s",
    "steps",
    "events",
    "energy_change",
    "energy_gain",
    "stiffness",
    "penetration",
    "cost_of_contact",
    "first",
    "bounces",
    "lowest_gap",
    "energy_growth",
    "momentum_in_all",
    "cells",
    "courant",
    "rho_inf",
    "across",
    "contact_mass",
    "friction_over_none",
    "modes",
    "mu",
    "stated",
    "stops",
    "far",
    "apart",
    "energy_of_four",
    "touches_off",
    "leaves_off",
    "force_rms",
    "bottom_off",
    "outcome",
    "error",
)
STUDY = Study(
    "nonsmooth",
    "contact and friction; x is the step, s, or the tolerance",
    tasks,
    run,
    (orders, kept, energies, frictions),
    (precision_figure, energy_figure, bar_figure),
    COLUMNS,
    notes=(stop_notes, at_home, chain_notes, plate_notes, friction_notes),
    headline=("random_bouncing_energy_growth", "random_plastic_energy_growth"),
)

if __name__ == "__main__":
    main(STUDY)
