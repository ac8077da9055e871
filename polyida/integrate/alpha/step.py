"""The compiled loop of generalized-alpha: stretches of steps of any model, through its table (polyida.system).

The stabilised form satisfies phi = 0 and `phi_q v + phi_t = 0` at once:
`q_1 = q_0 + h v_0 + h^2 ((1/2 - beta) a_0 + beta a_1) - M^-1 phi_q^T eta`. eta takes the local error of q along the constraints, so that v,
by Newmark's formula in a, is free of it (Gear, Gupta, Leimkuhler 1985; Arnold, Cardona, Bruels 2015). In one Newton step, with dq = x + y, x
in v and a too and `y = -M^-1 phi_q^T eta`: `S x + phi_q^T dlam = -r`, `phi_q x = -rate/gamma'`, `phi_q y = -(phi - rate/gamma')`. The sum of
the y of a step, GGL, is computed anew with phi_q of each iterate, so that in the end it has phi_q of the step's end.

A velocity row psi is a row with phi = 0, the rate psi and phi_q = W: `W dq = -psi/gamma'` in Newton's method, `W y = 0` in the stabilised form.
"""

from typing import NamedTuple

import numpy as np

from polyida import system as table
from polyida.errors import DONE, ERROR_LARGE, ERROR_SMALL, NOT_FINITE, REFACTOR
from polyida.jit import entry, fast, pack, part
from polyida.jit.intrinsics import address, call
from polyida.linear.dense import copy_matrix, put, zero

EPS = 2.0**-52
SLOW = 0.3  # contraction above which the matrix is made anew
FRESHEN = 10  # steps after which the contraction is measured again
PATIENCE = 6  # steps with a small error before the step grows
LARGEST_FACTOR = 4.0  # of an earlier change in a prediction; a straight line needs 2
# rows of Memory.past; the first three are those of Trial.now too
Q, V, A, A_ALG, CHANGE, EARLIER, MASSES, SHARES, PLACES = range(9)
DD, R, DQ, DV, GGL = range(3, 8)  # further rows of Trial.now
LAM, PHI, RATE, DLAM, BIAS = range(5)  # rows of Memory.rows and of Trial.rows
# of Memory.marks; norms are root mean squares
CONTRACTION, AGE = range(2)  # of Newton's method, and its age in steps
# norms of q'' and of its change in a step: largest so far, of this iteration
ACCEL, ACCEL_CHANGE, NEW_ACCEL, NEW_ACCEL_CHANGE = range(2, 6)
AHEAD, BEHIND = range(6, 8)  # factors of CHANGE and EARLIER in the prediction
MOVED = 8  # the last |dq| of an iteration from which Newton's method goes on, nan from a given trial state, 0 in a new step
ERROR, SINCE = range(9, 11)  # largest local error of the last SINCE steps
MARKS = 11


@pack
class Method(NamedTuple):
    """Numbers of the method at one h.

    least, most, share: Newton may leave `share` of the change of q'' in the step, within least and most of q'', over to_a. extent: of the
    coordinates, m, whose round-off is that of phi. incremental: carry phi by increments. control: |C| h^2 of the local error (0: fixed
    steps), of which atol + rtol |q| is allowed; grow: the error below which h may grow; before: weight of the change of q'' in the step
    before, over that in this step, in the error. velocity_rows: their numbers among the rows. unknowns: coordinates that Newton's method
    moves; those behind are relaxed strains, which the model computes at the end of a step.
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
    velocity_rows: np.ndarray
    unknowns: int


@pack
class Memory(NamedTuple):
    """Memory from step to step: `past` (9, n), `rows` (3, m): lam, phi and rate = phi_q v + phi_t as they are carried, `marks` (MARKS,).

    CHANGE, EARLIER: of q'' in the last step and in the one before. MASSES, SHARES: weights of the coordinates in the mean squares of the
    local error and of Newton's method. PLACES: of |q|, which the local error is relative to: MASSES without the integrals of states.
    """

    past: np.ndarray
    rows: np.ndarray
    marks: np.ndarray


@pack
class Trial(NamedTuple):
    """The state of Newton's method, `q = q_0 + (h v_0 + dd)`: `now` (8, n), `rows` (5, m)."""

    now: np.ndarray
    rows: np.ndarray


def empty(n, m):
    """(Memory, Trial) for n coordinates and m constraints."""
    return Memory(np.zeros((9, n)), np.zeros((3, m)), np.zeros(MARKS)), Trial(np.zeros((8, n)), np.zeros((5, m)))


@entry
def predict(p, y, w):
    """Fill the trial state: q'' by the combination of earlier changes that fits the last step best, lam constant."""
    past, now, ahead, behind = y.past, w.now, y.marks[AHEAD], y.marks[BEHIND]
    for i in range(p.unknowns):
        a0, a_alg = past[A, i], past[A_ALG, i]
        a = a0 + ahead * past[CHANGE, i] + behind * past[EARLIER, i]
        a1 = ((1.0 - p.alpha_f) * a + p.alpha_f * a0 - p.alpha_m * a_alg) / (1.0 - p.alpha_m)
        dd = p.h * p.h * ((0.5 - p.beta) * a_alg + p.beta * a1)
        now[A, i] = a
        now[V, i] = past[V, i] + p.h * ((1.0 - p.gamma) * a_alg + p.gamma * a1)
        now[DD, i] = dd
        now[Q, i] = past[Q, i] + (p.h * past[V, i] + dd)
    put(1.0, y.rows[LAM], w.rows[LAM])


@fast
def correct(p, y, w, first, last):
    """Add dq and dlam to the trial state. Returns what `convergence` returns; last: |dq| of the iteration before, or 0."""
    past, now = y.past, w.now
    moved = length = size = accel = change = 0.0
    for i in range(p.unknowns):
        d, share = now[DQ, i], past[SHARES, i]
        now[DD, i] += d
        now[Q, i] += d
        now[V, i] += p.to_v * d
        now[A, i] += p.to_a * d
        moved += share * d * d
        length += share * now[DD, i] * now[DD, i]
        size += share * now[Q, i] * now[Q, i]
        accel += share * now[A, i] * now[A, i]
        change += share * (now[A, i] - past[A, i]) ** 2
    for k in range(w.rows.shape[1]):
        w.rows[LAM, k] += w.rows[DLAM, k]
    return convergence(p, y.marks, first, last, np.sqrt(moved), np.sqrt(length), np.sqrt(size), np.sqrt(accel), np.sqrt(change))


@part
def convergence(p, marks, first, last, moved, length, size, accel, change):
    """(|dq|, True if converged, True if Newton's method fails, the largest |phi| allowed), from the norms of dq, dd, q, q'' and its change.

    Converged: the error to be expected is below the tolerance, or dq is round-off and no longer falls.
    """
    measured, rate = last > 0.0, marks[CONTRACTION]
    if measured:
        rate = moved / last
        marks[CONTRACTION], marks[AGE] = max(rate, (0.5 if first else 1.0) * marks[CONTRACTION]), 0.0
    marks[NEW_ACCEL], marks[NEW_ACCEL_CHANGE] = max(marks[ACCEL], accel), max(marks[ACCEL_CHANGE], change)
    tolerance = min(max(p.least * marks[NEW_ACCEL], p.share * marks[NEW_ACCEL_CHANGE]), p.most * marks[NEW_ACCEL]) / p.to_a
    coarse = 16.0 * EPS * (size + p.extent)
    fine = 16.0 * EPS * (length if p.incremental else size)
    small = (measured or marks[AGE] < FRESHEN) and rate < 1.0 and moved * rate / (1.0 - rate) <= tolerance
    stalled = measured and rate > SLOW and moved <= coarse
    allowed = max(1e-2 * tolerance, 16.0 * fine if p.incremental and not stalled else coarse)
    return moved, small or stalled or moved <= fine, measured and rate > SLOW and moved > coarse, allowed


@part
def end_step(f, w, k, p, c, y, x, row, qs, vs, accelerations, lams):
    """Accept the trial state, unless its local error is too large, and copy it into a row of the frames. Returns how the step ended."""
    y.marks[AGE] += 1.0
    y.marks[ACCEL], y.marks[ACCEL_CHANGE] = y.marks[NEW_ACCEL], y.marks[NEW_ACCEL_CHANGE]
    if p.control > 0.0:
        error = local_error(p, y, x)
        y.marks[ERROR] = max(y.marks[ERROR], error)
        if not error <= 1.0:
            return ERROR_LARGE
    remember(p, y, x)
    if p.unknowns < qs.shape[1]:
        call(f[table.STRAINS], w, k, address(y.past), address(x.now), address(y.past), address(c), 0, 0)
    y.marks[MOVED] = 0.0
    put(1.0, y.past[Q], qs[row])
    put(1.0, y.past[V], vs[row])
    put(1.0, y.past[A], accelerations[row])
    put(1.0, y.rows[LAM], lams[row])
    if p.control > 0.0:
        y.marks[SINCE] += 1.0
        if y.marks[SINCE] >= PATIENCE:
            if y.marks[ERROR] < p.grow:
                return ERROR_SMALL
            y.marks[ERROR] = y.marks[SINCE] = 0.0
    return DONE


@fast
def local_error(p, y, w):
    """Local error of q over the allowed one, mass-weighted norms; from the change of q'' in this step alone if none went before."""
    change = earlier = size = 0.0
    for i in range(w.now.shape[1]):
        before = p.before * y.past[CHANGE, i]
        change += y.past[MASSES, i] * (w.now[A, i] - y.past[A, i] + before) ** 2
        earlier += before * before
        size += y.past[PLACES, i] * w.now[Q, i] * w.now[Q, i]
    control = p.control / (1.0 + p.before) if earlier > 0.0 else p.control
    return control * np.sqrt(change) / max(p.atol + p.rtol * np.sqrt(size), 1e-300)


@fast
def remember(p, y, w):
    """Move the trial state into memory, with the algorithmic acceleration and the factors of the next prediction."""
    past, now = y.past, w.now
    aa = ab = bb = ad = bd = 0.0
    for i in range(p.unknowns):
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
    copy_matrix(w.rows[:DLAM], y.rows)  # lam, phi and the rate
    y.marks[AHEAD], y.marks[BEHIND] = nearest(aa, ab, bb, ad, bd)


@part
def nearest(aa, ab, bb, ad, bd):
    """(x, y) that minimise |x a + y b - d|, from the products of a, b and d; y = 0 if a and b are nearly parallel.

    Larger factors than LARGEST_FACTOR say that d has another cause than a and b, so they say nothing about the change after d: then y = 0, or
    both are zero.
    """
    rest = aa * bb - ab * ab
    if rest > 1e-8 * aa * bb:
        x, y = (ad * bb - bd * ab) / rest, (bd * aa - ad * ab) / rest
        if max(abs(x), abs(y)) <= LARGEST_FACTOR:
            return x, y
    if aa > 0.0 and abs(ad) <= LARGEST_FACTOR * aa:
        return ad / aa, 0.0
    return 0.0, 0.0


@part
def constraints(f, w, k, p, y, x):
    """(how it ended, the largest |phi|); fills phi and rate at the trial state."""
    now, rows = x.now, x.rows
    for i in range(p.unknowns):
        a1 = (now[DD, i] / (p.h * p.h) - (0.5 - p.beta) * y.past[A_ALG, i]) / p.beta
        now[DV, i] = p.h * ((1.0 - p.gamma) * y.past[A_ALG, i] + p.gamma * a1)
    for i in range(rows.shape[1]):
        rows[PHI, i], rows[RATE, i] = y.rows[PHI, i], y.rows[RATE, i]
    places = address(now[Q]), address(now[DD]), address(now[DV]), address(rows[PHI]), address(rows[RATE])
    ended = call(f[table.CONSTRAINTS], w, k, places[0], places[1], places[2], places[3], places[4], 0)
    worst = 0.0
    for i in range(rows.shape[1]):
        worst = max(worst, abs(rows[PHI, i]))
    return ended, worst


@part
def add_rates(f, w, k, p, x, stabilised):
    """Fill the velocity rows of rows[PHI] with psi/gamma'; if stabilised all rows with rate/gamma', for the solve of x, and rows[BIAS] with the rest."""
    rows = x.rows
    ended = call(f[table.RATE], w, k, address(x.now[Q]), address(x.now[V]), address(rows[BIAS]), 0, 0, 0)
    for i in range(rows.shape[1] if stabilised else 0):
        share = rows[BIAS, i] / p.to_v
        rows[BIAS, i], rows[PHI, i] = rows[PHI, i] - share, share
    for e in range(p.velocity_rows.shape[0]):
        i = p.velocity_rows[e]
        if not stabilised:
            rows[PHI, i] = rows[BIAS, i] / p.to_v
        rows[BIAS, i] = 0.0
    return ended


@part
def correct_ggl(f, w, k, p, y, x):
    """Compute the GGL correction anew, and q with it."""
    now, past = x.now, y.past
    for i in range(p.unknowns):
        now[DD, i] -= now[GGL, i]
    ended = call(f[table.PROJECT], w, k, address(x.rows[BIAS]), address(now[GGL]), 1, 0, 0, 0)
    for i in range(p.unknowns):
        now[DD, i] += now[GGL, i]
        now[Q, i] = past[Q, i] + (p.h * past[V, i] + now[DD, i])
    return ended


@part
def settle(f, w, k, x, stabilised):
    """Ask the model to accept the state; in the stabilised form project v onto the velocity constraint."""
    now, rows = x.now, x.rows
    ended = call(f[table.ACCEPT], w, k, address(now[Q]), 0, 0, 0, 0, 0)
    if ended != DONE or not stabilised:
        return ended
    ended = call(f[table.RATE], w, k, address(now[Q]), address(now[V]), address(rows[RATE]), 0, 0, 0)
    if ended != DONE:
        return ended
    ended = call(f[table.PROJECT], w, k, address(rows[RATE]), address(now[V]), 0, 0, 0, 0)
    zero(rows[RATE])
    return ended


@part
def newton(f, w, k, p, stabilised, y, x, counts):
    """Newton's method from the predicted state, or from where it was interrupted. Returns how it ended and the last |dq|."""
    last, now, rows = y.marks[MOVED], x.now, x.rows
    if last == 0.0:
        predict(p, y, x)
        y.marks[ACCEL] *= 0.9
        y.marks[ACCEL_CHANGE] *= 0.9
    call(f[table.BEGIN], w, k, address(y.past[Q]), address(y.past[V]), 0, 0, 0, 0)
    if stabilised and last == 0.0:
        zero(now[GGL])
    state = address(now[Q]), address(now[V]), address(now[A]), address(rows[LAM])
    r, phi, dq, dlam = address(now[R]), address(rows[PHI]), address(now[DQ]), address(rows[DLAM])
    for iteration in range(p.max_iterations):
        ended = call(f[table.RESIDUAL], w, k, state[0], state[1], state[2], state[3], r, phi)
        counts[0] += 1
        if ended == DONE and p.incremental:
            ended, _ = constraints(f, w, k, p, y, x)
        if ended == DONE and (stabilised or p.velocity_rows.shape[0]):
            ended = add_rates(f, w, k, p, x, stabilised)
        if ended != DONE:
            return ended, last
        ended = call(f[table.SOLVE], w, k, state[0], state[3], r, phi, dq, dlam)
        counts[1] += 1
        moved, converged, fails, allowed = correct(p, y, x, iteration == 1, last)
        if ended == DONE and stabilised:
            ended = correct_ggl(f, w, k, p, y, x)
        if ended != DONE:
            return ended, last
        if converged:
            ended, worst = constraints(f, w, k, p, y, x)
            if ended != DONE:
                return ended, last
            if worst <= allowed:
                return settle(f, w, k, x, stabilised), moved
        if fails:
            return REFACTOR, moved
        last = moved
    return REFACTOR, last


@entry
def stretch(f, w, first, p, c, stabilised, y, x, counts, qs, vs, accelerations, lams):
    """Take steps until the frames are full, a factor is needed or h is to change: (steps, how it ended, last |dq|).

    f, w: addresses of the table's functions and of the model's workspace; first: number of the instant at the first step's end; c (10,):
    numbers of a step, for the model; counts (3,): of residuals, solves and matrices made. Frames are written to qs, vs, accelerations
    (steps, n) and lams (steps, m).
    """
    moved = 0.0
    strains = p.unknowns < x.now.shape[1]
    for k in range(lams.shape[0]):
        if strains:
            call(f[table.STRAINS], w, first + k, address(y.past), 0, 0, address(c), 0, 0)
        end, moved = newton(f, w, first + k, p, stabilised, y, x, counts)
        if strains and (end != DONE or p.control > 0.0):
            call(f[table.STRAINS], w, first + k, address(y.past), address(x.now), address(x.now), address(c), 0, 0)
        if f[table.FACTOR] and (end in (REFACTOR, NOT_FINITE)):
            y.marks[MOVED] = y.marks[AHEAD] = y.marks[BEHIND] = 0.0
            predict(p, y, x)
            at, lam = x.now, address(x.rows[LAM])
            end = call(f[table.FACTOR], w, first + k, address(at[Q]), address(at[V]), address(at[A]), lam, address(c), 0)
            counts[2] += 1
            y.marks[CONTRACTION], y.marks[AGE] = 1.0, FRESHEN
            if end == DONE:
                end, moved = newton(f, w, first + k, p, stabilised, y, x, counts)
        if end != DONE:
            return k, end, moved
        end = end_step(f, w, first + k, p, c, y, x, k, qs, vs, accelerations, lams)
        if end != DONE:
            return (k if end == ERROR_LARGE else k + 1), end, moved
    return lams.shape[0], DONE, moved
