"""Slopes of data on logarithmic axes."""

import numpy as np


def fitted(x, y):
    """Slope of log y over log x by least squares; NaN where there are fewer than two finite positive points."""
    x, y = positive(x, y)
    return float(np.polyfit(np.log(x), np.log(y), 1)[0]) if len(np.unique(x)) > 1 else float("nan")


def positive(x, y):
    """The points whose coordinates are finite and positive both."""
    x, y = np.asarray(x, float), np.asarray(y, float)
    good = np.isfinite(x) & np.isfinite(y) & (x > 0) & (y > 0)
    return x[good], y[good]
