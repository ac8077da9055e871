"""Velocities of an energy-momentum step on their own constraint, at no cost of energy (Gonzalez, Physica D 132 (1999) 165-174).

`phi(q_1, t_1) = 0` alone leaves `v_1 = 2 (q_1 - q_0)/h - v_0` off `psi = phi_q v + phi_t = 0` by as much as v_0 was, with the sign
changed: what a motor's jerk puts there alternates for ever, and shows in lam divided by h. With mu of the size of h^2,
`q_1 - q_0 = h (v_m + M^-1 B^T mu)`, `M (v_1 - v_0)/h + f + B^T lam + (B^T mu)_q v_m = 0`, `v_m = (v_0 + v_1)/2`,
psi is 0 at t_1 too, B being phi_q of the mean q and time. As phi is bilinear, both brackets are discrete derivatives of phi and psi:
while no motor moves, the energy changes by `-lam . (phi_1 - phi_0) - mu . (psi_1 - psi_0) = 0`. With `w = 2 (q_1 - q_0)/h - v_0` in
place of v_1 the first term takes up `2 B^T mu / h`: a step finds q_1 and `lam - 2 mu / h`.
"""

from typing import NamedTuple

import numpy as np

from polyida.assembly import joints
from polyida.assembly.mass_system import point_columns
from polyida.compiled import entry, part
from polyida.linear.corotated import row_columns
from polyida.linear.dense import solve_small


class Hold(NamedTuple):
    """mu (m,), `push = phi_z^T mu` and `flow = A v_m` at the points; M^-1 A^T and A M^-1 A^T of one direction; scratch.

    mu has no entries where phi does not depend on t: psi is zero then without it, for phi is linear.
    """

    reach: np.ndarray
    g: np.ndarray
    columns: np.ndarray
    mu: np.ndarray
    push: np.ndarray
    flow: np.ndarray
    z0: np.ndarray
    z1: np.ndarray
    vz: np.ndarray
    middle: np.ndarray
    end: np.ndarray
    moved: np.ndarray
    matrix: np.ndarray
    bias: np.ndarray
    last: np.ndarray


def hold(model):
    """The Hold of a scene."""
    m, points = model.m if model.needs.driven else 0, (model.n_points, 2)
    columns = row_columns(model.arrays.links, model.m)[:m]
    rows, moved = (m, 2 * model.n_points), (2 * model.n_points, m)
    scratch = map(np.zeros, (m, points, points, points, points, points, rows, rows, moved, (m, m), m))
    return Hold(*model.once(point_columns), columns, *scratch, np.zeros(m, np.int64))


@entry
def hold_velocity(s, before, after, h, u0, v0, u1, y):
    """Fill y.mu, y.push and y.flow for the step to u1; before, after: drives at its middle and end. False where that is singular."""
    joints.point_values(s, u0, y.z0)
    joints.point_values(s, u1, y.z1)
    joints.point_values(s, v0, y.vz)
    for f in range(y.vz.shape[0]):
        for k in range(2):
            y.flow[f, k] = (y.z1[f, k] - y.z0[f, k]) / h
            y.vz[f, k] = 2.0 * y.flow[f, k] - y.vz[f, k]
            y.z0[f, k] = 0.5 * (y.z0[f, k] + y.z1[f, k])
    joints.joint_jacobian(s, before, y.z0, y.middle)
    joints.joint_jacobian(s, after, y.z1, y.end)
    joints.joint_rates(s, after, y.z1, y.vz, y.mu, y.bias)
    joints.joint_velocities(s, after, y.z1, y.vz, y.mu)
    fill_matrix(y)
    if not solve_small(y.matrix, y.mu, y.last):
        return False
    y.push[:] = 0.0
    for k in range(y.mu.shape[0]):
        for j in y.columns[k]:
            if j >= 0:
                y.push[j // 2, j % 2] += y.middle[k, j] * y.mu[k]
        for i in range(y.moved.shape[0]):
            y.flow[i // 2, i % 2] -= y.moved[i, k] * y.mu[k]
    return True


@part
def fill_matrix(y):
    """y.moved = `A M^-1 B^T`, y.matrix = twice phi_z of the end times it."""
    y.moved[:] = 0.0
    for k in range(y.mu.shape[0]):
        for j in y.columns[k]:
            if j >= 0:
                for f in range(y.g.shape[0]):
                    y.moved[2 * f + j % 2, k] += y.g[f, j // 2] * y.middle[k, j]
    for k in range(y.mu.shape[0]):
        for e in range(y.mu.shape[0]):
            total = 0.0
            for j in y.columns[k]:
                if j >= 0:
                    total += y.end[k, j] * y.moved[j, e]
            y.matrix[k, e] = 2.0 * total


@part
def bend(s, before, y, forces):
    """forces += `(phi_z^T mu)_z flow`, of the motors between bodies."""
    for j in range(s.joint_kind.shape[0]):
        a, b = s.joint_a[j], s.joint_b[j]
        if s.joint_kind[j] == joints.MOTOR and a >= 0 and b >= 0:
            c, n = joints.turn(s, j, before)
            g = y.mu[s.joint_row[j]]
            forces[a, 0] += g * (c * y.flow[b, 1] - n * y.flow[b, 0])
            forces[a, 1] -= g * (c * y.flow[b, 0] + n * y.flow[b, 1])
            forces[b, 0] -= g * (n * y.flow[a, 0] + c * y.flow[a, 1])
            forces[b, 1] += g * (c * y.flow[a, 0] - n * y.flow[a, 1])
