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

Curved sides: the functions map the cell of straight sides to the curved one (isoparametric). The right side above is integrated along the
parabolas, and weights are changed a little so that the moments of the cell are exact: up to degree 1 for the gradients, so that the linear
patch test stays exact, and 2 for the mass, so that the inertia is that of the body.
"""

import numpy as np

from polyida.element.elements import convex_sines, wachspress_functions
from polyida.element.operator import after, before, cross, measures, second_moments
from polyida.errors import InputError
from polyida.mesh.topology import SIDE, SIDE_SLOPES

STIFFNESS_RULE = np.array([[2.0, 0.5, 0.5], [0.5, 2.0, 0.5], [0.5, 0.5, 2.0]]) / 3.0, np.full(3, 1.0 / 3.0)
_NEAR, _FAR = 0.445948490915965, 0.091576213509771  # Strang, Fix 1973: six points, degree 4
_TRIPLES = [np.roll([1.0 - 2.0 * value, value, value], k) for value in (_NEAR, _FAR) for k in range(3)]
MASS_RULE = np.array(_TRIPLES), np.repeat([0.223381589678011, 0.109951743655322], 3)
LEAST = 0.1  # of the determinant of the map of a cell to its curved sides, which is 1 where they are straight
DEEPEST = 0.1  # sine of the angle by which two curved sides may overlap at their corner


def quadratic(corners, cells, nodes):
    """Areas (c,), mean gradients (2n, 2, c), gradients (p, 2n, 2, c), weights (p, c), mass (2n, 2n, c) of cells of 2n nodes."""
    vertices = corners[::2]
    convex_sines(vertices, cells, nodes[::2])
    origin = vertices.mean(axis=0)
    vertices = vertices - origin
    area, centroid, _ = measures(vertices)
    vertices = vertices - centroid
    to_cell = np.linalg.cholesky((second_moments(vertices) / area).transpose(2, 0, 1))  # of the coordinates with equal moments, (c, 2, 2)
    from_cell, size = np.linalg.inv(to_cell), np.linalg.det(to_cell)
    vertices = np.einsum("cde,nec->ndc", from_cell, vertices)
    places = np.einsum("cde,nec->ndc", from_cell, corners - origin - centroid)
    _require_open_corners(places, cells)
    moments, flux = _boundary(places)
    fan, coefficients = cross(vertices, after(vertices)) / 2, _coefficients(vertices)
    shapes, gradients, points, weights = _mapped(_rule(STIFFNESS_RULE, vertices, fan), vertices, coefficients, places, cells)
    weights = _matched(weights, _monomials(points)[:, :3], moments[:3])
    _correct(gradients, shapes, flux, points, weights)
    of_mass, _, points, mass_weights = _mapped(_rule(MASS_RULE, vertices, fan), vertices, coefficients, places, cells)
    mass_weights = _matched(mass_weights, _monomials(points), moments)
    mass = np.matmul((of_mass * (mass_weights * size)[:, None]).transpose(2, 1, 0), of_mass.transpose(2, 0, 1)).transpose(1, 2, 0)
    means = np.einsum("nec,ced->ndc", flux[:, 0], from_cell) / moments[0]
    return moments[0] * size, means, np.einsum("pnec,ced->pndc", gradients, from_cell), weights * size, mass


def _sides(places):
    """Nodes (n, 3, 2, c) of the sides: corner, middle, next corner."""
    return np.stack([places[::2], places[1::2], after(places[::2])], axis=1)


def _require_open_corners(places, cells):
    """Raise InputError for a middle node near a corner, where its side turns back, and for sides that cross beside their corner."""
    start, middle, end = _sides(places).transpose(1, 0, 2, 3)
    leaving, arriving, chord = 4 * middle - 3 * start - end, before(start - 4 * middle + 3 * end), end - start
    square = (chord**2).sum(axis=1)
    ahead = np.minimum((leaving * chord).sum(axis=1), (after(arriving) * chord).sum(axis=1)) > LEAST * square
    length = np.sqrt((leaving**2).sum(axis=1) * (arriving**2).sum(axis=1))
    wrong = np.flatnonzero(~(ahead & (cross(arriving, leaving) > -DEEPEST * length)).all(axis=0))
    if wrong.size:
        raise InputError(
            f"cell {cells[wrong[0]]}: its sides are curved too strongly; a middle node must be well between the corners, near their middle"
        )


def _boundary(places):
    """Moments (6, c) of 1, x, y, xx, xy, yy over the cells, and oint psi p n ds for p = 1, x, y, (2n, 3, 2, c)."""
    sides = _sides(places)
    x, dx = (np.einsum("gj,njdc->gndc", functions, sides) for functions in (SIDE, SIDE_SLOPES))
    monomials, twice = _monomials(x.reshape(-1, *x.shape[2:])).reshape(*x.shape[:2], 6, -1), cross(x, dx)
    moments = np.einsum("gnkc,gnc->kc", monomials, twice) / np.array([2.0, 3.0, 3.0, 4.0, 4.0, 4.0])[:, None]
    normals = np.stack([dx[:, :, 1], -dx[:, :, 0]], axis=2)
    parts = np.einsum("gj,gnkc,gndc->jnkdc", SIDE, monomials[:, :, :3], normals, optimize=True)
    flux = np.empty((len(places), *parts.shape[2:]))
    flux[::2] = parts[0] + before(parts[2])
    flux[1::2] = parts[1]
    return moments, flux


def _mapped(rule, vertices, coefficients, places, cells):
    """Functions and gradients at points of the straight cells mapped to the curved ones, and these points and weights."""
    shapes, gradients = _functions(vertices, coefficients, rule[0])
    slopes = np.einsum("pnec,ndc->pdec", gradients, places)
    determinant = slopes[:, 0, 0] * slopes[:, 1, 1] - slopes[:, 0, 1] * slopes[:, 1, 0]
    wrong = np.flatnonzero(~(determinant > LEAST).all(axis=0))
    if wrong.size:
        raise InputError(f"cell {cells[wrong[0]]}: its sides are curved too strongly, or turn it inside out; use more cells there")
    back = np.stack(
        [np.stack([slopes[:, 1, 1], -slopes[:, 0, 1]], axis=1), np.stack([-slopes[:, 1, 0], slopes[:, 0, 0]], axis=1)], axis=1
    )
    gradients = np.einsum("pnec,pedc->pndc", gradients, back / determinant[:, None, None])
    return shapes, gradients, np.einsum("pnc,ndc->pdc", shapes, places), rule[1] * determinant


def _monomials(points):
    """1, x, y, xx, xy, yy at points (p, 2, c): (p, 6, c)."""
    x, y = points[:, 0], points[:, 1]
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=1)


def _matched(weights, monomials, moments):
    """The weights changed as little as possible, relative to themselves, so that the monomials (p, k, c) have these moments (k, c)."""
    square = np.einsum("pc,pkc,plc->ckl", weights, monomials, monomials, optimize=True)
    missing = moments - np.einsum("pc,pkc->kc", weights, monomials)
    return weights * (1.0 + np.einsum("pkc,ck->pc", monomials, np.linalg.solve(square, missing.T[..., None])[..., 0]))


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
