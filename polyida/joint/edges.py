"""Edges of a body, or a point, that face the edges of another body: pieces of both sides and mortar weights of gaps.

A point has a gap for each edge on which its projection lies, its distance. A node i of a side has the gap `g_i = int N_i gap ds / int N_i ds`,
m, over what faces the second side; N_i is its hat function, gap the distance from the line of the facing edge. Each edge of the first side
is cut where nodes of the second side project onto it, along its normal; two Gauss points a piece integrate exactly while both sides are nearly parallel. The derivative of a gap by q with constant weights is
exact where the gap is zero.

What faces what changes with q, so that the arrays of a scene have no products of these rows; `links_at` appends them.

Puso, Laursen, Comput. Methods Appl. Mech. Engrg. 193 (2004) 601-629; Popp, Gee, Wall, Int. J. Numer. Meth. Engng. 79 (2009) 1354-1391.
"""

from copy import copy
from typing import NamedTuple

import numpy as np

from polyida.errors import InputError
from polyida.jit import entry, part
from polyida.joint.attachment import Ground
from polyida.validation import complex_of_pairs, pairs_of

OPPOSED = 0.3  # least cosine of the angle between an edge and the reverse of one that it faces
SHORT = 1e-9  # of an edge: a piece that is shorter is left out
GAUSS = 0.5 / np.sqrt(3.0)  # of a piece, from its middle
CORNER = 1.0  # rad: a section that turns by more at a node has a corner there
BESIDE = 1e-6  # of an edge: a point faces it up to so far beyond its ends


class Pieces(NamedTuple):
    """Products of rows: row (k,), edge (k,) of the second side, points (k, 2) of the first side, weights (k, 4) of these and of the edge's ends.

    `w = sum of weights times points` is the part of the mean vector from the second side to the first one that the row has on this edge.
    """

    row: np.ndarray
    edge: np.ndarray
    points: np.ndarray
    weights: np.ndarray


class FacingEdges:
    """Two sides: edges (k, 2) of numbers among the points of the first side, (0, 0) if that is a point; others: of the second side.

    first, second: nodes of the sides, attachments. count: rows. reach: deepest penetration that counts, m; in the reference configuration all that is within the rim of
    the second body counts.
    """

    def __init__(self, label, a, b):
        """label: of the contact, in messages. a, b: sections or points; b has edges."""
        alone = not a.has_edges
        self.first, self.second = [a] if alone else a.each(), b.each()
        self.edges = np.zeros((1, 2), np.int64) if alone else _edges(label, a)
        if not alone:
            _require_smooth(label, a, self)
        self.others = _edges(label, b)
        self.count = len(self.others) if alone else len(self.first)
        lengths = (np.linalg.norm(x[edges[:, 1]] - x[edges[:, 0]], axis=1) for x, edges in zip(self.rest, (self.edges, self.others)))
        depths = (getattr(side, "depth", 0.0) or np.inf for side in (a, b))
        self.reach = 0.5 * min(max(float(length.max()) for length in lengths), *depths)
        self.rim = _rim(b, self.rest[1][self.others])

    @property
    def rest(self):
        """Places of the nodes of both sides in the reference configuration, (k, 2) each, m."""
        return tuple(np.array([node.point for node in side]) for side in (self.first, self.second))

    def pieces(self, x, y, reach=None):
        """The Pieces of points x (k, 2) of the first side and y of the second side. reach: deepest penetration that counts, by default its own."""
        most = 4 * len(self.edges) * len(self.others)
        found = Pieces(*(np.empty(most, np.int64) for _ in range(2)), np.empty((most, 2), np.int64), np.empty((most, 4)))
        count = find_pieces(x, self.edges, y, self.others, self.reach if reach is None else reach, found)
        return Pieces(*(values[:count] for values in found))

    def gaps(self, far):
        """Gaps in the reference configuration, (rows,), `far` where nothing faces."""
        (x, y), result, rows = self.rest, np.full(self.count, far), np.ones(self.count, bool)
        for reach in (self.reach, np.inf):
            pieces = self.pieces(x, y, reach)
            pieces = Pieces(*(values[rows[pieces.row]] for values in pieces))
            result[pieces.row] = 0.0
            d, w = directions(self, y, pieces), np.einsum("ki,kij->kj", pieces.weights, self.places(x, y, pieces))
            np.add.at(result, pieces.row, d[:, 0] * w[:, 1] - d[:, 1] * w[:, 0])
            found = result < 0.0
            rows = np.resize(_within(x, self.rim) & ~(found if len(x) == self.count else found.any()), self.count)  # deeper than reach
        return result

    def places(self, x, y, pieces):
        """The four points of each product, (k, 4, 2): two of `x`, then two of the edges' ends in `y`."""
        return np.concatenate([x[pieces.points], y[self.others[pieces.edge]]], axis=1)


def _rim(side, edges):
    """Edges in the reference configuration, (k, 2, 2), around the body of a side that has these edges; none if they are not known."""
    mesh, ends = getattr(side.body, "mesh", None), edges.reshape(-1, 4)
    if mesh is not None:
        return side.body.points[mesh.boundary_edges]
    closed = {tuple(end) for end in ends[:, :2]} == {tuple(end) for end in ends[:, 2:]}
    return edges if closed else edges[:0]


def _within(x, rim):
    """True for the points x (k, 2) that a ray to the left joins to an odd number of edges (n, 2, 2)."""
    (ax, ay), (bx, by) = (rim[:, end].T for end in (0, 1))
    px, py = x.T[..., None]
    with np.errstate(divide="ignore", invalid="ignore"):
        left = ax + (py - ay) * (bx - ax) / (by - ay) < px
    return (((ay > py) != (by > py)) & left).sum(axis=1) % 2 == 1


def directions(sides, y, pieces):
    """Unit vectors, (k, 2), along the edges of the second side, which is on their right."""
    ends = y[sides.others[pieces.edge]]
    along = ends[:, 0] - ends[:, 1]
    return along / np.hypot(*along.T)[:, None]


def _edges(label, side):
    """The `edge_ends` of a side. Raises InputError if a node of it has none."""
    edges, nodes = side.edge_ends(), side.each()
    if missing := set(range(len(nodes))) - set(edges.ravel().tolist()):
        raise InputError(f"{label}: {nodes[min(missing)].name} of {side!r} has no edge of the plate's rim within the section")
    return edges


def _require_smooth(label, side, sides):
    """Raise InputError for a corner within the first side, where mean gaps let it penetrate."""
    x, edges = sides.rest[0], sides.edges
    for i, j in edges:
        for k in edges[edges[:, 0] == j, 1]:
            (ax, ay), (bx, by) = x[j] - x[i], x[k] - x[j]
            angle = abs(np.arctan2(ax * by - ay * bx, ax * bx + ay * by))
            if angle > CORNER:
                advice = "give each side a contact of its own, and corners that may touch one as points, plate.node(...) or body.at(...)"
                raise InputError(f"{label}: {side!r} turns by {np.degrees(angle):.0f} degrees at {sides.first[j].name}; {advice}")


@part
def gap_at(px, py, nodes, others, edge):
    """Distance of a point from the line of an edge, positive outside of the second side."""
    bx, by = nodes[others[edge, 0], 0], nodes[others[edge, 0], 1]
    dx, dy = nodes[others[edge, 1], 0] - bx, nodes[others[edge, 1], 1] - by
    return ((px - bx) * dy - (py - by) * dx) / np.sqrt(dx * dx + dy * dy)


@part
def place_on(px, py, nodes, others, edge):
    """Where a point projects onto an edge: 0 at its first end, 1 at its second one."""
    bx, by = nodes[others[edge, 0], 0], nodes[others[edge, 0], 1]
    dx, dy = nodes[others[edge, 1], 0] - bx, nodes[others[edge, 1], 1] - by
    return ((px - bx) * dx + (py - by) * dy) / (dx * dx + dy * dy)


@part
def nearer_beside(px, py, nodes, others, edge, gap):
    """True if a point behind an edge, near a corner that sticks out, is less deep behind the edge on the other side of the corner."""
    if gap >= 0.0:
        return False
    for g in range(others.shape[0]):
        one, other = (edge, g) if others[edge, 1] == others[g, 0] else (g, edge)
        if g == edge or others[one, 1] != others[other, 0]:
            continue
        ax, ay = nodes[others[one, 1], 0] - nodes[others[one, 0], 0], nodes[others[one, 1], 1] - nodes[others[one, 0], 1]
        bx, by = nodes[others[other, 1], 0] - nodes[others[other, 0], 0], nodes[others[other, 1], 1] - nodes[others[other, 0], 1]
        along = place_on(px, py, nodes, others, g)
        if ax * by - ay * bx > 0.0 and gap < gap_at(px, py, nodes, others, g) and abs(along - 0.5) <= 0.5 + BESIDE:
            return True
    return False


@part
def add(weights, at, weight, xi, eta):
    """Add to the weights of product `at` the weight times the vector from the edge of the second side at eta to that of the first one at xi."""
    weights[at, 0] += weight * (1.0 - xi)
    weights[at, 1] += weight * xi
    weights[at, 2] -= weight * (1.0 - eta)
    weights[at, 3] -= weight * eta


@part
def in_wedge(px, py, nodes, others, edge, place):
    """True for a point, projected to `place` beyond an end of an edge, in the wedge behind a reentrant corner: beyond both of its edges."""
    inside = False
    for g in range(others.shape[0]):
        if others[g, 0] == others[edge, 1] and place > 1.0:
            inside = place_on(px, py, nodes, others, g) < 0.0
        elif others[g, 1] == others[edge, 0] and place < 0.0:
            inside = place_on(px, py, nodes, others, g) > 1.0
    return inside


@part
def add_point(first, node, second, others, reach, found, total, count):
    """Add a product for each edge that a point faces, of the row of that edge. Returns the number of all products."""
    px, py = first[node, 0], first[node, 1]
    for f in range(others.shape[0]):
        gap, eta = gap_at(px, py, second, others, f), place_on(px, py, second, others, f)
        at, inside = min(max(eta, 0.0), 1.0), False
        if gap <= 0.0 and eta != at:
            inside = in_wedge(px, py, second, others, f, eta)
        if gap >= -reach and (inside or (abs(eta - at) <= BESIDE and not nearer_beside(px, py, second, others, f, gap))):
            found.row[count], found.edge[count], found.points[count, :], found.weights[count, :] = f, f, node, 0.0
            add(found.weights, count, 1.0, 0.0, at)
            total[f], count = 1.0, count + 1
    return count


@part
def find_overlaps(line, second, others, low, high, cuts):
    """Fill the part of an edge, low to high in [0, 1], that faces each other edge, -1 for high if none does, and all ends. Returns their number.

    line: first end (px, py) of the edge, unit vector (tx, ty) along it, and its length.
    """
    (px, py, tx, ty, length), ends = line, 0
    for f in range(others.shape[0]):
        bx, by = second[others[f, 0], 0], second[others[f, 0], 1]
        dx, dy = second[others[f, 1], 0] - bx, second[others[f, 1], 1] - by
        start = ((bx - px) * tx + (by - py) * ty) / length
        end = start + (dx * tx + dy * ty) / length
        low[f], high[f] = max(0.0, end), min(1.0, start)
        if tx * dx + ty * dy < -OPPOSED * np.sqrt(dx * dx + dy * dy) and high[f] - low[f] > SHORT:
            cuts[ends], cuts[ends + 1], ends = low[f], high[f], ends + 2
        else:
            high[f] = -1.0
    return ends


@part
def nearest_edge(x, y, place, second, others, reach, low, high):
    """The edge that faces an edge's point (x, y) at `place` with the least gap of at least -reach; -1 if none does."""
    best, least = -1, np.inf
    for f in range(others.shape[0]):
        if low[f] <= place <= high[f]:
            gap = gap_at(x, y, second, others, f)
            if -reach <= gap < least:
                best, least = f, gap
    return best


@entry
def find_pieces(first, edges, second, others, reach, found):
    """Fill the products of all rows: those of points, or of the pieces of edges at two Gauss points each. Returns their number."""
    count, others_count = 0, others.shape[0]
    total = np.zeros(max(first.shape[0], others_count))
    low, high, cuts = np.empty(others_count), np.empty(others_count), np.empty(2 * others_count)
    for e in range(edges.shape[0]):
        i, j = edges[e, 0], edges[e, 1]
        px, py = first[i, 0], first[i, 1]
        if i == j:
            count = add_point(first, i, second, others, reach, found, total, count)
            continue
        tx, ty = first[j, 0] - px, first[j, 1] - py
        length = np.sqrt(tx * tx + ty * ty)
        tx, ty = tx / length, ty / length
        ends = find_overlaps((px, py, tx, ty, length), second, others, low, high, cuts)
        cuts[:ends].sort()
        for k in range(ends - 1):
            if cuts[k + 1] - cuts[k] <= SHORT:
                continue
            middle = 0.5 * (cuts[k] + cuts[k + 1])
            best = nearest_edge(px + middle * length * tx, py + middle * length * ty, middle, second, others, reach, low, high)
            if best < 0:
                continue
            bx, by = second[others[best, 0], 0], second[others[best, 0], 1]
            dx, dy = second[others[best, 1], 0] - bx, second[others[best, 1], 1] - by
            for one, node in ((count, i), (count + 1, j)):
                found.row[one], found.edge[one], found.weights[one, :] = node, best, 0.0
                found.points[one, 0], found.points[one, 1] = i, j
            w = 0.5 * (cuts[k + 1] - cuts[k]) * length
            for sign in (-1.0, 1.0):
                xi = middle + sign * GAUSS * (cuts[k + 1] - cuts[k])
                eta = ((px - bx) * tx + (py - by) * ty + xi * length) / (dx * tx + dy * ty)
                add(found.weights, count, w * (1.0 - xi), xi, eta)
                add(found.weights, count + 1, w * xi, xi, eta)
                total[i] += w * (1.0 - xi)
                total[j] += w * xi
            count += 2
    for k in range(count):
        for c in range(4):
            found.weights[k, c] /= total[found.row[k]]
    return count


class EdgeRows:
    """The rows of one contact between edges in a scene: their products at a position of the points. first: number of its first row; far: gap of a point that faces nothing, m."""

    def __init__(self, first, contact, points, far):
        """first: number of its first row. points: those of all joints, to which it adds. far: distance of a place that no edge reaches."""
        sides = self.sides = contact.edges
        self.first, self.far, self.step = first, far, 2 if contact.friction else 1
        self.held = isinstance(sides.first[0], Ground)  # it moves with any point, weighted by 0
        a, self.b = ([0 if isinstance(node, Ground) else points.add(node) for node in side] for side in (sides.first, sides.second))
        self.numbers, self.rest = np.array([*a, *self.b]), np.concatenate(sides.rest)
        self.rows, self.points = first + self.step * np.arange(sides.count), len(a)

    def at(self, first):
        """A copy of these rows whose first row has the number `first`."""
        other = copy(self)
        other.first, other.rows = first, self.rows + (first - self.first)
        return other

    def products(self, dz):
        """(numbers of the rows of gaps, [(points (k, j), complex weights (k, j), values in the reference configuration (k,)) of three vectors of each product]).

        The vectors are the direction of the edge, the same turned by a right angle, and the mean vector from the edge to the first side.
        """
        count, at_rest = self.points, complex_of_pairs(self.rest)
        moves = self.rest + dz[self.numbers]
        moves[:count] = self.rest[:count] if self.held else moves[:count]
        pieces = self.sides.pieces(moves[:count], moves[count:])
        ends = count + self.sides.others[pieces.edge]
        along = complex_of_pairs(moves[ends[:, 0]] - moves[ends[:, 1]])
        direction = np.outer(1.0 / np.abs(along), (1.0 + 0j, -1.0))
        corners, weights = np.concatenate([pieces.points, ends], axis=1), pieces.weights + 0j
        vectors = [(ends, direction), (ends, 1j * direction), (corners, weights)]
        vectors = [(self.numbers[at], w, (w * at_rest[at]).sum(axis=1)) for at, w in vectors]
        if self.held:
            vectors[2][1][:, :2] = 0.0
        return self.rows[pieces.row], vectors


def links_at(links, contacts, dz):
    """Links with the products of the EdgeRows at displacements dz of the points."""
    constant, first = links.row_constant.copy(), len(links.vector_rest)
    product, vector = ([], [], [], []), ([], [], [], [])
    for contact in contacts:
        rows, vectors = contact.products(dz)
        constant[contact.rows] = contact.far
        constant[rows] = 0.0
        number = first + np.arange(3 * len(rows)).reshape(3, -1)
        first += number.size
        for points, weights, rest in vectors:
            for whole, each in zip(vector, (np.full(len(rows), points.shape[1]), points.ravel(), weights.ravel(), rest)):
                whole.append(each)
        for offset, one, rate in ((0, 1, False), (1, 0, True))[: contact.step]:  # the gap, and the slip
            for whole, each in zip(product, (rows + offset, number[one], number[2], np.full(len(rows), rate))):
                whole.append(each)
    rows, one, other, rate = map(np.concatenate, product)
    size, points, weights, rest = map(np.concatenate, vector)
    count = len(rows)
    return links._replace(
        row_constant=constant,
        product_row=np.append(links.product_row, rows),
        product_first=np.append(links.product_first, one),
        product_second=np.append(links.product_second, other),
        product_drive=np.append(links.product_drive, np.full(count, -1)),
        product_one_way=np.append(links.product_one_way, np.zeros(count, bool)),
        product_rate=np.append(links.product_rate, rate),
        vector_rest=np.concatenate([links.vector_rest, pairs_of(rest)]),
        vector_start=np.append(links.vector_start, links.vector_start[-1] + np.cumsum(size)),
        vector_points=np.append(links.vector_points, points),
        vector_weights=np.concatenate([links.vector_weights, pairs_of(weights)]),
    )
