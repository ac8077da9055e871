"""Wachspress elements on strictly convex polygons: a point per fan triangle, gradients that pass the patch test.

With outward unit normals n_i of the edges and distances h_i(x) to them (Floater, Gillette, Sukumar 2014):

    p_i = n_i / h_i,  w_i = det(p_{i-1}, p_i),  R_i = p_{i-1} + p_i
    N_i = w_i / sum w,  grad N_i = N_i (R_i - sum_j N_j R_j)

Correction (Talischi, Pereira, Menezes, Paulino 2015): the mean over the points becomes the exact one from the boundary,

    G_i(x_q) = grad N_i(x_q) + (1 / |E|) (oint N_i n ds - sum_q w_q grad N_i(x_q)),

which keeps sum_i G_i = 0 and sum_i X_i (x) G_i = I. The fan runs from the centroid; its triangles' centroids are the
points. A triangle needs one point only: its gradients are constant. Beyond MANY corners one point a fan triangle
hardly sees the fast modes of the rim (least stiffness 3e-3 of the largest at 12 corners, 5e-9 at 30), so three are
taken. The mass takes three points a fan triangle, exact for N linear, so that total mass and rigid inertia are exact.
"""

import numpy as np

from polyida.element.operator import after, before, build, cross, measures
from polyida.errors import InputError

FLATTEST = 1e-6
"""Least sine of a corner's turning angle: below it the corner counts as straight."""

MANY = 10
"""Most corners with one point a fan triangle."""


def reference_operator(mesh):
    """ReferenceOperator of a mesh with strictly convex, counter-clockwise cells.

    mesh: anything with points (N, 2) in m, nodes and offsets (corners of cell i are nodes[offsets[i]:offsets[i + 1]]).
    Raises InputError naming the cell and the corner where a cell is not strictly convex, or a node without a cell.
    """
    return build(mesh, _element)


def _element(corners, cells, nodes):
    """Areas (c,), mean gradients (n, 2, c), gradients (p, n, 2, c), weights (p, c), mass (n, n, c) of cells."""
    edges = after(corners) - corners
    with np.errstate(invalid="ignore", divide="ignore"):
        edges = edges / np.sqrt((edges**2).sum(axis=-2, keepdims=True))
    sines = cross(before(edges), edges)  # of the turning angles, (n, c)
    wrong = ~(sines > FLATTEST)
    if wrong.any():
        k = np.flatnonzero(wrong.any(axis=0))[0]
        corner = int(np.argmax(wrong[:, k]))
        angle = 180 - np.degrees(np.arctan2(sines[corner, k], (before(edges) * edges).sum(axis=-2)[corner, k]))
        raise InputError(
            f"cell {cells[k]}: corner {corner} (node {nodes[corner, k]}) has an interior angle of "
            f"{angle:.6g} degrees; a Wachspress element needs strictly convex, counter-clockwise cells, "
            "every angle below 180 degrees and no side of zero length"
        )
    corners = corners - corners.mean(axis=0)
    follower = after(corners)
    area, centroid, mean = measures(corners)
    weights = cross(corners - centroid, follower - centroid) / 2
    mass = _mass(corners, follower, sines, centroid, weights)
    if len(corners) == 3:
        return area, mean, mean[None], area[None], mass
    points, weights = _rule(corners, follower, centroid, weights)
    shapes, normals, heights = _shapes(corners, follower, sines, points)
    slopes = normals / heights[:, :, None]
    slopes = slopes + np.roll(slopes, 1, axis=1)
    gradients = shapes[:, :, None] * (slopes - np.einsum("pnc,pndc->pdc", shapes, slopes)[:, None])
    gradients += mean - np.einsum("pc,pndc->ndc", weights, gradients) / area
    return area, mean, gradients, weights, mass


def _rule(corners, follower, centroid, fan):
    """Points (p, 2, c) and weights (p, c) from the areas (n, c) of the fan triangles."""
    middle = centroid + corners + follower
    if len(corners) <= MANY:
        return middle / 3, fan
    vertices = (corners, follower, centroid)
    return np.concatenate([(middle + 3 * vertex) / 6 for vertex in vertices]), np.concatenate([fan / 3] * 3)


def _shapes(corners, follower, sines, points):
    """Shape functions (p, n, c) at points (p, 2, c); with them the edges' normals (n, 2, c) and distances (p, n, c)."""
    edges = follower - corners
    normals = np.stack([edges[:, 1], -edges[:, 0]], axis=1) / np.sqrt((edges**2).sum(axis=1))[:, None]
    offsets = (corners * normals).sum(axis=1)
    heights = offsets - (points[:, None, 0] * normals[:, 0] + points[:, None, 1] * normals[:, 1])
    shapes = sines / (heights * np.roll(heights, 1, axis=1))
    return shapes / shapes.sum(axis=1, keepdims=True), normals, heights


def _mass(corners, follower, sines, centroid, weights):
    """Integral of N_i N_j over each cell, (n, n, c)."""
    middle = centroid + corners + follower
    mass = 0.0
    for vertex in (corners, follower, centroid):
        shapes, _, _ = _shapes(corners, follower, sines, (middle + 3 * vertex) / 6)
        mass = mass + np.einsum("pic,pjc->ijc", shapes * (weights / 3)[:, None], shapes)
    return mass
