"""Bounded Voronoi cells: seeds near a wall are reflected through it; Lloyd's iteration on them."""

import contextlib
from dataclasses import dataclass

import numpy as np

from polyida.errors import InputError


class Unresolved(InputError):
    """The cells are too few to follow the boundary."""


@dataclass(frozen=True)
class Cells:
    """Voronoi diagram of n seeds: ridges (r, 2) between points, their ends (r, 2) in vertices; points (p, 2) beyond
    the first n are images of seeds, wall (p,) says through which wall."""

    vertices: np.ndarray
    ridges: np.ndarray
    ends: np.ndarray
    points: np.ndarray
    wall: np.ndarray
    n: int


def random_seeds(domain, count, rng, fixed, spacing):
    """count uniform points inside the domain, not between the fixed seeds around a corner."""
    kept, tried, found = [], 0, 0
    while found < count:
        trial = domain.lower + rng.random((2 * count + 10, 2)) * (domain.upper - domain.lower)
        trial = trial[domain.distance(trial) < 0.0]
        for seed in fixed:
            trial = trial[np.linalg.norm(trial - seed, axis=1) > 0.6 * spacing]
        kept.append(trial)
        found, tried = found + len(trial), tried + 1
        if tried >= 1000:
            raise InputError("domain is empty, or too thin within its bounding box to place seeds")
    return np.concatenate(kept)[:count]


def estimated_area(domain, rng, samples=20000):
    """Area by sampling, within a per cent: sets the lengths of the mesher, no result depends on its digits."""
    size = domain.upper - domain.lower
    inside = domain.distance(domain.lower + rng.random((samples, 2)) * size) < 0.0
    return float(np.prod(size)) * max(inside.mean(), 1.0 / samples)


def reflections(seeds, domain, reach):
    """Mirror images of the seeds closer than reach to a wall, where they fall outside the domain; and their walls."""
    images, index = [], []
    for i, wall in enumerate(domain.walls):
        distance = wall.distance(seeds)
        near = (np.abs(distance) < reach) & wall.faces(seeds)
        distance = distance[near]
        image = seeds[near] - 2.0 * distance[:, None] * wall.normal(seeds[near])
        image = image[domain.distance(image) > 0.9 * np.abs(distance)]
        images.append(image)
        index.append(np.full(len(image), i))
    images, index = np.concatenate(images), np.concatenate(index)
    return (images, index) if domain.convex else _distinct(images, index, reach)


def _distinct(images, index, reach):
    """Images without repetition: those of seeds on both sides of a re-entrant corner may coincide."""
    from scipy.spatial import cKDTree

    pairs = cKDTree(images).query_pairs(1e-9 * reach, output_type="ndarray") if len(images) else []
    keep = np.ones(len(images), dtype=bool)
    keep[[max(pair) for pair in pairs]] = False
    return images[keep], index[keep]


def bounded_cells(seeds, domain, spacing, reach):
    """Cells of the seeds and the reach used: doubled until every cell is bounded and ends near the wall."""
    from scipy.spatial import QhullError, Voronoi

    span = float(np.linalg.norm(domain.upper - domain.lower))
    while True:
        images, wall = reflections(seeds, domain, reach)
        if len(seeds) + len(images) >= 4:
            with contextlib.suppress(QhullError):
                cells = _own_cells(Voronoi(np.concatenate([seeds, images])), wall, len(seeds))
                if _closed(cells, domain, spacing, reach >= 2.0 * span):
                    return cells, reach
        if reach >= 2.0 * span:
            raise Unresolved(f"{len(seeds)} cells are too few to close them all at the boundary; use more cells")
        reach *= 2.0


def _own_cells(diagram, wall, n):
    ridges, ends = diagram.ridge_points, np.array(diagram.ridge_vertices)
    own = ridges.min(axis=1) < n
    return Cells(diagram.vertices, ridges[own], ends[own], diagram.points, np.concatenate([np.full(n, -1), wall]), n)


def _closed(cells, domain, spacing, last):
    """True when no ridge runs to infinity and no cell leaves the domain by more than half a cell."""
    if cells.ends.min() < 0:
        return False
    used = np.unique(cells.ends)
    return last or bool(domain.distance(cells.vertices[used]).max() < 0.5 * spacing)


def areas_and_centroids(points, cells):
    """Areas (n,) and centroids (n, 2): one triangle seed-v1-v2 for each side of each ridge."""
    area, moment = np.zeros(cells.n), np.zeros((cells.n, 2))
    a, b = cells.vertices[cells.ends[:, 0]], cells.vertices[cells.ends[:, 1]]
    for side in (0, 1):
        own = cells.ridges[:, side] < cells.n
        cell = cells.ridges[own, side]
        s = points[cell]
        u, v = a[own] - s, b[own] - s
        triangle = 0.5 * np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
        area += np.bincount(cell, triangle, cells.n)
        for k in (0, 1):
            moment[:, k] += np.bincount(cell, triangle * (u[:, k] + v[:, k]) / 3.0, cells.n)
    return area, points + moment / area[:, None]


def lloyd(fixed, free, domain, area, iterations, tolerance):
    """(seeds, cells): fixed seeds stay, free ones move to their centroids until
    sqrt(sum A_i^2 |c_i - s_i|^2) n / A^1.5 < tolerance, or for the given number of iterations.

    The move is stretched (factor 1.7, which about halves the iterations) wherever it stays inside the domain.
    """
    seeds = np.concatenate([fixed, free])
    spacing = np.sqrt(area / len(seeds))
    reach = 2.0 * spacing
    for _ in range(iterations):
        cells, reach = bounded_cells(seeds, domain, spacing, reach)
        areas, centroids = areas_and_centroids(seeds, cells)
        move = centroids - seeds
        move[: len(fixed)] = 0.0
        error = np.sqrt(np.sum(areas**2 * np.sum(move**2, axis=1))) * len(seeds) / areas.sum() ** 1.5
        stretched = seeds + 1.7 * move
        inside = domain.distance(stretched) < -0.1 * spacing
        seeds = np.where(inside[:, None], stretched, seeds + move)
        seeds = _kept_inside(seeds, domain)
        if error < tolerance:
            break
    return seeds, bounded_cells(seeds, domain, spacing, reach)[0]


def _kept_inside(seeds, domain):
    """Seeds that left the domain (centroids beside a concave wall) are mirrored back through the wall they crossed."""
    out = domain.distance(seeds) >= 0.0
    if not out.any():
        return seeds
    seeds = seeds.copy()
    stray = seeds[out]
    step = 1e-6 * float(np.max(domain.upper - domain.lower))
    for _ in range(8):
        d = domain.distance(stray)
        slope = np.stack([domain.distance(stray + step * axis) - d for axis in np.eye(2)], axis=1) / step
        length = np.maximum(np.sum(slope**2, axis=1), 1e-12)
        stray = stray - np.where(d >= 0.0, 2.0 * d + step, 0.0)[:, None] * slope / length[:, None]
    seeds[out] = stray
    return seeds
