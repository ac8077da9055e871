"""Triangular solves with a symmetric factor, in single precision: they only correct a residual that is evaluated in double.

A Newton correction needs two or three digits; half the bytes are half the time, for the solves stream the factor and do little else.
"""

from functools import partial

import numpy as np

from polyida.jit import entry, part

FAST = {"contract", "reassoc", "nsz"}
fast = partial(part, fastmath=FAST)


@entry
def fill_band(indptr, indices, blocks, band):
    """Write the lower triangle of a nodal block matrix into band (n, width + 1): row j holds column j from the diagonal down."""
    band[:] = 0.0
    for i in range(indptr.shape[0] - 1):
        for p in range(indptr[i], indptr[i + 1]):
            j = indices[p]
            if j <= i:
                d = 2 * (i - j)
                band[2 * j, d] = blocks[p, 0, 0]
                band[2 * j, d + 1] = blocks[p, 1, 0]
                band[2 * j + 1, d] = blocks[p, 1, 1]
                if d > 0:
                    band[2 * j + 1, d - 1] = blocks[p, 0, 1]


@entry
def eliminate_band(band, phase):
    """L of S = L L^T in place of S, in fill_band's storage, with reciprocal diagonal: for complex S, which LAPACK has not.

    False where the real part of a pivot, times phase, is not positive.
    """
    n, width = band.shape[0], band.shape[1] - 1
    for j in range(n):
        row, count = band[j], min(width, n - 1 - j)
        if not (phase * row[0]).real > 0.0:
            return False
        row[0] = 1.0 / np.sqrt(row[0])
        for k in range(1, count + 1):
            row[k] *= row[0]
        for k in range(1, count + 1):
            later, value = band[j + k], row[k]
            if value != 0.0:
                for i in range(k, count + 1):
                    later[i - k] -= value * row[i]
    return True


@fast
def solve_band(band, x):
    """x <- (L L^T)^-1 x for the Cholesky factor in band storage with reciprocal diagonal; x (n + width,) ends in zeros."""
    n, width = band.shape[0], band.shape[1] - 1
    for j in range(n):
        row = band[j]
        value = x[j] * row[0]
        x[j] = value
        part = x[j + 1 : j + 1 + width]
        for k in range(width):
            part[k] -= row[k + 1] * value
    for j in range(n - 1, -1, -1):
        row, part = band[j], x[j + 1 : j + 1 + width]
        total = x[j]
        for k in range(width):
            total -= row[k + 1] * part[k]
        x[j] = total * row[0]


@fast
def solve_columns(start, rows, values, reciprocal, x):
    """x <- (L D L^T)^-1 x with L unit lower in columns (the unit diagonal left out) and the reciprocal of D."""
    n = start.shape[0] - 1
    for j in range(n):
        value = x[j]
        if value != np.float32(0.0):
            for p in range(start[j], start[j + 1]):
                x[rows[p]] -= values[p] * value
    for j in range(n):
        x[j] *= reciprocal[j]
    for j in range(n - 1, -1, -1):
        total = x[j]
        for p in range(start[j], start[j + 1]):
            total -= values[p] * x[rows[p]]
        x[j] = total
