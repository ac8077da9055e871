"""Work-precision of this package and of other solvers on the same model: CPU seconds at equal error of the tip."""

from functools import lru_cache

import numpy as np

from against_peers import gain, peers
from against_peers.against import against
from against_peers.own import LABELS, OWN, TIMES, extrapolated, largest, ours, tip_of
from polyida.cli.study import main
from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.integrate.energy.energy_momentum import EnergyMomentum
from polyida.show.styles import legend_above
from polyida.study.executors import run_isolated
from polyida.study.plotting import line_picture, loglog, panels, study_figure
from polyida.study.tasks import Study
from step_cost.measure import model_of

SOLVERS = LABELS | {
    "solve_dae": "Radau (solve_dae)",
    "exudyn": "generalized-alpha (exudyn)",
    "exudyn modified": "generalized-alpha (exudyn, modified Newton)",
}
PEERS = ("solve_dae", "exudyn", "exudyn modified")
ALPHA, FINE = (4e-3, 2e-3, 1e-3, 1 / 1250, 5e-4, 2.5e-4), 1 / 8000  # steps, s
IDA_RTOL, DAE_RTOL, EXUDYN_H = (1e-4, 1e-5, 1e-6, 3e-7), (1e-3, 1e-4, 1e-5), (2e-3, 1e-3, 5e-4)
RADAU_RTOL, ROUNDS = (1e-4, 1e-5, 3e-6, 2e-6, 1e-6, 3e-7), 5
RADAU_STEPS = {"radau fixed": gain.RADAU_STEPS[:4], "radau lean": gain.LEAN_STEPS[:7]}  # with Newton to less, more steps pay
MOST = {"scene1_800_cpu_s": 0.1, "scene1_3000_cpu_s": 0.5, "ida_over_alpha_at_1e-5": 3.75} | {
    f"radau_rtol_over_steps_{k}": 1.3 for k in (1, 2)
}
LEAST = {"scene1_800_alpha_peer_ratio": 25.0}


def tasks(quick):
    """Reference, settings of this package, and fewer settings of the peers, for each scene and size."""
    selection, some = [], slice(1, None, 2) if quick else slice(None)
    for scene, dof in (("scene 1", 800), ("scene 2", 800)) + (() if quick else (("scene 1", 3000), ("scene 2", 3000))):
        fine = 0.5 if quick else 1 if dof > 1000 else 2
        settings = [("reference", FINE / fine)] + [(solver, h) for solver in ("alpha", "alpha lean") for h in ALPHA[some]]
        settings += [("radau", rtol) for rtol in RADAU_RTOL[some]] + [
            (solver, h) for solver, ladder in RADAU_STEPS.items() for h in ladder[some]
        ]
        settings += [("ida", rtol) for rtol in (IDA_RTOL[:-1] if quick else IDA_RTOL)]
        if dof > 1000:
            settings += [("solve_dae", 1e-4), ("exudyn modified", 5e-4)]
        else:
            settings += [("solve_dae", rtol) for rtol in DAE_RTOL]
            settings += [("exudyn modified", h) for h in (EXUDYN_H[1:2] if quick else EXUDYN_H)]
            settings += [] if quick else [("exudyn", h) for h in EXUDYN_H]
        selection += [
            {"scene": scene, "dof": dof, "solver": solver, "setting": setting, "fine": FINE / fine, "repeats": 1 if quick else 3}
            for solver, setting in settings
        ]
    return selection + [
        {
            "scene": scene,
            "dof": 100 if quick else gain.DOF,
            "solver": part,
            "setting": ROUNDS,
            "fine": fine if quick else 0.0,
            "repeats": 1 if quick else ROUNDS,
        }
        for scene, part, fine in (("scene 1", "rounds", 0.0), ("scene 2", "rounds", FINE), ("scene 1", "stiff", 0.0))
    ]


@lru_cache(maxsize=4)
def reference(scene, dof, fine):
    """(tip at TIMES (101, 2), accuracy): the energy-momentum method with steps fine and fine / 2, extrapolated, and its largest distance
    from generalized-alpha, computed in the same way.
    """
    exact, other = (extrapolated(model_of(scene, dof), method, fine) for method in (EnergyMomentum, GeneralizedAlpha))
    return exact, largest(other, exact)


def run(scene, dof, solver, setting, fine, repeats):
    """One row: CPU seconds of 1 s, and the largest distance of the tip from the reference over TIMES and at the end, m.

    Solver "rounds": all points of the gains over generalized-alpha; "stiff": Radau IIA on plates of 200 GPa.
    """
    if solver in ("rounds", "stiff"):
        return gain.in_rounds(scene, dof, repeats, fine=fine) if solver == "rounds" else gain.stiff_row(dof)
    model = model_of(scene, dof)
    exact, doubt = reference(scene, dof, fine)
    if solver == "reference":
        return {"n": model.n, "reference_doubt": doubt}
    if solver in OWN:
        row, tip = ours(model, OWN[solver][1](setting), repeats)
    else:
        row = run_isolated(peer, {"scene": scene, "dof": dof, "solver": solver, "setting": setting}, 300.0)
        if row["error"] or row.get("skipped"):
            return row
        tip = np.array(row.pop("tip"))
    distance = np.linalg.norm(tip - exact, axis=1)
    return {"n": model.n} | row | {"error_max": float(distance.max()), "error_end": float(distance[-1])}


def peer(scene, dof, solver, setting):
    """Run a peer in a separate process with its functions compiled."""
    model, rest = model_of(scene, dof), None
    watch, rest = tip_of(model), np.zeros(model.n)
    model.force(0.0, rest, rest), model.force_q(0.0, rest, rest), model.phi(0.0, rest)
    try:
        if solver == "solve_dae":
            peers.radau(model, TIMES[:1] + np.array([0.0, 1e-5]), 1e-3, watch)
            row, tip = peers.radau(model, TIMES, setting, watch)
        else:
            row, tip = peers.ExudynScene(model, watch).run(TIMES, setting, solver != "exudyn")
    except peers.Missing as missing:
        return {"skipped": str(missing)}
    return row | {"tip": tip.tolist()}


def cases_of(rows):
    """The scenes and sizes on which peers run."""
    return list(dict.fromkeys((row["scene"], row["dof"]) for row in rows if row["solver"] in SOLVERS))


def curve(rows, scene, dof, solvers, what="cpu_s"):
    """(errors, CPU s or steps) of the runs of these solvers on the Pareto front, by decreasing error."""
    good = sorted(
        (row["error_max"], row[what])
        for row in rows
        if (row["scene"], row["dof"]) == (scene, dof) and row["solver"] in solvers and row.get("error_max") and row.get(what)
    )
    front, least = [], np.inf
    for error, value in good:
        if value < least:
            front.append((error, value))
            least = value
    return np.array(front[::-1]).reshape(-1, 2).T


def at_error(rows, scene, dof, solvers, error, what="cpu_s"):
    """CPU s or steps at this error, interpolated linearly in logarithms; NaN beyond the last precise run."""
    errors, values = curve(rows, scene, dof, solvers, what)
    if not len(errors) or error < errors.min():
        return np.nan
    return float(np.exp(np.interp(np.log(error), np.log(errors[::-1]), np.log(values[::-1]))))


def cheapest(rows, scene, dof, solvers, error):
    """Smallest CPU s of a run with at most this error."""
    errors, seconds = curve(rows, scene, dof, solvers)
    return float(seconds[errors <= error].min()) if (errors <= error).any() else np.nan


def figures(rows, target=2e-5):
    """CPU seconds at a tip error of 2e-5 m, each peer relative to this package at equal error, IDA relative to alpha, peers relative to
    alpha and Radau IIA.
    """
    result = {}
    for scene, dof in cases_of(rows):
        name = f"{scene.replace(' ', '')}_{dof}"
        result[f"{name}_cpu_s"] = cheapest(rows, scene, dof, tuple(OWN), target)
        ratios = [
            row["cpu_s"] / at_error(rows, scene, dof, tuple(OWN), row["error_max"])
            for row in rows
            if row["scene"] == scene and row["dof"] == dof and row["solver"] in PEERS and row.get("cpu_s")
        ]
        result[f"{name}_peer_ratio"] = min((ratio for ratio in ratios if np.isfinite(ratio)), default=np.nan)
        for solver in PEERS:
            result[f"{name}_{solver.replace(' ', '_')}_cpu_s"] = at_error(rows, scene, dof, (solver,), target)
        for family, solvers in (("alpha", ("alpha", "alpha lean")), ("radau", gain.RADAU)):
            result[f"{name}_{family}_cpu_s"] = at_error(rows, scene, dof, solvers, target)
            result[f"{name}_{family}_peer_ratio"] = at_error(rows, scene, dof, PEERS, target) / result[f"{name}_{family}_cpu_s"]
        result[f"{name}_ida_over_alpha_at_1e-5"] = at_error(rows, scene, dof, ("ida",), 1e-5) / at_error(rows, scene, dof, ("alpha",), 1e-5)
    result["ida_over_alpha_at_1e-5"] = result.get("scene1_800_ida_over_alpha_at_1e-5", np.nan)
    result["radau_stiff_error"] = max((row["stiff_error"] for row in rows if row.get("stiff_error")), default=np.nan)
    result |= gain.gains(rows)
    return {key: value for key, value in result.items() if np.isfinite(value)}


def notes(rows):
    """Missed targets, the causes of IDA's cost, the accuracy of the reference, and omitted runs."""
    result = figures(rows)
    lines = [f"{name}: {result[name]:.3g}, aim at most {aim:.3g}" for name, aim in MOST.items() if result.get(name, 0) > aim]
    lines += [f"{name}: {result[name]:.3g}, aim at least {aim:.3g}" for name, aim in LEAST.items() if result.get(name, aim) < aim]
    for row in rows:
        if row["solver"] == "reference" and not row.get("error"):
            lines.append(
                f"{row['scene']}, {row['n']} coordinates: the reference, by the energy-momentum method, and "
                f"generalized-alpha, both extrapolated, are {row['reference_doubt']:.2g} m apart"
            )
    lines += [line for scene, dof in cases_of(rows) for line in _ida_and_alpha(rows, scene, dof)]
    lines += gain.notes(rows)
    return lines + sorted({f"left out: {row['skipped']}" for row in rows if row.get("skipped")})


def _ida_and_alpha(rows, scene, dof, error=1e-5):
    steps, seconds = ([at_error(rows, scene, dof, (solver,), error, what) for solver in ("alpha", "ida")] for what in ("steps", "cpu_s"))
    if not np.isfinite([*steps, *seconds]).all():
        return []
    ms = [1e3 * cpu / count for cpu, count in zip(seconds, steps)]
    return [
        f"{scene}, {dof}: at {error:.0e} m generalized-alpha takes {steps[0]:.0f} steps of {ms[0]:.3g} ms, "
        f"IDA {steps[1]:.0f} of {ms[1]:.3g} ms: {steps[1] / steps[0]:.2g} times the steps, for BDF2's larger "
        f"error, at {ms[1] / ms[0]:.2g} times the cost"
    ]


@study_figure
def draw(rows):
    """CPU time against the largest error of the tip, one panel for each scene and size."""
    cases = cases_of(rows)
    fig, axes = panels(len(cases))
    for axis, (scene, dof) in zip(axes, cases):
        for k, (solver, label) in enumerate(SOLVERS.items()):
            runs = [row for row in rows if (row["scene"], row["dof"], row["solver"]) == (scene, dof, solver) and row.get("cpu_s")]
            points = sorted((row["error_max"], row["cpu_s"]) for row in runs)
            if points:
                loglog(axis, *np.array(points).T, k, label)
        axis.set(title=f"{scene}, {dof} coordinates", xlabel="largest error of the tip, m", ylabel="CPU time of 1 s, s")
    legend_above(fig, axes, 2)
    return line_picture(fig, "against_peers")


study = Study(
    "against_peers",
    "Work-precision against other solvers on the same model",
    tasks,
    run,
    figures,
    (draw, gain.figure),
    notes=notes,
    headline=(
        "scene1_800_cpu_s",
        "scene2_800_cpu_s",
        "scene1_800_peer_ratio",
        "ida_over_alpha_at_1e-5",
        *gain.TARGETS,
        "radau_stiff_error",
    ),
    options={"against": ("a commit of this clone: only the gains over that one's generalized-alpha", against)},
    columns=("scene", "n", "solver", "setting", "error_max", "error_end", "cpu_s", "steps", "residuals", "tangents", "factorizations"),
)

if __name__ == "__main__":
    main(study)
