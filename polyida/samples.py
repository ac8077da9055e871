"""Piecewise polynomials through samples of a function of time or of a derivative of it."""

from __future__ import annotations

import numpy as np

SAME = 1e-9  # of the largest leading coefficient: pieces that differ by less are one


def joined(t, y, smooth):
    """The piecewise polynomial through samples: a cubic spline, or straight lines."""
    from scipy.interpolate import CubicSpline, PPoly

    return CubicSpline(t, y) if smooth else PPoly(np.stack([np.diff(y) / np.diff(t), y[:-1]]), t)


def kinks_of(curve):
    """Times of a piecewise polynomial at which another polynomial begins, with both ends."""
    leading = curve.c[0]
    other = np.abs(np.diff(leading)) > SAME * np.abs(leading).max()
    return curve.x[np.concatenate([[True], other, [True]])]


def baseline(curve, derivative):
    """c0 and c1 of the straight line `c0 + c1 (t - t[0])` that a first or second derivative has too much.

    Without it the integral returns to 0 at the end; that of a second derivative at rest. Of a first derivative c1 is 0.
    """
    duration = curve.x[-1] - curve.x[0]
    value, rate = ends(curve.antiderivative(derivative))[1]
    if derivative == 1:
        return value / duration, 0.0
    return (6.0 * value / duration - 2.0 * rate) / duration, (6.0 * rate - 12.0 * value / duration) / duration**2


def ends(curve):
    """((value, derivative) at the begin, (value, derivative) at the end) of a scalar piecewise polynomial, as floats."""
    rate = curve.derivative()
    return tuple((float(curve(t)), float(rate(t))) for t in (curve.x[0], curve.x[-1]))


def continued(curve, moving):
    """The piecewise polynomial with a piece before and one behind it: at rest or, if it is moving there, with constant rate."""
    from scipy.interpolate import PPoly

    (first, first_rate), (last, last_rate) = ends(curve)
    c = np.zeros((max(2, len(curve.c)), curve.c.shape[1] + 2))
    c[len(c) - len(curve.c) :, 1:-1] = curve.c
    c[-2:, -1] = last_rate * moving, last
    c[-2:, 0] = first_rate * moving, first - first_rate * moving
    return PPoly(c, np.concatenate([[curve.x[0] - 1.0], curve.x, [curve.x[-1] + 1.0]]))


def evaluated(curve, t):
    """A piecewise polynomial at a time or an array of times."""
    return curve(t)[()]
