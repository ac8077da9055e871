"""Corrections with the stale co-rotated factor of one state: what its frames give is made once a state, not once a solve."""

import numpy as np

from polyida.adjoint.scene.products import DZ
from polyida.assembly.corotated import add_masses, close, hold_border, solve_in_place, turn_frames
from polyida.jit import part

LEAST = 1e-280  # a residual below that is taken as that large: single precision, in which b is, ends at 1e-38


@part
def hold(s, c, room, drives, to_a, to_v, x):
    """Frames, rows and curvature of the state that x holds, `S^T` on the points among them. The rotations must be there."""
    turn_frames(s, c, room, x.rotation)
    hold_border(s, c, room, drives, x.points[DZ])
    curvature, mirror = room.border.curvature, s.coupling.mirror
    for k in range(mirror.shape[0]):
        for i in range(2):
            for j in range(2):
                curvature[k, i, j] = x.curvature[mirror[k], j, i]
                if x.slack.shape[0]:
                    curvature[k, i, j] += to_v * x.slack[mirror[k], j, i]
    add_masses(s, to_a, curvature)


@part
def correct(s, c, room, r, phi, dq, dlam):
    """Fill dq (nodes, 2) and dlam of `S dq + B^T dlam = -r`, `B dq = -phi`: the sum of |S^-1 r|, or less than zero where singular."""
    order, b, turn, size, free = c.factor.order, room.x, room.turn, LEAST, 0.0
    for i in range(r.shape[0]):
        size = max(size, abs(r[i, 0]), abs(r[i, 1]))
    for i in range(r.shape[0]):
        p, q = r[i, 0] / size, r[i, 1] / size
        b[order[2 * i]] = -(turn[i, 0] * p + turn[i, 1] * q)
        b[order[2 * i + 1]] = -(turn[i, 0] * q - turn[i, 1] * p)
    for k in range(2 * r.shape[0], b.shape[0]):
        b[k] = np.float32(0.0)
    solve_in_place(c.factor, room.team, b)
    for i in range(r.shape[0]):
        dq[i, 0], dq[i, 1] = size * b[order[2 * i]], size * b[order[2 * i + 1]]
        free += abs(dq[i, 0]) + abs(dq[i, 1])
    if room.border.x.shape[0]:
        move_points(s, turn, dq, room.moved)
        if not close(s, c, room, phi, dlam):
            return -1.0
        pull_points(c, room, dq)
    for i in range(r.shape[0]):
        p, q = dq[i, 0], dq[i, 1]
        dq[i, 0] = turn[i, 0] * p - turn[i, 1] * q
        dq[i, 1] = turn[i, 1] * p + turn[i, 0] * q
    return free


@part
def move_points(s, turn, y, moved):
    """moved = A y of y in the factor's frame."""
    for f in range(moved.shape[0]):
        moved[f, 0] = moved[f, 1] = 0.0
        for k in range(s.point_ptr[f], s.point_ptr[f + 1]):
            c, n, i = s.point_weights[k, 0], s.point_weights[k, 1], s.point_nodes[k]
            p = turn[i, 0] * y[i, 0] - turn[i, 1] * y[i, 1]
            q = turn[i, 1] * y[i, 0] + turn[i, 0] * y[i, 1]
            moved[f, 0] += c * p - n * q
            moved[f, 1] += c * q + n * p


@part
def pull_points(c, room, y):
    """y -= X pull, both in the factor's frame."""
    for f in range(room.spin.shape[0]):
        co, si = room.spin[f, 0], room.spin[f, 1]
        x, y_ = room.pull[2 * f], room.pull[2 * f + 1]
        p, q = co * x + si * y_, co * y_ - si * x
        if p == 0.0 and q == 0.0:
            continue
        first, size, at = c.place[f, 0], c.place[f, 1] - c.place[f, 0], c.place[f, 2]
        for e in range(size):
            for k in range(2):
                y[first + e, k] -= c.reach[at + e, k] * p + c.reach[at + size + e, k] * q
