"""The cone problem of rows with laws: pressures p = -lam and rates u = G p + b that satisfy the laws of contact and friction.

```
contact:   p = max(0, p - rho u)
friction:  p = clip(p - rho u, -c(p), c(p)),   c(p) = c_0 + mu |l_0 + L p|,   rho = 1/G_ii
slip:      p = -sign c(p), if the direction of slip is known
```
Semismooth Newton on these equations (Alart, Curnier 1991), an active-set method. If sets repeat, Newton begins again with all rows at rest, then
from the solution with the present bounds of friction, a convex quadratic problem whose sets change one row at a time (Nocedal, Wright, Numerical
Optimization (2006), section 16.5), then from projected Gauss-Seidel sweeps. Where G is singular, as with redundant contacts, pressures are
those of least norm among the solutions near the start.
"""

from typing import NamedTuple

import numpy as np

from polyida.jit import entry, pack, part
from polyida.linear.dense import put, solve_small

CONTACT, FRICTION = 0, 1
OPEN, CLOSED, STICKS, SLIPS_UP, SLIPS_DOWN = range(5)  # statuses; SLIPS_UP: rate > 0
NEWTON, SWEEPS, ROUNDS = 30, 400, 4
EXACT = 1e-13  # of the largest pressure: error of p
GOOD = 1e-8  # the same that is accepted if no iteration is better
LEAST = 1e-200  # of G_ii, which is round-off of either sign where a row cannot hold the motion, as friction at a dead point
REGULAR = 1e-9  # of G_ii, added to the matrix of Newton's method, not to the equations
CHANGES = 20  # for each row, of the sets of the problem with given bounds


@pack
class Cone(NamedTuple):
    """Rows with laws. kind: CONTACT or FRICTION. c, mu: of friction. start: first pressing entry of each row. l, L: |l + L p| of the entries.

    sign: 0, or the sign of the rate of a row that slips.
    """

    kind: np.ndarray
    c: np.ndarray
    mu: np.ndarray
    sign: np.ndarray
    start: np.ndarray
    l: np.ndarray  # noqa: E741
    L: np.ndarray


@part
def bound(x, p, i, slope):
    """c(p) of friction row i; fills its slope (k,)."""
    slope[:] = 0.0
    square = 0.0
    for e in range(x.start[i], x.start[i + 1]):
        value = x.l[e]
        for j in range(p.shape[0]):
            value += x.L[e, j] * p[j]
        square += value * value
        for j in range(p.shape[0]):
            slope[j] += value * x.L[e, j]
    norm = np.sqrt(square)
    for j in range(p.shape[0]):
        slope[j] *= x.mu[i] / norm if norm > 0.0 else 0.0
    return x.c[i] + x.mu[i] * norm


@part
def status_of(x, p, u, rho, i, limit):
    """The status of row i."""
    at = p[i] - rho * u
    if x.kind[i] == CONTACT:
        return CLOSED if at > 0.0 else OPEN
    if x.sign[i] != 0.0:
        return SLIPS_UP if x.sign[i] > 0.0 else SLIPS_DOWN
    return SLIPS_DOWN if at > limit else SLIPS_UP if at < -limit else STICKS


@part
def rate_of(G, b, p, i):
    """(rate of row i, the largest of its terms)."""
    u, scale = b[i], abs(b[i])
    for j in range(p.shape[0]):
        u += G[i, j] * p[j]
        scale = max(scale, abs(G[i, j] * p[j]))
    return u, scale


@part
def newton(G, b, x, p, status, matrix, right, slope):
    """Iterations until p no longer changes; p and status are then the best ones. Returns (the largest error of p over the largest p, iterations)."""
    k, least, kept, kept_status = p.shape[0], np.inf, p.copy(), status.copy()
    for iteration in range(NEWTON):
        error, size, same, finite = 0.0, 0.0, iteration > 0, True
        for i in range(k):
            u, scale = rate_of(G, b, p, i)
            rho = 1.0 / G[i, i]
            limit = bound(x, p, i, slope) if x.kind[i] == FRICTION else 0.0
            now = status_of(x, p, u, rho, i, limit)
            same = same and now == status[i]
            status[i] = now
            if now in (CLOSED, STICKS):
                for j in range(k):
                    matrix[i, j] = G[i, j] * rho
                matrix[i, i] += REGULAR
                right[i] = -u * rho
            elif now == OPEN:
                matrix[i, :] = 0.0
                matrix[i, i] = 1.0
                right[i] = -p[i]
            else:
                way = 1.0 if now == SLIPS_UP else -1.0  # p = -way c(p)
                for j in range(k):
                    matrix[i, j] = way * slope[j]
                matrix[i, i] += 1.0
                right[i] = -p[i] - way * limit
            error, size = max(error, abs(right[i])), max(size, abs(p[i]), limit if now >= SLIPS_UP else rho * scale)
            finite = finite and np.isfinite(right[i])
        if not finite:
            break
        error = error / size if size > 0.0 else 0.0
        if error <= EXACT or (same and error <= 100.0 * EXACT):
            return error, iteration
        if error < least:
            least = error
            put(1.0, p, kept)
            kept_status[:] = status
        if not solve_small(matrix, right):
            break
        for i in range(k):
            p[i] += right[i]
    put(1.0, kept, p)
    status[:] = kept_status
    return least, NEWTON


@part
def press(G, b, low, high, p, matrix, right):
    """Change p to the solution with given bounds: G p + b is 0 between them, not negative at the low one, not positive at the high one."""
    k, full = p.shape[0], False
    free = np.zeros(k, np.bool_)
    for i in range(k):
        p[i] = min(max(p[i], low[i]), high[i])
        free[i] = low[i] < p[i] < high[i]
    for _ in range(CHANGES * (k + 1)):
        error, size, worst, released = 0.0, 0.0, 0.0, -1
        for i in range(k):
            u, scale = rate_of(G, b, p, i)
            right[i] = -u / G[i, i]
            size = max(size, abs(p[i]), scale / G[i, i])
            if free[i]:
                error = max(error, abs(right[i]))
            elif low[i] < high[i]:
                out = right[i] if p[i] <= low[i] else -right[i]
                if out > worst:
                    worst, released = out, i
        if full and worst > EXACT * size:
            free[released] = True
        elif full and error <= 100.0 * EXACT * size:
            return
        for i in range(k):
            for j in range(k):
                matrix[i, j] = G[i, j] / G[i, i] if free[i] and free[j] else 0.0
            matrix[i, i] = 1.0 + REGULAR if free[i] else 1.0
            right[i] = right[i] if free[i] else 0.0
        if not solve_small(matrix, right):
            return
        share, blocked = 1.0, -1
        for i in range(k):
            bound_of_way = low[i] if right[i] < 0.0 else high[i]
            if right[i] != 0.0 and (bound_of_way - p[i]) / right[i] < share:
                share, blocked = (bound_of_way - p[i]) / right[i], i
        for i in range(k):
            p[i] += share * right[i]
        full = blocked < 0
        if not full:
            p[blocked], free[blocked] = low[blocked] if right[blocked] < 0.0 else high[blocked], False


@part
def sweep(G, b, x, p, slope):
    """One projected Gauss-Seidel sweep."""
    k = p.shape[0]
    for i in range(k):
        u, _ = rate_of(G, b, p, i)
        at = p[i] - u / G[i, i]
        if x.kind[i] == CONTACT:
            p[i] = max(0.0, at)
        else:
            limit = bound(x, p, i, slope)
            if x.sign[i] != 0.0:
                p[i] = -x.sign[i] * limit
            else:
                p[i] = min(max(at, -limit), limit)


@entry
def solve_cone(G, b, x, p, status):
    """Change p (k,) from a start to the solution, and fill status (k,). Returns the number of Newton iterations, or -1 without a solution.

    G_ii become positive.
    """
    k = p.shape[0]
    matrix, right, slope, total = np.empty((k, k)), np.empty(k), np.empty(k), 0
    for i in range(k):
        G[i, i] = max(abs(G[i, i]), LEAST)
    error, count = newton(G, b, x, p, status, matrix, right, slope)
    if not error <= GOOD:  # from the forces of rows that all stick, as of a rod that jams
        for i in range(k):
            right[i] = -b[i]
            put(1.0, G[i], matrix[i])
            matrix[i, i] *= 1.0 + REGULAR
        if solve_small(matrix, right):
            put(1.0, right, p)
            total += count
            error, count = newton(G, b, x, p, status, matrix, right, slope)
    for turn in range(ROUNDS):
        total += count
        if error <= GOOD:
            return total
        if not error < np.inf:
            p[:] = 0.0
        if turn == 0:
            low, high = np.zeros(k), np.full(k, np.inf)
            for i in range(k):
                if x.kind[i] == FRICTION:
                    limit = bound(x, p, i, slope)
                    low[i], high[i] = (-limit, limit) if x.sign[i] == 0.0 else (-x.sign[i] * limit, -x.sign[i] * limit)
            press(G, b, low, high, p, matrix, right)
        else:
            for _ in range(SWEEPS):
                sweep(G, b, x, p, slope)
        error, count = newton(G, b, x, p, status, matrix, right, slope)
    return total + count if error <= GOOD else -1
