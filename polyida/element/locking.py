"""Cells that cannot bend, or bend too easily: estimates from the mesh alone, before a run.

A thin plate of area A and circumference P (with its holes) has the height H = 2 A / P and the length P / 2. Its cells have the length l along it, the mean
of the boundary's edges weighted by their lengths. The bending stiffness, over the true one, of

    Wachspress cells               1 + (l / H)^2 / 4; plus 2 for one layer of triangles; less 1/4 for one of quadrilaterals, whose
                                   four points see 3/4 of their bending
    one layer of virtual cells     3 tau (5 - nu) / (2 (1 - nu^2)) l / H, all from the stabilisation
    quadratic cells                1 / (1 + 0.55 b^6), b the largest angle by which a side turns, rad

The first agrees within 10 % with cantilevers of 5 to 20 polygons at 10:1, of 5 to 12 polygons at 50:1 and of quadrilaterals, the second within 0.1,
the third within 0.15 with thin rings of one layer of 6 to 48 cells.
"""

import numpy as np

from polyida.element.elements import plane_trace
from polyida.mesh.topology import following

SLENDER = 8.0  # length over height of a plate that mostly bends
STIFF, SOFT = 1.3, 0.76  # stiffness over the true one beyond which a plate is said to be wrong


def bending_stiffness(plate):
    """Estimated bending stiffness of a plate over the true one; 1 if the plate is not thin."""
    mesh = plate.mesh
    ends = mesh.points[mesh.boundary_edges]
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    height, along = 2.0 * mesh.area / lengths.sum(), (lengths**2).sum() / lengths.sum()
    if lengths.sum() / 2.0 < SLENDER * height:
        return 1.0
    if plate.order == 2:
        return 1.0 / (1.0 + 0.55 * _largest_turn(mesh) ** 6)
    one_layer, corners = len(mesh.boundary_nodes) == mesh.n_nodes, np.diff(mesh.offsets)
    if plate.element == "wachspress":
        layer = {3: 2.0, 4: -0.25}.get(int(corners.max()), 0.0) if one_layer and np.ptp(corners) == 0 else 0.0
        return 1.0 + (along / height) ** 2 / 4.0 + layer
    nu = plate.material.nu
    return 3.0 * plate.tau * plane_trace(1.0, nu) / (1.0 - nu**2) * along / height if one_layer and corners.min() > 3 else 1.0


def _largest_turn(mesh):
    """The largest angle, rad, by which a side turns: a parabola of rise s over its chord c turns by about 4 atan(2 s / c)."""
    corner, middle, end = (mesh.points[nodes] for nodes in (mesh.nodes[::2], mesh.nodes[1::2], mesh.nodes[following(mesh.offsets)][1::2]))
    rise = np.linalg.norm(middle - (corner + end) / 2.0, axis=1)
    return 4.0 * np.arctan(2.0 * rise / np.linalg.norm(end - corner, axis=1)).max()
