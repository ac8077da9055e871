"""Quadratic elements on strictly convex polygons: 2n nodes, corner, middle of the side, corner, ...

From the Wachspress functions lam_i come the products mu_ij = lam_i lam_j. For each diagonal ab, 2n numbers c of least norm bring mu_ab to the
corners and sides (Rand, Gillette, Bajaj 2014):

    xi_ii = mu_ii + sum_ab c_ii mu_ab,  xi_i,i+1 = mu_i,i+1 + sum_ab c_i,i+1 mu_ab
    sum_i c_ii P(v_i, v_i) + 2 c_i,i+1 P(v_i, v_i+1) = 2 P(v_a, v_b),  P(v, w) = (1, (v + w) / 2, sym(v (x) w))

so that 1, x and x (x) x are reproduced. The Lagrange functions of the nodes are psi_i = xi_ii - xi_i-1,i - xi_i,i+1 of a corner and
4 xi_i,i+1 of a side. A triangle is T6; all is independent of affine maps, so each cell is computed with its second moments made equal.

Gradients get the linear correction d(x) of each function (Chi, Talischi, Lopez-Pamies, Paulino 2016) with which

    sum_q w_q (grad psi + d)(x_q) p(x_q) = oint psi p n ds - sum_q w_q psi(x_q) grad p,   p = 1, x, y

and both patch tests, linear and quadratic, are exact. The mass uses six points for each fan triangle, exact for degree 4.
"""

import numpy as np

from polyida.element.elements import convex_sines, wachspress_functions
from polyida.element.operator import after, before, cross, measures, second_moments
from polyida.errors import InputError

STIFFNESS_RULE = np.array([[2.0, 0.5, 0.5], [0.5, 2.0, 0.5], [0.5, 0.5, 2.0]]) / 3.0, np.full(3, 1.0 / 3.0)
_NEAR, _FAR = 0.445948490915965, 0.091576213509771  # Strang, Fix 1973: six points, degree 4
_TRIPLES = [np.roll([1.0 - 2.0 * value, value, value], k) for value in (_NEAR, _FAR) for k in range(3)]
MASS_RULE = np.array(_TRIPLES), np.repeat([0.223381589678011, 0.109951743655322], 3)
STRAIGHT = 1e-9  # distance of a middle node from the middle of its side, relative to the side


def quadratic(corners, cells, nodes):
    """Areas (c,), mean gradients (2n, 2, c), gradients (p, 2n, 2, c), weights (p, c), mass (2n, 2n, c) of cells of 2n nodes."""
    vertices, middles = corners[::2], corners[1::2]
    convex_sines(vertices, cells, nodes[::2])
    _require_straight(vertices, middles, cells, nodes[1::2])
    vertices = vertices - vertices.mean(axis=0)
    area, centroid, _ = measures(vertices)
    vertices = vertices - centroid
    to_cell = np.linalg.cholesky((second_moments(vertices) / area).transpose(2, 0, 1))  # of the coordinates with equal moments, (c, 2, 2)
    from_cell = np.linalg.inv(to_cell)
    vertices = np.einsum("cde,nec->ndc", from_cell, vertices)
    sides, size = after(vertices) - vertices, np.linalg.det(to_cell)
    fan, coefficients = cross(vertices, after(vertices)) / 2, _coefficients(vertices)
    points, weights = _rule(STIFFNESS_RULE, vertices, fan)
    shapes, gradients = _functions(vertices, coefficients, points)
    flux = _flux(vertices, np.stack([sides[:, 1], -sides[:, 0]], axis=1))
    _correct(gradients, shapes, flux, points, weights)
    of_mass, mass_weights = _rule(MASS_RULE, vertices, fan)
    shapes, _ = _functions(vertices, coefficients, of_mass)
    mass = np.matmul((shapes * (mass_weights * size)[:, None]).transpose(2, 1, 0), shapes.transpose(2, 0, 1)).transpose(1, 2, 0)
    means = np.einsum("nec,ced->ndc", flux[:, 0], from_cell) * (size / area)
    return area, means, np.einsum("pnec,ced->pndc", gradients, from_cell), weights * size, mass


def _require_straight(vertices, middles, cells, nodes):
    """Raise InputError for a middle node that is not at the middle of its side."""
    sides = after(vertices) - vertices
    away = middles - (vertices + after(vertices)) / 2
    wrong = (away**2).sum(axis=1) > STRAIGHT**2 * (sides**2).sum(axis=1)
    if wrong.any():
        k = np.flatnonzero(wrong.any(axis=0))[0]
        raise InputError(f"cell {cells[k]}: the middle node {nodes[np.argmax(wrong[:, k]), k]} is not at the middle of its side")


def _rule(rule, vertices, fan):
    """Points (p, 2, c) and weights (p, c) of a rule on each triangle of the fan around the origin, with areas fan (n, c)."""
    shares, weights = rule
    points = [share[1] * vertices + share[2] * after(vertices) for share in shares]
    return np.concatenate(points), np.concatenate([weight * fan for weight in weights])


def _products(v, w):
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


def _coefficients(vertices):
    """Coefficients (c, 2n, products) of the Lagrange functions in the products of `_pairs`."""
    n, places = len(vertices), vertices.transpose(2, 0, 1)
    i, j = _pairs(n)
    known = _products(places[:, i], places[:, j])
    kept = known[..., : 2 * n] * np.repeat([1.0, 2.0], n)
    least = kept.transpose(0, 2, 1) @ np.linalg.solve(kept @ kept.transpose(0, 2, 1), 2.0 * known[..., 2 * n :])
    both = np.concatenate([np.broadcast_to(np.eye(2 * n), (len(places), 2 * n, 2 * n)), least], axis=2)
    lagrange = np.zeros((2 * n, 2 * n))
    own = np.arange(n)
    lagrange[2 * own, own] = 1.0
    lagrange[2 * own, n + own] = lagrange[2 * own, n + (own - 1) % n] = -1.0
    lagrange[2 * own + 1, n + own] = 4.0
    return lagrange @ both


def _functions(vertices, coefficients, points):
    """Functions (p, 2n, c) and their gradients (p, 2n, 2, c) at points (p, 2, c)."""
    lam, slopes = wachspress_functions(vertices, points)
    lam, slopes = lam.transpose(2, 0, 1), slopes.transpose(3, 0, 2, 1)  # (c, p, n) and (c, p, 2, n)
    i, j = _pairs(len(vertices))
    back = coefficients.transpose(0, 2, 1)
    shapes = (lam[..., i] * lam[..., j]) @ back
    gradients = (lam[..., None, i] * slopes[..., j] + lam[..., None, j] * slopes[..., i]) @ back[:, None]
    return shapes.transpose(1, 2, 0), gradients.transpose(1, 3, 2, 0)


def _flux(vertices, normals):
    """oint psi p n ds for p = 1, x, y, (2n, 3, 2, c), by Simpson's rule; normals (n, 2, c) have the length of the sides."""
    middles = (vertices + after(vertices)) / 2

    def times(places):
        """p at one place of each side times the normal."""
        return np.stack([normals, *(places[:, k, None] * normals for k in (0, 1))], axis=1)

    flux = np.empty((2 * len(vertices), 3, *normals.shape[1:]))
    flux[::2] = (times(vertices) + before(times(after(vertices)))) / 6
    flux[1::2] = 4 * times(middles) / 6
    return flux


def _correct(gradients, shapes, flux, points, weights):
    """Add the linear correction to gradients."""
    linear = np.stack([np.ones_like(weights), points[:, 0], points[:, 1]], axis=1)
    missing = flux - np.einsum("pkc,pndc->nkdc", linear * weights[:, None], gradients, optimize=True)
    total = np.einsum("pc,pnc->nc", weights, shapes)
    missing[:, 1, 0] -= total
    missing[:, 2, 1] -= total
    square = np.einsum("pc,pkc,plc->ckl", weights, linear, linear)
    n, _, _, count = missing.shape
    change = np.linalg.solve(square, missing.transpose(3, 1, 0, 2).reshape(count, 3, -1)).reshape(count, 3, n, 2)
    gradients += np.einsum("pkc,cknd->pndc", linear, change, optimize=True)
