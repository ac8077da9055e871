"""Validity checks of a PolygonMesh at construction; every message names the cell or node and its position."""

from collections.abc import Mapping

import numpy as np

from polyida.errors import InputError
from polyida.mesh import topology
from polyida.validation import LARGEST, as_array, floats, is_flag, is_whole, reals


def _frozen(array, dtype):
    """A read-only C-contiguous copy of an array, with that dtype."""
    copy = np.array(array, dtype=dtype, order="C")
    copy.flags.writeable = False
    return copy


def point_array(points):
    """Return a read-only (n, 2) float64 copy. Raise InputError for another shape or numbers that are not finite."""
    array = reals(points)
    if array is None:
        raise InputError(f"mesh points must be an (n, 2) array of numbers, not {repr(points)[:80]}")
    if array.ndim != 2 or array.shape[1] != 2:
        raise InputError(f"mesh points have shape {array.shape}, they must be (n, 2)")
    bad = np.flatnonzero(~(np.abs(array) <= LARGEST).all(axis=1))
    if bad.size:
        raise InputError(f"mesh point {bad[0]} is {array[bad[0]].tolist()}; all coordinates must be finite, up to {LARGEST:g}")
    return _frozen(array, np.float64)


def index_array(values, what):
    """Return a read-only one-dimensional int32 copy. Raise InputError for anything but a list of integers."""
    array = as_array(values)
    if array is None:
        raise InputError(f"{what} must be a list of integers, not {repr(values)[:80]}")
    if array.size == 0:
        array = array.astype(np.int32)
    if array.ndim != 1 or array.dtype.kind not in "iu":
        raise InputError(f"{what} must be a one-dimensional array of integers, not {array.dtype} of shape {array.shape}")
    if array.size and (int(array.max()) > 2**31 - 1 or int(array.min()) < -(2**31)):
        raise InputError(f"{what} holds {array.min()}..{array.max()}, beyond 32 bit integers")
    return _frozen(array, np.int32)


def cell_arrays(nodes, offsets, n_nodes):
    """Return read-only nodes and offsets. Raise InputError unless all cells have at least three existing nodes."""
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


def require_order(order, nodes, offsets):
    """Raise InputError unless the order is 1 or 2, and cells of order 2 have a middle node after each corner."""
    if not is_whole(order, 1, 2):
        raise InputError(f"mesh order = {order!r} must be 1, or 2 for cells with a middle node on each side")
    if order == 1:
        return
    odd = np.flatnonzero((np.diff(offsets) % 2 != 0) | (np.diff(offsets) < 6))
    if odd.size:
        raise InputError(
            f"cell {odd[0]} has {np.diff(offsets)[odd[0]]} nodes; of order 2 it needs a middle node after each of three corners or more"
        )
    both = np.intersect1d(nodes[::2], nodes[1::2])
    if both.size:
        raise InputError(
            f"mesh node {both[0]} is a corner of one cell and the middle node of a side of another; for order 2 sides must match"
        )


def section_nodes(name, values, n_nodes):
    """Return the read-only node indices of a section. Raise InputError for nodes out of range, repeated nodes or none."""
    nodes = index_array(values, f"section {name!r}")
    if nodes.size == 0:
        raise InputError(f"section {name!r} has no nodes")
    if nodes.min() < 0 or nodes.max() >= n_nodes:
        raise InputError(f"section {name!r} names nodes {nodes.min()}..{nodes.max()}; the mesh has 0..{n_nodes - 1}")
    if len(np.unique(nodes)) < nodes.size:
        raise InputError(f"section {name!r} names a node twice")
    return nodes


def node_pairs(what, values, n_nodes, kind):
    """Return {node: (x, y)} with x and y of a kind, bool or float. Raise InputError for other nodes or values."""
    if not isinstance(values, Mapping):
        raise InputError(f"mesh {what} are {repr(values)[:80]}; they must be a dictionary, node -> (x, y)")
    right = "two of True or False, whether x and y are fixed" if kind is bool else "two finite numbers, N"
    pairs = {}
    for node, value in values.items():
        if not is_whole(node, 0, n_nodes - 1):
            raise InputError(f"mesh {what} name node {node!r}; the mesh has 0..{n_nodes - 1}")
        pair = floats([float(part) if is_flag(part) else part for part in value] if np.iterable(value) else value)
        if pair is None or pair.shape != (2,) or (kind is bool and not np.isin(pair, (0.0, 1.0)).all()):
            raise InputError(f"mesh {what} at node {node} are {repr(value)[:80]}; they must be {right}")
        pairs[int(node)] = tuple(map(kind, pair.tolist()))
    return pairs


STRAIGHT = 1e-9  # rad: so far round-off turns a straight side at its middle node


def described(mesh, cell):
    """Return the cell with its place in words, such as 'cell 3 at (0.1, 0.2)'."""
    x, y = mesh.points[mesh.cell(cell)].mean(axis=0)
    return f"cell {cell} at ({x:.6g}, {y:.6g})"


def require_valid_cells(mesh):
    """Raise InputError unless every node is used, every cell is counter-clockwise and simple, and no two cells overlap."""
    unused = np.flatnonzero(np.bincount(mesh.nodes, minlength=mesh.n_nodes) == 0)
    if unused.size:
        raise InputError(f"node {unused[0]} at {mesh.points[unused[0]].tolist()} belongs to no cell ({unused.size} such nodes)")
    cell = topology.corner_cells(mesh.offsets)
    keys = np.sort(cell.astype(np.int64) * mesh.n_nodes + mesh.nodes)
    twice = np.flatnonzero(keys[1:] == keys[:-1])
    if twice.size:
        number, node = divmod(keys[twice[0]], mesh.n_nodes)
        raise InputError(f"{described(mesh, number)} has node {node} as two of its corners")
    with np.errstate(over="ignore", invalid="ignore"):
        size = np.ptp(mesh.points, axis=0).max()
        bad = np.flatnonzero(~(mesh.cell_areas > 1e-14 * np.square(size) / mesh.n_cells))
    if bad.size:
        area = mesh.cell_areas[bad[0]]
        raise InputError(
            f"{described(mesh, bad[0])} has area {area:.3g}; cells must be counter-clockwise, with positive area ({bad.size} such cells)"
        )
    for number in _maybe_crossed(mesh):
        if _crosses_itself(mesh.points[mesh.cell(number)]):
            raise InputError(f"{described(mesh, number)} crosses or touches itself")
    _require_opposite_sides(mesh, cell)
    if cells := overlapping_cells(mesh):
        raise InputError(
            f"{described(mesh, cells[0])} and {described(mesh, cells[1])} overlap: a mesh covers no place twice; "
            "what lies on another part is a plate of its own"
        )


def _maybe_crossed(mesh):
    """Numbers of the cells that may cross themselves: a cell whose corners all turn left, by one full turn in sum, is simple."""
    turn = topology.turns(mesh.points, mesh.nodes, mesh.offsets)
    once = np.abs(np.add.reduceat(turn, mesh.offsets[:-1]) - 2 * np.pi) < 1e-6
    least = 0.0 if mesh.order == 1 else -STRAIGHT
    return np.flatnonzero(~(once & (np.minimum.reduceat(turn, mesh.offsets[:-1]) > least)))


def _crosses_itself(corners):
    """True if edges of a polygon (n, 2) without common corner meet, or if one folds back on the edge before it."""
    ends = np.roll(corners, -1, axis=0)
    edge = ends - corners
    after = np.roll(edge, -1, axis=0)
    folded = (topology.cross(edge, after) == 0) & (np.einsum("ij,ij->i", edge, after) <= 0)
    side_a, side_b = (topology.cross(edge[:, None], points[None] - corners[:, None]) for points in (corners, ends))
    split = side_a * side_b <= 0
    low, high = np.minimum(corners, ends), np.maximum(corners, ends)
    near = ((low[:, None] <= high[None]) & (low[None] <= high[:, None])).all(axis=2)
    i, j = np.indices(split.shape)
    apart = np.minimum((i - j) % len(corners), (j - i) % len(corners)) > 1
    return folded.any() or (split & split.T & near & apart).any()


def _require_opposite_sides(mesh, cell):
    """Raise InputError for two cells that have an edge in the same direction; cell: that of each corner."""
    edges = topology.directed_edges(mesh.nodes, mesh.offsets).astype(np.int64)
    sides = edges[:, 0] * mesh.n_nodes + edges[:, 1]
    order = np.argsort(sides, kind="stable")
    same = np.flatnonzero(sides[order][1:] == sides[order][:-1])
    if same.size:
        first, second = cell[order[[same[0], same[0] + 1]]]
        raise InputError(
            f"{described(mesh, first)} and {described(mesh, second)} lie on the same side of the edge "
            f"{edges[order[same[0]]].tolist()}: cells must not overlap"
        )


DEPTH = 1e-4  # relative to an edge's length: smaller overlaps count as touching
CROSSING = 1e-6  # the same for the ends of two edges that cross
AT_ONCE = 500_000  # pairs of edges in memory


def overlapping_cells(mesh):
    """Return two cells that overlap, or None.

    Cells overlap if two boundary edges cross, or if a point beside a boundary edge, on its inner side, is covered twice: the winding number
    of the boundary about it exceeds 1.
    """
    all_edges, edges = topology.directed_edges(mesh.nodes, mesh.offsets), mesh.boundary_edges
    places = mesh.points - mesh.points.min(axis=0)
    places = places[:, ::-1] * [-1, 1] if np.ptp(places[:, 1]) > np.ptp(places[:, 0]) else places  # pairs are sought along the longer axis
    start, end = places[edges[:, 0]], places[edges[:, 1]]
    along = end - start
    length = np.hypot(*along.T)
    inner = start + along / 2 + DEPTH * np.column_stack([-along[:, 1], along[:, 0]])
    round_off = 8 * np.finfo(float).eps * np.abs(mesh.points).max()

    def owner(edge):
        """Number of the first cell of the mesh that has the directed edge (2,), from its first node to its second."""
        return int(topology.corner_cells(mesh.offsets)[np.argmax((all_edges == edge).all(axis=1))])

    def separated(a, b, depth):
        """True if the ends of edge b lie on both sides of edge a."""
        side = [topology.cross(along[a], ends[b] - start[a]) / length[a] for ends in (start, end)]
        return (np.minimum(*side) < -depth) & (np.maximum(*side) > depth)

    cover = _winding(inner, start, end)
    low, high = (function([start[:, 0], end[:, 0], inner[:, 0]], axis=0) for function in (np.min, np.max))
    for i, j in _pairs_that_meet(low, high):
        depth = CROSSING * np.minimum(length[i], length[j]) + round_off
        crossing = np.flatnonzero(separated(i, j, depth) & separated(j, i, depth))
        if crossing.size:
            return owner(edges[i[crossing[0]]]), owner(edges[j[crossing[0]]])
        for point, edge in ((i, j), (j, i)):
            cover += np.bincount(point, _winding(inner[point], start[edge], end[edge]), len(edges)).astype(int)
    twice = np.flatnonzero(cover > 1)
    if not twice.size:
        return None
    own, corners = owner(edges[twice[0]]), places[all_edges]
    around = np.add.reduceat(
        _winding(np.broadcast_to(inner[twice[0]], corners[:, 0].shape), corners[:, 0], corners[:, 1]), mesh.offsets[:-1]
    )
    return own, int(next(cell for cell in np.flatnonzero(around) if cell != own))


def _pairs_that_meet(low, high):
    """Yield arrays (i, j) of the pairs of intervals [low, high] (n,) that meet, each pair once, about AT_ONCE pairs at a time."""
    order = np.argsort(low, kind="stable")
    reach = np.searchsorted(low[order], high[order], side="right") - np.arange(1, len(order) + 1)
    begin = 0
    while begin < len(order):
        chunk = max(1, int(np.searchsorted(np.cumsum(reach[begin:]), AT_ONCE, side="right")))
        part = np.arange(begin, min(begin + chunk, len(order)))
        first = np.repeat(part, reach[part])
        step = np.arange(len(first)) - np.repeat(np.cumsum(reach[part]) - reach[part], reach[part])
        yield order[first], order[first + 1 + step]
        begin = part[-1] + 1


def _winding(points, start, end):
    """Contribution of each edge to the winding number about its point, by a ray upwards: 1 leftwards, -1 rightwards, 0."""
    right = (start[:, 0] <= points[:, 0]) & (points[:, 0] < end[:, 0])
    left = (end[:, 0] <= points[:, 0]) & (points[:, 0] < start[:, 0])
    side = topology.cross(end - start, points - start)
    return (left & (side > 0)).astype(int) - (right & (side < 0))
