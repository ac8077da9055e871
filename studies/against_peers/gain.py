"""CPU time of generalized-alpha relative to Radau IIA at equal errors of the tip. Each round runs all points of both, and of an earlier
commit's generalized-alpha, so that disturbances of the machine affect all of them equally.

The reference is DOP853 on the index-1 equations, or the energy-momentum method; its accuracy is the distance to Radau IIA with a small
tolerance. For very stiff plates it is Radau IIA with short steps; its accuracy is the distance to generalized-alpha.
"""

import json
from functools import lru_cache

import numpy as np

from against_peers.own import LABELS, OWN, TIMES, extrapolated, largest, seconds, seen, tip_of
from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.integrate.energy.energy_momentum import EnergyMomentum
from polyida.integrate.radau.radau_iia import RadauIIA
from polyida.problems import plates
from polyida.show.styles import legend_above
from polyida.study.plotting import line_picture, loglog, panels, study_figure
from polyida.study.references import explicit
from step_cost.measure import model_of
from step_cost.side import cells_for
from work_precision.integrators import cheapest

DOF = 1115  # coordinates asked for: those of the scenes' default meshes, 160 cells a plate
EVERY = 5  # of TIMES: equal steps of Radau IIA end there, and what it interpolates between is no better than of order 4
RTOL, TIGHT = 1e-9, 1e-10  # of DOP853, of Radau IIA beside it
BEFORE = "alpha before"
TARGETS = {  # figure: scene, error of the tip, m
    "radau_gain_2e-5": ("scene 1", 2.5e-5),
    "radau_gain_2e-6": ("scene 1", 2e-6),
    "radau_gain_3e-8": ("scene 1", 3.5e-8),
    "radau_gain2_1e-5": ("scene 2", 1.2e-5),
    "radau_gain2_1e-6": ("scene 2", 1e-6),
}
EQUAL = 2e-6  # m: error of the tip at which steps chosen by rtol are compared with equal ones
STEPS = tuple(1 / n for n in (500, 1000, 2000, 4000, 8000, 16_000, 32_000, 45_000))
TOLERANCES = (1e-5, 3e-6, 1e-6, 3e-7, 1e-7, 3e-8, 1e-8, 3e-9, 1e-9)
RADAU_STEPS = tuple(1 / n for n in (40, 60, 80, 100, 140, 200, 280, 400))
LEAN_STEPS = tuple(1 / n for n in (60, 80, 100, 120, 140, 170, 200, 240, 280, 340, 400, 500, 600, 800, 1100, 1600, 2200))
RADAU = ("radau", "radau fixed", "radau lean", "radau lean, index 3")
STIFF, STIFF_STEP = 2e11, 1 / 80  # Pa, s


def settings(scene):
    """[(solver, setting)] of a round; errors on scene 2 are larger."""
    few = 0 if scene == "scene 1" else 3
    ladders = {"alpha": STEPS, "radau": TOLERANCES, "radau fixed": RADAU_STEPS, "radau lean": LEAN_STEPS}
    ladders |= {"radau lean, index 3": LEAN_STEPS} if scene == "scene 2" else {}  # the same where nothing drives phi
    return [(solver, x) for solver, ladder in ladders.items() for x in ladder[: len(ladder) - few]]


@lru_cache(maxsize=2)
def reference(scene, dof, fine=0.0):
    """(tip at TIMES (101, 2), distance of Radau IIA with a small tolerance). fine: see `in_rounds`."""
    model = model_of(scene, dof)
    exact = extrapolated(model, EnergyMomentum, fine) if fine else _explicit(model)
    return exact, off(seen(model, RadauIIA(rtol=TIGHT))[1], exact)


def _explicit(model):
    look = tip_of(model)
    return np.array([look(state[0]) for state in explicit(model, TIMES[-1], RTOL, times=TIMES)])


def off(tip, exact):
    """Largest distance over twenty of TIMES, m."""
    return largest(tip[::EVERY], exact[::EVERY])


def in_rounds(scene, dof, rounds, before=None, fine=0.0):
    """The row of a scene: "points" with the error and the CPU seconds of each round for each solver and setting.

    before: a process that runs generalized-alpha of an earlier commit, or None. fine: 0: the reference is DOP853; otherwise the energy-
    momentum method with this step, s, and half of it, extrapolated: faster, and accurate enough for the quick selection.
    """
    model, (exact, doubt) = model_of(scene, dof), reference(scene, dof, fine)
    points = [{"solver": solver, "setting": x} for solver, x in settings(scene)]
    points += [{"solver": BEFORE, "setting": point["setting"]} for point in points if point["solver"] == "alpha" and before]
    for point in points:
        answer = before(json.dumps(point)) if point["solver"] == BEFORE else None
        tip = np.array(answer["tip"]) if answer else seen(model, integrator(point))[1]
        point |= {"error_max": off(tip, exact), "cpu_s": []}
    for _ in range(rounds):
        for point in points:
            point["cpu_s"].append(before(json.dumps(point))["cpu_s"] if point["solver"] == BEFORE else seconds(model, integrator(point)))
    return {"n": model.n, "reference_doubt": doubt, "points": points}


def integrator(point):
    """The integrator of a point of this package."""
    return OWN[point["solver"]][1](point["setting"])


def at_error(row, solvers, error):
    """CPU seconds at an error in each round, interpolated linearly in logarithms on the Pareto front of these solvers' points."""
    points = [point for point in row["points"] if point["solver"] in solvers]
    rounds = zip(*(point["cpu_s"] for point in points))
    errors = [point["error_max"] for point in points]
    return np.array([cheapest([{"cpu_s": s, "e": e} for s, e in zip(result, errors)], "e", error) for result in rounds])


def gains(rows, alpha="alpha"):
    """{figure: median over the rounds of the ratio of generalized-alpha's seconds to Radau's; "..._s" and "..._alpha_s": both}; and the
    ratio of Radau IIA with error control to its best equal steps.
    """
    result = {}
    for name, (scene, error) in TARGETS.items():
        for row in rows:
            if row["scene"] == scene and row.get("points"):
                ours, theirs = (at_error(row, solvers, error) for solvers in (RADAU, (alpha,)))
                result |= {name: np.median(theirs / ours), f"{name}_s": np.median(ours), f"{name}_alpha_s": np.median(theirs)}
    for row in rows:
        if row.get("points"):
            adaptive, equal = (at_error(row, solvers, EQUAL) for solvers in (RADAU[:1], RADAU[1:]))
            result[f"radau_rtol_over_steps_{row['scene'][-1]}"] = np.median(adaptive / equal)
    return result


def stiff_row(dof):
    """Error of Radau IIA's tip at 80 steps per second on scene 1 with E = 200 GPa against an eighth of the step, and the distance of
    generalized-alpha. There the error of generalized-alpha does not decrease with its step, so extrapolation increases it.
    """
    rubber = plates.RUBBER
    model = plates.double_plate(cells_for(dof), material=plates.Material(E=STIFF, nu=rubber.nu, rho=rubber.rho)).build()
    counts, tip = seen(model, RadauIIA(h=STIFF_STEP))
    exact, other = (seen(model, method)[1] for method in (RadauIIA(h=STIFF_STEP / 8), GeneralizedAlpha(h=1 / 32_000)))
    return {"n": model.n, "reference_doubt": off(other, exact), "stiff_error": off(tip, exact)} | counts


def notes(rows):
    """The seconds of each gain, and the accuracy of the references."""
    lines, result = [], gains(rows)
    for name, (scene, error) in TARGETS.items():
        if np.isfinite(result.get(name, np.nan)):
            lines.append(
                f"{name}: {scene} at {error:g} m: generalized-alpha {result[f'{name}_alpha_s']:.3g} s, Radau IIA {result[f'{name}_s']:.3g} s"
            )
    for row in rows:
        if row.get("points") or row.get("stiff_error"):
            made = "energy-momentum, extrapolated" if row.get("fine") else "DOP853"
            stiff, other = ("200 GPa, Radau IIA", "generalized-alpha") if row.get("stiff_error") else (made, "Radau IIA")
            lines.append(f"{row['scene']}, {row['n']} coordinates, {stiff}: {other} is {row['reference_doubt']:.2g} m from this reference")
    return lines


@study_figure
def figure(rows):
    """CPU time of generalized-alpha and Radau IIA against the error of the tip."""
    result, labels = [row for row in rows if row.get("points")], LABELS | {BEFORE: "generalized-alpha, before"}
    fig, axes = panels(len(result))
    for axis, row in zip(axes, result):
        for k, (solver, label) in enumerate(labels.items()):
            points = sorted((point["error_max"], np.median(point["cpu_s"])) for point in row["points"] if point["solver"] == solver)
            if points:
                loglog(axis, *np.array(points).T, k, label)
        axis.set(title=f"{row['scene']}, {row['n']} coordinates", xlabel="largest error of the tip, m", ylabel="CPU time of 1 s, s")
    legend_above(fig, axes, 3)
    return line_picture(fig, "radau_gain")
