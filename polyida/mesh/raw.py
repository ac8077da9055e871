"""From file data to a PolygonMesh: RawMesh before any check, its unit and its repair."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np

from polyida.errors import InputError, NamingWarning
from polyida.mesh import checks, sections, topology
from polyida.mesh.polygon_mesh import PolygonMesh
from polyida.validation import LARGEST, SMALLEST, as_array, is_number, is_one_of, listed, named_keywords

METRES = {"m": 1.0, "dm": 0.1, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "in": 0.0254, "ft": 0.3048}
WIDE = 20.0  # m: a wider part of a mechanism was probably drawn in millimetres
WITHIN = 1e-6  # of an edge's length: a node that is nearer lies within the edge
LARGEST_COORDINATE = 1e100  # coordinates, in the file's unit
FLAT = 1e-9  # variation of z relative to the size of the mesh


class MeshWarning(NamingWarning):
    """A mesh from a file or drawing was changed, or looks wrong."""


@named_keywords
@dataclass(frozen=True, eq=False)
class RawMesh:
    """Points, cells and names as in a file, before `pi.mesh.read` repairs and checks them; what the reader of a `Format` returns.

    Parameters
    ----------
    points : (n, 2) or (n, 3) float
        In the file's unit.
    cells : iterable of lists of point numbers, or arrays (m, k) of m cells with k corners
    sections : dict of name to point numbers
    supports : dict of point number to (x fixed, y fixed)
    loads : dict of point number to (Fx, Fy), N
    notes : tuple of str
        Messages for the user.
    metres : float, optional
        Size of the file's unit, if known.
    first : int
        Number of the first point.
    middles : (k, 3) int, optional
        Both corners and the middle point of sides of elements of order 2. If all sides have one, the mesh has order 2.
    """

    points: np.ndarray
    cells: Iterable
    sections: Mapping = field(default_factory=dict)
    supports: Mapping = field(default_factory=dict)
    loads: Mapping = field(default_factory=dict)
    notes: tuple = ()
    metres: float | None = None
    first: int = 0
    middles: np.ndarray | None = None


def sides_of(corners, middles):
    """Rows (k, 3) of both corners and the middle of the sides of cells (m, n), whose middles (m, n) follow their first corners."""
    return np.stack([corners, np.roll(corners, -1, axis=1), middles], axis=2).reshape(-1, 3)


def unit_size(unit, of_file=None):
    """Return the size, m, of the user's unit (a name or a number), else of the file's unit, else 1. Raise InputError for other units."""
    if unit is None:
        return of_file or 1.0
    if is_one_of(unit, METRES):
        return METRES[unit]
    if is_number(unit) and SMALLEST <= float(unit) <= LARGEST:
        return float(unit)
    raise InputError(f"unit is {unit!r}; it must be one of {', '.join(METRES)}, or the metres in one unit of the file")


def unit_note(points, unit, of_file):
    """Return [question for the user] if the unit is unknown and the points may be in millimetres, else []."""
    width = float(np.ptp(points, axis=0).max())
    if unit is not None or of_file is not None or width <= WIDE:
        return []
    return [f"it is {width:.6g} m wide; if its numbers are millimetres pass unit='mm', if they are metres unit='m'"]


def counted(count, what):
    """Return a number with its noun in singular or plural: '1 cell', '2 cells'."""
    return f"{count} {what}" + ("" if count == 1 else "s")


def repaired(raw, tolerance, scale=1.0, numbered=True):
    """Return (PolygonMesh, notes) of a RawMesh: lengths times scale, points within tolerance times the size merged.

    numbered: renumber if that reduces the bandwidth by a fifth, and sort the cells by their nodes.
    """
    notes = list(raw.notes)
    points, nodes, offsets, middles = _arrays(raw, notes)
    target = _merged(points, np.unique(nodes), tolerance, notes)
    used, nodes = np.unique(target[nodes], return_inverse=True)
    nodes, offsets = _with_three_corners(nodes, offsets, notes)
    nodes = _counter_clockwise(points[used], nodes, offsets, notes)
    place = np.full(len(points), -1)  # node of each point of the file, -1 for a point of no cell
    place[used] = np.arange(len(used))
    place = place[target]
    unused = np.setdiff1d(np.flatnonzero(place < 0), middles[:, 2])
    if unused.size:
        notes.append(f"left out {counted(unused.size, 'point')} of no cell, the first at {points[unused[0]].tolist()}")
    points = points if scale == 1.0 else points * scale
    at_middles, points = points[middles[:, 2]], points[used]
    if numbered:
        points, nodes, offsets, place = _renumbered(points, nodes, offsets, place)
    points, nodes, offsets, order = _with_middles(points, nodes, offsets, place, middles, at_middles, notes)
    supports = {node: tuple(np.any(rows, axis=0).tolist()) for node, rows in _at_nodes("supports", raw, place, bool).items()}
    loads = {node: tuple(np.sum(rows, axis=0).tolist()) for node, rows in _at_nodes("loads", raw, place, float).items()}
    named = sections.automatic(points, topology.boundary_edges(nodes, offsets, len(points)))
    named |= _sections_of_supports(supports, loads) | _sections_of_file(raw, place, notes)  # those of the file have priority
    mesh = PolygonMesh(points, nodes, offsets, named, supports, loads, order)
    return mesh, notes + _unjoined(mesh)


def _arrays(raw, notes):
    """(points (n, 2), corners of all cells (corners,), offsets (cells + 1,), middles (k, 3)) of a RawMesh, its nodes counted from 0.

    Corners of cell i are those from offsets[i] to offsets[i + 1]. notes: a list, to which notes for the user are appended. Raises
    InputError for wrong points, cells, or numbers out of range.
    """
    nodes, offsets = _joined(raw.cells)
    points = np.asarray(raw.points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] not in (2, 3):
        raise InputError(f"points have shape {points.shape}, they must have 2 or 3 coordinates")
    nodes, points = nodes - raw.first, np.column_stack([points, np.zeros((len(points), 3 - points.shape[1]))])
    _require_range(nodes, offsets, len(points), raw.first)
    middles = np.zeros((0, 3), np.int64) if raw.middles is None else np.asarray(raw.middles, np.int64) - raw.first
    return _flat(points, np.unique(np.concatenate([nodes, middles[:, 2]])), notes), nodes, offsets, middles


def _with_three_corners(nodes, offsets, notes):
    """(nodes, offsets) without corners equal to the one before, and without cells that then have fewer than three corners."""
    cell = topology.corner_cells(offsets)
    keep = nodes != nodes[topology.preceding(offsets)]
    size = np.bincount(cell[keep], minlength=len(offsets) - 1)
    gone = np.flatnonzero(size < 3)
    if gone.size == len(size):
        raise InputError("no cell has three different corners; each must have an area")
    if gone.size:
        notes.append(f"left out {counted(gone.size, 'cell')} with fewer than three different corners")
    repeated = np.flatnonzero(~keep & (size[cell] >= 3))
    if repeated.size:
        where = f"equal to the corner before, the first in cell {cell[repeated[0]]}"
        notes.append(f"left out {counted(repeated.size, 'corner')} {where}")
    keep &= size[cell] >= 3
    return nodes[keep], np.concatenate([[0], np.cumsum(size[size >= 3])])


def _counter_clockwise(points, nodes, offsets, notes):
    """The nodes of all cells with those of clockwise cells in reverse order; notes say how many there were."""
    cell = topology.corner_cells(offsets)
    mirror = offsets[cell] + offsets[cell + 1] - 1 - np.arange(len(nodes))
    turned = topology.areas(points, nodes, offsets) < 0.0
    if turned.any():
        notes.append(f"turned {counted(turned.sum(), 'clockwise cell')} of {len(turned)}")
    return np.where(turned[cell], nodes[mirror], nodes)


def _renumbered(points, nodes, offsets, place):
    """(points, nodes, offsets, place) with new numbers if these reduce the bandwidth by a fifth, else with sorted cells alone."""
    new_points, new_nodes, new_offsets, number = topology.renumber(points, nodes, offsets)
    if topology.half_bandwidth(new_nodes, new_offsets) < 0.8 * topology.half_bandwidth(nodes, offsets):
        return new_points, new_nodes, new_offsets, np.where(place >= 0, number[place], -1)
    return points, *topology.sorted_cells(nodes, offsets), place


def _with_middles(points, nodes, offsets, place, middles, at_middles, notes):
    """(points, nodes, offsets, order): of order 2 if each side has a middle point in `middles` (k, 3), at the places at_middles (k, 2).

    place: node of each point of the file; middle points get theirs here.
    """
    sides, first = np.unique(np.sort(place[middles[:, :2]], axis=1), axis=0, return_index=True)
    if np.array_equal(sides, topology.edges(nodes, offsets, len(points))):
        new = len(points) + np.arange(len(first))
        place[middles[first, 2]] = new
        return np.concatenate([points, at_middles[first]]), *topology.inserted(nodes, offsets, sides, new), 2
    if len(middles):
        notes.append("elements of order 2 became their corners, curved edges straight: not all sides have one middle node")
    return points, nodes, offsets, 1


def _sections_of_supports(supports, loads):
    """{name: nodes} of the sections "support", "support x", "support y" and "load", those that have nodes."""
    named = {
        "support": list(supports),
        "support x": [node for node, (x, _) in supports.items() if x],
        "support y": [node for node, (_, y) in supports.items() if y],
        "load": list(loads),
    }
    return {name: np.unique(rows) for name, rows in named.items() if rows}


def _sections_of_file(raw, place, notes):
    """{name: nodes} of the file's sections. Raises InputError for points that do not exist; sections without a corner are left out."""
    named = {}
    for name, values in raw.sections.items():
        index = checks.index_array(values, f"section {name!r}") - raw.first
        if index.size and (index.min() < 0 or index.max() >= len(place)):
            names = f"{index.min() + raw.first}..{index.max() + raw.first}"
            known = f"{raw.first}..{len(place) - 1 + raw.first}"
            raise InputError(f"section {name!r} names points {names}; there are points {known}")
        rows = np.unique(place[index])
        if (rows >= 0).any():
            named[name] = rows[rows >= 0]
        else:
            notes.append(f"left out section {name!r}, of which no point is a corner of a cell")
    return named


def _unjoined(mesh):
    """[note on the nodes that lie within an edge of the boundary: the cells on its two sides are not joined], or []."""
    from scipy.spatial import cKDTree

    nodes, (start, end) = mesh.boundary_nodes, mesh.points[mesh.boundary_edges.T]
    length = np.linalg.norm(end - start, axis=1)
    near = cKDTree(mesh.points[nodes]).query_ball_point(0.5 * (start + end), (0.5 - WITHIN) * length)
    edge = np.repeat(np.arange(len(near)), [len(one) for one in near])
    node = nodes[np.concatenate(near).astype(int)]
    away = np.abs(topology.cross(end[edge] - start[edge], mesh.points[node] - start[edge])) / length[edge]
    found = np.flatnonzero(away < WITHIN * length[edge])
    if not found.size:
        return []
    first, (a, b) = node[found[0]], mesh.boundary_edges[edge[found[0]]]
    return [
        f"node {first} at {mesh.points[first].tolist()} lies within the edge from node {a} to node {b}, of whose cell it is no corner: the cells "
        f"are not joined there ({counted(len(np.unique(node[found])), 'such node')})"
    ]


def _joined(cells):
    """(corners of all cells, offsets) of lists of point numbers and of arrays of cells with the same number of corners."""
    blocks, number = [], 0
    for cell in listed("mesh", "cells", cells):
        array = as_array(cell)
        array = np.empty((0, 0, 0)) if array is None else np.atleast_2d(array)
        whole = array.dtype.kind in "iu" or (array.dtype.kind == "f" and np.array_equal(array, np.round(array)))
        if array.ndim != 2 or not whole or (len(array) and array.shape[1] < 3) or np.abs(array).max(initial=0) > 2**31:
            raise InputError(f"cell {number} is {repr(cell)[:80]}; it must be a list of at least 3 nodes by number")
        number += len(array)
        if array.size:
            blocks.append(array.astype(np.int64))
    if not blocks:
        raise InputError("holds no triangles, quads or polygons")
    sizes = np.concatenate([np.full(len(block), block.shape[1]) for block in blocks])
    return np.concatenate([block.ravel() for block in blocks]), np.concatenate([[0], np.cumsum(sizes)])


def _require_range(nodes, offsets, n_points, first):
    """Raise InputError for the first cell with an unknown point; nodes from 0, first: number of the first point in the file."""
    outside = np.flatnonzero((nodes < 0) | (nodes >= n_points))
    if outside.size:
        cell = int(np.searchsorted(offsets, outside[0], side="right")) - 1
        from_one = first == 0 and nodes.min() == 1 and nodes.max() == n_points
        raise InputError(
            f"cell {cell} names point {nodes[outside[0]] + first}; there are points {first}..{n_points - 1 + first}"
            + ("; these cells count from 1, as first=1 of pi.mesh.from_lists takes them" if from_one else "")
        )


def _flat(points, used, notes):
    """(n, 2) points. Raise InputError if points of cells are not finite or not in one plane z = constant."""
    corner = points[used]
    bad = np.flatnonzero(~np.isfinite(corner).all(axis=1))
    if bad.size:
        raise InputError(f"point {used[bad[0]]} is {corner[bad[0]].tolist()}; all coordinates must be finite")
    bad = np.flatnonzero((np.abs(corner) > LARGEST_COORDINATE).any(axis=1))
    if bad.size:
        raise InputError(
            f"point {used[bad[0]]} is {corner[bad[0]].tolist()}; coordinates must be at most {LARGEST_COORDINATE:g}, so that areas are finite"
        )
    z = corner[:, 2]
    size = float(np.ptp(corner, axis=0).max())
    if np.ptp(z) > FLAT * size:
        off = int(np.argmax(np.abs(z - np.median(z))))
        raise InputError(
            f"is not plane: point {used[off]} is {corner[off].tolist()}, z runs from {z.min():.6g} to {z.max():.6g}; it must be 0"
        )
    if np.abs(z).max() > FLAT * size:
        notes.append(f"left out z, which is {z[0]:.6g} everywhere")
    return points[:, :2]


def _merged(points, used, tolerance, notes):
    """The point that replaces each point: the lowest numbered of those within tolerance times the size of the mesh."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    target = np.arange(len(points))
    if tolerance == 0.0:
        return target
    corner = points[used]
    distance = tolerance * float(np.ptp(corner, axis=0).max())
    different, group = np.unique(corner, axis=0, return_inverse=True)
    tree = cKDTree(different)
    if tree.count_neighbors(tree, distance) > 50 * len(different):
        raise InputError(f"has heaps of different points within {distance:.3g} of each other")
    pairs = tree.query_pairs(distance, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(different),) * 2)
    group = connected_components(graph, directed=False)[1][group.ravel()]
    leader = np.full(len(used), len(points))
    np.minimum.at(leader, group, used)
    target[used] = leader[group]
    moved = np.flatnonzero(target != np.arange(len(points)))
    if moved.size:
        where = f"within {tolerance:g} of the mesh's size, the first at {points[moved[0]].tolist()}"
        notes.append(f"merged {counted(moved.size, 'point')} with others {where}")
    return target


def _at_nodes(what, raw, place, kind):
    """{node: [pairs of its points]} of the supports or loads of a RawMesh; place: the node of each point, -1 if it has none."""
    nodes = {}
    for point, pair in checks.node_pairs(what, getattr(raw, what), len(place) + raw.first, kind).items():
        if point < raw.first or place[point - raw.first] < 0:
            place_of = "" if point < raw.first else f" at {np.asarray(raw.points[point - raw.first], float)[:2].tolist()}"
            raise InputError(f"{what} name point {point}{place_of}, which is no corner of a cell")
        nodes.setdefault(int(place[point - raw.first]), []).append(pair)
    return nodes
