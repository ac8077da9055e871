"""Numba kernels of the relaxation of a viscoelastic body: its strains at the points of the elements, and the stress that relaxes.

    S = D : (E - viscous_strain),   viscous_strain = sum_k g_k x_k,   x_k' = (E - x_k) / tau_k

Strains of the points, viscous_strain and x_k, are flat arrays (3 weights,): (11, 12, 22) of the LANES cells of one point, point after point in the order of
the weights. Other arguments as in kernels.py; h, d: gradients of a state and of a direction, as in material.py.
"""

from polyida.element.cell_products import _two_gradients, first_half, symmetric_part, times
from polyida.element.kernels import _add_means, _differences, _gradient, _scatter_balanced, _workspace, lame
from polyida.element.material import add_cauchy_of, add_times, carried, determinant, second_piola, strain, two_state_strain
from polyida.jit import entry, part
from polyida.jit.intrinsics import LANES, load, load2, load3, store, traced, zeros2, zeros3


@traced(4)
def relaxed_piola(h, viscous_strain, weight, lam_bar, two_mu):
    """weight F (D : viscous_strain)."""
    return carried(h, second_piola(viscous_strain, lam_bar * weight, two_mu * weight))


@traced(3)
def strain_of(h):
    """The Green-Lagrange strain E of a displacement gradient H."""
    return strain(h)


@traced(3)
def mean_strain(h, d):
    """Mean of E at H - d and H + d."""
    return two_state_strain(h, d, 0.0, 1.0)


@traced(3)
def strain_change(h, d):
    """Change of E along d."""
    return symmetric_part(h, d)


@traced(3)
def less_relaxed_cauchy(state, h, viscous_strain, weight, lam_bar, two_mu):
    """state - weight (sigma_xx, sigma_yy, sigma_xy) with sigma = F (D : viscous_strain) F^T / det F."""
    return add_cauchy_of(state, h, relaxed_piola(h, viscous_strain, -1.0 * weight / determinant(h), lam_bar, two_mu))


@traced(7)
def relaxation_change(h, d, viscous_strain, back, weight, lam_bar, two_mu):
    """D S of S = -weight D : viscous_strain, plus (dE/dF)^T back; then weight D : (change of E weight d), with both shear terms in the second."""
    lam_bar, two_mu = lam_bar * weight, two_mu * weight
    turned = times(d, second_piola(viscous_strain, -1.0 * lam_bar, -1.0 * two_mu))
    held = carried(h, (back[0], 0.5 * back[1], back[2]))
    s11, s12, s22 = second_piola(symmetric_part(h, d), lam_bar, two_mu)
    return (*(a + b for a, b in zip(turned, held)), s11, s12 + s12, s22)


@traced(3)
def last_three(change):
    """The last three of seven numbers: those behind a 2 x 2 matrix."""
    return change[4:]


@entry
def relax(cells, material, moved, half, viscous_strain, nodal_force, out):
    """Add the force of the stress S = -D : viscous_strain to nodal_force (N, 2), and store the strain at all points of all cells in out.

    moved (N, 2): displacements of nodes, of which F, the force and the strain are taken. viscous_strain, out: at all points, by lanes.
    half: None; or half the change of moved in a step (N, 2): the strain is then the mean of those at `moved` - half and moved + half.
    """
    lam_bar, two_mu = lame(material)
    work = _workspace(cells.layout, 6, 0)
    for b in range(cells.layout.shape[0]):
        m, first = cells.layout[b, 0] - 1, cells.layout[b, 2]
        size = 2 * m * LANES
        force = work[2 * size :]
        _differences(moved, cells.corners, first, cells.first_node, m, work)
        _directions(half, cells.corners, first, cells.first_node, m, work[size:])
        for k in range(0, size, 2 * LANES):
            store(force, k, zeros2())
        for p in range(cells.layout[b, 1]):
            g, at = cells.layout[b, 3] + p * size, cells.layout[b, 4] + p * LANES
            h = _gradient(cells.gradients, g, work, m)
            store(out, 3 * at, _strain(half, h, cells.gradients, g, work[size:], m))
            stress = relaxed_piola(h, load3(viscous_strain, 3 * at), load(cells.weights, at), -lam_bar, -two_mu)
            for k in range(0, size, 2 * LANES):
                store(force, k, add_times(load2(force, k), stress, load2(cells.gradients, g + k)))
        _scatter_balanced(force, cells.corners, first, cells.first_node, m, nodal_force)


@part
def _directions(half, corners, first, node_offset, count, out):
    """Store the differences of `half`, unless it is None. Its own function: numba drops a branch only if an argument is None."""
    if half is not None:
        _differences(half, corners, first, node_offset, count, out)


@part
def _strain(half, h, gradients, start, directions, count):
    """The strain E of h; with `half` the mean of E at H - d and H + d, d the gradient of `half`."""
    if half is None:
        return strain_of(h)
    return mean_strain(h, _gradient(gradients, start, directions, count))


@entry
def strain_at_points(cells, moved, out):
    """Store the Green-Lagrange strain at displacements of nodes `moved` (N, 2) in out, for all points of all cells, by lanes."""
    work = _workspace(cells.layout, 2, 0)
    for b in range(cells.layout.shape[0]):
        m = cells.layout[b, 0] - 1
        _differences(moved, cells.corners, cells.layout[b, 2], cells.first_node, m, work)
        for p in range(cells.layout[b, 1]):
            h = _gradient(cells.gradients, cells.layout[b, 3] + 2 * p * m * LANES, work, m)
            store(out, 3 * (cells.layout[b, 4] + p * LANES), strain_of(h))


@entry
def change_of_strain(cells, moved, along, out):
    """Store in out, for all points of all cells, the change of the strain along a field (N, 2); moved (N, 2): displacements of nodes."""
    work = _workspace(cells.layout, 4, 0)
    for b in range(cells.layout.shape[0]):
        m, first = cells.layout[b, 0] - 1, cells.layout[b, 2]
        size = 2 * m * LANES
        _differences(moved, cells.corners, first, cells.first_node, m, work)
        _differences(along, cells.corners, first, cells.first_node, m, work[size:])
        for p in range(cells.layout[b, 1]):
            h, d = _two_gradients(cells.gradients, cells.layout[b, 3] + p * size, work, m)
            store(out, 3 * (cells.layout[b, 4] + p * LANES), strain_change(h, d))


@entry
def relaxation_products(cells, material, moved, along, viscous_strain, back, nodal_force, out):
    """Add the change of the force of the stress -D : viscous_strain along a field w = along (N, 2), and B^T back, to nodal_force, and store D B w in out, B = dE/du."""
    lam_bar, two_mu = lame(material)
    work = _workspace(cells.layout, 6, 0)
    for b in range(cells.layout.shape[0]):
        m, first = cells.layout[b, 0] - 1, cells.layout[b, 2]
        size = 2 * m * LANES
        force = work[2 * size :]
        _differences(moved, cells.corners, first, cells.first_node, m, work)
        _differences(along, cells.corners, first, cells.first_node, m, work[size:])
        for k in range(0, size, 2 * LANES):
            store(force, k, zeros2())
        for p in range(cells.layout[b, 1]):
            g, at = cells.layout[b, 3] + p * size, cells.layout[b, 4] + p * LANES
            h, d = _two_gradients(cells.gradients, g, work, m)
            change = relaxation_change(h, d, load3(viscous_strain, 3 * at), load3(back, 3 * at), load(cells.weights, at), lam_bar, two_mu)
            store(out, 3 * at, last_three(change))
            for k in range(0, size, 2 * LANES):
                store(force, k, add_times(load2(force, k), first_half(change), load2(cells.gradients, g + k)))
        _scatter_balanced(force, cells.corners, first, cells.first_node, m, nodal_force)


@entry
def relax_stress(cells, lane_cells, areas, material, moved, viscous_strain, out):
    """Add the mean Cauchy stress of each cell, (xx, yy, xy), Pa, of the relaxed part S = -D : viscous_strain to out (cells, 3).

    moved (N, 2): displacements of nodes. viscous_strain: at all points of all cells, by lanes. lane_cells: the cell of each lane. areas: of
    the cells.
    """
    lam_bar, two_mu = lame(material)
    work = _workspace(cells.layout, 2, 0)
    for b in range(cells.layout.shape[0]):
        m = cells.layout[b, 0] - 1
        _differences(moved, cells.corners, cells.layout[b, 2], cells.first_node, m, work)
        state = zeros3()
        for p in range(cells.layout[b, 1]):
            at, h = cells.layout[b, 4] + p * LANES, _gradient(cells.gradients, cells.layout[b, 3] + 2 * p * m * LANES, work, m)
            state = less_relaxed_cauchy(state, h, load3(viscous_strain, 3 * at), load(cells.weights, at), lam_bar, two_mu)
        _add_means(state, lane_cells, b * LANES, areas, out)


@entry
def strain_square(weights, material, strain):
    """Integral of E : D : E over a body, J, of a strain E at its points."""
    total, nu = 0.0, material.nu
    for i in range(weights.shape[0]):
        at = 3 * LANES * (i // LANES) + i % LANES
        e11, e12, e22 = strain[at], strain[at + LANES], strain[at + 2 * LANES]
        total += weights[i] * material.stiffness * (nu * (e11 + e22) ** 2 + (1.0 - nu) * (e11 * e11 + e22 * e22 + 2.0 * e12 * e12))
    return total
