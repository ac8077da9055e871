"""From Voronoi ridges to clean polygons: short edges collapsed, corners that lost convexity relaxed."""

from dataclasses import dataclass

import numpy as np

from polyida.mesh import topology


@dataclass
class Polygons:
    """Working mesh of the mesher: points, nodes, offsets, and rank of each point (0 inside, 1 on a wall, 2 fixed)."""

    points: np.ndarray
    nodes: np.ndarray
    offsets: np.ndarray
    rank: np.ndarray


def compact(points, cell, corner, rank):
    """Polygons from corners sorted by cell, keeping used points only; cells with fewer than three corners vanish."""
    count = np.bincount(cell)
    keep = count[cell] >= 3
    cell, corner = cell[keep], corner[keep]
    used, nodes = np.unique(corner, return_inverse=True)
    count = count[count >= 3]
    return Polygons(points[used], nodes, np.concatenate([[0], np.cumsum(count)]), rank[used])


def merge(polygons, target):
    """Polygons after node i became node target[i]: repeated corners of a cell go, and cells without area."""
    corner, cell = target[polygons.nodes], topology.corner_cells(polygons.offsets)
    same = corner == corner[topology.preceding(polygons.offsets)]
    return compact(polygons.points, cell[~same], corner[~same], polygons.rank)


def collapse(polygons, share=0.1, project=None):
    """Edges shorter than share of the mean edge collapsed, to the node of highest rank or the mean of those.

    Two fixed nodes merge only where they coincide, two boundary nodes never through the inside: that would pinch
    the domain.
    project(points) puts merged wall nodes back on their wall.
    """
    for _ in range(50):
        edges = topology.edges(polygons.nodes, polygons.offsets, len(polygons.points))
        length = np.linalg.norm(polygons.points[edges[:, 0]] - polygons.points[edges[:, 1]], axis=1)
        short = np.flatnonzero((length < share * length.mean()) & _may_merge(polygons, edges, length))
        if short.size == 0:
            break
        short = _independent(edges, short[np.argsort(length[short], kind="stable")])
        polygons = _contract(polygons, edges[short], project)
    return polygons


def _may_merge(polygons, edges, length):
    n = len(polygons.points)
    rim = np.sort(topology.boundary_edges(polygons.nodes, polygons.offsets, n), axis=1).astype(np.int64)
    on_rim = np.zeros(n, dtype=bool)
    on_rim[rim] = True
    across = on_rim[edges].all(axis=1) & ~np.isin(edges[:, 0].astype(np.int64) * n + edges[:, 1], rim[:, 0] * n + rim[:, 1])
    return ~across & (~(polygons.rank[edges] == 2).all(axis=1) | (length < 1e-6 * length.mean()))


def _independent(edges, order):
    """Edges, shortest first, that share no node with one taken before: one sweep merges pairs only."""
    taken, chosen = set(), []
    for index, (a, b) in zip(order.tolist(), edges[order].tolist(), strict=True):
        if a not in taken and b not in taken:
            taken.update((a, b))
            chosen.append(index)
    return np.array(chosen)


def _contract(polygons, pairs, project):
    a, b = pairs.T
    swap = polygons.rank[b] > polygons.rank[a]
    keep, drop = np.where(swap, b, a), np.where(swap, a, b)
    level = polygons.rank[keep] == polygons.rank[drop]
    points = polygons.points.copy()
    points[keep[level]] = 0.5 * (points[keep[level]] + points[drop[level]])
    wall = keep[level & (polygons.rank[keep] == 1)]
    if project is not None and wall.size:
        points[wall] = project(points[wall])
    target = np.arange(len(points))
    target[drop] = keep
    return merge(Polygons(points, polygons.nodes, polygons.offsets, polygons.rank), target)


def drop_flat_rim_nodes(polygons, smallest_turn=0.03):
    """Wall nodes of one cell only, flat or concave there, go: reflection leaves such along curved walls."""
    turn = topology.turns(polygons.points, polygons.nodes, polygons.offsets)
    single = np.bincount(polygons.nodes, minlength=len(polygons.points))[polygons.nodes] == 1
    drop = single & (polygons.rank[polygons.nodes] == 1) & (turn < smallest_turn)
    if not drop.any():
        return polygons
    cell = topology.corner_cells(polygons.offsets)
    left = np.bincount(cell[~drop], minlength=len(polygons.offsets) - 1)
    drop &= left[cell] >= 3
    return compact(polygons.points, cell[~drop], polygons.nodes[~drop], polygons.rank)


def relax(polygons, project, smallest_turn=0.03, sweeps=20):
    """Nodes where a cell turns by less than smallest_turn (rad) move half way to the mean of their neighbours.

    A node at the mean of its neighbours has every angle below 180 degrees; wall nodes use their wall neighbours.
    """
    polygons = Polygons(polygons.points.copy(), polygons.nodes, polygons.offsets, polygons.rank)
    edges = topology.edges(polygons.nodes, polygons.offsets, len(polygons.points))
    on_wall = np.zeros(len(polygons.points), dtype=bool)
    on_wall[topology.boundary_edges(polygons.nodes, polygons.offsets, len(polygons.points))] = True
    edges = np.concatenate([edges, edges[:, ::-1]])
    edges = edges[~on_wall[edges[:, 0]] | on_wall[edges[:, 1]]]
    for _ in range(sweeps):
        turn = topology.turns(polygons.points, polygons.nodes, polygons.offsets)
        flat = np.unique(polygons.nodes[turn < smallest_turn])
        flat = flat[polygons.rank[flat] < 2]
        if flat.size == 0:
            break
        _towards_neighbours(polygons, edges, flat, project)
    return polygons


def _towards_neighbours(polygons, edges, moving, project):
    n = len(polygons.points)
    count = np.maximum(np.bincount(edges[:, 0], minlength=n), 1)
    for k in (0, 1):
        mean = np.bincount(edges[:, 0], polygons.points[edges[:, 1], k], n) / count
        polygons.points[moving, k] += 0.5 * (mean[moving] - polygons.points[moving, k])
    wall = moving[polygons.rank[moving] == 1]
    if wall.size:
        polygons.points[wall] = project(polygons.points[wall])
