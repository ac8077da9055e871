"""Numba kernels beside those of element/kernels.py: energies and forces over frames, energies of cells, what stresses of cells pull with.

    tau = F S F^T,  sigma = tau / det F,  d(G : sigma) = (2 G F S + F D : (F^T G F) - (G : sigma) det F F^-T) / det F : dF

Arguments as there; the body's nodes begin at 0.
"""

from polyida.assembly import equilibrium
from polyida.element.kernels import _differences, _gradient, _room
from polyida.element.material import add_energy, add_times, carried, determinant, difference, second_piola, strain
from polyida.jit import entry
from polyida.jit.intrinsics import LANES, lane, load, load2, scatter_add, store, traced, zeros2


@entry
def energies(scene, q, out):
    """Fill out (frames,) with the elastic energy, J, of a scene's bodies at q (frames, pairs, 2)."""
    for k in range(q.shape[0]):
        out[k] = equilibrium.strain_energy(scene, q[k])


@entry
def forces(scene, drives, q, still, lam, factor, phi, points, out):
    """Fill out (frames, pairs, 2) with factor (frames,) times the residual at rest; still (pairs, 2), lam (m,) are zero, phi (m,) and
    points (2, points, 2) scratch.
    """
    for k in range(q.shape[0]):
        equilibrium.equilibrium(scene, drives, q[k], still, lam, out[k], phi, still[:0], points[0], points[1])
        for i in range(out.shape[1]):
            out[k, i, 0], out[k, i, 1] = factor[k] * out[k, i, 0], factor[k] * out[k, i, 1]


@entry
def cell_energies(layout, corners, gradients, weights, lane_cells, c1, nu, u, factor, out):
    """out (cells,) += factor times the strain energy of every cell, J."""
    room = _room(layout, 2, 0)
    for b in range(layout.shape[0]):
        m = layout[b, 0] - 1
        _differences(u, corners, layout[b, 2], 0, m, room)
        state = zeros2()
        for p in range(layout[b, 1]):
            h = _gradient(gradients, layout[b, 3] + 2 * p * m * LANES, room, m)
            state = add_energy(state, h, load(weights, layout[b, 4] + p * LANES), c1 * nu, c1 * (1.0 - nu))
        for k in range(LANES):
            out[lane_cells[b * LANES + k]] += factor * lane(state[0], k)


@traced(4)
def _pull(h, g, w, spherical, deviatoric):
    """w d(G : sigma)/dF, g = (Gxx, Gyy, 2 Gxy)."""
    f11, f12, f21, f22 = 1.0 + h[0], h[1], h[2], 1.0 + h[3]
    shear, det = 0.5 * g[2], determinant(h)
    s = second_piola(strain(h), spherical, deviatoric)
    n = g[0] * f11 + shear * f21, g[0] * f12 + shear * f22, shear * f11 + g[1] * f21, shear * f12 + g[1] * f22
    a = f11 * n[0] + f21 * n[2], f11 * n[1] + f21 * n[3], f12 * n[1] + f22 * n[3]
    moved = carried(h, second_piola(a, spherical, deviatoric))
    held = (s[0] * a[0] + 2.0 * (s[1] * a[1]) + s[2] * a[2]) / det
    stretched = n[0] * s[0] + n[1] * s[1], n[0] * s[1] + n[1] * s[2], n[2] * s[0] + n[3] * s[1], n[2] * s[1] + n[3] * s[2]
    turned = f22, 0.0 - f21, 0.0 - f12, f11
    return tuple(w / det * (2.0 * x + y - held * z) for x, y, z in zip(stretched, moved, turned))


@entry
def stress_pull(layout, corners, gradients, weights, toward, c, nu, u, f):
    """f (nodes, 2) += the slope in u of the sum over cells of `toward . int (sxx, syy, sxy)`, as kernels.stress has it.

    toward (blocks, 3, LANES): numbers of each cell, 1/m^2 times what the sum is in.
    """
    room = _room(layout, 4, 0)
    for b in range(layout.shape[0]):
        m, first = layout[b, 0] - 1, layout[b, 2]
        force, size = room[2 * m * LANES :], 2 * m * LANES
        _differences(u, corners, first, 0, m, room)
        for k in range(0, size, 2 * LANES):
            store(force, k, zeros2())
        at = 3 * b * LANES
        wanted = load(toward, at), load(toward, at + LANES), load(toward, at + 2 * LANES)
        for p in range(layout[b, 1]):
            g = layout[b, 3] + p * size
            pull = _pull(_gradient(gradients, g, room, m), wanted, load(weights, layout[b, 4] + p * LANES), c * nu, c * (1.0 - nu))
            for k in range(0, size, 2 * LANES):
                store(force, k, add_times(load2(force, k), pull, load2(gradients, g + k)))
        balance = zeros2()
        for i in range(m):
            own = load2(force, 2 * i * LANES)
            scatter_add(f, corners, first + i * LANES, 0, own)
            balance = difference(balance, own)
        scatter_add(f, corners, first + m * LANES, 0, balance)
