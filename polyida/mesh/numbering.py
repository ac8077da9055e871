"""Numbering of nodes and cells along the long axis: small half bandwidth of everything assembled on the mesh."""

import numpy as np

from polyida.mesh import topology


def renumber(points, nodes, offsets):
    """(points, nodes, offsets, new number of each old node): by coordinate along the longer side of the bounding box
    or by reverse Cuthill-McKee, whichever gives the smaller half bandwidth; cells by their lowest node."""
    axis = int(np.ptp(points[:, 1]) > np.ptp(points[:, 0]))
    orders = [np.lexsort((points[:, 1 - axis], points[:, axis])), _cuthill_mckee(points, nodes, offsets, axis)]
    ranks = [_inverse(order) for order in orders]
    number = min(ranks, key=lambda rank: topology.half_bandwidth(rank[nodes], offsets))
    placed = np.empty_like(points)
    placed[number] = points
    nodes, offsets = sorted_cells(number[nodes], offsets)
    return placed, nodes, offsets, number


def sorted_cells(nodes, offsets):
    """Cells ordered by the sum of their lowest and highest node, each starting at its lowest node."""
    low, high = np.minimum.reduceat(nodes, offsets[:-1]), np.maximum.reduceat(nodes, offsets[:-1])
    order = np.lexsort((low, low + high))
    cell, size = topology.corner_cells(offsets), np.diff(offsets)
    first = np.flatnonzero(nodes == low[cell])
    place = (np.arange(len(nodes)) - first[cell]) % size[cell]
    nodes = nodes[np.lexsort((place, _inverse(order)[cell]))]
    return nodes, np.concatenate([[0], np.cumsum(size[order])])


def _inverse(order):
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    return rank


def _cuthill_mckee(points, nodes, offsets, axis):
    """Order of the nodes, from the low end of the axis; neighbours are all nodes of a common cell."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    cells = csr_array((np.ones(len(nodes), dtype=np.int32), nodes, offsets), shape=(len(offsets) - 1, len(points)))
    graph = (cells.T @ cells).tocsr()
    order = np.asarray(reverse_cuthill_mckee(graph, symmetric_mode=True))
    return order if points[order[0], axis] <= points[order[-1], axis] else order[::-1]
