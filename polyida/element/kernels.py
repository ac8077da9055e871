"""Numba kernels of one body: internal force, tangent, strain energy, stress, and products with mass and stabilisation.

    f_i = int t F S G_i,  K_ij = int t [(G_i . S G_j) I + B_i^T D B_j] = int t G_i A G_j,  W = int t S : E / 2

Arguments: the Cells and the Material of the body (operator.py); moved (N, 2): displacements of all bodies, m. Arrays are contiguous, writeable float64. Results are added to the output arrays. Differences to the last
corner replace displacements: the forces of a cell then sum to zero, and large translations cost no digits.

The stabilisation of virtual elements is a constant scalar matrix S on the node pattern whose rows sum to 0: f = factor (S (x) I) u,
W = factor u . (S (x) I) u / 2, tangent factor S on the diagonal of each 2 x 2 block. It has no viscosity: S v is not zero in the rigid
rotation of a warped cell and would brake it.
"""

import numpy as np

from polyida.element.material import (
    add,
    add_cauchy,
    add_energy,
    add_outer,
    add_product,
    add_rotation,
    add_stiffness,
    add_strain,
    add_times,
    difference,
    first_piola,
    moduli,
    moduli_times,
    negative,
    relaxed_moduli,
    relaxing_piola,
    scaled,
    symmetric,
    transposed,
    watch,
)
from polyida.jit import entry, leaf, part
from polyida.jit.intrinsics import (
    LANES,
    add_pair,
    gather,
    lane,
    load,
    load2,
    load3,
    load4,
    load8,
    load_float,
    load_integer,
    load_pair,
    pair,
    scatter_add,
    spread,
    store,
    traced,
    zero_pair,
    zeros2,
    zeros3,
    zeros4,
)


@leaf
def lame(material):
    """Lame's lam_bar = c nu of plane stress or strain, and 2 mu = c (1 - nu)."""
    return material.stiffness * material.nu, material.stiffness * (1.0 - material.nu)


@part
def _workspace(layout, per_corner, per_corner_point):
    """Workspace for the largest block, by the number of vectors for each corner, and for each corner and point."""
    vectors = 1
    for b in range(layout.shape[0]):
        vectors = max(vectors, layout[b, 0] * (per_corner + layout[b, 1] * per_corner_point))
    return np.empty(vectors * LANES)


@part
def _differences(moved, corners, start, node_offset, count, out):
    """Store the displacements of `count` corners relative to the last one, which follows them, in out."""
    last = gather(moved, corners, start + count * LANES, node_offset)
    for i in range(count):
        store(out, 2 * i * LANES, difference(gather(moved, corners, start + i * LANES, node_offset), last))


@part
def _gradient(gradients, start, differences, count):
    """The displacement gradient H = (xx, xy, yx, yy) at one point of LANES cells."""
    h = zeros4()
    for k in range(0, 2 * count * LANES, 2 * LANES):
        h = add_outer(h, load2(differences, k), load2(gradients, start + k))
    return h


@part
def _scatter_balanced(force, corners, first, node_offset, count, nodal_force):
    """Add the forces of the corners to nodal_force, that of the last one such that they sum to zero."""
    balance = zeros2()
    for i in range(count):
        own = load2(force, 2 * i * LANES)
        scatter_add(nodal_force, corners, first + i * LANES, node_offset, own)
        balance = difference(balance, own)
    scatter_add(nodal_force, corners, first + count * LANES, node_offset, balance)


@part
def _scatter_turn(turn, corners, first, node_offset, count, rotation):
    """Add the cells' rotation to their nodes, unless rotation is (0, 2)."""
    if rotation.shape[0] > 0:
        for k in range(first, first + (count + 1) * LANES, LANES):
            scatter_add(rotation, corners, k, node_offset, turn)


@part
def _least(least):
    """The least det F in the state of `watch`; NaN if a det F is not finite."""
    low, total = np.inf, 0.0
    for k in range(LANES):
        low, total = min(low, lane(least[0], k)), total + lane(least[1], k)
    return low if np.isfinite(total) else np.nan


@part
def _add_means(state, lane_cells, first, areas, out):
    """Add the three sums of a block's cells over their areas to out (cells, 3)."""
    for k in range(LANES):
        cell = lane_cells[first + k]
        out[cell, 0] += lane(state[0], k) / areas[cell]
        out[cell, 1] += lane(state[1], k) / areas[cell]
        out[cell, 2] += lane(state[2], k) / areas[cell]


@entry
def internal_force(cells, material, moved, nodal_force, rotation):
    """Add the internal force to nodal_force (N, 2); return the least det F, NaN if a displacement is not finite.

    Add to rotation (N, 2), unless it is (0, 2), at every node the sum over its cells of area (F11 + F22, F21 - F12) of the cell's mean F: the
    angle of this vector is the node's rotation.
    """
    return _add_force(cells, material, moved, None, 1.0, nodal_force, rotation)


@entry
def relaxed_force(cells, material, moved, viscous_strain, kappa, nodal_force, rotation):
    """Add the internal force with the stress D : (kappa E - viscous_strain); viscous_strain as in relaxation.py."""
    return _add_force(cells, material, moved, viscous_strain, kappa, nodal_force, rotation)


@part
def _add_force(cells, material, moved, viscous_strain, kappa, nodal_force, rotation):
    """Add the force of `internal_force`, or of `relaxed_force` if viscous_strain is not None; return the least det F."""
    lam_bar, two_mu = lame(material)
    work = _workspace(cells.layout, 4, 0)
    least = spread(np.inf), spread(0.0)
    for b in range(cells.layout.shape[0]):
        m, first = cells.layout[b, 0] - 1, cells.layout[b, 2]
        force, size = work[2 * m * LANES :], 2 * m * LANES
        _differences(moved, cells.corners, first, cells.first_node, m, work)
        for k in range(0, size, 2 * LANES):
            store(force, k, zeros2())
        turn = zeros2()
        for p in range(cells.layout[b, 1]):
            g, w = cells.layout[b, 3] + p * size, load(cells.weights, cells.layout[b, 4] + p * LANES)
            h = _gradient(cells.gradients, g, work, m)
            least, turn = watch(least, h), add_rotation(turn, w, h)
            stress = _stress(viscous_strain, kappa, h, w, cells.layout[b, 4] + p * LANES, lam_bar, two_mu)
            for k in range(0, size, 2 * LANES):
                store(force, k, add_times(load2(force, k), stress, load2(cells.gradients, g + k)))
        balance = zeros2()  # inlined: calls of the functions above make this most frequent kernel slower
        for i in range(m):
            own = load2(force, 2 * i * LANES)
            scatter_add(nodal_force, cells.corners, first + i * LANES, cells.first_node, own)
            balance = difference(balance, own)
        scatter_add(nodal_force, cells.corners, first + m * LANES, cells.first_node, balance)
        if rotation.shape[0] > 0:
            for k in range(first, first + (m + 1) * LANES, LANES):
                scatter_add(rotation, cells.corners, k, cells.first_node, turn)
    return _least(least)


@part
def _stress(viscous_strain, kappa, h, weight, at, lam_bar, two_mu):
    """weight P of a point: relaxed stress unless viscous_strain is None. Its own function: numba drops a branch only if an argument is None."""
    if viscous_strain is None:
        return first_piola(h, weight, lam_bar, two_mu)
    return relaxing_piola(h, load3(viscous_strain, 3 * at), kappa, weight, lam_bar, two_mu)


@entry
def tangent(cells, blocks, material, moved, scale):
    """Add scale * K to blocks (M, 2, 2) of the node pattern; the blocks of the body start at number `blocks.first`."""
    _add_tangent(cells, blocks, material, moved, scale, None, 0.0)


@entry
def relaxed_tangent(cells, blocks, material, moved, scale, viscous_strain, change):
    """Add scale times what relaxation adds to K at the displacements `moved`.

    It is K of `tangent` with S = -D : viscous_strain and with `change` times D in place of D; viscous_strain as in relaxation.py.
    """
    _add_tangent(cells, blocks, material, moved, scale, viscous_strain, change)


@part
def _add_tangent(cells, blocks, material, moved, scale, viscous_strain, change):
    """Add scale * K of `tangent`, or of `relaxed_tangent` if viscous_strain is not None."""
    lam_bar, two_mu = scale * material.stiffness * material.nu, scale * material.stiffness * (1.0 - material.nu)
    work = _workspace(cells.layout, 6, 8)
    for b in range(cells.layout.shape[0]):
        m, points, g = cells.layout[b, 0] - 1, cells.layout[b, 1], cells.layout[b, 3]
        sums, products = work[2 * m * LANES :], work[6 * m * LANES :]
        _differences(moved, cells.corners, cells.layout[b, 2], cells.first_node, m, work)
        for p in range(points):
            start = g + 2 * p * m * LANES
            h = _gradient(cells.gradients, start, work, m)
            a = _moduli(viscous_strain, change, h, cells.weights, cells.layout[b, 4] + p * LANES, lam_bar, two_mu)
            for j in range(m):
                store(products, 8 * (j * points + p) * LANES, moduli_times(a, load2(cells.gradients, start + 2 * j * LANES)))
        for k in range(0, 4 * m * LANES, 4 * LANES):
            store(sums, k, zeros4())
        for j in range(m):
            for i in range(j + 1):
                block = zeros4()
                for p in range(points):
                    block = add_stiffness(
                        block, load2(cells.gradients, g + 2 * (p * m + i) * LANES), load8(products, 8 * (j * points + p) * LANES)
                    )
                _add_block(block, i, j, m, cells.layout[b, 5], blocks, sums)
        _add_last(m, cells.layout[b, 5], blocks, sums)


@part
def _moduli(viscous_strain, change, h, weights, at, lam_bar, two_mu):
    """The moduli of a point. Its own function: numba drops a branch only if an argument is None."""
    if viscous_strain is None:
        return moduli(h, load(weights, at), lam_bar, two_mu)
    return relaxed_moduli(h, load3(viscous_strain, 3 * at), load(weights, at), lam_bar, two_mu, change)


@part
def _add_block(block, row, column, count, start, blocks, sums):
    """Add K_ij, i = row <= j = column, and its mirror image to the pattern and to the sums of their rows."""
    if row == column:
        block = symmetric(block)
    else:
        mirror = transposed(block)
        scatter_add(blocks.values, blocks.pairs, start + (column * (count + 1) + row) * LANES, blocks.first, mirror)
        store(sums, 4 * column * LANES, add(load4(sums, 4 * column * LANES), mirror))
    scatter_add(blocks.values, blocks.pairs, start + (row * (count + 1) + column) * LANES, blocks.first, block)
    store(sums, 4 * row * LANES, add(load4(sums, 4 * row * LANES), block))


@part
def _add_last(count, start, blocks, sums):
    """Add the last corner's column and row: the rows of K sum to zero."""
    total = zeros4()
    for i in range(count):
        block = negative(load4(sums, 4 * i * LANES))
        scatter_add(blocks.values, blocks.pairs, start + (i * (count + 1) + count) * LANES, blocks.first, block)
        scatter_add(blocks.values, blocks.pairs, start + (count * (count + 1) + i) * LANES, blocks.first, transposed(block))
        total = add(total, load4(sums, 4 * i * LANES))
    scatter_add(blocks.values, blocks.pairs, start + (count * (count + 1) + count) * LANES, blocks.first, symmetric(total))


@entry
def strain_energy(cells, material, moved):
    """Strain energy in J, summed with compensation."""
    lam_bar, two_mu = lame(material)
    work = _workspace(cells.layout, 2, 0)
    state = zeros2()
    for b in range(cells.layout.shape[0]):
        m = cells.layout[b, 0] - 1
        _differences(moved, cells.corners, cells.layout[b, 2], cells.first_node, m, work)
        for p in range(cells.layout[b, 1]):
            h = _gradient(cells.gradients, cells.layout[b, 3] + 2 * p * m * LANES, work, m)
            state = add_energy(state, h, load(cells.weights, cells.layout[b, 4] + p * LANES), lam_bar, two_mu)
    energy = 0.0
    for k in range(LANES):
        energy += lane(state[0], k)
    return energy


@entry
def stress(cells, lane_cells, areas, material, moved, out):
    """Store the Cauchy stress (sxx, syy, sxy), Pa, mean over the reference area of each cell, in out (cells, 3).

    sigma = F S F^T / det F with F in the plane; modulus = E_mod / (1 - nu^2), Pa. Exact in plane strain; in plane stress the change of thickness is
    neglected (it would scale sigma by 1 / F33, about 1 + nu tr(E) / (1 - nu)).
    """
    out[:] = 0.0
    lam_bar, two_mu = lame(material)
    work = _workspace(cells.layout, 2, 0)
    for b in range(cells.layout.shape[0]):
        m = cells.layout[b, 0] - 1
        _differences(moved, cells.corners, cells.layout[b, 2], cells.first_node, m, work)
        state = zeros3()
        for p in range(cells.layout[b, 1]):
            h = _gradient(cells.gradients, cells.layout[b, 3] + 2 * p * m * LANES, work, m)
            state = add_cauchy(state, h, load(cells.weights, cells.layout[b, 4] + p * LANES), lam_bar, two_mu)
        _add_means(state, lane_cells, b * LANES, areas, out)


@entry
def green_strain(cells, lane_cells, areas, moved, out):
    """Store the Green-Lagrange strain (Exx, Eyy, 2 Exy), mean over the reference area of each cell, in out (cells, 3)."""
    out[:] = 0.0
    work = _workspace(cells.layout, 2, 0)
    for b in range(cells.layout.shape[0]):
        m = cells.layout[b, 0] - 1
        _differences(moved, cells.corners, cells.layout[b, 2], cells.first_node, m, work)
        state = zeros3()
        for p in range(cells.layout[b, 1]):
            h = _gradient(cells.gradients, cells.layout[b, 3] + 2 * p * m * LANES, work, m)
            state = add_strain(state, h, load(cells.weights, cells.layout[b, 4] + p * LANES))
        _add_means(state, lane_cells, b * LANES, areas, out)


@entry
def mass_product(indptr, indices, mass, scale, node_offset, a, residual):
    """residual (N, 2) += scale * (mass (x) I2) a for a body's node pattern; scale = rho * thickness in kg/m^2."""
    for row in range(indptr.shape[0] - 1):
        total = zero_pair()
        for k in range(load_integer(indptr, row), load_integer(indptr, row + 1)):
            total = add_product(total, load_float(mass, k), load_pair(a, 2 * (load_integer(indices, k) + node_offset)))
        add_pair(residual, 2 * (row + node_offset), scaled(scale, total))


@traced(1, pair)
def _add_pull(total, weight, other, own):
    """The sum `total + weight (other - own)` for a node and its neighbour."""
    return total + weight * (other - own)


@entry
def stabilisation_force(indptr, indices, stabilisation, factor, node_offset, moved, nodal_force):
    """nodal_force (N, 2) += factor (stabilisation (x) I2) moved of a body's nodes."""
    for row in range(indptr.shape[0] - 1):
        total, own = zero_pair(), load_pair(moved, 2 * (row + node_offset))
        for k in range(load_integer(indptr, row), load_integer(indptr, row + 1)):
            other = load_pair(moved, 2 * (load_integer(indices, k) + node_offset))
            total = _add_pull(total, load_float(stabilisation, k), other, own)
        add_pair(nodal_force, 2 * (row + node_offset), scaled(factor, total))


@entry
def stabilisation_energy(indptr, indices, stabilisation, factor, node_offset, moved):
    """factor moved . (stabilisation (x) I2) moved / 2 in J: compensated sum of -factor S_ij |u_i - u_j|^2 / 2, i < j."""
    total, lost = 0.0, 0.0
    for row in range(indptr.shape[0] - 1):
        i = row + node_offset
        for k in range(indptr[row], indptr[row + 1]):
            j = indices[k] + node_offset
            if j > i:
                x, y = moved[j, 0] - moved[i, 0], moved[j, 1] - moved[i, 1]
                term = -0.5 * factor * stabilisation[k] * (x * x + y * y) - lost
                bigger = total + term
                lost, total = (bigger - total) - term, bigger
    return total
