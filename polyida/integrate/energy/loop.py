"""The compiled loop of the energy-momentum method: stretches of steps of any model, through its table (polyida.system).

Newton's method on dq of the end. The derivative of the residual is `S/2`, `S = (4/h^2) M + (2/h) C + K` at the middle, a step matrix, except
for what is not symmetric and for the Jacobian of phi, which is that at the end and not at the middle. Newton's method converges with both, to
the root of the exact residual. A velocity row psi is a row with phi = 0 at the end; its equation is `psi = 0` in the middle, `W dq = -h psi`.

It starts from extrapolated a and lam, each by the polynomial that would have been nearest in the last step, and ends after one correction if
the contraction measured in earlier steps leaves less than the tolerance.
"""

from typing import NamedTuple

import numpy as np

from polyida import system as table
from polyida.errors import DONE, NOT_FINITE, REFACTOR
from polyida.jit import entry, pack, part
from polyida.linear.dense import zero
from polyida.system import instant as ask

# constants of compiled code: rows of `now` (NOW, n), the first five as MIDDLE takes them, and of `rows` (ROWS, m)
Q0, Q1, QM, VM, AM, V0, V1, R, DQ, A = range(10)  # from A on: backward differences of the accelerations of the last steps
TERMS = 5
NOW = A + TERMS
PHI, DLAM, LAM, LAMS = range(4)  # from LAMS on: backward differences of the multipliers
ROWS = LAMS + TERMS
ORDER, ORDER_LAM, CONTRACTION, AGE, ERRORS = range(5)  # of `marks`: orders of the polynomials; contraction, its age in steps; workspace
MARKS = ERRORS + TERMS
FREE, PROJECTED, FRAMES_PROJECTED = range(3)  # v_1: as it is; on its constraint; on it in frames only, with unchanged kinetic energy
EPS = 2.0**-52
SLOW = 0.3  # contraction above which the matrix is made anew
FRESHEN = 10  # steps after which the contraction is measured again
RESIDUALS, SOLVES, FACTORS = range(3)  # of the counts
UNSEEN = 2.0**-4  # share of the tolerance that Newton may leave by the contraction of an earlier step


@pack
class Method(NamedTuple):
    """Numbers of the method at one h."""

    h: float  # s
    numbers: np.ndarray  # (2,) 4/h^2 and 2/h, of the step matrix
    tolerance: float  # of dq, over h^2 |a|
    max_iterations: int
    extent: float  # of the model, m, whose round-off is that of q
    kind: int  # what v_1 becomes: FREE, PROJECTED or FRAMES_PROJECTED
    velocity_rows: np.ndarray  # their numbers among the rows


@part
def extrapolate(history, first, order, out):
    """history[out] = the polynomial of an order through the last values, one step ahead."""
    for i in range(history.shape[1]):
        total = history[first, i]
        for j in range(1, order + 1):
            total += history[first + j, i]
        history[out, i] = total


@part
def remember(history, value, first, errors):
    """Add history[value] to the backward differences. Returns the order of the polynomial that would have been nearest to it."""
    zero(errors)
    for i in range(history.shape[1]):
        new = history[value, i]
        for j in range(TERMS):
            old = history[first + j, i]
            history[first + j, i] = new
            new -= old
            errors[j] += new * new
    best = 0
    for j in range(1, TERMS):
        if errors[j] < errors[best]:
            best = j
    return float(best)


@part
def predict(h, now, rows, marks):
    """The end by extrapolated accelerations, and extrapolated multipliers."""
    extrapolate(now, A, int(marks[ORDER]), AM)
    extrapolate(rows, LAMS, int(marks[ORDER_LAM]), LAM)
    for i in range(now.shape[1]):
        now[Q1, i] = now[Q0, i] + h * (now[V0, i] + 0.5 * h * now[AM, i])


@part
def fill_middle(h, now):
    """Set q, v and a of the middle from q and v at the beginning and q at the end."""
    for i in range(now.shape[1]):
        now[VM, i] = (now[Q1, i] - now[Q0, i]) / h
        now[AM, i] = 2.0 * (now[VM, i] - now[V0, i]) / h
        now[QM, i] = 0.5 * (now[Q0, i] + now[Q1, i])


@part
def correct(now, rows):
    """Move the end by dq, the multipliers by half of dlam. Returns the largest dq, q and acceleration, and True if dq is finite."""
    moved = size = accel = finite = 0.0
    for i in range(now.shape[1]):
        now[Q1, i] += now[DQ, i]
        finite += 0.0 * now[DQ, i]
        moved = max(moved, abs(now[DQ, i]))
        size = max(size, abs(now[Q1, i]))
        accel = max(accel, abs(now[AM, i]))
    for k in range(rows.shape[1]):
        rows[LAM, k] += 0.5 * rows[DLAM, k]
    return moved, size, accel, finite == 0.0


@part
def residual(model, instant, method, now, rows):
    """Fill twice r of the middle, phi of the end, and the velocity rows of the middle. Returns a status."""
    velocity_rows = method.velocity_rows
    fill_middle(method.h, now)
    status = ask.middle(model, instant, now, rows[LAM], now[R], rows[PHI])
    if status == DONE and velocity_rows.shape[0]:
        status = ask.rate(model, instant - 1, now[QM], now[VM], rows[DLAM], 0)
        for i in range(velocity_rows.shape[0]):
            rows[PHI, velocity_rows[i]] = method.h * rows[DLAM, velocity_rows[i]]
    for i in range(now.shape[1]):
        now[R, i] *= 2.0
    return status


@part
def newton(model, instant, method, now, rows, marks, counts):
    """Newton's method from the predicted end. Returns (status, the last |dq|).

    It ends if the error left by a correction, |dq| k/(1 - k) with the contraction k, is below the tolerance, or if dq is round-off of q; it fails
    (REFACTOR) where it contracts slowly, unless dq is nearly round-off.
    """
    h, before = method.h, 0.0
    for iteration in range(method.max_iterations):
        status = residual(model, instant, method, now, rows)
        counts[RESIDUALS] += 1
        if status != DONE:
            return status, before
        status = ask.solve(model, instant, now[Q1], rows[LAM], now[R], rows[PHI], now[DQ], rows[DLAM])
        if status != DONE:
            return status, before
        counts[SOLVES] += 1
        moved, size, accel, finite = correct(now, rows)
        if not finite:
            return NOT_FINITE, before
        rate, share = (1.0 + marks[AGE]) * marks[CONTRACTION], UNSEEN
        if before > 0.0:
            rate, share = moved / before, 1.0
            marks[CONTRACTION] = max(rate, 0.5 * marks[CONTRACTION] if iteration == 1 else marks[CONTRACTION])
            marks[AGE] = 0.0
        known = (before > 0.0 or marks[AGE] < FRESHEN) and rate < 1.0
        if moved <= 4.0 * EPS * size or (known and moved * rate / (1.0 - rate) <= share * method.tolerance * h * h * accel):
            return ask.accept(model, instant, now[Q1]), moved
        if iteration > 1 and rate > SLOW:
            close = moved <= 256.0 * EPS * (size + method.extent)
            return (ask.accept(model, instant, now[Q1]) if close else REFACTOR), moved
        before = moved
    return REFACTOR, before


@part
def project(model, instant, q, v, rate):
    """Project v onto the velocity constraint of the end; rate: workspace. Returns a status."""
    status = ask.rate(model, instant, q, v, rate, 0)
    return ask.project(model, instant, rate, v, 0) if status == DONE else status


@part
def end_step(model, instant, method, now, rows, marks, q, v):
    """Fill the frame of the end, and begin the next step there. Returns a status."""
    total = 0.0
    for i in range(now.shape[1]):
        now[V1, i] = 2.0 * (now[Q1, i] - now[Q0, i]) / method.h - now[V0, i]
        now[AM, i] = (now[V1, i] - now[V0, i]) / method.h
    if method.kind == PROJECTED:
        status = project(model, instant, now[Q1], now[V1], rows[DLAM])
        if status != DONE:
            return status
    for i in range(now.shape[1]):
        q[i], v[i] = now[Q1, i], now[V1, i]
        total += 0.0 * v[i]
    if total != 0.0:
        return NOT_FINITE
    for i in range(now.shape[1]):
        now[V0, i], now[Q0, i] = now[V1, i], now[Q1, i]
    marks[ORDER] = remember(now, AM, A, marks[ERRORS:])
    marks[ORDER_LAM] = remember(rows, LAM, LAMS, marks[ERRORS:])
    marks[AGE] += 1.0
    return DONE


@part
def factor(model, instant, method, now, rows, marks, counts):
    """Make the step matrix at the middle of the predicted step, from which Newton's method begins anew. Returns a status."""
    marks[ORDER] = marks[ORDER_LAM] = 0.0
    marks[CONTRACTION], marks[AGE] = 1.0, FRESHEN
    predict(method.h, now, rows, marks)
    fill_middle(method.h, now)
    counts[FACTORS] += 1
    return ask.factor(model, instant - 1, now[QM], now[VM], now[AM], rows[LAM], method.numbers)


@entry
def take_steps(functions, workspace, first, method, now, rows, marks, counts, qs, vs):
    """Take steps until the frames are full or a factor is needed. Returns (steps, status, the last |dq|).

    functions, workspace: of the model's table (system/instant.py); first: number of the first step; counts (3,): of residuals, solves and
    matrices made. q and v from which the next steps begin are written to qs, vs (steps, n).
    """
    model, moved = (functions, workspace), 0.0
    for k in range(qs.shape[0]):
        instant = 2 * (first + k) + 1
        predict(method.h, now, rows, marks)
        status, moved = newton(model, instant, method, now, rows, marks, counts)
        if ask.provides(model, table.FACTOR) and status in (REFACTOR, NOT_FINITE):
            status = factor(model, instant, method, now, rows, marks, counts)
            if status == DONE:
                status, moved = newton(model, instant, method, now, rows, marks, counts)
        if status == DONE:
            status = end_step(model, instant, method, now, rows, marks, qs[k], vs[k])
        if status != DONE:
            return k, status, moved
    return qs.shape[0], DONE, moved


@entry
def project_frames(functions, workspace, first, qs, vs, rate):
    """Project velocities (steps, n) onto their constraints. Returns a status."""
    for k in range(qs.shape[0]):
        status = project((functions, workspace), first + k, qs[k], vs[k], rate)
        if status != DONE:
            return status
    return DONE


@entry
def forces(functions, workspace, first, qs, vs, accelerations, lams):
    """Consistent accelerations and multipliers of the ends from `first` on. Returns a status."""
    for k in range(qs.shape[0]):
        status = ask.acceleration((functions, workspace), first + k, qs[k], vs[k], accelerations[k], lams[k])
        if status != DONE:
            return status
    return DONE
