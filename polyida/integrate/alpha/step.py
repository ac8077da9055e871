"""A step of generalized-alpha on flat arrays: predict, correct, judge, finish; `loop.py` calls the model in between."""

from typing import NamedTuple

import numpy as np

from polyida.jit import entry, pack, part
from polyida.system.table import DONE, TOO_FAR, TOO_NEAR

EPS = 2.0**-52
SLOW = 0.3  # contraction above which the matrix is made anew
FRESHEN = 10  # steps after which the contraction is measured again
PATIENCE = 6  # steps with a small error before the step grows
Q, V, A, A_ALG, CHANGE, EARLIER, MASSES, SHARES = range(8)  # rows of Memory.past; the first three are those of Trial.now too
DD, R, DQ, DV, SLIP = range(3, 8)  # further rows of Trial.now
LAM, PHI, RATE, DLAM, BIAS = range(5)  # rows of Memory.closed, and of Trial.rows
CONTRACTION, AGE, SIZE, CHANGED, AHEAD, BEHIND, MOVED, ERROR, SINCE, PULL, TURN = range(11)
MARKS = 11


@pack
class Method(NamedTuple):
    """Numbers of the method at one h.

    least, most, share: Newton may leave `share` of the change of q'' in the step, within least and most of q'', over
    to_a. extent: of the coordinates, m, whose round-off is that of phi. incremental: carry phi by increments. control:
    |C| h^2 of the local error (0: fixed steps), of which atol + rtol |q| is allowed; grow: the error below which the
    step is too short; before: the weight of the change of q'' in the step before, beside 1 of that in this one, in the error.
    """

    h: float
    alpha_m: float
    alpha_f: float
    beta: float
    gamma: float
    to_a: float
    to_v: float
    least: float
    most: float
    share: float
    extent: float
    incremental: bool
    max_iterations: int
    control: float
    rtol: float
    atol: float
    grow: float
    before: float


@pack
class Memory(NamedTuple):
    """What goes from step to step: `past` (8, n), `closed` (3, m): lam, phi and rate = phi_q v + phi_t as they are carried, `marks`.

    CHANGE, EARLIER: of q'' in the last step and in the one before. MASSES, SHARES: of the coordinates in the mean squares of the
    local error and of Newton's. CONTRACTION of Newton; AGE of it in steps; SIZE of q'' and CHANGED of it in a step, PULL and TURN the same
    of the last iteration; AHEAD, BEHIND: of change and earlier in the prediction; MOVED: the last |dq| of an iteration to go on with (0: a
    new step); ERROR: largest local error of the last SINCE steps.
    """

    past: np.ndarray
    closed: np.ndarray
    marks: np.ndarray


@pack
class Trial(NamedTuple):
    """The state that Newton works on, `q = q_0 + (h v_0 + dd)`: `now` (8, n), `rows` (5, m)."""

    now: np.ndarray
    rows: np.ndarray


def empty(n, m):
    """(Memory, Trial) for n coordinates and m constraints."""
    return Memory(np.zeros((8, n)), np.zeros((3, m)), np.zeros(MARKS)), Trial(np.zeros((8, n)), np.zeros((5, m)))


@part
def pairs(row):
    """A row (n,) of a scene as (nodes, 2)."""
    return row.reshape((row.shape[0] // 2, 2))


@entry
def predict(p, y, w):
    """Fill the trial state: q'' as would have been nearest in the last step, lam constant."""
    past, now, ahead, behind = y.past, w.now, y.marks[AHEAD], y.marks[BEHIND]
    for i in range(now.shape[1]):
        a0, a_alg = past[A, i], past[A_ALG, i]
        a = a0 + ahead * past[CHANGE, i] + behind * past[EARLIER, i]
        a1 = ((1.0 - p.alpha_f) * a + p.alpha_f * a0 - p.alpha_m * a_alg) / (1.0 - p.alpha_m)
        dd = p.h * p.h * ((0.5 - p.beta) * a_alg + p.beta * a1)
        now[A, i] = a
        now[V, i] = past[V, i] + p.h * ((1.0 - p.gamma) * a_alg + p.gamma * a1)
        now[DD, i] = dd
        now[Q, i] = past[Q, i] + (p.h * past[V, i] + dd)
    for k in range(w.rows.shape[1]):
        w.rows[LAM, k] = y.closed[LAM, k]


@entry
def begin(p, y, w):
    """Begin a step, or go on with one that has been: the last |dq|, 0 at a beginning."""
    if y.marks[MOVED] == 0.0:
        predict(p, y, w)
        y.marks[SIZE] *= 0.9
        y.marks[CHANGED] *= 0.9
    return y.marks[MOVED]


@entry
def correct(p, y, w, first, last):
    """Add dq and dlam to the trial state; what an iteration that moved by |dq| after one by `last` tells.

    (|dq|, settled or not, hopeless or not, the largest |phi| allowed): settled where the error to be expected is below the
    tolerance, or dq is round-off and no longer falls.
    """
    past, now = y.past, w.now
    moved = length = size = pull = change = 0.0
    for i in range(now.shape[1]):
        d, share = now[DQ, i], past[SHARES, i]
        now[DD, i] += d
        now[Q, i] += d
        now[V, i] += p.to_v * d
        now[A, i] += p.to_a * d
        moved += share * d * d
        length += share * now[DD, i] * now[DD, i]
        size += share * now[Q, i] * now[Q, i]
        pull += share * now[A, i] * now[A, i]
        change += share * (now[A, i] - past[A, i]) ** 2
    for k in range(w.rows.shape[1]):
        w.rows[LAM, k] += w.rows[DLAM, k]
    return judge(p, y.marks, first, last, np.sqrt(moved), np.sqrt(length), np.sqrt(size), np.sqrt(pull), np.sqrt(change))


@part
def judge(p, marks, first, last, moved, length, size, pull, change):
    """What `correct` returns, from root mean squares of dq, of dd, of q, of q'' and of its change."""
    measured, rate = last > 0.0, marks[CONTRACTION]
    if measured:
        rate = moved / last
        marks[CONTRACTION], marks[AGE] = max(rate, (0.5 if first else 1.0) * marks[CONTRACTION]), 0.0
    marks[PULL], marks[TURN] = max(marks[SIZE], pull), max(marks[CHANGED], change)
    tolerance = min(max(p.least * marks[PULL], p.share * marks[TURN]), p.most * marks[PULL]) / p.to_a
    coarse = 16.0 * EPS * (size + p.extent)
    fine = 16.0 * EPS * (length if p.incremental else size)
    small = (measured or marks[AGE] < FRESHEN) and rate < 1.0 and moved * rate / (1.0 - rate) <= tolerance
    stalled = measured and rate > SLOW and moved <= coarse
    allowed = max(1e-2 * tolerance, 16.0 * fine if p.incremental and not stalled else coarse)
    return moved, small or stalled or moved <= fine, measured and rate > SLOW and moved > coarse, allowed


@entry
def finish(p, y, w, q, v, a, lam):
    """Accept the settled trial state, unless its local error is too large, and copy it into a frame (n,), (m,): how the step ended."""
    y.marks[AGE] += 1.0
    y.marks[SIZE], y.marks[CHANGED] = y.marks[PULL], y.marks[TURN]
    if p.control > 0.0:
        error = local_error(p, y, w)
        y.marks[ERROR] = max(y.marks[ERROR], error)
        if not error <= 1.0:
            return TOO_FAR
    accept(p, y, w)
    y.marks[MOVED] = 0.0
    for i in range(q.shape[0]):
        q[i], v[i], a[i] = y.past[Q, i], y.past[V, i], y.past[A, i]
    for k in range(lam.shape[0]):
        lam[k] = y.closed[LAM, k]
    if p.control > 0.0:
        y.marks[SINCE] += 1.0
        if y.marks[SINCE] >= PATIENCE:
            if y.marks[ERROR] < p.grow:
                return TOO_NEAR
            y.marks[ERROR] = y.marks[SINCE] = 0.0
    return DONE


@part
def local_error(p, y, w):
    """Local error of q over what is allowed, both root mean squares weighted with the masses; where no step went before, from this one."""
    change = earlier = size = 0.0
    for i in range(w.now.shape[1]):
        before = p.before * y.past[CHANGE, i]
        change += y.past[MASSES, i] * (w.now[A, i] - y.past[A, i] + before) ** 2
        earlier += before * before
        size += y.past[MASSES, i] * w.now[Q, i] * w.now[Q, i]
    control = p.control / (1.0 + p.before) if earlier > 0.0 else p.control
    return control * np.sqrt(change) / max(p.atol + p.rtol * np.sqrt(size), 1e-300)


@part
def accept(p, y, w):
    """Move the trial state into memory; the algorithmic acceleration; the next step's predictor."""
    past, now = y.past, w.now
    aa = ab = bb = ad = bd = 0.0
    for i in range(now.shape[1]):
        a, a0 = now[A, i], past[A, i]
        change, before, earlier = a - a0, past[CHANGE, i], past[EARLIER, i]
        aa += before * before
        ab += before * earlier
        bb += earlier * earlier
        ad += before * change
        bd += earlier * change
        past[A_ALG, i] = ((1.0 - p.alpha_f) * a + p.alpha_f * a0 - p.alpha_m * past[A_ALG, i]) / (1.0 - p.alpha_m)
        past[CHANGE, i] = change
        past[EARLIER, i] = before
        past[Q, i], past[V, i], past[A, i] = now[Q, i], now[V, i], a
    for k in range(w.rows.shape[1]):
        y.closed[LAM, k], y.closed[PHI, k], y.closed[RATE, k] = w.rows[LAM, k], w.rows[PHI, k], w.rows[RATE, k]
    y.marks[AHEAD], y.marks[BEHIND] = nearest(aa, ab, bb, ad, bd)


@part
def nearest(aa, ab, bb, ad, bd):
    """(x, y) for which x a + y b is nearest to d, from their products; y = 0 where a and b are as good as parallel."""
    rest = aa * bb - ab * ab
    if rest > 1e-8 * aa * bb:
        return (ad * bb - bd * ab) / rest, (bd * aa - ad * ab) / rest
    return (ad / aa if aa > 0.0 else 0.0), 0.0
