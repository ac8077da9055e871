"""Polygon mesher: random seeds, reflection at the walls, Lloyd's iteration on bounded Voronoi cells, short edges collapsed, numbering.

Source: Talischi, Paulino, Pereira, Menezes, PolyMesher, Struct. Multidisc. Optim. 45 (2012).
"""

import contextlib
import operator
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from polyida.errors import InputError
from polyida.mesh import cleanup, topology
from polyida.mesh.domains import Domain, Moved, meet, project
from polyida.mesh.polygon_mesh import PolygonMesh
from polyida.mesh.sections import ON_CIRCLE, automatic
from polyida.mesh.topology import renumber
from polyida.validation import is_whole, named_keywords

ATTEMPTS = 8  # with other seeds, where cells leave a part of the boundary without any
SAMPLES = 20_000  # points, by which the area of a domain is estimated
FARTHEST = 1e6  # sizes from the origin: beyond, the walls' round-off is that of the mesher's tolerances


def whole(value, what, least, most=10**9):
    """value as an int from least to most, else InputError."""
    if not is_whole(value, least, most):
        raise InputError(f"{what} is {value!r}; it must be a whole number, at least {least} (and at most {most})")
    return operator.index(value)


@named_keywords
def polygonize(domain: Domain, cells: int, seed: int = 0, iterations: int = 40) -> PolygonMesh:
    """Polygon mesh of a domain (see polyida.mesh.domains); about `cells` convex polygons.

    Nodes of the boundary lie on the domain's boundary, corners where walls meet are exact. Cells that a concave corner
    leaves non-convex are cut, so there may be a few more. Sections: left, right, top, bottom where the boundary
    has straight edges on the bounding box, and 'hole 0', ... for the rims of holes.
    The same seed gives the same mesh, bit by bit. Raises InputError for bad values.
    """
    if not isinstance(domain, Domain):
        raise InputError(f"polygonize needs a domain such as Rectangle or Link, not {domain!r}")
    cells, seed = whole(cells, "polygonize cells", 1), whole(seed, "polygonize seed", 0)
    # mesh near the origin, where coordinates have all the digits that Voronoi's squares need; whole powers of two move without round-off
    size = 2.0 ** np.ceil(np.log2(np.max(domain.upper - domain.lower)))
    place = size * np.round(domain.lower / size)
    if np.abs(place).max() > FARTHEST * size:
        raise InputError(
            f"polygonize: the domain begins at {domain.lower.tolist()}, more than {FARTHEST:g} of its sizes from the origin, "
            "too far for the digits of its walls; mesh it at the origin and move the plate by its origin="
        )
    polygons = raw_polygons(Moved(domain, -place) if place.any() else domain, cells, seed, whole(iterations, "polygonize iterations", 1))
    points, nodes, offsets, _ = renumber(polygons.points, polygons.nodes, polygons.offsets)
    rim = topology.boundary_edges(nodes, offsets, len(points))
    return PolygonMesh(points + place, nodes, offsets, automatic(points, rim))


def raw_polygons(domain, cells, seed, iterations):
    """Clean polygons of a domain before numbering, with boundary nodes on the walls and corners exact.

    Few cells may leave a part of the boundary without any: then the next random seeds of the same stream are tried.
    """
    rng = np.random.default_rng(seed)
    size = domain.upper - domain.lower
    inside = domain.distance(domain.lower + rng.random((SAMPLES, 2)) * size) < 0.0
    area = float(np.prod(size)) * max(inside.mean(), 1.0 / SAMPLES)  # within a per cent: no result depends on its digits
    corners = domain.corners()
    for _ in range(ATTEMPTS - 1):
        with suppress(Unresolved):
            return _attempt(domain, cells, rng, area, corners, iterations)
    return _attempt(domain, cells, rng, area, corners, iterations)


def _attempt(domain, cells, rng, area, corners, iterations, tolerance=5e-3):
    spacing = np.sqrt(area / cells)
    fixed = cleanup.corner_seeds(domain, corners, spacing)[: cells - 1]
    free = random_seeds(domain, cells - len(fixed), rng, fixed, spacing)
    seeds, diagram = lloyd(fixed, free, domain, area, iterations, tolerance)

    def to_wall(points):
        return to_boundary(points, domain)

    polygons = cleanup.place_corners(snapped(seeds, diagram, domain, spacing, corners), corners, spacing)
    polygons = cleanup.collapse(cleanup.drop_flat_rim_nodes(polygons), project=to_wall)
    polygons = cleanup.split_concave_cells(cleanup.relax(polygons, to_wall))
    # not resolved where a wall or corner has no nodes, an edge leaves the boundary, the mesh is pinched or too small
    size = float(np.max(domain.upper - domain.lower))
    rim = topology.boundary_edges(polygons.nodes, polygons.offsets, len(polygons.points))
    start, end = polygons.points[rim[:, 0]], polygons.points[rim[:, 1]]
    found = topology.areas(polygons.points, polygons.nodes, polygons.offsets)
    followed = [np.sum(np.abs(w.distance(start)) < 1e-9 * size) >= _needed(w, domain) for w in domain.walls]
    followed += [np.linalg.norm(start - corner, axis=1).min() < 1e-9 * size for corner in corners]
    followed += [
        np.all(np.abs(domain.distance(0.5 * (start + end))) < 0.35 * np.linalg.norm(end - start, axis=1)),
        len(np.unique(rim[:, 0])) == len(rim),
        (found > 0.0).all(),
        abs(found.sum() - area) < 0.2 * area,
    ]
    if not all(followed):
        raise Unresolved(f"{len(found)} cells are too few to follow the boundary of the domain; use more cells")
    return polygons


def _needed(wall, domain):
    """Least number of nodes on a wall: none where it is not part of the boundary, 4 on a full circle, which tell it, else 2."""
    part = np.mean(domain.on_boundary(wall.samples(domain.lower, domain.upper)))
    return 0 if part == 0.0 else (ON_CIRCLE if part == 1.0 and wall.closed else 2)


def snapped(seeds, diagram, domain, spacing, corners):
    """Polygons of the seeds' cells; nodes between a seed and its image move onto that wall, of two to a corner."""
    own = diagram.ridges < diagram.n
    cell = np.concatenate([np.repeat(diagram.ridges[own[:, side], side], 2) for side in (0, 1)])
    corner = np.concatenate([diagram.ends[own[:, side]].ravel() for side in (0, 1)])
    keys = np.unique(cell.astype(np.int64) * len(diagram.vertices) + corner)
    cell, corner = keys // len(diagram.vertices), keys % len(diagram.vertices)
    around = diagram.vertices[corner] - seeds[cell]
    order = np.lexsort((np.arctan2(around[:, 1], around[:, 0]), cell))
    points, rank = diagram.vertices.copy(), np.zeros(len(diagram.vertices), dtype=np.int8)
    # a vertex touches a wall where it ends a ridge between a seed and an image. The images of two seeds around a re-entrant corner coincide,
    # and the wall one was made with may be that of the other: a wall through which the seed itself has this image comes first
    mirrored = diagram.ridges.max(axis=1) >= diagram.n
    ends, pair = diagram.ends[mirrored], np.sort(diagram.ridges[mirrored], axis=1)
    seed, image = seeds[pair[:, 0]], diagram.points[pair[:, 1]]
    through = [seed - 2.0 * wall.distance(seed)[:, None] * wall.normal(seed) for wall in domain.walls]
    miss = np.array([np.linalg.norm(image - other, axis=1) for other in through])
    exact = miss.min(axis=0) < 1e-9 * np.linalg.norm(image - seed, axis=1)
    wall = np.where(exact, miss.argmin(axis=0), diagram.wall[pair[:, 1]])
    touched = np.zeros((len(diagram.vertices), len(domain.walls)), dtype=bool)
    touched[ends[:, 0], wall] = touched[ends[:, 1], wall] = True
    rim = touched.any(axis=1)
    points[rim], rank[rim] = to_boundary(points[rim], domain), 1
    # nodes that touch two walls move to where these meet; where a wall's extension meets another there is no corner
    size = float(np.max(domain.upper - domain.lower))
    for i, first in enumerate(domain.walls):
        for j, second in enumerate(domain.walls[:i]):
            both = np.flatnonzero(touched[:, i] & touched[:, j])
            if both.size:
                meeting = meet(points[both], first, second)
                real = np.linalg.norm(meeting - points[both], axis=1) < 0.5 * spacing
                if not domain.convex:
                    real &= (np.linalg.norm(meeting[:, None] - corners, axis=2) < 1e-6 * size).any(axis=1)
                points[both[real]] = meeting[real]
                rank[both[real]] = 2
    return cleanup.compact(points, cell[order], corner[order], rank)


def to_boundary(points, domain):
    """Each point projected on the nearest wall, where that is part of the boundary; points without such stay."""
    shifted = np.array([project(points, wall) for wall in domain.walls])
    away = np.linalg.norm(shifted - points, axis=2)
    away[~np.array([domain.on_boundary(image) for image in shifted])] = np.inf
    nearest = away.argmin(axis=0)
    return np.where(np.isinf(away.min(axis=0))[:, None], points, shifted[nearest, np.arange(len(points))])


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
        # mirror images of the seeds closer than reach to a wall, where they fall outside the domain, and the walls
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
        images, wall = (images, index) if domain.convex else _distinct(images, index, reach)
        if len(seeds) + len(images) >= 4:
            with contextlib.suppress(QhullError):
                diagram = Voronoi(np.concatenate([seeds, images]))
                n = len(seeds)
                ridges, ends = diagram.ridge_points, np.array(diagram.ridge_vertices)
                own = ridges.min(axis=1) < n
                cells = Cells(diagram.vertices, ridges[own], ends[own], diagram.points, np.concatenate([np.full(n, -1), wall]), n)
                if _closed(cells, domain, spacing, reach >= 2.0 * span):
                    return cells, reach
        if reach >= 2.0 * span:
            raise Unresolved(f"{len(seeds)} cells are too few to close them all at the boundary; use more cells")
        reach *= 2.0


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
