"""Quadratic elements on strictly convex polygons: 2n nodes, corner, middle of the side, corner, ...

From the Wachspress functions lam_i come the products mu_ij = lam_i lam_j. For each diagonal ab, 2n numbers c of least norm bring mu_ab to the
corners and sides (Rand, Gillette, Bajaj 2014):

    xi_ii = mu_ii + sum_ab c_ii mu_ab,  xi_i,i+1 = mu_i,i+1 + sum_ab c_i,i+1 mu_ab
    sum_i c_ii P(v_i, v_i) + 2 c_i,i+1 P(v_i, v_i+1) = 2 P(v_a, v_b),  P(v, w) = (1, (v + w) / 2, sym(v (x) w))

so that 1, x and x (x) x are reproduced. The Lagrange functions of the nodes are psi_i = xi_ii - xi_i-1,i - xi_i,i+1 of a corner and
4 xi_i,i+1 of a side. The mass is their integral with six points for each fan triangle, exact for degree 4.

Gradients are the linear ones with the moments of those of psi, as in virtual elements of order two (Beirao da Veiga et al. 2013):

    int G_i p = oint psi_i p n ds - int psi_i grad p,   p = 1, x, y

Both patch tests, linear and quadratic, are exact. Three points are enough for them: in coordinates with unit second moments, an equilateral
triangle around the centroid has the moments of the cell up to degree 2, and its corners, sqrt(2) away, lie within every convex cell. The
volume then has three conditions in each cell, which do not lock as nu goes to 1/2. All that is not quadratic in a cell has the stabilisation of
virtual elements, tau / 2 times tr(C) |x - Q x|^2 / 2 with the least-squares fit Q of a quadratic field to the nodes: triangles, which are T6, have none.
Each cell is computed in the coordinates with unit second moments: slender cells cost no digits.
"""

import numpy as np

from polyida.element.elements import convex_sines, wachspress_functions
from polyida.element.operator import after, before, cross, measures, second_moments
from polyida.errors import InputError

NEAR, FAR = 0.445948490915965, 0.091576213509771  # Strang, Fix 1973: six points of a triangle, degree 4
SHARES = np.array([np.roll([1.0 - 2.0 * share, share, share], k) for share in (NEAR, FAR) for k in range(3)])
WEIGHTS = np.repeat([0.223381589678011, 0.109951743655322], 3)
STRAIGHT = 1e-9  # distance of a middle node from the middle of its side, relative to the side


def quadratic(corners, cells, nodes, tau):
    """Areas (c,), mean gradients (2n, 2, c), gradients (3, 2n, 2, c), weights (3, c), mass and stabilisation (2n, 2n, c) of cells of 2n nodes."""
    convex_sines(corners[::2], cells, nodes[::2])
    _require_straight(corners[::2], corners[1::2], cells, nodes[1::2])
    vertices, area, from_cell = _with_unit_moments(corners)
    size = 1.0 / np.linalg.det(from_cell)
    points, weights = _rule(vertices)
    shapes = _functions(vertices, points)
    mass = np.matmul((shapes * (weights * size)[:, None]).transpose(2, 1, 0), shapes.transpose(2, 0, 1)).transpose(1, 2, 0)
    moments = _flux(vertices)
    total = np.einsum("pc,pnc->nc", weights, shapes)
    moments[:, 1, 0] -= total
    moments[:, 2, 1] -= total
    moments = np.einsum("nkec,ced->nkdc", moments, from_cell) * (size / area)
    places = _places(vertices)
    linear = np.concatenate([np.ones_like(places[:, :1]), places], axis=1)
    gradients = np.einsum("pkc,nkdc->pndc", linear, moments)
    return area, moments[:, 0], gradients, np.tile(area / 3.0, (3, 1)), mass, tau / 2 * _unfitted(vertices)


def _with_unit_moments(corners):
    """(vertices (n, 2, c) in coordinates with unit second moments about the centroid, areas (c,), their slopes in x and y (c, 2, 2))."""
    vertices = corners[::2] - corners[::2].mean(axis=0)
    area, centroid, _ = measures(vertices)
    vertices = vertices - centroid
    slopes = np.linalg.inv(np.linalg.cholesky((second_moments(vertices) / area).transpose(2, 0, 1)))
    return np.einsum("cde,nec->ndc", slopes, vertices), area, slopes


def _places(vertices):
    """The three points (3, 2, c) in these coordinates, the first one towards the first corner."""
    start = vertices[0] / np.sqrt((vertices[0] ** 2).sum(axis=0))
    turned = np.exp(2j * np.pi * np.arange(3) / 3)[:, None] * (start[0] + 1j * start[1]) * np.sqrt(2.0)
    return np.stack([turned.real, turned.imag], axis=1)


def to_nodes(corners):
    """Weights (2n, 3, c) by which linear fields at the three points are extrapolated to the nodes of cells."""
    vertices = _with_unit_moments(corners)[0]
    nodes = np.stack([vertices, (vertices + after(vertices)) / 2], axis=1).reshape(2 * len(vertices), *vertices.shape[1:])
    return (1.0 + np.einsum("ndc,pdc->npc", nodes, _places(vertices))) / 3.0


def _require_straight(vertices, middles, cells, nodes):
    """Raise InputError for a middle node that is not at the middle of its side."""
    sides = after(vertices) - vertices
    away = middles - (vertices + after(vertices)) / 2
    wrong = (away**2).sum(axis=1) > STRAIGHT**2 * (sides**2).sum(axis=1)
    if wrong.any():
        k = np.flatnonzero(wrong.any(axis=0))[0]
        raise InputError(f"cell {cells[k]}: the middle node {nodes[np.argmax(wrong[:, k]), k]} is not at the middle of its side")


def _rule(vertices):
    """Points (p, 2, c) and weights (p, c) of degree 4: six for each triangle of the fan around the origin."""
    fan = cross(vertices, after(vertices)) / 2
    points = [share[1] * vertices + share[2] * after(vertices) for share in SHARES]
    return np.concatenate(points), np.concatenate([weight * fan for weight in WEIGHTS])


def _quadratics(v, w):
    """(1, (v + w) / 2, sym(v (x) w)) of points (c, n, 2): (c, 6, n)."""
    mean, one, other = (v + w) / 2, v[..., 0] * w[..., 1], v[..., 1] * w[..., 0]
    return np.stack(
        [np.ones_like(one), mean[..., 0], mean[..., 1], v[..., 0] * w[..., 0], (one + other) / 2, v[..., 1] * w[..., 1]], axis=1
    )


def _pairs(n):
    """Numbers i, j of the products: corners, sides, diagonals."""
    own = np.arange(n)
    i, j = np.triu_indices(n, 2)
    inner = (i != 0) | (j != n - 1)
    return np.concatenate([own, own, i[inner]]), np.concatenate([own, (own + 1) % n, j[inner]])


def _functions(vertices, points):
    """Lagrange functions (p, 2n, c) at points (p, 2, c)."""
    n, places = len(vertices), vertices.transpose(2, 0, 1)
    i, j = _pairs(n)
    known = _quadratics(places[:, i], places[:, j])
    kept = known[..., : 2 * n] * np.repeat([1.0, 2.0], n)
    least = kept.transpose(0, 2, 1) @ np.linalg.solve(kept @ kept.transpose(0, 2, 1), 2.0 * known[..., 2 * n :])
    lam = wachspress_functions(vertices, points).transpose(2, 0, 1)
    products = lam[..., i] * lam[..., j]
    xi = products[..., : 2 * n] + products[..., 2 * n :] @ least.transpose(0, 2, 1)
    own, sides = xi[..., :n], xi[..., n:]
    shapes = np.stack([own - sides - np.roll(sides, 1, axis=2), 4.0 * sides], axis=3)
    return shapes.reshape(*lam.shape[:2], 2 * n).transpose(1, 2, 0)


def _flux(vertices):
    """oint psi p n ds for p = 1, x, y, (2n, 3, 2, c), by Simpson's rule."""
    sides = after(vertices) - vertices
    normals = np.stack([sides[:, 1], -sides[:, 0]], axis=1)

    def times(places):
        """p at one place of each side, times the normal of the side's length."""
        return np.stack([normals, *(places[:, k, None] * normals for k in (0, 1))], axis=1)

    flux = np.empty((2 * len(vertices), *times(vertices).shape[1:]))
    flux[::2] = (times(vertices) + before(times(after(vertices)))) / 6
    flux[1::2] = 4 * times((vertices + after(vertices)) / 2) / 6
    return flux


def _unfitted(vertices):
    """The projection (2n, 2n, c) of nodal values on what no quadratic field fits."""
    n, places = len(vertices), vertices.transpose(2, 0, 1)
    if n == 3:
        return np.zeros((6, 6, len(places)))
    middles = (places + np.roll(places, -1, axis=1)) / 2
    nodes = np.stack([places, middles], axis=2).reshape(len(places), 2 * n, 2)
    basis = np.linalg.qr(_quadratics(nodes, nodes).transpose(0, 2, 1))[0]
    return (np.eye(2 * n) - basis @ basis.transpose(0, 2, 1)).transpose(1, 2, 0)
