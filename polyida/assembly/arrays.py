"""A scene as plain arrays: what the compiled kernels take, and nothing else."""

from typing import NamedTuple

import numpy as np

from polyida.assembly.compact import Compact
from polyida.jit import pack


@pack
class Plates(NamedTuple):
    """The plates and their loads. Bodies' nodes are concatenated; equal meshes share one operator.

    Operators: concatenated arrays of `element.operator.ReferenceOperator` with the start of each (`at`, (operators + 1, 7): layout,
    corners, gradients, weights, pairs, indptr, nnz). stabilisation: like mass, of virtual elements. Bodies: operator
    number, first node, first block of the tangent, c1, nu, rho t, mass damping (1/s), viscosity (s), factor of the stabilisation (N/m).
    weight: gravity on every pair of q, (pairs, 2). Loads: forces on pairs times a drive.
    """

    at: np.ndarray
    layout: np.ndarray
    corners: np.ndarray
    gradients: np.ndarray
    weights: np.ndarray
    pairs: np.ndarray
    indptr: np.ndarray
    indices: np.ndarray
    mass: np.ndarray
    stabilisation: np.ndarray
    body_operator: np.ndarray
    body_node: np.ndarray
    body_block: np.ndarray
    body_c1: np.ndarray
    body_nu: np.ndarray
    body_density: np.ndarray
    body_drag: np.ndarray
    body_viscosity: np.ndarray
    body_stabilisation: np.ndarray
    weight: np.ndarray
    load_ptr: np.ndarray
    load_nodes: np.ndarray
    load_values: np.ndarray
    load_drive: np.ndarray


@pack
class Coupling(NamedTuple):
    """Which points are coupled beyond phi_z, by the curvature of rows, by force elements, and each with itself by its mass.

    Blocks (2, 2) of pairs of points, by rows: those of point p are `start[p]` to `start[p + 1]`, with the points `columns`.

    mirror: the transposed block of each. mass: the block of each point with itself, -1 where it has no mass. products: the blocks (E, F) of
    the products whose vectors both have points, in the order of `joint_curvature`. laws: those of each force element's sides, row by row,
    -1 where a side stays with the ground, from `law_start` on.
    """

    start: np.ndarray
    columns: np.ndarray
    mirror: np.ndarray
    mass: np.ndarray
    products: np.ndarray
    laws: np.ndarray
    law_start: np.ndarray


@pack
class Links(NamedTuple):
    """The points that joints and masses hold on to, and the rows of phi.

    Points: weighted sums of pairs of q in CSR form (`dz = A u`), weights complex numbers (., 2); the mass they carry.
    Rows: constant; the components of the points that each touches, in CSR form, and the slopes of its linear part. Shifts: a factor
    times a drive that is added to a row. Products
    `R(theta) E . F`: their row, the vectors E and F, the drive of theta (-1: none), whether only one of two positions half a turn apart
    is accepted. Vectors: value at rest, and in CSR form their points with a complex weight each. coupling: of the points.
    """

    point_ptr: np.ndarray
    point_nodes: np.ndarray
    point_weights: np.ndarray
    point_mass: np.ndarray
    gravity: np.ndarray
    row_constant: np.ndarray
    row_start: np.ndarray
    row_columns: np.ndarray
    row_slopes: np.ndarray
    shift_row: np.ndarray
    shift_drive: np.ndarray
    shift_factor: np.ndarray
    product_row: np.ndarray
    product_first: np.ndarray
    product_second: np.ndarray
    product_drive: np.ndarray
    product_one_way: np.ndarray
    vector_rest: np.ndarray
    vector_start: np.ndarray
    vector_points: np.ndarray
    vector_weights: np.ndarray
    coupling: Coupling | None = None


@pack
class SceneArrays(NamedTuple):
    """A scene: what changes with the number of elements, what with the number of joints, and the bodies of few coordinates."""

    plates: Plates
    links: Links
    compact: Compact


def bilinear(links):
    """Which products have points in both of their vectors, (products,): those that make phi_q vary with q."""
    size = np.diff(links.vector_start)
    return (size[links.product_first] > 0) & (size[links.product_second] > 0)


def turning_drives(links):
    """The drives that turn vectors of rows, sorted: angles, rad."""
    return np.unique(links.product_drive[links.product_drive >= 0])


def shifting_drives(links):
    """The drives that are added to rows, sorted: lengths, m."""
    return np.unique(links.shift_drive)


def concatenated(arrays, dtype, tail=()):
    """One C-contiguous writeable array of the parts, of the given dtype, also where there is no part."""
    parts = [np.asarray(part, dtype).reshape((-1, *tail)) for part in arrays]
    return np.ascontiguousarray(np.concatenate(parts)) if parts else np.zeros((0, *tail), dtype)


def starts(parts):
    """Offsets of concatenated parts, (parts + 1,) int64."""
    return np.concatenate([[0], np.cumsum([len(part) for part in parts], dtype=np.int64)]).astype(np.int64)
