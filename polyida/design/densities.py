"""Densities of cells: factors of stiffness and mass (RAMP, SIMP, projection), and the mesh of what is solid.

The functions of rho return their value and its derivative.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike

from polyida.errors import InputError
from polyida.mesh import MeshWarning, PolygonMesh, sections, topology
from polyida.validation import SMALLEST, floats, is_number, is_one_of, named_keywords, number, positive


@named_keywords
def ramp(rho: ArrayLike, q: float = 20.0, void: float = 1e-3) -> tuple[np.ndarray, np.ndarray]:
    """Return the stiffness of the RAMP interpolation, `void + (1 - void) rho / (1 + q (1 - rho))`, and its derivative.

    The derivative at rho = 0 is not zero: with `mass(rho)` in proportion, regions of low density have no slow vibrations of their own.

    Parameters
    ----------
    rho : float or array, 0 to 1
    q : float, >= 0
    void : float in (0, 1)
        Relative stiffness at rho = 0.

    Returns
    -------
    (stiffness, derivative) : arrays like rho, no unit
        The relative stiffness and its derivative with respect to rho.

    Raises
    ------
    InputError
        If a value is out of range.

    Notes
    -----
    Rational approximation of material properties: Stolpe, Svanberg, Struct. Multidisc. Optim. 22 (2001).
    """
    rho, void = _densities("ramp", rho), _fraction("ramp", "void", void)
    q = number("ramp", "q", q, "no unit", 0.0)
    below = 1.0 + q * (1.0 - rho)
    return void + (1.0 - void) * rho / below, (1.0 - void) * (1.0 + q) / below**2


@named_keywords
def simp(rho: ArrayLike, p: float = 3.0, void: float = 1e-3) -> tuple[np.ndarray, np.ndarray]:
    """Return the stiffness of the SIMP interpolation, `void + (1 - void) rho^p`, and its derivative.

    For dynamics use `mass(rho, low=0.1)`: with mass in proportion, regions of low density have slow vibrations of their own.

    Parameters
    ----------
    rho : float or array, 0 to 1
    p : float, >= 1
    void : float in (0, 1)
        Relative stiffness at rho = 0.

    Returns
    -------
    (stiffness, derivative) : arrays like rho, no unit
        The relative stiffness and its derivative with respect to rho.

    Raises
    ------
    InputError
        If a value is out of range.

    Notes
    -----
    Bendsoe, Sigmund, Arch. Appl. Mech. 69 (1999), in the modified form.
    """
    rho, void = _densities("simp", rho), _fraction("simp", "void", void)
    if not (is_number(p) and p >= 1):
        raise InputError(f"simp: p = {p!r} must be a number of at least 1")
    return void + (1.0 - void) * rho**p, (1.0 - void) * p * rho ** (p - 1.0)


@named_keywords
def mass(rho: ArrayLike, low: float = 0.0, void: float = 1e-3) -> tuple[np.ndarray, np.ndarray]:
    """Return the mass `void + (1 - void) m(rho)` and its derivative: m = rho, and `6 rho^6 / low^5 - 5 rho^7 / low^6` below `low`.

    The polynomial continues rho with its value and derivative and decreases as rho^6, faster than the stiffness of SIMP.

    Parameters
    ----------
    rho : float or array, 0 to 1
    low : float in [0, 1)
    void : float in (0, 1)
        Relative mass at rho = 0.

    Returns
    -------
    (mass, derivative) : arrays like rho, no unit
        The relative mass and its derivative with respect to rho.

    Raises
    ------
    InputError
        If a value is out of range.

    Notes
    -----
    Polynomial of Du, Olhoff, Struct. Multidisc. Optim. 34 (2007).
    """
    rho, void = _densities("mass", rho), _fraction("mass", "void", void)
    if not (is_number(low) and (low == 0 or SMALLEST <= float(low) < 1)):
        raise InputError(f"mass: low = {low!r:.100} must be 0, or from {SMALLEST:g} to 1")
    part = np.where(rho < low, rho / (low or 1.0), 1.0)
    value = np.where(rho < low, low * (6.0 - 5.0 * part) * part**6, rho)
    return void + (1.0 - void) * value, (1.0 - void) * (36.0 - 35.0 * part) * part**5


@named_keywords
def project(rho: ArrayLike, beta: float, eta: float = 0.5) -> tuple[np.ndarray, np.ndarray]:
    """Return the smoothed Heaviside projection of densities at eta, and its derivative.

    `(tanh(beta eta) + tanh(beta (rho - eta))) / (tanh(beta eta) + tanh(beta (1 - eta)))`: 0 and 1 are fixed points; a larger beta moves
    values above eta nearer to 1 and values below eta nearer to 0.

    Parameters
    ----------
    rho : float or array, 0 to 1
    beta : float, > 0
    eta : float in (0, 1)

    Returns
    -------
    (density, derivative) : arrays like rho, no unit
        The projected density and its derivative with respect to rho.

    Raises
    ------
    InputError
        If a value is out of range.

    Notes
    -----
    Wang, Lazarov, Sigmund, Struct. Multidisc. Optim. 43 (2011).
    """
    rho, eta = _densities("project", rho), _fraction("project", "eta", eta)
    beta = positive("project", "beta", beta, "no unit")
    shifted, low = np.tanh(beta * (rho - eta)), np.tanh(beta * eta)
    span = low + np.tanh(beta * (1.0 - eta))
    return (low + shifted) / span, beta * (1.0 - shifted**2) / span


def _densities(function, rho, round_off=1e-9):
    """rho as an array clipped to [0, 1]: a filter may exceed the interval by round-off. Raises InputError if it does by more."""
    array = floats(rho)
    if array is None or (np.abs(array - 0.5) > 0.5 + round_off).any():
        shown = repr(rho)[:80] if array is None else f"{array.min():.6g} to {array.max():.6g}"
        raise InputError(f"{function}: densities rho are {shown}; they must be numbers from 0 to 1")
    return np.clip(array, 0.0, 1.0)


def _fraction(function, name, value):
    """A number between 0 and 1 as a float. Raises InputError for anything else."""
    if not (is_number(value) and 0 < value < 1):
        raise InputError(f"{function}: {name} = {value!r} must be between 0 and 1")
    return float(value)


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
    if mesh.order == 2:
        return threshold(mesh.linear, density, at, keep, hanging=hanging).quadratic
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
    supports, loads = ({int(new[node]): pair for node, pair in pairs.items() if new[node] >= 0} for pairs in (mesh.supports, mesh.loads))
    return PolygonMesh(points, nodes, offsets, named, supports, loads)


def neighbours(mesh):
    """(cells on one side, cells on the other side) of each edge that two cells share, two arrays (edges,) of cell numbers."""
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


def cells_along(part, mesh, keep):
    """{section: cells with an edge in it, and all cells of its nodes without an edge}. Raises InputError for an unknown section."""
    cell, edges = topology.corner_cells(mesh.offsets), topology.directed_edges(mesh.nodes, mesh.offsets).astype(np.int64)
    result = {}
    for name in [keep] if isinstance(keep, str) else list(keep) if np.iterable(keep) else [keep]:
        if not is_one_of(name, mesh.sections):
            known = ", ".join(map(repr, mesh.sections)) or "none"
            raise InputError(f"{part}: keep names {name!r}, which is no section; the mesh's sections are {known}")
        within = sections.edges_within(mesh, mesh.sections[name])
        beside = np.isin(edges @ [mesh.n_nodes, 1], within.astype(np.int64) @ [mesh.n_nodes, 1])
        result[name] = np.unique(cell[beside | np.isin(mesh.nodes, np.setdiff1d(mesh.sections[name], within))])
    return result
