"""What the mesh and the element cost: elastica, CSM1, frequencies, a short cantilever, joints at a node and at a
section, spin-up.
"""

from functools import cache

from polyida.cli_study import main
from polyida.problems.spin_up_beam import EXTENSION
from polyida.study import mesh_cases
from polyida.study.drawing import drawn, fitted, legend, loglog, look, panels, saved
from polyida.study.harness import Study

MEMBERS = (
    ("polygons", "wachspress"),
    ("quads", "wachspress"),
    ("triangles", "wachspress"),
    ("polygons", "virtual"),
    ("quads", "virtual"),
)


QUICK = {
    "elastica": (2, 4, 8),
    "cantilever": (2, 4, 8),
    "csm1": (2, 4, 8),
    "csm1 fine": (16, 40),
    "frequencies": (2, 4),
    "compliance": (2, 4, 8),
    "spin-up": ((130, 1, 1e-2), (130, 2, 5e-3)),
}
FULL = {
    "elastica": (2, 3, 4, 6, 8, 12),
    "cantilever": (2, 3, 5, 10, 20),
    "csm1": (2, 4, 8, 16),
    "csm1 fine": (24, 40),
    "frequencies": (2, 3, 4, 6, 8),
    "compliance": (2, 4, 8, 16, 32),
    "spin-up": ((65, 1, 1e-2), (130, 1, 1e-2), (130, 2, 5e-3), (260, 2, 5e-3), (260, 2, 2e-3)),
}


def tasks(quick):
    sizes = QUICK if quick else FULL
    loads = [{"load": load} for load in (1, 10)]
    clamps = [{"clamp": clamp} for clamp in ("arc", "straight")]
    made = grid("elastica", MEMBERS, sizes["elastica"], loads) + grid("csm1", MEMBERS, sizes["csm1"], clamps)
    made += grid("csm1", MEMBERS[1:2], sizes["csm1 fine"][:1], clamps)
    made += grid("csm1", MEMBERS[1:2], sizes["csm1 fine"][1:], clamps[:1] if quick else clamps)
    made += grid("cantilever", MEMBERS, sizes["cantilever"]) + grid("frequencies", MEMBERS, sizes["frequencies"])
    made += grid("compliance", MEMBERS[:1], sizes["compliance"], [{"at": at} for at in ("node", "section")])
    return made + [grid("spin-up", MEMBERS[1:2], (ny,), [{"nx": nx, "h": h}])[0] for nx, ny, h in sizes["spin-up"]]


def grid(case, members, sizes, options=({},)):
    """All combinations as tasks."""
    return [
        {"case": case, "kind": kind, "element": element, "through": n} | option
        for option in options
        for kind, element in members
        for n in sizes
    ]


@cache
def fine_cantilever():
    return mesh_cases.fine_cantilever()


def run(case, kind, element, through, **options):
    if case == "spin-up":
        return mesh_cases.spin_up(options["nx"], through, options["h"])
    if case == "cantilever":
        options = {"known": fine_cantilever()}
    return getattr(mesh_cases, case)(kind, element, through, **options)


def pick(rows, **wanted):
    kept = [
        row for row in rows if not row.get("error") and "dof" in row and all(row.get(k) == v for k, v in wanted.items())
    ]
    return sorted(kept, key=lambda row: row["dof"])


def figures(rows):
    found = {}
    for load in (1, 10):
        for kind, element in MEMBERS:
            found[f"elastica_{load}_error_{kind}_{element}"] = pick(
                rows, case="elastica", load=load, kind=kind, element=element
            )[-1]["deviation"]
        found[f"elastica_{load}_error"] = found[f"elastica_{load}_error_polygons_wachspress"]
    for clamp in ("arc", "straight"):
        runs = pick(rows, case="csm1", clamp=clamp, kind="quads", element="wachspress")
        found[f"csm1_error_{clamp}"] = runs[-1]["deviation"]
        fine, coarse = (next(row for row in runs if row["through"] == n) for n in (16, 8))
        found[f"csm1_extrapolated_error_{clamp}"] = mesh_cases.extrapolated(coarse["moved"], fine["moved"], clamp)
    found["csm1_error"] = found["csm1_error_arc"]
    found["spin_up_extension_error"] = pick(rows, case="spin-up")[-1]["deviation"]
    for at in ("node", "section"):
        runs = pick(rows, case="compliance", at=at)
        found[f"compliance_growth_{at}"] = runs[-1]["compliance"] / runs[0]["compliance"] - 1
    for kind, element in MEMBERS:
        runs = pick(rows, case="cantilever", kind=kind, element=element)
        found[f"cantilever_order_{kind}_{element}"] = -2 * fitted(
            [row["dof"] for row in runs], [row["deviation"] for row in runs]
        )
        last = pick(rows, case="frequencies", kind=kind, element=element)[-1]
        found[f"bending_frequency_error_{kind}_{element}"], found[f"axial_frequency_error_{kind}_{element}"] = (
            abs(last["bending_errors"][0]),
            max(map(abs, last["axial_errors"])),
        )
    return found


def notes(rows):
    found = figures(rows)
    aims = {"elastica_1_error": 1e-3, "elastica_10_error": 1e-3, "csm1_error": 1e-3, "spin_up_extension_error": 1e-2}
    lines = [f"{name} = {found[name]:.2g} misses {aim:g}" for name, aim in aims.items() if found[name] > aim]
    lines.append(
        f"a joint at one node does not converge: its compliance grows by {found['compliance_growth_node']:.1%} to the "
        f"finest mesh, that of a section by {found['compliance_growth_section']:.1e}"
    )
    triangles = max(found["elastica_1_error_triangles_wachspress"], found["elastica_10_error_triangles_wachspress"])
    lines.append(f"linear triangles lock in bending: {triangles:.1%} off on the finest elastica")
    lines.append(
        "elastica: the reference has neither shear nor stretch; at L/h = 50 shear alone adds 1.2 (h/L)^2 = 5e-4 to u"
    )
    return lines


@drawn
def draw(rows, folder):
    return convergence_figure(rows, folder) + joint_figure(rows, folder) + spin_up_figure(rows, folder)


def convergence_figure(rows, folder):
    cases = {
        "elastica, PL²/EI = 1": {"case": "elastica", "load": 1},
        "elastica, PL²/EI = 10": {"case": "elastica", "load": 10},
        "CSM1, arc clamp": {"case": "csm1", "clamp": "arc"},
        "CSM1, straight clamp": {"case": "csm1", "clamp": "straight"},
        "short cantilever, L/H = 10": {"case": "cantilever"},
        "frequencies, L/H = 50": {"case": "frequencies"},
    }
    made, axes = panels(len(cases), height=2.3)
    for axis, (title, wanted) in zip(axes, cases.items()):
        for i, (kind, element) in enumerate(MEMBERS):
            runs = pick(rows, kind=kind, element=element, **wanted)
            loglog(axis, [row["dof"] for row in runs], [row["deviation"] for row in runs], i, f"{kind}, {element}")
        axis.axhline(1e-3, color="#999999", linewidth=0.6, zorder=0)
        axis.set(title=title, ylabel="relative error")
    for axis in axes[-2:]:
        axis.set_xlabel("degrees of freedom")
    legend(made, axes, 3)
    return saved(made, folder, "mesh-convergence")


def joint_figure(rows, folder):
    made, axes = panels(1, width=4.2, height=2.6)
    for i, at in enumerate(("node", "section")):
        runs = pick(rows, case="compliance", at=at)
        axes[0].semilogx(
            [row["dof"] for row in runs], [row["compliance"] for row in runs], label=f"pulled at a {at}", **look(i)
        )
    axes[0].set(xlabel="degrees of freedom", ylabel="compliance over that of the bar")
    legend(made, axes, 2)
    return saved(made, folder, "node-against-section")


def spin_up_figure(rows, folder):
    made, axes = panels(2, height=2.6)
    row = pick(rows, case="spin-up")[-1]
    axes[0].plot(row["t"], row["w"], **look(0) | {"marker": ""})
    axes[1].plot(row["t"], [1e3 * u for u in row["u"]], **look(0) | {"marker": ""})
    axes[1].axhline(1e3 * EXTENSION, color="#D55E00", linewidth=0.9, linestyle=(0, (4, 2)))
    axes[1].set(ylabel="extension, mm", xlabel="t, s", ylim=(-2, 1.5), title="steady turning: dashed, exact")
    axes[0].set(ylabel="deflection, m", xlabel="t, s", title="spin-up beam, tip in the turning frame")
    return saved(made, folder, "spin-up")


COLUMNS = (
    "case",
    "kind",
    "element",
    "through",
    "load",
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
    "mesh_convergence", "meshes and elements against known answers", tasks, run, figures, draw, COLUMNS, notes=notes
)

if __name__ == "__main__":
    main(STUDY)
