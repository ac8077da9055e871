"""Meshes with smaller cells in chosen places, or with another number of cells, of the same outline."""

import numpy as np
from numpy.typing import ArrayLike

from polyida.errors import InputError
from polyida.mesh import cleanup, topology
from polyida.mesh.domains import nearest
from polyida.mesh.mesher import numbered, polygonize, voronoi_polygons
from polyida.mesh.outline import Outline, outline_of
from polyida.mesh.polygon_mesh import PolygonMesh
from polyida.mesh.sections import edges_within
from polyida.validation import as_array, named_keywords

PARTS = 4  # cells in place of one that is refined
BLEND = 40  # largest number of iterations that follow the wanted sizes of cells
NEAR = 20  # cells whose wanted sizes are averaged: sizes that jump leave distorted cells, which cost more than refinement gains


@named_keywords
def refine(mesh: PolygonMesh, cells: ArrayLike) -> PolygonMesh:
    """Return a mesh of the same outline with about four cells in place of each chosen one.

    The mesher starts from the centroids of the other cells and four points in each chosen one. Lloyd's iterations, with the wanted size of cells,
    averaged over neighbours, as density, blend the sizes. If no such mesh follows the boundary, as with cracks and notches of less than 20 degrees,
    each chosen cell is divided by its centroid and the middles of its edges.

    Parameters
    ----------
    mesh : PolygonMesh
    cells : (k,) int, or (n_cells,) bool
        The cells to be refined, such as those with the largest shares in `bars.cells["arm"]`.

    Returns
    -------
    PolygonMesh
        Of the same order, with the sections of the mesh that lie on its boundary. Loads and supports of files are left out.

    Raises
    ------
    InputError
        For cells that do not exist.

    Examples
    --------
    >>> shares = np.abs(bars.cells["arm"])
    >>> finer = pi.mesh.refine(mesh, np.argsort(shares)[-20:])
    """
    if not isinstance(mesh, PolygonMesh):
        raise InputError(f"refine: mesh is {type(mesh).__name__}, it must be a PolygonMesh")
    chosen, array = np.zeros(mesh.n_cells, bool), as_array(cells)
    array = np.zeros(0) if array is None else array
    whole = array.dtype.kind in "iu" and array.ndim == 1 and array.size and array.min() >= 0 and array.max() < mesh.n_cells
    if not (whole or (array.dtype == bool and array.shape == chosen.shape)):
        raise InputError(
            f"refine: cells = {cells!r:.80} must be indices from 0 to {mesh.n_cells - 1}, or a mask of all {mesh.n_cells} cells"
        )
    chosen[array] = True
    if mesh.order == 2:
        return refine(mesh.linear, chosen).quadratic
    try:
        new = _blended(mesh, np.where(chosen, PARTS, 1))
    except InputError:
        new = _divided(mesh, chosen)
    return _with_sections(numbered(new), mesh)


def _blended(mesh, parts):
    """Polygons of the outline of a mesh, about `parts` (n_cells,) for each cell."""
    from scipy.spatial import cKDTree

    outer, *holes = outline_of(mesh)
    domain = Outline(outer, holes)
    centres, areas, tree = mesh.cell_centroids, mesh.cell_areas / parts, cKDTree(mesh.cell_centroids)
    way = np.repeat(0.5 * np.sqrt(areas), parts)[:, None]
    number = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
    angle = 0.7 + 2.0 * np.pi * number / np.repeat(parts, parts)
    alone = np.repeat(parts == 1, parts)[:, None]
    seeds = np.repeat(centres, parts, axis=0) + np.where(alone, 0.0, 1.4 * way * np.stack([np.cos(angle), np.sin(angle)], axis=1))
    seeds = seeds[domain.distance(seeds) < 0.0]

    def size(points):
        """Wanted size of cells at points (n, 2), m: the mean of those of the NEAR next cells, by their distance."""
        away, near = tree.query(points, min(NEAR, len(areas)))
        weights = 1.0 / np.maximum(away, 1e-6 * way.min()).reshape(len(points), -1)
        logs = np.log(areas[near] / areas.max()).reshape(weights.shape)
        return np.sqrt(areas.max()) * np.exp(0.5 * (weights * logs).sum(axis=1) / weights.sum(axis=1))

    return voronoi_polygons(domain, len(seeds), 0, BLEND, start=seeds, size=size)


def _divided(mesh, chosen):
    """Polygons of a mesh, with a quadrilateral for each corner of a chosen cell, or of its convex pieces; neighbours with new nodes are cut."""
    pieces, numbers = cleanup.convex_cells(mesh.points, mesh.nodes, mesh.offsets)
    nodes, offsets, chosen = np.concatenate(pieces), np.cumsum([0, *map(len, pieces)]), chosen[numbers]
    pairs = np.sort(topology.directed_edges(nodes, offsets)[np.repeat(chosen, np.diff(offsets))])
    pairs, n = np.unique(pairs, axis=0), mesh.n_nodes
    points = np.concatenate([mesh.points, mesh.points[pairs].mean(axis=1), topology.centroids(mesh.points, nodes, offsets)])
    nodes, offsets = topology.inserted(nodes, offsets, pairs, n + np.arange(len(pairs)))
    cells = []
    for number, ring in enumerate(np.split(nodes, offsets[1:-1])):
        if chosen[number]:
            centre = np.full(len(ring) // 2, n + len(pairs) + number)
            cells.extend(np.stack([centre, np.roll(ring[1::2], 1), ring[::2], ring[1::2]], axis=1))
        else:
            cells.append(ring)
    cell = np.repeat(np.arange(len(cells)), [len(ring) for ring in cells])
    return cleanup.split_concave_cells(cleanup.compact(points, cell, np.concatenate(cells), np.zeros(len(points))))


def remeshed(mesh, cells):
    """A new polygonal mesh of about `cells` cells of equal size, with outline, sections and order (1 or 2) of `mesh`."""
    if mesh.order == 2:
        return remeshed(mesh.linear, cells).quadratic
    outer, *holes = outline_of(mesh)
    return _with_sections(polygonize(Outline(outer, holes), cells), mesh)


def _with_sections(new, mesh):
    """A new mesh with the sections of another one that lie on its boundary."""
    sections = dict(new.sections)
    for name, nodes in mesh.sections.items():
        start, end = mesh.points[edges_within(mesh, nodes).T]
        if name not in sections and len(start):
            rim = new.points[new.boundary_nodes]
            edge, share = nearest(rim, start, end - start)
            away = np.hypot(*(rim - start[edge] - share[:, None] * (end - start)[edge]).T)
            sections[name] = new.boundary_nodes[away < 1e-9 * np.ptp(mesh.points)]
    return PolygonMesh(new.points, new.nodes, new.offsets, sections)
