"""From densities to the mesh of what is solid."""

from __future__ import annotations

import warnings
from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike

from polyida.design.variables import cells_along
from polyida.errors import InputError
from polyida.mesh import MeshWarning, PolygonMesh, topology
from polyida.validation import floats, is_number, is_one_of, named_keywords


@named_keywords
def threshold(mesh: PolygonMesh, rho: ArrayLike, at: float = 0.5, keep: Iterable[str] = (), hanging: str = "raise") -> PolygonMesh:
    """Return the mesh of the cells with a density of at least `at`, to analyse the design.

    Sections, supports and loads keep their names and the nodes that remain. Nodes and cells are renumbered.

    Parameters
    ----------
    mesh : PolygonMesh
    rho : (n_cells,) float
    at : float
    keep : str or iterable of str
        Sections whose cells remain whatever their density, so that these sections do not change.
    hanging : "raise" or "leave out"
        For pieces that share no edge with the largest piece: raise an InputError that lists them, or leave them out with a MeshWarning.

    Returns
    -------
    PolygonMesh
        The solid cells.

    Raises
    ------
    InputError
        For wrong values, an unknown section, no solid cell, hanging pieces, or a section of `keep` on a hanging piece.
    """
    if not isinstance(mesh, PolygonMesh):
        raise InputError(f"threshold: mesh is {type(mesh).__name__}, a polyida mesh is needed")
    density = floats(rho)
    if density is None or density.shape != (mesh.n_cells,):
        raise InputError(f"threshold: rho is {repr(rho)[:80]}; it must be {mesh.n_cells} finite numbers, one a cell")
    if not is_number(at):
        raise InputError(f"threshold: at = {at!r} must be a finite number")
    if not is_one_of(hanging, ("raise", "leave out")):
        raise InputError(f"threshold: hanging = {hanging!r} must be 'raise' or 'leave out'")
    cell, cells_of_section = topology.corner_cells(mesh.offsets), cells_along("threshold", mesh, keep)
    solid = density >= at
    for cells in cells_of_section.values():
        solid[cells] = True
    if not solid.any():
        raise InputError(f"threshold: no cell has a density of at least {at:g}; the largest is {density.max():.6g}")
    solid = _main_piece(mesh, solid, cells_of_section, hanging)
    used, nodes = np.unique(mesh.nodes[solid[cell]], return_inverse=True)
    offsets = np.concatenate([[0], np.cumsum(np.diff(mesh.offsets)[solid])])
    points, nodes, offsets, number = topology.renumber(mesh.points[used], nodes, offsets)
    new = np.full(mesh.n_nodes, -1)
    new[used] = number
    named = {name: np.sort(rest) for name, old in mesh.sections.items() if (rest := new[old][new[old] >= 0]).size}
    at_nodes = [{int(new[node]): pair for node, pair in pairs.items() if new[node] >= 0} for pairs in (mesh.supports, mesh.loads)]
    return PolygonMesh(points, nodes, offsets, named, *at_nodes)


def neighbours(mesh):
    """Cells on both sides of each inner edge, two arrays (edges,)."""
    pairs = np.sort(topology.directed_edges(mesh.nodes, mesh.offsets).astype(np.int64), axis=1) @ [mesh.n_nodes, 1]
    cell = topology.corner_cells(mesh.offsets)[order := np.argsort(pairs, kind="stable")]
    shared = np.flatnonzero(np.diff(pairs[order]) == 0)
    return cell[shared], cell[shared + 1]


def _main_piece(mesh, solid, cells_of_section, hanging, most=5):
    """Mask of the solid cells of the largest piece connected by edges; InputError or a MeshWarning lists at most `most` other pieces."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    a, b = neighbours(mesh)
    both = solid[a] & solid[b]
    graph = coo_array((np.ones(both.sum()), (a[both], b[both])), shape=(mesh.n_cells, mesh.n_cells))
    label = connected_components(graph, directed=False)[1]
    piece = np.full(mesh.n_cells, -1)  # number of the piece of each solid cell
    piece[solid] = np.unique(label[solid], return_inverse=True)[1]
    area = np.bincount(piece[solid], weights=mesh.cell_areas[solid])
    main = int(np.argmax(area))
    if len(area) == 1:
        return solid
    for name, cells in cells_of_section.items():
        if (piece[cells] != main).any():
            raise InputError(f"threshold: section {name!r}, which is to be kept, is not connected to the largest piece")
    others, words = [k for k in np.argsort(-area) if k != main], []
    for k in others[:most]:
        cells = np.flatnonzero(piece == k)
        x, y = np.average(mesh.cell_centroids[cells], axis=0, weights=mesh.cell_areas[cells])
        words.append(f"{len(cells)} cell{'s' * (len(cells) > 1)} around ({x:.4g}, {y:.4g})")
    more = f" and {len(others) - most} more" if len(others) > most else ""
    listed = f"{len(others)} hanging piece{'s' * (len(others) > 1)}, {'; '.join(words)}{more}"
    if hanging == "raise":
        raise InputError(f"threshold: {listed}; a lower `at` may join them, hanging='leave out' leaves them out")
    warnings.warn(f"threshold: left out: {listed}", MeshWarning, stacklevel=4)
    return piece == main
