"""Cost of the gradient of a run relative to the run, the parts of its backward sweep, and its accuracy at each Newton tolerance."""

import numpy as np

from gradient_over_run import measure
from polyida.cli.study import main
from polyida.show.styles import legend_above, marker_style
from polyida.study.plotting import line_picture, panels, study_figure, target_line
from polyida.study.rows import pick
from polyida.study.tasks import Study

DECADES = {"1e3": 1_000, "1e4": 10_000}
SPANS = {1_000: 1.0, 3_000: 1.0, 10_000: 0.5, 30_000: 0.2}  # s
AIMS = {"gradient_over_run_1e3": 1.5, "gradient_over_run_1e4": 1.1, "several_over_one_1e3": 1.6, "several_over_one_1e4": 1.6}
TOLERANCES = (1e-4, 1e-5, 1e-6, 1e-8)
RUNS = {"time": measure.ratio_row, "several": measure.several_row, "error": measure.error_row}
PARTS = ("solve", "product", "rest")


def tasks(quick):
    """Times of each scene and objective at each size, of several objectives together, then errors at each tolerance."""
    sizes, repeats = (DECADES.values(), 3) if quick else (SPANS, 7)
    cases = [(scene, objective) for scene in measure.SCENES for objective in measure.OBJECTIVES]
    selection = [
        {"part": "time", "scene": scene, "objective": objective, "dof": dof, "t_end": SPANS[dof], "repeats": repeats}
        for dof in sizes
        for scene, objective in cases
    ]
    selection += [{"part": "several", "scene": "scene 2", "dof": dof, "t_end": SPANS[dof], "repeats": repeats} for dof in DECADES.values()]
    dof, span = (300, 0.2) if quick else (1_000, 1.0)
    return selection + [
        {"part": "error", "scene": scene, "objective": objective, "dof": dof, "t_end": span, "tolerance": tolerance}
        for scene, objective in cases
        for tolerance in TOLERANCES
    ]


def run(part, **task):
    """One row."""
    return RUNS[part](**task)


def figures(rows):
    """Median of the ratios of each size over all scenes and objectives; the largest errors."""
    result = {}
    for name, dof in DECADES.items():
        ratios = [row["ratio"] for row in pick(rows, part="time", dof=dof)]
        if ratios:
            result |= {f"gradient_over_run_{name}": float(np.median(ratios)), f"gradient_over_run_{name}_largest": max(ratios)}
        if several := pick(rows, part="several", dof=dof):
            result[f"several_over_one_{name}"] = several[0]["several_over_one"]
            result[f"several_over_apart_{name}"] = several[0]["several_over_apart"]
    for tolerance in TOLERANCES:
        errors = [max(row["stiffness_error"], row["mass_error"]) for row in pick(rows, part="error", tolerance=tolerance)]
        if errors:
            result[f"slope_error_{tolerance:.0e}"] = max(errors)
    return result


def aim_notes(rows):
    """Missed targets."""
    result = figures(rows)
    return [
        f"{name}: {result[name]:.3g}, aim at most {target:.3g}"
        for name, target in AIMS.items()
        if name in result and not result[name] <= target
    ]


def time_notes(rows):
    """Each gradient and its run, and the shares of its backward sweep."""
    return [
        f"{row['scene']}, {row['n']} coordinates, {row['objective']}: a step of the run {row['run_us']:.3g} us with {row['run_solves']:.2f} solves, "
        f"of its gradient {row['gradient_us']:.3g} with {row['solves']:.2f}, in turn {row['ratio']:.2f}; the sweep {row['sweep_us']:.3g}: "
        + ", ".join(f"{part} {100 * share:.0f} %" for part, share in shares(row).items())
        for row in pick(rows, part="time")
    ]


def shares(row):
    """Shares of the parts of a backward sweep in its time."""
    result = {part: row[f"{part}_us"] / row["sweep_us"] for part in PARTS[:2]}
    return result | {"rest": 1.0 - sum(result.values())}


@study_figure
def draw(rows):
    """Left: CPU time of a gradient relative to its run against the number of coordinates, for each scene and objective. Right: relative
    error of the slopes for each polygon's stiffness against Newton's tolerance.
    """
    times, errors = pick(rows, part="time"), pick(rows, part="error")
    fig, axes = panels(2 if times or errors else 0, width=9.0, height=3.6)
    cases = [(scene, objective) for scene in measure.SCENES for objective in measure.OBJECTIVES]
    for i, (scene, objective) in enumerate(cases):
        for axis, result, x, y in ((axes[0], times, "n", "ratio"), (axes[1], errors, "tolerance", "stiffness_error")):
            own = sorted(pick(result, scene=scene, objective=objective), key=lambda row, x=x: row[x])
            if own:
                axis.plot([row[x] for row in own], [row[y] for row in own], label=f"{scene}, {objective}", **marker_style(i))
    axes[0].set(xscale="log", xlabel="coordinates", ylabel="gradient over run", ylim=(0.0, None))
    axes[1].set(xscale="log", yscale="log", xlabel="Newton's tolerance", ylabel="relative error of the slopes")
    target_line(axes[0], AIMS["gradient_over_run_1e4"], "aim at 1e4")
    legend_above(fig, axes, columns=3)
    return line_picture(fig, "gradient-over-run")


study = Study(
    "gradient_over_run",
    "Cost of a gradient relative to its run",
    tasks,
    run,
    figures,
    draw,
    notes=(aim_notes, time_notes),
    headline=tuple(AIMS),
    columns=(
        "part",
        "scene",
        "objective",
        "n",
        "steps",
        "tolerance",
        "run_us",
        "gradient_us",
        "ratio",
        "run_solves",
        "solves",
        "run_factorizations",
        "factorizations",
        "sweep_us",
        "solve_us",
        "product_us",
        "stiffness_error",
        "mass_error",
    ),
)

if __name__ == "__main__":
    main(study)
