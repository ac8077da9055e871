"""CPU time and work against measured error in q, v and lam: every integrator and form on every problem."""

import numpy as np

from polyida.cli_study import main
from polyida.study.drawing import drawn, legend, loglog, panels, saved
from polyida.study.harness import Study
from polyida.study.members import FIXED, IDA_FORMS
from polyida.study.work_precision import cheapest, measure

# problem: coarsest step; halved again and again
CLASSICAL = {"pendulum": 2e-2, "car-axis": 1e-2, "andrews": 6e-5}
SCENES = {
    "double-plate": 4e-3,
    "double-plate-motors": 4e-3,
    "plate-chain": 4e-3,
    "rigid-limit": 4e-3,
    "spin-up-beam": 4e-2,
}
STIFF = ("rigid-limit", "spin-up-beam")  # IDA takes 1e4 to 1e6 steps there
EVENT = "sudden-blow"
SECTIONS = {
    "quick": {
        "problems": ("pendulum", "car-axis", "andrews", "double-plate", "double-plate-motors", EVENT),
        "steps": (0, 2),
        "members": ("alpha", "alpha, stabilised", "alpha, Richardson", "energy-momentum"),
    },
    "full": {"problems": (*CLASSICAL, *SCENES, EVENT), "steps": range(6), "members": tuple(FIXED)},
}


def tasks(quick):
    chosen, made = SECTIONS["quick" if quick else "full"], []
    for problem in chosen["problems"]:
        if problem == EVENT:
            continue
        coarsest = (CLASSICAL | SCENES)[problem]
        made += [
            task(problem, member, coarsest / 2**k, quick)
            for member in chosen["members"]
            for k in chosen["steps"]
            if member not in leave_out(problem, quick)
        ]
        made += [
            task(problem, "alpha, adaptive", tolerance, quick)
            for tolerance in ladder(quick, 1e-4, 1e-6 if quick else 1e-8)
        ]
        made += [
            task(problem, f"IDA {form}", tolerance, quick)
            for form in IDA_FORMS
            for tolerance in ladder(quick, 1e-3, tightest(problem, quick))
            if form not in leave_out(problem, quick)
        ]
        if problem not in STIFF:
            made += [task(problem, "IDA index3", tolerance, quick) for tolerance in (1e-3, 1e-5)]
    made += [task(EVENT, "alpha", 8e-3 / 2**k, quick) for k in range(9)]
    return made + [task(EVENT, "alpha, adaptive", 10.0**-k, quick) for k in range(3, 9)]


def tightest(problem, quick):
    """The last of IDA's ladder: stiff scenes without damping take a million steps beyond it."""
    if problem in CLASSICAL:
        return 1e-12
    return 1e-7 if quick else {"rigid-limit": 1e-5, "spin-up-beam": 1e-4}.get(problem, 1e-9)


def leave_out(problem, quick):
    """What a problem cannot have, or needs not in a short selection."""
    left = ["index3"] + ([] if problem in SCENES else ["energy-momentum", "alpha, rho 0.5", "alpha, rho 0.99"])
    left += ["index2", "index1", "baumgarte", "alpha, rho 0.99"] if problem in STIFF else []
    spared = ["alpha, stabilised", "index1", "baumgarte"] + (["alpha, Richardson"] if problem in CLASSICAL else [])
    return left + (spared if quick and problem != "andrews" else [])


def task(problem, member, x, quick):
    return {"problem": problem, "integrator": member, "x": float(f"{x:.3g}"), "quick": quick}


def ladder(quick, loose, tight):
    powers = np.arange(np.log10(loose), np.log10(tight) - 0.5, -2 if quick else -1)
    return [float(f"1e{int(np.round(power))}") for power in powers]


def run(problem, integrator, x, quick):
    return measure(problem, integrator, x, quick)


def pick(rows, problem=None, integrator=None):
    return [
        row
        for row in rows
        if not row.get("error") and problem in (None, row["problem"]) and integrator in (None, row["integrator"])
    ]


def best(rows, problem, prefix, part):
    errors = [row.get(f"error_{part}") for row in pick(rows, problem) if row["integrator"].startswith(prefix)]
    errors = [error for error in errors if error is not None and np.isfinite(error)]
    return min(errors, default=float("nan"))


def figures(rows):
    found = {
        "andrews_alpha_best_error": best(rows, "andrews", "alpha", "q"),
        "andrews_ida_best_error": best(rows, "andrews", "IDA", "q"),
        "andrews_alpha_plain_best_error": min(row["error_q"] for row in pick(rows, "andrews", "alpha")),
        "car_axis_ida_error_q": best(rows, "car-axis", "IDA", "q"),
        "car_axis_ida_error_lam": best(rows, "car-axis", "IDA", "lam"),
        "car_axis_alpha_error_q": best(rows, "car-axis", "alpha", "q"),
        "pendulum_ida_error_q": best(rows, "pendulum", "IDA", "q"),
        "pendulum_alpha_error_q": best(rows, "pendulum", "alpha", "q"),
    }
    stopped = [row for row in pick(rows) if row["outcome"] != "done" and row["integrator"] != "IDA index3"]
    found["stopped_runs"], found["stopped_runs_andrews"] = len(stopped), len(pick(stopped, "andrews"))
    found["stopped_runs_index3"] = sum(row["outcome"] != "done" for row in pick(rows, None, "IDA index3"))
    for problem in ("double-plate", "double-plate-motors"):
        found[f"{problem}_ida_over_alpha_cpu".replace("-", "_")] = ratio(rows, problem)
    return found | adaptivity(rows)


def ratio(rows, problem, level=1e-5):
    alpha, ida = (cheapest(pick(rows, problem, name), "error_q", level) for name in ("alpha", "IDA ggl2"))
    return ida / alpha


def adaptivity(rows):
    """CPU of the best fixed step over that of error control at equal errors of q, m, where both come so far."""
    fixed, adaptive = pick(rows, EVENT, "alpha"), pick(rows, EVENT, "alpha, adaptive")
    levels = (1e-4, 1e-5, 1e-6)
    ratios = [cheapest(fixed, "error_q", level) / cheapest(adaptive, "error_q", level) for level in levels]
    return {
        f"fixed_over_adaptive_cpu_at_{level:.0e}": ratio for level, ratio in zip(levels, ratios) if np.isfinite(ratio)
    }


def notes(rows):
    lines = [
        f"{row['problem']}, {row['integrator']} at {row['x']:g}: {row['outcome'][:150]}"
        for row in pick(rows)
        if row["outcome"] != "done"
    ]
    for row in {row["problem"]: row for row in pick(rows)}.values():
        known = ", ".join(f"{part} {value:.1e}" for part, value in row["known"].items())
        moves = f"; known to {known}" if known else ""
        lines.append(f"reference of {row['problem']}: {row['reference']}{moves}")
    for member in ("alpha", "alpha, Richardson"):
        row = min(
            (row for row in pick(rows, "andrews", member) if row["outcome"] == "done"), key=lambda row: row["error_q"]
        )
        lines.append(
            f"andrews: {member} comes to {row['error_q']:.1e} in q, at h = {row['x']:g} s, {row['cpu_s']:.2g} CPU s"
        )
    return lines


@drawn
def draw(rows, folder):
    return [path for part in ("q", "v", "lam") for path in cpu_figure(rows, folder, part)] + work_figure(rows, folder)


def members_of(rows):
    return list(dict.fromkeys(row["integrator"] for row in pick(rows)))


def cpu_figure(rows, folder, part):
    problems, members = list(dict.fromkeys(row["problem"] for row in pick(rows))), members_of(rows)
    made, axes = panels(len(problems), width=7.2, height=2.4, columns=3 if len(problems) > 4 else 2)
    for axis, problem in zip(axes, problems):
        for i, member in enumerate(members):
            runs = sorted(
                (row for row in pick(rows, problem, member) if row.get(f"error_{part}")), key=lambda row: row["x"]
            )
            loglog(axis, [row[f"error_{part}"] for row in runs], [row["cpu_s"] for row in runs], i, member)
        axis.set(title=problem, xlabel=f"error in {part}")
    for axis in axes[::3]:
        axis.set_ylabel("CPU seconds")
    legend(made, axes, 4)
    return saved(made, folder, f"work-precision-{part}")


def work_figure(rows, folder):
    problems, members = list(dict.fromkeys(row["problem"] for row in pick(rows)))[:4], members_of(rows)
    made, axes = panels(2 * len(problems), width=6.8, height=2.2)
    for k, problem in enumerate(problems):
        for axis, work in zip(axes[2 * k : 2 * k + 2], ("residuals", "factorizations")):
            for i, member in enumerate(members):
                runs = sorted(
                    (row for row in pick(rows, problem, member) if row.get("error_q")), key=lambda row: row["x"]
                )
                loglog(axis, [row["error_q"] for row in runs], [row[work] for row in runs], i, member)
            axis.set(title=problem, xlabel="error in q", ylabel=work)
    legend(made, axes, 4)
    return saved(made, folder, "work-counts")


COLUMNS = (
    "problem",
    "integrator",
    "x",
    "error_q",
    "error_v",
    "error_lam",
    "cpu_s",
    "steps",
    "residuals",
    "factorizations",
    "outcome",
    "error",
)
STUDY = Study(
    "work_precision",
    "work against precision; x is the step, s, or the tolerance",
    tasks,
    run,
    figures,
    draw,
    COLUMNS,
    notes=notes,
)

if __name__ == "__main__":
    main(STUDY)
