"""The compiled loop of generalized-alpha on a scene: whole stretches of steps on one factor in the frame of nodal rotations."""

from typing import NamedTuple

import numpy as np

from polyida.assembly import corotated
from polyida.assembly import equilibrium as kernels
from polyida.assembly.bodies.damping import add_damping
from polyida.assembly.own.laws import add_own_forces
from polyida.assembly.rows import joints
from polyida.assembly.rows.increments import drive_table, gain_table
from polyida.assembly.rows.tie import tie as tie_of
from polyida.compiled import entry, pack, part
from polyida.integrate.alpha import step
from polyida.integrate.alpha import tie as alpha_tie
from polyida.integrate.kinks import inner_side
from polyida.integrate.stepping.ended import DONE, HALF_TURN, INVERTED, NOT_FINITE, REFACTOR, SINGULAR, TOO_FAR
from polyida.linear.cholesky.helpers import Helpers
from polyida.linear.dense import clear
from polyida.machine import threads

SHARED = 20_000  # coordinates from which on the threads that are asked for share the solves
DZ, FORCES, START, VX, AX, DX, DV = range(7)  # rows of Scratch.points


@pack
class Scratch(NamedTuple):
    """Of the nodes: rotation (nodes, 2). Of the points: `points` (7, points, 2): displacements, forces, displacements, velocities and
    algorithmic accelerations at the last state, what the step adds to the first two.
    """

    rotation: np.ndarray
    points: np.ndarray


def scratch(model):
    """Scratch of a scene's size."""
    return Scratch(np.zeros((model.n_nodes, 2)), np.zeros((7, model.n_points, 2)))


@part
def hold_points(s, y, w):
    """The points at the last state, before a step."""
    joints.point_values(s, step.pairs(y.past[step.Q]), w.points[START])
    joints.point_values(s, step.pairs(y.past[step.V]), w.points[VX])
    joints.point_values(s, step.pairs(y.past[step.A_ALG]), w.points[AX])


@part
def carry(s, p, drives, gains, y, x, w):
    """phi and rate at the trial state from what the step adds."""
    dx, dv, ax = w.points[DX], w.points[DV], w.points[AX]
    joints.point_values(s, step.pairs(x.now[step.DD]), dx)
    for f in range(dx.shape[0]):
        for k in range(2):
            a1 = (dx[f, k] / (p.h * p.h) - (0.5 - p.beta) * ax[f, k]) / p.beta
            dv[f, k] = p.h * ((1.0 - p.gamma) * ax[f, k] + p.gamma * a1)
    for k in range(x.rows.shape[1]):
        x.rows[step.PHI, k], x.rows[step.RATE, k] = y.closed[step.PHI, k], y.closed[step.RATE, k]
    joints.joint_change(s, drives, gains, p.h, w.points[START], w.points[VX], dx, dv, x.rows[step.PHI], x.rows[step.RATE])


@part
def closed(s, p, before, drives, gains, y, x, w):
    """The largest |phi| at the trial state, carried or from the positions."""
    if p.incremental:
        carry(s, p, before, gains, y, x, w)
    else:
        joints.point_values(s, step.pairs(x.now[step.Q]), w.points[DZ])
        joints.joint_forces(s, drives, w.points[DZ], x.rows[step.LAM], x.rows[step.PHI], w.points[FORCES])
    worst = 0.0
    for k in range(x.rows.shape[1]):
        worst = max(worst, abs(x.rows[step.PHI, k]))
    return worst


@part
def newton(s, c, room, p, tie, damp, laws, before, drives, gains, y, x, w, counts):
    """Newton's iteration from the predicted state, or on from where it was. Returns how it ended and the last |dq|."""
    last, now = step.begin(p, y, x), x.now
    u, dq, r, dz = step.pairs(now[step.Q]), step.pairs(now[step.DQ]), step.pairs(now[step.R]), w.points[DZ]
    lam, phi, dlam = x.rows[step.LAM], x.rows[step.PHI], x.rows[step.DLAM]
    hold_points(s.links, y, w)
    if tie is not None and last == 0.0:
        clear(tie.slip)
    for iteration in range(p.max_iterations):
        det, cosine = kernels.equilibrium(s, drives, u, step.pairs(now[step.A]), lam, r, phi, w.rotation, dz, w.points[FORCES])
        counts[0] += 1
        if not det > 0.0:
            return (INVERTED if det <= 0.0 else NOT_FINITE), last
        if damp is not None:
            add_damping(s, u, step.pairs(now[step.V]), damp, r)
        if laws is not None:
            add_own_forces(laws, s.links, drives, u, step.pairs(now[step.V]), r)
        if p.incremental:
            carry(s.links, p, before, gains, y, x, w)
        if tie is not None:
            alpha_tie.part_constraints(s.links, drives, dz, step.pairs(now[step.V]), phi, tie, p.to_v)
        good = corotated.solve(s.links, c, room, drives, w.rotation, dz, lam, r, phi, p.to_a, dq, dlam)
        counts[1] += 1
        moved, settled, hopeless, allowed = step.correct(p, y, x, iteration == 1, last)
        if tie is not None:
            good = alpha_tie.slip(s.links, p, y, x, tie) and good
        if not good:
            return SINGULAR, last
        if settled and closed(s.links, p, before, drives, gains, y, x, w) <= allowed:
            if tie is not None:
                joints.point_values(s.links, u, dz)
                alpha_tie.settle(s.links, drives, dz, step.pairs(now[step.V]), x.rows[step.RATE], tie)
            return (DONE if cosine > 0.0 else HALF_TURN), moved
        if hopeless:
            return REFACTOR, moved
        last = moved
    return REFACTOR, last


@entry
def stretch(s, c, room, p, tie, damp, laws, drives, gains, y, x, w, counts, qs, vs, accelerations, lams):
    """Steps until the frames, the factor's use or that of h end; drives step.begin with those of the last state.

    tie: of the stabilised form, or None; damp: scratch (nodes, 2) of a damped scene, or None; laws: of force
    elements, or None. What is None is not
    compiled. Frames go to qs, vs, accelerations (steps, n), lams (steps, m). Returns (steps, end, last |dq|).
    """
    moved = 0.0
    for k in range(lams.shape[0]):
        end, moved = newton(s, c, room, p, tie, damp, laws, drives[k], drives[k + 1], gains[k], y, x, w, counts)
        if end != DONE:
            return k, end, moved
        end = step.finish(p, y, x, qs[k], vs[k], accelerations[k], lams[k])
        if end != DONE:
            return (k if end == TOO_FAR else k + 1), end, moved
    return lams.shape[0], DONE, moved


class SceneLoop:
    """Stretches of compiled steps on a scene, their solves by several threads where it has `SHARED` coordinates and these are asked for."""

    longest = 256

    def __init__(self, settings, model, counts, memory, trial):
        self.settings, self.model, self.counts, self.memory, self.trial = settings, model, counts, memory, trial
        self.tie = tie_of(model) if settings.form == "stabilised" and model.m else None
        self.damp = np.zeros((model.n_nodes, 2)) if model.damped else None
        self.scratch = scratch(model)
        self.helpers = Helpers(threads() if model.n >= SHARED else 1)

    def system(self):
        """What factors the step matrix, not factored yet."""
        return self.settings.step_matrix(self.model)

    def prepare(self, times, method):
        """Get ready for steps between the times: loads and motors at all of them."""
        ends = inner_side(self.model, times[0], -method.h), inner_side(self.model, times[-1], method.h)
        self.drives = drive_table(self.model, times, ends)
        self.gains = gain_table(self.model, times, self.drives, method.h)

    def factor(self, system, p, t):
        """Factor the system at the trial state. Raises SingularSystem."""
        q, v, a = self.trial.now[:3].copy()
        system.factor(t, q, v, a, self.trial.rows[step.LAM].copy(), p.to_a, p.to_v)
        self.counts.residuals += 1

    def steps(self, p, system, first, last, *frames):
        """Take the steps from `first` to `last` with a factored system: (steps, how it ended, last |dq|)."""
        seen = np.zeros(2, np.int64)
        with self.helpers.at_work(system.corotated.factor, system.room) as room:
            result = stretch(
                self.model.arrays,
                system.corotated,
                room,
                p,
                self.tie,
                self.damp,
                self.model.laws,
                self.drives[first : last + 1],
                self.gains[first:last],
                self.memory,
                self.trial,
                self.scratch,
                seen,
                *frames,
            )
        self.counts.residuals += int(seen[0])
        self.counts.solves += int(seen[1])
        self.counts.newton_iterations += int(seen[1])
        return result
