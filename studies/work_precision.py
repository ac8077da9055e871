"""Work-precision: CPU time and work against the measured error in q, v and lam, for every integrator and form on every problem."""

from functools import partial

import numpy as np

from polyida.cli.study import main
from polyida.show.styles import INK, legend_above
from polyida.study.plotting import line_picture, loglog, panels, study_figure
from polyida.study.rows import column, distinct, pick, smallest, unfinished_notes
from polyida.study.tasks import Study
from work_precision import radau_accuracy, tip_accuracy
from work_precision.cases import measure
from work_precision.integrators import FIXED, IDA_FORMS, RADAU, cheapest
from work_precision.selection import EVENT, STIFF, not_run, tasks

FAMILIES = {  # figure: its members, and those of other families for comparison
    "alpha": ((*FIXED, "alpha, adaptive"), ("IDA ggl2",)),
    "ida": (tuple(f"IDA {form}" for form in IDA_FORMS), ("alpha",)),
    "radau": (("radau", *RADAU), ("alpha", "IDA ggl2")),
}
NAMES = {"alpha": "Generalized-alpha and its kin", "ida": "IDA", "radau": "Radau IIA"}
GREYS = (("#aaaaaa", "-"), ("#888888", (0, (4, 1.6))))
UNITS = {  # of q, v and lam; a multiplier of an angle motor is in N m, one of a phi in m^2 in N/m
    "andrews": ("rad", "rad/s", "N"),
    "car-axis": ("m", "m/s", "N/m"),
    "double-plate-motors": ("m", "m/s", "N and N m"),
}
SI = ("m", "m/s", "N")
LEVELS = (1e-6, 1e-8)


def all_tasks(quick):
    return tasks(quick) + tip_accuracy.tasks(quick)


def run(problem, integrator, x, quick):
    if problem in tip_accuracy.SCENES:
        return tip_accuracy.measure(problem, integrator, x)
    return measure(problem, integrator, x, quick)


def errors(rows, problem, prefix, part="q"):
    return column([row for row in pick(rows, problem=problem) if row["integrator"].startswith(prefix)], f"error_{part}")


def best_errors(rows):
    return {
        "andrews_alpha_best_error": smallest(errors(rows, "andrews", "alpha")),
        "andrews_ida_best_error": smallest(errors(rows, "andrews", "IDA")),
        "andrews_alpha_plain_best_error": smallest(column(pick(rows, problem="andrews", integrator="alpha"), "error_q")),
        "car_axis_ida_error_q": smallest(errors(rows, "car-axis", "IDA")),
        "car_axis_ida_error_lam": smallest(errors(rows, "car-axis", "IDA", "lam")),
        "car_axis_alpha_error_q": smallest(errors(rows, "car-axis", "alpha")),
        "pendulum_ida_error_q": smallest(errors(rows, "pendulum", "IDA")),
        "pendulum_alpha_error_q": smallest(errors(rows, "pendulum", "alpha")),
    }


def stops(rows):
    ended = [row for row in pick(rows) if row["outcome"] != "done"]
    raw = pick(ended, integrator="IDA index3")
    return {
        "stopped_runs": len(ended) - len(raw),
        "stopped_runs_andrews": len(pick(ended, problem="andrews")) - len(pick(raw, problem="andrews")),
        "stopped_runs_index3": len(raw),
    }


def ratios(rows, level=1e-5):
    """CPU time of IDA relative to generalized-alpha at equal errors of q, m."""
    result = {}
    for problem in distinct([row for row in rows if row["problem"] in ("double-plate", "double-plate-motors")], "problem"):
        alpha, ida = (cheapest(pick(rows, problem=problem, integrator=name), "error_q", level) for name in ("alpha", "IDA ggl2"))
        result[f"{problem}_ida_over_alpha_cpu".replace("-", "_")] = ida / alpha
    return result


def adaptivity(rows):
    """CPU time of the best fixed step relative to error control at equal errors of q, m."""
    fixed, adaptive = (pick(rows, problem=EVENT, integrator=name) for name in ("alpha", "alpha, adaptive"))
    result = {level: cheapest(fixed, "error_q", level) / cheapest(adaptive, "error_q", level) for level in (1e-4, 1e-5, 1e-6)}
    return {f"fixed_over_adaptive_cpu_at_{level:.0e}": ratio for level, ratio in result.items() if np.isfinite(ratio)}


def stop_notes(rows):
    return unfinished_notes(rows, "problem", "integrator", "x")


def reference_notes(rows):
    lines = []
    for row in {row["problem"]: row for row in pick(rows)}.values():
        known = ", ".join(f"{part} {value:.1e}" for part, value in row["known"].items())
        lines.append(f"reference of {row['problem']}: {row['reference']}{f'; known to {known}' if known else ''}")
    return lines


def selection_notes(rows):
    lines = not_run(rows)
    for problem in STIFF:
        tolerances = [row["x"] for row in rows if row["problem"] == problem and row["integrator"].startswith("IDA")]
        lines += [f"{problem}: IDA's tolerances end at {min(tolerances):g}"] if tolerances else []
    return lines


def reach_notes(rows):
    """Smallest error of fixed steps of generalized-alpha on Andrews' mechanism, and the step below which it rises again."""
    lines = []
    for member in ("alpha", "alpha, stabilised", "alpha, Richardson"):
        runs = [row for row in pick(rows, problem="andrews", integrator=member) if np.isfinite(row.get("error_q") or np.nan)]
        runs = sorted(runs, key=lambda row: -row["x"])
        if not runs:
            continue
        best, finest = min(runs, key=lambda row: row["error_q"]), runs[-1]
        line = f"andrews: {member} comes to {best['error_q']:.1e} in q, at h = {best['x']:g} s, {best['cpu_s']:.2g} CPU s"
        for level in LEVELS:
            met = ", ".join(f"{row['x']:g}" for row in runs if row["error_q"] <= level)
            line += f"; {level:.0e} is met at {f'h = {met} s' if met else 'no h'} of {len(runs)}"
        if finest["error_q"] > 1.5 * best["error_q"]:
            line += f"; the error rises again below, to {finest['error_q']:.1e} at h = {finest['x']:g} s"
        lines.append(line)
    return lines


def unit(problem, part):
    return UNITS.get(problem, SI)[["q", "v", "lam"].index(part)]


def curve(axis, rows, x, y, i, label):
    runs = [row for row in sorted(rows, key=lambda row: row["x"]) if row.get(x)]
    loglog(axis, column(runs, x), column(runs, y), i, label)


def draw_family(axis, rows, problem, family, x, y):
    """Lines of the members of a family; lines of other families in grey."""
    members, others = FAMILIES[family]
    for other, (grey, dash) in zip(others, GREYS):
        runs = pick(rows, problem=problem, integrator=other)
        if runs:
            curve(axis, runs, x, y, len(members), f"{other} (for comparison)")
            axis.get_lines()[-1].set(color=grey, linestyle=dash, linewidth=2.5, marker="", zorder=1, alpha=0.7)
    for i, member in enumerate(members):
        runs = pick(rows, problem=problem, integrator=member)
        if runs:
            curve(axis, runs, x, y, i, member)


def mark_known(axis, rows, problem, part):
    """A line at the accuracy of the reference: smaller errors cannot be resolved."""
    known = max((row["known"].get(part, 0.0) for row in pick(rows, problem=problem)), default=0.0)
    if known > axis.get_xlim()[0]:
        axis.axvline(known, color=INK, linewidth=0.7, linestyle=(0, (1, 1.5)), zorder=0, label="what is known of the reference")


def problems_of(rows, family):
    return distinct([row for row in rows if row["integrator"] in FAMILIES[family][0]], "problem")


def cpu_figure(family, part, rows):
    problems = problems_of(rows, family)
    fig, axes = panels(len(problems), width=7.2, height=2.3, columns=3)
    for k, (axis, problem) in enumerate(zip(axes, problems)):
        draw_family(axis, rows, problem, family, f"error_{part}", "cpu_s")
        mark_known(axis, rows, problem, part)
        axis.set(title=problem, xlabel=f"error in {part}, {unit(problem, part)}", ylabel="" if k % 3 else "CPU seconds")
    legend_above(fig, axes, 3)
    caption = f"{NAMES[family]}: CPU time against the error in {part} at the end, problem by problem; grey are others for comparison."
    return line_picture(fig, f"work-precision-{family}-{part}", caption)


def counts_figure(family, rows):
    problems = problems_of(rows, family)
    fig, axes = panels(2 * len(problems), width=9.0, height=2.1, columns=4)
    for k, problem in enumerate(problems):
        for axis, work in zip(axes[2 * k : 2 * k + 2], ("residuals", "factorizations")):
            draw_family(axis, rows, problem, family, "error_q", work)
            mark_known(axis, rows, problem, "q")
            axis.set(title=problem, xlabel=f"error in q, {unit(problem, 'q')}", ylabel=work)
    legend_above(fig, axes, 4)
    caption = f"{NAMES[family]}: residuals and factorizations against the error in q at the end, problem by problem; grey are others for comparison."
    return line_picture(fig, f"work-counts-{family}", caption)


def figure_of(function, *settings):
    """A figure function of the study with its settings, under its own name."""
    drawing = partial(function, *settings)
    drawing.__name__ = "_".join((function.__name__, *settings))
    return study_figure(drawing)


DRAW = tuple(figure_of(cpu_figure, family, part) for family in FAMILIES for part in ("q", "v", "lam"))
DRAW += tuple(figure_of(counts_figure, family) for family in FAMILIES)
COLUMNS = (
    "problem",
    "integrator",
    "x",
    "error_q",
    "error_v",
    "error_lam",
    "error_tip",
    "newton_tip",
    "cpu_s",
    "steps",
    "residuals",
    "factorizations",
    "outcome",
    "error",
)
STUDY = Study(
    "work_precision",
    "work against precision; x is the step, s, or the tolerance; errors are the largest absolute ones at the end",
    all_tasks,
    run,
    (
        best_errors,
        stops,
        ratios,
        adaptivity,
        tip_accuracy.newton_share,
        tip_accuracy.ida_error_slope,
        radau_accuracy.orders,
        radau_accuracy.at_tight_tolerance,
        radau_accuracy.error_over_rtol,
    ),
    DRAW,
    COLUMNS,
    notes=(stop_notes, reference_notes, selection_notes, reach_notes, tip_accuracy.notes, radau_accuracy.notes),
    headline=(
        "andrews_alpha_best_error",
        "andrews_ida_best_error",
        "car_axis_ida_error_q",
        "car_axis_ida_error_lam",
        "newton_share",
        "ida_error_slope",
        "radau_order_q",
        "radau_order_v",
        "radau_order_lam",
        "radau_error_over_rtol",
    ),
)

if __name__ == "__main__":
    main(STUDY)
