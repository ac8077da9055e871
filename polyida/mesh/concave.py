"""Domains that are not convex: corners found, seeds set around re-entrant ones, cells left non-convex cut."""

import numpy as np

from polyida.mesh import topology
from polyida.mesh.make.cleanup import Polygons
from polyida.mesh.make.walls import meet


def domain_corners(domain):
    """(n, 2) points of the boundary where two walls meet, by Newton from a grid over the bounding box."""
    size = float(np.max(domain.upper - domain.lower))
    grid = np.stack(np.meshgrid(*np.linspace(domain.lower, domain.upper, 12).T), axis=-1).reshape(-1, 2)
    found = np.zeros((0, 2))
    for i, first in enumerate(domain.walls):
        for second in domain.walls[:i]:
            point = meet(grid, first, second)
            point = point[np.isfinite(point).all(axis=1)]
            miss = np.max([np.abs(d(point)) for d in (domain.distance, first.distance, second.distance)], axis=0)
            found = np.concatenate([found, point[miss < 1e-9 * size]])
    _, one = np.unique(np.round(found / (1e-7 * size)), axis=0, return_index=True)
    ring = 1e-5 * size * _ring(720)
    share = np.array([np.mean(domain.distance(point + ring) < 0.0) for point in found[one]])
    return found[one][(share > 0.0) & (np.abs(share - 0.5) > 0.01)]


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
