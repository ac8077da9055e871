"""A small dense linear solve for compiled code."""

import numpy as np

from polyida.jit import entry, part


@part
def magnitude(x):
    """|Re x| + |Im x|: the size of a pivot, without a root."""
    return abs(x.real) + abs(x.imag)


@part
def factor(matrix, pivots):
    """P matrix = L U in place, by rows, with partial pivoting; False if it is singular. pivots (n,): the pivot row of each step.

    The diagonal of U becomes its reciprocals.
    """
    n = matrix.shape[0]
    for k in range(n):
        p, most = k, magnitude(matrix[k, k])
        for i in range(k + 1, n):
            if magnitude(matrix[i, k]) > most:
                p, most = i, magnitude(matrix[i, k])
        pivots[k] = p
        if not 0.0 < most < np.inf:
            return False
        if p != k:
            for j in range(n):
                matrix[k, j], matrix[p, j] = matrix[p, j], matrix[k, j]
        matrix[k, k] = 1.0 / matrix[k, k]
        for i in range(k + 1, n):
            if matrix[i, k] != 0.0:
                share = matrix[i, k] * matrix[k, k]
                matrix[i, k] = share
                for j in range(k + 1, n):
                    matrix[i, j] -= share * matrix[k, j]
    return True


@part
def solve(matrix, pivots, b):
    """b becomes the solution, with the factors of `factor`."""
    n = b.shape[0]
    for k in range(n):
        if pivots[k] != k:
            b[k], b[pivots[k]] = b[pivots[k]], b[k]
    for i in range(1, n):
        total = b[i]
        for j in range(i):
            total -= matrix[i, j] * b[j]
        b[i] = total
    for i in range(n - 1, -1, -1):
        total = b[i]
        for j in range(i + 1, n):
            total -= matrix[i, j] * b[j]
        b[i] = total * matrix[i, i]


@part
def put(c, x, y):
    """y = c x; y may be longer."""
    for i in range(x.shape[0]):
        y[i] = c * x[i]


@part
def copy_matrix(x, y):
    """y = x. numba takes two seconds to compile an assignment of arrays."""
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            y[i, j] = x[i, j]


@part
def zero(x):
    """Every entry of a vector 0. An assignment to a slice takes longer where vectors are short."""
    for i in range(x.shape[0]):
        x[i] = 0.0


@part
def clear(matrix):
    """Every entry 0."""
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            matrix[i, j] = 0.0


@entry
def solve_small(matrix, b):
    """b <- matrix^-1 b, with rows divided by their largest entry first; overwrites both. False if it is singular."""
    for i in range(b.shape[0]):
        size = 0.0
        for j in range(b.shape[0]):
            size = max(size, abs(matrix[i, j]))
        if not size > 0.0:
            return False
        for j in range(b.shape[0]):
            matrix[i, j] /= size
        b[i] /= size
    pivots = np.empty(b.shape[0], np.int64)
    if not factor(matrix, pivots):
        return False
    solve(matrix, pivots, b)
    return True
