"""Algebraic states s, `0 = f(s)` with a regular slope: solved for where forces are evaluated, so that integrators know nothing of them."""

import numpy as np

# constants of compiled code
STEP = 1e-7  # relative step of central differences
ROUND, CLOSE = 1e-13, 1e-9  # relative corrections of which the next one, or the one after it, is the last
FAST = 1e-3  # ratio of corrections with which a slope is used again
SINGULAR = 1e-7  # least pivot or singular value of the slope, with rows and columns of size one, of a regular slope
MOST, LEAST = 50, 2.0**-12  # iterations, and share of a step


def solved(f, s, sizes):
    """(the s, (k,), with f(s) = 0, "") by Newton's method with shorter steps where corrections do not fall, or (nan, why there is none).

    f: function (k,) -> (k,). s: the guess. sizes (k,): typical sizes of s.
    """
    none = np.full(len(s), np.nan)
    value = f(s)
    for _ in range(MOST):
        slope = np.empty((len(s), len(s)))
        for j, step in enumerate(STEP * np.maximum(sizes, np.abs(s))):
            moved = step * np.eye(len(s))[j]
            slope[:, j] = (f(s + moved) - f(s - moved)) / (2.0 * step) * sizes[j]
        rows = np.abs(slope).max(axis=1)
        if not (np.isfinite(slope).all() and rows.min() > 0.0 and np.linalg.svd(slope / rows[:, None])[1][-1] > SINGULAR):
            return none, "their slope d rates/ds is singular"
        inverse = sizes[:, None] * np.linalg.inv(slope / rows[:, None]) / rows
        change, ratio = -inverse @ value, 0.0
        while ratio <= FAST:
            share, before = 1.0, relative(change, s, sizes)
            while True:
                value = f(s + share * change)
                left = -inverse @ value
                size = relative(left, s + share * change, sizes)
                if size <= max(CLOSE, (1.0 - 0.25 * share) * before):
                    break
                share *= 0.5
                if share < LEAST:
                    return none, "Newton's method from start() does not converge"
            s = s + share * change
            if size <= ROUND or before <= CLOSE:
                return s + left, ""
            change, ratio = left, size / before
    return none, "Newton's method from start() does not converge"


def relative(change, s, sizes):
    """Largest change relative to s and its sizes."""
    return float(np.max(np.abs(change) / (sizes + np.abs(s))))
