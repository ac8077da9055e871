"""Everything about a mesh's elements that does not change in time, packed for the kernels, and measures of polygons side by side.

Polygons: corners (n, 2, c), counter-clockwise, c cells on the last axis.
"""

from dataclasses import dataclass

import numpy as np

from polyida.errors import InputError
from polyida.jit.intrinsics import LANES


def cross(a, b):
    """a_x b_y - a_y b_x for vectors along axis -2."""
    return a[..., 0, :] * b[..., 1, :] - a[..., 1, :] * b[..., 0, :]


def after(array):
    """The next corner's entry at every corner."""
    return np.roll(array, -1, axis=0)


def before(array):
    """The previous corner's entry at every corner."""
    return np.roll(array, 1, axis=0)


def measures(corners):
    """Area (c,), centroid (2, c) and the exact mean gradients (n, 2, c) = oint N_i n ds / area of linear edges."""
    follower = after(corners)
    double = cross(corners, follower)
    area = double.sum(axis=0) / 2
    centroid = np.einsum("nc,ndc->dc", double, corners + follower) / (6 * area)
    chord = (follower - before(corners)) / (2 * area)
    return area, centroid, np.stack([chord[:, 1], -chord[:, 0]], axis=1)


def second_moments(corners):
    """int x (x) x over the polygons, (2, 2, c), about the origin: exact, from the triangles origin - edge."""
    follower = after(corners)
    double = cross(corners, follower)
    return sum(np.einsum("nc,ndc,nec->dec", double, x, x) for x in (corners, follower, corners + follower)) / 24


CHUNK = 256
"""Cells treated at once: the work arrays then stay in the cache."""

LISTED = ("corners", "gradients", "weights", "pairs")
"""What a row of the layout holds the starts of."""


@dataclass(frozen=True, eq=False)
class ReferenceOperator:
    """Gradients, weights and mass of a mesh's elements: free of thickness and material, shared by identical bodies.

    Cells of n corners and p points lie LANES at a time in blocks; a block that is not full repeats its last cell with
    weight 0. Gradients of a cell sum to zero, so the last corner's are not stored. A row of `layout` holds n, p and the
    starts of the block in `corners`, `gradients`, `weights` and `pairs`, whose blocks are

        corners    [corner][lane]                      node
        gradients  [point][corner < n - 1][x, y][lane]  1/m
        weights    [point][lane]                       reference area of the point, m^2
        pairs      [corner i][corner j][lane]          place of (node i, node j) in the node pattern

    The node pattern (indptr, indices) is the adjacency of nodes through cells in rows: sorted, symmetric, with the
    diagonal. On it live `mass`, the integral of N_i N_j (m^2), and `stabilisation`, a constant scalar matrix or None:
    sums of `cell_mass` and `cell_stabilisation`, what each cell adds, which lie as `pairs` do, 0 in repeated cells.

    offsets (cells + 1), nodes: the mesh's cells; areas (cells,) m^2; mean_gradients (len(nodes), 2) 1/m: exact means
    over each cell; lane_cells int32, the cells in the order of the lanes.
    """

    offsets: np.ndarray
    nodes: np.ndarray
    n_nodes: int
    areas: np.ndarray
    mean_gradients: np.ndarray
    layout: np.ndarray
    lane_cells: np.ndarray
    corners: np.ndarray
    gradients: np.ndarray
    weights: np.ndarray
    pairs: np.ndarray
    indptr: np.ndarray
    indices: np.ndarray
    mass: np.ndarray
    cell_mass: np.ndarray
    stabilisation: np.ndarray | None = None
    cell_stabilisation: np.ndarray | None = None

    @property
    def n_cells(self):
        """Number of cells."""
        return len(self.offsets) - 1

    @property
    def force_arrays(self):
        """First arguments of kernels.internal_force and kernels.strain_energy."""
        return self.layout, self.corners, self.gradients, self.weights


@dataclass(frozen=True, eq=False)
class CellGroup:
    """Cells of one vertex count n with p points each, cells on the last axis.

    cells (c,); nodes (n, c); gradients (p, n, 2, c); weights (p, c); mass and stabilisation (n, n, c) or None.
    """

    cells: np.ndarray
    nodes: np.ndarray
    gradients: np.ndarray
    weights: np.ndarray
    mass: np.ndarray
    stabilisation: np.ndarray | None = None


def build(mesh, element):
    """ReferenceOperator of a mesh from what `element` makes of cells of equal vertex count.

    mesh: anything with points (N, 2) in m, nodes and offsets (corners of cell i are nodes[offsets[i]:offsets[i + 1]]).
    element(corners (n, 2, c), cells (c,), nodes (n, c)) returns areas (c,), mean gradients (n, 2, c) and, as in a
    CellGroup, gradients, weights, mass and where there is one the stabilisation; it raises InputError for a cell that
    it cannot treat. Raises InputError for a node that belongs to no cell.
    """
    points = np.asarray(mesh.points, dtype=float)
    offsets, nodes = np.asarray(mesh.offsets, dtype=np.int64), np.asarray(mesh.nodes, dtype=np.int64)
    counts = np.diff(offsets)
    areas, means = np.empty(len(counts)), np.empty((len(nodes), 2))
    groups = []
    for n in np.unique(counts):
        cells = np.flatnonzero(counts == n)
        slots = offsets[cells] + np.arange(n)[:, None]
        corners = points[nodes[slots]].transpose(0, 2, 1)
        chunks = [slice(k, k + CHUNK) for k in range(0, len(cells), CHUNK)]
        parts = [element(corners[..., k], cells[k], nodes[slots[:, k]]) for k in chunks]
        area, mean, *rest = (np.concatenate(part, axis=-1) for part in zip(*parts))
        areas[cells], means[slots] = area, mean.transpose(0, 2, 1)
        groups.append(CellGroup(cells, nodes[slots], *rest))
    return pack(mesh, areas, means, groups)


def pack(mesh, areas, mean_gradients, groups):
    """ReferenceOperator of a mesh from its groups of cells.

    Raises InputError if a node belongs to no cell, since it would have no mass.
    """
    n_nodes = len(mesh.points)
    indptr, indices, places = _pattern(n_nodes, groups)
    blocks = [_blocks(group, place) for group, place in zip(groups, places)]
    flat = {name: np.concatenate([block[name].ravel() for block in blocks]) for name in blocks[0]}
    tables, starts = [], np.zeros(4, dtype=np.int64)
    for group, block in zip(groups, blocks):
        known = [block[name] for name in LISTED]
        count = len(known[0])
        shape = np.full((count, 2), (len(group.nodes), len(group.weights)))
        sizes = np.array([array[0].size for array in known])
        tables.append(np.hstack([shape, starts + np.arange(count)[:, None] * sizes]).astype(np.int64))
        starts = starts + [array.size for array in known]
    along = np.argsort(flat["lane_cells"][::LANES], kind="stable")
    matrices = {name: flat[name] for name in ("cell_mass", "cell_stabilisation") if name in flat}
    return ReferenceOperator(
        offsets=_integers(mesh.offsets),
        nodes=_integers(mesh.nodes),
        n_nodes=n_nodes,
        areas=areas,
        mean_gradients=mean_gradients,
        layout=np.concatenate(tables)[along],
        lane_cells=_integers(flat["lane_cells"].reshape(-1, LANES)[along].ravel()),
        corners=_integers(flat["corners"]),
        gradients=_aligned(flat["gradients"]),
        weights=_aligned(flat["weights"]),
        pairs=_integers(flat["pairs"]),
        indptr=indptr,
        indices=indices,
        **matrices,
        **{name.removeprefix("cell_"): np.bincount(flat["pairs"], values) for name, values in matrices.items()},
    )


def _pattern(n_nodes, groups):
    """Node pattern, and for each group the places (n, n, c) of its corner pairs."""
    keys = [(group.nodes[:, None] * np.int64(n_nodes) + group.nodes[None]) for group in groups]
    flat = np.concatenate([key.ravel() for key in keys])
    ordered = np.sort(flat)
    ordered = ordered[np.append(True, ordered[1:] != ordered[:-1])]
    rows, columns = np.divmod(ordered, n_nodes)
    lengths = np.bincount(rows, minlength=n_nodes)
    if not lengths.all():
        raise InputError(f"mesh: node {int(np.argmin(lengths))} belongs to no cell; remove it, it would have no mass")
    place = np.searchsorted(ordered, flat)
    splits = np.cumsum([key.size for key in keys])[:-1]
    places = [part.reshape(key.shape) for part, key in zip(np.split(place, splits), keys)]
    return _integers(np.append(0, np.cumsum(lengths))), _integers(columns), places


def _blocks(group, place):
    """{name: (blocks, ..., LANES)} of the numbers of a group; what is summed up is zero in repeated cells."""
    order, count = _lane_order(len(group.cells)), len(group.cells)
    given = {"lane_cells": group.cells, "corners": group.nodes, "gradients": group.gradients[:, :-1], "pairs": place}
    summed = {"weights": group.weights, "cell_mass": group.mass, "cell_stabilisation": group.stabilisation}
    lanes = {name: array[..., order] for name, array in (given | summed).items() if array is not None}
    for name in summed.keys() & lanes.keys():
        lanes[name][..., count:] = 0.0
    return {name: np.moveaxis(array.reshape(*array.shape[:-1], -1, LANES), -2, 0) for name, array in lanes.items()}


def _lane_order(count):
    """Positions 0 .. count - 1, the last repeated until LANES divides the length."""
    return np.minimum(np.arange(-(-count // LANES) * LANES), count - 1)


def _integers(array):
    return np.array(array, dtype=np.int32)


def _aligned(numbers):
    """The numbers, starting on a 64-byte boundary: one block load then touches one cache line."""
    room = np.empty(numbers.size + 8)
    start = -room.ctypes.data % 64 // 8
    room[start : start + numbers.size] = numbers
    return room[start : start + numbers.size]
