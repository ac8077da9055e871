"""What integrators choose where nothing is given: errors and CPU time on every named problem, against given steps and tolerances."""

import numpy as np

from defaults.runs import measure
from polyida import registry
from polyida.cli.study import main
from polyida.show.style import legend_above, marker_style
from polyida.study.plotting import line_picture, loglog, panels, study_figure
from polyida.study.rows import NAN, column, distinct, pick, unfinished_notes
from polyida.study.tasks import Study
from work_precision.integrators import cheapest

AIM, REACH = 1e-4, (1e-5, 3e-4)  # error over the size: about that, and within these
GIVEN = {  # integrator: settings beside its own
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
        for integrator, given in GIVEN.items()
        for x in (None, *(given[1::3] if quick else given))
    ]


def default(rows, **wanted):
    return [row for row in pick(rows, **wanted) if row["x"] is None]


def errors(rows):
    """The largest and the least error of each integrator's own choice, and of all; NaN where a run did not come to its end."""
    found = {}
    for name, wanted in (("default", {}), *((f"{kind}_default", {"integrator": kind}) for kind in GIVEN)):
        numbers = column(default(rows, **wanted), "error_max")
        found |= {f"{name}_error_max": float(numbers.max()), f"{name}_error_min": float(numbers.min())} if numbers.size else {}
    return found


def over_best(rows, row):
    """CPU of a run over that of the best given setting of its integrator at equal error."""
    given = [other for other in pick(rows, problem=row["problem"], integrator=row["integrator"]) if other["x"] is not None]
    return row["cpu_s"] / cheapest(given, "error_max", row["error_max"]) if row["outcome"] == "done" else NAN


def costs(rows):
    """Median and largest CPU of the own choices over the best given setting at equal error, where one comes so far."""
    found = {}
    for kind in GIVEN:
        ratios = np.array([over_best(rows, row) for row in default(rows, integrator=kind)])
        ratios = ratios[np.isfinite(ratios)]
        found |= (
            {f"{kind}_cpu_over_best": float(np.median(ratios)), f"{kind}_cpu_over_best_max": float(ratios.max())} if ratios.size else {}
        )
    return found


def off_aim(rows):
    """How many of the own choices end outside of REACH."""
    numbers = column(default(rows), "error_max")
    return {"defaults": len(numbers), "above_reach": int((numbers > REACH[1]).sum()), "below_reach": int((numbers < REACH[0]).sum())}


def told(rows):
    """What each own choice comes to, over the best given setting, and what the run's summary says of it."""
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
    """CPU seconds against error: given settings as lines, the own choice a star; the aim is dashed, shaded what counts as reaching it."""
    problems = distinct(rows, "problem")
    made, axes = panels(len(GIVEN) if problems else 0, width=9.0, height=3.4, columns=3)
    for axis, kind in zip(axes, GIVEN):
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
    legend_above(made, axes, 5)
    return line_picture(made, "defaults")


COLUMNS = ("problem", "integrator", "x", "error_max", "error_end", "cpu_s", "steps", "rejected", "factorizations", "outcome", "error")
STUDY = Study(
    "defaults",
    "what integrators choose; x is h over the time, or rtol, none for their own choice; errors of q over the problem's size",
    tasks,
    measure,
    (errors, costs, off_aim),
    defaults_figure,
    COLUMNS,
    notes=(stop_notes, told, reference_notes),
    headline=("default_error_max", "default_error_min", "alpha_cpu_over_best_max"),
)

if __name__ == "__main__":
    main(STUDY)
