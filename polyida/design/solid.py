"""From densities to a mesh of what is solid."""

import warnings
from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike

from polyida.errors import InputError
from polyida.given import floats, is_number, is_one_of
from polyida.keywords import named_keywords
from polyida.mesh import MeshWarning, PolygonMesh, sections, topology
from polyida.mesh.numbering import renumber

HANGING = ("raise", "leave out")


@named_keywords
def threshold(mesh: PolygonMesh, rho: ArrayLike, at: float = 0.5, keep: Iterable[str] = (), hanging: str = "raise") -> PolygonMesh:
    """The PolygonMesh of the cells with a density rho (n_cells,) of at least `at`, ready to be analysed again.

    keep: names of sections whose cells stay whatever their density, so that these sections are what they were; of the others, and of
    supports and loads, what is left stays under its name. Cells that only touch the rest in a node, or not at all, hang: `hanging` says
    whether to "raise" an InputError that names the pieces, or to "leave out" all but the largest, with a MeshWarning. Nodes and cells are
    numbered anew.
    Raises InputError for densities of another number, an unknown section, where nothing is solid, and where a section to keep is on a piece
    that hangs.
    """
    if not isinstance(mesh, PolygonMesh):
        raise InputError(f"threshold: mesh is {type(mesh).__name__}, a polyida mesh is needed")
    given = floats(rho)
    if given is None or given.shape != (mesh.n_cells,):
        raise InputError(f"threshold: rho is {repr(rho)[:80]}; it must be {mesh.n_cells} finite numbers, one a cell")
    if not is_number(at):
        raise InputError(f"threshold: at = {at!r} must be a finite number")
    if not is_one_of(hanging, HANGING):
        raise InputError(f"threshold: hanging = {hanging!r} must be 'raise' or 'leave out'")
    held = {name: _cells_along(mesh, name) for name in _names(mesh, keep)}
    solid = given >= at
    solid[[cell for cells in held.values() for cell in cells]] = True
    if not solid.any():
        raise InputError(f"threshold: no cell has a density of at least {at:g}; the largest is {given.max():.6g}")
    return _part(mesh, _main_piece(mesh, solid, held, hanging))


def _names(mesh, keep):
    """The names of sections to keep, checked."""
    names = [keep] if isinstance(keep, str) else list(keep) if np.iterable(keep) else [keep]
    for name in names:
        if not is_one_of(name, mesh.sections):
            known = ", ".join(map(repr, mesh.sections)) or "none"
            raise InputError(f"threshold: keep names {name!r}, which is no section; the mesh's sections are {known}")
    return names


def _cells_along(mesh, name):
    """Cells that have an edge of a section, and all cells of its nodes that have none."""
    chosen, cell = mesh.sections[name], topology.corner_cells(mesh.offsets)
    edges = topology.directed_edges(mesh.nodes, mesh.offsets).astype(np.int64) @ [mesh.n_nodes, 1]
    within = sections.edges_within(mesh, chosen)
    along = np.isin(edges, within.astype(np.int64) @ [mesh.n_nodes, 1])
    alone = np.isin(mesh.nodes, np.setdiff1d(chosen, within))
    return np.unique(cell[along | alone])


def _main_piece(mesh, solid, held, hanging):
    """Mask of the solid cells of the largest piece; InputError or a MeshWarning for the others."""
    piece = _pieces(mesh, solid)
    area = np.bincount(piece[solid], weights=mesh.cell_areas[solid])
    main = int(np.argmax(area))
    if len(area) == 1:
        return solid
    for name, cells in held.items():
        if (piece[cells] != main).any():
            raise InputError(f"threshold: section {name!r}, which is to be kept, is not connected to the largest piece")
    if hanging == "raise":
        raise InputError(f"threshold: {_told(mesh, piece, area, main)}; a lower `at` may join them, hanging='leave out' leaves them out")
    warnings.warn(f"threshold: left out: {_told(mesh, piece, area, main)}", MeshWarning, stacklevel=4)
    return piece == main


def _pieces(mesh, solid):
    """(n_cells,) number of the piece that each solid cell is of, joined by edges, -1 of the others."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    pairs = np.sort(topology.directed_edges(mesh.nodes, mesh.offsets).astype(np.int64), axis=1) @ [mesh.n_nodes, 1]
    cell = topology.corner_cells(mesh.offsets)[order := np.argsort(pairs, kind="stable")]
    shared = np.flatnonzero(np.diff(pairs[order]) == 0)
    a, b = cell[shared], cell[shared + 1]
    both = solid[a] & solid[b]
    graph = coo_array((np.ones(both.sum()), (a[both], b[both])), shape=(mesh.n_cells, mesh.n_cells))
    label = connected_components(graph, directed=False)[1]
    found = np.full(mesh.n_cells, -1)
    found[solid] = np.unique(label[solid], return_inverse=True)[1]
    return found


def _told(mesh, piece, area, main, most=5):
    """The pieces beside the main one in words, the largest first."""
    others = [k for k in np.argsort(-area) if k != main]
    words = [_piece_told(mesh, np.flatnonzero(piece == k)) for k in others[:most]]
    more = f" and {len(others) - most} more" if len(others) > most else ""
    return f"{len(others)} hanging piece{'s' * (len(others) > 1)}, {'; '.join(words)}{more}"


def _piece_told(mesh, cells):
    x, y = np.average(mesh.cell_centroids[cells], axis=0, weights=mesh.cell_areas[cells])
    return f"{len(cells)} cell{'s' * (len(cells) > 1)} around ({x:.4g}, {y:.4g})"


def _part(mesh, chosen):
    """The mesh of the chosen cells alone, numbered anew, with what is left of sections, supports and loads."""
    corner = chosen[topology.corner_cells(mesh.offsets)]
    used, nodes = np.unique(mesh.nodes[corner], return_inverse=True)
    offsets = np.concatenate([[0], np.cumsum(np.diff(mesh.offsets)[chosen])])
    points, nodes, offsets, number = renumber(mesh.points[used], nodes, offsets)
    place = np.full(mesh.n_nodes, -1)
    place[used] = number
    named = {name: np.sort(left) for name, of in mesh.sections.items() if (left := place[of][place[of] >= 0]).size}
    at_nodes = [{int(place[node]): pair for node, pair in pairs.items() if place[node] >= 0} for pairs in (mesh.supports, mesh.loads)]
    return PolygonMesh(points, nodes, offsets, named, *at_nodes)
