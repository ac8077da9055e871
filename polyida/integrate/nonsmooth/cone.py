"""The cone problem of rows with laws: pressures p = -lam and rates u = G p + b that satisfy the laws of contact and friction.

```
contact:   p = max(0, p - rho u)
friction:  p = clip(p - rho u, -c(p), c(p)),   c(p) = c_0 + mu |l_0 + L p|,   rho = 1/G_ii
slip:      p = -sign c(p), if the direction of slip is known
```
with the constant c_0 and the coefficient mu of friction, and its pressing entries l_0 + L p. `solve_cone` tries in this order:

1. `newton`: semismooth Newton on these equations (Alart, Curnier 1991), an active-set method, from the given start.
2. If its sets repeat, the same from the pressures with which all rows are at rest, G p + b = 0.
3. The same from the solution with the present bounds of friction, `solve_box_lcp`: a convex quadratic problem whose sets change one row at a time
   (Nocedal, Wright, Numerical Optimization (2006), section 16.5).
4. The same from projected Gauss-Seidel sweeps, `sweep`, a few times.
5. As 3., a few times: bounds that change little with the forces are then found though G is nearly singular.

Where G is singular, as with redundant contacts, pressures are those of least norm among the solutions near the start.
"""

from typing import NamedTuple

import numpy as np

from polyida.jit import entry, pack, part
from polyida.linear.dense import put, solve_small

CONTACT, FRICTION = 0, 1
OPEN, CLOSED, STICKS, SLIPS_UP, SLIPS_DOWN = range(5)  # statuses; SLIPS_UP: rate > 0
NEWTON = 30  # most iterations of Newton's method from one start
SWEEPS = 400  # of Gauss-Seidel in one round
ROUNDS = 4  # starts of Newton's method beyond the first two
AGAIN = 8  # further starts, from bounds of friction that are computed again
EXACT = 1e-13  # of the largest pressure: error of p
GOOD = 1e-8  # the same that is accepted if no iteration is better
LEAST = 1e-200  # of G_ii, which is round-off of either sign where a row cannot hold the motion, as friction at a dead point
REGULAR = 1e-9  # of G_ii, added to the matrix of Newton's method, not to the equations
CHANGES = 20  # for each row, of the sets of the problem with given bounds


@pack
class Cone(NamedTuple):
    """The laws of k rows: their bounds of friction are c + mu |l + L p|, |.| over the row's pressing entries."""

    kind: np.ndarray  # (k,) CONTACT or FRICTION
    c: np.ndarray  # (k,) constant of friction
    mu: np.ndarray  # (k,) its coefficient
    sign: np.ndarray  # (k,) 0, or the sign of the rate of a row that slips
    start: np.ndarray  # (k + 1,) first pressing entry of each row
    l: np.ndarray  # noqa: E741 (entries,) of the pressing entries
    L: np.ndarray  # (entries, k)


@part
def friction_bound(cone, forces, row, slope):
    """The bound c(p) of a row of friction at the forces p; fills its slope dc/dp (k,)."""
    slope[:] = 0.0
    square = 0.0
    for e in range(cone.start[row], cone.start[row + 1]):
        value = cone.l[e]
        for j in range(forces.shape[0]):
            value += cone.L[e, j] * forces[j]
        square += value * value
        for j in range(forces.shape[0]):
            slope[j] += value * cone.L[e, j]
    norm = np.sqrt(square)
    for j in range(forces.shape[0]):
        slope[j] *= cone.mu[row] / norm if norm > 0.0 else 0.0
    return cone.c[row] + cone.mu[row] * norm


@part
def row_status(cone, forces, rate, rho, row, limit):
    """The status of a row by its force and rate; limit: its bound of friction."""
    trial = forces[row] - rho * rate
    if cone.kind[row] == CONTACT:
        return CLOSED if trial > 0.0 else OPEN
    if cone.sign[row] != 0.0:
        return SLIPS_UP if cone.sign[row] > 0.0 else SLIPS_DOWN
    return SLIPS_DOWN if trial > limit else SLIPS_UP if trial < -limit else STICKS


@part
def row_rate(delassus, free_rates, forces, row):
    """(the rate of a row, G p + b, the largest of its terms)."""
    u, scale = free_rates[row], abs(free_rates[row])
    for j in range(forces.shape[0]):
        u += delassus[row, j] * forces[j]
        scale = max(scale, abs(delassus[row, j] * forces[j]))
    return u, scale


@part
def newton(delassus, free_rates, cone, forces, status, matrix, right, slope):
    """Iterate until the forces p no longer change; they and status are then the best ones. Returns (largest error over largest force, iterations).

    matrix (k, k), right, slope (k,): workspace. Each row of the matrix is the slope of the equation that holds with the row's present status.
    """
    k, least, best_forces, best_status = forces.shape[0], np.inf, forces.copy(), status.copy()
    for iteration in range(NEWTON):
        error, size, same, finite = 0.0, 0.0, iteration > 0, True
        for i in range(k):
            u, scale = row_rate(delassus, free_rates, forces, i)
            rho = 1.0 / delassus[i, i]
            limit = friction_bound(cone, forces, i, slope) if cone.kind[i] == FRICTION else 0.0
            now = row_status(cone, forces, u, rho, i, limit)
            same = same and now == status[i]
            status[i] = now
            if now in (CLOSED, STICKS):
                for j in range(k):
                    matrix[i, j] = delassus[i, j] * rho
                matrix[i, i] += REGULAR
                right[i] = -u * rho
            elif now == OPEN:
                matrix[i, :] = 0.0
                matrix[i, i] = 1.0
                right[i] = -forces[i]
            else:
                direction = 1.0 if now == SLIPS_UP else -1.0  # p = -direction c(p)
                for j in range(k):
                    matrix[i, j] = direction * slope[j]
                matrix[i, i] += 1.0
                right[i] = -forces[i] - direction * limit
            error, size = max(error, abs(right[i])), max(size, abs(forces[i]), limit if now >= SLIPS_UP else rho * scale)
            finite = finite and np.isfinite(right[i])
        if not finite:
            break
        error = error / size if size > 0.0 else 0.0
        if error <= EXACT or (same and error <= 100.0 * EXACT):
            return error, iteration
        if error < least:
            least = error
            put(1.0, forces, best_forces)
            best_status[:] = status
        if not solve_small(matrix, right):
            break
        for i in range(k):
            forces[i] += right[i]
    put(1.0, best_forces, forces)
    status[:] = best_status
    return least, NEWTON


@part
def solve_box_lcp(delassus, free_rates, low, high, forces, matrix, right):
    """Change the forces p to the solution with given bounds. Rates G p + b are 0 between them, not negative at the low one, not positive at the high one.

    A step goes to the solution of the free rows, or as far as the first bound on the way, whose row is then fixed (`blocked`). At a solution of
    the free rows the fixed row with the wrongest rate becomes free (`released`). Ends also, without a solution, if a matrix is singular.
    """
    k, full = forces.shape[0], False
    free = np.zeros(k, np.bool_)
    for i in range(k):
        forces[i] = min(max(forces[i], low[i]), high[i])
        free[i] = low[i] < forces[i] < high[i]
    for _ in range(CHANGES * (k + 1)):
        error, size, worst, released = 0.0, 0.0, 0.0, -1
        for i in range(k):
            u, scale = row_rate(delassus, free_rates, forces, i)
            right[i] = -u / delassus[i, i]
            size = max(size, abs(forces[i]), scale / delassus[i, i])
            if free[i]:
                error = max(error, abs(right[i]))
            elif low[i] < high[i]:
                out = right[i] if forces[i] <= low[i] else -right[i]
                if out > worst:
                    worst, released = out, i
        if full and worst > EXACT * size:
            free[released] = True
        elif full and error <= 100.0 * EXACT * size:
            return
        for i in range(k):
            for j in range(k):
                matrix[i, j] = delassus[i, j] / delassus[i, i] if free[i] and free[j] else 0.0
            matrix[i, i] = 1.0 + REGULAR if free[i] else 1.0
            right[i] = right[i] if free[i] else 0.0
        if not solve_small(matrix, right):
            return
        share, blocked = 1.0, -1
        for i in range(k):
            ahead = low[i] if right[i] < 0.0 else high[i]
            if right[i] != 0.0 and (ahead - forces[i]) / right[i] < share:
                share, blocked = (ahead - forces[i]) / right[i], i
        for i in range(k):
            forces[i] += share * right[i]
        full = blocked < 0
        if not full:
            forces[blocked], free[blocked] = low[blocked] if right[blocked] < 0.0 else high[blocked], False


@part
def sweep(delassus, free_rates, cone, forces, slope):
    """Solve the rows one after the other, each with the others fixed and projected onto its bounds: one projected Gauss-Seidel sweep."""
    k = forces.shape[0]
    for i in range(k):
        u, _ = row_rate(delassus, free_rates, forces, i)
        trial = forces[i] - u / delassus[i, i]
        if cone.kind[i] == CONTACT:
            forces[i] = max(0.0, trial)
        else:
            limit = friction_bound(cone, forces, i, slope)
            if cone.sign[i] != 0.0:
                forces[i] = -cone.sign[i] * limit
            else:
                forces[i] = min(max(trial, -limit), limit)


@entry
def solve_cone(delassus, free_rates, cone, forces, status):
    """Overwrite a start, the pressures p = forces (k,), with a solution, and fill status (k,); return the Newton iterations, or -1.

    delassus (k, k): G, whose diagonal entries are replaced by their magnitudes, at least LEAST; free_rates (k,): b; cone: the Cone of the
    laws. -1: no solution was found. status: of each row, whether it is open, closed, sticks or slips.
    """
    k = forces.shape[0]
    matrix, right, slope, total = np.empty((k, k)), np.empty(k), np.empty(k), 0
    for i in range(k):
        delassus[i, i] = max(abs(delassus[i, i]), LEAST)
    error, count = newton(delassus, free_rates, cone, forces, status, matrix, right, slope)
    if not error <= GOOD:  # from the forces of rows that all stick, as of a rod that jams
        for i in range(k):
            right[i] = -free_rates[i]
            put(1.0, delassus[i], matrix[i])
            matrix[i, i] *= 1.0 + REGULAR
        if solve_small(matrix, right):
            put(1.0, right, forces)
            total += count
            error, count = newton(delassus, free_rates, cone, forces, status, matrix, right, slope)
    for turn in range(ROUNDS + AGAIN):
        total += count
        if error <= GOOD:
            return total
        if not error < np.inf:
            forces[:] = 0.0
        if turn == 0 or turn >= ROUNDS:
            low, high = np.zeros(k), np.full(k, np.inf)
            for i in range(k):
                if cone.kind[i] == FRICTION:
                    limit = friction_bound(cone, forces, i, slope)
                    low[i], high[i] = (-limit, limit) if cone.sign[i] == 0.0 else (-cone.sign[i] * limit, -cone.sign[i] * limit)
            solve_box_lcp(delassus, free_rates, low, high, forces, matrix, right)
        else:
            for _ in range(SWEEPS):
                sweep(delassus, free_rates, cone, forces, slope)
        error, count = newton(delassus, free_rates, cone, forces, status, matrix, right, slope)
    return total + count if error <= GOOD else -1
