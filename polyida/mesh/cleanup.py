"""From Voronoi ridges to clean convex polygons: collapse short edges, relax flat corners, cut concave cells, keep re-entrant corners."""

from dataclasses import dataclass

import numpy as np

from polyida.mesh import topology
from polyida.mesh.domains import nearest


@dataclass
class Polygons:
    """Working mesh of the mesher: points, nodes, offsets, and the rank of each point (0 inside, 1 on a wall, 2 fixed)."""

    points: np.ndarray
    nodes: np.ndarray
    offsets: np.ndarray
    rank: np.ndarray


def compact(points, cell, corner, rank):
    """Return Polygons from corners sorted by cell; unused points and cells with fewer than three corners are dropped."""
    count = np.bincount(cell)
    keep = count[cell] >= 3
    cell, corner = cell[keep], corner[keep]
    used, nodes = np.unique(corner, return_inverse=True)
    count = count[count >= 3]
    return Polygons(points[used], nodes, np.concatenate([[0], np.cumsum(count)]), rank[used])


def collapse(polygons, project, size, share=0.1):
    """Return the polygons with edges shorter than share of the mean edge collapsed to the node of highest rank, or to the mean.

    Lengths are compared over the wanted size of cells there, size(points).

    Two fixed nodes merge only if they coincide, two boundary nodes never through the inside: that would pinch the domain. project(points)
    moves merged wall nodes to their wall.
    """
    for _ in range(50):
        chosen = _edges_to_collapse(polygons, size, share)
        if not len(chosen):
            break
        polygons = _collapsed(polygons, chosen, project)
    return polygons


def _edges_to_collapse(polygons, size, share):
    """Short edges (k, 2) that may collapse, the shortest first; no two of them share a node, so that one sweep merges pairs only."""
    n = len(polygons.points)
    edges = topology.edges(polygons.nodes, polygons.offsets, n)
    sizes = size(polygons.points[edges].mean(axis=1))
    length = np.linalg.norm(polygons.points[edges[:, 0]] - polygons.points[edges[:, 1]], axis=1) / (sizes / sizes.max())
    rim = np.sort(topology.boundary_edges(polygons.nodes, polygons.offsets, n), axis=1).astype(np.int64)
    on_rim = np.zeros(n, dtype=bool)
    on_rim[rim] = True
    across = on_rim[edges].all(axis=1) & ~np.isin(edges[:, 0].astype(np.int64) * n + edges[:, 1], rim[:, 0] * n + rim[:, 1])
    fixed = (polygons.rank[edges] == 2).all(axis=1) & (length >= 1e-6 * length.mean())
    short = np.flatnonzero((length < share * length.mean()) & ~across & ~fixed)
    taken, chosen = set(), []
    for index in short[np.argsort(length[short], kind="stable")].tolist():
        first, second = edges[index].tolist()
        if first not in taken and second not in taken:
            taken.update((first, second))
            chosen.append(index)
    return edges[chosen]


def _collapsed(polygons, edges, project):
    """The polygons with each of the edges (k, 2) merged into its node of higher rank, or of equal rank into their mean."""
    first, second = edges.T
    swap = polygons.rank[second] > polygons.rank[first]
    keep, drop = np.where(swap, second, first), np.where(swap, first, second)
    level = polygons.rank[keep] == polygons.rank[drop]
    points = polygons.points.copy()
    points[keep[level]] = 0.5 * (points[keep[level]] + points[drop[level]])
    wall = keep[level & (polygons.rank[keep] == 1)]
    if wall.size:
        points[wall] = project(points[wall])
    target = np.arange(len(points))
    target[drop] = keep
    corner, cell = target[polygons.nodes], topology.corner_cells(polygons.offsets)
    same = corner == corner[topology.preceding(polygons.offsets)]
    return compact(points, cell[~same], corner[~same], polygons.rank)


def drop_flat_rim_nodes(polygons, smallest_turn=0.03):
    """Return the polygons without wall nodes of a single cell where it is flat or concave: reflection leaves them along curved walls."""
    turn = topology.turns(polygons.points, polygons.nodes, polygons.offsets)
    single = np.bincount(polygons.nodes, minlength=len(polygons.points))[polygons.nodes] == 1
    drop = single & (polygons.rank[polygons.nodes] == 1) & (turn < smallest_turn)
    if not drop.any():
        return polygons
    cell = topology.corner_cells(polygons.offsets)
    corners = np.bincount(cell[~drop], minlength=len(polygons.offsets) - 1)
    drop &= corners[cell] >= 3
    return compact(polygons.points, cell[~drop], polygons.nodes[~drop], polygons.rank)


def relax(polygons, project, smallest_turn=0.03, sweeps=20):
    """Return the polygons with nodes moved half way to the mean of their neighbours if a cell turns there by less than smallest_turn, rad.

    At a node that is the mean of its neighbours all angles are below 180 degrees; wall nodes use their wall neighbours.
    """
    n = len(polygons.points)
    polygons = Polygons(polygons.points.copy(), polygons.nodes, polygons.offsets, polygons.rank)
    edges = topology.edges(polygons.nodes, polygons.offsets, n)
    on_wall = np.zeros(n, dtype=bool)
    on_wall[topology.boundary_edges(polygons.nodes, polygons.offsets, n)] = True
    edges = np.concatenate([edges, edges[:, ::-1]])
    edges = edges[~on_wall[edges[:, 0]] | on_wall[edges[:, 1]]]
    count = np.maximum(np.bincount(edges[:, 0], minlength=n), 1)
    for _ in range(sweeps):
        turn = topology.turns(polygons.points, polygons.nodes, polygons.offsets)
        flat = np.unique(polygons.nodes[turn < smallest_turn])
        flat = flat[polygons.rank[flat] < 2]
        if flat.size == 0:
            break
        for k in (0, 1):
            mean = np.bincount(edges[:, 0], polygons.points[edges[:, 1], k], n) / count
            polygons.points[flat, k] += 0.5 * (mean[flat] - polygons.points[flat, k])
        wall = flat[polygons.rank[flat] == 1]
        if wall.size:
            polygons.points[wall] = project(polygons.points[wall])
    return polygons


def corner_seeds(domain, corners, sizes):
    """Return seeds around each re-entrant corner, at one distance from it: with their images the corner is a Voronoi vertex.

    Each of the k cells there has the angle theta / k < 180 degrees of the interior angle theta, small enough that the images of the outer two
    fit into the remaining 2 pi - theta.
    """
    rays = (np.arange(720) + 0.5) * (2 * np.pi / 720)
    seeds = [np.zeros((0, 2))]
    for corner, spacing in zip(corners, sizes):
        inside = domain.distance(corner + 1e-3 * spacing * np.stack([np.cos(rays), np.sin(rays)], axis=1)) < 0.0
        starts = np.flatnonzero(inside & ~np.roll(inside, 1))
        theta = inside.mean() * 2 * np.pi
        if starts.size == 1 and theta > np.pi + 0.05:
            count = int(np.clip(np.ceil(theta / (2 * np.pi - theta) - 0.1), 2, 20))
            angle = rays[starts[0]] - np.pi / 720 + theta * (np.arange(count) + 0.5) / count
            seeds.append(corner + 0.55 * spacing * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    seeds = np.concatenate(seeds)
    return seeds[domain.distance(seeds) < 0.0] if len(seeds) else seeds


def place_corners(polygons, corners, sizes):
    """Move the nearest wall node within half a cell to each corner that has no node yet, and fix it there; without one, the nearest edge gets a node."""
    for corner, size in zip(corners, sizes):
        away = np.linalg.norm(polygons.points - corner, axis=1)
        away[polygons.rank == 0] = np.inf
        near = int(np.argmin(away))
        if away[near] < 1e-9 * size or (polygons.rank[near] == 1 and away[near] < 0.5 * size):
            polygons.points[near], polygons.rank[near] = corner, 2
            continue
        rim = topology.boundary_edges(polygons.nodes, polygons.offsets, len(polygons.points))
        start, along = polygons.points[rim[:, 0]], np.diff(polygons.points[rim], axis=1)[:, 0]
        edge, share = nearest(corner[None], start, along)
        if np.linalg.norm(start[edge] + share * along[edge] - corner) < 0.5 * size:
            points, rank = np.concatenate([polygons.points, corner[None]]), np.append(polygons.rank, np.int8(2))
            polygons = Polygons(points, *topology.inserted(polygons.nodes, polygons.offsets, rim[edge], [len(rank) - 1]), rank)
    return polygons


def split_concave_cells(polygons, smallest_turn=1e-3):
    """Return the polygons with every cell that has an angle of 180 degrees or more cut into convex cells."""
    cells, _ = convex_cells(polygons.points, polygons.nodes, polygons.offsets, smallest_turn)
    return Polygons(polygons.points, np.concatenate(cells), np.concatenate([[0], np.cumsum([len(cell) for cell in cells])]), polygons.rank)


def convex_cells(points, nodes, offsets, smallest_turn=1e-3):
    """Return (nodes of each convex cell or piece of a concave one, number of its cell)."""
    worst = np.minimum.reduceat(topology.turns(points, nodes, offsets), offsets[:-1])
    cells, numbers = [], []
    for i, cell in enumerate(np.split(nodes, offsets[1:-1])):
        pieces = [cell] if worst[i] > smallest_turn else _cut(points, cell, smallest_turn)
        cells.extend(pieces)
        numbers.extend([i] * len(pieces))
    return cells, np.array(numbers)


def _cut(points, cell, smallest_turn):
    """Convex pieces of one cell: each cut starts at the most reflex corner and maximises the smallest turn."""
    turn = topology.ring_turns(points[cell])
    if len(cell) == 3 or turn.min() > smallest_turn:
        return [cell]
    ring = np.roll(cell, -int(np.argmin(turn)))

    def pieces(k):
        """The two pieces, arrays of nodes, into which the cut from corner 0 to corner k divides the cell."""
        return ring[: k + 1], np.r_[ring[0], ring[k:]]

    def merit(k):
        """The smallest turn of both pieces of a cut to corner k; -10 if a piece is no simple polygon."""
        corners = [points[piece] for piece in pieces(k)]
        turns = [topology.ring_turns(c) for c in corners]
        smallest = min(topology.areas(c, np.arange(len(c)), np.array([0, len(c)]))[0] for c in corners)
        if smallest <= 0.0 or any(abs(t.sum() - 2.0 * np.pi) > 1e-6 or t.max() > np.pi - 1e-9 for t in turns):
            return -10.0  # a piece is inside out, crosses itself or folds back
        return min(float(t.min()) for t in turns)

    best = max(range(2, len(ring) - 1), key=merit)
    return [part for piece in pieces(best) for part in _cut(points, piece, smallest_turn)]
