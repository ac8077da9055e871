"""Cells that cannot bend, or bend too easily: estimates from the mesh alone, before a run.

A thin plate of area A and circumference P (with its holes) has the height H = 2 A / P and the length P / 2. Its cells have the length l along it, the mean
of the boundary's edges weighted by their lengths. The bending stiffness, over the true one, of

    Wachspress cells               1 + (l / H)^2 / 4; plus 2 for one layer of triangles; less 1/4 for one of quadrilaterals, whose
                                   four points see 3/4 of their bending
    one layer of virtual cells     3 tau (5 - nu) / (2 (1 - nu^2)) l / H, all from the stabilisation
    quadratic cells                1 / (1 + 7 (s / H)^2), s the largest rise of a curved side over its chord

The first agrees within 10 % with cantilevers of 5 to 20 polygons at 10:1, of 5 to 12 polygons at 50:1 and of quadrilaterals, the second within 0.1,
the third within 3 % with frequencies of thin rings of one layer of 32 and 48 cells; of fewer, the stiffness is less than it says.
"""

import numpy as np

from polyida.element.elements import plane_trace
from polyida.mesh.topology import following

SLENDER = 8.0  # length over height of a plate that mostly bends
STIFF, SOFT = 1.5, 0.76  # stiffness over the true one beyond which a plate is said to be wrong


def bending_stiffness(plate):
    """Estimated bending stiffness of a plate over the true one; 1 if the plate is not thin."""
    mesh = plate.mesh
    ends = mesh.points[mesh.boundary_edges]
    lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    height, along = 2.0 * mesh.area / lengths.sum(), (lengths**2).sum() / lengths.sum()
    if lengths.sum() / 2.0 < SLENDER * height:
        return 1.0
    if plate.order == 2:
        return 1.0 / (1.0 + 7.0 * (_largest_rise(mesh) / height) ** 2)
    one_layer, corners = len(mesh.boundary_nodes) == mesh.n_nodes, np.diff(mesh.offsets)
    if plate.element == "wachspress":
        layer = {3: 2.0, 4: -0.25}.get(int(corners.max()), 0.0) if one_layer and np.ptp(corners) == 0 else 0.0
        return 1.0 + (along / height) ** 2 / 4.0 + layer
    nu = plate.material.nu
    return 3.0 * plate.tau * plane_trace(1.0, nu) / (1.0 - nu**2) * along / height if one_layer and corners.min() > 3 else 1.0


def _largest_rise(mesh):
    """The largest distance, m, of a middle node from the middle of its chord."""
    corner, middle, end = mesh.nodes[::2], mesh.nodes[1::2], mesh.nodes[following(mesh.offsets)][1::2]
    return np.linalg.norm(mesh.points[middle] - (mesh.points[corner] + mesh.points[end]) / 2.0, axis=1).max()
