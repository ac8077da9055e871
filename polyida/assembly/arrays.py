"""A scene as plain arrays, all that the compiled kernels read.

Lists of unequal length are concatenated; list k has the entries `start[k]` to `start[k + 1]`. Complex numbers are pairs (re, im).
"""

from typing import NamedTuple

import numpy as np

from polyida.assembly.reduced_kernels import ReducedArrays
from polyida.element.operator import Cells, Material
from polyida.jit import leaf, pack

LAYOUT, CORNERS, GRADIENTS, WEIGHTS, PAIRS, INDPTR, INDICES = range(7)  # columns of Plates.at: starts in the arrays of these names


@pack
class Plates(NamedTuple):
    """The plates and their loads. Nodes of the plates are concatenated; equal meshes share one operator (element.operator.ReferenceOperator)."""

    at: np.ndarray  # (operators + 1, 7) columns LAYOUT to INDICES: where the entries of each operator start; the last row holds the ends
    layout: np.ndarray
    corners: np.ndarray
    gradients: np.ndarray
    weights: np.ndarray
    pairs: np.ndarray
    indptr: np.ndarray
    indices: np.ndarray
    mass: np.ndarray  # on the node pattern, like stabilisation
    stabilisation: np.ndarray  # of virtual elements
    body_operator: np.ndarray
    body_node: np.ndarray  # first node of each plate
    body_block: np.ndarray  # first block of the tangent of each plate
    membrane_stiffness: np.ndarray  # E t / (1 - nu^2), N/m
    body_nu: np.ndarray
    body_density: np.ndarray  # rho t, kg/m^2
    body_drag: np.ndarray  # mass-proportional damping, 1/s
    body_viscosity: np.ndarray  # s
    body_stabilisation: np.ndarray  # factor of the stabilisation, N/m
    weight: np.ndarray  # (pairs, 2) steady gravity on each pair of q, N
    load_ptr: np.ndarray  # starts of the loads in load_nodes and load_values
    load_nodes: np.ndarray
    load_values: np.ndarray  # (., 2) N, times the drive of the load
    load_drive: np.ndarray


@pack
class Coupling(NamedTuple):
    """Blocks (2, 2) of pairs of points that the curvature of rows, force elements or, on the diagonal, masses at points couple."""

    start: np.ndarray  # blocks of point p in its row: start[p] to start[p + 1]
    columns: np.ndarray  # the other point of each block
    mirror: np.ndarray  # number of the transposed block
    mass: np.ndarray  # diagonal block of each point; -1 without mass
    products: np.ndarray  # block (E, F) of each product whose vectors both have points, in the order of `joint_curvature`
    laws: np.ndarray  # blocks of the sides of each force element, row by row; -1 for a side on the ground
    law_start: np.ndarray
    states: np.ndarray  # points that are states; in the rows of a force element's states these columns are the last ones


@pack
class Slips(NamedTuple):
    """Rows of friction that slip in a mode, none of phi: `lam = sign (c + mu |lam_on|)`. The first fields are those of Links."""

    row_start: np.ndarray
    row_columns: np.ndarray
    row_slopes: np.ndarray
    product_row: np.ndarray
    product_first: np.ndarray
    product_second: np.ndarray
    product_drive: np.ndarray
    product_rate: np.ndarray
    vector_rest: np.ndarray
    vector_start: np.ndarray
    vector_points: np.ndarray
    vector_weights: np.ndarray
    constant: np.ndarray  # sign c
    mu: np.ndarray  # sign mu
    on_contact: np.ndarray  # True if one contact presses: |lam_on| is -lam_on then, of either sign
    on_start: np.ndarray  # starts of the rows in `on`
    on: np.ndarray  # rows of phi that press


@pack
class Links(NamedTuple):
    """The points that joints and masses hold on to, `dz = A u`, and the rows of phi (joints.py)."""

    point_ptr: np.ndarray  # starts of the points in point_nodes and point_weights
    point_nodes: np.ndarray
    point_weights: np.ndarray  # (., 2) complex weights of pairs of q
    point_mass: np.ndarray  # kg
    point_turns: np.ndarray  # True for directions: slopes of force elements on them turn with the body
    gravity: np.ndarray  # (2,) steady gravity, m/s^2
    row_constant: np.ndarray
    row_start: np.ndarray  # starts of the rows in row_columns and row_slopes
    row_columns: np.ndarray  # components `2 point + axis` that a row depends on
    row_slopes: np.ndarray  # of the linear part
    shift_row: np.ndarray  # shifts: factor times drive, added to a row
    shift_drive: np.ndarray
    shift_factor: np.ndarray
    shift_order: np.ndarray  # derivative of the drive in the rate of the row: 1, or 0 in velocity rows
    product_row: np.ndarray  # products R(theta) E . F
    product_first: np.ndarray  # vector E
    product_second: np.ndarray  # vector F
    product_drive: np.ndarray  # drive of theta; -1 without
    product_one_way: np.ndarray  # True if one of two positions half a turn apart is wrong
    product_rate: np.ndarray  # True in velocity rows: R(theta) E . F'
    velocity_rows: np.ndarray  # numbers of the velocity rows among the rows of phi
    vector_rest: np.ndarray  # (vectors, 2) value at rest
    vector_start: np.ndarray  # starts of the vectors in vector_points and vector_weights
    vector_points: np.ndarray
    vector_weights: np.ndarray  # (., 2) complex
    coupling: Coupling | None = None
    slips: Slips | None = None


@pack
class Relaxation(NamedTuple):
    """The relaxed strains of viscoelastic plates, as velocities of the last pairs of q (relaxation.py). Bodies: full plates, then those of few
    coordinates. There are no terms in a scene without such plates."""

    first: int  # their first pair
    start: np.ndarray  # (bodies + 1,) of each body's numbers behind it, term after term: three of each weight, or as many as y has
    terms: np.ndarray  # (bodies + 1,) starts in share and time
    share: np.ndarray  # g
    time: np.ndarray  # tau, s
    mass: float
    unit: np.ndarray  # (bodies,) strain of a unit velocity: s/m, of a body of few coordinates, whose strains are those of y, s m
    condensed: np.ndarray  # (2,) addresses of a Condensation and of `condensed_force`; 0 if the velocities are the strains


@pack
class SceneArrays(NamedTuple):
    """A scene: its plates, the points and rows of its joints, its bodies of few coordinates, and its relaxed strains."""

    plates: Plates
    links: Links
    reduced: ReducedArrays
    relaxation: Relaxation


def concatenated(arrays, dtype, tail=()):
    """The arrays joined to one writeable C-contiguous array of a dtype, (., *tail); empty without arrays."""
    parts = [np.asarray(part, dtype).reshape((-1, *tail)) for part in arrays]
    return np.ascontiguousarray(np.concatenate(parts)) if parts else np.zeros((0, *tail), dtype)


def starts(lists):
    """Starts of the lists when concatenated, (lists + 1,) int64."""
    return np.cumsum([0, *map(len, lists)], dtype=np.int64)


@leaf
def cells_of(plates, body):
    """The Cells of a plate."""
    operator, node = plates.body_operator[body], plates.body_node[body]
    first, end = plates.at[operator], plates.at[operator + 1]
    layout, corners = plates.layout[first[LAYOUT] : end[LAYOUT]], plates.corners[first[CORNERS] : end[CORNERS]]
    gradients, weights = plates.gradients[first[GRADIENTS] : end[GRADIENTS]], plates.weights[first[WEIGHTS] : end[WEIGHTS]]
    return Cells(layout, corners, gradients, weights, node)


@leaf
def material_of(plates, body):
    """The Material of a plate."""
    return Material(plates.membrane_stiffness[body], plates.body_nu[body], plates.body_viscosity[body])
