"""The compiled loop of the energy-momentum method: stretches of steps of a model, through its table (system/table.py).

Newton on dq of the end. The derivative of the residual is `S/2`, `S = (4/h^2) M + (2/h) C + K` at the middle, which is a step matrix, but for
what is not symmetric and for the Jacobian of phi at the end in place of that at the middle. Both are near enough for Newton to contract, and
what it converges to is the exact residual's root.
"""

import numpy as np

from polyida.integrate.energy.steps import SLOW
from polyida.jit import entry, part
from polyida.system import table
from polyida.system.table import DONE, NOT_FINITE, REFACTOR, address, call

# constants of compiled code: rows of `now` (NOW, n), the first five as MIDDLE takes them, and of `rows` (ROWS, m)
Q0, Q1, QM, VM, AM, V0, V1, V, GUESS, R, DQ = range(11)
NOW = 11
LAM, KNOWN, PHI, DLAM, RATE = range(5)
ROWS = 5
FREE, DRIVEN, TURNING = range(3)  # what v_1 needs: nothing; to be put on its constraint; that in frames alone, as fast as it was
EPS = 2.0**-52


@part
def predict(h, now, rows):
    """The end where the last accelerations lead."""
    for i in range(now.shape[1]):
        now[Q1, i] = now[Q0, i] + h * now[V0, i] + 0.5 * h * h * now[GUESS, i]
    for k in range(rows.shape[1]):
        rows[LAM, k] = rows[KNOWN, k]


@part
def fill_middle(h, now):
    """q, v and a of the middle."""
    for i in range(now.shape[1]):
        now[VM, i] = (now[Q1, i] - now[Q0, i]) / h
        now[AM, i] = 2.0 * (now[VM, i] - now[V0, i]) / h
        now[QM, i] = 0.5 * (now[Q0, i] + now[Q1, i])


@part
def correct(now, rows):
    """Move the end by dq, the multipliers by half of dlam; the largest entries of dq, q and the acceleration, and whether dq is finite."""
    moved = size = pull = finite = 0.0
    for i in range(now.shape[1]):
        now[Q1, i] += now[DQ, i]
        finite += 0.0 * now[DQ, i]
        moved = max(moved, abs(now[DQ, i]))
        size = max(size, abs(now[Q1, i]))
        pull = max(pull, abs(now[AM, i]))
    for k in range(rows.shape[1]):
        rows[LAM, k] += 0.5 * rows[DLAM, k]
    return moved, size, pull, finite == 0.0


@part
def newton(f, w, instant, h, tolerance, most, extent, now, rows, counts):
    """Newton's iteration from the predicted end. Returns how it ended and the last |dq|."""
    before = 0.0
    places = address(now[Q1]), address(rows[LAM]), address(now[R]), address(rows[PHI]), address(now[DQ]), address(rows[DLAM])
    for iteration in range(most):
        fill_middle(h, now)
        ended = call(f[table.MIDDLE], w, instant, address(now), places[1], places[2], places[3], 0, 0)
        counts[0] += 1
        if ended != DONE:
            return ended, before
        for i in range(now.shape[1]):
            now[R, i] *= 2.0
        ended = call(f[table.SOLVE], w, instant, places[0], places[1], places[2], places[3], places[4], places[5])
        if ended != DONE:
            return ended, before
        counts[1] += 1
        moved, size, pull, finite = correct(now, rows)
        if not finite:
            return NOT_FINITE, before
        rate = moved / before if before > 0.0 else 1.0
        if moved <= 4.0 * EPS * size or (iteration > 0 and rate < 1.0 and moved * rate / (1.0 - rate) <= tolerance * h * h * pull):
            return call(f[table.ACCEPT], w, instant, places[0], 0, 0, 0, 0, 0), moved
        if iteration > 1 and rate > SLOW:
            close = moved <= 256.0 * EPS * (size + extent)
            return (call(f[table.ACCEPT], w, instant, places[0], 0, 0, 0, 0, 0) if close else REFACTOR), moved
        before = moved
    return REFACTOR, before


@part
def put(f, w, instant, now, rows):
    """v onto the velocity constraint of the end."""
    ended = call(f[table.RATE], w, instant, address(now[Q1]), address(now[V]), address(rows[RATE]), 0, 0, 0)
    return call(f[table.PROJECT], w, instant, address(rows[RATE]), address(now[V]), 0, 0, 0, 0) if ended == DONE else ended


@part
def put_as_fast(f, w, instant, now, rows, energies):
    """The same, v with the kinetic energy that it had."""
    call(f[table.KINETIC], w, instant, address(now[V]), address(energies), 0, 0, 0, 0)
    ended = put(f, w, instant, now, rows)
    call(f[table.KINETIC], w, instant, address(now[V]), address(energies) + 8, 0, 0, 0, 0)
    if energies[1] > 0.0:
        faster = np.sqrt(energies[0] / energies[1])
        for i in range(now.shape[1]):
            now[V, i] *= faster
    return ended


@part
def finish(f, w, instant, h, kind, now, rows, energies, q, v, a, lam):
    """Make the frame of the end, and take that as the next beginning."""
    for i in range(now.shape[1]):
        now[V, i] = now[V1, i] = 2.0 * (now[Q1, i] - now[Q0, i]) / h - now[V0, i]
    ended, total = DONE, 0.0
    if kind == DRIVEN:
        ended = put(f, w, instant, now, rows)
        for i in range(now.shape[1]):
            now[V1, i] = now[V, i]
    elif kind == TURNING and f[table.ACCELERATION]:
        ended = put_as_fast(f, w, instant, now, rows, energies)
    for i in range(now.shape[1]):
        q[i], v[i] = now[Q1, i], now[V, i]
        total += 0.0 * v[i]
    if ended == DONE and f[table.ACCELERATION]:
        ended = call(f[table.ACCELERATION], w, instant, address(q), address(v), address(a), address(lam), 0, 0)
    if ended != DONE or total != 0.0:
        return NOT_FINITE if ended == DONE else ended
    for i in range(now.shape[1]):
        now[GUESS, i] = (2.0 * (now[Q1, i] - now[Q0, i]) / h - 2.0 * now[V0, i]) / h
        now[V0, i], now[Q0, i] = now[V1, i], now[Q1, i]
    for k in range(rows.shape[1]):
        rows[KNOWN, k] = rows[LAM, k]
    return DONE


@entry
def stretch(f, w, first, c, h, tolerance, most, extent, kind, now, rows, counts, qs, vs, accelerations, lams):
    """Steps until the frames or the factor's use end: (steps, how it ended, last |dq|).

    f, w: addresses of the table's functions and of the model's workspace; first: number of the first step; c (2,): 4/h^2 and 2/h. counts (3,): of residuals,
    solves and matrices made. Frames go to qs, vs, accelerations (steps, n), lams (steps, m); the last two are of no length where they are made when they are asked for,
    vs then holds what the next step begins with.
    """
    moved, energies = 0.0, np.zeros(2)
    for k in range(qs.shape[0]):
        instant = 2 * (first + k) + 1
        predict(h, now, rows)
        ended, moved = newton(f, w, instant, h, tolerance, most, extent, now, rows, counts)
        if f[table.FACTOR] and ended in (REFACTOR, NOT_FINITE):
            predict(h, now, rows)
            fill_middle(h, now)
            places = address(now[QM]), address(now[VM]), address(now[AM]), address(rows[LAM]), address(c)
            ended = call(f[table.FACTOR], w, instant - 1, places[0], places[1], places[2], places[3], places[4], 0)
            counts[2] += 1
            if ended == DONE:
                ended, moved = newton(f, w, instant, h, tolerance, most, extent, now, rows, counts)
        if ended != DONE:
            return k, ended, moved
        j = min(k, lams.shape[0] - 1)
        ended = finish(f, w, instant, h, kind, now, rows, energies, qs[k], vs[k], accelerations[j], lams[j])
        if ended != DONE:
            return k, ended, moved
    return qs.shape[0], DONE, moved
