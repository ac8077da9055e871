"""Numba kernels of one body with a second field: velocities (Kelvin-Voigt viscosity), or the end of a step (energy-momentum).

    viscous   S = D : (E + tau_v Edot), Edot = sym(F^T Fdot): no stress, no damping in any rigid motion
    midpoint  f_i = int t F_m S_m G_i, F_m = (F_0 + F_1) / 2, S_m = D : (E_0 + E_1) / 2 (Simo, Tarnow 1992), so that
              f . (u_1 - u_0) = W_1 - W_0; with viscosity, plus tau_v / h int t (E_1 - E_0) : D : (E_1 - E_0)

Arguments as in kernels.py.
"""

import numpy as np

from polyida.element.kernels import _differences, _gradient, _least, _scatter_balanced, _scatter_turn, _workspace, lame
from polyida.element.material import (
    add,
    add_rotation,
    add_stiffness,
    add_times,
    advanced,
    all_moduli_times,
    combination,
    difference,
    negative,
    two_state_moduli,
    two_state_piola,
    watch,
)
from polyida.jit import entry, part
from polyida.jit.intrinsics import LANES, gather, load, load2, load4, load8, scatter_add, spread, store, zeros2, zeros4

SECOND_ALONE = (1.0, 0.0, 0.0, 1.0)  # state = first field, direction = second
MEAN_AND_HALF = (0.5, 0.5, -0.5, 0.5)  # state = mean of the fields, direction = half their difference


@entry
def internal_force_viscous(cells, material, moved, v, nodal_force, rotation):
    """Add elastic and viscous force on the nodes to nodal_force; return the least det F, NaN if undefined.

    moved, v, nodal_force (N, 2): displacements, velocities of nodes and forces on them. To rotation (N, 2), unless it is (0, 2), the
    rotation vectors of the cells are added, as in kernels.internal_force. The dissipated power is
    v . (f - f(tau_v = 0)) = tau_v int t Edot : D : Edot >= 0, W.
    """
    return _force(cells, material, (material.viscosity, 0.0, 0.0), SECOND_ALONE, moved, v, nodal_force, rotation)


@entry
def tangent_viscous(cells, blocks, material, moved, v, c_q, c_v):
    """Add c_q dg/dq + c_v dg/dv of internal_force_viscous to blocks (M, 2, 2) in one pass.

    dg/dv = tau_v int t B^T D B is symmetric to round-off and positive semidefinite; dg/dq is unsymmetric unless v is a rigid motion.
    """
    (lam_bar, two_mu), tau = lame(material), material.viscosity
    work = _workspace(cells.layout, 12, 8)
    for k in range(cells.layout.shape[0]):
        m, points, g = cells.layout[k, 0] - 1, cells.layout[k, 1], cells.layout[k, 3]
        size = 2 * m * LANES
        rates, sums, products = work[size:], work[2 * size :], work[6 * size :]
        _differences(moved, cells.corners, cells.layout[k, 2], cells.first_node, m, work)
        _differences(v, cells.corners, cells.layout[k, 2], cells.first_node, m, rates)
        for p in range(points):
            start, weight = g + p * size, load(cells.weights, cells.layout[k, 4] + p * LANES)
            h, d = _gradient(cells.gradients, start, work, m), _gradient(cells.gradients, start, rates, m)
            moduli = two_state_moduli(h, d, weight, lam_bar, two_mu, tau, (c_q, c_q + c_v * tau, c_q * tau))
            for j in range(m):
                product = all_moduli_times(moduli, load2(cells.gradients, start + 2 * j * LANES))
                store(products, 8 * (j * points + p) * LANES, product)
        for i in range(0, 4 * size, 4 * LANES):
            store(sums, i, zeros4())
        for j in range(m):
            for i in range(m):
                block = zeros4()
                for p in range(points):
                    here = load2(cells.gradients, g + p * size + 2 * i * LANES)
                    block = add_stiffness(block, here, load8(products, 8 * (j * points + p) * LANES))
                scatter_add(blocks.values, blocks.pairs, cells.layout[k, 5] + (i * (m + 1) + j) * LANES, blocks.first, block)
                store(sums, 4 * i * LANES, add(load4(sums, 4 * i * LANES), block))
                store(sums, 4 * (m + j) * LANES, add(load4(sums, 4 * (m + j) * LANES), block))
        # the last corner's column and row: rows and columns of the tangent sum to zero
        total, start = zeros4(), cells.layout[k, 5]
        for i in range(m):
            row, column = load4(sums, 4 * i * LANES), load4(sums, 4 * (m + i) * LANES)
            scatter_add(blocks.values, blocks.pairs, start + (i * (m + 1) + m) * LANES, blocks.first, negative(row))
            scatter_add(blocks.values, blocks.pairs, start + (m * (m + 1) + i) * LANES, blocks.first, negative(column))
            total = add(total, row)
        scatter_add(blocks.values, blocks.pairs, start + (m * (m + 1) + m) * LANES, blocks.first, total)


@entry
def internal_force_midpoint(cells, material, u0, u1, nodal_force, rotation):
    """Add the energy-momentum force of the step from u0 to u1 to nodal_force; return the least det F(u1), NaN if undefined.

    The material's viscosity is tau_v / h, no unit, 0 for an elastic body. The force has no resultant, and no moment at the mean positions. rotation as in
    kernels.internal_force, of F_m.
    """
    return _force(cells, material, (2.0 * material.viscosity, 1.0, 1.0), MEAN_AND_HALF, u0, u1, nodal_force, rotation)


@part
def _fields(one, other, corners, start, node_offset, count, mix, out):
    """Store state and direction of the corners relative to the last one in out: count pairs each."""
    state, direction, size = mix[:2], mix[2:], 2 * count * LANES
    last_a = gather(one, corners, start + count * LANES, node_offset)
    last_b = gather(other, corners, start + count * LANES, node_offset)
    for i in range(count):
        own_a = difference(gather(one, corners, start + i * LANES, node_offset), last_a)
        own_b = difference(gather(other, corners, start + i * LANES, node_offset), last_b)
        store(out, 2 * i * LANES, combination(own_a, own_b, state[0], state[1]))
        store(out, size + 2 * i * LANES, combination(own_a, own_b, direction[0], direction[1]))


@part
def _force(cells, material, response, mix, one, other, nodal_force, rotation):
    """Add the force of the two fields `mix` of two fields, one and other; response = (rate, square, factor of d in the F whose det F is returned)."""
    lam_bar, two_mu = lame(material)
    work = _workspace(cells.layout, 6, 0)
    least = spread(np.inf), spread(0.0)
    rate, square, ahead = response
    for k in range(cells.layout.shape[0]):
        m, first = cells.layout[k, 0] - 1, cells.layout[k, 2]
        size = 2 * m * LANES
        direction, force = work[size:], work[2 * size :]
        _fields(one, other, cells.corners, first, cells.first_node, m, mix, work)
        for i in range(0, size, 2 * LANES):
            store(force, i, zeros2())
        turn = zeros2()
        for p in range(cells.layout[k, 1]):
            g, w = cells.layout[k, 3] + p * size, load(cells.weights, cells.layout[k, 4] + p * LANES)
            h, d = _gradient(cells.gradients, g, work, m), _gradient(cells.gradients, g, direction, m)
            least, turn = watch(least, advanced(h, d, ahead)), add_rotation(turn, w, h)
            stress = two_state_piola(h, d, w, lam_bar, two_mu, rate, square)
            for i in range(0, size, 2 * LANES):
                store(force, i, add_times(load2(force, i), stress, load2(cells.gradients, g + i)))
        _scatter_balanced(force, cells.corners, first, cells.first_node, m, nodal_force)
        _scatter_turn(turn, cells.corners, first, cells.first_node, m, rotation)
    return _least(least)
