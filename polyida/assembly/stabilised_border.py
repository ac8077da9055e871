"""The border of a scene's step matrix by constraints and their rates, with the multipliers lam and mu, on the points z = A q.

With B = Bz A and H = d(B v + phi_t)/dq = Hz A, S and M those of the plates, m the masses at points, C the curvature of the rows and
the slopes of force elements, c real or complex,

    S dq + A^T (w + Bz^T dlam + c m A A^T Bz^T dmu) + c M B^T dmu = r2,   w = (C + c^2 m) A dq
    Bz A dq = r3,   (Hz + c Bz) A dq + Bz A A^T Bz^T dmu = r4 + Bz A r1
"""

from typing import NamedTuple

import numpy as np

from polyida.assembly import corotated
from polyida.assembly.equilibrium import momentum
from polyida.assembly.rows import joints
from polyida.given import on_pairs
from polyida.jit import leaf, pack, part
from polyida.linear.dense import clear, solve_small


@pack
class StabilisedRoom(NamedTuple):
    """Scratch of the border, in the numbers of c; overlap: A A^T; place: the unknowns' order; swing: Bz^T dmu, left there."""

    overlap: np.ndarray
    place: np.ndarray
    swing: np.ndarray
    moved: np.ndarray
    rate_slopes: np.ndarray
    cross: np.ndarray
    hb: np.ndarray
    small: np.ndarray
    unknown: np.ndarray
    last: np.ndarray


def stabilised_room(model, dtype=float):
    """Scratch for the borders of a model's step matrices, float or complex."""
    links, wide = model.arrays.links, 2 * model.n_points
    place = order_along_joints(corotated.active_components(links, model.laws), links)
    return StabilisedRoom(
        on_pairs((model.point_weights @ model.point_weights.conj().T).toarray()),
        place,
        np.zeros((model.n_points, 2), dtype),
        np.empty((model.n_points, 2), dtype),
        np.empty(len(links.row_columns)),
        np.empty((wide, wide), dtype),
        np.empty((wide, model.m), dtype),
        *corotated.small_room(len(place), dtype),
    )


def order_along_joints(active, links):
    """Place of the unknowns (active components, lam, mu): mu beside lam."""
    m, single = len(links.row_constant), corotated.order_along_joints(active, links)
    before = np.argsort(np.argsort(single * 2.0))
    multipliers = single[len(active) :]
    shift = np.array([(multipliers < at).sum() for at in before], np.int64)
    place = before + shift
    return np.concatenate([place, place[len(active) :] + 1]) if m else place


def massive(model, system, damping=None):
    """The Corotated `system` with columns `S^-1 (M + damping) A^T`, M of the plates.

    damping (n, n): C/c, so that c times the columns is that of c M + C; without it C B^T dmu, as good as zero, is left out.
    """

    def product(a):
        result = np.zeros_like(a)
        momentum(model.arrays, a, result)
        return result if damping is None else result + (damping @ a.ravel()).reshape(a.shape)

    result = system._replace(reach=np.zeros_like(system.reach))
    corotated.fill_reach(model.arrays.links, result, product)
    return result


@part
def stabilised_border(s, c, cm, cr, w, drives, dz, vz, lam, c_v, dq, r1, r3, r4, dlam, dmu):
    """Fill dlam, dmu (m,); move dq (nodes, 2), S^-1 r2 of the plates, by them; leave w.swing. False where the border is singular.

    c, cm: the factor with its columns and with those of `massive`; cr: its Room, frames as `solve_plates` left them; dz, vz: displacements
    and velocities of the points; c_v: c. r1 (nodes, 2), or None where it is zero.
    """
    wide = w.cross.shape[0]
    corotated.points_matrix(s, c, cr)
    for i in range(wide):
        for j in range(wide):
            w.cross[i, j] = cr.g[i, j]
    corotated.points_matrix(s, cm, cr)
    g, h = w.cross, cr.g
    joints.joint_jacobian(s, drives, dz, cr.slopes)
    joints.joint_rate_jacobian(s, drives, dz, vz, w.rate_slopes)
    corotated.fill_curvature(s, cr, drives, lam, c_v * c_v)
    for i in range(wide):
        for j in range(wide):
            h[i, j] *= c_v
        for p in range(wide):
            if s.point_mass[p // 2] != 0.0:
                for e in range(wide):
                    h[i, e] += c_v * g[i, p] * s.point_mass[p // 2] * w.overlap[p, e]
    times_jacobian(s, cr, g, cr.gb)
    times_jacobian(s, cr, h, w.hb)
    fill_stabilised(s, c, cr, w, c_v, dq, r3.shape[0])
    close_stabilised(s, c, cr, w, r1, r3, r4)
    if not solve_small(w.small, w.unknown, w.last):
        return False
    apply_border(s, c, cm, cr, w, c_v, dq, dlam, dmu)
    return True


@part
def times_jacobian(s, cr, matrix, product):
    """product (2 points, m) = matrix Bz^T."""
    for k in range(product.shape[1]):
        for p in range(product.shape[0]):
            total = 0.0
            for e in range(s.row_start[k], s.row_start[k + 1]):
                total += matrix[p, s.row_columns[e]] * cr.slopes[e]
            product[p, k] = total


@part
def fill_stabilised(s, c, cr, w, c_v, dq, m):
    """The border's system: curvature, position and velocity rows, each a combination of components of A dq."""
    count = c.active.shape[0]
    joints.point_values(s, dq, w.moved)
    clear(w.small)
    for i in range(w.unknown.shape[0]):
        w.unknown[i] = 0.0
    for i in range(count):
        w.small[w.place[i], w.place[i]] = 1.0
        for j in c.active:
            if cr.curvature[c.active[i], j] != 0.0:
                add_row(c, cr, w, w.place[i], cr.curvature[c.active[i], j], j, m)
    for k in range(m):
        for e in range(s.row_start[k], s.row_start[k + 1]):
            j = s.row_columns[e]
            add_row(c, cr, w, w.place[count + k], cr.slopes[e], j, m)
            add_row(c, cr, w, w.place[count + m + k], w.rate_slopes[e] + c_v * cr.slopes[e], j, m)


@leaf
def add_row(c, cr, w, at, value, j, m):
    """Add value times component j of `A dq = A y - g (w + Bz^T dlam) - h Bz^T dmu` to equation `at`."""
    count = c.active.shape[0]
    if value == 0.0:
        return
    w.unknown[at] += value * w.moved[j // 2, j % 2]
    for o in range(count):
        w.small[at, w.place[o]] += value * w.cross[j, c.active[o]]
    for k in range(m):
        w.small[at, w.place[count + k]] += value * cr.gb[j, k]
        w.small[at, w.place[count + m + k]] += value * w.hb[j, k]


@part
def close_stabilised(s, c, cr, w, r1, r3, r4):
    """Right-hand sides r3, r4 + Bz A r1 and the block -Bz A A^T Bz^T of the velocity constraint."""
    count, m = c.active.shape[0], r3.shape[0]
    if r1 is not None:
        joints.point_values(s, r1, w.moved)
    for k in range(m):
        at = w.place[count + m + k]
        w.unknown[w.place[count + k]] -= r3[k]
        w.unknown[at] -= r4[k]
        for e in range(s.row_start[k], s.row_start[k + 1]):
            p, value = s.row_columns[e], cr.slopes[e]
            if r1 is not None:
                w.unknown[at] -= value * w.moved[p // 2, p % 2]
            for o in range(m):
                for i in range(s.row_start[o], s.row_start[o + 1]):
                    q = s.row_columns[i]
                    w.small[at, w.place[count + m + o]] -= value * w.overlap[p, q] * cr.slopes[i]


@part
def apply_border(s, c, cm, cr, w, c_v, dq, dlam, dmu):
    """dq -= X (w + Bz^T dlam + c m A A^T Bz^T dmu) + c S^-1 M A^T Bz^T dmu; w.swing = Bz^T dmu."""
    clear(w.swing)
    for i in range(cr.pull.shape[0]):
        cr.pull[i] = 0.0
    count, m = c.active.shape[0], dlam.shape[0]
    for i in range(count):
        cr.pull[c.active[i]] = w.unknown[w.place[i]]
    for k in range(m):
        dlam[k], dmu[k] = w.unknown[w.place[count + k]], w.unknown[w.place[count + m + k]]
        for e in range(s.row_start[k], s.row_start[k + 1]):
            p = s.row_columns[e]
            cr.pull[p] += cr.slopes[e] * dlam[k]
            w.swing[p // 2, p % 2] += cr.slopes[e] * dmu[k]
    for p in range(w.overlap.shape[0]):
        if s.point_mass[p // 2] != 0.0:
            for e in range(w.overlap.shape[0]):
                cr.pull[p] += c_v * s.point_mass[p // 2] * w.overlap[p, e] * w.swing[e // 2, e % 2]
    corotated.pull_points(s, c, cr, dq)
    for p in range(cr.pull.shape[0]):
        cr.pull[p] = c_v * w.swing[p // 2, p % 2]
    corotated.pull_points(s, cm, cr, dq)
