"""What a PolygonMesh must be, checked once at construction; every message names the cell or node and its place."""

from collections.abc import Mapping

import numpy as np

from polyida.errors import InputError
from polyida.given import floats, is_flag, is_whole, reals
from polyida.mesh import topology
from polyida.mesh.overlap import overlapping_cells


def _frozen(array, dtype):
    copy = np.array(array, dtype=dtype, order="C")
    copy.flags.writeable = False
    return copy


def point_array(points):
    """Read-only (n, 2) float64 copy; InputError unless finite and of that shape."""
    given = reals(points)
    if given is None:
        raise InputError(f"mesh points must be an (n, 2) array of numbers, not {repr(points)[:80]}")
    points = _frozen(given, np.float64)
    if points.ndim != 2 or points.shape[1] != 2:
        raise InputError(f"mesh points have shape {points.shape}, they must be (n, 2)")
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if bad.size:
        raise InputError(f"mesh point {bad[0]} is {points[bad[0]].tolist()}; all coordinates must be finite")
    return points


def index_array(values, what):
    """Read-only one-dimensional int32 copy; InputError for anything that is not a list of integers."""
    try:
        array = np.asarray(values)
    except ValueError as error:
        raise InputError(f"{what} must be a list of integers: {error}") from None
    if array.size == 0:
        array = array.astype(np.int32)
    if array.ndim != 1 or array.dtype.kind not in "iu":
        raise InputError(f"{what} must be a one-dimensional array of integers, not {array.dtype} of shape {array.shape}")
    if array.size and (int(array.max()) > 2**31 - 1 or int(array.min()) < -(2**31)):
        raise InputError(f"{what} holds {array.min()}..{array.max()}, beyond 32 bit integers")
    return _frozen(array, np.int32)


def cell_arrays(nodes, offsets, n_nodes):
    """Read-only nodes and offsets; InputError unless they describe cells of at least three existing nodes."""
    nodes, offsets = index_array(nodes, "mesh nodes"), index_array(offsets, "mesh offsets")
    if len(offsets) < 2 or offsets[0] != 0 or offsets[-1] != len(nodes):
        raise InputError(f"mesh offsets must run from 0 to the number of corners ({len(nodes)}) over at least one cell")
    few = np.flatnonzero(np.diff(offsets) < 3)
    if few.size:
        raise InputError(f"cell {few[0]} has {np.diff(offsets)[few[0]]} corners; it needs at least 3")
    outside = np.flatnonzero((nodes < 0) | (nodes >= n_nodes))
    if outside.size:
        cell = topology.corner_cells(offsets)[outside[0]]
        raise InputError(f"cell {cell} names node {nodes[outside[0]]}; the mesh has nodes 0..{n_nodes - 1}")
    return nodes, offsets


def section_nodes(name, values, n_nodes):
    """Read-only node indices of a section; InputError for nodes out of range, repeated or none at all."""
    nodes = index_array(values, f"section {name!r}")
    if nodes.size == 0:
        raise InputError(f"section {name!r} has no nodes")
    if nodes.min() < 0 or nodes.max() >= n_nodes:
        raise InputError(f"section {name!r} names nodes {nodes.min()}..{nodes.max()}; the mesh has 0..{n_nodes - 1}")
    if len(np.unique(nodes)) < nodes.size:
        raise InputError(f"section {name!r} names a node twice")
    return nodes


def node_pairs(what, given, n_nodes, kind):
    """{node: (x, y)} with both as kind, bool or float; InputError for other nodes and other values."""
    if not isinstance(given, Mapping):
        raise InputError(f"mesh {what} are {repr(given)[:80]}; they must be a dictionary, node -> (x, y)")
    right = "two of True or False, whether x and y are fixed" if kind is bool else "two finite numbers, N"
    pairs = {}
    for node, value in given.items():
        if not is_whole(node, 0, n_nodes - 1):
            raise InputError(f"mesh {what} name node {node!r}; the mesh has 0..{n_nodes - 1}")
        pair = floats([float(part) if is_flag(part) else part for part in value] if np.iterable(value) else value)
        if pair is None or pair.shape != (2,) or (kind is bool and not np.isin(pair, (0.0, 1.0)).all()):
            raise InputError(f"mesh {what} at node {node} are {repr(value)[:80]}; they must be {right}")
        pairs[int(node)] = tuple(map(kind, pair.tolist()))
    return pairs


def _place(mesh, cell):
    x, y = mesh.points[mesh.cell(cell)].mean(axis=0)
    return f"cell {cell} at ({x:.6g}, {y:.6g})"


def require_valid_cells(mesh):
    """InputError unless every node is used, every cell counter-clockwise and simple, and no two cells overlap."""
    unused = np.flatnonzero(np.bincount(mesh.nodes, minlength=mesh.n_nodes) == 0)
    if unused.size:
        raise InputError(f"node {unused[0]} at {mesh.points[unused[0]].tolist()} belongs to no cell ({unused.size} such nodes)")
    cell = topology.corner_cells(mesh.offsets)
    keys = np.sort(cell.astype(np.int64) * mesh.n_nodes + mesh.nodes)
    twice = np.flatnonzero(keys[1:] == keys[:-1])
    if twice.size:
        raise InputError(f"{_place(mesh, keys[twice[0]] // mesh.n_nodes)} has node {keys[twice[0]] % mesh.n_nodes} as two of its corners")
    with np.errstate(over="ignore", invalid="ignore"):
        size = np.ptp(mesh.points, axis=0).max()
        bad = np.flatnonzero(~(mesh.cell_areas > 1e-14 * np.square(size) / mesh.n_cells))
    if bad.size:
        area = mesh.cell_areas[bad[0]]
        raise InputError(
            f"{_place(mesh, bad[0])} has area {area:.3g}; cells must be counter-clockwise, with positive area ({bad.size} such cells)"
        )
    _require_simple(mesh)
    _require_single_edges(mesh)
    if cells := overlapping_cells(mesh):
        raise InputError(
            f"{_place(mesh, cells[0])} and {_place(mesh, cells[1])} overlap: a mesh covers no place twice; "
            "what lies on another part is a plate of its own"
        )


def _require_simple(mesh):
    """A cell whose corners all turn left, once around in sum, is simple; only the others need their edges crossed."""
    turn = topology.turns(mesh.points, mesh.nodes, mesh.offsets)
    once = np.abs(np.add.reduceat(turn, mesh.offsets[:-1]) - 2 * np.pi) < 1e-6
    left = np.minimum.reduceat(turn, mesh.offsets[:-1]) > 0
    for cell in np.flatnonzero(~(once & left)):
        if _crosses_itself(mesh.points[mesh.cell(cell)]):
            raise InputError(f"{_place(mesh, cell)} crosses or touches itself")


def _crosses_itself(corner):
    """True when two edges that share no corner meet, or two that do fold back on each other."""
    a, b = corner, np.roll(corner, -1, axis=0)
    edge = b - a
    after = np.roll(edge, -1, axis=0)
    folded = (topology.cross(edge, after) == 0) & (np.einsum("ij,ij->i", edge, after) <= 0)
    side_a = topology.cross(edge[:, None], a[None] - a[:, None])
    side_b = topology.cross(edge[:, None], b[None] - a[:, None])
    split = side_a * side_b <= 0
    low, high = np.minimum(a, b), np.maximum(a, b)
    near = ((low[:, None] <= high[None]) & (low[None] <= high[:, None])).all(axis=2)
    i, j = np.indices(split.shape)
    apart = np.minimum((i - j) % len(a), (j - i) % len(a)) > 1
    return bool(folded.any() or (split & split.T & near & apart).any())


def _require_single_edges(mesh):
    pairs = topology.directed_edges(mesh.nodes, mesh.offsets).astype(np.int64)
    keys = pairs[:, 0] * mesh.n_nodes + pairs[:, 1]
    order = np.argsort(keys, kind="stable")
    same = np.flatnonzero(keys[order][1:] == keys[order][:-1])
    if same.size:
        first, second = topology.corner_cells(mesh.offsets)[order[[same[0], same[0] + 1]]]
        raise InputError(
            f"{_place(mesh, first)} and {_place(mesh, second)} lie on the same side of the edge "
            f"{pairs[order[same[0]]].tolist()}: cells must not overlap"
        )


def require_convex(mesh, tolerance):
    """InputError naming the first corner whose turn, as a sine, is not above the tolerance."""
    turn = topology.turns(mesh.points, mesh.nodes, mesh.offsets)
    bad = np.flatnonzero(~((np.sin(turn) > tolerance) & (turn > 0)))
    if bad.size:
        cell = topology.corner_cells(mesh.offsets)[bad[0]]
        angle = 180.0 - np.degrees(turn[bad[0]])
        raise InputError(
            f"{_place(mesh, cell)} is not strictly convex: its angle at node {mesh.nodes[bad[0]]} is "
            f"{angle:.4f} degrees and must be below 180"
        )
