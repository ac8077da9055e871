"""Condition number of the iteration matrices against the step, and its effect on the solution by each back-end."""

import numpy as np

from conditioning import solve_error
from conditioning import systems as conditioning
from polyida.cli.study import main
from polyida.integrate.ida.tables import SCALINGS as IDA_SCALINGS
from polyida.linear.saddle import SCALINGS
from polyida.show.styles import legend_above
from polyida.study.conditions import MODES
from polyida.study.plotting import line_picture, loglog, nested_style, panels, slope_line, study_figure
from polyida.study.rows import column_with_failures, farthest, fit_slope, largest, number, pick
from polyida.study.tasks import Study


def steps(quick):
    return [float(f"1e-{k}") for k in range(1, 10)] if quick else [float(f"{x}e-{k}") for k in range(1, 10) for x in (3, 1)][1:]


def tasks(quick):
    selection, common = [], {"cells": 8 if quick else 20, "h": steps(quick)}
    for plates in ("soft", "steel", "stiffest", "springs"):
        pairs = [("(q, lam)", scaling) for scaling in conditioning.ALPHA_SCALINGS]
        pairs += [(f"({unknown}, lam)", "none") for unknown in conditioning.ALPHA_UNKNOWNS if unknown != "q"]
        selection += [{"plates": plates, "of": "alpha", "form": form, "scaling": scaling} | common for form, scaling in pairs]
        selection += [
            {"plates": plates, "of": "IDA", "form": form, "scaling": scaling} | common
            for form in conditioning.IDA_SLOPES
            for scaling in IDA_SCALINGS
        ]
        selection += [
            {"plates": plates, "of": "Radau", "form": f"{form}, {mode}", "scaling": scaling} | common
            for form in conditioning.RADAU_SLOPES
            for mode in MODES
            for scaling in SCALINGS
        ]
        selection.append({"plates": plates, "of": "alpha", "form": "S on free motions", "scaling": "-"} | common)
    for plates in ("soft", "steel"):
        selection += [
            {"plates": plates, "of": "solve", "form": backend, "scaling": scaling} | common
            for backend in solve_error.BACKENDS
            for scaling in SCALINGS
        ]
        selection += [
            {"plates": plates, "of": f"IDA solve, {form}", "form": backend, "scaling": scaling} | common
            for form in ("ggl2", "index1")
            for backend in solve_error.WHOLE
            for scaling in IDA_SCALINGS
        ]
    return selection


def run(plates, cells, of, form, scaling, h):
    model, state = conditioning.state_of(plates, cells)
    if "solve" in of:
        errors = np.array([solve_error_of(model, state, of, form, scaling, step) for step in h])
        return {"values": errors.max(axis=1), "worst": errors.max(), "at_1e-2": errors[h.index(1e-2)].max(), "at_1e-9": errors[-1].max()}
    measure = measured(model, state, of, form, scaling)
    values, fastest = np.array([measure(step) for step in h]), conditioning.fastest(model, state)
    far = 1e-3 / fastest**2 * 10.0 ** -np.arange(4)
    small = np.array(h) < 0.1 / fastest
    within = np.array(h) <= 1.0001e-2
    return {
        "values": values,
        "theory": theory(of, form, scaling),
        "slope": fit_slope(np.array(h)[small], values[small]),
        "slope_limit": fit_slope(far, [measure(step) for step in far]),
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
    if of == "Radau":
        return lambda h: conditioning.radau_condition(model, state, h, *form.split(", "), scaling)
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
    if of == "Radau":
        return conditioning.RADAU_SLOPES[form.split(", ")[0]] if scaling == "none" else 0
    return conditioning.ALPHA_SCALINGS[scaling] if form == "(q, lam)" else conditioning.ALPHA_UNKNOWNS[form[1]]


def figures(rows):
    physical = {"of": "alpha", "form": "(q, lam)", "scaling": "physical"}
    unscaled = {"of": "alpha", "form": "(q, lam)", "scaling": "none"}
    result = {
        "slope_unscaled": number(rows, "slope", plates="soft", **unscaled),
        "slope_unscaled_worst": farthest(column_with_failures(rows, "slope_limit", **unscaled), -4),
        "scaled_condition_max": largest(rows, "worst", **physical),
        "scaled_condition_at_1e-9_max": largest(rows, "at_1e-9", **physical),
    }
    for row in pick(rows, **physical):
        result[f"scaled_condition_max_{row['plates']}"] = row["worst"]
    result["scaled_over_free_max"] = over_free(rows, pick(rows, **physical))
    result["ida_scaled_slope_limit_max"] = abs(farthest(column_with_failures(rows, "slope_limit", of="IDA", scaling="characteristic"), 0))
    for row in pick(rows, of="IDA", scaling="none", plates="soft"):
        result[f"slope_limit_{row['form']}"] = row["slope_limit"]
    return result | radau_figures(rows)


def radau_figures(rows):
    """Maxima over both modes and all plates, and over both forms of the scaled matrices."""
    raw, physical = {"of": "Radau", "scaling": "none"}, {"of": "Radau", "scaling": "physical"}
    result = {}
    for form, slope in conditioning.RADAU_SLOPES.items():
        slopes = [column_with_failures(rows, "slope_limit", form=f"{form}, {mode}", **raw) for mode in MODES]
        result[f"radau_{form}_raw_slope"] = farthest(np.concatenate(slopes), slope)
    return result | {
        "radau_scaled_slope_max": abs(farthest(column_with_failures(rows, "slope_limit", **physical), 0)),
        "radau_scaled_condition_max": largest(rows, "worst", **physical),
        "radau_scaled_condition_at_1e-9_max": largest(rows, "at_1e-9", **physical),
    }


def over_free(rows, physical):
    """Largest scaled condition number relative to that of S on the free motions."""
    free = {row["plates"]: row["values"] for row in pick(rows, form="S on free motions")}
    ratios = [np.max(np.divide(row["values"], free[row["plates"]])) for row in physical if row["plates"] in free]
    return max(ratios, default=float("nan"))


def size_notes(rows):
    return [
        f"scaled condition numbers exceed 1e4: {row['plates']}, up to {row['worst']:.2g} at h <= 1e-2. "
        "They are the plates' own, of S on the motions that the constraints leave free; no scaling of the border helps"
        for row in pick(rows, of="alpha", form="(q, lam)", scaling="physical")
        if row["worst"] > 1e4
    ]


def border_notes(rows):
    added = figures(rows)["scaled_over_free_max"]
    return [f"the border adds at most a factor {added:.2g} to S on the free motions, at every h"] if added > 0 else []


def solve_notes(rows):
    return [
        f"no digits at 1e-9: {row['of']}, {row['form']}, scaling {row['scaling']}, {row['plates']}: {row['at_1e-9']:.1g}"
        for row in pick(rows)
        if "solve" in row["of"] and row["at_1e-9"] > 1e-3
    ]


def label_of(row):
    return f"{row['form']}{'' if row['scaling'] in '-' else ', ' + row['scaling']}"


@study_figure
def alpha_figure(rows):
    """Condition number of generalized-alpha's iteration matrix against the step, with the slopes of theory dashed."""
    fig, axes = panels(2, height=3.4)
    labels = list(dict.fromkeys(label_of(row) for row in pick(rows, of="alpha")))
    for axis, plates in zip(axes, ("soft", "steel")):
        alpha_rows = pick(rows, of="alpha", plates=plates)
        for row in alpha_rows:
            loglog(axis, row["h"], row["values"], labels.index(label_of(row)), label_of(row))
        for row in alpha_rows:
            if row["scaling"] == "none":
                slope_line(axis, row["theory"], [1e-6, 1e-9], row["values"][row["h"].index(1e-6)] * 3)
        axis.set(xlabel="step h, s", ylabel="condition number", title=f"generalized-alpha, {plates} plates")
    legend_above(fig, axes, 3)
    return line_picture(fig, "condition-alpha")


@study_figure
def ida_figure(rows):
    """Condition number of IDA's matrix against 1/cj, raw and scaled, form by form."""
    fig, axes = panels(2, height=3.4, sharey=True)
    for axis, scaling, title in zip(axes, ("none", "characteristic"), ("raw", "scaled by characteristic sizes")):
        for row in pick(rows, of="IDA", plates="soft", scaling=scaling):
            loglog(axis, row["h"], row["values"], list(conditioning.IDA_SLOPES).index(row["form"]), row["form"])
        axis.set(xlabel="1 / cj, s", title=f"IDA, soft plates, {title}")
    axes[0].set_ylabel("condition number")
    legend_above(fig, axes, 6)
    return line_picture(fig, "condition-ida")


@study_figure
def radau_figure(rows):
    """Condition number of Radau IIA's matrices against the step, raw and scaled, for both modes of the stages."""
    fig, axes = panels(2, height=3.4, sharey=True)
    forms = [f"{form}, {mode}" for form in conditioning.RADAU_SLOPES for mode in MODES]
    for axis, scaling, title in zip(axes, ("none", "physical"), ("raw", "scaled by physical sizes")):
        for row in pick(rows, of="Radau", plates="soft", scaling=scaling):
            ring = forms.index(row["form"])
            axis.loglog(row["h"], row["values"], label=row["form"], **nested_style(ring, ring, len(forms)))
        axis.set(xlabel="step h, s", title=f"Radau IIA, soft plates, {title}")
    for row in pick(rows, of="Radau", plates="soft", scaling="none"):
        if row["form"].endswith("real"):
            slope_line(axes[0], row["theory"], [1e-6, 1e-9], row["values"][row["h"].index(1e-6)] * 3)
    axes[0].set_ylabel("condition number")
    legend_above(fig, axes, 4)
    return line_picture(fig, "condition-radau")


def solve_figure(rows, name, step, shown):
    """Errors on steel plates, one panel for each (unknown, scaling)."""
    fig, axes = panels(len(shown), width=7.4, height=3.3, columns=len(shown), sharey=True)
    for axis, (of, scaling) in zip(axes, shown):
        for row in pick(rows, of=of, plates="steel", scaling=scaling):
            loglog(axis, row["h"], row["values"], list(solve_error.BACKENDS).index(row["form"]), row["form"])
        form = of.removeprefix("IDA solve, ")
        title = f"scaling: {scaling}" if of == form else f"{form}, {'raw' if scaling == 'none' else 'scaled'}"
        axis.set(xlabel=step, title=title, ylim=(1e-16, 1e3))
    axes[0].set_ylabel("relative error of the solve")
    legend_above(fig, axes, 2)
    return line_picture(fig, name)


@study_figure
def solve_alpha_figure(rows):
    """Relative error of one solve with generalized-alpha's matrix against the step, on steel plates, for each back-end and scaling."""
    return solve_figure(rows, "solve-error", "step h, s", [("solve", scaling) for scaling in SCALINGS])


@study_figure
def solve_ida_figure(rows):
    """Relative error of one solve with IDA's matrix against 1/cj, on steel plates, for each back-end."""
    kinds = [(f"IDA solve, {form}", scaling) for form in ("ggl2", "index1") for scaling in IDA_SCALINGS[::-1]]
    return solve_figure(rows, "solve-error-ida", "1 / cj, s", kinds)


COLUMNS = ("of", "plates", "form", "scaling", "theory", "slope", "slope_limit", "at_1e-2", "at_1e-9", "worst", "error")
STUDY = Study(
    "conditioning",
    "condition numbers: measured and theoretical slopes in h; errors of linear back-ends",
    tasks,
    run,
    figures,
    (alpha_figure, ida_figure, radau_figure, solve_alpha_figure, solve_ida_figure),
    COLUMNS,
    notes=(size_notes, border_notes, solve_notes),
    headline=("slope_unscaled", "scaled_condition_max"),
)

if __name__ == "__main__":
    main(STUDY)
