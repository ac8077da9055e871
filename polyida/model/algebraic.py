"""Algebraic states s, `0 = f(s)` with a regular slope: solved for where forces are evaluated, so that integrators know nothing of them."""

import ctypes

import numpy as np

from polyida.errors import DONE, RAISED
from polyida.jit import entry, part
from polyida.jit.intrinsics import address, call
from polyida.jit.user_functions import CALLBACK
from polyida.linear.dense import factor, solve

# constants of compiled code
STEP = 1e-7  # relative step of central differences
ROUND, CLOSE = 1e-13, 1e-9  # relative corrections of which the next one, or the one after it, is the last
FAST = 1e-3  # ratio of corrections with which a slope is used again
SINGULAR = 1e-7  # least pivot of the slope, with rows and columns of size one, of a regular slope
MOST, LEAST = 50, 2.0**-12  # iterations, and share of a step
FOUND, FLAT, LOST = range(3)  # how it ended
WHY = "", "their slope d rates/ds is singular", "Newton's method from start() does not converge"


@part
def evaluate(function, data, t, x, v, s, outputs, rates):
    """Fill rates by a C function (jit/user_functions.py); nan if it fails."""
    if call(function, data, 0, t, x, v, address(s), outputs, address(rates)) != DONE:
        rates[:] = np.nan


@part
def largest(change, s, first, sizes):
    """Largest of the changes, in sizes, relative to the algebraic states and their sizes."""
    size = 0.0
    for i in range(change.shape[0]):
        size = max(size, abs(change[i]) * sizes[i] / (sizes[i] + abs(s[first + i])))
    return size


@entry
def fill_algebraic(function, data, t, x, v, outputs, s, first, sizes, rates):
    """Fill the algebraic states of s, from number `first` on, and the rates: Newton's method with shorter steps where corrections do not fall.

    function, data, t, x, v, outputs: a C function of the rates, and its arguments beside s and rates. sizes: typical sizes of the algebraic
    states; s holds a guess of them. Returns how it ended.
    """
    count, behind = sizes.shape[0], np.zeros_like(rates)
    free, slope, pivots = s[first : first + count], np.empty((count, count)), np.empty(count, np.int64)
    change, left, rows = np.empty(count), np.empty(count), np.empty(count)
    evaluate(function, data, t, x, v, s, outputs, rates)
    for i in range(count):
        left[i] = rates[first + i]
    for _ in range(MOST):
        for j in range(count):
            middle, step = free[j], STEP * max(sizes[j], abs(free[j]))
            free[j] = middle + step
            evaluate(function, data, t, x, v, s, outputs, rates)
            free[j] = middle - step
            evaluate(function, data, t, x, v, s, outputs, behind)
            free[j] = middle
            for i in range(count):
                slope[i, j] = (rates[first + i] - behind[first + i]) / (2.0 * step) * sizes[j]
        for i in range(count):
            rows[i] = np.max(np.abs(slope[i]))
            change[i] = -left[i] / rows[i] if rows[i] > 0.0 else np.nan
            slope[i] /= rows[i]
        if not factor(slope, pivots):
            return FLAT
        for i in range(count):
            if not abs(slope[i, i]) < 1.0 / SINGULAR:
                return FLAT
        solve(slope, pivots, change)
        ratio = 0.0
        while ratio <= FAST:
            share, moved, before, size = 1.0, 0.0, largest(change, s, first, sizes), 0.0
            while True:
                for i in range(count):
                    free[i] += (share - moved) * change[i] * sizes[i]
                evaluate(function, data, t, x, v, s, outputs, rates)
                for i in range(count):
                    left[i] = -rates[first + i] / rows[i]
                solve(slope, pivots, left)
                size = largest(left, s, first, sizes)
                if size <= max(CLOSE, (1.0 - 0.25 * share) * before):
                    break
                moved, share = share, 0.5 * share
                if share < LEAST:
                    return LOST
            if size <= ROUND or before <= CLOSE:
                for i in range(count):
                    free[i] += left[i] * sizes[i]
                evaluate(function, data, t, x, v, s, outputs, rates)
                return FOUND
            change[:], ratio = left, size / before
        for i in range(count):
            left[i] = rates[first + i]
    return LOST


@part
def with_algebraic(function, data, t, q, v, x, guess, sizes):
    """The states x of an own model with the algebraic ones behind them; nan for these without a solution."""
    k, s = x.shape[0], np.empty(x.shape[0] + guess.shape[0])
    for i in range(s.shape[0]):
        s[i] = x[i] if i < k else guess[i - k]
    if fill_algebraic(function, data, t, q, v, 0, s, k, sizes, np.zeros_like(s)) != FOUND:
        s[k:] = np.nan
    return s


def solved(f, s, sizes):
    """(the s, (k,), with f(s) = 0, "") or (nan, why there is none), of a Python function f (k,) -> (k,). s: the guess; sizes (k,)."""
    s, raised, vector = np.array(s, float), [], ctypes.c_double * len(s)

    def called(*arguments):
        try:
            np.frombuffer(vector.from_address(arguments[-1]))[:] = f(s.copy())
        except BaseException as error:  # noqa: BLE001 it is raised below
            raised.append(error)
            return RAISED
        return DONE

    callback = CALLBACK(called)
    ended = fill_algebraic(ctypes.cast(callback, ctypes.c_void_p).value, 0, 0, 0, 0, 0, s, 0, np.array(sizes, float), np.empty_like(s))
    if raised:
        raise raised[0]
    return (s if ended == FOUND else np.full(len(s), np.nan)), WHY[ended]
