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
from polyida.linear.dense import put, zero
from polyida.system import instant as ask

EPS = 2.0**-52
SLOW = 0.3  # contraction above which the matrix is made anew
FRESHEN = 10  # steps after which the contraction is measured again
PATIENCE = 6  # steps with a small error before the step grows
LARGEST_FACTOR = 4.0  # of an earlier change in a prediction; a straight line needs 2
# of Begin.marks; norms are root mean squares
CONTRACTION, AGE = range(2)  # of Newton's method, and its age in steps
# norms of q'' and of its change in a step: largest so far, of this iteration
ACCEL, ACCEL_CHANGE, NEW_ACCEL, NEW_ACCEL_CHANGE = range(2, 6)
AHEAD, BEHIND = range(6, 8)  # factors of the last two changes in the prediction
MOVED = 8  # the last |dq| of an iteration from which Newton's method goes on, or one of these two
NEW_STEP, GIVEN = 0.0, np.nan  # predict first; go on from the trial state, with no |dq| known
ERROR, SINCE = range(9, 11)  # largest local error of the last SINCE steps
MARKS = 11
RESIDUALS, SOLVES, FACTORS = range(3)  # of the counts


@pack
class Method(NamedTuple):
    """Numbers of the method at one h."""

    h: float  # s
    alpha_m: float  # of the family, as beta and gamma
    alpha_f: float
    beta: float
    gamma: float
    to_a: float  # dq''/dq in Newton's method, 1/s^2
    to_v: float  # dv/dq, 1/s
    least: float  # Newton may leave `share` of the change of q'' in the step, within least and most of q'', over to_a
    most: float
    share: float
    extent: float  # of the coordinates, m, whose round-off is that of phi
    incremental: bool  # phi is carried by increments
    max_iterations: int
    control: float  # |C| h^2 of the local error, of which atol + rtol |q| is allowed; 0: fixed steps
    rtol: float
    atol: float
    grow: float  # local error over the allowed one below which h may grow
    before: float  # weight of the change of q'' in the step before, over that in this step, in the error
    velocity_rows: np.ndarray  # their numbers among the rows
    unknowns: int  # coordinates that Newton's method moves; relaxed strains, behind them, follow at the end of a step


@pack
class Begin(NamedTuple):
    """The state at which a step begins, and what is remembered of earlier steps."""

    past: np.ndarray  # (9, n) whose rows are q to places
    rows: np.ndarray  # (3, m) whose rows are lam, phi and rate
    marks: np.ndarray  # (MARKS,)
    q: np.ndarray  # (n,), as all up to places
    v: np.ndarray
    a: np.ndarray  # q''
    a_alg: np.ndarray  # the algorithmic acceleration
    change: np.ndarray  # of q'' in the last step
    earlier: np.ndarray  # of q'' in the step before that
    masses: np.ndarray  # weights in the mean square of the local error
    shares: np.ndarray  # weights in that of Newton's method
    places: np.ndarray  # weights in that of |q|, which the local error is relative to: masses without integrals of states
    lam: np.ndarray  # (m,)
    phi: np.ndarray  # (m,), as it is carried
    rate: np.ndarray  # (m,) phi_q v + phi_t, as it is carried


@pack
class Trial(NamedTuple):
    """An iterate `q = q_0 + (h v_0 + moved)` of Newton's method, its residuals and its correction."""

    now: np.ndarray  # (8, n) whose rows are q to slip
    q: np.ndarray  # (n,), as all up to slip
    v: np.ndarray
    a: np.ndarray  # q''
    moved: np.ndarray
    r: np.ndarray  # the residual
    dq: np.ndarray  # the correction
    dv: np.ndarray  # change of v in the step
    slip: np.ndarray  # the part of q from eta
    lam: np.ndarray  # (m,), as all that follow
    phi: np.ndarray
    rate: np.ndarray  # phi_q v + phi_t
    dlam: np.ndarray  # the correction of lam
    bias: np.ndarray  # the rows that slip closes


def empty(n, m):
    """(Begin, Trial): new packs of zeros, of the state at which a step begins and of the trial state; n coordinates, m constraints."""
    past, rows, now = np.zeros((9, n)), np.zeros((3, m)), np.zeros((8, n))
    return Begin(past, rows, np.zeros(MARKS), *past, *rows), Trial(now, *now, *np.zeros((5, m)))


@entry
def predict(method, begin, trial):
    """Fill the trial state: q'' by the combination of earlier changes that fits the last step best, lam constant."""
    h, alpha_m, alpha_f = method.h, method.alpha_m, method.alpha_f
    ahead, behind = begin.marks[AHEAD], begin.marks[BEHIND]
    for i in range(method.unknowns):
        a0, a_alg = begin.a[i], begin.a_alg[i]
        a = a0 + ahead * begin.change[i] + behind * begin.earlier[i]
        a1 = ((1.0 - alpha_f) * a + alpha_f * a0 - alpha_m * a_alg) / (1.0 - alpha_m)
        moved = h * h * ((0.5 - method.beta) * a_alg + method.beta * a1)
        trial.a[i] = a
        trial.v[i] = begin.v[i] + h * ((1.0 - method.gamma) * a_alg + method.gamma * a1)
        trial.moved[i] = moved
        trial.q[i] = begin.q[i] + (h * begin.v[i] + moved)
    put(1.0, begin.lam, trial.lam)


@fast
def correct(method, begin, trial, first, last):
    """Add dq and dlam to the trial state. Returns what `convergence` returns; last: |dq| of the iteration before, or 0."""
    moved = length = size = accel = change = 0.0
    for i in range(method.unknowns):
        d, share = trial.dq[i], begin.shares[i]
        trial.moved[i] += d
        trial.q[i] += d
        trial.v[i] += method.to_v * d
        trial.a[i] += method.to_a * d
        moved += share * d * d
        length += share * trial.moved[i] * trial.moved[i]
        size += share * trial.q[i] * trial.q[i]
        accel += share * trial.a[i] * trial.a[i]
        change += share * (trial.a[i] - begin.a[i]) ** 2
    for k in range(trial.lam.shape[0]):
        trial.lam[k] += trial.dlam[k]
    return convergence(method, begin.marks, first, last, np.sqrt(moved), np.sqrt(length), np.sqrt(size), np.sqrt(accel), np.sqrt(change))


@part
def convergence(method, marks, first, last, moved, length, size, accel, change):
    """(|dq|, True if converged, True if Newton's method fails, the largest |phi| allowed), from the norms of dq, moved, q, q'' and its change.

    Converged: the error to be expected is below the tolerance, or dq is round-off and no longer falls.

    The judges of the other methods have other norms and limits, so that each is written beside its iteration: here the tolerance is one of q'',
    which jumps with h, and phi must be closed besides; Radau IIA takes one of q and h v over all stages, and gives up as soon as the iterations
    left cannot reach it; the energy-momentum method takes largest entries, as its round-off decides whether energy is kept.
    """
    measured, rate = last > 0.0, marks[CONTRACTION]
    if measured:
        rate = moved / last
        marks[CONTRACTION], marks[AGE] = max(rate, (0.5 if first else 1.0) * marks[CONTRACTION]), 0.0
    marks[NEW_ACCEL], marks[NEW_ACCEL_CHANGE] = max(marks[ACCEL], accel), max(marks[ACCEL_CHANGE], change)
    tolerance = (
        min(max(method.least * marks[NEW_ACCEL], method.share * marks[NEW_ACCEL_CHANGE]), method.most * marks[NEW_ACCEL]) / method.to_a
    )
    coarse = 16.0 * EPS * (size + method.extent)
    fine = 16.0 * EPS * (length if method.incremental else size)
    small = (measured or marks[AGE] < FRESHEN) and rate < 1.0 and moved * rate / (1.0 - rate) <= tolerance
    stalled = measured and rate > SLOW and moved <= coarse
    allowed = max(1e-2 * tolerance, 16.0 * fine if method.incremental and not stalled else coarse)
    return moved, small or stalled or moved <= fine, measured and rate > SLOW and moved > coarse, allowed


@part
def end_step(model, instant, method, numbers, begin, trial, row, frames):
    """Accept the trial state, unless its local error is too large, and copy it into a row of the frames. Returns how the step ended."""
    marks = begin.marks
    marks[AGE] += 1.0
    marks[ACCEL], marks[ACCEL_CHANGE] = marks[NEW_ACCEL], marks[NEW_ACCEL_CHANGE]
    if method.control > 0.0:
        error = local_error(method, begin, trial)
        marks[ERROR] = max(marks[ERROR], error)
        if not error <= 1.0:
            return ERROR_LARGE
    remember(method, begin, trial)
    qs, vs, accelerations, lams = frames
    if method.unknowns < qs.shape[1]:
        ask.end_strains(model, instant, begin.past, trial.now, begin.past, numbers)
    marks[MOVED] = NEW_STEP
    put(1.0, begin.q, qs[row])
    put(1.0, begin.v, vs[row])
    put(1.0, begin.a, accelerations[row])
    put(1.0, begin.lam, lams[row])
    if method.control > 0.0:
        marks[SINCE] += 1.0
        if marks[SINCE] >= PATIENCE:
            if marks[ERROR] < method.grow:
                return ERROR_SMALL
            marks[ERROR] = marks[SINCE] = 0.0
    return DONE


@fast
def local_error(method, begin, trial):
    """Local error of q over the allowed one, mass-weighted norms; from the change of q'' in this step alone if none went before."""
    change = earlier = size = 0.0
    for i in range(trial.q.shape[0]):
        before = method.before * begin.change[i]
        change += begin.masses[i] * (trial.a[i] - begin.a[i] + before) ** 2
        earlier += before * before
        size += begin.places[i] * trial.q[i] * trial.q[i]
    control = method.control / (1.0 + method.before) if earlier > 0.0 else method.control
    return control * np.sqrt(change) / max(method.atol + method.rtol * np.sqrt(size), 1e-300)


@fast
def remember(method, begin, trial):
    """Make the trial state that of the next step's beginning, with its algorithmic acceleration and the factors of the next prediction."""
    alpha_m, alpha_f = method.alpha_m, method.alpha_f
    aa = ab = bb = ad = bd = 0.0
    for i in range(method.unknowns):
        a, a0 = trial.a[i], begin.a[i]
        change, before, earlier = a - a0, begin.change[i], begin.earlier[i]
        aa += before * before
        ab += before * earlier
        bb += earlier * earlier
        ad += before * change
        bd += earlier * change
        begin.a_alg[i] = ((1.0 - alpha_f) * a + alpha_f * a0 - alpha_m * begin.a_alg[i]) / (1.0 - alpha_m)
        begin.change[i] = change
        begin.earlier[i] = before
        begin.q[i], begin.v[i], begin.a[i] = trial.q[i], trial.v[i], a
    put(1.0, trial.lam, begin.lam)
    put(1.0, trial.phi, begin.phi)
    put(1.0, trial.rate, begin.rate)
    begin.marks[AHEAD], begin.marks[BEHIND] = nearest(aa, ab, bb, ad, bd)


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
def constraints(model, instant, method, begin, trial):
    """Fill phi and its rate at the trial state. Returns (status, the largest |phi|)."""
    h, beta, gamma = method.h, method.beta, method.gamma
    for i in range(method.unknowns):
        a1 = (trial.moved[i] / (h * h) - (0.5 - beta) * begin.a_alg[i]) / beta
        trial.dv[i] = h * ((1.0 - gamma) * begin.a_alg[i] + gamma * a1)
    put(1.0, begin.phi, trial.phi)
    put(1.0, begin.rate, trial.rate)
    status = ask.constraints(model, instant, trial.q, trial.moved, trial.dv, trial.phi, trial.rate)
    worst = 0.0
    for k in range(trial.phi.shape[0]):
        worst = max(worst, abs(trial.phi[k]))
    return status, worst


@part
def add_rates(model, instant, method, trial, stabilised):
    """Fill the velocity rows of phi with psi/gamma'; if stabilised all rows with rate/gamma', for the solve of x, and bias with the rest."""
    status = ask.rate(model, instant, trial.q, trial.v, trial.bias, 0)
    for k in range(trial.phi.shape[0] if stabilised else 0):
        share = trial.bias[k] / method.to_v
        trial.bias[k] = trial.phi[k] - share
        trial.phi[k] = share
    for e in range(method.velocity_rows.shape[0]):
        k = method.velocity_rows[e]
        if not stabilised:
            trial.phi[k] = trial.bias[k] / method.to_v
        trial.bias[k] = 0.0
    return status


@part
def evaluate(model, instant, method, stabilised, begin, trial):
    """Fill r, phi and, where they are equations, the rates of the trial state. Returns a status."""
    status = ask.residual(model, instant, trial.q, trial.v, trial.a, trial.lam, trial.r, trial.phi)
    if status == DONE and method.incremental:
        status, _ = constraints(model, instant, method, begin, trial)
    if status == DONE and (stabilised or method.velocity_rows.shape[0]):
        status = add_rates(model, instant, method, trial, stabilised)
    return status


@part
def renew_slip(model, instant, method, begin, trial):
    """Compute the slip with phi_q of this iterate, and q with it."""
    for i in range(method.unknowns):
        trial.moved[i] -= trial.slip[i]
    status = ask.project(model, instant, trial.bias, trial.slip, 1)
    for i in range(method.unknowns):
        trial.moved[i] += trial.slip[i]
        trial.q[i] = begin.q[i] + (method.h * begin.v[i] + trial.moved[i])
    return status


@part
def settle(model, instant, trial, stabilised):
    """Ask the model to accept the state; in the stabilised form project v onto the velocity constraint."""
    status = ask.accept(model, instant, trial.q)
    if status == DONE and stabilised:
        status = ask.rate(model, instant, trial.q, trial.v, trial.rate, 0)
        if status == DONE:
            status = ask.project(model, instant, trial.rate, trial.v, 0)
            zero(trial.rate)
    return status


@part
def newton(model, instant, method, stabilised, begin, trial, counts):
    """Newton's method from the predicted state, or from where it was interrupted. Returns (status, the last |dq|)."""
    last = begin.marks[MOVED]
    if last == NEW_STEP:
        predict(method, begin, trial)
        begin.marks[ACCEL] *= 0.9
        begin.marks[ACCEL_CHANGE] *= 0.9
        if stabilised:
            zero(trial.slip)
    ask.begin(model, instant, begin.q, begin.v, None)
    for iteration in range(method.max_iterations):
        status = evaluate(model, instant, method, stabilised, begin, trial)
        counts[RESIDUALS] += 1
        if status != DONE:
            return status, last
        status = ask.solve(model, instant, trial.q, trial.lam, trial.r, trial.phi, trial.dq, trial.dlam)
        counts[SOLVES] += 1
        moved, converged, fails, allowed = correct(method, begin, trial, iteration == 1, last)
        if status == DONE and stabilised:
            status = renew_slip(model, instant, method, begin, trial)
        if status != DONE:
            return status, last
        if converged:
            status, worst = constraints(model, instant, method, begin, trial)
            if status != DONE:
                return status, last
            if worst <= allowed:
                return settle(model, instant, trial, stabilised), moved
        if fails:
            return REFACTOR, moved
        last = moved
    return REFACTOR, last


@part
def factor(model, instant, method, numbers, begin, trial, counts):
    """Make the step matrix at the predicted state, from which Newton's method begins anew. Returns a status."""
    marks = begin.marks
    marks[MOVED], marks[AHEAD], marks[BEHIND] = NEW_STEP, 0.0, 0.0
    predict(method, begin, trial)
    counts[FACTORS] += 1
    marks[CONTRACTION], marks[AGE] = 1.0, FRESHEN
    return ask.factor(model, instant, trial.q, trial.v, trial.a, trial.lam, numbers)


@entry
def take_steps(functions, workspace, first, method, numbers, stabilised, begin, trial, counts, frames):
    """Take steps until the frames are full, a factor is needed or h is to change. Returns (steps, status, the last |dq|).

    functions, workspace: of the model's table (system/instant.py); first: number of the instant at the first step's end; numbers (10,): of a
    step, for the model; counts (3,): of residuals, solves and matrices made; frames: q, v, a (steps, n) and lam (steps, m) of the ends.
    """
    model, moved, lams = (functions, workspace), 0.0, frames[3]
    strains = method.unknowns < trial.q.shape[0]
    for k in range(lams.shape[0]):
        instant = first + k
        if strains:
            ask.begin_strains(model, instant, begin.past, numbers)
        status, moved = newton(model, instant, method, stabilised, begin, trial, counts)
        if strains and (status != DONE or method.control > 0.0):
            ask.end_strains(model, instant, begin.past, trial.now, trial.now, numbers)
        if ask.provides(model, table.FACTOR) and status in (REFACTOR, NOT_FINITE):
            status = factor(model, instant, method, numbers, begin, trial, counts)
            if status == DONE:
                status, moved = newton(model, instant, method, stabilised, begin, trial, counts)
        if status != DONE:
            return k, status, moved
        status = end_step(model, instant, method, numbers, begin, trial, k, frames)
        if status != DONE:
            return (k if status == ERROR_LARGE else k + 1), status, moved
    return lams.shape[0], DONE, moved
