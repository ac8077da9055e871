"""Central differences: the default derivatives of a model, and the yardstick its exact ones are checked against."""

import numpy as np

FIRST_ORDER_STEP = np.finfo(float).eps ** (1 / 5)  # balances the h^4 truncation against round-off / h


def along(function, scale=1.0):
    """Derivative d/ds function(s) at s = 0, fourth order central.

    Parameters: `function` of one float, returning an array; `scale`, the size of s over which it varies.
    Returns an array of the same shape. The error is about eps^(4/5) of the function's size over `scale`.
    """
    step = FIRST_ORDER_STEP * scale
    near = np.asarray(function(step)) - np.asarray(function(-step))
    far = np.asarray(function(2 * step)) - np.asarray(function(-2 * step))
    return (8 * near - far) / (12 * step)


def jacobian(function, x, rows):
    """Jacobian of `function(x)` (rows,) with respect to x (n,): a dense (rows, n) array, one column a coordinate."""
    result = np.empty((rows, x.size))
    for k in range(x.size):
        def moved(s, k=k):
            shifted = x.copy()
            shifted[k] += s
            return function(shifted)

        result[:, k] = along(moved, max(1.0, abs(x[k])))
    return result
