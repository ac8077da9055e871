"""A small dense linear solve for compiled code."""

import numpy as np

from polyida.jit import entry, part


@part
def magnitude(value):
    """|Re value| + |Im value|: the size of a pivot, without a root."""
    return abs(value.real) + abs(value.imag)


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
def solve(matrix, pivots, right):
    """`right` becomes the solution, with the factors of `factor`."""
    n = right.shape[0]
    for k in range(n):
        if pivots[k] != k:
            right[k], right[pivots[k]] = right[pivots[k]], right[k]
    for i in range(1, n):
        total = right[i]
        for j in range(i):
            total -= matrix[i, j] * right[j]
        right[i] = total
    for i in range(n - 1, -1, -1):
        total = right[i]
        for j in range(i + 1, n):
            total -= matrix[i, j] * right[j]
        right[i] = total * matrix[i, i]


@part
def put(factor, source, target):
    """Copy factor times source to target, which may be longer."""
    for i in range(source.shape[0]):
        target[i] = factor * source[i]


@part
def copy_matrix(source, target):
    """Copy a matrix to another one of its size. numba takes two seconds to compile an assignment of arrays."""
    for i in range(source.shape[0]):
        for j in range(source.shape[1]):
            target[i, j] = source[i, j]


@part
def zero(vector):
    """Set every entry of a vector to 0. An assignment to a slice takes longer where vectors are short."""
    for i in range(vector.shape[0]):
        vector[i] = 0.0


@part
def clear(matrix):
    """Set every entry of a matrix (rows, columns) to 0, in place."""
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            matrix[i, j] = 0.0


@entry
def solve_small(matrix, right):
    """right <- matrix^-1 right, with rows divided by their largest entry first; overwrites both. False if it is singular."""
    for i in range(right.shape[0]):
        size = 0.0
        for j in range(right.shape[0]):
            size = max(size, abs(matrix[i, j]))
        if not size > 0.0:
            return False
        for j in range(right.shape[0]):
            matrix[i, j] /= size
        right[i] /= size
    pivots = np.empty(right.shape[0], np.int64)
    if not factor(matrix, pivots):
        return False
    solve(matrix, pivots, right)
    return True
