"""Discretisation errors of meshes and elements: elastica, CSM1, frequencies, a short cantilever, joints at a node and at a section, spin-
up.
"""

from functools import cache

from mesh_convergence import cases
from mesh_convergence.selection import MEMBERS, MOVING, POLYGONS, QUADRATIC, QUADS, SLENDER, tasks
from polyida.cli.study import main
from polyida.problems.literature import EXTENSION
from polyida.show.styles import INK, legend_above, marker_style
from polyida.study.plotting import line_picture, loglog, panels, study_figure, target_line
from polyida.study.rows import column, fit_slope, largest, last, pick, value
from polyida.study.tasks import Study

REFERENCES = {  # what a figure says of what errors are measured against: where that is slender, a plane body is some way from it
    "elastica": "plane body less elastica",
    "frequencies": "plane body less slender bar",
    "cantilever": "reference: quads, 16 and 32 through, extrapolated",
}
STEADY = 12.0  # s, before which the swing shortens the spin-up beam a hundred times more than the turning lengthens it


@cache
def fine_cantilever():
    return cases.fine_cantilever()


def run(case, kind, element, through, **options):
    if case == "spin-up":
        return cases.spin_up(options["nx"], through, options["h"])
    if case in MOVING:
        return cases.moving(case, element, options["cells"])
    if case == "cantilever":
        options = {"known": fine_cantilever()}
    return getattr(cases, case)(kind, element, through, **options)


def by_size(rows, **wanted):
    """Rows with these values that did not fail, from coarse to fine."""
    return sorted(pick(rows, **wanted), key=lambda row: row.get("dof", 0))


def finest(rows, **wanted):
    """The row of the finest mesh with these values, or None if it failed."""
    all_of = [row for row in rows if all(row.get(key) == entry for key, entry in wanted.items())]
    row = max(all_of, key=lambda row: (row["through"], row.get("nx", 0), -row.get("h", 0.0)), default=None)
    return None if row is None or row.get("error") else row


def of_member(member):
    return dict(zip(("kind", "element"), member))


def elastica(rows):
    result = {}
    for load in (1, 10):
        for member in MEMBERS:
            row = finest(rows, case="elastica", load=load, slenderness=50, **of_member(member))
            result[f"elastica_{load}_error_{'_'.join(member)}"] = value(row, "deviation")
        result[f"elastica_{load}_error"] = result[f"elastica_{load}_error_polygons_wachspress"]
        slender = finest(rows, case="elastica", load=load, slenderness=SLENDER, kind="quads")
        result[f"elastica_{load}_error_slender_quads_wachspress"] = value(slender, "deviation")
    return result


def csm1(rows):
    result = {}
    for clamp in ("arc", "straight"):
        quads = {"case": "csm1", "clamp": clamp} | of_member(QUADS[0])
        result[f"csm1_error_{clamp}"] = value(finest(rows, **quads), "deviation")
        fine, coarse = (last(rows, through=n, **quads) for n in (16, 8))
        if fine and coarse:
            result[f"csm1_extrapolated_error_{clamp}"] = cases.extrapolated(coarse["moved"], fine["moved"], clamp)
    polygons = finest(rows, case="csm1", clamp="arc", **of_member(POLYGONS[0]))
    return result | {"csm1_error": result["csm1_error_arc"], "csm1_error_arc_polygons": value(polygons, "deviation")}


def spin_up(rows):
    return {"spin_up_extension_error": value(finest(rows, case="spin-up"), "deviation")}


def joints(rows):
    result = {}
    for at in ("node", "section"):
        runs = column(by_size(rows, case="compliance", at=at), "compliance")
        result[f"compliance_growth_{at}"] = runs[-1] / runs[0] - 1 if len(runs) > 1 else float("nan")
    return result


def rates(rows):
    result = {}
    for member in MEMBERS + QUADRATIC:
        name, runs = "_".join(member), by_size(rows, case="cantilever", **of_member(member))
        result[f"cantilever_order_{name}"] = -2 * fit_slope(column(runs, "dof"), column(runs, "deviation"))
        if row := finest(rows, case="frequencies", **of_member(member)):
            result[f"bending_frequency_error_{name}"] = abs(row["bending_errors"][0])
            result[f"axial_frequency_error_{name}"] = max(map(abs, row["axial_errors"]))
    return result


AIMS = {"swing": 3e-6, "motor": 1e-3}  # errors of meshes: m of the tip, and of the deflection


def moving_runs(rows, case):
    """{element: (n, CPU time s, error, CPU time of a step over n)} against the finest quadratic mesh, which is left out."""
    known = by_size(rows, case=case, element="quadratic")
    if not known:
        return {}
    tip, result = cases.np.array(known[-1]["tip"]), {}
    angle = cases.profile.quintic(0.0, cases.np.pi / 4, duration=1.0)(0.6)
    rigid = cases.np.array([cases.np.cos(angle), cases.np.sin(angle)])
    scale = 1.0 if case == "swing" else float(cases.np.hypot(*(tip - rigid)))
    for element in MOVING[case]:
        runs = [row for row in by_size(rows, case=case, element=element) if row is not known[-1]]
        errors = [float(cases.np.hypot(*cases.np.subtract(row["tip"], tip))) / scale for row in runs]
        costs = [row["step_cpu_s"] / row["dof"] for row in runs]
        result[element] = [row["dof"] for row in runs], [row["cpu_s"] for row in runs], errors, costs
    return result


def cpu_at(seconds, errors, aim):
    """CPU time, s, to an error, by a straight line in logarithms; without a run that reaches it that of the finest run, a lower bound."""
    for i in range(1, len(errors)):
        if errors[i] <= aim < errors[i - 1]:
            share = cases.np.log(aim / errors[i - 1]) / cases.np.log(errors[i] / errors[i - 1])
            return float(seconds[i - 1] * (seconds[i] / seconds[i - 1]) ** share)
    return seconds[-1]


def motions(rows):
    """CPU times of linear over quadratic meshes at equal errors (at least, if no linear mesh reaches it), orders of errors, and CPU time of a step and coordinate."""
    result = {}
    for case, aim in AIMS.items():
        runs = moving_runs(rows, case)
        if not all(len(runs.get(element, ((),))[0]) > 1 for element in ("wachspress", "quadratic")):
            continue
        times = [cpu_at(*runs[element][1:3], aim) for element in ("wachspress", "quadratic")]
        result[f"{case}_cpu_ratio"] = times[0] / times[1]
        result[f"{case}_step_cost_ratio"] = runs["quadratic"][3][-1] / runs["wachspress"][3][-1]
        for element, (n, _, errors, _) in runs.items():
            result[f"{case}_order_{element}"] = -2 * fit_slope(n, errors)
    return result


@study_figure
def motion_figure(rows):
    """Errors of the tip in motion against n and CPU time, linear and quadratic cells."""
    fig, axes = panels(4, height=2.3)
    for row, (case, title) in enumerate({"swing": "double plate", "motor": "plate of 50:1 with a motor"}.items()):
        for i, (element, (n, seconds, errors, _)) in enumerate(moving_runs(rows, case).items()):
            for axis, x in zip(axes[2 * row : 2 * row + 2], (n, seconds)):
                loglog(axis, x, errors, i, element)
        for axis, label in zip(axes[2 * row : 2 * row + 2], ("degrees of freedom", "CPU time, s")):
            axis.set(title=title, xlabel=label, ylabel="error of the tip, m" if case == "swing" else "error over deflection")
            target_line(axis, AIMS[case], f"{AIMS[case]:g}")
    legend_above(fig, axes, 3)
    return line_picture(fig, "motion")


def aim_notes(rows):
    result = elastica(rows) | csm1(rows) | spin_up(rows)
    aims = {"elastica_1_error": 1e-3, "elastica_10_error": 1e-3, "csm1_error": 1e-3, "spin_up_extension_error": 1e-2}
    return [f"{name} = {result[name]:.2g} misses {aim:g}" for name, aim in aims.items() if result[name] > aim]


def csm1_notes(rows):
    """The mesh of csm1_error, and the errors of the finest other meshes."""
    lines = []
    for clamp in ("arc", "straight"):
        ends = [finest(rows, case="csm1", clamp=clamp, **of_member(member)) for member in MEMBERS]
        text = [
            f"{row['kind']}, {row['element']} {row['deviation']:.2%} ({row['through']} cells through the thickness, "
            f"{row['dof']} degrees of freedom)"
            for row in ends
            if row
        ]
        lines += [f"CSM1, {clamp} clamp, on the finest mesh of each: {'; '.join(text)}"] if text else []
    best = finest(rows, case="csm1", clamp="arc", **of_member(QUADS[0]))
    return lines + ([f"csm1_error is that of quads with {best['through']} through the thickness"] if best else [])


def elastica_notes(rows):
    """The part of the elastica's error that does not vanish with the mesh: shear moves the tip by 0.6 (h/L)^2 downwards and 1.0 (h/L)^2
    backwards, stretch and the second-order strain of the fibres by 0.2 (h/L)^2 backwards.
    """
    lines = []
    for load in (1, 10):
        for member in QUADS + POLYGONS:
            wanted = {"case": "elastica", "load": load} | of_member(member)
            stout, slender = (by_size(rows, slenderness=50, **wanted)[-2:], by_size(rows, slenderness=SLENDER, **wanted)[-2:])
            if stout and slender:
                text = [" and ".join(f"{row['deviation']:.1e}" for row in selected) for selected in (stout, slender)]
                lines.append(
                    f"elastica, PL^2/EI = {load}, {', '.join(member)}, finest meshes: {text[0]} at L/h = 50, "
                    f"{text[1]} at L/h = {SLENDER}; the reference has neither shear nor stretch, a plane body is "
                    f"1.2 (h/L)^2 off it under small loads: {1.2 / 50**2:.1e} and {1.2 / SLENDER**2:.1e}"
                )
    return lines


def joint_notes(rows):
    result = joints(rows)
    if not all(abs(growth) < float("inf") for growth in result.values()):
        return []
    return [
        f"compliance from the coarsest to the finest mesh: a joint at one node {result['compliance_growth_node']:+.1%}, "
        f"which does not converge, that of a section {result['compliance_growth_section']:+.1e}"
    ]


def locking_notes(rows):
    off = largest(
        [row for row in (finest(rows, case="elastica", load=load, slenderness=50, kind="triangles") for load in (1, 10)) if row],
        "deviation",
    )
    return [f"linear triangles on the finest elastica are up to {off:.1%} off: they lock in bending"] if off > 0.01 else []


def rate_notes(rows):
    """Elements whose error in the short cantilever does not decrease from mesh to mesh."""
    lines = []
    for member in MEMBERS:
        errors = column(by_size(rows, case="cantilever", **of_member(member)), "deviation")
        if (errors[1:] > errors[:-1]).any():
            text = ", ".join(f"{error:.1e}" for error in errors)
            lines.append(f"short cantilever, {', '.join(member)}: errors {text} do not fall steadily; the fitted order says nothing")
    return lines


def left_out(rows, **wanted):
    """Deviation of a case in the limit of fine quads by extrapolation of order 2; NaN if the two finest meshes are not sufficient."""
    runs = by_size(rows, **of_member(QUADS[0]), **wanted)[-2:]
    return (4 * runs[1]["deviation"] - runs[0]["deviation"]) / 3 if len(runs) > 1 else float("nan")


def band(axis, top):
    """Shade the values below `top`, where errors are not those of the mesh; returns `top` in words."""
    if not top > 0:
        return ""
    axis.set_ylim(bottom=min(axis.get_ylim()[0], top / 5))
    axis.axhspan(axis.get_ylim()[0], top, color="#dddddd", linewidth=0, zorder=0)
    return f": {top:.1e}"


@study_figure
def convergence_figure(rows):
    """Deviation from each reference against the number of coordinates. In the shaded range it is the error of the reference; the dashed
    line is the target.
    """
    cases = {
        "elastica, PL²/EI = 1, L/h = 50": {"case": "elastica", "load": 1, "slenderness": 50},
        "elastica, PL²/EI = 10, L/h = 50": {"case": "elastica", "load": 10, "slenderness": 50},
        "CSM1, arc clamp": {"case": "csm1", "clamp": "arc"},
        "CSM1, straight clamp": {"case": "csm1", "clamp": "straight"},
        "short cantilever, L/h = 10": {"case": "cantilever"},
        "frequencies, L/h = 50": {"case": "frequencies"},
    }
    fig, axes = panels(len(cases), height=2.3)
    for axis, (title, wanted) in zip(axes, cases.items()):
        for i, member in enumerate(MEMBERS + QUADRATIC):
            runs = by_size(rows, **of_member(member), **wanted)
            loglog(axis, column(runs, "dof"), column(runs, "deviation"), i, ", ".join(member))
            more = [row for row in runs if row.get("above")]
            axis.plot(column(more, "dof"), column(more, "deviation"), **marker_style(i) | {"linestyle": "", "markerfacecolor": "white"})
        axis.margins(y=0.2)
        target_line(axis, 1e-3, "0.1 %")
        axis.set(title=title, ylabel="relative error")
        if words := REFERENCES.get(wanted["case"]):
            text = words + (band(axis, left_out(rows, **wanted)) if wanted["case"] != "cantilever" else "")
            axis.annotate(text, (1, 0), (-3, 3), "axes fraction", "offset points", fontsize=7, color=INK, ha="right", va="bottom")
    axes[0].plot([], [], "ko", markerfacecolor="white", markersize=3.5, label="hollow: above the reference")
    for axis in axes[-2:]:
        axis.set_xlabel("degrees of freedom")
    legend_above(fig, axes, 3)
    return line_picture(fig, "mesh-convergence")


@study_figure
def joint_figure(rows):
    """Compliance of a joint at one node and at a whole section against the mesh."""
    fig, axes = panels(1, width=4.2, height=2.6)
    for i, at in enumerate(("node", "section")):
        runs = by_size(rows, case="compliance", at=at)
        axes[0].semilogx(column(runs, "dof"), column(runs, "compliance"), label=f"pulled at a {at}", **marker_style(i))
    axes[0].set(xlabel="degrees of freedom", ylabel="compliance over that of the bar")
    legend_above(fig, axes, 2)
    return line_picture(fig, "node-against-section")


@study_figure
def spin_up_figure(rows):
    """Extension and deflection of the spin-up beam's tip against time."""
    runs = by_size(rows, case="spin-up")
    fig, axes = panels(2 if runs else 0, height=2.8)
    steady = [(t, 1e3 * u) for t, u in zip(runs[-1]["t"], runs[-1]["u"]) if t > STEADY]
    axes[0].plot(runs[-1]["t"], runs[-1]["w"], color=marker_style(0)["color"], linewidth=1.0)
    axes[1].plot(*zip(*steady), color=marker_style(0)["color"], linewidth=1.0, label="tip")
    axes[1].axhline(1e3 * EXTENSION, color=marker_style(1)["color"], linewidth=1.0, linestyle=(0, (4, 2)), label="exact, steady turning")
    axes[0].set(ylabel="deflection of the tip, m", xlabel="t, s", title="spin-up beam, in the turning frame")
    axes[1].set(ylabel="extension, mm", xlabel="t, s", title=f"its extension from t = {STEADY:g} s")
    legend_above(fig, axes, 2)
    return line_picture(fig, "spin-up")


COLUMNS = (
    "case",
    "kind",
    "element",
    "through",
    "load",
    "slenderness",
    "clamp",
    "at",
    "nx",
    "h",
    "dof",
    "deviation",
    "compliance",
    "cpu_s",
    "error",
)
STUDY = Study(
    "mesh_convergence",
    "meshes and elements against reference solutions",
    tasks,
    run,
    (elastica, csm1, spin_up, joints, rates, motions),
    (convergence_figure, motion_figure, joint_figure, spin_up_figure),
    COLUMNS,
    notes=(aim_notes, csm1_notes, elastica_notes, joint_notes, locking_notes, rate_notes),
    headline=(
        "elastica_1_error",
        "elastica_10_error",
        "csm1_error",
        "spin_up_extension_error",
        "swing_cpu_ratio",
        "motor_cpu_ratio",
        "swing_step_cost_ratio",
    ),
)

if __name__ == "__main__":
    main(STUDY)
