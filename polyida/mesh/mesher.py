"""Meshers: polygons by Lloyd's iteration on bounded Voronoi cells; structured quadrilaterals and triangles of a rectangle.

The polygon mesher starts from random seeds, reflects them at the walls, iterates, collapses short edges and renumbers.
Source: Talischi, Paulino, Pereira, Menezes, PolyMesher, Struct. Multidisc. Optim. 45 (2012).
"""

import operator
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from polyida.errors import InputError
from polyida.mesh import cleanup, topology
from polyida.mesh.domains import Domain, Moved, Rectangle, meet, project
from polyida.mesh.polygon_mesh import PolygonMesh, moved
from polyida.mesh.raw import counted
from polyida.mesh.sections import ON_CIRCLE, automatic
from polyida.validation import is_whole, named_keywords, positive, vector2

SHIFTS = 1e-3, *[0.5] * 7  # of given seeds, over the size of cells there, in attempts until all parts of the boundary have cells
BY_CHANCE = 12  # places where cells fail to follow the boundary, up to which other seeds are tried
SAMPLES = 20_000  # points that estimate the area of a domain
# of an edge from one wall to another that continues it: distance of its middle from the boundary over its length; 1 - cosine of the normals
TANGENT = 0.1
DEEPEST = 0.3  # distance of a middle node on a wall from its straight side, over the side's length: that of an arc of 120 degrees
FARTHEST = 1e6  # sizes from the origin: beyond, the round-off of the walls reaches the mesher's tolerances


class Unresolved(InputError):
    """The cells are too few to follow the boundary. places: (n, 2) points of the boundary where they fail; none if only the area is wrong."""

    def __init__(self, message, places=()):
        """Take the message, and the places (n, 2), m, of the boundary that the cells do not follow."""
        super().__init__(message)
        self.places = np.reshape(places, (-1, 2))


def _whole(function, name, value, least):
    """Return the argument `name` of a function as an int. Raises InputError unless it is whole and from `least` to 10^9."""
    if not is_whole(value, least, 10**9):
        raise InputError(f"{function}: {name} = {value!r} must be a whole number from {least} to {10**9}")
    return operator.index(value)


@named_keywords
def polygonize(domain: Domain, cells: int, seed: int = 0, iterations: int = 40, order: int = 1) -> PolygonMesh:
    """Return a mesh of convex polygons of a domain.

    Boundary nodes lie on the walls; corners of the domain are exact.

    Parameters
    ----------
    domain : Domain
    cells : int, >= 1
        Approximate number of polygons: cells that a concave corner leaves non-convex are cut.
    seed : int, >= 0
        Of the random start; the same seed gives the same mesh, bit by bit.
    iterations : int, >= 1
        Largest number of Lloyd iterations.
    order : 1 or 2
        2: with a middle node on each side, for quadratic plates; those of the boundary lie on the walls, so that sides are curved.

    Returns
    -------
    PolygonMesh
        With the sections left, right, top, bottom if the boundary has straight edges on the bounding box, and 'hole 0', ... for rims of holes.

    Raises
    ------
    InputError
        For wrong values, and for cells that are too few to follow the boundary.
    """
    if not isinstance(domain, Domain):
        raise InputError(f"polygonize needs a domain such as Rectangle or Link, not {domain!r}")
    cells, seed = _whole("polygonize", "cells", cells, 1), _whole("polygonize", "seed", seed, 0)
    iterations = _whole("polygonize", "iterations", iterations, 1)
    # mesh near the origin, where coordinates keep their digits in Voronoi's squares; a shift by whole powers of two has no round-off
    size = 2.0 ** np.ceil(np.log2(np.max(domain.upper - domain.lower)))
    shift = size * np.round(domain.lower / size)
    if np.abs(shift).max() > FARTHEST * size:
        raise InputError(
            f"polygonize: the domain begins at {domain.lower.tolist()}, more than {FARTHEST:g} of its sizes from the origin, "
            "too far for the digits of its walls; mesh it at the origin and move the plate by its origin="
        )
    near = Moved(domain, -shift) if shift.any() else domain
    try:
        return _of_order("polygonize", order, numbered(voronoi_polygons(near, cells, seed, iterations), shift), domain)
    except Unresolved as error:
        told = f"polygonize: cells = {cells} are too few to follow the boundary of the domain; use more cells"
        if len(error.places):
            (width, (x, y)), count = _narrowest(near, error.places, cells, shift), counted(len(error.places), "place")
            told += f", or leave details out: the narrowest of {count} where they fail is about {width:.2g} m wide, at ({x:.6g}, {y:.6g})"
        raise InputError(told) from None


def _narrowest(domain, places, cells, shift):
    """(width, m, place plus shift) of the narrowest place of the boundary: the distance to another wall, or the size of a wall through it."""
    size, corners = float(np.max(domain.upper - domain.lower)), domain.corners()
    if len(corners):  # near a corner, the distance to its other wall says nothing
        away = np.linalg.norm(places[:, None] - corners, axis=2)
        at_corner = away.min(axis=1) < np.sqrt(np.prod(domain.upper - domain.lower) / cells)
        places = np.where(at_corner[:, None], corners[away.argmin(axis=1)], places)
    width = np.full(len(places), size)
    for wall in domain.walls:
        samples = wall.samples(domain.lower, domain.upper)
        samples = samples[domain.on_boundary(samples)]
        if len(samples):
            away, extent = np.linalg.norm(places[:, None] - samples, axis=2).min(axis=1), np.ptp(samples, axis=0).max()
            on = np.abs(wall.distance(places)) < 1e-9 * size  # or on its straight continuation
            width = np.minimum(width, np.where(on, np.where(away < 0.02 * extent, extent, size), away))
    first = int(width.argmin())
    return width[first], places[first] + shift


def _of_order(function, order, mesh, domain=None):
    """The mesh with middle nodes if the order is 2; those of the boundary are on the walls of a domain."""
    if _whole(function, "order", order, 1) > 2:
        raise InputError(f"{function}: order = {order!r} must be 1 or 2")
    if order == 1:
        return mesh
    mesh = mesh.quadratic
    if domain is None:
        return mesh
    sides, points = mesh.boundary_edges.reshape(-1, 4)[:, [0, 1, 3]], np.array(mesh.points)
    start, middle, end = points[sides].transpose(1, 0, 2)
    size, length, best = float(np.max(domain.upper - domain.lower)), np.hypot(*(end - start).T), middle.copy()
    least = np.full(len(sides), np.inf)
    for wall in domain.walls:
        foot = project(middle, wall)
        away, off = np.hypot(*(foot - middle).T), np.maximum(np.abs(wall.distance(start)), np.abs(wall.distance(end)))
        nearer = (off < 1e-9 * size) & (away < np.minimum(least, DEEPEST * length))
        best[nearer], least[nearer] = foot[nearer], away[nearer]
    points[sides[:, 1]] = best
    return moved(mesh, points)


def numbered(polygons, shift=0.0):
    """The PolygonMesh of polygons moved by `shift`, with nodes in an order of small bandwidth and automatic sections."""
    points, nodes, offsets, _ = topology.renumber(polygons.points, polygons.nodes, polygons.offsets)
    rim = topology.boundary_edges(nodes, offsets, len(points))
    return PolygonMesh(points + shift, nodes, offsets, automatic(points, rim))


@named_keywords
def rectangle(
    length: float, height: float, cells: int, seed: int = 0, iterations: int = 40, origin: "ArrayLike" = (0.0, 0.0), order: int = 1
) -> PolygonMesh:
    """Return a polygon mesh of the rectangle 0 <= x <= length, |y| <= height/2, symmetric about y = 0.

    Half of it is meshed and mirrored: the corners and the mid nodes (0, 0) and (length, 0) are exact.

    Parameters
    ----------
    length, height : float, m, > 0
    cells : int, >= 1
        Number of polygons; an odd number is increased by one.
    seed : int, >= 0
        The same seed gives the same mesh, bit by bit.
    iterations : int, >= 1
        Largest number of Lloyd iterations.
    origin : (2,) float, m
        Translation of the mesh.
    order : 1 or 2
        2: with a middle node on each side, for quadratic plates.

    Returns
    -------
    PolygonMesh
        With the sections left, right, top, bottom.

    Raises
    ------
    InputError
        For wrong values.
    """
    length, height = positive("rectangle", "length", length, "metres"), positive("rectangle", "height", height, "metres")
    cells, seed = _whole("rectangle", "cells", cells, 1), _whole("rectangle", "seed", seed, 0)
    iterations, origin = _whole("rectangle", "iterations", iterations, 1), vector2("rectangle", "origin", origin)
    half = voronoi_polygons(Rectangle(length, 0.5 * height), (cells + 1) // 2, seed, iterations)
    off_axis = np.flatnonzero(half.points[:, 1] != 0.0)  # nodes on y = 0 belong to both halves
    image = np.arange(len(half.points))
    image[off_axis] = len(half.points) + np.arange(len(off_axis))
    points = np.concatenate([half.points, half.points[off_axis] * [1.0, -1.0]])
    sizes = np.diff(half.offsets)
    offsets = np.concatenate([[0], np.cumsum(np.r_[sizes, sizes[::-1]])])
    points, nodes, offsets, _ = topology.renumber(points, np.concatenate([half.nodes, image[half.nodes[::-1]]]), offsets)
    return _of_order("rectangle", order, PolygonMesh(points + origin, nodes, offsets, _sides(points, length, height)))


def _sides(points, length, height):
    """{"left", "right", "top", "bottom": nodes} on the sides of the rectangle 0 <= x <= length, |y| <= height / 2, for points (n, 2)."""
    x, y = points.T
    masks = {"left": x == 0.0, "right": x == length, "top": y == 0.5 * height, "bottom": y == -0.5 * height}
    return {name: np.flatnonzero(mask) for name, mask in masks.items()}


@named_keywords
def quads(length: float, height: float, nx: int, ny: int, origin: "ArrayLike" = (0.0, 0.0), order: int = 1) -> PolygonMesh:
    """Return nx by ny equal quadrilaterals of the rectangle 0 <= x <= length, |y| <= height/2.

    Parameters
    ----------
    length, height : float, m, > 0
    nx, ny : int, >= 1
    origin : (2,) float, m
        Translation of the mesh.
    order : 1 or 2
        2: with a middle node on each side, for quadratic plates.

    Returns
    -------
    PolygonMesh
        With the sections left, right, top, bottom.

    Raises
    ------
    InputError
        For wrong values.
    """
    return _of_order("quads", order, _structured("quads", length, height, nx, ny, origin))


@named_keywords
def triangles(length: float, height: float, nx: int, ny: int, origin: "ArrayLike" = (0.0, 0.0), order: int = 1) -> PolygonMesh:
    """Return a mesh of a rectangle, 0 <= x <= length, |y| <= height/2: nx by ny equal ones, each cut into two triangles.

    The diagonals alternate.

    Parameters
    ----------
    length, height, nx, ny, origin, order
        As of `quads`: length and height, m, numbers of rectangles along x and y, translation (2,), m, order 1 or 2 of the cells.

    Returns
    -------
    PolygonMesh
        With the sections left, right, top, bottom.

    Raises
    ------
    InputError
        For wrong values.
    """
    return _of_order("triangles", order, _structured("triangles", length, height, nx, ny, origin, cut=True))


def _structured(function, length, height, nx, ny, origin, cut=False):
    """Mesh with nodes numbered across the shorter direction first."""
    length, height = positive(function, "length", length, "metres"), positive(function, "height", height, "metres")
    nx, ny, origin = _whole(function, "nx", nx, 1), _whole(function, "ny", ny, 1), vector2(function, "origin", origin)
    x, y = np.meshgrid(length * (np.arange(nx + 1) / nx), height * (np.arange(ny + 1) / ny - 0.5), indexing="ij")
    number = np.arange(x.size).reshape(x.shape)
    if ny > nx:
        x, y, number = x.T, y.T, np.arange(x.size).reshape(ny + 1, nx + 1).T
    a, b, c, d = (corner if ny <= nx else corner.T for corner in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    corners = np.stack([a, b, c, d], axis=-1)
    if cut:
        i, j = np.indices(a.shape)
        even, up, down = ((i + j) % 2 == 0)[..., None], np.stack([a, b, c, a, c, d], axis=-1), np.stack([a, b, d, b, c, d], axis=-1)
        corners = np.where(even, up, down).reshape(-1, 3)
    nodes, offsets = topology.sorted_cells(corners.ravel(), np.arange(0, corners.size + 1, corners.shape[-1]))
    points = np.stack([x.ravel(), y.ravel()], axis=1)
    return PolygonMesh(points + origin, nodes, offsets, _sides(points, length, height))


def voronoi_polygons(domain, cells, seed, iterations, tolerance=5e-3, start=None, size=None):
    """Polygons of a domain before numbering, with boundary nodes on the walls and exact corners.

    If the boundary is not resolved, the next random seeds of the same stream are tried. start (cells, 2): seeds in place of random ones, which are
    shifted at random; size: wanted sizes of cells, m, a function of points (n, 2), in place of one size.
    """
    rng = np.random.default_rng(seed)
    extent = domain.upper - domain.lower
    inside = domain.distance(domain.lower + rng.random((SAMPLES, 2)) * extent) < 0.0
    area = float(np.prod(extent)) * max(inside.mean(), 1.0 / SAMPLES)  # accurate to about 1 %: no result depends on its digits
    size = size or (lambda points: np.full(len(points), np.sqrt(area / cells)))
    corners = domain.corners()

    def attempt(shift):
        """The polygons from new random seeds, or from given ones shifted by a share of the size. Raises Unresolved."""
        fixed = cleanup.corner_seeds(domain, corners, size(corners))[: cells - 1]
        if start is None:
            free = _random_seeds(domain, cells - len(fixed), rng, fixed, size)
        else:
            free = _apart(start, fixed, size)
            free = free + shift * size(free)[:, None] * (rng.random(free.shape) - 0.5)
            free = free[domain.distance(free) < 0.0]
        seeds, diagram = _lloyd(fixed, free, domain, size, iterations, tolerance)
        polygons = cleanup.place_corners(_snapped(seeds, diagram, domain, size, corners), corners, size(corners))
        polygons = cleanup.collapse(cleanup.drop_flat_rim_nodes(polygons), lambda points: _to_boundary(points, domain), size)
        polygons = cleanup.split_concave_cells(cleanup.relax(polygons, lambda points: _to_boundary(points, domain)))
        _require_resolved(polygons, domain, corners, area)
        return polygons

    for shift in SHIFTS[:-1]:
        try:
            return attempt(shift)
        except Unresolved as error:
            if len(error.places) > BY_CHANCE:
                raise
    return attempt(SHIFTS[-1])


def _apart(seeds, fixed, size):
    """The seeds whose distance from each fixed seed is more than 0.6 of the local size of cells; size(points): (n,), m."""
    for one in fixed:
        seeds = seeds[np.linalg.norm(seeds - one, axis=1) > 0.6 * size(one[None])]
    return seeds


def _require_resolved(polygons, domain, corners, area):
    """Raise Unresolved if a wall or corner has no nodes, an edge leaves its wall or cuts a corner, or the mesh is pinched or too small."""
    size = float(np.max(domain.upper - domain.lower))
    rim = topology.boundary_edges(polygons.nodes, polygons.offsets, len(polygons.points))
    start, end = polygons.points[rim[:, 0]], polygons.points[rim[:, 1]]
    areas = topology.areas(polygons.points, polygons.nodes, polygons.offsets)
    middle, places = 0.5 * (start + end), [corner for corner in corners if np.linalg.norm(start - corner, axis=1).min() >= 1e-9 * size]
    along, before, behind = np.zeros(len(rim), bool), np.zeros(start.shape), np.zeros(end.shape)  # normals at both ends
    for wall in domain.walls:  # no nodes are needed on a wall that is not part of the boundary
        samples = wall.samples(domain.lower, domain.upper)
        samples, count = samples[domain.on_boundary(samples)], len(samples)
        needed = 0 if not len(samples) else (ON_CIRCLE if len(samples) == count and wall.closed else 2)
        begins, ends = (np.abs(wall.distance(nodes)) < 1e-9 * size for nodes in (start, end))
        if np.sum(begins) < needed:
            places.append(samples[len(samples) // 2])
        along |= begins & ends
        before += begins[:, None] * wall.normal(start)
        behind += ends[:, None] * wall.normal(end)
    away = np.abs(domain.distance(middle)) / np.linalg.norm(end - start, axis=1)
    smooth = np.einsum("nx,nx->n", before, behind) > (1.0 - TANGENT) * np.hypot(*before.T) * np.hypot(*behind.T)
    along |= smooth & (away < TANGENT)  # from one wall to another that continues it; corners have nodes of their own
    cuts = ~(away < 0.35)
    pinched = np.bincount(rim[:, 0], minlength=len(polygons.points))[rim[:, 0]] > 1
    tiny = polygons.points[polygons.nodes[polygons.offsets[:-1][~(areas > 1e-9 * areas.mean())]]]
    places = np.concatenate(
        [np.reshape(places, (-1, 2)), _to_boundary(np.concatenate([middle[~along | cuts], start[pinched], tiny]), domain)]
    )
    if len(places) or not abs(areas.sum() - area) < 0.2 * area:
        raise Unresolved(f"{len(areas)} cells are too few to follow the boundary of the domain; use more cells", places)


def _snapped(seeds, diagram, domain, size, corners):
    """Polygons of the seeds' cells; nodes between a seed and its image move to that wall, nodes of two walls to their corner."""
    points, rank = diagram.vertices.copy(), np.zeros(len(diagram.vertices), dtype=np.int8)
    touched = _touched_walls(seeds, diagram, domain)
    rim = touched.any(axis=1)
    points[rim] = _to_boundary(points[rim], domain)
    rank[rim] = 1
    _move_to_corners(points, rank, touched, domain, size, corners)
    return cleanup.compact(points, *_corners_of_cells(seeds, diagram), rank)


def _corners_of_cells(seeds, diagram):
    """(cell, vertex) of each corner of the seeds' cells, cell by cell and counter-clockwise."""
    own = diagram.ridges < diagram.n
    cell = np.concatenate([np.repeat(diagram.ridges[own[:, side], side], 2) for side in (0, 1)])
    corner = np.concatenate([diagram.ends[own[:, side]].ravel() for side in (0, 1)])
    keys = np.unique(cell.astype(np.int64) * len(diagram.vertices) + corner)
    cell, corner = keys // len(diagram.vertices), keys % len(diagram.vertices)
    around = diagram.vertices[corner] - seeds[cell]
    order = np.lexsort((np.arctan2(around[:, 1], around[:, 0]), cell))
    return cell[order], corner[order]


def _touched_walls(seeds, diagram, domain):
    """(vertices, walls) mask: a vertex touches a wall if it ends a ridge between a seed and its image through the wall.

    Images of two seeds around a re-entrant corner coincide, and the stored wall may be that of the other seed: a wall through which the seed
    itself has this image is preferred.
    """
    mirrored = diagram.ridges.max(axis=1) >= diagram.n
    ends, pair = diagram.ends[mirrored], np.sort(diagram.ridges[mirrored], axis=1)
    seed, image = seeds[pair[:, 0]], diagram.points[pair[:, 1]]
    through = [seed - 2.0 * wall.distance(seed)[:, None] * wall.normal(seed) for wall in domain.walls]
    miss = np.array([np.linalg.norm(image - other, axis=1) for other in through])
    exact = miss.min(axis=0) < 1e-9 * np.linalg.norm(image - seed, axis=1)
    wall = np.where(exact, miss.argmin(axis=0), diagram.wall[pair[:, 1]])
    touched = np.zeros((len(diagram.vertices), len(domain.walls)), dtype=bool)
    touched[ends[:, 0], wall] = touched[ends[:, 1], wall] = True
    return touched


def _move_to_corners(points, rank, touched, domain, size, corners):
    """Move nodes that touch two walls to their intersection and fix them, unless one of the walls is not part of the boundary there."""
    extent = float(np.max(domain.upper - domain.lower))
    of_two = touched[touched.sum(axis=1) > 1].astype(np.float32)
    for i, j in np.argwhere(np.tril(of_two.T @ of_two, -1)):
        both = np.flatnonzero(touched[:, i] & touched[:, j])
        meeting = meet(points[both], domain.walls[i], domain.walls[j])
        real = np.linalg.norm(meeting - points[both], axis=1) < 0.5 * size(points[both])
        if not domain.convex:
            real &= (np.linalg.norm(meeting[:, None] - corners, axis=2) < 1e-6 * extent).any(axis=1)
        points[both[real]] = meeting[real]
        rank[both[real]] = 2


def _to_boundary(points, domain):
    """Each point projected on the nearest wall that is part of the boundary there; other points do not move."""
    shifted = np.array([project(points, wall) for wall in domain.walls])
    away = np.linalg.norm(shifted - points, axis=2)
    placed, left = points.copy(), np.arange(len(points))
    while left.size:  # the nearest wall first; where its image is not on the boundary, the next one
        wall = away[:, left].argmin(axis=0)
        known = np.isfinite(away[wall, left])
        wall, left = wall[known], left[known]
        images = shifted[wall, left]
        on = domain.on_boundary(images)
        placed[left[on]] = images[on]
        away[wall[~on], left[~on]] = np.inf
        left = left[~on]
    return placed


@dataclass(frozen=True)
class Cells:
    """Voronoi diagram of n seeds: ridges (r, 2) between points, their ends (r, 2) in vertices.

    points (p, 2) after the first n are images of seeds; wall (p,): index of the wall that reflects them.
    """

    vertices: np.ndarray
    ridges: np.ndarray
    ends: np.ndarray
    points: np.ndarray
    wall: np.ndarray
    n: int


def _random_seeds(domain, count, rng, fixed, size):
    """count uniform points inside the domain, not between the fixed seeds around a corner."""
    seeds = np.zeros((0, 2))
    for _ in range(1000):
        trial = domain.lower + rng.random((2 * count + 10, 2)) * (domain.upper - domain.lower)
        seeds = np.concatenate([seeds, _apart(trial[domain.distance(trial) < 0.0], fixed, size)])
        if len(seeds) >= count:
            return seeds[:count]
    raise InputError("domain is empty, or too thin within its bounding box to place seeds")


def _bounded_cells(seeds, domain, size, reach):
    """Cells of the seeds, and the reach within which seeds are reflected: doubled until every cell is bounded and ends near the wall."""
    from scipy.spatial import QhullError, Voronoi, cKDTree

    span, n = float(np.linalg.norm(domain.upper - domain.lower)), len(seeds)
    while True:
        images, index, behind = [], [], []
        for i, wall in enumerate(domain.walls):
            distance = wall.distance(seeds)
            near = (np.abs(distance) < reach) & wall.faces(seeds)
            distance = distance[near]
            image = seeds[near] - 2.0 * distance[:, None] * wall.normal(seeds[near])
            images.append(image)
            index.append(np.full(len(image), i))
            behind.append(0.9 * np.abs(distance))
        images, index = np.concatenate(images), np.concatenate(index)
        outside = domain.distance(images) > np.concatenate(behind)  # of all walls at once
        images, index = images[outside], index[outside]
        if not domain.convex and len(images):  # images of seeds on both sides of a re-entrant corner may coincide
            different = np.ones(len(images), dtype=bool)
            different[cKDTree(images).query_pairs(1e-9 * reach, output_type="ndarray").max(axis=1)] = False
            images, index = images[different], index[different]
        if n + len(images) >= 4:
            with suppress(QhullError):
                diagram = Voronoi(np.concatenate([seeds, images]))
                own = diagram.ridge_points.min(axis=1) < n
                ends = np.array(diagram.ridge_vertices)[own]
                wall = np.concatenate([np.full(n, -1), index])
                vertices = diagram.vertices[np.unique(ends[ends >= 0])]
                if ends.min() >= 0 and (reach >= 2.0 * span or (domain.distance(vertices) < 0.5 * size(vertices)).all()):
                    return Cells(diagram.vertices, diagram.ridge_points[own], ends, diagram.points, wall, n), reach
        if reach >= 2.0 * span:
            raise Unresolved(f"{n} cells are too few to close them all at the boundary; use more cells")
        reach *= 2.0


def _lloyd(fixed, free, domain, size, iterations, tolerance):
    """(seeds, cells): fixed seeds stay, free ones move to their centroids until sqrt(sum A_i^2 |c_i - s_i|^2) n / A^1.5 < tolerance.

    The move is multiplied by 1.7, which about halves the number of iterations, if the seed then stays inside the domain. Centroids are weighed with
    the power -4 of the wanted size, which cells then have.
    """
    seeds = np.concatenate([fixed, free])
    largest = float(np.max(size(seeds)))
    reach = 2.0 * largest
    for _ in range(iterations):
        cells, reach = _bounded_cells(seeds, domain, size, reach)
        areas, move = _ways_to_centroids(seeds, cells, size, largest)
        move[: len(fixed)] = 0.0
        error = np.sqrt(np.sum(areas**2 * np.sum(move**2, axis=1))) * len(seeds) / areas.sum() ** 1.5
        stretched = seeds + 1.7 * move
        inside = domain.distance(stretched) < -0.1 * size(stretched)
        seeds = np.where(inside[:, None], stretched, seeds + move)
        out = domain.distance(seeds) >= 0.0
        if out.any():
            seeds[out] = _mirrored_back(seeds[out], domain)
        if error < tolerance:
            break
    return seeds, _bounded_cells(seeds, domain, size, reach)[0]


def _ways_to_centroids(seeds, cells, size, largest):
    """(areas (n,) of the cells, ways (n, 2) from seeds to weighed centroids), by the triangles of a seed and both ends of a ridge."""
    areas, weights, moments = np.zeros(cells.n), np.zeros(cells.n), np.zeros((cells.n, 2))
    a, b = cells.vertices[cells.ends[:, 0]], cells.vertices[cells.ends[:, 1]]
    for side in (0, 1):
        own = cells.ridges[:, side] < cells.n
        cell = cells.ridges[own, side]
        u, v = a[own] - seeds[cell], b[own] - seeds[cell]
        triangle = 0.5 * np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
        areas += np.bincount(cell, triangle, cells.n)
        triangle = triangle * (size(seeds[cell] + (u + v) / 3.0) / largest) ** -4.0
        weights += np.bincount(cell, triangle, cells.n)
        for k in (0, 1):
            moments[:, k] += np.bincount(cell, triangle * (u[:, k] + v[:, k]) / 3.0, cells.n)
    return areas, seeds + moments / weights[:, None] - seeds


def _mirrored_back(stray, domain):
    """Seeds that left the domain, as centroids beside a concave wall do, mirrored back through the wall that they crossed."""
    step = 1e-6 * float(np.max(domain.upper - domain.lower))
    for _ in range(8):
        away = domain.distance(stray)
        slope = np.stack([domain.distance(stray + step * axis) - away for axis in np.eye(2)], axis=1) / step
        length = np.maximum(np.sum(slope**2, axis=1), 1e-12)
        stray = stray - np.where(away >= 0.0, 2.0 * away + step, 0.0)[:, None] * slope / length[:, None]
    return stray
