"""The collocation equations of a scene in compiled code: residuals of all stages, and the step's end."""

from typing import NamedTuple

import numpy as np

from polyida.assembly import equilibrium as kernels
from polyida.assembly.bodies.damping import add_damping
from polyida.assembly.own.laws import add_own_forces
from polyida.assembly.rows import joints
from polyida.assembly.rows.tie import project
from polyida.integrate.stepping.ended import DONE, HALF_TURN, INVERTED, NOT_FINITE
from polyida.jit import entry, pack, part
from polyida.linear.dense import clear

Q, V, SHARES, A, MOVE, SPEED = range(6)  # rows of Room.past
START, VX, DX, DV = range(4)  # rows of Room.points


@pack
class Way(NamedTuple):
    """A tableau for compiled code: c, W, `start`, rows and columns of the real mode (s,), or none of them, and of the complex pair."""

    c: np.ndarray
    W: np.ndarray
    start: np.ndarray
    real_row: np.ndarray
    real_column: np.ndarray
    pair_row: np.ndarray
    pair_column: np.ndarray


def way(tableau):
    """The Way of a Tableau."""
    modes = {mode.paired: mode for mode in tableau.modes}
    real, pair = modes.get(False), modes[True]
    rows = (np.zeros(0), np.zeros(0)) if real is None else (real.row.copy(), real.column.copy())
    return Way(tableau.c, tableau.W, tableau.start, *rows, pair.row.copy(), pair.column.copy())


@pack
class Room(NamedTuple):
    """Scratch of a scene and s stages.

    past (6, n): q, v, shares, the last v' and scratch; closed (2, m): phi and phi' at the step's start; r, rotation and turn (s, nodes, 2);
    points (4, points, 2); vz (points, 2): velocities in the middle stage; dz (s, points, 2); rows (2, s, m): phi and phi'. Of the modes:
    right-hand sides and corrections; closing (2, m), multipliers (2, m): of phi and phi', lam and mu.
    """

    past: np.ndarray
    closed: np.ndarray
    r: np.ndarray
    rotation: np.ndarray
    turn: np.ndarray
    points: np.ndarray
    forces: np.ndarray
    vz: np.ndarray
    dz: np.ndarray
    rows: np.ndarray
    right: np.ndarray
    dq: np.ndarray
    closing: np.ndarray
    multipliers: np.ndarray
    right_pair: np.ndarray
    dq_pair: np.ndarray
    closing_pair: np.ndarray
    multipliers_pair: np.ndarray


def room(model, stages):
    """The Room of a scene."""
    nodes, points, m = (model.n_nodes, 2), (model.n_points, 2), model.m
    stage, modal = [(stages, *nodes)] * 3, (nodes, nodes, (2, m), (2, m))
    shapes = ((6, model.n), (2, m), *stage, (4, *points), points, points, (stages, *points), (2, stages, m), *modal)
    return Room(*map(np.zeros, shapes), *(np.zeros(shape, complex) for shape in modal))


@part
def pairs(row):
    """A row (n,) as (nodes, 2)."""
    return row.reshape((row.shape[0] // 2, 2))


@part
def place(t, h, x, w, k):
    """q and v of stage k, in MOVE and SPEED."""
    c, past = t.c[k] * h, w.past
    for i in range(past.shape[1]):
        past[MOVE, i] = past[Q, i] + (c * past[V, i] + x.e[k, i])
        past[SPEED, i] = past[V, i] + x.dv[k, i]


@part
def through(W, h, x, rates):
    """rates = W x / h, (s, n) each."""
    for k in range(x.shape[0]):
        row, first, weight = rates[k], x[0], W[k, 0] / h
        for i in range(row.shape[0]):
            row[i] = weight * first[i]
        for j in range(1, x.shape[0]):
            other, weight = x[j], W[k, j] / h
            for i in range(row.shape[0]):
                row[i] += weight * other[i]


@part
def follow(s, t, h, drives, x, w):
    """v and v' of the stages from e and mu."""
    through(t.W, h, x.e, x.dv)
    if x.mu.shape[1]:
        for k in range(x.e.shape[0]):
            place(t, h, x, w, k)
            joints.point_values(s.links, pairs(w.past[MOVE]), w.dz[k])
            clear(w.forces)
            joints.joint_forces(s.links, drives[k + 1], w.dz[k], x.mu[k], w.rows[0, k], w.forces)
            joints.spread(s.links, w.forces, pairs(x.dv[k]))
    through(t.W, h, x.dv, x.a)


@part
def carry(s, t, h, drives, gains, x, w, k):
    """phi and phi' of stage k from those at the start and what the step adds."""
    phi, rate = w.rows[0, k], w.rows[1, k]
    for i in range(phi.shape[0]):
        phi[i], rate[i] = w.closed[0, i], w.closed[1, i]
    joints.point_values(s.links, pairs(x.e[k]), w.points[DX])
    joints.point_values(s.links, pairs(x.dv[k]), w.points[DV])
    joints.joint_change(s.links, drives[0], gains[k], t.c[k] * h, w.points[START], w.points[VX], w.points[DX], w.points[DV], phi, rate)


@entry
def begin(s, q, v, phi, rate, w):
    """Take up the state that a step begins from."""
    for i in range(q.shape[0]):
        w.past[Q, i], w.past[V, i] = q[i], v[i]
    for k in range(phi.shape[0]):
        w.closed[0, k], w.closed[1, k] = phi[k], rate[k]
    joints.point_values(s.links, pairs(w.past[Q]), w.points[START])
    joints.point_values(s.links, pairs(w.past[V]), w.points[VX])


@entry
def close(s, t, h, drives, gains, enough, moves_v, y, x, w):
    """v and v' of the stages; phi and phi' of the last, the step's end, which is moved onto phi = 0 and, moves_v, onto phi' = 0.

    enough: |phi| that is round-off. y: the scene's Tie, or None without constraints. False where that is singular.
    """
    follow(s, t, h, drives, x, w)
    if y is None:
        return True
    k = x.e.shape[0] - 1
    carry(s, t, h, drives, gains, x, w, k)
    phi, rate, good = w.rows[0, k], w.rows[1, k], True
    off_q, off_v = largest(phi) > enough, moves_v and largest(rate) > 0.0
    if off_q or off_v:
        place(t, h, x, w, k)
        joints.point_values(s.links, pairs(w.past[MOVE]), w.dz[k])
        joints.joint_jacobian(s.links, drives[k + 1], w.dz[k], y.slopes)
    if off_q:
        good = project(s.links, y, phi, pairs(x.e[k]))
        carry(s, t, h, drives, gains, x, w, k)
    if good and off_v:
        good = project(s.links, y, rate, pairs(x.dv[k]))
        carry(s, t, h, drives, gains, x, w, k)
    return good


@part
def largest(x):
    """max |x|."""
    found = 0.0
    for k in range(x.shape[0]):
        found = max(found, abs(x[k]))
    return found


@part
def residuals(s, t, h, damp, laws, drives, gains, x, w):
    """r, phi and phi' of all stages. Returns how it ended."""
    follow(s, t, h, drives, x, w)
    for k in range(x.e.shape[0]):
        place(t, h, x, w, k)
        u, v, r = pairs(w.past[MOVE]), pairs(w.past[SPEED]), w.r[k]
        det, cosine = kernels.equilibrium(s, drives[k + 1], u, pairs(x.a[k]), x.lam[k], r, w.rows[0, k], w.rotation[k], w.dz[k], w.forces)
        if not det > 0.0:
            return INVERTED if det <= 0.0 else NOT_FINITE
        if not cosine > 0.0:
            return HALF_TURN
        if damp is not None:
            add_damping(s, u, v, damp, r)
        if laws is not None:
            add_own_forces(laws, s.links, drives[k + 1], u, v, r)
        carry(s, t, h, drives, gains, x, w, k)
        if k == x.e.shape[0] // 2:
            joints.point_values(s.links, v, w.vz)
    return DONE
