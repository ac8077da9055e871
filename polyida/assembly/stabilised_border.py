"""The constraint system of a scene's step matrix with the multipliers lam of phi and mu of its rate (GGL stabilisation).

Points of the bodies are z = A q. B = Bz A is phi_q, H = Hz A is d(B v + phi_t)/dq. S and M are the step and mass matrices of the plates, m the
point masses, C the curvature of the rows of phi and the slopes of force elements; c is a real or complex number.

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
    measure,
    solve_border,
    solve_border_again,
    width,
)
from polyida.assembly.equilibrium import momentum
from polyida.jit import pack, part
from polyida.linear.dense import clear


@pack
class StabilisedWorkspace(NamedTuple):
    """Scratch of the type of c. border: pattern of the unknowns w, lam and mu. rate_forces, displacements (points, 2): Bz^T dmu, and A dq."""

    border: Border
    workspace: BorderWorkspace
    rate_forces: np.ndarray
    displacements: np.ndarray


def stabilised_workspace(model, dtype=float, transposed=False):
    """A StabilisedWorkspace of a model. transposed: True for the systems of the backward sweep."""
    pattern = model.once(transposed_border if transposed else border_with_rates, of_shape=True)
    numbers, flat, at, points = border_workspace(model, pattern, dtype), model.once(overlaps, of_shape=True), 0, (model.n_points, 2)
    for begin, end in zip(pattern.block, pattern.block[1:]):
        size = int(np.sqrt(end - begin)) // 2
        block, place = numbers.blocks[begin:end].reshape(2 * size, 2 * size), slice(0, size) if transposed else slice(size, None)
        block[place, place] = -flat[at : at + size * size].reshape(size, size)
        at += size * size
    return StabilisedWorkspace(pattern, numbers, np.zeros(points, dtype), np.empty(points, dtype))


def border_with_rates(model):
    """The Border of a scene with mu."""
    return border(model, rates=True)


def transposed_border(model):
    """The Border of the transposed system."""
    return border(model, rates=True, transposed=True)


def overlaps(model):
    """The blocks A A^T of the bodies."""
    weights = model.point_weights
    return body_blocks(model.once(border_with_rates, of_shape=True), weights, weights.conj().T.tocsc())


def mass_columns(model, system, damping=None, before=None):
    """The Corotated `system` with the columns `S^-1 (M + damping) A^T`, M of the plates.

    damping (n, n): C/c, so that c times the columns is S^-1 (c M + C) A^T. Without it C B^T dmu, which is nearly zero, is neglected. before:
    an earlier result for the same system, whose columns are overwritten.
    """
    loads = model.once(momenta)
    if damping is not None:
        units = model.once(corotated.unit_loads, of_shape=True)
        loads = loads + (damping[: 2 * model.n_factored, : 2 * model.n_factored] @ units.reshape(len(units), -1).T).T.reshape(units.shape)
    before = system._replace(compliance_columns=np.zeros_like(system.compliance_columns)) if before is None else before
    corotated.fill_compliance_columns(
        system, before.compliance_columns, system.frame[:0], loads, np.empty(2 * model.n_factored, system.panels.dtype)
    )
    return before


def momenta(model):
    """M A^T of the plates, arranged as `corotated.unit_loads`."""
    loads = np.zeros_like(model.once(corotated.unit_loads, of_shape=True))
    for load, unit in zip(loads, model.once(corotated.unit_loads, of_shape=True)):
        momentum(model.arrays, unit, load)
    return loads


@part
def stabilised_border(s, c, cm, cr, w, drives, dz, vz, lam, c_v, anew, dq, r3, r4, dlam, dmu):
    """Compute dlam, dmu (m,) and w.rate_forces, and correct dq (nodes, 2), which is S^-1 r2. Returns False if the system is singular.

    c, cm: factors with the columns of the corotated solver and of `mass_columns`. cr: SolveWorkspace with the frames that `solve_plates` sets.
    dz, vz: displacements and velocities of the points. c_v: the number c. anew: True if the system is assembled; False if that of the last call is
    used. c times the third equation is subtracted from the last one, which gives `Hz A dq + Bz A A^T Bz^T dmu = r4 - c r3`.
    """
    b, y, m = w.border, w.workspace, r3.shape[0]
    if anew:
        corotated.points_matrix(s, c, cr, b, y.blocks, 0)
        corotated.points_matrix(s, cm, cr, b, y.blocks, 1)
        add_masses(s, b, c_v, y.blocks)
        joints.joint_jacobian(s, drives, dz, y.slopes)
        joints.joint_rate_jacobian(s, drives, dz, vz, y.rates)
        corotated.fill_curvature(s, cr, y.curvature, drives, lam, c_v * c_v)
    joints.point_values(s, dq, w.displacements)
    measure(b, y, w.displacements, w.displacements[:0])
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
    """Set the block H of each body to c (A S^-1 M A^T + G m A A^T); A A^T is read from the block below."""
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
    """dq -= S^-1 A^T (w + Bz^T dlam + c m A A^T Bz^T dmu) + c S^-1 M A^T Bz^T dmu; w.rate_forces = Bz^T dmu."""
    clear(w.rate_forces)
    b, m = w.border, dlam.shape[0]
    corotated.point_forces_of(s, b, w.workspace, cr.point_forces, dlam)
    for k in range(m):
        dmu[k] = w.workspace.x[b.active.shape[0] + m + k]
        for e in range(s.row_start[k], s.row_start[k + 1]):
            p = s.row_columns[e]
            w.rate_forces[p // 2, p % 2] += w.workspace.slopes[e] * dmu[k]
    for n in range(b.block.shape[0] - 1):
        wide, points = width(b, n), b.points[b.point_start[n] : b.point_start[n + 1]]
        size = wide // 2
        for p in range(size):
            mass = s.point_mass[points[p // 2]]
            if mass != 0.0:
                for q in range(size):
                    across = -w.workspace.blocks[b.block[n] + (size + p) * wide + size + q]
                    cr.point_forces[2 * points[p // 2] + p % 2] += c_v * mass * across * w.rate_forces[points[q // 2], q % 2]
    corotated.apply_point_forces(s, c, cr, dq)
    for p in range(cr.point_forces.shape[0]):
        cr.point_forces[p] = c_v * w.rate_forces[p // 2, p % 2]
    corotated.apply_point_forces(s, cm, cr, dq)
    corotated.settle_states(s, c, w.workspace.curvature, w.displacements, dq)


@part
def transpose_blocks(b, blocks, out):
    """Copy H and G from the blocks ((G, H), (0, -A A^T)) to the blocks of the transposed system, ((-A A^T, H^T), (0, G))."""
    for n in range(b.block.shape[0] - 1):
        wide, at = width(b, n), b.block[n]
        size = wide // 2
        for p in range(size):
            for q in range(size):
                out[at + p * wide + size + q] = blocks[at + q * wide + size + p]
                out[at + (size + p) * wide + size + q] = blocks[at + p * wide + q]


@part
def transposed(s, c, cm, cr, w, z, c_v, r, dw, rows, multipliers):
    """Compute multipliers (2, m), lam and kappa, and cr.point_forces of the transposed system. Returns False if it is singular.

        S dw + A^T (C A dw + Bz^T dlam + (Hz + c Bz)^T dkappa) = r,   Bz A dw = -rows_0,   B (c M + C) dw + B B^T dkappa = -rows_1

    dw, r (nodes, 2): S^-1 r of the plates, and r. rows (2, m). w, z: workspaces of the system and of the transposed one; `transpose_blocks` has
    copied the blocks.
    """
    b, y, m = z.border, z.workspace, rows.shape[1]
    joints.point_values(s, dw, z.displacements)
    momenta_at_points(c, cm, cr, c_v, r, z.rate_forces)
    for n in range(w.border.block.shape[0] - 1):  # c A A^T m A dw
        wide, points = width(b, n), b.points[b.point_start[n] : b.point_start[n + 1]]
        size = wide // 2
        for q in range(size):
            mass = s.point_mass[points[q // 2]]
            if mass != 0.0:
                for p in range(size):
                    across = -y.blocks[b.block[n] + p * wide + q]
                    z.rate_forces[points[p // 2], p % 2] += c_v * mass * across * z.displacements[points[q // 2], q % 2]
    measure(b, y, z.rate_forces, z.displacements)
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
def momenta_at_points(c, cm, cr, c_v, r, out):
    """out = A (c M + C) S^-1 r of the plates, by the columns of `mass_columns`."""
    for f in range(out.shape[0]):
        first, end, at = c.place[f, 0], c.place[f, 1], c.place[f, 2]
        size, p, q = end - first, 0.0 * c_v, 0.0 * c_v
        for i in range(size):
            co, si, x, y = cr.turn[first + i, 0], cr.turn[first + i, 1], r[first + i, 0], r[first + i, 1]
            x, y = co * x + si * y, co * y - si * x
            p += cm.compliance_columns[at + i, 0] * x + cm.compliance_columns[at + i, 1] * y
            q += cm.compliance_columns[at + size + i, 0] * x + cm.compliance_columns[at + size + i, 1] * y
        co, si = cr.spin[f, 0], cr.spin[f, 1]
        out[f, 0], out[f, 1] = c_v * (co * p - si * q), c_v * (si * p + co * q)
