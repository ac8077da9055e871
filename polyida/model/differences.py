"""Numerical derivatives, the defaults of a model's functions and the check of exact ones; interpolation and times beside kinks."""

import math
from functools import lru_cache

import numpy as np

# constants of compiled code
FIRST_ORDER_STEP = np.finfo(float).eps ** (1 / 5)  # balances the h^4 truncation against round-off / h
NEAR = np.finfo(float).eps ** (1 / 3)  # step of slopes of phi_q, which only Newton sees: two values are enough
EVERYWHERE = (-np.inf, np.inf)
LATER = 0.37  # s: a later time at which forces are evaluated to see if they depend on time
SPACES = 6  # between the values of a difference that is not central


def along(function, scale=1.0, bounds=EVERYWHERE):
    """Derivative d/ds function(s) at s = 0, by fourth-order central differences, or by `within` near a bound of s.

    function: of one float, returns an array, which may be the same one each time. scale: the size of s over which it varies. bounds: the
    range of s around 0 in which it is smooth. The error is about eps^(4/5) of the function's size over `scale`; near bounds round-off grows.
    """
    step = FIRST_ORDER_STEP * scale
    if bounds[0] > -2 * step or bounds[1] < 2 * step:
        return within(function, bounds, step)
    near = np.array(function(step)) - function(-step)
    far = np.array(function(2 * step)) - function(-2 * step)
    return (8 * near - far) / (12 * step)


def bend(function, here, scale):
    """(first, second) derivative of function(s) at s = 0, where its value is `here`, by central differences; the second to few digits."""
    step = NEAR * scale
    ahead, behind = np.array(function(step)), np.array(function(-step))
    return (ahead - behind) / (2 * step), (ahead - here + behind - here) / step**2


def reach_along(q, direction):
    """The s for which `s direction` has the size of q, at least 1; s is at most 1."""
    size, pace = 1.0 + np.abs(q).max(initial=0.0), np.abs(direction).max(initial=0.0)
    return float(size / pace) if pace > size else 1.0


def central(scale=1.0):
    """(s, weight) of the central difference of `along`: the derivative is the weighted sum of the values."""
    step = FIRST_ORDER_STEP * scale
    return tuple((k * step, weight / (12 * step)) for k, weight in ((1, 8.0), (-1, -8.0), (2, -1.0), (-2, 1.0)))


def within(function, bounds, step, order=1):
    """Derivative of order 1 or 2 at s = 0 from 7 values of the function `step` apart, or nearer, all inside of `bounds`.

    It is that of the polynomial through them, of fifth order in the step or higher, one-sided from the right if bounds[0] = 0. bounds:
    numbers, or arrays of one shape, which `function` then takes and returns.
    """
    low, high = bounds
    least, most, weights_at = (np.minimum, np.maximum, _weights) if np.ndim(low) else (min, max, _weights_again)
    step = least(step, (high - low) / (SPACES + 2))
    first = least(most(-SPACES / 2 * step, low + step / 8), high - step / 8 - SPACES * step)
    values = [np.array(function(first + step * k)) for k in range(SPACES + 1)]
    changes = (weight * (value - values[0]) for weight, value in zip(weights_at(first / step, order)[1:], values[1:]))
    return sum(changes) / step**order  # the weights' sum is zero, but for round-off


def _weights(first, order):
    """The weights of values at first, first + 1, ... for the derivative at 0 of the polynomial through them, (7, ...)."""
    powers = (np.asarray(first)[..., None] + np.arange(SPACES + 1))[..., None, :] ** np.arange(SPACES + 1.0)[:, None]
    return order * np.moveaxis(np.linalg.solve(powers, np.eye(SPACES + 1)[:, [order]])[..., 0], -1, 0)


_weights_again = lru_cache(100)(_weights)


def around(kinks, t):
    """The range of s in which t + s is at none of the sorted kinks; after a kink that is at t itself."""
    k = np.searchsorted(kinks, t, side="right")
    return float(kinks[k - 1] - t) if k else -np.inf, float(kinks[k] - t) if k < len(kinks) else np.inf


def jacobian(function, x, rows):
    """Jacobian of `function(x)` (rows,) with respect to x (n,): a dense (rows, n) array, one column a coordinate."""
    result = np.empty((rows, x.size))
    for k in range(x.size):

        def moved(s, k=k):
            """The function where coordinate k of x is changed by s, (rows,)."""
            shifted = x.copy()
            shifted[k] += s
            return function(shifted)

        result[:, k] = along(moved, max(1.0, abs(x[k])))
    return result


def beside(t, side):
    """A time next to t, later if side is positive and earlier if it is negative."""
    return t + math.copysign(32 * math.ulp(max(abs(t), 1.0)), side)


def cubic(x0, v0, x1, v1, h, s):
    """(x, x') at the part s of an interval of length h, from values x0, x1 and slopes v0, v1 at its ends: Hermite's polynomial.

    x' is linear where x1 - x0 differs from the mean slope by round-off alone, which 1/h would enlarge.
    """
    move, mean = x1 - x0, 0.5 * h * (v0 + v1)
    x = x0 + s * s * (3 - 2 * s) * move + h * s * (1 - s) * ((1 - s) * v0 - s * v1)
    bend = np.where(np.abs(move - mean) > 4 * np.finfo(float).eps * (np.abs(x0) + np.abs(x1)), move - mean, 0.0)
    return x, (1 - s) * v0 + s * v1 + 6 * s * (1 - s) / h * bend


def near_points(steps, first, last, most=4):
    """(number of the first point (steps,), count): the points, numbered first to last, of the polynomial over each step k from point k to k + 1."""
    count = min(most, last - first + 1)
    return np.clip(steps - (most // 2 - 1), first, last - count + 1), count


def step_integrals(t, begin, h):
    """Weights (steps, 2, count) of `int x dt / h` and of `int (begin + h - t) x dt / h^2` over steps from begin, of h, (steps,) each.

    x: the polynomial through values at the times t (steps, count).
    """
    power = np.arange(t.shape[1])
    powers = ((t - begin[:, None]) / h[:, None])[:, None] ** power[:, None]
    moments = np.stack([1.0 / (power + 1), 1.0 / ((power + 1) * (power + 2))], axis=1)
    return np.swapaxes(np.linalg.solve(powers, np.broadcast_to(moments, (len(t), *moments.shape))), 1, 2)
