"""Newton's corrections of a scene's stages in compiled code: one real and one complex solve for all of them.

The factors are made in the frame of the nodes, and each stage has a frame of its own: its residual is turned from there to the middle
stage's, R(q_k) R(q_i)^T node by node, and the correction that comes back is turned the other way.
"""

from functools import partial
from typing import NamedTuple

import numpy as np

from polyida.assembly import corotated
from polyida.assembly import equilibrium as kernels
from polyida.assembly.bodies.damping import add_damping
from polyida.assembly.rows import joints
from polyida.assembly.stabilised_border import StabilisedRoom, stabilised_border
from polyida.integrate.radau.scene.stages import DX, MOVE, SHARES, SPEED, A, Q, pairs, residuals, through
from polyida.integrate.stepping.ended import DONE, SINGULAR
from polyida.jit import entry, pack, part
from polyida.linear.dense import clear

fast = partial(part, fastmath={"contract", "reassoc", "nsz"})


@pack
class Solver(NamedTuple):
    """What kernels take of the factored matrix of a mode; c (1,): its own; massive, border: of the border with mu, or None."""

    c: np.ndarray
    factored: corotated.Corotated
    room: corotated.Room
    massive: corotated.Corotated | None
    border: StabilisedRoom | None


@part
def turn_in(t, w):
    """The modes' residuals, turned into the frame of the middle stage."""
    stages = w.r.shape[0]
    for k in range(stages):
        turn_to(w.rotation[k], w.rotation[stages // 2], w.turn[k], w.r[k])
    for i in range(w.right.shape[0]):
        for a in range(2):
            w.right[i, a], w.right_pair[i, a] = 0.0, 0.0
    for k in range(stages):
        row, pair = t.real_row[k] if t.real_row.shape[0] else 0.0, t.pair_row[k]
        for i in range(w.right.shape[0]):
            for a in range(2):
                w.right[i, a] += row * w.r[k, i, a]
                w.right_pair[i, a] += pair * w.r[k, i, a]
    for f in range(2):
        for e in range(w.closing.shape[1]):
            w.closing[f, e], w.closing_pair[f, e] = 0.0, 0.0
            for k in range(stages):
                if t.real_row.shape[0]:
                    w.closing[f, e] += t.real_row[k] * w.rows[f, k, e]
                w.closing_pair[f, e] += t.pair_row[k] * w.rows[f, k, e]


@fast
def turn_to(own, middle, turn, r):
    """turn (nodes, 2): cosine and sine of the nodes' way from their rotation in a stage to that in the middle one; r goes it."""
    for i in range(r.shape[0]):
        mx, my, x, y = middle[i, 0], middle[i, 1], own[i, 0], own[i, 1]
        size = 1.0 / np.sqrt((mx * mx + my * my) * (x * x + y * y))
        c, n = (mx * x + my * y) * size, (my * x - mx * y) * size
        p, q = r[i, 0], r[i, 1]
        turn[i, 0], turn[i, 1] = c, n
        r[i, 0], r[i, 1] = c * p - n * q, n * p + c * q


@part
def turn_out(t, x, w):
    """Add the modes' corrections to the stages, each turned into its frame. Returns the mean square of dq and h dv, by mass."""
    stages = x.e.shape[0]
    for k in range(stages):
        turn_back(t.real_column[k] if t.real_row.shape[0] else 0.0, 2.0 * t.pair_column[k], w.turn[k], w, w.r[k], pairs(x.e[k]))
    moved = w.r.reshape(x.e.shape)
    through(t.W, 1.0, moved, x.dv)
    add_multipliers(t, w, 0, x.lam)
    add_multipliers(t, w, 1, x.mu)
    total = 0.0
    for k in range(stages):
        total += square(w.past[SHARES], moved[k]) + square(w.past[SHARES], x.dv[k])
    return total / stages


@fast
def turn_back(real, pair, turn, w, dq, e):
    """dq (nodes, 2) of a stage from those of the modes; added to e."""
    re, im = pair.real, pair.imag
    for i in range(dq.shape[0]):
        p = real * w.dq[i, 0] + re * w.dq_pair[i, 0].real - im * w.dq_pair[i, 0].imag
        q = real * w.dq[i, 1] + re * w.dq_pair[i, 1].real - im * w.dq_pair[i, 1].imag
        c, n = turn[i, 0], turn[i, 1]
        dq[i, 0], dq[i, 1] = c * p + n * q, c * q - n * p
        e[i, 0] += dq[i, 0]
        e[i, 1] += dq[i, 1]


@fast
def square(shares, x):
    """The sum of shares x^2."""
    total = 0.0
    for i in range(x.shape[0]):
        total += shares[i] * x[i] * x[i]
    return total


@part
def add_multipliers(t, w, f, lam):
    """Add the modes' multipliers of one kind to those of the stages."""
    for k in range(lam.shape[0]):
        for e in range(lam.shape[1]):
            lam[k, e] += 2.0 * (t.pair_column[k] * w.multipliers_pair[f, e]).real
            if t.real_row.shape[0]:
                lam[k, e] += t.real_column[k] * w.multipliers[f, e]


@part
def solve_mode(s, c, room, massive, border, c_v, drives, x, w, r, closing, dq, multipliers):
    """dq and multipliers of one mode from its residuals, rows and curvature those of the middle stage. False where it is singular."""
    k = x.e.shape[0] // 2
    at, rotation, dz, lam = drives[k + 1], w.rotation[k], w.dz[k], x.lam[k]
    if massive is None:
        return corotated.solve(s.links, c, room, at, rotation, dz, lam, r, closing[0], c_v * c_v, dq, multipliers[0])
    corotated.solve_plates(s.links, c, room, rotation, r, dq)
    for i in range(dq.shape[0]):
        dq[i, 0], dq[i, 1] = -dq[i, 0], -dq[i, 1]
    for f in range(2):
        for e in range(closing.shape[1]):
            closing[f, e] = -closing[f, e]
    return stabilised_border(
        s.links, c, massive, room, border, at, dz, w.vz, lam, c_v, dq, None, closing[0], closing[1], multipliers[0], multipliers[1]
    )


@part
def solve_real(s, real, drives, x, w):
    """The real mode's corrections. False where it is singular."""
    given = w.right, w.closing, w.dq, w.multipliers
    return solve_mode(s, real.factored, real.room, real.massive, real.border, real.c[0], drives, x, w, *given)


@part
def solve_pair(s, pair, drives, x, w):
    """The same of the complex pair."""
    given = w.right_pair, w.closing_pair, w.dq_pair, w.multipliers_pair
    return solve_mode(s, pair.factored, pair.room, pair.massive, pair.border, pair.c[0], drives, x, w, *given)


@entry
def iterate(s, t, h, real, pair, damp, laws, drives, gains, x, w):
    """One Newton iteration on the trial stages: (how it ended, |dq|).

    real, pair: their Solver, real None where there is no real mode. damp: scratch of a damped scene, or None; laws: of force elements, or
    None. drives (s + 1, profiles, 3): of the step's start and the stages.
    """
    ended = residuals(s, t, h, damp, laws, drives, gains, x, w)
    if ended != DONE:
        return ended, 0.0
    turn_in(t, w)
    if real is not None and not solve_real(s, real, drives, x, w):
        return SINGULAR, 0.0
    if not solve_pair(s, pair, drives, x, w):
        return SINGULAR, 0.0
    return DONE, np.sqrt(turn_out(t, x, w))


@part
def whole_momentum(s, b, w, r):
    """r += M b."""
    kernels.momentum(s, b, r)
    joints.point_values(s.links, b, w.points[DX])
    for f in range(w.forces.shape[0]):
        w.forces[f, 0] = s.links.point_mass[f] * w.points[DX, f, 0]
        w.forces[f, 1] = s.links.point_mass[f] * w.points[DX, f, 1]
    joints.spread(s.links, w.forces, r)


@part
def off(s, t, h, damp, x, w, r):
    """r = -((c M + C) off_v + M off_a), what the last v' and v_0 are off the stages' polynomial."""
    stages, n = x.e.shape
    for i in range(n):
        v, a = 0.0, w.past[A, i]
        for k in range(stages):
            v += t.start[k] * x.e[k, i] / h
            a += t.start[k] * x.dv[k, i] / h
        w.past[MOVE, i], w.past[SPEED, i] = -v, -a
    for i in range(r.shape[0]):
        r[i, 0] = r[i, 1] = 0.0
    whole_momentum(s, pairs(w.past[SPEED]), w, r)
    if damp is not None:
        add_damping(s, pairs(w.past[Q]), pairs(w.past[MOVE]), damp, r)


@entry
def error(s, t, h, real, pair, damp, drives, x, w):
    """(whether it could be solved, the local error): |dq| of a solve with (c M + C) off_v + M off_a on the right, and no residual of rows."""
    off(s, t, h, damp, x, w, w.r[0])
    for i in range(w.right.shape[0]):
        w.right[i, 0] = w.right[i, 1] = 0.0
    whole_momentum(s, pairs(w.past[MOVE]), w, w.right)
    if real is not None:
        clear(w.closing)
        for i in range(w.right.shape[0]):
            for a in range(2):
                w.right[i, a] = w.r[0, i, a] + real.c[0] * w.right[i, a]
        good = solve_real(s, real, drives, x, w)
        return good, np.sqrt(square(w.past[SHARES], w.dq.reshape(w.past.shape[1])))
    clear(w.closing_pair)
    for i in range(w.right.shape[0]):
        for a in range(2):
            w.right_pair[i, a] = w.r[0, i, a] + pair.c[0] * w.right[i, a]
    good, total = solve_pair(s, pair, drives, x, w), 0.0
    for i in range(w.right.shape[0]):
        total += w.past[SHARES, 2 * i] * (w.dq_pair[i, 0].real ** 2 + w.dq_pair[i, 1].real ** 2)
    return good, np.sqrt(total)
