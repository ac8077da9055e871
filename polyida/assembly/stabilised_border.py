"""The border of a scene's step matrix by constraints and their rates, with the multipliers lam and mu, on the points z = A q.

With B = Bz A and H = d(B v + phi_t)/dq = Hz A, S and M those of the plates, m the masses at points, C the curvature of the rows and
the slopes of force elements, c real or complex,

    S dq + A^T (w + Bz^T dlam + c m A A^T Bz^T dmu) + c M B^T dmu = r2,   w = (C + c^2 m) A dq
    Bz A dq = r3,   (Hz + c Bz) A dq + Bz A A^T Bz^T dmu = r4
"""

from typing import NamedTuple

import numpy as np

from polyida.assembly import corotated, joints
from polyida.assembly.border import Border, BorderRoom, body_blocks, border, border_room, look, solve_border, solve_border_again, width
from polyida.assembly.equilibrium import momentum
from polyida.jit import pack, part
from polyida.linear.dense import clear


@pack
class StabilisedRoom(NamedTuple):
    """Scratch of the border, in the numbers of c; border: the pattern of the unknowns w, lam and mu. swing: Bz^T dmu, left there."""

    border: Border
    room: BorderRoom
    swing: np.ndarray
    moved: np.ndarray


def stabilised_room(model, dtype=float):
    """Scratch for the borders of a model's step matrices, float or complex."""
    pattern, points = model.once(border_with_rates, of_shape=True), (model.n_points, 2)
    numbers, flat = border_room(model, pattern, dtype), model.once(overlaps, of_shape=True)
    at = 0
    for begin, end in zip(pattern.block, pattern.block[1:]):
        size = int(np.sqrt(end - begin)) // 2
        block = numbers.blocks[begin:end].reshape(2 * size, 2 * size)
        block[size:, size:] = -flat[at : at + size * size].reshape(size, size)
        at += size * size
    return StabilisedRoom(pattern, numbers, np.zeros(points, dtype), np.empty(points, dtype))


def border_with_rates(model):
    """The Border of a scene with the multipliers of the rows' rates."""
    return border(model, rates=True)


def overlaps(model):
    """`A A^T` body by body."""
    weights = model.point_weights
    return body_blocks(model.once(border_with_rates, of_shape=True), weights, weights.conj().T.tocsc())


def massive(model, system, damping=None, before=None):
    """The Corotated `system` with columns `S^-1 (M + damping) A^T`, M of the plates.

    damping (n, n): C/c, so that c times the columns is that of c M + C; without it C B^T dmu, as good as zero, is left out. before: one made
    for the same system, which is filled anew.
    """
    loads = model.once(momenta)
    if damping is not None:
        units = model.once(corotated.unit_loads, of_shape=True)
        loads = loads + (damping @ units.reshape(len(units), -1).T).T.reshape(units.shape)
    before = system._replace(reach=np.zeros_like(system.reach)) if before is None else before
    corotated.fill_reach(system, before.reach, system.frame[:0], loads, np.empty(model.n, system.panels.dtype))
    return before


def momenta(model):
    """M A^T of the plates, as `unit_loads`."""
    loads = np.zeros_like(model.once(corotated.unit_loads, of_shape=True))
    for load, unit in zip(loads, model.once(corotated.unit_loads, of_shape=True)):
        momentum(model.arrays, unit, load)
    return loads


@part
def stabilised_border(s, c, cm, cr, w, drives, dz, vz, lam, c_v, anew, dq, r3, r4, dlam, dmu):
    """Fill dlam, dmu (m,); move dq (nodes, 2), S^-1 r2 of the plates, by them; leave w.swing. False where the border is singular.

    c, cm: the factor with its columns and with those of `massive`; cr: its Room, frames as `solve_plates` left them; dz, vz: displacements
    and velocities of the points; c_v: c; anew: whether the border is made of these, or is that of before. Of the last equation
    c times the one before is taken, which leaves `Hz A dq + Bz A A^T Bz^T dmu = r4 - c r3`.
    """
    b, y, m = w.border, w.room, r3.shape[0]
    if anew:
        corotated.points_matrix(s, c, cr, b, y.blocks, 0)
        corotated.points_matrix(s, cm, cr, b, y.blocks, 1)
        add_masses(s, b, c_v, y.blocks)
        joints.joint_jacobian(s, drives, dz, y.slopes)
        joints.joint_rate_jacobian(s, drives, dz, vz, y.rates)
        corotated.fill_curvature(s, cr, y.curvature, drives, lam, c_v * c_v)
    joints.point_values(s, dq, w.moved)
    look(b, y, w.moved)
    count = b.active.shape[0]
    for k in range(m):
        y.right[count + k] -= r3[k]
        y.right[count + m + k] -= r4[k] - c_v * r3[k]
    if not (solve_border(b, y) if anew else solve_border_again(b, y)):
        return False
    apply_border(s, c, cm, cr, w, c_v, dq, dlam, dmu)
    return True


@part
def add_masses(s, b, c_v, blocks):
    """Second layer of the bodies' first rows: c (S^-1 M A^T on the points + G m A A^T), A A^T from the last rows."""
    for n in range(b.block.shape[0] - 1):
        wide, at = width(b, n), b.block[n]
        size = wide // 2
        for e in range(size):
            mass = s.point_mass[b.points[b.point_start[n] + e // 2]]
            if mass != 0.0:
                for p in range(size):
                    for q in range(size):
                        blocks[at + p * wide + size + q] -= blocks[at + p * wide + e] * mass * blocks[at + (size + e) * wide + size + q]
        for p in range(size):
            for q in range(size):
                blocks[at + p * wide + size + q] *= c_v


@part
def apply_border(s, c, cm, cr, w, c_v, dq, dlam, dmu):
    """dq -= X (w + Bz^T dlam + c m A A^T Bz^T dmu) + c S^-1 M A^T Bz^T dmu; w.swing = Bz^T dmu."""
    clear(w.swing)
    b, m = w.border, dlam.shape[0]
    corotated.pull_of(s, b, w.room, cr.pull, dlam)
    for k in range(m):
        dmu[k] = w.room.x[b.active.shape[0] + m + k]
        for e in range(s.row_start[k], s.row_start[k + 1]):
            p = s.row_columns[e]
            w.swing[p // 2, p % 2] += w.room.slopes[e] * dmu[k]
    for n in range(b.block.shape[0] - 1):
        wide, points = width(b, n), b.points[b.point_start[n] : b.point_start[n + 1]]
        size = wide // 2
        for p in range(size):
            mass = s.point_mass[points[p // 2]]
            if mass != 0.0:
                for q in range(size):
                    across = -w.room.blocks[b.block[n] + (size + p) * wide + size + q]
                    cr.pull[2 * points[p // 2] + p % 2] += c_v * mass * across * w.swing[points[q // 2], q % 2]
    corotated.pull_points(s, c, cr, dq)
    for p in range(cr.pull.shape[0]):
        cr.pull[p] = c_v * w.swing[p // 2, p % 2]
    corotated.pull_points(s, cm, cr, dq)
