"""Least weight of mechanisms within limits of motion, drives and stress: a slewing arm against static designs, and the rod of a slider crank."""

import numpy as np

from designed_in_motion.pictures import draw_densities, draw_meshes
from least_weight import arm, bracket, rod
from polyida.cli.study import main
from polyida.design import threshold
from polyida.show.styles import legend_above, marker_style
from polyida.study.plotting import line_picture, panels, picture, study_figure
from polyida.study.rows import last, pick, value
from polyida.study.tasks import Study

VOLUMES = (0.4, 0.425, 0.45, 0.475, 0.5, 0.525, 0.55, 0.575, 0.6, 0.625, 0.65, 0.675, 0.7)  # of static designs
DEVIATIONS = {400: (4e-5, 1.2e-5, 9.5e-6), 1600: (4e-5, 1.2e-5, 9.5e-6, 7.7e-6)}  # limits, m2: from slack to the least of static designs
STARTS = (("tip load and weight", 0.5), ("tip load and weight", 0.55), ("tip load and weight", 0.6))  # at the second limit
MEASURES = ("deviation", "torque", "stress")
RUNS = {"arm": arm.row, "rod": rod.row, "bracket": bracket.row}


def tasks(quick):
    """Designs in motion at several limits, one of them from three starts; static designs of both loads and several volumes; the rod and the bracket."""
    if quick:
        arms = [
            {"part": "arm", "cells": 400, "way": way, "effort": "short", "deviation": 1.2e-5} for way in ("in motion", "static", "static")
        ]
        arms[2]["volume"] = 0.6
        return [*arms, {"part": "rod", "cells": 30, "effort": "short"}, {"part": "bracket", "cells": 300, "effort": "short"}]
    result = []
    for cells, deviations in DEVIATIONS.items():
        arm_of = {"part": "arm", "cells": cells, "effort": "full"}
        result += [arm_of | {"way": "in motion", "deviation": one} for one in deviations]
        if cells == 400:
            result += [arm_of | {"way": "in motion", "deviation": deviations[1], "load": load, "volume": v} for load, v in STARTS[1:]]
        result += [
            arm_of | {"way": "static", "deviation": deviations[-1], "load": load, "volume": v} for load in arm.LOADS for v in VOLUMES
        ]
    return [*result, {"part": "rod", "cells": 60, "effort": "full"}, {"part": "bracket", "cells": 1500, "effort": "full"}]


def run(part, **task):
    """One row."""
    return RUNS[part](**task)


def best_static(rows, cells, deviation):
    """The row of the lightest static design that keeps the limits within 3 % as a solid design; None if there is none."""
    upper = {"deviation": deviation, "torque": arm.TORQUE, "stress": arm.STRESS}
    still = pick(rows, part="arm", way="static", cells=cells)
    kept = [row for row in still if all(row[f"{name}_solid"] <= 1.03 * most for name, most in upper.items())]
    return min(kept, key=lambda row: row["mass_solid"], default=None)


def figures(rows):
    """Masses of the arm in motion over the best static design at each limit, spread of starts, excess of limits, seconds; the rod; the bracket.

    arm_over_static: of the finest mesh, at the least limit that a static design keeps.
    """
    result = {}
    for cells in sorted({row["cells"] for row in pick(rows, part="arm")}):
        moving = pick(rows, part="arm", way="in motion", cells=cells)
        for deviation in sorted({row["deviation"] for row in moving}, reverse=True):
            there = [row for row in moving if row["deviation"] == deviation]
            name, still = f"{cells}_{deviation:g}", best_static(rows, cells, deviation)
            result[f"arm_mass_{name}"] = there[0]["mass_solid"]
            if still:
                result["arm_over_static"] = result[f"arm_over_static_{name}"] = there[0]["mass_solid"] / still["mass_solid"]
            if len(there) > 1:
                masses = [row["mass_solid"] for row in there]
                result[f"arm_spread_{name}"] = max(masses) / min(masses) - 1.0
        if moving:
            result[f"arm_excess_{cells}"] = max(row["excess"] for row in moving)
            result[f"arm_wall_s_{cells}"] = max(row["wall_s"] for row in moving)
    slider, angle = last(rows, part="rod"), last(rows, part="bracket")
    result |= {"bracket_share": value(angle, "share"), "bracket_excess": value(angle, "excess")}
    return result | {"rod_over_thickness": value(slider, "mass_heights") / value(slider, "mass_thickness")}


def notes(rows):
    """Each design with its limits, by the optimiser and solid."""
    lines = []
    for row in pick(rows, part="arm"):
        kept = ", ".join(
            f"{name} {row[f'{name}_optimiser']:.3g} / {row[f'{name}_solid']:.3g} <= {row[f'{name}_upper']:.3g}" for name in MEASURES
        )
        lines.append(
            f"arm, {row['cells']} polygons, {row['way']} from {row.get('load', 'tip load and weight')} at {row.get('volume', 0.5):g}: mass "
            f"{row['mass_optimiser']:.4g} / {row['mass_solid']:.4g} kg (densities / solid from {row['at']:g}); {kept}; {row['message']}"
        )
        again = {
            name[5:]: row[name] for name in row if name.startswith("mass_") and name not in ("mass_optimiser", "mass_solid", "mass_upper")
        }
        for name in again:
            lines.append(f"  solid, {name}: " + ", ".join(f"{measure} {row[f'{measure}_{name}']:.4g}" for measure in MEASURES))
    for row in pick(rows, part="rod"):
        for way in ("thickness", "heights"):
            sizes = ", ".join(f"{name} {number:.4g}" for name, number in row[f"sizes_{way}"].items())
            kept = ", ".join(f"{name} {number:.4g}" for name, number in row[f"limits_{way}"].items())
            lines.append(f"rod by {way}: {row[f'mass_{way}']:.4g} kg with {sizes}; {kept}; {row[f'message_{way}']}")
    for row in pick(rows, part="bracket"):
        lines.append(
            f"bracket, {row['cells']} polygons: {100 * row['share']:.3g} % of the mass; largest stress {row['stress_solid']:.4g} Pa, limit "
            f"{row['stress_upper']:.4g}, of the whole bracket {row['start_stress']:.4g}; {row['message']}"
        )
    return lines


def _solid(row, mesh):
    """The mesh of a row's solid design."""
    return threshold(mesh, np.isin(np.arange(mesh.n_cells), row["solid"]).astype(float))


@study_figure
def designs_figure(rows):
    """Left: densities of the designs of the arm; right: what is solid. In motion and, for each mesh, the best static design."""
    shown = pick(rows, part="arm", way="in motion")
    pairs = sorted({(row["cells"], row["deviation"]) for row in shown})
    shown += [row for pair in pairs if (row := best_static(rows, *pair))]
    fig, axes = panels(2 * len(shown), width=8.0, height=1.3, columns=2)
    for row, (left, right) in zip(shown, np.reshape(axes, (-1, 2))):
        draw_densities(left, [arm.ARM.mesh(row["cells"])], row["rho"])
        draw_meshes(right, [_solid(row, arm.ARM.mesh(row["cells"]))], arm.ARM.height)
        left.set_title(f"{row['cells']} polygons, {row['way']}", loc="left")
        right.set_title(f"{row['mass_solid']:.3f} kg, deviation {row['deviation_solid']:.3g} m2", loc="left")
    return picture(fig, "least-weight-designs")


@study_figure
def mass_figure(rows):
    """Deviation against mass of solid designs: static ones by load, and those in motion. Static designs have a least deviation: their inertia grows too."""
    meshes = sorted({row["cells"] for row in pick(rows, part="arm")})
    fig, axes = panels(len(meshes), width=8.0, height=2.8)
    for ax, cells in zip(axes, meshes):
        of_mesh = pick(rows, part="arm", cells=cells)
        kinds = {load: [r for r in of_mesh if r["way"] == "static" and r.get("load", "tip load and weight") == load] for load in arm.LOADS}
        for i, (name, shown) in enumerate((kinds | {"in motion": [r for r in of_mesh if r["way"] == "in motion"]}).items()):
            ax.semilogy(
                *([row[f"{what}_solid"] for row in shown] for what in ("mass", "deviation")),
                label=name,
                **marker_style(i) | {"linestyle": ""},
            )
        ax.set(xlabel=f"mass, {cells} polygons, kg", ylabel="deviation, m2")
    legend_above(fig, axes, 3)
    return picture(fig, "least-weight-mass")


@study_figure
def bracket_figure(rows):
    """The L-bracket: densities (left), what is solid (right)."""
    shown = pick(rows, part="bracket")
    fig, axes = panels(2 * len(shown), width=6.0, height=2.8, columns=2)
    for row, (left, right) in zip(shown, np.reshape(axes, (-1, 2))):
        mesh = bracket.mesh_of(row["cells"])
        draw_densities(left, [mesh], row["rho"])
        draw_meshes(right, [_solid(row, mesh)], 0.0)
        right.set_title(f"{100 * row['share']:.3g} % of the mass", loc="left")
    return picture(fig, "least-weight-bracket")


@study_figure
def history_figure(rows):
    """Mass against evaluations: the arm in motion (left), the rod (right)."""
    arms, rods = pick(rows, part="arm", way="in motion"), pick(rows, part="rod")
    fig, axes = panels(2 if arms or rods else 0, width=8.0, height=2.8)
    for i, row in enumerate(arms):
        label = f"{row['cells']} polygons, {row['deviation']:g} m2, from {row.get('volume', 0.5):g}"
        axes[0].plot(row["history"], label=label, **marker_style(i) | {"marker": ""})
    for row in rods:
        for i, way in enumerate(("thickness", "heights")):
            axes[1].plot(1e3 * np.array(row[f"history_{way}"]), label=f"rod by {way}", **marker_style(i) | {"marker": ""})
    axes[0].set(xlabel="evaluation", ylabel="mass of the arm, kg")
    axes[1].set(xlabel="evaluation", ylabel="mass of the rod, g")
    legend_above(fig, axes, 2)
    return line_picture(fig, "least-weight-history")


STUDY = Study(
    "least_weight",
    "least mass at limited tracking error, torque, stress and reaction: designed in motion against static designs",
    tasks,
    run,
    figures,
    (designs_figure, mass_figure, bracket_figure, history_figure),
    (
        "part",
        "cells",
        "way",
        "load",
        "volume",
        "deviation",
        "mass_optimiser",
        "mass_solid",
        "excess",
        "at",
        "grey",
        "evaluations",
        "wall_s",
        "cpu_s",
        "error",
    ),
    notes=notes,
    headline=("arm_over_static", "rod_over_thickness"),
)

if __name__ == "__main__":
    main(STUDY)
