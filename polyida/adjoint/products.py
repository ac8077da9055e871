"""Products of a scene's matrices with fields at one state: `K^T w + B^T mu`, `M w` and `C^T w`, without a matrix.

The fields are columns w (columns, nodes, 2). What depends on the state alone is evaluated once for all of them.
"""

from typing import NamedTuple

import numpy as np

from polyida.adjoint import relaxation
from polyida.assembly import joints, reduced_kernels
from polyida.assembly.arrays import cells_of, material_of
from polyida.assembly.equilibrium import on_pattern
from polyida.assembly.own_laws import add_own_curvature
from polyida.element import cell_products, kernels
from polyida.jit import entry, pack, part, shared
from polyida.linear.dense import clear


@pack
class Scratch(NamedTuple):
    """Workspace of products at a state: nodal rotations, matrices of the points and of bodies of few coordinates, and the results.

    points (4, points, 2): displacements, velocities, those of w, forces. curvature, slack (., 2, 2): blocks of K and C on the coupled
    points, of rows and force elements. few, slow (blocks, 2, 2): K and C of bodies of few coordinates. stiff, heavy, slowing (columns,
    nodes, 2): K^T w + B^T mu, M w, C^T w; rows (columns, m): B w.
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
    reduced = model.arrays.reduced
    return model.arrays._replace(reduced=reduced._replace(block=reduced.block - reduced.block[0]))


def viscosity_of(model):
    """(plates,) viscosities, s; empty if no body is damped."""
    return model.arrays.plates.body_viscosity if model.damped else np.zeros(0)


def scratch(model, tied=False, results=None):
    """Scratch of a scene's size; tied: True if there are multipliers of the rates of the rows, which add to C^T w.

    results (3, columns, nodes, 2): arrays for stiff, slowing and heavy; by default new ones for one column.
    """
    results = np.zeros((3, 1, model.n_nodes, 2)) if results is None else results
    nodes, few = results.shape[1:], (int(np.ptp(model.arrays.reduced.block)), 2, 2)
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
def hold_state(scene, laws, drives, displacements, velocities, lam, results):
    """Evaluate everything at a state except the plates: points, their curvature, matrices of bodies of few coordinates."""
    joints.point_values(scene.links, displacements, results.points[DZ])
    results.curvature[:] = 0.0
    joints.joint_curvature(scene.links, drives, lam, results.curvature)
    if results.slack.shape[0]:
        results.slack[:] = 0.0
        joints.point_values(scene.links, velocities, results.points[VZ])
        add_own_curvature(laws, scene.links.coupling, drives, results.points[DZ], results.points[VZ], 1.0, 0.0, results.curvature)
        add_own_curvature(laws, scene.links.coupling, drives, results.points[DZ], results.points[VZ], 0.0, 1.0, results.slack)
    if results.few.shape[0]:
        results.few[:] = 0.0
        reduced_kernels.blocks(scene.reduced, displacements, velocities, 0.0, 0.0, 1.0, results.few)
        if results.slow.shape[0]:
            results.slow[:] = 0.0
            reduced_kernels.blocks(scene.reduced, displacements, velocities, 0.0, 1.0, 0.0, results.slow)


@part
def few_products(bodies, blocks, field, out):
    """out += the transposed blocks of bodies of few coordinates times field."""
    for b in range(bodies.drag.shape[0]):
        first, count = bodies.pair[b], bodies.pair[b + 1] - bodies.pair[b]
        for i in range(count):
            for j in range(count):
                block = blocks[bodies.block[b] + i * count + j]
                for k in range(2):
                    out[first + j, k] += block[0, k] * field[first + i, 0] + block[1, k] * field[first + i, 1]


@shared
def body_products(scene, viscosity, displacements, velocities, columns, fields, rotation, results):
    """Overwrite results.stiff, slowing and heavy (columns, nodes, 2) with the parts of the bodies in K^T w, C^T w and M w.

    scene: the arrays of the model; viscosity (plates,), s; displacements, velocities (nodes, 2): the state; fields (columns, nodes, 2): the
    w. columns: (numbers of the columns of stiff and slowing to be filled, numbers of those of heavy). rotation: results.rotation, which is
    filled with the rotations of the nodes, or an array (0, 2) if it is known.
    """
    which, moving = columns
    clear(rotation)
    for c in which:
        clear(results.stiff[c])
        clear(results.slowing[c])
    for c in moving:
        clear(results.heavy[c])
    plate_products(scene.plates, viscosity, displacements, velocities, columns, fields, rotation, results)
    for k in range(which.shape[0]):
        c, turns = which[k], rotation if k == 0 else rotation[:0]
        reduced_kernels.momentum(scene.reduced, fields[c], results.heavy[c])
        few_products(scene.reduced, results.few, fields[c], results.stiff[c])
        if results.slow.shape[0]:
            few_products(scene.reduced, results.slow, fields[c], results.slowing[c])
        relaxation.add_products(
            scene, scene.relaxation, displacements, velocities, fields[c], turns, results.stiff[c], results.heavy[c], results.slowing[c]
        )
    if rotation.shape[0]:
        for b in range(scene.reduced.drag.shape[0]):
            reduced_kernels.turn(scene.reduced, b, displacements, rotation)


@part
def plate_products(plates, viscosity, displacements, velocities, columns, fields, rotation, results):
    """Add the parts of the plates in K^T w, C^T w, M w and the rotations to results.stiff, slowing, heavy and rotation.

    plates: Plates of the scene; the other arguments as of `body_products`.
    """
    which, moving = columns
    for b in range(plates.body_operator.shape[0]):
        o, n0 = plates.body_operator[b], plates.body_node[b]
        if viscosity.shape[0] == 0:
            cell_products.stiffness_product(
                cells_of(plates, b), material_of(plates, b), displacements, which, fields, results.stiff, rotation
            )
        cell_products.mass_products(*on_pattern(plates, o, plates.mass), plates.body_density[b], n0, moving, fields, results.heavy)
        for k in range(which.shape[0]):
            c, turns = which[k], rotation if k == 0 else rotation[:0]
            if viscosity.shape[0]:
                drag = results.slowing[c]
                cell_products.viscous_products(
                    cells_of(plates, b), material_of(plates, b), displacements, velocities, fields[c], results.stiff[c], drag, turns
                )
                if plates.body_drag[b] != 0.0:
                    kernels.mass_product(
                        *on_pattern(plates, o, plates.mass), plates.body_drag[b] * plates.body_density[b], n0, fields[c], drag
                    )
            if plates.body_stabilisation[b] != 0.0:
                kernels.stabilisation_force(
                    *on_pattern(plates, o, plates.stabilisation), plates.body_stabilisation[b], n0, fields[c], results.stiff[c]
                )


@part
def point_products(links, slopes, column, field, mu, results):
    """Add the parts of point masses, rows and force elements to a column of results.stiff, heavy and slowing; its results.rows = B w.

    slopes: phi_z; field w (nodes, 2), mu (m,): of the column.
    """
    wz, forces = results.points[WZ], results.points[FORCES]
    joints.point_values(links, field, wz)
    pull_back(links.coupling, results.curvature, wz, forces)
    for k in range(mu.shape[0]):
        results.rows[column, k] = joints.along(links, slopes, k, wz)
    joints.add_rows(links, slopes, mu, forces)
    joints.spread(links, forces, results.stiff[column])
    for f in range(forces.shape[0]):
        forces[f, 0], forces[f, 1] = links.point_mass[f] * wz[f, 0], links.point_mass[f] * wz[f, 1]
    joints.spread(links, forces, results.heavy[column])
    if results.slack.shape[0]:
        pull_back(links.coupling, results.slack, wz, forces)
        joints.spread(links, forces, results.slowing[column])


@part
def pull_back(coupling, blocks, wz, forces):
    """Overwrite forces (points, 2) with the transposed blocks (., 2, 2) of the coupling times wz (points, 2)."""
    for p in range(forces.shape[0]):
        forces[p, 0] = forces[p, 1] = 0.0
        for k in range(coupling.start[p], coupling.start[p + 1]):
            block, q = blocks[coupling.mirror[k]], coupling.columns[k]
            for j in range(2):
                forces[p, j] += block[0, j] * wz[q, 0] + block[1, j] * wz[q, 1]


@entry
def curvature_product(links, drives, lam, field, results):
    """Fill results.stiff with (B^T lam)_q^T w of a field w."""
    results.curvature[:] = 0.0
    joints.joint_curvature(links, drives, lam, results.curvature)
    joints.point_values(links, field, results.points[WZ])
    pull_back(links.coupling, results.curvature, results.points[WZ], results.points[FORCES])
    clear(results.stiff[0])
    joints.spread(links, results.points[FORCES], results.stiff[0])


def reaction_product(model, t, lam, w):
    """(B^T lam)_q^T w of a compiled scene at any q, (n,)."""
    x = model.once(scratch)
    curvature_product(model.arrays.links, model.drives(t), np.array(lam, float), np.array(w, float).reshape(-1, 2), x)
    return x.stiff.ravel().copy()


@entry
def products(scene, viscosity, laws, drives, slopes, displacements, velocities, lam, fields, mu, results):
    """All products of one column at one state, into results; slopes is workspace for phi_z."""
    hold_state(scene, laws, drives, displacements, velocities, lam, results)
    which = np.zeros(1, np.int64)
    body_products(scene, viscosity, displacements, velocities, (which, which), fields, results.rotation, results)
    joints.joint_jacobian(scene.links, drives, results.points[DZ], slopes)
    point_products(scene.links, slopes, 0, fields[0], mu, results)


def products_at(model, drives, q, v, lam, w, mu):
    """The Scratch with the products at a state of a compiled scene; drives: of its time."""
    x, arrays, slopes = model.once(scratch), model.once(arrays_of), np.empty(len(model.arrays.links.row_columns))
    u, v, w = (np.array(each, float).reshape(-1, 2) for each in (q, v, w))
    viscosity = viscosity_of(model)
    products(arrays, viscosity, model.laws, drives, slopes, u, v, np.array(lam, float), w[None], np.array(mu, float), x)
    model.raise_error()
    return x
