"""Condition number of the iteration matrices against the step, and what it does to the solve of each back-end."""

import numpy as np

from polyida.cli_study import main
from polyida.integrate.ida_whole import SCALINGS as IDA_SCALINGS
from polyida.linear.kkt import SCALINGS
from polyida.study import conditioning, solve_error
from polyida.study.drawing import drawn, fitted, legend, loglog, panels, saved, slope_line
from polyida.study.harness import Study


def steps(quick):
    return (
        [float(f"1e-{k}") for k in range(1, 10)]
        if quick
        else [float(f"{x}e-{k}") for k in range(1, 10) for x in (3, 1)][1:]
    )


def tasks(quick):
    made, given = [], {"cells": 8 if quick else 20, "h": steps(quick)}
    for plates in ("soft", "steel", "stiffest", "springs"):
        pairs = [("(q, lam)", scaling) for scaling in conditioning.ALPHA_SCALINGS]
        pairs += [(f"({unknown}, lam)", "none") for unknown in conditioning.ALPHA_UNKNOWNS if unknown != "q"]
        made += [{"plates": plates, "of": "alpha", "form": form, "scaling": scaling} | given for form, scaling in pairs]
        made += [
            {"plates": plates, "of": "IDA", "form": form, "scaling": scaling} | given
            for form in conditioning.IDA_SLOPES
            for scaling in IDA_SCALINGS
        ]
        made.append({"plates": plates, "of": "alpha", "form": "S on free motions", "scaling": "-"} | given)
    for plates in ("soft", "steel"):
        made += [
            {"plates": plates, "of": "solve", "form": backend, "scaling": scaling} | given
            for backend in solve_error.BACKENDS
            for scaling in SCALINGS
        ]
        made += [
            {"plates": plates, "of": f"IDA solve, {form}", "form": backend, "scaling": scaling} | given
            for form in ("ggl2", "index1")
            for backend in solve_error.WHOLE
            for scaling in IDA_SCALINGS
        ]
    return made


def run(plates, cells, of, form, scaling, h):
    model, state = conditioning.state_of(plates, cells)
    if "solve" in of:
        errors = np.array([solve_error_of(model, state, of, form, scaling, step) for step in h])
        return {
            "values": errors.max(axis=1),
            "worst": errors.max(),
            "at_1e-2": errors[h.index(1e-2)].max(),
            "at_1e-9": errors[-1].max(),
        }
    measure = measured(model, state, of, form, scaling)
    values, fastest = np.array([measure(step) for step in h]), conditioning.fastest(model, state)
    far = 1e-3 / fastest**2 * 10.0 ** -np.arange(4)
    small = np.array(h) < 0.1 / fastest
    within = np.array(h) <= 1.0001e-2
    return {
        "values": values,
        "theory": theory(of, form, scaling),
        "slope": fitted(np.array(h)[small], values[small]),
        "slope_limit": fitted(far, [measure(step) for step in far]),
        "worst": values[within].max(),
        "at_1e-2": values[h.index(1e-2)],
        "at_1e-9": values[-1],
    }


def measured(model, state, of, form, scaling):
    """Function h -> condition number."""
    if form == "S on free motions":
        return lambda h: conditioning.inherent_condition(model, state, h)
    if of == "alpha":
        return lambda h: conditioning.alpha_condition(model, state, h, form[1], scaling)
    return lambda h: conditioning.ida_condition(model, state, h, form, scaling)


def solve_error_of(model, state, of, backend, scaling, h):
    """Errors of the kinds of unknowns in one solve."""
    if of == "solve":
        return solve_error.alpha_errors(model, state, h, backend, scaling)
    return solve_error.ida_errors(model, state, h, of.removeprefix("IDA solve, "), backend, scaling)


def theory(of, form, scaling):
    if form == "S on free motions" or scaling == "characteristic":
        return 0
    if of == "IDA":
        return conditioning.IDA_SLOPES[form]
    return conditioning.ALPHA_SCALINGS[scaling] if form == "(q, lam)" else conditioning.ALPHA_UNKNOWNS[form[1]]


def pick(rows, **wanted):
    return [row for row in rows if not row.get("error") and all(row[key] == value for key, value in wanted.items())]


def figures(rows):
    physical = pick(rows, of="alpha", form="(q, lam)", scaling="physical")
    unscaled = pick(rows, of="alpha", form="(q, lam)", scaling="none")
    found = {
        "slope_unscaled": pick(unscaled, plates="soft")[0]["slope"],
        "slope_unscaled_worst": max((row["slope_limit"] for row in unscaled), key=lambda slope: abs(slope + 4)),
        "scaled_condition_max": max(row["worst"] for row in physical),
        "scaled_condition_at_1e-9_max": max(row["at_1e-9"] for row in physical),
    }
    for row in physical:
        found[f"scaled_condition_max_{row['plates']}"] = row["worst"]
    free = {row["plates"]: row["values"] for row in pick(rows, form="S on free motions")}
    found["scaled_over_free_max"] = max(np.max(np.divide(row["values"], free[row["plates"]])) for row in physical)
    found["ida_scaled_slope_limit_max"] = max(
        abs(row["slope_limit"]) for row in pick(rows, of="IDA", scaling="characteristic")
    )
    for row in pick(rows, of="IDA", scaling="none", plates="soft"):
        found[f"slope_limit_{row['form']}"] = row["slope_limit"]
    return found


def notes(rows):
    found = figures(rows)
    lines = [
        f"scaled condition numbers exceed 1e4: {row['plates']}, up to {row['worst']:.2g} at h <= 1e-2. "
        "They are the plates' own, of S on the motions that the constraints leave free; no scaling of the border helps"
        for row in pick(rows, of="alpha", form="(q, lam)", scaling="physical")
        if row["worst"] > 1e4
    ]
    lines.append(
        f"the border adds at most a factor {found['scaled_over_free_max']:.2g} to S on the free motions, at every h"
    )
    for row in rows:
        if "solve" in row["of"] and not row.get("error") and row["at_1e-9"] > 1e-3:
            lines.append(
                f"no digits at 1e-9: {row['of']}, {row['form']}, scaling {row['scaling']}, {row['plates']}: "
                f"{row['at_1e-9']:.1g}"
            )
    return lines


@drawn
def draw(rows, folder):
    return (
        alpha_figure(rows, folder)
        + ida_figure(rows, folder)
        + solve_figure(rows, folder, "solve-error", "step h, s", [("solve", scaling) for scaling in SCALINGS])
        + solve_figure(
            rows,
            folder,
            "solve-error-ida",
            "1 / cj, s",
            [(f"IDA solve, {form}", scaling) for form in ("ggl2", "index1") for scaling in IDA_SCALINGS[::-1]],
        )
    )


def alpha_figure(rows, folder):
    made, axes = panels(2, height=3.4)
    for axis, plates in zip(axes, ("soft", "steel")):
        kept = pick(rows, of="alpha", plates=plates)
        for i, row in enumerate(kept):
            loglog(
                axis,
                row["h"],
                row["values"],
                i,
                f"{row['form']}{'' if row['scaling'] in '-' else ', ' + row['scaling']}",
            )
        for row in kept:
            if row["scaling"] == "none":
                slope_line(axis, row["theory"], [1e-6, 1e-9], row["values"][row["h"].index(1e-6)] * 3)
        axis.set(xlabel="step h, s", ylabel="condition number", title=f"generalized-alpha, {plates} plates")
    legend(made, axes, 3)
    return saved(made, folder, "condition-alpha")


def ida_figure(rows, folder):
    made, axes = panels(2, height=3.4, sharey=True)
    for axis, scaling, title in zip(axes, ("none", "characteristic"), ("raw", "scaled by characteristic sizes")):
        for i, row in enumerate(pick(rows, of="IDA", plates="soft", scaling=scaling)):
            loglog(axis, row["h"], row["values"], i, row["form"])
        axis.set(xlabel="1 / cj, s", title=f"IDA, soft plates, {title}")
    axes[0].set_ylabel("condition number")
    legend(made, axes, 6)
    return saved(made, folder, "condition-ida")


def solve_figure(rows, folder, name, step, shown):
    """Errors on steel plates, a panel for each (of, scaling)."""
    made, axes = panels(len(shown), width=7.4, height=3.3, columns=len(shown), sharey=True)
    for axis, (of, scaling) in zip(axes, shown):
        for i, row in enumerate(pick(rows, of=of, plates="steel", scaling=scaling)):
            loglog(axis, row["h"], row["values"], i, row["form"])
        form = of.removeprefix("IDA solve, ")
        title = f"scaling: {scaling}" if of == form else f"{form}, {'raw' if scaling == 'none' else 'scaled'}"
        axis.set(xlabel=step, title=title, ylim=(1e-16, 1e3))
    axes[0].set_ylabel("relative error of the solve")
    legend(made, axes, 2)
    return saved(made, folder, name)


COLUMNS = ("of", "plates", "form", "scaling", "theory", "slope", "slope_limit", "at_1e-2", "at_1e-9", "worst", "error")
STUDY = Study(
    "conditioning",
    "condition numbers: slopes in h beside theory; solve errors of linear back-ends",
    tasks,
    run,
    figures,
    draw,
    COLUMNS,
    notes=notes,
)

if __name__ == "__main__":
    main(STUDY)
