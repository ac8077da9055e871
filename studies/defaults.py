"""Accuracy and cost of the default settings of each integrator on every named problem, relative to explicit steps and tolerances."""

import numpy as np

from defaults.runs import measure
from polyida import registry
from polyida.cli.study import main
from polyida.show.styles import legend_above, marker_style
from polyida.study.plotting import line_picture, loglog, panels, study_figure
from polyida.study.rows import NAN, column, distinct, pick, unfinished_notes
from polyida.study.tasks import Study
from work_precision.integrators import cheapest

AIM, REACH = 1e-4, (1e-5, 3e-4)  # error over the size: about that, and within these
EXPLICIT = {  # integrator: settings beside its own
    "alpha": tuple(float(x) for x in np.geomspace(1e-2, 2e-5, 13)),
    "radau": tuple(float(x) for x in np.geomspace(1e-3, 1e-8, 11)),
    "ida": tuple(float(x) for x in np.geomspace(1e-3, 1e-7, 9)),
}
QUICK = ("pendulum", "andrews", "plate-chain")


def tasks(quick):
    names = QUICK if quick else (*registry.problems, "sudden-blow")
    return [
        {"problem": name, "integrator": integrator, "x": x}
        for name in names
        for integrator, explicit in EXPLICIT.items()
        for x in (None, *(explicit[1::3] if quick else explicit))
    ]


def default(rows, **wanted):
    return [row for row in pick(rows, **wanted) if row["x"] is None]


def errors(rows):
    """Largest and smallest error of the defaults of each integrator and of all; NaN if a run failed."""
    result = {}
    for name, wanted in (("default", {}), *((f"{kind}_default", {"integrator": kind}) for kind in EXPLICIT)):
        numbers = column(default(rows, **wanted), "error_max")
        result |= {f"{name}_error_max": float(numbers.max()), f"{name}_error_min": float(numbers.min())} if numbers.size else {}
    return result


def over_best(rows, row):
    """CPU time of a run relative to the best explicit setting of its integrator at equal error."""
    explicit = [other for other in pick(rows, problem=row["problem"], integrator=row["integrator"]) if other["x"] is not None]
    return row["cpu_s"] / cheapest(explicit, "error_max", row["error_max"]) if row["outcome"] == "done" else NAN


def costs(rows):
    """Median and maximum of the CPU time of the defaults relative to the best explicit setting at equal error."""
    result = {}
    for kind in EXPLICIT:
        ratios = np.array([over_best(rows, row) for row in default(rows, integrator=kind)])
        ratios = ratios[np.isfinite(ratios)]
        result |= (
            {f"{kind}_cpu_over_best": float(np.median(ratios)), f"{kind}_cpu_over_best_max": float(ratios.max())} if ratios.size else {}
        )
    return result


def off_aim(rows):
    """Number of default runs with an error outside of REACH."""
    numbers = column(default(rows), "error_max")
    return {"defaults": len(numbers), "above_reach": int((numbers > REACH[1]).sum()), "below_reach": int((numbers < REACH[0]).sum())}


def default_notes(rows):
    """Error and cost of each default run, and the summary of the run."""
    return [
        f"{row['problem']}, {row['integrator']}: error {row['error_max']:.1e} of {row['size']:.3g}, {row['cpu_s']:.2g} CPU s, "
        f"{over_best(rows, row):.2g} times the best given setting's at equal error; {row['summary']}"
        for row in default(rows)
    ]


def reference_notes(rows):
    known = {row["problem"]: ", ".join(f"{part} {value:.1e}" for part, value in row["known"].items()) for row in pick(rows)}
    return [f"reference of {name}: Radau IIA, rtol 1e-10, off what is published by {text}" for name, text in known.items() if text]


def stop_notes(rows):
    return unfinished_notes(rows, "problem", "integrator", "x")


@study_figure
def defaults_figure(rows):
    """CPU seconds against error: lines are explicit settings, stars the defaults. The dashed line is the target error; the shaded range is
    accepted.
    """
    problems = distinct(rows, "problem")
    fig, axes = panels(len(EXPLICIT) if problems else 0, width=9.0, height=3.4, columns=3)
    for axis, kind in zip(axes, EXPLICIT):
        for i, name in enumerate(problems):
            runs = [row for row in pick(rows, problem=name, integrator=kind) if row["x"] is not None]
            loglog(axis, column(runs, "error_max"), column(runs, "cpu_s"), i, name)
            own = default(rows, problem=name, integrator=kind)
            axis.loglog(
                column(own, "error_max"), column(own, "cpu_s"), **marker_style(i) | {"marker": "*", "markersize": 10, "linestyle": ""}
            )
        axis.axvspan(*REACH, color="#dddddd", zorder=0)
        axis.axvline(AIM, color="#777777", linewidth=0.8, linestyle=(0, (5, 3)), zorder=1)
        axis.set(
            title=f"{kind}; stars: its own choice",
            xlabel="largest error of q over the size",
            ylabel="" if kind != "alpha" else "CPU seconds",
        )
    legend_above(fig, axes, 5)
    return line_picture(fig, "defaults")


COLUMNS = ("problem", "integrator", "x", "error_max", "error_end", "cpu_s", "steps", "rejected", "factorizations", "outcome", "error")
STUDY = Study(
    "defaults",
    "default settings of the integrators; x is h relative to the time, or rtol, empty for the default; errors of q relative to the problem's size",
    tasks,
    measure,
    (errors, costs, off_aim),
    defaults_figure,
    COLUMNS,
    notes=(stop_notes, default_notes, reference_notes),
    headline=("default_error_max", "default_error_min", "alpha_cpu_over_best_max"),
)

if __name__ == "__main__":
    main(STUDY)
