"""The compiled loop of the energy-momentum method: stretches of steps of any model, through its table (polyida.system).

Newton's method on dq of the end. The derivative of the residual is `S/2`, `S = (4/h^2) M + (2/h) C + K` at the middle, a step matrix, except
for what is not symmetric and for the Jacobian of phi, which is that at the end and not at the middle. Newton's method converges with both, to
the root of the exact residual. A velocity row psi is a row with phi = 0 at the end; its equation is `psi = 0` in the middle, `W dq = -h psi`.

It starts from extrapolated a and lam, each by the polynomial that would have been nearest in the last step, and ends after one correction if
the contraction measured in earlier steps leaves less than the tolerance.
"""

from polyida import system as table
from polyida.errors import DONE, NOT_FINITE, REFACTOR
from polyida.jit import entry, part
from polyida.jit.intrinsics import address, call
from polyida.linear.dense import zero

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
UNSEEN = 2.0**-4  # share of the tolerance that Newton may leave by the contraction of an earlier step


@part
def extrapolate(x, first, order, out):
    """x[out] = the polynomial of an order through the last values, one step ahead."""
    for i in range(x.shape[1]):
        total = x[first, i]
        for j in range(1, order + 1):
            total += x[first + j, i]
        x[out, i] = total


@part
def remember(x, value, first, errors):
    """Add x[value] to the backward differences. Returns the order of the polynomial that would have been nearest to it."""
    zero(errors)
    for i in range(x.shape[1]):
        new = x[value, i]
        for j in range(TERMS):
            old = x[first + j, i]
            x[first + j, i] = new
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
    """q, v and a of the middle."""
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
def newton(f, w, instant, h, tolerance, most, extent, velocity_rows, now, rows, marks, counts):
    """Newton's method from the predicted end. Returns how it ended and the last |dq|."""
    before = 0.0
    places = address(now[Q1]), address(rows[LAM]), address(now[R]), address(rows[PHI]), address(now[DQ]), address(rows[DLAM])
    for iteration in range(most):
        fill_middle(h, now)
        ended = call(f[table.MIDDLE], w, instant, address(now), places[1], places[2], places[3], 0, 0)
        counts[0] += 1
        if ended != DONE:
            return ended, before
        if velocity_rows.shape[0]:
            ended = call(f[table.RATE], w, instant - 1, address(now[QM]), address(now[VM]), places[5], 0, 0, 0)
            if ended != DONE:
                return ended, before
            for i in range(velocity_rows.shape[0]):
                rows[PHI, velocity_rows[i]] = h * rows[DLAM, velocity_rows[i]]
        for i in range(now.shape[1]):
            now[R, i] *= 2.0
        ended = call(f[table.SOLVE], w, instant, places[0], places[1], places[2], places[3], places[4], places[5])
        if ended != DONE:
            return ended, before
        counts[1] += 1
        moved, size, accel, finite = correct(now, rows)
        if not finite:
            return NOT_FINITE, before
        rate, share = (1.0 + marks[AGE]) * marks[CONTRACTION], UNSEEN
        if before > 0.0:
            rate, share = moved / before, 1.0
            marks[CONTRACTION], marks[AGE] = max(rate, 0.5 * marks[CONTRACTION] if iteration == 1 else marks[CONTRACTION]), 0.0
        known = (before > 0.0 or marks[AGE] < FRESHEN) and rate < 1.0
        if moved <= 4.0 * EPS * size or (known and moved * rate / (1.0 - rate) <= share * tolerance * h * h * accel):
            return call(f[table.ACCEPT], w, instant, places[0], 0, 0, 0, 0, 0), moved
        if iteration > 1 and rate > SLOW:
            close = moved <= 256.0 * EPS * (size + extent)
            return (call(f[table.ACCEPT], w, instant, places[0], 0, 0, 0, 0, 0) if close else REFACTOR), moved
        before = moved
    return REFACTOR, before


@part
def project(f, w, instant, q, v, rate):
    """Project v onto the velocity constraint of the end; rate: address of workspace."""
    ended = call(f[table.RATE], w, instant, q, v, rate, 0, 0, 0)
    return call(f[table.PROJECT], w, instant, rate, v, 0, 0, 0, 0) if ended == DONE else ended


@part
def end_step(f, w, instant, h, kind, now, rows, marks, q, v):
    """Fill the frame of the end, and begin the next step there. Returns how the step ended."""
    total = 0.0
    for i in range(now.shape[1]):
        now[V1, i] = 2.0 * (now[Q1, i] - now[Q0, i]) / h - now[V0, i]
        now[AM, i] = (now[V1, i] - now[V0, i]) / h
    if kind == PROJECTED:
        ended = project(f, w, instant, address(now[Q1]), address(now[V1]), address(rows[DLAM]))
        if ended != DONE:
            return ended
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


@entry
def stretch(f, w, first, c, h, tolerance, most, extent, kind, velocity_rows, now, rows, marks, counts, qs, vs):
    """Take steps until the frames are full or a factor is needed: (steps, how it ended, last |dq|).

    f, w: addresses of the table's functions and of the model's workspace; first: number of the first step; c (2,): 4/h^2 and 2/h; counts (3,):
    of residuals, solves and matrices made. q and v from which the next steps begin are written to qs, vs (steps, n).
    """
    moved = 0.0
    for k in range(qs.shape[0]):
        instant = 2 * (first + k) + 1
        predict(h, now, rows, marks)
        ended, moved = newton(f, w, instant, h, tolerance, most, extent, velocity_rows, now, rows, marks, counts)
        if f[table.FACTOR] and ended in (REFACTOR, NOT_FINITE):
            marks[ORDER] = marks[ORDER_LAM] = 0.0
            marks[CONTRACTION], marks[AGE] = 1.0, FRESHEN
            predict(h, now, rows, marks)
            fill_middle(h, now)
            places = address(now[QM]), address(now[VM]), address(now[AM]), address(rows[LAM]), address(c)
            ended = call(f[table.FACTOR], w, instant - 1, places[0], places[1], places[2], places[3], places[4], 0)
            counts[2] += 1
            if ended == DONE:
                ended, moved = newton(f, w, instant, h, tolerance, most, extent, velocity_rows, now, rows, marks, counts)
        if ended == DONE:
            ended = end_step(f, w, instant, h, kind, now, rows, marks, qs[k], vs[k])
        if ended != DONE:
            return k, ended, moved
    return qs.shape[0], DONE, moved


@entry
def project_frames(f, w, first, qs, vs, rate):
    """Project velocities (steps, n) onto their constraints. Returns how it ended."""
    for k in range(qs.shape[0]):
        ended = project(f, w, first + k, address(qs[k]), address(vs[k]), address(rate))
        if ended != DONE:
            return ended
    return DONE


@entry
def forces(f, w, first, qs, vs, accelerations, lams):
    """Consistent accelerations and multipliers of the ends from `first` on. Returns how it ended."""
    for k in range(qs.shape[0]):
        ended = call(f[table.ACCELERATION], w, first + k, address(qs[k]), address(vs[k]), address(accelerations[k]), address(lams[k]), 0, 0)
        if ended != DONE:
            return ended
    return DONE
