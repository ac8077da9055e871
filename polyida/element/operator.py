"""The reference operator: constant data of a mesh's elements, packed for the kernels. Measures of polygons of equal vertex count.

Polygons: corners (n, 2, c), counter-clockwise, c cells on the last axis.
"""

from dataclasses import dataclass
from typing import NamedTuple

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


CHUNK = 256  # cells treated at once: the work arrays then fit into the cache
LISTED = ("corners", "gradients", "weights", "pairs")  # arrays whose block starts a row of the layout holds


class Cells(NamedTuple):
    """The cells of one body: arrays of a ReferenceOperator, and the body's first node in u."""

    layout: np.ndarray
    corners: np.ndarray
    gradients: np.ndarray
    weights: np.ndarray
    first_node: int


class Blocks(NamedTuple):
    """The blocks (M, 2, 2) of a tangent, those of the body from number `first` on, and `pairs` of its ReferenceOperator."""

    pairs: np.ndarray
    first: int
    values: np.ndarray


class Material(NamedTuple):
    """c = t E_mod / (1 - nu^2), N/m, or without the thickness t, Pa; Poisson's ratio; the Kelvin-Voigt relaxation time tau_v, s."""

    stiffness: float
    nu: float
    viscosity: float = 0.0


@dataclass(frozen=True, eq=False)
class ReferenceOperator:
    """Gradients, weights and mass of a mesh's elements, independent of thickness and material, shared by identical bodies.

    A block holds LANES cells of n corners and p points; an incomplete block repeats its last cell with weight 0. The gradients of a cell sum
    to zero, so those of the last corner are not stored. A row of `layout` holds n, p and the starts of the block in `corners`, `gradients`,
    `weights` and `pairs`, whose blocks are

        corners    [corner][lane]                      node
        gradients  [point][corner < n - 1][x, y][lane]  1/m
        weights    [point][lane]                       reference area of the point, m^2
        pairs      [corner i][corner j][lane]          position of (node i, node j) in the node pattern

    The node pattern (indptr, indices) is the CSR pattern of nodes with a common cell: sorted, symmetric, with the diagonal. `mass`, the
    integral of N_i N_j (m^2), and `stabilisation`, a constant scalar matrix or None, have this pattern; they are sums of `cell_mass` and
    `cell_stabilisation`, stored as `pairs`, 0 in repeated cells. offsets (cells + 1), nodes: the mesh's cells; areas (cells,), m^2;
    mean_gradients (len(nodes), 2), 1/m: exact means over each cell; lane_cells, int32: the cells in the order of the lanes.
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
        """The number of cells of the mesh."""
        return len(self.offsets) - 1

    def cells(self, first_node=0):
        """The Cells of a body whose first node in u has this number."""
        return Cells(self.layout, self.corners, self.gradients, self.weights, first_node)


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
    """Return the ReferenceOperator of a mesh; `element` computes the data of cells of equal vertex count.

    mesh: any object with points (N, 2) in m, nodes and offsets (the corners of cell i are nodes[offsets[i]:offsets[i + 1]]).
    element(corners (n, 2, c), cells (c,), nodes (n, c)) returns areas (c,), mean gradients (n, 2, c) and, as in a CellGroup, gradients,
    weights, mass and optionally stabilisation. Raise InputError for a node without a cell, since it would have no mass.
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
    indptr, indices, places = _pattern(len(points), groups)
    blocks = [_blocks(group, place) for group, place in zip(groups, places)]
    flat = {name: np.concatenate([block[name].ravel() for block in blocks]) for name in blocks[0]}
    along = np.argsort(flat["lane_cells"][::LANES], kind="stable")
    matrices = {name: flat[name] for name in ("cell_mass", "cell_stabilisation") if name in flat}
    return ReferenceOperator(
        offsets=_integers(mesh.offsets),
        nodes=_integers(mesh.nodes),
        n_nodes=len(points),
        areas=areas,
        mean_gradients=means,
        layout=_layout(groups, blocks)[along],
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


def _layout(groups, blocks):
    """The rows of Cells.layout of all blocks, group after group: corners, points, and the starts of the block in the arrays of LISTED."""
    tables, starts = [], np.zeros(4, dtype=np.int64)
    for group, block in zip(groups, blocks):
        listed = [block[name] for name in LISTED]
        count = len(listed[0])
        shape = np.full((count, 2), (len(group.nodes), len(group.weights)))
        sizes = np.array([array[0].size for array in listed])
        tables.append(np.hstack([shape, starts + np.arange(count)[:, None] * sizes]).astype(np.int64))
        starts = starts + [array.size for array in listed]
    return np.concatenate(tables)


def _pattern(n_nodes, groups):
    """CSR pattern (indptr, indices) of the pairs of nodes that share a cell, and for each group the positions (n, n, c) of its pairs in it."""
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
    """{name: (blocks, ..., LANES)} of the arrays of a group; values that kernels sum are zero in repeated cells."""
    count = len(group.cells)
    order = np.minimum(np.arange(-(-count // LANES) * LANES), count - 1)  # the last cell repeated until LANES divides the length
    copied = {"lane_cells": group.cells, "corners": group.nodes, "gradients": group.gradients[:, :-1], "pairs": place}
    summed = {"weights": group.weights, "cell_mass": group.mass, "cell_stabilisation": group.stabilisation}
    lanes = {name: array[..., order] for name, array in (copied | summed).items() if array is not None}
    for name in summed.keys() & lanes.keys():
        lanes[name][..., count:] = 0.0
    return {name: np.moveaxis(array.reshape(*array.shape[:-1], -1, LANES), -2, 0) for name, array in lanes.items()}


def _integers(array):
    """A copy of an array as integers of 32 bits."""
    return np.array(array, dtype=np.int32)


def _aligned(numbers):
    """The numbers, aligned to 64 bytes: loading a block then reads one cache line."""
    padded = np.empty(numbers.size + 8)
    start = -padded.ctypes.data % 64 // 8
    padded[start : start + numbers.size] = numbers
    return padded[start : start + numbers.size]
