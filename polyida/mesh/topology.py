"""Polygons in offset form: areas, moments, edges, corners and numbering, without loops over cells."""

import numpy as np


def following(offsets):
    """Return the index of the next corner of the cell, for each corner."""
    step = np.arange(1, offsets[-1] + 1)
    step[offsets[1:] - 1] = offsets[:-1]
    return step


def preceding(offsets):
    """Return the index of the previous corner of the cell, for each corner."""
    step = np.arange(-1, offsets[-1] - 1)
    step[offsets[:-1]] = offsets[1:] - 1
    return step


def corner_cells(offsets):
    """Return the number of the cell of each corner, (corners,)."""
    return np.repeat(np.arange(len(offsets) - 1), np.diff(offsets))


def cross(a, b):
    """Return the z component a_x b_y - a_y b_x of plane vectors (..., 2)."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _fan(points, nodes, offsets):
    """(first corner of each cell; corners and next corners relative to it, which keeps digits far from the origin)."""
    start = points[nodes[offsets[:-1]]]
    base = np.repeat(start, np.diff(offsets), axis=0)
    here = points[nodes] - base
    return start, here, here[following(offsets)]


def areas(points, nodes, offsets):
    """Return the signed areas (n_cells,), positive counter-clockwise."""
    _, here, there = _fan(points, nodes, offsets)
    return 0.5 * np.add.reduceat(cross(here, there), offsets[:-1])


def centroids(points, nodes, offsets):
    """Return the centroids (n_cells, 2) of polygons with straight sides."""
    start, here, there = _fan(points, nodes, offsets)
    twice = cross(here, there)
    moment = np.add.reduceat((here + there) * twice[:, None], offsets[:-1])
    return start + moment / (3.0 * np.add.reduceat(twice, offsets[:-1])[:, None])


_PLACES, _WEIGHTS = np.polynomial.legendre.leggauss(4)  # exact for the second moments of parabolas
_SHARE = (1.0 + _PLACES) / 2.0
SIDE = np.stack([(1 - _SHARE) * (1 - 2 * _SHARE), 4 * _SHARE * (1 - _SHARE), _SHARE * (2 * _SHARE - 1)], axis=1)
"""(points, 3): the functions of corner, middle node and next corner of a side at points along it."""
SIDE_SLOPES = np.stack([4 * _SHARE - 3, 4 - 8 * _SHARE, 4 * _SHARE - 1], axis=1) * _WEIGHTS[:, None] / 2.0
"""(points, 3): their derivatives along the side times the weights of the points."""


def parabolas(sides):
    """Points (points, k, 2) along sides (k, 3, 2) that are parabolas, and their pieces dx (points, k, 2)."""
    return np.einsum("gj,kjd->gkd", SIDE, sides), np.einsum("gj,kjd->gkd", SIDE_SLOPES, sides)


def curved_measures(points, nodes, offsets):
    """Return areas (n_cells,) and centroids (n_cells, 2) of cells of order 2."""
    start, here, there = _fan(points, nodes, offsets)
    x, dx = parabolas(np.stack([here[::2], here[1::2], there[1::2]], axis=1))
    twice, first = cross(x, dx), offsets[:-1] // 2
    area = np.add.reduceat(twice.sum(axis=0), first) / 2.0
    moment = np.add.reduceat((x * twice[..., None]).sum(axis=0), first) / 3.0
    return area, start + moment / np.where(area == 0.0, 1.0, area)[:, None]


def directed_edges(nodes, offsets):
    """Return the (corners, 2) node pairs in the cells' direction."""
    return np.stack([nodes, nodes[following(offsets)]], axis=1)


def edges(nodes, offsets, n_nodes):
    """Return the edges (n_edges, 2), each once, lower node first."""
    pairs = np.sort(directed_edges(nodes, offsets), axis=1).astype(np.int64)
    keys = np.unique(pairs[:, 0] * n_nodes + pairs[:, 1])
    return np.stack([keys // n_nodes, keys % n_nodes], axis=1).astype(np.int32)


def inserted(nodes, offsets, edges, new):
    """Return (nodes, offsets) with the nodes `new` (k,) between the ends of edges (k, 2), in every cell that has the edge."""
    total = int(nodes.max()) + 1
    keys, wanted = (
        pairs[:, 0].astype(np.int64) * total + pairs[:, 1] for pairs in (np.sort(directed_edges(nodes, offsets)), np.sort(edges))
    )
    at, order = np.flatnonzero(np.isin(keys, wanted)), np.argsort(wanted)
    place = order[np.searchsorted(wanted, keys[at], sorter=order)]
    added = np.concatenate([[0], np.cumsum(np.bincount(corner_cells(offsets)[at], minlength=len(offsets) - 1))])
    return np.insert(nodes, at + 1, np.asarray(new)[place]), offsets + added


def boundary_edges(nodes, offsets, n_nodes):
    """Return the directed edges (n_boundary_edges, 2) whose reverse belongs to no cell."""
    pairs = directed_edges(nodes, offsets)
    wide = pairs.astype(np.int64)
    inner = np.isin(wide[:, 0] * n_nodes + wide[:, 1], wide[:, 1] * n_nodes + wide[:, 0])
    return pairs[~inner]


def turns(points, nodes, offsets):
    """Return the exterior angle at each corner, rad: positive convex, 0 straight, negative reflex."""
    corner = points[nodes]
    ahead = corner[following(offsets)] - corner
    behind = ahead[preceding(offsets)]
    return np.arctan2(cross(behind, ahead), np.einsum("ij,ij->i", behind, ahead))


def ring_turns(ring):
    """Return the exterior angles, rad, at the corners of one closed polygon (n, 2)."""
    return turns(ring, np.arange(len(ring)), np.array([0, len(ring)]))


def half_bandwidth(nodes, offsets):
    """Return the largest difference of node numbers within a cell."""
    return int((np.maximum.reduceat(nodes, offsets[:-1]) - np.minimum.reduceat(nodes, offsets[:-1])).max())


def area_moments(mesh):
    """Return (area, m^2; centroid (2,), m; polar second moment about the centroid, m^4) of all cells together.

    For a polygon of corners x_i, c_i = x_i cross x_(i + 1): `A = sum c_i / 2`, `A x_S = sum c_i (x_i + x_(i + 1)) / 6`,
    `J = sum c_i (x_i . x_i + x_i . x_(i + 1) + x_(i + 1) . x_(i + 1)) / 12`, each about the mesh's mean point to avoid cancellation.
    """
    centre = mesh.points.mean(axis=0)
    x = mesh.points[mesh.nodes] - centre
    y = x[following(mesh.offsets)]
    across = cross(x, y)
    area = across.sum() / 2
    first = across @ (x + y) / 6
    second = across @ ((x * x).sum(axis=1) + (x * y).sum(axis=1) + (y * y).sum(axis=1)) / 12
    return float(area), centre + first / area, float(second - first @ first / area)


def renumber(points, nodes, offsets):
    """Return (points, nodes, offsets, new number of each old node) with a small half bandwidth.

    Nodes are ordered along the longer side of the bounding box or by reverse Cuthill-McKee, whichever is better, cells by their nodes.
    """
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    axis = int(np.ptp(points[:, 1]) > np.ptp(points[:, 0]))
    # nodes of a common cell are neighbours; the order starts at the low end of the axis
    cells = csr_array((np.ones(len(nodes), dtype=np.int32), nodes, offsets), shape=(len(offsets) - 1, len(points)))
    graph = (cells.T @ cells).tocsr()
    reverse = np.asarray(reverse_cuthill_mckee(graph, symmetric_mode=True))
    reverse = reverse if points[reverse[0], axis] <= points[reverse[-1], axis] else reverse[::-1]
    orders = [np.lexsort((points[:, 1 - axis], points[:, axis])), reverse]
    number = min(map(np.argsort, orders), key=lambda rank: half_bandwidth(rank[nodes], offsets))
    placed = np.empty_like(points)
    placed[number] = points
    nodes, offsets = sorted_cells(number[nodes], offsets)
    return placed, nodes, offsets, number


def sorted_cells(nodes, offsets):
    """Return (nodes, offsets) of the cells ordered by the sum of their lowest and highest node, each starting at its lowest node."""
    low, high = np.minimum.reduceat(nodes, offsets[:-1]), np.maximum.reduceat(nodes, offsets[:-1])
    order = np.lexsort((low, low + high))
    cell, size = corner_cells(offsets), np.diff(offsets)
    first = np.flatnonzero(nodes == low[cell])
    place = (np.arange(len(nodes)) - first[cell]) % size[cell]
    nodes = nodes[np.lexsort((place, np.argsort(order)[cell]))]
    return nodes, np.concatenate([[0], np.cumsum(size[order])])
