"""The MBB half beam by optimality criteria on squares and on polygons: compliance of each element, compared with the published value."""

from designed_in_motion.pictures import draw_densities
from mbb_beam import beam, criteria
from polyida.cli.study import main
from polyida.show.styles import legend_above
from polyida.study.plotting import line_picture, panels, picture, study_figure
from polyida.study.rows import NAN, distinct, number, pick
from polyida.study.tasks import Study

PUBLISHED = 233.71  # 60 x 20 squares, volume 0.5, SIMP 3, radius 2.4: Andreassen et al. 2011
SHOWN = 10  # the first iteration in the picture of the history
ELEMENTS = ("bilinear", "wachspress", "virtual")
CASES = (("squares", "bilinear"), ("squares", "wachspress"), ("squares", "virtual"), ("polygons", "wachspress"), ("polygons", "virtual"))


def tasks(quick):
    return [{"mesh": mesh, "element": element, "iterations": 300} for mesh, element in (CASES[1:4:2] if quick else CASES)]


def run(mesh, element, iterations):
    """One design: densities, history, and its compliance with each element that the mesh supports."""
    polygons = beam.mesh_of(mesh)
    rho, history = criteria.optimised(polygons, beam.compliance_of(polygons, element), iterations)
    others = ELEMENTS if mesh == "squares" else ELEMENTS[1:]
    result = {other: criteria.compliance_at(beam.compliance_of(polygons, other), rho)[0] for other in others}
    grey = float(4.0 * (rho * (1.0 - rho)).mean())
    return {
        "compliance": result[element],
        "used": len(history),
        "settled": len(history) < iterations,
        "grey": grey,
        "by_element": result,
        "history": history,
        "rho": rho.tolist(),
    }


def compliances(rows):
    """Compliance of squares and polygons, and the relative difference of the first from the published value."""
    result = number(rows, "compliance", mesh="squares", element="wachspress")
    return {
        "mbb_compliance": result,
        "mbb_difference": result / PUBLISHED - 1.0,
        "mbb_compliance_polygons": number(rows, "compliance", mesh="polygons", element="wachspress"),
    }


def share(rows):
    """Effect of the element alone on the compliance of the published design: this package's squares relative to bilinear ones."""
    (row,) = pick(rows, mesh="squares", element="bilinear") or [{"by_element": {}}]
    result = row["by_element"]
    return {f"mbb_{element}_share": result.get(element, NAN) / result.get("bilinear", NAN) - 1.0 for element in ELEMENTS[1:]}


def notes(rows):
    """Compliance of each design with every element; why the elements differ."""
    lines = []
    for row in pick(rows):
        values = ", ".join(f"{element} {value:.2f}" for element, value in row["by_element"].items())
        ended = "settled" if row["settled"] else "stopped, not settled,"
        lines.append(f"{row['mesh']}, optimised with {row['element']}: {ended} after {row['used']} iterations; compliance by {values}")
    return [
        *lines,
        f"published: {PUBLISHED}, with bilinear squares of two by two Gauss points. A Wachspress square has the same functions, taken in the "
        "centroids of the four triangles from its middle to its sides: two thirds of the stiffness in the two bending modes, the same in all others. "
        "That is the whole of the element's share",
    ]


@study_figure
def designs_figure(rows):
    """The designs: black is solid; the left edge is the symmetry plane of the beam, where the load acts."""
    result = pick(rows)
    fig, axes = panels(len(result), width=7.2, height=1.5)
    for axis, row in zip(axes, result):
        draw_densities(axis, [beam.mesh_of(row["mesh"])], row["rho"])
        axis.set_title(f"{row['mesh']}, {row['element']}: {row['compliance']:.2f}")
    return picture(fig, "mbb_designs")


@study_figure
def history_figure(rows):
    """Compliance over the iterations; the dashed line is the published value."""
    fig, (axis,) = panels(1, width=5.6)
    for name in distinct(rows, "mesh"):
        for row in pick(rows, mesh=name):
            dash = "-" if name == "squares" else "--"
            axis.semilogx(range(SHOWN, row["used"] + 1), row["history"][SHOWN - 1 :], dash, label=f"{name}, {row['element']}")
    axis.axhline(PUBLISHED, color="#777777", linewidth=0.8, linestyle=(0, (5, 3)))
    axis.set(xlabel="iteration", ylabel="compliance, J")
    legend_above(fig, axis, 3)
    return line_picture(fig, "mbb_history")


STUDY = Study(
    "mbb_beam",
    "half of the MBB beam, minimum compliance by optimality criteria",
    tasks,
    run,
    (compliances, share),
    (designs_figure, history_figure),
    ("mesh", "element", "iterations", "compliance", "used", "grey", "error"),
    notes=notes,
    headline=("mbb_compliance", "mbb_difference"),
)

if __name__ == "__main__":
    main(STUDY)
