"""Moves along M^-1 phi_q^T in compiled code: of positions onto phi = 0, of velocities onto `phi_q v + phi_t = 0`."""

from typing import NamedTuple

import numpy as np

from polyida.assembly.rows import joints
from polyida.assembly.rows.mass_system import point_columns
from polyida.jit import pack, part
from polyida.linear.dense import solve_small


@pack
class Tie(NamedTuple):
    """M^-1 A^T, real parts (pairs, points) of complex numbers and imaginary ones, (0, points) where there are none, A M^-1 A^T
    (2 points, 2 points), and scratch; slip (pairs, 2): what eta has added to q in a step.
    """

    reach: np.ndarray
    across: np.ndarray
    g: np.ndarray
    matrix: np.ndarray
    eta: np.ndarray
    last: np.ndarray
    rate: np.ndarray
    bias: np.ndarray
    slopes: np.ndarray
    vz: np.ndarray
    pull: np.ndarray
    slip: np.ndarray


def tie(model):
    """The Tie of a scene."""
    points, m = model.n_points, model.m
    shapes = ((m, m), m, m, m, len(model.arrays.links.row_columns), (points, 2), (points, 2))
    matrix, eta, rate, bias, slopes, vz, pull = map(np.empty, shapes)
    slip = np.zeros((model.n_nodes, 2))
    return Tie(*model.once(point_columns), matrix, eta, np.empty(m, np.int64), rate, bias, slopes, vz, pull, slip)


@part
def velocity_rate(s, drives, dz, v, t):
    """t.rate = phi_q v + phi_t; t.slopes with it."""
    joints.point_values(s, v, t.vz)
    joints.joint_rates(s, drives, dz, t.vz, t.eta, t.rate, t.bias)
    joints.joint_jacobian(s, drives, dz, t.slopes)


@part
def project(s, t, wanted, x):
    """x -= M^-1 phi_q^T eta with `phi_q M^-1 phi_q^T eta = wanted`. False where that is singular."""
    m = wanted.shape[0]
    for i in range(m):
        t.eta[i] = wanted[i]
        for j in range(m):
            t.matrix[i, j] = 0.0
            for e in range(s.row_start[i], s.row_start[i + 1]):
                p = s.row_columns[e]
                for o in range(s.row_start[j], s.row_start[j + 1]):
                    q = s.row_columns[o]
                    t.matrix[i, j] += t.slopes[e] * t.g[p, q] * t.slopes[o]
    if not solve_small(t.matrix, t.eta, t.last):
        return False
    t.pull[:] = 0.0
    for i in range(m):
        for e in range(s.row_start[i], s.row_start[i + 1]):
            p = s.row_columns[e]
            t.pull[p // 2, p % 2] += t.slopes[e] * t.eta[i]
    for f in range(t.pull.shape[0]):
        px, py = t.pull[f, 0], t.pull[f, 1]
        if px != 0.0 or py != 0.0:
            for i in range(x.shape[0]):
                x[i, 0] -= t.reach[i, f] * px
                x[i, 1] -= t.reach[i, f] * py
            for i in range(t.across.shape[0]):
                x[i, 0] += t.across[i, f] * py
                x[i, 1] -= t.across[i, f] * px
    return True
