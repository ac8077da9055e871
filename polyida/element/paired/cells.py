"""Numba kernels that keep the cells of a body apart: the work of each cell's forces along a second field w.

    w . f = sum over the cell's points of weight P(F) : grad w      P = F S, S = D : (E + tau_v Edot)

and products of fields on the node pattern, from which the work of what is constant in a cell, mass and stabilisation, follows for any
number of frames at once. Arguments as in kernels.py; results are added to the arrays given.
"""

from polyida.element.kernels import _differences, _gradient, _room
from polyida.element.material import first_piola
from polyida.element.paired.two_state_material import two_state_piola
from polyida.jit import entry
from polyida.jit.intrinsics import LANES, load, load_integer, store, traced


@traced(1)
def add_work(total, p, g):
    """total + P : G."""
    return total + p[0] * g[0] + p[1] * g[1] + p[2] * g[2] + p[3] * g[3]


@entry
def force_work(layout, corners, gradients, weights, node_offset, c1, nu, tau_v, u, v, w, out):
    """Add to out (blocks * LANES,), in the order of the lanes, `w . f` of each cell at displacements u, velocities v, without the
    stabilisation; v is not read where tau_v is zero.
    """
    room = _room(layout, 6, 0)
    for b in range(layout.shape[0]):
        m, first = layout[b, 0] - 1, layout[b, 2]
        size, total = 2 * m * LANES, load(out, b * LANES)
        along, rate = room[size:], room[2 * size :]
        _differences(u, corners, first, node_offset, m, room)
        _differences(w, corners, first, node_offset, m, along)
        if tau_v != 0.0:
            _differences(v, corners, first, node_offset, m, rate)
        for p in range(layout[b, 1]):
            g, weight = layout[b, 3] + p * size, load(weights, layout[b, 4] + p * LANES)
            h, slope = _gradient(gradients, g, room, m), _gradient(gradients, g, along, m)
            if tau_v != 0.0:
                d = _gradient(gradients, g, rate, m)
                total = add_work(total, two_state_piola(h, d, weight, c1 * nu, c1 * (1.0 - nu), tau_v, 0.0), slope)
            else:
                total = add_work(total, first_piola(h, weight, c1 * nu, c1 * (1.0 - nu)), slope)
        store(out, b * LANES, (total,))


@entry
def products(indptr, indices, node_offset, b, w, out):
    """out (nnz,) += w_i . b_j for every pair (i, j) of a body's node pattern."""
    for row in range(indptr.shape[0] - 1):
        x, y = w[row + node_offset, 0], w[row + node_offset, 1]
        for k in range(load_integer(indptr, row), load_integer(indptr, row + 1)):
            j = load_integer(indices, k) + node_offset
            out[k] += x * b[j, 0] + y * b[j, 1]


@entry
def difference_products(indptr, indices, node_offset, u, w, out):
    """out (nnz,) += w_i . (u_j - u_i) for every pair: for matrices whose rows sum to zero, without the digits of large translations."""
    for row in range(indptr.shape[0] - 1):
        i = row + node_offset
        x, y, ux, uy = w[i, 0], w[i, 1], u[i, 0], u[i, 1]
        for k in range(load_integer(indptr, row), load_integer(indptr, row + 1)):
            j = load_integer(indices, k) + node_offset
            out[k] += x * (u[j, 0] - ux) + y * (u[j, 1] - uy)


@entry
def sums(places, cells, values, factors, out):
    """out[place] += value * factors[cell] for every place, cell and value."""
    for k in range(values.shape[0]):
        out[places[k]] += values[k] * factors[cells[k]]
