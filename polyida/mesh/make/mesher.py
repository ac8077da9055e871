"""Polygon mesher: random seeds, reflection at the walls, Lloyd, short edges collapsed, numbering.

Source: Talischi, Paulino, Pereira, Menezes, PolyMesher, Struct. Multidisc. Optim. 45 (2012).
"""

import operator
from contextlib import suppress

import numpy as np

from polyida.errors import InputError
from polyida.given import is_whole
from polyida.keywords import named_keywords
from polyida.mesh import concave, topology
from polyida.mesh.make import cleanup, voronoi
from polyida.mesh.make.domains import Domain, Moved
from polyida.mesh.make.walls import meet, project
from polyida.mesh.numbering import renumber
from polyida.mesh.polygon_mesh import PolygonMesh
from polyida.mesh.sections import ON_CIRCLE, automatic

ATTEMPTS = 8  # with other seeds, where cells leave a part of the boundary without any
FARTHEST = 1e6  # sizes from the origin: beyond, the walls' round-off is that of the mesher's tolerances


def whole(value, what, least, most=10**9):
    """value as an int from least to most, else InputError."""
    if not is_whole(value, least, most):
        raise InputError(f"{what} is {value!r}; it must be a whole number, at least {least} (and at most {most})")
    return operator.index(value)


@named_keywords
def polygonize(domain: Domain, cells: int, seed: int = 0, iterations: int = 40) -> PolygonMesh:
    """Polygon mesh of a domain (see polyida.mesh.make.domains); about `cells` convex polygons.

    Nodes of the boundary lie on the domain's boundary, corners where walls meet are exact. Cells that a concave corner
    leaves non-convex are cut, so there may be a few more. Sections: left, right, top, bottom where the boundary
    has straight edges on the bounding box, and 'hole 0', ... for the rims of holes.
    The same seed gives the same mesh, bit by bit. Raises InputError for bad values.
    """
    if not isinstance(domain, Domain):
        raise InputError(f"polygonize needs a domain such as Rectangle or Link, not {domain!r}")
    cells, seed = whole(cells, "polygonize cells", 1), whole(seed, "polygonize seed", 0)
    domain, place = at_origin(domain)
    polygons = raw_polygons(domain, cells, seed, whole(iterations, "polygonize iterations", 1))
    points, nodes, offsets, _ = renumber(polygons.points, polygons.nodes, polygons.offsets)
    rim = topology.boundary_edges(nodes, offsets, len(points))
    return PolygonMesh(points + place, nodes, offsets, automatic(points, rim))


def at_origin(domain):
    """(domain moved to where its coordinates have all their digits, by how much): Voronoi's squares need them.

    It moves by whole powers of two, without round-off; a domain near the origin stays.
    """
    size = 2.0 ** np.ceil(np.log2(np.max(domain.upper - domain.lower)))
    place = size * np.round(domain.lower / size)
    if np.abs(place).max() > FARTHEST * size:
        raise InputError(
            f"polygonize: the domain begins at {domain.lower.tolist()}, more than {FARTHEST:g} of its sizes from the origin, "
            "too far for the digits of its walls; mesh it at the origin and move the plate by its origin="
        )
    return (Moved(domain, -place), place) if place.any() else (domain, 0.0)


def raw_polygons(domain, cells, seed, iterations):
    """Clean polygons of a domain before numbering, with boundary nodes on the walls and corners exact.

    Few cells may leave a part of the boundary without any: then the next random seeds of the same stream are tried.
    """
    rng = np.random.default_rng(seed)
    area = voronoi.estimated_area(domain, rng)
    corners = domain.corners()
    for _ in range(ATTEMPTS - 1):
        with suppress(voronoi.Unresolved):
            return _attempt(domain, cells, rng, area, corners, iterations)
    return _attempt(domain, cells, rng, area, corners, iterations)


def _attempt(domain, cells, rng, area, corners, iterations, tolerance=5e-3):
    spacing = np.sqrt(area / cells)
    fixed = concave.corner_seeds(domain, corners, spacing)[: cells - 1]
    free = voronoi.random_seeds(domain, cells - len(fixed), rng, fixed, spacing)
    seeds, diagram = voronoi.lloyd(fixed, free, domain, area, iterations, tolerance)

    def to_wall(points):
        return to_boundary(points, domain)

    polygons = concave.place_corners(snapped(seeds, diagram, domain, spacing, corners), corners, spacing)
    polygons = cleanup.collapse(cleanup.drop_flat_rim_nodes(polygons), project=to_wall)
    polygons = concave.split_concave_cells(cleanup.relax(polygons, to_wall))
    _require_resolved(polygons, domain, area, corners)
    return polygons


def _require_resolved(polygons, domain, area, corners):
    """Unresolved where a wall or corner has no nodes, an edge leaves the boundary, the mesh is pinched or too small."""
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
        raise voronoi.Unresolved(f"{len(found)} cells are too few to follow the boundary of the domain; use more cells")


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
    touched = _touched_walls(seeds, diagram, domain.walls)
    rim = touched.any(axis=1)
    points[rim], rank[rim] = to_boundary(points[rim], domain), 1
    _snap_corners(points, rank, touched, domain, spacing, corners)
    return cleanup.compact(points, cell[order], corner[order], rank)


def _touched_walls(seeds, diagram, walls):
    """(vertices, walls) mask: the vertex ends a ridge between a seed and an image.

    The images of two seeds around a re-entrant corner coincide, and the wall one was made with may be that of the
    other: a wall through which the seed itself has this image comes first.
    """
    rim = diagram.ridges.max(axis=1) >= diagram.n
    ends, pair = diagram.ends[rim], np.sort(diagram.ridges[rim], axis=1)
    seed, image = seeds[pair[:, 0]], diagram.points[pair[:, 1]]
    own = [seed - 2.0 * wall.distance(seed)[:, None] * wall.normal(seed) for wall in walls]
    miss = np.array([np.linalg.norm(image - other, axis=1) for other in own])
    exact = miss.min(axis=0) < 1e-9 * np.linalg.norm(image - seed, axis=1)
    wall = np.where(exact, miss.argmin(axis=0), diagram.wall[pair[:, 1]])
    touched = np.zeros((len(diagram.vertices), len(walls)), dtype=bool)
    touched[ends[:, 0], wall] = touched[ends[:, 1], wall] = True
    return touched


def _snap_corners(points, rank, touched, domain, spacing, corners):
    """Nodes that touch two walls move to where these meet; where a wall's extension meets another there is no corner."""
    size = float(np.max(domain.upper - domain.lower))
    for i, first in enumerate(domain.walls):
        for j, second in enumerate(domain.walls[:i]):
            both = np.flatnonzero(touched[:, i] & touched[:, j])
            if both.size:
                corner = meet(points[both], first, second)
                real = np.linalg.norm(corner - points[both], axis=1) < 0.5 * spacing
                if not domain.convex:
                    real &= (np.linalg.norm(corner[:, None] - corners, axis=2) < 1e-6 * size).any(axis=1)
                points[both[real]] = corner[real]
                rank[both[real]] = 2


def to_boundary(points, domain):
    """Each point projected on the nearest wall, where that is part of the boundary; points without such stay."""
    shifted = np.array([project(points, wall) for wall in domain.walls])
    away = np.linalg.norm(shifted - points, axis=2)
    away[~np.array([domain.on_boundary(image) for image in shifted])] = np.inf
    nearest = away.argmin(axis=0)
    return np.where(np.isinf(away.min(axis=0))[:, None], points, shifted[nearest, np.arange(len(points))])
