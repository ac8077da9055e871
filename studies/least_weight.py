"""Least weight of mechanisms within limits of motion, drives and stress: a slewing arm against static designs, and the rod of a slider crank."""

import numpy as np

from designed_in_motion.pictures import draw_densities, draw_meshes
from least_weight import arm, bracket, rod
from polyida.cli.study import main
from polyida.design import threshold
from polyida.show.style import legend_above, marker_style
from polyida.study.plotting import line_picture, panels, picture, study_figure
from polyida.study.rows import last, pick, value
from polyida.study.tasks import Study

STARTS = (("tip load and weight", 0.5), ("tip load and weight", 0.6), ("tip load", 0.6))
MEASURES = ("deviation", "torque", "stress")
RUNS = {"arm": arm.row, "rod": rod.row, "bracket": bracket.row}


def tasks(quick):
    """Designs in motion from three starts, the lightest static designs, the rod and the bracket."""
    if quick:
        task = {"part": "arm", "cells": 400, "way": "in motion", "effort": "short"}
        still = {"part": "arm", "cells": 400, "way": "static", "effort": "short", "load": "tip load and weight"}
        return [task, still, {"part": "rod", "cells": 30, "effort": "short"}, {"part": "bracket", "cells": 300, "effort": "short"}]
    result = []
    for cells in (400, 1600):
        starts = STARTS if cells == 400 else STARTS[:1]
        result += [
            {"part": "arm", "cells": cells, "way": "in motion", "effort": "full", "load": load, "volume": volume} for load, volume in starts
        ]
        result += [{"part": "arm", "cells": cells, "way": "static", "effort": "full", "load": load} for load in arm.LOADS]
    return [*result, {"part": "rod", "cells": 60, "effort": "full"}, {"part": "bracket", "cells": 1500, "effort": "full"}]


def run(part, **task):
    """One row."""
    return RUNS[part](**task)


def best_static(rows, cells):
    """The row of the lightest static design that keeps the limits within 3 % as a solid design; None if there is none."""
    kept = [row for row in pick(rows, part="arm", way="static", cells=cells) if row["excess"] <= 0.03]
    return min(kept, key=lambda row: row["mass_solid"], default=None)


def figures(rows):
    """Masses of the arm in motion over the best static design, spread of starts, excess of limits, seconds; the rod by shape over thickness."""
    result = {}
    for cells in sorted({row["cells"] for row in pick(rows, part="arm")}):
        moving, still = pick(rows, part="arm", way="in motion", cells=cells), best_static(rows, cells)
        if not moving:
            continue
        result[f"arm_mass_{cells}"] = moving[0]["mass_solid"]
        result[f"arm_excess_{cells}"] = max(row["excess"] for row in moving)
        result[f"arm_wall_s_{cells}"] = moving[0]["wall_s"]
        if still:
            result[f"arm_over_static_{cells}"] = moving[0]["mass_solid"] / still["mass_solid"]
            result.setdefault("arm_over_static", result[f"arm_over_static_{cells}"])
        if len(moving) > 1:
            masses = [row["mass_solid"] for row in moving]
            result[f"arm_spread_{cells}"] = max(masses) / min(masses) - 1.0
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
            f"arm, {row['cells']} polygons, {row['way']} from {row.get('load', 'tip load and weight')} at {row['volume_found']:g}: mass "
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
    shown += [row for cells in sorted({row["cells"] for row in shown}) if (row := best_static(rows, cells))]
    fig, axes = panels(2 * len(shown), width=8.0, height=1.3, columns=2)
    for row, (left, right) in zip(shown, np.reshape(axes, (-1, 2))):
        draw_densities(left, [arm.ARM.mesh(row["cells"])], row["rho"])
        draw_meshes(right, [_solid(row, arm.ARM.mesh(row["cells"]))], arm.ARM.height)
        left.set_title(f"{row['cells']} polygons, {row['way']}", loc="left")
        right.set_title(f"{row['mass_solid']:.3f} kg, limits exceeded by {100 * max(row['excess'], 0.0):.2g} %", loc="left")
    return picture(fig, "least-weight-designs")


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
        label = f"{row['cells']} polygons, {row.get('load', 'tip load and weight')} at {row.get('volume', 0.5):g}"
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
    (designs_figure, bracket_figure, history_figure),
    (
        "part",
        "cells",
        "way",
        "load",
        "volume",
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
