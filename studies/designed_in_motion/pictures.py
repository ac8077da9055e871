"""Pictures of designs: densities in grey, solid meshes, and several machines in motion side by side."""

from functools import lru_cache

import numpy as np

import polyida as pi
from designed_in_motion import solids
from designed_in_motion.machines import MACHINES, VOLUME

APART, STEPS = 1.3, 100  # m, between the hinges of machines that are shown moving, and steps of their run


def draw_densities(axes, meshes, rho, apart=1.0):
    """Densities of meshes in a row, each `apart` from the one before, in grey, to scale, without ticks."""
    from matplotlib.collections import PolyCollection

    cells = [mesh.points[mesh.cell(i)] + [k * apart, 0.0] for k, mesh in enumerate(meshes) for i in range(mesh.n_cells)]
    look = {"cmap": "Greys", "clim": (0, 1), "edgecolors": "face", "linewidths": 0.2, "rasterized": True}
    axes.add_collection(PolyCollection(cells, array=np.asarray(rho, float), **look))
    _frame(axes, np.concatenate(cells))


def draw_meshes(axes, meshes, height, apart=1.0):
    """The polygons of meshes in a row, in a frame of a height, m."""
    from matplotlib.collections import PolyCollection

    cells = [mesh.points[mesh.cell(i)] + [k * apart, 0.0] for k, mesh in enumerate(meshes) for i in range(mesh.n_cells)]
    axes.add_collection(PolyCollection(cells, facecolors="#9fc3dd", edgecolors="#0072B2", linewidths=0.25, rasterized=True))
    _frame(axes, np.concatenate([*cells, [[0.0, -0.5 * height], [0.0, 0.5 * height]]]))


def _frame(axes, points):
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.01 * (high - low).max()
    axes.set(aspect="equal", xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin), xticks=[], yticks=[])
    axes.grid(False)
    for spine in axes.spines.values():
        spine.set_visible(False)


def meshes_of(row):
    """The meshes on which a row's design was made."""
    machine = MACHINES[row["machine"]]
    height = machine.height * (VOLUME if row["design"] == "bar" else 1.0)
    return [machine.mesh(row["cells"], height)] * len(machine.names)


def solids_of(row):
    """The meshes of a row's solid design."""
    return list(_solids(row["machine"], row["cells"], tuple(row["rho"]), row["at"])) if "rho" in row else meshes_of(row)


@lru_cache(maxsize=16)
def _solids(machine, cells, rho, at):
    return solids.solid_meshes([MACHINES[machine].mesh(cells)] * len(MACHINES[machine].names), rho, at)


def beside_each_other(rows):
    """A Trajectory of the solid designs of several rows of one machine, side by side."""
    machine, scene = MACHINES[rows[0]["machine"]], pi.Scene(MACHINES[rows[0]["machine"]].gravity)
    for k, row in enumerate(rows):
        machine.add_to(scene, solids_of(row), row["thickness"], f"{row['design']}: ", k * APART * len(machine.names))
    return pi.solve(scene.build(), machine.t_end, pi.GeneralizedAlpha(h=machine.t_end / STEPS))
