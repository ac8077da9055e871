"""From what a file holds to a PolygonMesh: flat, each point once and used, cells counter-clockwise, numbers that are near each other."""

import numpy as np

from polyida.errors import InputError
from polyida.mesh import checks, sections, topology
from polyida.mesh.polygon_mesh import PolygonMesh
from polyida.mesh.raw import joined, require_range
from polyida.mesh.topology import renumber, sorted_cells

FLAT = 1e-9  # of the size of the mesh, by which z may vary


def repaired(raw, tolerance, scale=1.0, numbered=True):
    """(PolygonMesh, notes) of a RawMesh: lengths times scale, points within tolerance times the size merged.

    numbered: renumber where that narrows the bandwidth by a fifth, and sort the cells along the nodes.
    """
    notes = list(raw.notes)
    nodes, offsets = joined(raw.cells)
    points = np.asarray(raw.points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] not in (2, 3):
        raise InputError(f"points have shape {points.shape}, they must have 2 or 3 coordinates")
    nodes, points = nodes - raw.first, np.column_stack([points, np.zeros((len(points), 3 - points.shape[1]))])
    require_range(nodes, offsets, len(points), raw.first)
    points = _flat(points, np.unique(nodes), notes)
    target = _merged(points, np.unique(nodes), tolerance, notes)
    used, nodes = np.unique(target[nodes], return_inverse=True)
    # corners equal to the one before go, and cells left with fewer than three corners
    cell = topology.corner_cells(offsets)
    keep = nodes != nodes[topology.preceding(offsets)]
    size = np.bincount(cell[keep], minlength=len(offsets) - 1)
    gone = np.flatnonzero(size < 3)
    if gone.size == len(size):
        raise InputError("no cell has three different corners; each must have an area")
    if gone.size:
        notes.append(f"left out {several(gone.size, 'cell')} with fewer than three different corners")
    keep &= size[cell] >= 3
    nodes, offsets = nodes[keep], np.concatenate([[0], np.cumsum(size[size >= 3])])
    own = topology.corner_cells(offsets)
    mirror = offsets[own] + offsets[own + 1] - 1 - np.arange(len(nodes))
    turned = topology.areas(points[used], nodes, offsets) < 0.0
    if turned.any():
        notes.append(f"turned {several(turned.sum(), 'clockwise cell')} of {len(turned)}")
    nodes = np.where(turned[own], nodes[mirror], nodes)
    place = np.full(len(points), -1)
    place[used] = np.arange(len(used))
    place = place[target]
    unused = np.flatnonzero(place < 0)
    if unused.size:
        notes.append(f"left out {several(unused.size, 'point')} of no cell, the first at {points[unused[0]].tolist()}")
    points = points[used] if scale == 1.0 else points[used] * scale
    if numbered:
        points, nodes, offsets, place = _numbered(points, nodes, offsets, place)
    # sections of the boundary, of supports and loads, and over them those with names in the file
    supports = {n: tuple(np.any(rows, axis=0).tolist()) for n, rows in _at_nodes("supports", raw, place, bool).items()}
    loads = {n: tuple(np.sum(rows, axis=0).tolist()) for n, rows in _at_nodes("loads", raw, place, float).items()}
    rim = topology.boundary_edges(nodes, offsets, len(points))
    found = {
        "support": list(supports),
        "support x": [node for node, (x, _) in supports.items() if x],
        "support y": [node for node, (_, y) in supports.items() if y],
        "load": list(loads),
    }
    found = sections.automatic(points, rim) | {name: np.unique(nodes) for name, nodes in found.items() if nodes}
    return PolygonMesh(points, nodes, offsets, found | _sections(raw.sections, place, raw.first), supports, loads), notes


def _flat(points, used, notes):
    """(n, 2): InputError for points of cells that are not finite or not in one plane z = constant."""
    corner = points[used]
    bad = np.flatnonzero(~np.isfinite(corner).all(axis=1))
    if bad.size:
        raise InputError(f"point {used[bad[0]]} is {corner[bad[0]].tolist()}; all coordinates must be finite")
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
    """Point that stands for each point: the lowest numbered of those within tolerance times the size of the mesh."""
    target = np.arange(len(points))
    if tolerance == 0.0:
        return target
    corner = points[used]
    size = float(np.ptp(corner, axis=0).max())
    _, first, group = np.unique(corner, axis=0, return_index=True, return_inverse=True)
    lowest = _near_groups(corner[first], tolerance * size)[group.ravel()]
    leader = np.full(len(used), len(points))
    np.minimum.at(leader, lowest, used)
    target[used] = leader[lowest]
    moved = np.flatnonzero(target != np.arange(len(points)))
    if moved.size:
        where = f"within {tolerance:g} of the mesh's size, the first at {points[moved[0]].tolist()}"
        notes.append(f"merged {several(moved.size, 'point')} with others {where}")
    return target


def _near_groups(points, distance):
    """Group number of each of the different points; points closer than the distance are in one group."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    tree = cKDTree(points)
    if tree.count_neighbors(tree, distance) > 50 * len(points):
        raise InputError(f"has heaps of different points within {distance:.3g} of each other")
    pairs = tree.query_pairs(distance, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(points), len(points)))
    return connected_components(graph, directed=False)[1]


def several(count, what):
    """'1 cell', '2 cells'."""
    return f"{count} {what}" + ("" if count == 1 else "s")


def _numbered(points, nodes, offsets, place):
    """The same with narrow numbering, where that gains a fifth of the bandwidth."""
    placed, new_nodes, new_offsets, number = renumber(points, nodes, offsets)
    if topology.half_bandwidth(new_nodes, new_offsets) < 0.8 * topology.half_bandwidth(nodes, offsets):
        return placed, new_nodes, new_offsets, np.where(place >= 0, number[place], -1)
    return points, *sorted_cells(nodes, offsets), place


def _at_nodes(what, raw, place, kind):
    """node -> [pairs of the points that are there now] of raw.supports or raw.loads."""
    found = {}
    for point, pair in checks.node_pairs(what, getattr(raw, what), len(place) + raw.first, kind).items():
        if point < raw.first or place[point - raw.first] < 0:
            raise InputError(f"{what} name point {point}, which is no corner of a cell")
        found.setdefault(int(place[point - raw.first]), []).append(pair)
    return found


def _sections(named, place, first):
    """name -> nodes, of those that have any; InputError for points that there are not."""
    found = {}
    for name, index in named.items():
        index = checks.index_array(index, f"section {name!r}") - first
        if index.size and (index.min() < 0 or index.max() >= len(place)):
            names = f"{index.min() + first}..{index.max() + first}"
            raise InputError(f"section {name!r} names points {names}; there are points {first}..{len(place) - 1 + first}")
        nodes = np.unique(place[index])
        found[name] = nodes[nodes >= 0]
    return {name: nodes for name, nodes in found.items() if nodes.size}
