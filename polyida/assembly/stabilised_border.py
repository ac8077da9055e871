"""The border of a scene's step matrix by constraints and their rates, with the multipliers lam and mu, on the points z = A q.

With B = Bz A and H = d(B v + phi_t)/dq = Hz A, S and M those of the plates, m the masses at points, C the curvature of the rows and
the slopes of force elements, c real or complex,

    S dq + A^T (w + Bz^T dlam + c m A A^T Bz^T dmu) + c M B^T dmu = r2,   w = (C + c^2 m) A dq
    Bz A dq = r3,   (Hz + c Bz) A dq + Bz A A^T Bz^T dmu = r4
"""

from typing import NamedTuple

import numpy as np

from polyida.assembly import corotated, joints
from polyida.assembly.border import (
    Border,
    BorderWorkspace,
    body_blocks,
    border,
    border_workspace,
    look,
    solve_border,
    solve_border_again,
    width,
)
from polyida.assembly.equilibrium import momentum
from polyida.jit import pack, part
from polyida.linear.dense import clear


@pack
class StabilisedWorkspace(NamedTuple):
    """Scratch of the border, in the numbers of c; border: the pattern of the unknowns w, lam and mu. swing: Bz^T dmu, left there."""

    border: Border
    workspace: BorderWorkspace
    swing: np.ndarray
    moved: np.ndarray


def stabilised_workspace(model, dtype=float, transposed=False):
    """Scratch for the borders of a model's step matrices, float or complex; transposed: for those of the backward sweep."""
    pattern = model.once(transposed_border if transposed else border_with_rates, of_shape=True)
    numbers, flat, at, points = border_workspace(model, pattern, dtype), model.once(overlaps, of_shape=True), 0, (model.n_points, 2)
    for begin, end in zip(pattern.block, pattern.block[1:]):
        size = int(np.sqrt(end - begin)) // 2
        block, place = numbers.blocks[begin:end].reshape(2 * size, 2 * size), slice(0, size) if transposed else slice(size, None)
        block[place, place] = -flat[at : at + size * size].reshape(size, size)
        at += size * size
    return StabilisedWorkspace(pattern, numbers, np.zeros(points, dtype), np.empty(points, dtype))


def border_with_rates(model):
    """The Border of a scene with the multipliers of the rows' rates."""
    return border(model, rates=True)


def transposed_border(model):
    """The same of the transposed system."""
    return border(model, rates=True, transposed=True)


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
    before = system._replace(compliance_columns=np.zeros_like(system.compliance_columns)) if before is None else before
    corotated.fill_compliance_columns(system, before.compliance_columns, system.frame[:0], loads, np.empty(model.n, system.panels.dtype))
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

    c, cm: the factor with its columns and with those of `massive`; cr: its SolveWorkspace, frames as `solve_plates` left them; dz, vz: displacements
    and velocities of the points; c_v: c; anew: whether the border is made of these, or is that of before. Of the last equation
    c times the one before is taken, which leaves `Hz A dq + Bz A A^T Bz^T dmu = r4 - c r3`.
    """
    b, y, m = w.border, w.workspace, r3.shape[0]
    if anew:
        corotated.points_matrix(s, c, cr, b, y.blocks, 0)
        corotated.points_matrix(s, cm, cr, b, y.blocks, 1)
        add_masses(s, b, c_v, y.blocks)
        joints.joint_jacobian(s, drives, dz, y.slopes)
        joints.joint_rate_jacobian(s, drives, dz, vz, y.rates)
        corotated.fill_curvature(s, cr, y.curvature, drives, lam, c_v * c_v)
    joints.point_values(s, dq, w.moved)
    look(b, y, w.moved, w.moved[:0])
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
    corotated.point_forces_of(s, b, w.workspace, cr.point_forces, dlam)
    for k in range(m):
        dmu[k] = w.workspace.x[b.active.shape[0] + m + k]
        for e in range(s.row_start[k], s.row_start[k + 1]):
            p = s.row_columns[e]
            w.swing[p // 2, p % 2] += w.workspace.slopes[e] * dmu[k]
    for n in range(b.block.shape[0] - 1):
        wide, points = width(b, n), b.points[b.point_start[n] : b.point_start[n + 1]]
        size = wide // 2
        for p in range(size):
            mass = s.point_mass[points[p // 2]]
            if mass != 0.0:
                for q in range(size):
                    across = -w.workspace.blocks[b.block[n] + (size + p) * wide + size + q]
                    cr.point_forces[2 * points[p // 2] + p % 2] += c_v * mass * across * w.swing[points[q // 2], q % 2]
    corotated.apply_point_forces(s, c, cr, dq)
    for p in range(cr.point_forces.shape[0]):
        cr.point_forces[p] = c_v * w.swing[p // 2, p % 2]
    corotated.apply_point_forces(s, cm, cr, dq)


@part
def transpose_blocks(b, blocks, out):
    """The blocks of the transposed border from those of the border, ((G, H), (0, -A A^T)): ((-A A^T, H^T), (0, G))."""
    for n in range(b.block.shape[0] - 1):
        wide, at = width(b, n), b.block[n]
        size = wide // 2
        for p in range(size):
            for q in range(size):
                out[at + p * wide + size + q] = blocks[at + q * wide + size + p]
                out[at + (size + p) * wide + size + q] = blocks[at + p * wide + q]


@part
def transposed(s, c, cm, cr, w, z, c_v, r, dw, rows, multipliers):
    """Fill the multipliers (2, m) of the transposed system, and cr.point_forces; dw (nodes, 2) = S^-1 r of the plates, r (nodes, 2) and rows (2, m):

    `S dw + A^T (C A dw + Bz^T dmu + (Hz + c Bz)^T dkappa) = r`, `Bz A dw = -rows_0`, `B (c M + C) dw + B B^T dkappa = -rows_1`. w: the workspace of
    the border, whose blocks those of z, the workspace of the transposed one, are made of. False where the border is singular.
    """
    b, y, m = z.border, z.workspace, rows.shape[1]
    joints.point_values(s, dw, z.moved)
    momenta_at_points(c, cm, cr, c_v, r, z.swing)
    for n in range(w.border.block.shape[0] - 1):  # c A A^T m A dw
        wide, points = width(b, n), b.points[b.point_start[n] : b.point_start[n + 1]]
        size = wide // 2
        for q in range(size):
            mass = s.point_mass[points[q // 2]]
            if mass != 0.0:
                for p in range(size):
                    across = -y.blocks[b.block[n] + p * wide + q]
                    z.swing[points[p // 2], p % 2] += c_v * mass * across * z.moved[points[q // 2], q % 2]
    look(b, y, z.swing, z.moved)
    count = b.active.shape[0]
    for k in range(m):
        y.right[count + k] += rows[0, k]
        y.right[count + m + k] += rows[1, k]
    if not solve_border(b, y):
        return False
    corotated.point_forces_of(s, b, y, cr.point_forces, multipliers[0])
    for k in range(m):
        multipliers[1, k] = y.x[count + m + k]
        multipliers[0, k] -= c_v * multipliers[1, k]
        for e in range(s.row_start[k], s.row_start[k + 1]):
            cr.point_forces[s.row_columns[e]] += y.rates[e] * multipliers[1, k]
    return True


@part
def momenta_at_points(c, cm, cr, c_v, r, moved):
    """moved = A (c M + C) S^-1 r of the plates, from the columns of `massive`."""
    for f in range(moved.shape[0]):
        first, end, at = c.place[f, 0], c.place[f, 1], c.place[f, 2]
        size, p, q = end - first, 0.0 * c_v, 0.0 * c_v
        for i in range(size):
            co, si, x, y = cr.turn[first + i, 0], cr.turn[first + i, 1], r[first + i, 0], r[first + i, 1]
            x, y = co * x + si * y, co * y - si * x
            p += cm.compliance_columns[at + i, 0] * x + cm.compliance_columns[at + i, 1] * y
            q += cm.compliance_columns[at + size + i, 0] * x + cm.compliance_columns[at + size + i, 1] * y
        co, si = cr.spin[f, 0], cr.spin[f, 1]
        moved[f, 0], moved[f, 1] = c_v * (co * p - si * q), c_v * (si * p + co * q)
