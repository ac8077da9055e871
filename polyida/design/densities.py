"""From densities to factors of stiffness and mass, with their slopes, and from densities to a mesh of what is solid."""

import warnings
from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polyida.errors import InputError
from polyida.mesh import MeshWarning, PolygonMesh, sections, topology
from polyida.mesh.topology import renumber
from polyida.validation import floats, is_number, is_one_of, named_keywords


@named_keywords
def ramp(rho: ArrayLike, q: float = 20.0, void: float = 1e-3) -> tuple[NDArray, NDArray]:
    """(stiffness, its slope in rho) by RAMP: `void + (1 - void) rho / (1 + q (1 - rho))`; what has no density is `void` times as stiff.

    Its slope at rho = 0 is not zero: with `mass(rho)` in proportion, thin regions keep a stiffness in proportion to their mass and
    have no slow vibrations of their own. Raises InputError for densities outside [0, 1], q < 0 and void outside (0, 1).
    Source: Stolpe, Svanberg, Struct. Multidisc. Optim. 22 (2001).
    """
    rho, void = _densities("ramp", rho), _part("ramp", "void", void)
    if not (is_number(q) and q >= 0):
        raise InputError(f"ramp: q = {q!r} must be a number of at least 0")
    below = 1.0 + q * (1.0 - rho)
    return void + (1.0 - void) * rho / below, (1.0 - void) * (1.0 + q) / below**2


@named_keywords
def simp(rho: ArrayLike, p: float = 3.0, void: float = 1e-3) -> tuple[NDArray, NDArray]:
    """(stiffness, its slope in rho) by SIMP: `void + (1 - void) rho^p`; what has no density is `void` times as stiff.

    In motion it wants `mass(rho, low=0.1)`: with mass in proportion, thin regions have slow vibrations of their own. Raises InputError for
    densities outside [0, 1], p < 1 and void outside (0, 1). Source: Bendsoe, Sigmund, Arch. Appl. Mech. 69 (1999), in the modified form.
    """
    rho, void = _densities("simp", rho), _part("simp", "void", void)
    if not (is_number(p) and p >= 1):
        raise InputError(f"simp: p = {p!r} must be a number of at least 1")
    return void + (1.0 - void) * rho**p, (1.0 - void) * p * rho ** (p - 1.0)


@named_keywords
def mass(rho: ArrayLike, low: float = 0.0, void: float = 1e-3) -> tuple[NDArray, NDArray]:
    """(mass, its slope in rho): `void + (1 - void) m(rho)` with m = rho, and below `low` with `m = 6 rho^6 / low^5 - 5 rho^7 / low^6`.

    The polynomial goes on from rho with its value and slope and falls as rho^6, faster than the stiffness of SIMP. Raises InputError for
    densities outside [0, 1], low outside [0, 1) and void outside (0, 1).
    Source of the polynomial: Du, Olhoff, Struct. Multidisc. Optim. 34 (2007).
    """
    rho, void = _densities("mass", rho), _part("mass", "void", void)
    if not (is_number(low) and 0 <= low < 1):
        raise InputError(f"mass: low = {low!r} must be at least 0 and below 1")
    part = np.where(rho < low, rho / (low or 1.0), 1.0)
    value = np.where(rho < low, low * (6.0 - 5.0 * part) * part**6, rho)
    return void + (1.0 - void) * value, (1.0 - void) * (36.0 - 35.0 * part) * part**5


@named_keywords
def project(rho: ArrayLike, beta: float, eta: float = 0.5) -> tuple[NDArray, NDArray]:
    """(projected density, its slope in rho): `(tanh(beta eta) + tanh(beta (rho - eta))) / (tanh(beta eta) + tanh(beta (1 - eta)))`.

    0 and 1 stay; the larger beta, the nearer is all above eta to 1 and all below to 0. Raises InputError for densities outside [0, 1], a
    beta that is not positive and eta outside (0, 1). Source: Wang, Lazarov, Sigmund, Struct. Multidisc. Optim. 43 (2011).
    """
    rho, eta = _densities("project", rho), _part("project", "eta", eta)
    if not (is_number(beta) and beta > 0):
        raise InputError(f"project: beta = {beta!r} must be a positive number")
    shifted, low = np.tanh(beta * (rho - eta)), np.tanh(beta * eta)
    span = low + np.tanh(beta * (1.0 - eta))
    return (low + shifted) / span, beta * (1.0 - shifted**2) / span


def _densities(what, rho, round_off=1e-9):
    """rho as an array held to [0, 1], which a filter may leave by round-off."""
    given = floats(rho)
    if given is None or (np.abs(given - 0.5) > 0.5 + round_off).any():
        shown = repr(rho)[:80] if given is None else f"{given.min():.6g} to {given.max():.6g}"
        raise InputError(f"{what}: densities rho are {shown}; they must be numbers from 0 to 1")
    return np.clip(given, 0.0, 1.0)


def _part(what, name, value):
    if not (is_number(value) and 0 < value < 1):
        raise InputError(f"{what}: {name} = {value!r} must be between 0 and 1")
    return float(value)


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
    chosen = _main_piece(mesh, solid, held, hanging)
    corner = chosen[topology.corner_cells(mesh.offsets)]
    used, nodes = np.unique(mesh.nodes[corner], return_inverse=True)
    offsets = np.concatenate([[0], np.cumsum(np.diff(mesh.offsets)[chosen])])
    points, nodes, offsets, number = renumber(mesh.points[used], nodes, offsets)
    place = np.full(mesh.n_nodes, -1)
    place[used] = number
    named = {name: np.sort(left) for name, of in mesh.sections.items() if (left := place[of][place[of] >= 0]).size}
    at_nodes = [{int(place[node]): pair for node, pair in pairs.items() if place[node] >= 0} for pairs in (mesh.supports, mesh.loads)]
    return PolygonMesh(points, nodes, offsets, named, *at_nodes)


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
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    pairs = np.sort(topology.directed_edges(mesh.nodes, mesh.offsets).astype(np.int64), axis=1) @ [mesh.n_nodes, 1]
    cell = topology.corner_cells(mesh.offsets)[order := np.argsort(pairs, kind="stable")]
    shared = np.flatnonzero(np.diff(pairs[order]) == 0)
    a, b = cell[shared], cell[shared + 1]
    both = solid[a] & solid[b]
    graph = coo_array((np.ones(both.sum()), (a[both], b[both])), shape=(mesh.n_cells, mesh.n_cells))
    label = connected_components(graph, directed=False)[1]
    piece = np.full(mesh.n_cells, -1)  # of each solid cell, joined by edges, its number
    piece[solid] = np.unique(label[solid], return_inverse=True)[1]
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


def _told(mesh, piece, area, main, most=5):
    """The pieces beside the main one in words, the largest first."""
    others = [k for k in np.argsort(-area) if k != main]
    words = [_piece_told(mesh, np.flatnonzero(piece == k)) for k in others[:most]]
    more = f" and {len(others) - most} more" if len(others) > most else ""
    return f"{len(others)} hanging piece{'s' * (len(others) > 1)}, {'; '.join(words)}{more}"


def _piece_told(mesh, cells):
    x, y = np.average(mesh.cell_centroids[cells], axis=0, weights=mesh.cell_areas[cells])
    return f"{len(cells)} cell{'s' * (len(cells) > 1)} around ({x:.4g}, {y:.4g})"
