"""The collocation equations of a scene in compiled code: residuals of all stages, one real and one complex solve, corrections.

What `plain.py` does for any model. The factors are made in the frame of the nodes, and each stage has a frame of its own: its residual
is turned from there to the middle stage's, R(q_k) R(q_i)^T node by node, and the correction that comes back is turned the other way.
"""

import math
from typing import NamedTuple

import numpy as np

from polyida.assembly import corotated
from polyida.assembly import equilibrium as kernels
from polyida.assembly.damping import add_damping, symmetric_parts
from polyida.assembly.own.laws import add_own_forces
from polyida.assembly.rows import joints
from polyida.assembly.rows.increments import drive_table, gains_from
from polyida.assembly.rows.tie import project, tie
from polyida.assembly.stabilised_border import StabilisedRoom, massive, stabilised_border, stabilised_room
from polyida.compiled import entry, pack, part
from polyida.integrate.ended import DONE, HALF_TURN, INVERTED, NOT_FINITE, REASONS, SINGULAR
from polyida.integrate.kinks import inner_side
from polyida.integrate.radau.newton import Failed, trial
from polyida.integrate.sizes import ROUND_OFF, extent
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


@pack
class Solver(NamedTuple):
    """What kernels take of the factored matrix of a mode; c (1,): its own; massive, border: of the border with mu, or None."""

    c: np.ndarray
    factored: corotated.Corotated
    room: corotated.Room
    massive: corotated.Corotated | None
    border: StabilisedRoom | None


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
            add_damping(s.plates, u, v, damp, r)
        if laws is not None:
            add_own_forces(laws, s.links, drives[k + 1], u, v, r)
        carry(s, t, h, drives, gains, x, w, k)
        if k == x.e.shape[0] // 2:
            joints.point_values(s.links, v, w.vz)
    return DONE


@part
def turn_in(t, w):
    """The modes' residuals, turned into the frame of the middle stage."""
    stages, middle = w.r.shape[0], w.r.shape[0] // 2
    for i in range(w.right.shape[0]):
        mx, my = w.rotation[middle, i, 0], w.rotation[middle, i, 1]
        size = 1.0 / np.sqrt(mx * mx + my * my)
        mx, my = mx * size, my * size
        w.right[i, 0] = w.right[i, 1] = 0.0
        w.right_pair[i, 0] = w.right_pair[i, 1] = 0.0
        for k in range(stages):
            x, y = w.rotation[k, i, 0], w.rotation[k, i, 1]
            size = 1.0 / np.sqrt(x * x + y * y)
            c, n = (mx * x + my * y) * size, (my * x - mx * y) * size
            w.turn[k, i, 0], w.turn[k, i, 1] = c, n
            p, q = c * w.r[k, i, 0] - n * w.r[k, i, 1], n * w.r[k, i, 0] + c * w.r[k, i, 1]
            if t.real_row.shape[0]:
                w.right[i, 0] += t.real_row[k] * p
                w.right[i, 1] += t.real_row[k] * q
            w.right_pair[i, 0] += t.pair_row[k] * p
            w.right_pair[i, 1] += t.pair_row[k] * q
    for f in range(2):
        for e in range(w.closing.shape[1]):
            w.closing[f, e], w.closing_pair[f, e] = 0.0, 0.0
            for k in range(stages):
                if t.real_row.shape[0]:
                    w.closing[f, e] += t.real_row[k] * w.rows[f, k, e]
                w.closing_pair[f, e] += t.pair_row[k] * w.rows[f, k, e]


@part
def turn_out(t, x, w):
    """Add the modes' corrections to the stages, each turned into its frame. Returns the mean square of dq and h dv, by mass."""
    stages, total = x.e.shape[0], 0.0
    dq = np.empty((stages, 2))
    for i in range(w.right.shape[0]):
        for k in range(stages):
            p = 2.0 * (t.pair_column[k] * w.dq_pair[i, 0]).real
            q = 2.0 * (t.pair_column[k] * w.dq_pair[i, 1]).real
            if t.real_row.shape[0]:
                p += t.real_column[k] * w.dq[i, 0]
                q += t.real_column[k] * w.dq[i, 1]
            c, n = w.turn[k, i, 0], w.turn[k, i, 1]
            dq[k, 0], dq[k, 1] = c * p + n * q, c * q - n * p
            x.e[k, 2 * i] += dq[k, 0]
            x.e[k, 2 * i + 1] += dq[k, 1]
        for a in range(2):
            share = w.past[SHARES, 2 * i + a]
            for k in range(stages):
                speed = 0.0
                for j in range(stages):
                    speed += t.W[k, j] * dq[j, a]
                total += share * (dq[k, a] * dq[k, a] + speed * speed)
    add_multipliers(t, w, 0, x.lam)
    add_multipliers(t, w, 1, x.mu)
    return total / stages


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
    kernels.momentum(s.plates, b, r)
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
        add_damping(s.plates, pairs(w.past[Q]), pairs(w.past[MOVE]), damp, r)


@entry
def error(s, t, h, real, pair, damp, drives, x, w):
    """(whether it could be solved, the local error): |dq| of a solve with (c M + C) off_v + M off_a on the right, and no residual of rows."""
    off(s, t, h, damp, x, w, w.r[0])
    for i in range(w.right.shape[0]):
        w.right[i, 0] = w.right[i, 1] = 0.0
    whole_momentum(s, pairs(w.past[MOVE]), w, w.right)
    total = 0.0
    if real is not None:
        clear(w.closing)
        for i in range(w.right.shape[0]):
            for a in range(2):
                w.right[i, a] = w.r[0, i, a] + real.c[0] * w.right[i, a]
        good = solve_real(s, real, drives, x, w)
        for i in range(w.right.shape[0]):
            total += w.past[SHARES, 2 * i] * (w.dq[i, 0] ** 2 + w.dq[i, 1] ** 2)
        return good, np.sqrt(total)
    clear(w.closing_pair)
    for i in range(w.right.shape[0]):
        for a in range(2):
            w.right_pair[i, a] = w.r[0, i, a] + pair.c[0] * w.right[i, a]
    good = solve_pair(s, pair, drives, x, w)
    for i in range(w.right.shape[0]):
        total += w.past[SHARES, 2 * i] * (w.dq_pair[i, 0].real ** 2 + w.dq_pair[i, 1].real ** 2)
    return good, np.sqrt(total)


class SceneSystem:
    """Of a scene, for the stages of a tableau; the same protocol as PlainSystem's."""

    asks = False  # its residuals have looked

    def __init__(self, model, tableau, tied, moves_v, counts):
        needs, self.model, self.tableau, self.counts = model.needs, model, tableau, counts
        self.tied = tied and model.m > 0 and (needs.phi_q_varies or needs.driven)
        self.way, self.room = way(tableau), room(model, tableau.stages)
        self.trial = trial(tableau.stages, model.n, model.m, self.tied)
        self.damp = np.zeros((model.n_nodes, 2)) if model.damped else None
        self.moves_v, self.tie, self.kernels = moves_v, tie(model) if model.m else None, {}

    def _call(self, kernel, *args):
        """kernel(scene's arrays, *args), whose types are the same in every call."""
        bound = self.kernels.get(kernel)
        if bound is None:
            bound = self.kernels[kernel] = kernel.bound(self.model.arrays, *args)
        return bound(self.model.arrays, *args)

    def weigh(self, shares):
        """Take the coordinates' shares in the mass."""
        self.room.past[SHARES] = shares

    def matrices(self, h, made_at):
        """Those of steps of h at made_at, not made yet."""
        return SceneMatrices(self.model, self.tableau.modes, h, made_at, self.tied)

    def begin(self, state, h, times, closed):
        """Go on from a state: h, the times of the stages, and (phi, rate) there as they are carried."""
        self.h, self.enough = h, ROUND_OFF * extent(self.model, state.q)
        self._call(begin, np.ascontiguousarray(state.q), np.ascontiguousarray(state.v), *closed, self.room)
        self.drives, self.gains = self._loads(state.t, times)

    def _loads(self, t, times):
        model = self.model
        if not model.profiles:
            none = np.empty((len(times) + 1, 0, 3))
            return none, none[1:]
        edge = inner_side(model, t, -self.h)
        drives = drive_table(model, np.array([t, *times]), (edge, times[-1]))
        return drives, gains_from(model, t, np.array(times), drives, self.tableau.c * self.h)

    def take(self, matrices):
        """Nothing: the rows of the constraints are made in each iteration."""

    def iterate(self, matrices):
        """One iteration; returns |dq|, |dv| h with it, root mean square by mass. Raises Failed."""
        counts = self.counts
        counts.residuals += self.tableau.stages
        counts.newton_iterations += 1
        counts.solves += len(matrices.modes)
        given = *matrices.compiled, self.damp, self.model.laws, self.drives, self.gains, self.trial, self.room
        ended, moved = self._call(iterate, self.way, self.h, *given)
        if ended != DONE:
            raise Failed(*REASONS[ended])
        return moved

    def close(self):
        """Bring v and v' up to the last correction, and the step's end onto its constraints: (phi, rate) there as they are carried."""
        given = self.drives, self.gains, self.enough, self.moves_v, self.tie, self.trial, self.room
        if not self._call(close, self.way, self.h, *given):
            raise Failed(*REASONS[SINGULAR])
        return self.room.rows[0, -1].copy(), self.room.rows[1, -1].copy()

    def error(self, matrices, a):
        """|q_ - q| of the step's end against a method of order s; a (n,): v' at the last step's end."""
        self.counts.solves += 1
        self.room.past[A] = a
        good, found = self._call(error, self.way, self.h, *matrices.compiled, self.damp, self.drives, self.trial, self.room)
        if not good:
            raise Failed(*REASONS[SINGULAR])
        return found


class SceneMatrices:
    """The co-rotated factors of both modes for steps of h, made when first used from `made_at`; compiled: what kernels take of them.

    price: iterations that they cost beyond their best ones, `least` a step.
    """

    def __init__(self, model, modes, h, made_at, tied):
        self.model, self.modes, self.made_at, self.price, self.least, self.tied = model, modes, made_at, 0.0, math.inf, tied
        self.c, self.compiled, self.backend = [mode.value / h for mode in modes], None, ""

    def make(self):
        """Factor, where it is not done. Raises SingularSystem."""
        if self.compiled is not None:
            return
        at = (float(self.made_at[0]), *np.split(self.made_at[1:], np.cumsum([self.model.n] * 3)))
        parts, found = symmetric_parts(self.model, at[1].reshape(-1, 2)), {}
        for mode, c in zip(self.modes, self.c):
            step = self.model.step_matrix()
            step.factor(*at, c * c, c, parts)
            found[mode.paired], self.backend = Solver(np.array([c]), step.corotated, step.room, *self._border(step, c, at)), step.backend
        self.compiled = found.get(False), found[True]

    def _border(self, step, c, at):
        if not self.tied:
            return None, None
        t, q, v = at[:3]
        damping = self.model.force_v(t, q, np.zeros_like(v)) / c if self.model.damped else None
        return massive(self.model, step.corotated, step.room.x, damping), stabilised_room(self.model, type(c))
