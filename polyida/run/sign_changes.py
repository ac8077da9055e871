"""The first change of sign of a function within a step, from its values at nodes of the step and at the extrema of their polynomial."""

import numpy as np

NODES = 0.5 - 0.5 * np.cos(np.pi * np.arange(5) / 4)  # of a step, 0 to 1, where functions of events are evaluated
COEFFICIENTS = np.linalg.inv(np.vander(NODES, increasing=True))  # values at NODES -> coefficients of the polynomial, s^0 first


def first_sign_change(g, values, side, offset, direction):
    """(s of the first change of sign that counts, or None; the sign at the end of the step, or there).

    g: function of s in [0, 1]. values: g at NODES. side: its sign before the step, 0 if it is on neither side yet: then the first sign is no
    change. offset: |g| up to which g keeps its side. direction: "rising", "falling" or "both", of the changes that count.
    """
    if (side * values > offset).all() and 2 * np.abs(values).min() > np.ptp(values):
        return None, side
    points = sorted([*zip(NODES, values), *((s, g(s)) for s in _extrema(values))])
    for (s0, g0), (s1, g1) in zip([points[0], *points], points):
        if abs(g1) <= offset or np.sign(g1) == side:
            continue
        from_side = side
        rising = g1 > 0
        side = np.sign(g1)
        counts = from_side and direction != ("falling" if rising else "rising")
        if not counts:
            continue
        if g0 * from_side <= 0.0:  # round-off at the start of a step
            return s0, side
        if s1 >= 1.0 and not g1:
            return 1.0, side
        from scipy.optimize import brentq

        return brentq(g, s0, s1, xtol=1e-300, rtol=4 * np.finfo(float).eps, maxiter=1000), side
    return None, side


def _extrema(values):
    """The s within (0, 1) at which the polynomial through the values at NODES has an extremum."""
    slopes = (COEFFICIENTS @ values)[1:] * np.arange(1, len(values))
    roots = np.roots(slopes[::-1]) if slopes.any() else []
    return [float(s.real) for s in roots if abs(s.imag) < 1e-6 and 0.0 < s.real < 1.0]
