"""Factors of the plates' matrix `S = c_m M + c_v C + K`, real or complex symmetric, in the layout that the compiled solves read."""

from typing import NamedTuple

import numpy as np

from polyida.jit import entry, fast, pack
from polyida.linear.dissection import NOTHING, Symbolic, symbolic
from polyida.linear.fronts import factorize, single
from polyida.linear.lu import SYMMETRIC_MODE

BAND, COLUMNS, FRONTS = 0, 1, 2


@pack
class Factor(NamedTuple):
    """A symmetric factor: multifrontal or banded Cholesky, or L D L^T in columns.

    order (n,): the place of each coordinate in the factor. The fields of the other kinds are empty. All numbers are float32 or complex64.
    """

    kind: int
    band: np.ndarray
    start: np.ndarray
    rows: np.ndarray
    values: np.ndarray
    reciprocal: np.ndarray
    order: np.ndarray
    fronts: Symbolic
    panels: np.ndarray


class NotFactorable(Exception):
    """S has no factor: it is singular or not finite."""


def symbolic_of(model):
    """The symbolic phase for a scene's plates: order and fronts, the same for every factor of the model."""
    return symbolic(*model.pattern, model.reference)


def factor(model, blocks, backend="auto", phase=1.0, before=None):
    """(Factor, its name) of the plates' matrix, given as blocks (nnz, 2, 2) on the model's nodal pattern.

    backend: "auto" and "fronts" are the multifrontal Cholesky, "band" LAPACK's or, where S is complex, ours, "superlu" SuperLU.
    Where `phase` S, or its real part, is not positive definite both Cholesky factors give way to SuperLU's L D L^T. before: a Factor of the
    model, whose panels a multifrontal one takes over: it is then that Factor itself. Raises NotFactorable.
    """
    indptr, indices = model.pattern
    if not np.isfinite(blocks).all():
        raise NotFactorable("the tangent is not finite")
    if backend in ("auto", "fronts"):
        known = model.once(symbolic_of, of_shape=True)
        again = before is not None and before.kind == FRONTS and before.panels.dtype == single(blocks)
        panels = factorize(known, blocks, phase, panels=before.panels if again else None)
        if panels is not None:
            made = before if again else _empty(FRONTS, known.order, panels.dtype)._replace(fronts=known, panels=panels)
            return made, "multifrontal Cholesky"
    if backend == "band":
        width = 2 * int(np.max(np.abs(indices - np.repeat(np.arange(model.n // 2), np.diff(indptr))))) + 1
        band = np.empty((model.n, width + 1), blocks.dtype)
        fill_band(indptr, indices, blocks, band)
        band = _eliminated(band, phase)
        if band is not None:
            order = np.arange(model.n, dtype=np.int32)
            return _empty(BAND, order, band.dtype)._replace(band=band), "band Cholesky"
    return _columns(indptr, indices, blocks, model.n), "L D L^T (SuperLU, MMD)"


def _empty(kind, order, dtype):
    integers, numbers = np.zeros(0, np.int32), np.zeros(0, dtype)
    return Factor(kind, np.zeros((0, 1), dtype), integers, integers, numbers, numbers, order, NOTHING, numbers)


def _eliminated(band, phase):
    """The Cholesky factor of a band in single precision, or None."""
    if np.iscomplexobj(band):
        return band.astype(np.complex64) if eliminate_band(band, complex(phase)) else None
    from scipy.linalg.lapack import dpbtrf

    done, info = dpbtrf(band.T, lower=1, overwrite_ab=1)
    if info:
        return None
    found = np.ascontiguousarray(done.T, np.float32)
    found[:, 0] = 1.0 / done[0]
    return found


def _columns(indptr, indices, blocks, n):
    from scipy.sparse import bsr_array, tril
    from scipy.sparse.linalg import splu

    matrix = bsr_array((blocks, indices, indptr), shape=(n, n)).tocsc()
    try:
        lu = splu(matrix, **SYMMETRIC_MODE)
    except RuntimeError as error:
        raise NotFactorable("the tangent is singular") from error
    if not np.array_equal(lu.perm_r, lu.perm_c):
        raise NotFactorable("the tangent is singular to working precision")
    lower, diagonal = tril(lu.L, -1, format="csc"), lu.U.diagonal()
    dtype = single(blocks)
    return _empty(COLUMNS, lu.perm_c.astype(np.int32), dtype)._replace(
        start=lower.indptr.astype(np.int32),
        rows=lower.indices.astype(np.int32),
        values=lower.data.astype(dtype),
        reciprocal=(1.0 / diagonal).astype(dtype),
    )


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
