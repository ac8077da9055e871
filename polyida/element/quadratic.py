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
virtual elements, tau tr(C) |x - Q x|^2 / 2 with the least-squares fit Q of a quadratic field to the nodes. Triangles, which are T6, have none.
Each cell is computed in the coordinates with unit second moments: slender cells cost no digits.

Curved sides are parabolas. The functions psi map the cell of straight sides to the curved one (isoparametric). There p are 1 and the straight
coordinates, with unit second moments over the curved cell, so that a long cell bends along its curve; the integral on the boundary is that
along the parabolas. The weights of int psi_i are changed a little so that the area and its first and second moments are exact, and the moments
so that linear fields have exact gradients: the mass has the inertia of the body, and the linear patch test is exact.
"""

from typing import NamedTuple

import numpy as np

from polyida.element.elements import convex_sines, wachspress_functions
from polyida.element.operator import after, before, cross, measures
from polyida.errors import InputError
from polyida.mesh.topology import SIDE, SIDE_SLOPES

NEAR, FAR = 0.445948490915965, 0.091576213509771  # Strang, Fix 1973: six points of a triangle, degree 4
SHARES = np.array([np.roll([1.0 - 2.0 * share, share, share], k) for share in (NEAR, FAR) for k in range(3)])
WEIGHTS = np.repeat([0.223381589678011, 0.109951743655322], 3)
STRAIGHT = 1e-9  # distance of a middle node from the middle of its side, relative to the extent of its cell
LEAST = 0.1  # of the determinant of the map to curved sides, 1 where they are straight, and of the slope of a side along its chord
DEEPEST = 0.1  # sine of the angle by which two curved sides may overlap beside their corner
STEP = 1e-30  # of derivatives by complex numbers, which have no round-off


def quadratic(corners, cells, nodes, tau):
    """Areas (c,), mean gradients (2n, 2, c), gradients (3, 2n, 2, c), weights (3, c), mass and stabilisation (2n, 2n, c) of cells of 2n nodes."""
    convex_sines(corners[::2], cells, nodes[::2])
    nodes, area, from_cell = _with_unit_moments(corners)
    _require_open_corners(nodes, cells)
    rule = _rule(nodes, cells)
    size = 1.0 / np.linalg.det(from_cell)
    mass = np.matmul((rule.shapes * (rule.weights * size)[:, None]).transpose(2, 1, 0), rule.shapes.transpose(2, 0, 1)).transpose(1, 2, 0)
    moments = np.einsum("nkec,ced->nkdc", _moments_of_gradients(nodes, rule), from_cell) * (size / area)
    places = _places(rule.places)
    linear = np.concatenate([np.ones_like(places[:, :1]), places], axis=1)
    gradients = np.einsum("pkc,nkdc->pndc", linear, moments)
    return area, moments[:, 0], gradients, np.tile(area / 3.0, (3, 1)), mass, tau * _unfitted(nodes, rule.places)


class Rule(NamedTuple):
    """Points of degree 4 over cells of 2n nodes.

    shapes (p, 2n, c): the functions; weights (p, c); places (2n, 2, c): straight coordinates of the nodes, with unit second moments; slopes
    (p, straight, x or y, c): of these coordinates.
    """

    shapes: np.ndarray
    weights: np.ndarray
    places: np.ndarray
    slopes: np.ndarray


def _moments_of_gradients(nodes, rule):
    """int p grad psi for p = 1 and the straight coordinates, (2n, 3, 2, c), so that linear fields have exact gradients."""
    moments, area = _flux(nodes, rule.places), rule.weights.sum(axis=0)
    for axis in (0, 1):
        moments[:, 1 + axis] -= np.einsum("pc,pnc,pdc->ndc", rule.weights, rule.shapes, rule.slopes[:, axis])
    share = np.einsum("pc,pnc->nc", rule.weights, rule.shapes) / area
    moments[:, 1:] -= share[:, None, None] * moments[:, 1:].sum(axis=0)
    rest = np.einsum("nec,nkdc->kedc", nodes, moments[:, 1:])  # of a linear field; 0 where sides are straight
    moments[:, 1:] -= np.einsum("nec,kedc->nkdc", moments[:, 0] / area, rest)
    return moments


def _along_sides(nodes):
    """Points (g, n, 2, c) along the parabolas of the sides, and their pieces dx."""
    sides = np.stack([nodes[::2], nodes[1::2], after(nodes[::2])], axis=1)
    return [np.einsum("gj,njdc->gndc", functions, sides) for functions in (SIDE, SIDE_SLOPES)]


def _moments(nodes):
    """int (1, x, y, xx, xy, yy) over the area of each cell with these nodes (2n, 2, c), (6, c)."""
    x, dx = _along_sides(nodes)
    return np.einsum("gnkc,gnc->kc", _monomials(x), cross(x, dx)) / np.array([2.0, 3.0, 3.0, 4.0, 4.0, 4.0])[:, None]


def _monomials(points):
    """1, x, y, xx, xy, yy at points (..., 2, c): (..., 6, c)."""
    x, y = points[..., 0, :], points[..., 1, :]
    return np.stack([np.ones_like(x), x, y, x * x, x * y, y * y], axis=-2)


def _with_unit_moments(corners):
    """(nodes, areas (c,), slopes) of c cells in coordinates about the centroid, in which the second moments over the area are unit ones.

    corners (2n, 2, c): all nodes of the cells in x and y, corner, middle, corner, ... nodes (2n, 2, c): the same in the new coordinates.
    slopes (c, 2, 2): derivatives of the new coordinates (rows) in x and y (columns).
    """
    nodes = corners - corners[::2].mean(axis=0)
    area, *first = _moments(nodes)[:3]
    nodes = nodes - first / area
    xx, xy, yy = _moments(nodes)[3:] / area
    slopes = np.linalg.inv(np.linalg.cholesky(np.array([[xx, xy], [xy, yy]]).transpose(2, 0, 1)))
    return np.einsum("cde,nec->ndc", slopes, nodes), area, slopes


def _require_open_corners(nodes, cells):
    """Raise InputError for a middle node near a corner, where its side turns back, and for sides that overlap beside their corner."""
    start, middle, end = nodes[::2], nodes[1::2], after(nodes[::2])
    leaving, arriving, chord = 4 * middle - 3 * start - end, before(start - 4 * middle + 3 * end), end - start
    ahead = np.minimum((leaving * chord).sum(axis=1), (after(arriving) * chord).sum(axis=1)) > LEAST * (chord**2).sum(axis=1)
    length = np.sqrt((leaving**2).sum(axis=1) * (arriving**2).sum(axis=1))
    wrong = np.flatnonzero(~(ahead & (cross(arriving, leaving) > -DEEPEST * length)).all(axis=0))
    if wrong.size:
        raise InputError(f"cell {cells[wrong[0]]}: its sides are curved too strongly; a middle node must lie near the middle of its side")


def _rule(nodes, cells):
    """The Rule of the cells. Where sides are curved, the weights are changed a little: area, first and second moments are exact."""
    vertices = nodes[::2]
    points, weights = _straight_rule(vertices)
    shapes, middles = _functions(vertices, points), (vertices + after(vertices)) / 2
    straight = np.empty_like(nodes)
    straight[::2], straight[1::2] = vertices, middles
    if not ((nodes[1::2] - middles) ** 2).sum(axis=1).max() > STRAIGHT**2:
        return Rule(shapes, weights, straight, np.broadcast_to(np.eye(2)[..., None], (len(points), 2, 2, nodes.shape[-1])))
    steps = [STEP * 1j * np.eye(2)[axis][:, None] for axis in (0, 1)]
    slopes = [np.einsum("pnc,ndc->pdc", _functions(vertices, points + step).imag / STEP, nodes) for step in steps]
    determinant = cross(*slopes)
    wrong = np.flatnonzero(~(determinant > LEAST).all(axis=0))
    if wrong.size:
        raise InputError(f"cell {cells[wrong[0]]}: its sides are curved too strongly, or turn it inside out; use smaller cells there")
    weights, monomials = weights * determinant, _monomials(np.einsum("pnc,ndc->pdc", shapes, nodes))
    square = np.einsum("pc,pkc,plc->ckl", weights, monomials, monomials, optimize=True)
    missing = _moments(nodes) - np.einsum("pc,pkc->kc", weights, monomials)
    change = np.linalg.solve(square, missing.T[..., None])[..., 0]  # the smallest one relative to the weights
    weights = weights * (1.0 + np.einsum("pkc,ck->pc", monomials, change))
    first, second = (np.stack([slope[:, 1], -slope[:, 0]], axis=1) / determinant[:, None] for slope in slopes)
    return _with_unit_places(shapes, weights, straight, points, np.stack([second, -first], axis=1))


def _with_unit_places(shapes, weights, straight, points, slopes):
    """The Rule with straight coordinates moved and linearly mapped so that they have unit second moments over the curved cell.

    shapes, weights: as of Rule; straight (2n, 2, c), points (p, 2, c): straight coordinates of the nodes and of the points; slopes
    (p, 2, 2, c): their derivatives in x and y at the points.
    """
    area = weights.sum(axis=0)
    centre = np.einsum("pc,pdc->dc", weights, points) / area
    offset = points - centre
    moments = np.einsum("pc,pdc,pec->cde", weights / area, offset, offset)
    change = np.linalg.inv(np.linalg.cholesky(moments))
    return Rule(shapes, weights, np.einsum("cde,nec->ndc", change, straight - centre), np.einsum("cde,pefc->pdfc", change, slopes))


def _places(places):
    """The three points (3, 2, c) in coordinates with unit second moments, in which the nodes have these places; one lies towards the first corner."""
    start = places[0] / np.sqrt((places[0] ** 2).sum(axis=0))
    turned = np.exp(2j * np.pi * np.arange(3) / 3)[:, None] * (start[0] + 1j * start[1]) * np.sqrt(2.0)
    return np.stack([turned.real, turned.imag], axis=1)


def to_nodes(corners):
    """Weights (2n, 3, c) by which linear fields at the three points are extrapolated to the nodes of cells."""
    nodes = _with_unit_moments(corners)[0]
    places = _rule(nodes, np.arange(nodes.shape[-1])).places
    return (1.0 + np.einsum("ndc,pdc->npc", places, _places(places))) / 3.0


def _straight_rule(vertices):
    """Points (p, 2, c) and weights (p, c) of degree 4 over straight cells: six for each triangle of the fan around the centroid."""
    _, centroid, _ = measures(vertices)
    arms = vertices - centroid
    fan = cross(arms, after(arms)) / 2
    points = [centroid + share[1] * arms + share[2] * after(arms) for share in SHARES]
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


def _flux(nodes, places):
    """oint psi p n ds for p = 1 and the straight coordinates, in which nodes have these places, (2n, 3, 2, c)."""
    (_, dx), (straight, _) = _along_sides(nodes), _along_sides(places)
    normals = np.stack([dx[:, :, 1], -dx[:, :, 0]], axis=2)
    parts = np.einsum("gj,gnkc,gndc->jnkdc", SIDE, _monomials(straight)[:, :, :3], normals, optimize=True)
    flux = np.empty((len(nodes), *parts.shape[2:]))
    flux[::2] = parts[0] + before(parts[2])
    flux[1::2] = parts[1]
    return flux


def _unfitted(nodes, places):
    """The projection (2n, 2n, c) of nodal values on what no field fits that is linear in x and quadratic in the straight coordinates."""
    count, at = len(nodes), places.transpose(2, 0, 1)
    if count == 6:
        return np.zeros((6, 6, len(at)))
    fields = _quadratics(at, at).transpose(0, 2, 1)
    fields[..., 1:3] = nodes.transpose(2, 0, 1)
    basis = np.linalg.qr(fields)[0]
    return (np.eye(count) - basis @ basis.transpose(0, 2, 1)).transpose(1, 2, 0)
