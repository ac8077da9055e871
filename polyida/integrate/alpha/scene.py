"""Steps of generalized-alpha on a scene, compiled: whole stretches on one factor in the frame of nodal rotations."""

import numpy as np

from polyida.assembly import equilibrium as kernels
from polyida.assembly import joints
from polyida.assembly.damping import add_damping
from polyida.compiled import entry, part
from polyida.integrate.alpha import tie as alpha_tie
from polyida.integrate.alpha.arrays import AGE, AHEAD, BEHIND, CHANGE, ERROR, MOVED, PATIENCE, RATE, SINCE, SIZE
from polyida.linear import corotated

EPS = 2.0**-52
SLOW = 0.3  # contraction above which the matrix is made anew
FRESHEN = 10  # steps after which the contraction is measured again
DONE, REFACTOR, INVERTED, NOT_FINITE, HALF_TURN, SINGULAR, TOO_FAR, TOO_NEAR = range(8)


@entry
def predict(p, y, w):
    """Fill the trial state: q'' as would have been nearest in the last step, lam constant."""
    ahead, behind = y.marks[AHEAD], y.marks[BEHIND]
    for i in range(y.u.shape[0]):
        for k in range(2):
            a = y.a[i, k] + ahead * y.change[i, k] + behind * y.earlier[i, k]
            a1 = ((1.0 - p.alpha_f) * a + p.alpha_f * y.a[i, k] - p.alpha_m * y.a_alg[i, k]) / (1.0 - p.alpha_m)
            w.a[i, k] = a
            w.v[i, k] = y.v[i, k] + p.h * ((1.0 - p.gamma) * y.a_alg[i, k] + p.gamma * a1)
            w.dd[i, k] = p.h * p.h * ((0.5 - p.beta) * y.a_alg[i, k] + p.beta * a1)
            w.u[i, k] = y.u[i, k] + (p.h * y.v[i, k] + w.dd[i, k])
    for k in range(w.lam.shape[0]):
        w.lam[k] = y.lam[k]


@part
def correct(p, y, w):
    """Add dq and dlam to the trial state; root mean squares of dq, of dd, of q, of q'' and of its change."""
    moved = length = size = pull = change = 0.0
    for i in range(w.u.shape[0]):
        for k in range(2):
            d = w.dq[i, k]
            w.dd[i, k] += d
            w.u[i, k] += d
            w.v[i, k] += p.to_v * d
            w.a[i, k] += p.to_a * d
            moved += d * d
            length += w.dd[i, k] * w.dd[i, k]
            size += w.u[i, k] * w.u[i, k]
            pull += w.a[i, k] * w.a[i, k]
            change += (w.a[i, k] - y.a[i, k]) ** 2
    for k in range(w.lam.shape[0]):
        w.lam[k] += w.dlam[k]
    n = 2.0 * w.u.shape[0]
    return np.sqrt(moved / n), np.sqrt(length / n), np.sqrt(size / n), np.sqrt(pull / n), np.sqrt(change / n)


@part
def accept(p, y, w):
    """Move the trial state into memory; the algorithmic acceleration; the next step's predictor."""
    aa = ab = bb = ad = bd = 0.0
    for i in range(y.u.shape[0]):
        for k in range(2):
            a, a0 = w.a[i, k], y.a[i, k]
            now, before, earlier = a - a0, y.change[i, k], y.earlier[i, k]
            aa += before * before
            ab += before * earlier
            bb += earlier * earlier
            ad += before * now
            bd += earlier * now
            y.a_alg[i, k] = ((1.0 - p.alpha_f) * a + p.alpha_f * a0 - p.alpha_m * y.a_alg[i, k]) / (1.0 - p.alpha_m)
            y.change[i, k] = now
            y.earlier[i, k] = before
            y.a[i, k] = a
            y.u[i, k] = w.u[i, k]
            y.v[i, k] = w.v[i, k]
    for k in range(w.lam.shape[0]):
        y.lam[k] = w.lam[k]
        y.phi[k] = w.phi[k]
        y.rate[k] = w.rate[k]
    y.marks[AHEAD], y.marks[BEHIND] = nearest(aa, ab, bb, ad, bd)


@part
def nearest(aa, ab, bb, ad, bd):
    """(x, y) for which x a + y b is nearest to d, from their products; y = 0 where a and b are as good as parallel."""
    rest = aa * bb - ab * ab
    if rest > 1e-8 * aa * bb:
        return (ad * bb - bd * ab) / rest, (bd * aa - ad * ab) / rest
    return (ad / aa if aa > 0.0 else 0.0), 0.0


@part
def local_error(p, y, w):
    """Local error of q over what is allowed, both root mean squares weighted with the masses."""
    change = size = 0.0
    for i in range(w.u.shape[0]):
        for k in range(2):
            change += y.weights[i, k] * (w.a[i, k] - y.a[i, k]) ** 2
            size += y.weights[i, k] * w.u[i, k] * w.u[i, k]
    return p.control * np.sqrt(change) / max(p.atol + p.rtol * np.sqrt(size), 1e-300)


@part
def hold_points(s, y, w):
    """The points at the last state, before a step."""
    joints.point_values(s, y.u, w.start)
    joints.point_values(s, y.v, w.vx)
    joints.point_values(s, y.a_alg, w.ax)


@part
def carry(s, p, drives, gains, y, w):
    """phi and rate at the trial state from what the step adds."""
    joints.point_values(s, w.dd, w.dx)
    for f in range(w.dx.shape[0]):
        for k in range(2):
            a1 = (w.dx[f, k] / (p.h * p.h) - (0.5 - p.beta) * w.ax[f, k]) / p.beta
            w.dv[f, k] = p.h * ((1.0 - p.gamma) * w.ax[f, k] + p.gamma * a1)
    for k in range(w.phi.shape[0]):
        w.phi[k], w.rate[k] = y.phi[k], y.rate[k]
    joints.joint_change(s, drives, gains, p.h, w.start, w.vx, w.dx, w.dv, w.phi, w.rate)


@part
def closed(s, p, before, drives, gains, y, w):
    """The largest |phi| at the trial state, carried or from the positions."""
    if p.incremental:
        carry(s, p, before, gains, y, w)
    else:
        joints.point_values(s, w.u, w.dz)
        joints.joint_forces(s, drives, w.dz, w.lam, w.phi, w.forces)
    worst = 0.0
    for k in range(w.phi.shape[0]):
        worst = max(worst, abs(w.phi[k]))
    return worst


@part
def judge(p, marks, first, last, moved, length, size, pull, change):
    """What an iteration that moved by dq after one by `last` tells: settled or not, hopeless or not, |phi| allowed.

    Settled: the error to be expected is below the tolerance, or dq is round-off and no longer falls.
    """
    measured, rate = last > 0.0, marks[RATE]
    if measured:
        rate = moved / last
        marks[RATE], marks[AGE] = max(rate, (0.5 if first else 1.0) * marks[RATE]), 0.0
    pull, change = max(marks[SIZE], pull), max(marks[CHANGE], change)
    tolerance = min(max(p.least * pull, p.share * change), p.most * pull) / p.to_a
    coarse = 16.0 * EPS * (size + p.extent)
    fine = 16.0 * EPS * (length if p.incremental else size)
    small = (measured or marks[AGE] < FRESHEN) and rate < 1.0 and moved * rate / (1.0 - rate) <= tolerance
    stalled = measured and rate > SLOW and moved <= coarse
    allowed = max(1e-2 * tolerance, 16.0 * fine if p.incremental and not stalled else coarse)
    return small or stalled or moved <= fine, measured and rate > SLOW and moved > coarse, allowed


@part
def newton(s, c, room, p, tie, damp, before, drives, gains, y, w, counts):
    """Newton's iteration from the predicted state, or on from where it was. Returns how it ended and the last |dq|."""
    last = y.marks[MOVED]
    if last == 0.0:
        predict(p, y, w)
        y.marks[SIZE] *= 0.9
        y.marks[CHANGE] *= 0.9
    hold_points(s.links, y, w)
    for iteration in range(p.max_iterations):
        det, cosine = kernels.equilibrium(s, drives, w.u, w.a, w.lam, w.r, w.phi, w.rotation, w.dz, w.forces)
        counts[0] += 1
        if not det > 0.0:
            return (INVERTED if det <= 0.0 else NOT_FINITE), last
        if damp is not None:
            add_damping(s.plates, w.u, w.v, damp, w.r)
        if p.incremental:
            carry(s.links, p, before, gains, y, w)
        if tie is not None:
            alpha_tie.part_constraints(s.links, drives, w, tie, p.to_v)
        good = corotated.solve(s.links, c, room, drives, w.rotation, w.dz, w.lam, w.r, w.phi, p.to_a, w.dq, w.dlam)
        counts[1] += 1
        moved, length, size, pull, change = correct(p, y, w)
        if tie is not None:
            good = alpha_tie.slip(s.links, p, y, w, tie) and good
        if not good:
            return SINGULAR, last
        settled, hopeless, allowed = judge(p, y.marks, iteration == 1, last, moved, length, size, pull, change)
        if settled and closed(s.links, p, before, drives, gains, y, w) <= allowed:
            y.marks[AGE] += 1.0
            y.marks[SIZE], y.marks[CHANGE] = max(y.marks[SIZE], pull), max(y.marks[CHANGE], change)
            if tie is not None:
                alpha_tie.settle(s.links, drives, w, tie)
            return (DONE if cosine > 0.0 else HALF_TURN), moved
        if hopeless:
            return REFACTOR, moved
        last = moved
    return REFACTOR, last


@part
def record(y, q, v, a, lam):
    """Copy the accepted state into a frame."""
    for i in range(q.shape[0]):
        for k in range(2):
            q[i, k], v[i, k], a[i, k] = y.u[i, k], y.v[i, k], y.a[i, k]
    for k in range(lam.shape[0]):
        lam[k] = y.lam[k]


@entry
def stretch(s, c, room, p, tie, damp, drives, gains, y, w, counts, qs, vs, accelerations, lams):
    """Steps until the frames, the factor's use or that of h end; drives begin with those of the last state.

    tie: of the stabilised form, or None; damp: scratch (nodes, 2) of a damped scene, or None. What is None is not
    compiled. Frames go to qs, vs, accelerations, lams. Returns (steps, end, last |dq|).
    """
    for k in range(qs.shape[0]):
        end, moved = newton(s, c, room, p, tie, damp, drives[k], drives[k + 1], gains[k], y, w, counts)
        if end != DONE:
            return k, end, moved
        if p.control > 0.0:
            error = local_error(p, y, w)
            y.marks[ERROR] = max(y.marks[ERROR], error)
            if not error <= 1.0:
                return k, TOO_FAR, moved
        accept(p, y, w)
        y.marks[MOVED] = 0.0
        record(y, qs[k], vs[k], accelerations[k], lams[k])
        if p.control > 0.0:
            y.marks[SINCE] += 1.0
            if y.marks[SINCE] >= PATIENCE:
                if y.marks[ERROR] < p.grow:
                    return k + 1, TOO_NEAR, moved
                y.marks[ERROR] = y.marks[SINCE] = 0.0
    return qs.shape[0], DONE, moved
