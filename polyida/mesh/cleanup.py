"""From Voronoi ridges to clean convex polygons: short edges collapsed, flat corners relaxed, concave cells cut, re-entrant corners kept."""

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
        n = len(polygons.points)
        rim = np.sort(topology.boundary_edges(polygons.nodes, polygons.offsets, n), axis=1).astype(np.int64)
        on_rim = np.zeros(n, dtype=bool)
        on_rim[rim] = True
        across = on_rim[edges].all(axis=1) & ~np.isin(edges[:, 0].astype(np.int64) * n + edges[:, 1], rim[:, 0] * n + rim[:, 1])
        short = np.flatnonzero(
            (length < share * length.mean()) & (~across & (~(polygons.rank[edges] == 2).all(axis=1) | (length < 1e-6 * length.mean())))
        )
        if short.size == 0:
            break
        short = _independent(edges, short[np.argsort(length[short], kind="stable")])
        a, b = edges[short].T
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
        polygons = merge(Polygons(points, polygons.nodes, polygons.offsets, polygons.rank), target)
    return polygons


def _independent(edges, order):
    """Edges, shortest first, that share no node with one taken before: one sweep merges pairs only."""
    taken, chosen = set(), []
    for index, (a, b) in zip(order.tolist(), edges[order].tolist(), strict=True):
        if a not in taken and b not in taken:
            taken.update((a, b))
            chosen.append(index)
    return np.array(chosen)


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
        n = len(polygons.points)
        count = np.maximum(np.bincount(edges[:, 0], minlength=n), 1)
        for k in (0, 1):
            mean = np.bincount(edges[:, 0], polygons.points[edges[:, 1], k], n) / count
            polygons.points[flat, k] += 0.5 * (mean[flat] - polygons.points[flat, k])
        wall = flat[polygons.rank[flat] == 1]
        if wall.size:
            polygons.points[wall] = project(polygons.points[wall])
    return polygons


def _ring(count):
    """Unit vectors in count directions, beginning half a step above x."""
    angle = (np.arange(count) + 0.5) * (2 * np.pi / count)
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def corner_seeds(domain, corners, spacing):
    """Seeds around each re-entrant corner, at one distance from it: with their images the corner is a Voronoi vertex.

    Each of the k cells there takes the share theta / k < 180 degrees of the interior angle theta, small enough that
    the images of the outer two fit into the other 2 pi - theta.
    """
    rays = (np.arange(720) + 0.5) * (2 * np.pi / 720)
    seeds = []
    for corner in corners:
        inside = domain.distance(corner + 1e-3 * spacing * _ring(720)) < 0.0
        starts = np.flatnonzero(inside & ~np.roll(inside, 1))
        theta = inside.mean() * 2 * np.pi
        if starts.size == 1 and theta > np.pi + 0.05:
            count = int(np.clip(np.ceil(theta / (2 * np.pi - theta) - 0.1), 2, 20))
            angle = rays[starts[0]] - np.pi / 720 + theta * (np.arange(count) + 0.5) / count
            seeds.append(corner + 0.55 * spacing * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    seeds = np.concatenate(seeds) if seeds else np.zeros((0, 2))
    return seeds[domain.distance(seeds) < 0.0] if len(seeds) else seeds


def place_corners(polygons, corners, spacing):
    """The nearest wall node within half a cell of a corner that no node has yet moves there and stays."""
    for corner in corners:
        away = np.linalg.norm(polygons.points - corner, axis=1)
        away[polygons.rank == 0] = np.inf
        nearest = int(np.argmin(away))
        if polygons.rank[nearest] == 1 and away[nearest] < 0.5 * spacing:
            polygons.points[nearest], polygons.rank[nearest] = corner, 2
    return polygons


def split_concave_cells(polygons, smallest_turn=1e-3):
    """Polygons in which every cell that has a corner of 180 degrees or more is cut from there until none has."""
    turn = topology.turns(polygons.points, polygons.nodes, polygons.offsets)
    worst = np.minimum.reduceat(turn, polygons.offsets[:-1])
    if (worst > smallest_turn).all():
        return polygons
    cells = []
    for i, cell in enumerate(np.split(polygons.nodes, polygons.offsets[1:-1])):
        cells.extend([cell] if worst[i] > smallest_turn else _cut(polygons.points, cell, smallest_turn))
    offsets = np.concatenate([[0], np.cumsum([len(cell) for cell in cells])])
    return Polygons(polygons.points, np.concatenate(cells), offsets, polygons.rank)


def _cut(points, cell, smallest_turn):
    """Convex pieces of one cell: each cut starts at the most reflex corner and leaves the best smallest turn."""
    turn = topology.ring_turns(points[cell])
    if len(cell) == 3 or turn.min() > smallest_turn:
        return [cell]
    ring = np.roll(cell, -int(np.argmin(turn)))
    best = max(range(2, len(ring) - 1), key=lambda k: _merit(points, ring[: k + 1], np.r_[ring[0], ring[k:]]))
    pieces = ring[: best + 1], np.r_[ring[0], ring[best:]]
    return [part for piece in pieces for part in _cut(points, piece, smallest_turn)]


def _merit(points, first, second):
    """Smallest turn of the two pieces; hopeless where a piece is turned inside out."""
    corners = points[first], points[second]
    smallest = min(topology.areas(c, np.arange(len(c)), np.array([0, len(c)]))[0] for c in corners)
    return -10.0 if smallest <= 0.0 else min(float(topology.ring_turns(c).min()) for c in corners)
