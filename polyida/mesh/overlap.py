"""Cells that lie on each other, told by the mesh's boundary alone.

The sum of the cells' winding numbers around a point says how many cells cover it, and edges between two cells cancel in
it: it is the winding number of the boundary. It exceeds one somewhere if and only if it does beside the boundary.
"""

import numpy as np

from polyida.mesh import topology

DEPTH = 1e-4  # of an edge's length: what overlaps by less was drawn to touch
CROSSING = 1e-6  # the same of the ends of two edges that cross
AT_ONCE = 500_000  # pairs of edges


def overlapping_cells(mesh):
    """(cell, other cell) that overlap, or None: where boundary edges cross or the inner side of one is covered twice."""
    edges = mesh.boundary_edges
    places = mesh.points - mesh.points.min(axis=0)
    places = places[:, ::-1] * [-1, 1] if np.ptp(places[:, 1]) > np.ptp(places[:, 0]) else places
    start, end = places[edges[:, 0]], places[edges[:, 1]]
    along = end - start
    inner = start + along / 2 + DEPTH * np.column_stack([-along[:, 1], along[:, 0]])
    round_off = 8 * np.finfo(float).eps * np.abs(mesh.points).max()
    cover = np.zeros(len(edges), int)
    for i, j in _side_by_side(start[:, 0], end[:, 0], inner[:, 0]):
        crossing = np.flatnonzero(_cross(start, end, i, j, round_off))
        if crossing.size:
            return _owner(mesh, edges[i[crossing[0]]]), _owner(mesh, edges[j[crossing[0]]])
        for point, edge in ((i, j), (j, i)):
            cover += np.bincount(point, _winding(inner[point], start[edge], end[edge]), len(edges)).astype(int)
    cover += _winding(inner, start, end)
    twice = np.flatnonzero(cover > 1)
    return _covering(mesh, places, inner[twice[0]], _owner(mesh, edges[twice[0]])) if twice.size else None


def _side_by_side(*places):
    """Pairs (i, j), i before j in x, of edges whose ranges of x meet, a bounded number at once."""
    low, high = np.min(places, axis=0), np.max(places, axis=0)
    order = np.argsort(low, kind="stable")
    reach = np.searchsorted(low[order], high[order], side="right") - np.arange(1, len(order) + 1)
    begin = 0
    while begin < len(order):
        room = np.searchsorted(np.cumsum(reach[begin:]), AT_ONCE, side="right")
        part = np.arange(begin, begin + max(1, int(room)))[: len(order) - begin]
        count = reach[part]
        step = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        first = np.repeat(part, count)
        yield order[first], order[first + 1 + step]
        begin = part[-1] + 1


def _winding(points, start, end):
    """What each edge adds to the winding number about its point, told by a ray upwards: 1 leftwards, -1 rightwards, 0."""
    right = (start[:, 0] <= points[:, 0]) & (points[:, 0] < end[:, 0])
    left = (end[:, 0] <= points[:, 0]) & (points[:, 0] < start[:, 0])
    side = topology.cross(end - start, points - start)
    return (left & (side > 0)).astype(int) - (right & (side < 0))


def _cross(start, end, i, j, round_off):
    """(pairs,) mask: the ends of each edge lie on both sides of the other."""
    length = np.hypot(*(end - start).T)
    depth = CROSSING * np.minimum(length[i], length[j]) + round_off

    def parted(a, b):
        side = [topology.cross(end[a] - start[a], ends[b] - start[a]) / length[a] for ends in (start, end)]
        return (np.minimum(*side) < -depth) & (np.maximum(*side) > depth)

    return parted(i, j) & parted(j, i)


def _owner(mesh, edge):
    """The cell of a boundary edge."""
    found = (topology.directed_edges(mesh.nodes, mesh.offsets) == edge).all(axis=1)
    return int(topology.corner_cells(mesh.offsets)[np.argmax(found)])


def _covering(mesh, places, point, own):
    """(own, another cell) of those around a point."""
    start, end = (places[nodes] for nodes in topology.directed_edges(mesh.nodes, mesh.offsets).T)
    around = np.add.reduceat(_winding(np.broadcast_to(point, start.shape), start, end), mesh.offsets[:-1])
    return own, int(next(cell for cell in np.flatnonzero(around) if cell != own))
