"""Matrix-free products of one body's tangent with a field, and work of its forces.

    (K w)_i = int t dP G_i,  dP = D S + F dS,  D = sum_i w_i (x) G_i,  dS = C : sym(F^T D)

With Kelvin-Voigt viscosity, `P = F S`, `S = C : (E + tau sym(F^T V))`, the transposed products are those of the tangents in u and in v:

    K^T w: W S + (F + tau V) T,   C^T w: tau F T,   T = C : sym(F^T W)

Other kernels give values for each cell: the work of its forces along a second field w,

    w . f = sum over the cell's points of weight P(F) : grad w      P = F S, S = D : (E + tau_v Edot)

and products of fields on the node pattern, for the work of the constant matrices (mass and stabilisation) in any number of frames at once. Fields w of
several objectives are columns: the forces are computed once for all of them.
Arguments as in kernels.py; results are added to the output arrays.
"""

from functools import partial

import numpy as np

from polyida.element.kernels import _differences, _gradient, _scatter_balanced, _scatter_turn, _workspace, lame, mass_product
from polyida.element.material import (
    add_outer,
    add_product,
    add_rotation,
    add_times,
    carried,
    first_piola,
    scaled,
    second_piola,
    strain,
    two_state_piola,
    two_state_strain,
)
from polyida.jit import FAST, entry, part
from polyida.jit.intrinsics import (
    LANES,
    add_pair,
    load,
    load2,
    load_float,
    load_integer,
    load_pair,
    store,
    traced,
    zero_pair,
    zeros2,
    zeros4,
)


def symmetric_part(h, d):
    """The symmetric part (xx, xy, yy) of F^T D, F = I + H."""
    f11, f12, f21, f22 = 1.0 + h[0], h[1], h[2], 1.0 + h[3]
    e12 = 0.5 * (f11 * d[1] + f21 * d[3] + f12 * d[0] + f22 * d[2])
    return f11 * d[0] + f21 * d[2], e12, f12 * d[1] + f22 * d[3]


def times(d, s):
    """The product D S of a matrix and a symmetric one."""
    s11, s12, s22 = s
    return d[0] * s11 + d[1] * s12, d[0] * s12 + d[1] * s22, d[2] * s11 + d[3] * s12, d[2] * s12 + d[3] * s22


@traced(3)
def stress(h, weight, lam_bar, two_mu):
    """weight times the second Piola-Kirchhoff stress S."""
    return second_piola(strain(h), lam_bar * weight, two_mu * weight)


@traced(4)
def piola_change(h, s, d, weight, lam_bar, two_mu):
    """weight dP along D; s: weight S."""
    turned, stretched = times(d, s), carried(h, second_piola(symmetric_part(h, d), lam_bar * weight, two_mu * weight))
    return tuple(a + b for a, b in zip(turned, stretched))


@traced(8)
def viscous_change(h, v, d, weight, lam_bar, two_mu, tau):
    """weight (D S + (F + tau V) T), then weight tau F T."""
    lam_bar, two_mu = lam_bar * weight, two_mu * weight
    turned = times(d, second_piola(two_state_strain(h, v, tau, 0.0), lam_bar, two_mu))
    stress = second_piola(symmetric_part(h, d), lam_bar, two_mu)
    stretched, dragged = carried(h, stress), times(v, stress)
    return tuple(a + b + tau * c for a, b, c in zip(turned, stretched, dragged)) + tuple(tau * b for b in stretched)


@traced(4)
def first_half(change):
    """The first of two 2 x 2 matrices."""
    return change[:4]


@traced(4)
def second_half(change):
    """The second of two 2 x 2 matrices."""
    return change[4:]


@part
def _two_gradients(gradients, start, differences, count):
    """H at one point of two fields, stored in succession in differences."""
    h, d, size = zeros4(), zeros4(), 2 * count * LANES
    for k in range(0, size, 2 * LANES):
        g = load2(gradients, start + k)
        h = add_outer(h, load2(differences, k), g)
        d = add_outer(d, load2(differences, size + k), g)
    return h, d


@entry
def stiffness_product(cells, material, moved, which, fields, nodal_forces, rotation):
    """Add K(moved) w, w = fields[c], to nodal_forces[c], (columns, N, 2), for the columns c in `which`; to rotation (N, 2) what kernels.internal_force adds, unless it is (0, 2)."""
    count = which.shape[0]
    lam_bar, two_mu = lame(material)
    work = _workspace(cells.layout, 2 + 4 * count, 0)
    for b in range(cells.layout.shape[0]):
        m, first = cells.layout[b, 0] - 1, cells.layout[b, 2]
        size = 2 * m * LANES
        forces = work[(1 + count) * size :]
        _differences(moved, cells.corners, first, cells.first_node, m, work)
        for c in range(count):
            _differences(fields[which[c]], cells.corners, first, cells.first_node, m, work[(1 + c) * size :])
        for k in range(0, count * size, 2 * LANES):
            store(forces, k, zeros2())
        turn = zeros2()
        for p in range(cells.layout[b, 1]):
            g, share = cells.layout[b, 3] + p * size, load(cells.weights, cells.layout[b, 4] + p * LANES)
            h, d = _two_gradients(cells.gradients, g, work, m)
            turn, elastic = add_rotation(turn, share, h), stress(h, share, lam_bar, two_mu)
            _add_forces(forces, cells.gradients, g, piola_change(h, elastic, d, share, lam_bar, two_mu), size)
            for c in range(1, count - 1, 2):  # two columns share the loads of the gradients
                d, e = _two_gradients(cells.gradients, g, work[(1 + c) * size :], m)
                here, behind = forces[c * size :], forces[(c + 1) * size :]
                one = piola_change(h, elastic, d, share, lam_bar, two_mu)
                two = piola_change(h, elastic, e, share, lam_bar, two_mu)
                for k in range(0, size, 2 * LANES):
                    slope = load2(cells.gradients, g + k)
                    store(here, k, add_times(load2(here, k), one, slope))
                    store(behind, k, add_times(load2(behind, k), two, slope))
            if count % 2 == 0:
                d = _gradient(cells.gradients, g, work[count * size :], m)
                change = piola_change(h, elastic, d, share, lam_bar, two_mu)
                _add_forces(forces[(count - 1) * size :], cells.gradients, g, change, size)
        for c in range(count):
            _scatter_balanced(forces[c * size :], cells.corners, first, cells.first_node, m, nodal_forces[which[c]])
        _scatter_turn(turn, cells.corners, first, cells.first_node, m, rotation)


@part
def _add_forces(forces, gradients, start, change, size):
    """Add the forces of a stress at one point."""
    for k in range(0, size, 2 * LANES):
        store(forces, k, add_times(load2(forces, k), change, load2(gradients, start + k)))


@entry
def mass_products(indptr, indices, mass, scale, node_offset, which, fields, out):
    """out[c] (N, 2) += scale * (mass (x) I2) fields[c] of a body's nodes for the columns c in `which`; two at a time share the loads of the matrix."""
    count = which.shape[0]
    for e in range(0, count - 1, 2):
        one, two, to, behind = fields[which[e]], fields[which[e + 1]], out[which[e]], out[which[e + 1]]
        for row in range(indptr.shape[0] - 1):
            p, q = zero_pair(), zero_pair()
            for k in range(load_integer(indptr, row), load_integer(indptr, row + 1)):
                value, place = load_float(mass, k), 2 * (load_integer(indices, k) + node_offset)
                p, q = add_product(p, value, load_pair(one, place)), add_product(q, value, load_pair(two, place))
            add_pair(to, 2 * (row + node_offset), scaled(scale, p))
            add_pair(behind, 2 * (row + node_offset), scaled(scale, q))
    if count % 2:
        mass_product(indptr, indices, mass, scale, node_offset, fields[which[count - 1]], out[which[count - 1]])


@entry
def viscous_products(cells, material, moved, v, along, nodal_force, slow, rotation):
    """Add K(moved, v)^T w, w = along, to nodal_force and C(moved)^T w to slow, (N, 2), of a viscous body; rotation as above."""
    lam_bar, two_mu = lame(material)
    work = _workspace(cells.layout, 10, 0)
    for b in range(cells.layout.shape[0]):
        m, first = cells.layout[b, 0] - 1, cells.layout[b, 2]
        size = 2 * m * LANES
        rates, force, drag = work[2 * size :], work[3 * size :], work[4 * size :]
        _differences(moved, cells.corners, first, cells.first_node, m, work)
        _differences(along, cells.corners, first, cells.first_node, m, work[size:])
        _differences(v, cells.corners, first, cells.first_node, m, rates)
        for k in range(0, 2 * size, 2 * LANES):
            store(force, k, zeros2())
        turn = zeros2()
        for p in range(cells.layout[b, 1]):
            g, share = cells.layout[b, 3] + p * size, load(cells.weights, cells.layout[b, 4] + p * LANES)
            h, d = _two_gradients(cells.gradients, g, work, m)
            turn = add_rotation(turn, share, h)
            change = viscous_change(h, _gradient(cells.gradients, g, rates, m), d, share, lam_bar, two_mu, material.viscosity)
            for k in range(0, size, 2 * LANES):
                here = load2(cells.gradients, g + k)
                store(force, k, add_times(load2(force, k), first_half(change), here))
                store(drag, k, add_times(load2(drag, k), second_half(change), here))
        _scatter_balanced(force, cells.corners, first, cells.first_node, m, nodal_force)
        _scatter_balanced(drag, cells.corners, first, cells.first_node, m, slow)
        _scatter_turn(turn, cells.corners, first, cells.first_node, m, rotation)


@traced(1)
def add_product_of(total, a, b):
    """total + a . b of two plane vectors."""
    return total + a[0] * b[0] + a[1] * b[1]


@entry
def force_work(cells, material, moved, v, fields, out):
    """Add the work `w . f`, w = fields[c], of each cell, without stabilisation, to out (columns, blocks * LANES) in the order of the lanes; v is not used without viscosity."""
    lam_bar, two_mu = lame(material)
    work = _workspace(cells.layout, 8, 0)
    for b in range(cells.layout.shape[0]):
        m, first = cells.layout[b, 0] - 1, cells.layout[b, 2]
        size = 2 * m * LANES
        rate, force, along = work[size:], work[2 * size :], work[3 * size :]
        _differences(moved, cells.corners, first, cells.first_node, m, work)
        if material.viscosity != 0.0:
            _differences(v, cells.corners, first, cells.first_node, m, rate)
        for k in range(0, size, 2 * LANES):
            store(force, k, zeros2())
        for p in range(cells.layout[b, 1]):
            g, weight = cells.layout[b, 3] + p * size, load(cells.weights, cells.layout[b, 4] + p * LANES)
            h = _gradient(cells.gradients, g, work, m)
            if material.viscosity != 0.0:
                d = _gradient(cells.gradients, g, rate, m)
                stress_of = two_state_piola(h, d, weight, lam_bar, two_mu, material.viscosity, 0.0)
                _add_forces(force, cells.gradients, g, stress_of, size)
            else:
                _add_forces(force, cells.gradients, g, first_piola(h, weight, lam_bar, two_mu), size)
        for c in range(fields.shape[0]):
            _differences(fields[c], cells.corners, first, cells.first_node, m, along)
            total = load(out[c], b * LANES)
            for k in range(0, size, 2 * LANES):
                total = add_product_of(total, load2(force, k), load2(along, k))
            store(out[c], b * LANES, (total,))


@entry
def by_node(fields, column, less):
    """Vectors of a column of fields (frames, columns, N, 2), less those of the frames (frames, 2), as (N, 2 frames)."""
    out = np.empty((fields.shape[2], 2 * fields.shape[0]))
    for i in range(fields.shape[2]):
        for k in range(fields.shape[0]):
            out[i, 2 * k], out[i, 2 * k + 1] = fields[k, column, i, 0] - less[k, 0], fields[k, column, i, 1] - less[k, 1]
    return out


@partial(entry, fastmath=FAST)
def products(indptr, indices, node_offset, others, fields, out):
    """out (nnz,) += sum over the frames of w_i . b_j, w = fields, b = others, for every pair (i, j) of a body's node pattern; both `by_node`."""
    for row in range(indptr.shape[0] - 1):
        own = fields[row + node_offset]
        for k in range(load_integer(indptr, row), load_integer(indptr, row + 1)):
            other, total = others[load_integer(indices, k) + node_offset], 0.0
            for e in range(own.shape[0]):
                total += own[e] * other[e]
            out[k] += total


@entry
def difference_products(indptr, indices, node_offset, moved, fields, out):
    """out (columns, nnz) += fields[c]_i . (u_j - u_i) for every pair: for matrices whose rows sum to zero; large translations cost no digits."""
    for c in range(fields.shape[0]):
        for row in range(indptr.shape[0] - 1):
            i = row + node_offset
            x, y, ux, uy = fields[c, i, 0], fields[c, i, 1], moved[i, 0], moved[i, 1]
            for k in range(load_integer(indptr, row), load_integer(indptr, row + 1)):
                j = load_integer(indices, k) + node_offset
                out[c, k] += x * (moved[j, 0] - ux) + y * (moved[j, 1] - uy)


@entry
def sums(places, cells, values, factors, out):
    """out[place] += value * factors[cell] for every place, cell and value."""
    for k in range(values.shape[0]):
        out[places[k]] += values[k] * factors[cells[k]]
