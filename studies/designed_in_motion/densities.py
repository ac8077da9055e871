"""From the design variables to a model: filter, projection, stiffness and mass factors; and the slopes of all of them."""

import numpy as np
from scipy.sparse import block_diag

import polyida as pi
from designed_in_motion.machines import KEPT

VOID = 1e-3  # factor of what has no density


class Densities:
    """Densities of all plates of a machine, plate by plate: `rho = projection(filter @ x)`, and 1 in the cells along fixed sections.

    share (cells,): part of each cell in the total area. free (cells,): True if the cell's density is a design variable.
    """

    def __init__(self, names, meshes, radius):
        self.blur = block_diag([pi.mesh.density_filter(mesh, radius) for mesh in meshes], format="csr")
        areas = np.concatenate([mesh.cell_areas for mesh in meshes])
        self.share = areas / areas.sum()
        ends = np.cumsum([0, *(mesh.n_cells for mesh in meshes)])
        self.free = np.concatenate([~along(mesh, KEPT) for mesh in meshes])
        self.parts = {name: slice(*pair) for name, pair in zip(names, zip(ends, ends[1:]))}

    def of(self, x, beta):
        """(rho, its slope in the filtered variables). beta: of the projection, None for none."""
        blurred = self.blur @ x
        rho, rate = (blurred, 1.0) if beta is None else pi.design.project(blurred, beta)
        return np.where(self.free, rho, 1.0), np.where(self.free, rate, 0.0)

    def evaluated(self, model, judge, rho, q):
        """(value, slopes in rho) of judge(model with these densities), what `pi.gradient` gives; q: of RAMP."""
        (stiffness, hardening), (mass, growing) = pi.design.ramp(rho, q, VOID), pi.design.mass(rho, void=VOID)
        result = judge(model.with_factors(**{name: (stiffness[part], mass[part]) for name, part in self.parts.items()}))
        by_stiffness, by_mass = (np.concatenate([result[f"{name}.{what}"] for name in self.parts]) for what in ("stiffness", "mass"))
        return result.value, by_stiffness * hardening + by_mass * growing


def along(mesh, sections):
    """Mask of the cells with an edge on one of these sections."""
    cells = np.repeat(np.arange(mesh.n_cells), np.diff(mesh.offsets))
    on = [np.bincount(cells, np.isin(mesh.nodes, mesh.sections[name]), mesh.n_cells) for name in sections]
    return (np.array(on) > 1).any(axis=0)
