"""The two elements of a plate, Wachspress and virtual, and the choice between them.

Wachspress elements on strictly convex polygons have one point for each fan triangle and gradients that pass the patch test. With outward unit
normals n_i of the edges and distances h_i(x) to them (Floater, Gillette, Sukumar 2014):

    p_i = n_i / h_i,  w_i = det(p_{i-1}, p_i),  R_i = p_{i-1} + p_i
    N_i = w_i / sum w,  grad N_i = N_i (R_i - sum_j N_j R_j)

Correction (Talischi, Pereira, Menezes, Paulino 2015): the mean over the points becomes the exact one from the boundary,

    G_i(x_q) = grad N_i(x_q) + (1 / |E|) (oint N_i n ds - sum_q w_q grad N_i(x_q)),

which keeps sum_i G_i = 0 and sum_i X_i (x) G_i = I. The fan starts at the centroid; the points are the centroids of its triangles. A triangle
has one point: its gradients are constant. The mass uses three points for each fan triangle, exact for N linear, so that total mass and rigid
inertia are exact.

Virtual elements of order one on any simple polygon have one constant F in each cell, and a stabilisation of all other deformations. Pi maps
nodal values x_i of a cell to the linear field with their mean at the corners' mean X_m and the gradient sum_i x_i (x) G_i,
G_i = (1 / |E|) oint N_i n ds of linear edges (Beirao da Veiga et al. 2013). Energy and mass are

    W = int t S(F) : E(F) / 2 + tau t tr(C) |(I - Pi) x|^2 / 2
    m_ij = int Pi N_i Pi N_j + (|E| / (9 n)) ((I - Pi)^T (I - Pi))_ij

with tr(C) of the 3 x 3 plane elasticity matrix. (I - Pi) maps linear fields to zero, including the reference positions X: displacements may
replace x, and a rotation has no energy. Total mass and rigid inertia are exact; on a square the mass is the bilinear element's, and on regular
polygons of 4 to 7 corners the part with 1 / (9 n) is within 7 % of that of Wachspress functions.
"""

import numpy as np

from polyida.element.operator import after, before, build, cross, measures, second_moments
from polyida.errors import InputError

FLATTEST = 1e-6  # sine of a corner's turning angle: a corner below counts as straight
MANY = 10  # corners; with more, one point for each fan triangle gives modes of the rim almost no stiffness, so three are used
THINNEST = 1e-14  # area of a cell over its squared circumference


def lighter(element, kept, order=1):
    """Return the element with less mass at some nodes: in each cell what they lose is shared by the nodes that keep theirs.

    m_ij is multiplied by the smaller share of both nodes, and diagonals make up for it, so that the mass of a cell stays, and M is positive
    definite. Cells without a node that keeps its mass stay as they are. Cells of order 2, whose rows sum to negative numbers at corners, get a
    diagonal mass in proportion to their diagonal where a node is light.
    """
    if kept is None:
        return element

    def light_element(corners, cells, nodes):
        """The arrays of an element whose nodes in contact keep a share of their mass; the other nodes of the cell take the rest."""
        areas, means, gradients, weights, mass, *rest = element(corners, cells, nodes)
        whole = kept[nodes] == 1.0
        share = np.where(whole.any(axis=0), kept[nodes], 1.0)
        if order == 2:
            light = share.min(axis=0) < 1.0
            lumped = np.einsum("iic->ic", mass)
            lumped = lumped * (mass.sum(axis=(0, 1)) / lumped.sum(axis=0))
            mass = np.where(light, np.eye(len(nodes))[..., None] * lumped[:, None], mass)
        left = mass * np.minimum(share[:, None], share[None])
        lost = (mass - left).sum(axis=1)
        moved = np.where(whole, lost + np.where(whole, 0.0, lost).sum(axis=0) / np.maximum(whole.sum(axis=0), 1), 0.0)
        return areas, means, gradients, weights, left + np.eye(len(nodes))[..., None] * moved[:, None], *rest

    return light_element


def stabilisation_factor(plate, operator):
    """Return the factor of a plate's stabilisation, N/m: t tr(C) of plane stress, also in plane strain; 0 for Wachspress elements.

    The tr(C) of plane strain is unbounded for nu -> 1/2 and would lock the stabilised deformations, which change no volume. Those of quadratic
    cells are coupled by the volume, so that each would cost too much there: theirs has the factor 1 - nu'^4 / 2, nu' of the plane.
    """
    if operator.stabilisation is None:
        return 0.0
    material = plate.material
    share = 1.0 - material.in_plane[1] ** 4 / 2.0 if plate.order == 2 else 1.0
    return share * plane_trace(plate.thickness * material.E / (1 - material.nu**2), material.nu)


def plane_trace(membrane_stiffness, nu):
    """Return t (C11 + C22 + C33) of plane stress, N/m; membrane_stiffness = t E / (1 - nu^2)."""
    return membrane_stiffness * (5.0 - nu) / 2.0


def wachspress(mesh, kept=None):
    """Return the ReferenceOperator of a mesh with strictly convex, counter-clockwise cells.

    mesh: any object with points (N, 2) in m, nodes and offsets (the corners of cell i are nodes[offsets[i]:offsets[i + 1]]).
    kept: as of `choice.operator_of`. Raise InputError naming cell and corner if a cell is not strictly convex, or a node without a cell.
    """
    return build(mesh, lighter(_wachspress, kept))


def fan_points(corners):
    """(points (3 n, 2, c), areas (n, c), centroid (2, c)) of the three points of each triangle of the fans, and the areas of these."""
    follower, (_, centroid, _) = after(corners), measures(corners)
    middle = centroid + corners + follower
    points = np.concatenate([(middle + 3 * vertex) / 6 for vertex in (corners, follower, np.broadcast_to(centroid, corners.shape))])
    return points, cross(corners - centroid, follower - centroid) / 2, centroid


def convex_sines(corners, cells, nodes):
    """Sines of the turning angles at the corners, (n, c). Raise InputError naming cell and corner if a cell is not strictly convex."""
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
    return sines


def _wachspress(corners, cells, nodes, many=MANY):
    """Areas (c,), mean gradients (n, 2, c), gradients (p, n, 2, c), weights (p, c), mass (n, n, c) of cells.

    many: number of corners from which on each triangle of the fan has three points.
    """
    sines = convex_sines(corners, cells, nodes)
    corners = corners - corners.mean(axis=0)
    follower = after(corners)
    area, _, mean = measures(corners)
    near, weights, centroid = fan_points(corners)
    mass = 0.0
    for points in np.split(near, 3):
        shapes, _, _ = _shapes(corners, follower, sines, points)
        mass = mass + np.einsum("pic,pjc->ijc", shapes * (weights / 3)[:, None], shapes)
    if len(corners) == 3 and many >= 3:
        return area, mean, mean[None], area[None], mass
    points = (centroid + corners + follower) / 3
    if len(corners) > many:
        points, weights = near, np.concatenate([weights / 3] * 3)
    shapes, normals, heights = _shapes(corners, follower, sines, points)
    slopes = normals / heights[:, :, None]
    slopes = slopes + np.roll(slopes, 1, axis=1)
    gradients = shapes[:, :, None] * (slopes - np.einsum("pnc,pndc->pdc", shapes, slopes)[:, None])
    gradients += mean - np.einsum("pc,pndc->ndc", weights, gradients) / area
    return area, mean, gradients, weights, mass


def wachspress_of_three(corners, cells, nodes):
    """The data of Wachspress cells with three points of the true gradients in each triangle of the fan: for errors of meshes."""
    return _wachspress(corners, cells, nodes, many=0)


def wachspress_functions(corners, points):
    """Wachspress functions (p, n, c) at points (p, 2, c) of strictly convex cells."""
    edges = after(corners) - corners
    edges = edges / np.sqrt((edges**2).sum(axis=-2, keepdims=True))
    return _shapes(corners, after(corners), cross(before(edges), edges), points)[0]


def _shapes(corners, follower, sines, points):
    """Shape functions (p, n, c) at points (p, 2, c); with them the edges' normals (n, 2, c) and distances (p, n, c)."""
    edges = follower - corners
    normals = np.stack([edges[:, 1], -edges[:, 0]], axis=1) / np.sqrt((edges**2).sum(axis=1))[:, None]
    offsets = (corners * normals).sum(axis=1)
    heights = offsets - (points[:, None, 0] * normals[:, 0] + points[:, None, 1] * normals[:, 1])
    shapes = sines / (heights * np.roll(heights, 1, axis=1))
    return shapes / shapes.sum(axis=1, keepdims=True), normals, heights


def virtual(mesh, tau=0.1, kept=None):
    """Return the ReferenceOperator with one point in each cell and `stabilisation` = tau sum over cells (I - Pi)^T (I - Pi), no unit.

    mesh: as of `wachspress`; cells are counter-clockwise simple polygons, not necessarily convex: hanging nodes are allowed.
    tau: stiffness of the deformations that a cell's F does not contain, > 0. Results converge to the same limit for every tau. Error of a
    cantilever's tip with 2 / 3 / 5 cells through the thickness: +3.5 / +0.2 / +0.3 % for 0.1 and -43 / -19 / -8 % for 0.5 (means over six
    meshes of 40 / 90 / 250 cells). The energy of the stabilisation is factor u . (stabilisation (x) I) u / 2 with the factor of
    `stabilisation_factor`. Triangles have none. Raise InputError for tau <= 0, a cell without area or clockwise, a side of zero length, a node
    without a cell.
    """
    if not (np.isfinite(tau) and tau > 0):
        raise InputError(
            f"virtual element: tau = {tau!r} must be a positive number, 0.1 is usual; without "
            "stabilisation cells of more than three corners have no stiffness against some deformations"
        )
    return build(mesh, lighter(lambda corners, cells, nodes: _virtual(corners, cells, nodes, tau), kept))


def _virtual(corners, cells, nodes, tau):
    """The arrays of `_wachspress` for virtual elements, and behind them the stabilisation (n, n, c)."""
    n = len(corners)
    corners = corners - corners.mean(axis=0)
    lengths = np.sqrt(((after(corners) - corners) ** 2).sum(axis=1))
    flat = ~(lengths > 0)
    if flat.any():
        k = np.flatnonzero(flat.any(axis=0))[0]
        raise InputError(f"cell {cells[k]}: the side after node {nodes[np.argmax(flat[:, k]), k]} has no length")
    area, centroid, mean = measures(corners)
    wrong = np.flatnonzero(~(area > THINNEST * lengths.sum(axis=0) ** 2))
    if wrong.size:
        raise InputError(
            f"cell {cells[wrong[0]]}: area {area[wrong[0]]:.3g} m^2; a virtual element needs a cell counter-clockwise, with positive area"
        )
    rest = np.eye(n)[..., None] - 1 / n - np.einsum("idc,jdc->ijc", corners, mean)
    square = np.einsum("kic,kjc->ijc", rest, rest) if n > 3 else np.zeros((n, n, len(cells)))
    middle = 1 / n + np.einsum("idc,dc->ic", mean, centroid)
    spread = np.einsum("idc,dec,jec->ijc", mean, second_moments(corners - centroid), mean)
    mass = middle[:, None] * middle * area + (spread + spread.transpose(1, 0, 2)) / 2 + area / (9 * n) * square
    return area, mean, mean[None], area[None], mass, tau * square
