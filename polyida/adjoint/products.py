"""Products of a scene's matrices with fields at one state: `K^T w + B^T mu`, `M w` and `C^T w`, without a matrix.

The fields are columns w (columns, nodes, 2). What depends on the state alone is evaluated once for all of them.
"""

from typing import NamedTuple

import numpy as np

from polyida.adjoint import relaxation
from polyida.assembly import compact, joints
from polyida.assembly.arrays import cells
from polyida.assembly.equilibrium import on_pattern
from polyida.assembly.own_laws import add_own_curvature
from polyida.element import cell_products, kernels
from polyida.jit import entry, pack, part, shared
from polyida.linear.dense import clear


@pack
class Scratch(NamedTuple):
    """Workspace of products at a state: nodal rotations, matrices of the points and of bodies of few coordinates, and the results.

    points (4, points, 2): displacements, velocities, those of w, forces. curvature, slack (., 2, 2): blocks of K and C on the coupled points, of
    rows and force elements. few, slow (blocks, 2, 2): K and C of bodies of few coordinates. stiff, heavy, slowing (columns, nodes, 2):
    K^T w + B^T mu, M w, C^T w; rows (columns, m): B w.
    """

    rotation: np.ndarray
    points: np.ndarray
    curvature: np.ndarray
    slack: np.ndarray
    few: np.ndarray
    slow: np.ndarray
    stiff: np.ndarray
    heavy: np.ndarray
    slowing: np.ndarray
    rows: np.ndarray


DZ, VZ, WZ, FORCES = range(4)


def arrays_of(model):
    """The arrays of the model, with blocks of the bodies of few coordinates numbered from the first of these."""
    compact = model.arrays.compact
    return model.arrays._replace(compact=compact._replace(block=compact.block - compact.block[0]))


def viscosity_of(model):
    """(plates,) viscosities, s; empty if no body is damped."""
    return model.arrays.plates.body_viscosity if model.damped else np.zeros(0)


def scratch(model, tied=False, results=None):
    """Scratch of a scene's size; tied: True if there are multipliers of the rates of the rows, which add to C^T w.

    results (3, columns, nodes, 2): arrays for stiff, slowing and heavy; by default new ones for one column.
    """
    results = np.zeros((3, 1, model.n_nodes, 2)) if results is None else results
    nodes, few = results.shape[1:], (int(np.ptp(model.arrays.compact.block)), 2, 2)
    coupled = (len(model.arrays.links.coupling.columns), 2, 2)
    return Scratch(
        np.zeros(nodes[1:]),
        np.zeros((4, model.n_points, 2)),
        np.zeros(coupled),
        np.zeros(coupled if len(model.laws.energies) else (0, 2, 2)),
        np.zeros(few),
        np.zeros(few if model.damped else (0, 2, 2)),
        results[0],
        results[2],
        results[1] if tied or model.needs.velocity_forces else np.zeros((nodes[0], 0, 2)),
        np.zeros((nodes[0], model.m)),
    )


@shared
def hold_state(s, laws, drives, u, v, lam, x):
    """Evaluate everything at a state except the plates: points, their curvature, matrices of bodies of few coordinates."""
    joints.point_values(s.links, u, x.points[DZ])
    x.curvature[:] = 0.0
    joints.joint_curvature(s.links, drives, lam, x.curvature)
    if x.slack.shape[0]:
        x.slack[:] = 0.0
        joints.point_values(s.links, v, x.points[VZ])
        add_own_curvature(laws, s.links.coupling, drives, x.points[DZ], x.points[VZ], 1.0, 0.0, x.curvature)
        add_own_curvature(laws, s.links.coupling, drives, x.points[DZ], x.points[VZ], 0.0, 1.0, x.slack)
    if x.few.shape[0]:
        x.few[:] = 0.0
        compact.blocks(s.compact, u, v, 0.0, 0.0, 1.0, x.few)
        if x.slow.shape[0]:
            x.slow[:] = 0.0
            compact.blocks(s.compact, u, v, 0.0, 1.0, 0.0, x.slow)


@part
def few_products(c, few, w, r):
    """r += the transposed blocks of bodies of few coordinates times w."""
    for b in range(c.drag.shape[0]):
        first, count = c.pair[b], c.pair[b + 1] - c.pair[b]
        for i in range(count):
            for j in range(count):
                block = few[c.block[b] + i * count + j]
                for k in range(2):
                    r[first + j, k] += block[0, k] * w[first + i, 0] + block[1, k] * w[first + i, 1]


@shared
def body_products(s, viscosity, u, v, which, moving, w, rotation, x):
    """Fill x.stiff and x.slowing of the columns in `which`, and x.heavy of those in `moving`, with the parts of the bodies; rotation: x.rotation,
    or (0, 2) if it is known.
    """
    clear(rotation)
    for c in which:
        clear(x.stiff[c])
        clear(x.slowing[c])
    for c in moving:
        clear(x.heavy[c])
    plate_products(s.plates, viscosity, u, v, which, moving, w, rotation, x)
    for k in range(which.shape[0]):
        c, turns = which[k], rotation if k == 0 else rotation[:0]
        compact.momentum(s.compact, w[c], x.heavy[c])
        few_products(s.compact, x.few, w[c], x.stiff[c])
        if x.slow.shape[0]:
            few_products(s.compact, x.slow, w[c], x.slowing[c])
        relaxation.add_products(s, s.relaxation, u, v, w[c], turns, x.stiff[c], x.heavy[c], x.slowing[c])
    if rotation.shape[0]:
        for b in range(s.compact.drag.shape[0]):
            compact.turn(s.compact, b, u, rotation)


@part
def plate_products(s, viscosity, u, v, which, moving, w, rotation, x):
    """Add the parts of the plates."""
    for b in range(s.body_operator.shape[0]):
        o, n0 = s.body_operator[b], s.body_node[b]
        c1, nu = s.body_c1[b], s.body_nu[b]
        if viscosity.shape[0] == 0:
            cell_products.stiffness_product(*cells(s, o), n0, c1, nu, u, which, w, x.stiff, rotation)
        cell_products.mass_products(*on_pattern(s, o, s.mass), s.body_density[b], n0, moving, w, x.heavy)
        for k in range(which.shape[0]):
            c, turns = which[k], rotation if k == 0 else rotation[:0]
            if viscosity.shape[0]:
                cell_products.viscous_products(*cells(s, o), n0, c1, nu, viscosity[b], u, v, w[c], x.stiff[c], x.slowing[c], turns)
                if s.body_drag[b] != 0.0:
                    kernels.mass_product(*on_pattern(s, o, s.mass), s.body_drag[b] * s.body_density[b], n0, w[c], x.slowing[c])
            if s.body_stabilisation[b] != 0.0:
                kernels.stabilisation_force(*on_pattern(s, o, s.stabilisation), s.body_stabilisation[b], n0, w[c], x.stiff[c])


@part
def point_products(s, slopes, c, w, mu, x):
    """Add the parts of point masses, rows and force elements to column c; its x.rows = B w. slopes: phi_z; w (nodes, 2), mu (m,): of the column."""
    wz, forces = x.points[WZ], x.points[FORCES]
    joints.point_values(s, w, wz)
    pull_back(s.coupling, x.curvature, wz, forces)
    for k in range(mu.shape[0]):
        x.rows[c, k] = joints.along(s, slopes, k, wz)
    joints.add_rows(s, slopes, mu, forces)
    joints.spread(s, forces, x.stiff[c])
    for f in range(forces.shape[0]):
        forces[f, 0], forces[f, 1] = s.point_mass[f] * wz[f, 0], s.point_mass[f] * wz[f, 1]
    joints.spread(s, forces, x.heavy[c])
    if x.slack.shape[0]:
        pull_back(s.coupling, x.slack, wz, forces)
        joints.spread(s, forces, x.slowing[c])


@part
def pull_back(coupling, blocks, wz, forces):
    """forces = the transposed blocks of the coupling times wz."""
    for p in range(forces.shape[0]):
        forces[p, 0] = forces[p, 1] = 0.0
        for k in range(coupling.start[p], coupling.start[p + 1]):
            block, q = blocks[coupling.mirror[k]], coupling.columns[k]
            for j in range(2):
                forces[p, j] += block[0, j] * wz[q, 0] + block[1, j] * wz[q, 1]


@entry
def curvature_product(s, drives, lam, w, x):
    """Fill x.stiff with (B^T lam)_q^T w."""
    x.curvature[:] = 0.0
    joints.joint_curvature(s, drives, lam, x.curvature)
    joints.point_values(s, w, x.points[WZ])
    pull_back(s.coupling, x.curvature, x.points[WZ], x.points[FORCES])
    clear(x.stiff[0])
    joints.spread(s, x.points[FORCES], x.stiff[0])


def reaction_product(model, t, lam, w):
    """(B^T lam)_q^T w of a compiled scene at any q, (n,)."""
    x = model.once(scratch)
    curvature_product(model.arrays.links, model.drives(t), np.array(lam, float), np.array(w, float).reshape(-1, 2), x)
    return x.stiff.ravel().copy()


@entry
def products(s, viscosity, laws, drives, slopes, u, v, lam, w, mu, x):
    """All products of one column at one state, into x; slopes is workspace for phi_z."""
    hold_state(s, laws, drives, u, v, lam, x)
    which = np.zeros(1, np.int64)
    body_products(s, viscosity, u, v, which, which, w, x.rotation, x)
    joints.joint_jacobian(s.links, drives, x.points[DZ], slopes)
    point_products(s.links, slopes, 0, w[0], mu, x)


def products_at(model, drives, q, v, lam, w, mu):
    """The Scratch with the products at a state of a compiled scene; drives: of its time."""
    x, arrays, slopes = model.once(scratch), model.once(arrays_of), np.empty(len(model.arrays.links.row_columns))
    u, v, w = (np.array(each, float).reshape(-1, 2) for each in (q, v, w))
    viscosity = viscosity_of(model)
    products(arrays, viscosity, model.laws, drives, slopes, u, v, np.array(lam, float), w[None], np.array(mu, float), x)
    model.raise_error()
    return x
