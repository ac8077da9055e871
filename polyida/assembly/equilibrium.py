"""Residual `r = M a + g + phi_q^T lam`, constraints, tangent, energy and damping of a scene in compiled code."""

import numpy as np

from polyida.assembly import reduced_kernels
from polyida.assembly.arrays import INDICES, INDPTR, PAIRS, cells_of, material_of
from polyida.assembly.joints import joint_forces, point_values, slip_forces, spread
from polyida.assembly.relaxation import add_relaxed_blocks, stiffness_changes
from polyida.element import kernels, viscous_midpoint
from polyida.element.operator import Blocks
from polyida.jit import entry, leaf, part, shared
from polyida.jit.intrinsics import call, float_of
from polyida.linear.dense import clear


@leaf
def on_pattern(plates, operator, values):
    """indptr and indices of the nodes' pattern of an operator, and the values on it."""
    first, end = plates.at[operator], plates.at[operator + 1]
    indptr, indices = plates.indptr[first[INDPTR] : end[INDPTR]], plates.indices[first[INDICES] : end[INDICES]]
    return indptr, indices, values[first[INDICES] : end[INDICES]]


@shared
def equilibrium(scene, drives, moved, a, lam, residual, phi, rotation, dz, forces):
    """Fill residual (nodes, 2), phi (m,), rotation (nodes, 2), dz and forces (points, 2) at the displacements `moved`, accelerations a, multipliers lam.

    rotation: area-weighted sums of (F11 + F22, F21 - F12), in the direction of the nodal rotation, or the vector of a body's frame; pass
    (0, 2) to skip it. Returns (least det F of all elements, least cosine of a motor's angle error); det F is nan if moved is not finite.
    """
    s, links, x = scene.plates, scene.links, scene.relaxation
    condensed = x.condensed[0] != 0
    for i in range(residual.shape[0]):
        residual[i, 0], residual[i, 1] = -s.weight[i, 0], -s.weight[i, 1]
    clear(rotation)
    least = 1e300
    for b in range(s.body_operator.shape[0]):
        o, n0 = s.body_operator[b], s.body_node[b]
        if condensed and x.terms[b] < x.terms[b + 1]:
            det = float_of(call(x.condensed[1], (x.condensed[0], b, moved, residual, rotation)))
        else:
            det = kernels.internal_force(cells_of(s, b), material_of(s, b), moved, residual, rotation)
        least = reduced_kernels.lesser(least, det)
        kernels.mass_product(*on_pattern(s, o, s.mass), s.body_density[b], n0, a, residual)
        if s.body_stabilisation[b] != 0.0:
            kernels.stabilisation_force(*on_pattern(s, o, s.stabilisation), s.body_stabilisation[b], n0, moved, residual)
    least = reduced_kernels.lesser(least, reduced_kernels.forces(scene.reduced, moved, a, residual, rotation))
    hold_strains(x, a, residual, rotation)
    return least, add_loads_and_joints(s, links, drives, moved, a, lam, phi, dz, forces, residual)


@part
def add_loads_and_joints(plates, links, drives, moved, a, lam, phi, dz, forces, residual):
    """Add loads, and forces of the joints and masses at points to residual; fill phi, dz and forces. Returns what `joint_forces` returns."""
    for k in range(plates.load_drive.shape[0]):
        factor = drives[plates.load_drive[k], 0]
        for i in range(plates.load_ptr[k], plates.load_ptr[k + 1]):
            residual[plates.load_nodes[i], 0] -= factor * plates.load_values[i, 0]
            residual[plates.load_nodes[i], 1] -= factor * plates.load_values[i, 1]
    point_values(links, a, dz)
    for f in range(dz.shape[0]):
        forces[f, 0] = links.point_mass[f] * (dz[f, 0] - links.gravity[0])
        forces[f, 1] = links.point_mass[f] * (dz[f, 1] - links.gravity[1])
    point_values(links, moved, dz)
    cosine = joint_forces(links, drives, dz, lam, phi, forces)
    slip_forces(links.slips, drives, dz, lam, forces)
    spread(links, forces, residual)
    return cosine


@part
def hold_strains(relaxation, a, residual, rotation):
    """Add the inertia of the relaxed strains to residual, and set their frames."""
    for i in range(relaxation.first, residual.shape[0]):
        residual[i, 0] += relaxation.mass * a[i, 0]
        residual[i, 1] += relaxation.mass * a[i, 1]
    for i in range(relaxation.first, rotation.shape[0]):
        rotation[i, 0] = 1.0


@entry
def tangent_blocks(scene, moved, v, c_m, c_v, c_q, blocks):
    """Fill blocks (nnz, 2, 2) = `c_m M + c_v dg/dv + c_q dg/dq` of the bodies on their pattern, without masses at points and joints.

    v: velocities (nodes, 2), or None without damping; dg/dq is symmetric only for v = 0.
    """
    s = scene.plates
    blocks[:] = 0.0
    for b in range(s.body_operator.shape[0]):
        o, block = s.body_operator[b], s.body_block[b]
        first, end = s.at[o], s.at[o + 1]
        own = Blocks(s.pairs[first[PAIRS] : end[PAIRS]], block, blocks)
        if v is not None:
            viscous_midpoint.tangent_viscous(cells_of(s, b), own, material_of(s, b), moved, v, c_q, c_v)
        elif c_q != 0.0:
            kernels.tangent(cells_of(s, b), own, material_of(s, b), moved, c_q)
        mass, stiffness = (c_m + c_v * s.body_drag[b]) * s.body_density[b], c_q * s.body_stabilisation[b]
        if mass != 0.0 or stiffness != 0.0:
            for k in range(end[INDICES] - first[INDICES]):
                value = mass * s.mass[first[INDICES] + k] + stiffness * s.stabilisation[first[INDICES] + k]
                blocks[block + k, 0, 0] += value
                blocks[block + k, 1, 1] += value
    reduced_kernels.blocks(scene.reduced, moved, moved if v is None else v, c_m, c_v, c_q, blocks)


@entry
def strain_energy(scene, moved):
    """Elastic energy of all bodies, J."""
    s, total = scene.plates, reduced_kernels.energy(scene.reduced, moved)
    for b in range(s.body_operator.shape[0]):
        o = s.body_operator[b]
        total += kernels.strain_energy(cells_of(s, b), material_of(s, b), moved)
        if s.body_stabilisation[b] != 0.0:
            total += kernels.stabilisation_energy(*on_pattern(s, o, s.stabilisation), s.body_stabilisation[b], s.body_node[b], moved)
    return total


@entry
def momentum(scene, a, residual):
    """residual += M a without the masses at points."""
    s = scene.plates
    reduced_kernels.momentum(scene.reduced, a, residual)
    hold_strains(scene.relaxation, a, residual, residual[:0])
    for b in range(s.body_operator.shape[0]):
        o = s.body_operator[b]
        kernels.mass_product(*on_pattern(s, o, s.mass), s.body_density[b], s.body_node[b], a, residual)


def symmetric_parts(model, q, v):
    """(K (nnz, 2, 2), C or None without damping, real and imaginary part (nnz,) of the complex numbers in M's blocks, None if all are real,
    the part of K that relaxation scales, or None), those of zero velocity."""
    u, still = q.reshape(-1, 2), _still(model, v)
    K, M = blocks_at(model, u, still, 0.0, 0.0, 1.0), blocks_at(model, u, still, 1.0, 0.0, 0.0)
    C = blocks_at(model, u, still, 0.0, 1.0, 0.0) if model.damped else None
    relaxing = np.zeros_like(K) if model.strains else None
    if relaxing is not None:
        for sign in (1.0, -1.0):
            add_relaxed_blocks(model.arrays, u, still, np.full(len(model.arrays.relaxation.terms) - 1, 0.5 * sign), sign, relaxing)
    return K, C, M[:, 0, 0].copy(), M[:, 1, 0].copy() if M[:, 1, 0].any() else None, relaxing


def step_blocks(model, q, v, c_m, c_v):
    """Blocks of `c_m M + c_v C + K`, C and K those of zero velocity; real."""
    changes = stiffness_changes(model, c_m / c_v if c_v else np.inf) if model.strains else None
    return blocks_at(model, q.reshape(-1, 2), _still(model, v), c_m, c_v, 1.0, changes)


def _still(model, v):
    """Velocities (nodes, 2) without those of the nodes."""
    still = np.zeros((model.n_nodes, 2))
    still[model.n_factored :] = v.reshape(-1, 2)[model.n_factored :]
    return still


def blocks_at(model, u, v, c_m, c_v, c_q, changes=None):
    """`tangent_blocks` of a scene at u and v (nodes, 2); changes (bodies,): kappa - 1 of viscoelastic plates, zero by default."""
    blocks = np.empty((len(model.pattern[1]), 2, 2))
    tangent_blocks(model.arrays, u, v if model.damped else None, c_m, c_v, c_q, blocks)
    if model.strains and c_q:
        add_relaxed_blocks(
            model.arrays, u, v, np.zeros(len(model.arrays.relaxation.terms) - 1) if changes is None else changes, c_q, blocks
        )
    return blocks


def combined(model, c_m, c_v, K, C, m, across, relaxing):
    """Blocks of `c_m M + c_v C + K` from symmetric_parts."""
    blocks = K + c_v * (0.0 if C is None else C)
    for i in range(2):
        blocks[:, i, i] += c_m * m
    if across is not None:
        blocks[:, 0, 1] -= c_m * across
        blocks[:, 1, 0] += c_m * across
    if relaxing is not None:
        changes, s = stiffness_changes(model, c_m / c_v), model.arrays
        first = np.concatenate([s.plates.body_block[:-1], s.reduced.block])[: len(changes) + 1]
        blocks[: first[-1]] += np.repeat(changes, np.diff(first))[:, None, None] * relaxing[: first[-1]]
    return blocks


@entry
def add_damping(scene, moved, v, elastic, residual):
    """residual (nodes, 2) += damping forces of all bodies; elastic (nodes, 2) is workspace."""
    s = scene.plates
    reduced_kernels.add_damping(scene.reduced, moved, v, residual)
    for b in range(s.body_operator.shape[0]):
        o, n0 = s.body_operator[b], s.body_node[b]
        if s.body_drag[b] != 0.0:
            kernels.mass_product(*on_pattern(s, o, s.mass), s.body_drag[b] * s.body_density[b], n0, v, residual)
        if s.body_viscosity[b] == 0.0:
            continue
        none = elastic[:0]
        elastic[:] = 0.0
        kernels.internal_force(cells_of(s, b), material_of(s, b), moved, elastic, none)
        for i in range(n0, s.body_node[b + 1]):
            residual[i, 0] -= elastic[i, 0]
            residual[i, 1] -= elastic[i, 1]
        viscous_midpoint.internal_force_viscous(cells_of(s, b), material_of(s, b), moved, v, residual, none)
