"""Factors of the plates' matrix `S = c_m M + K` in the layout that the compiled solves read."""

from typing import NamedTuple

import numpy as np

from polyida.compiled import pack
from polyida.linear.cholesky.dissection import NOTHING, Symbolic, symbolic
from polyida.linear.cholesky.fronts import factorize
from polyida.linear.cholesky.triangular import fill_band
from polyida.linear.lu import SYMMETRIC_MODE

BAND, COLUMNS, FRONTS = 0, 1, 2


@pack
class Factor(NamedTuple):
    """A symmetric factor: multifrontal or banded Cholesky, or L D L^T in columns.

    order (n,): the place of each coordinate in the factor. The fields of the other kinds are empty.
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


def factor(model, blocks, backend="auto"):
    """(Factor, its name) of the plates' matrix, given as blocks (nnz, 2, 2) on the model's nodal pattern.

    backend: "auto" and "fronts" are the multifrontal Cholesky, "band" LAPACK's, "superlu" SuperLU. Where S is not positive definite
    both Cholesky factors give way to SuperLU's L D L^T. Raises NotFactorable.
    """
    indptr, indices = model.pattern
    if not np.isfinite(blocks).all():
        raise NotFactorable("the tangent is not finite")
    if backend in ("auto", "fronts"):
        known = model.once(symbolic_of)
        panels = factorize(known, blocks)
        if panels is not None:
            return _empty(FRONTS, known.order)._replace(fronts=known, panels=panels), "multifrontal Cholesky"
    if backend == "band":
        found = _band(indptr, indices, blocks, model.n)
        if found is not None:
            return found, "band Cholesky (LAPACK)"
    return _columns(indptr, indices, blocks, model.n), "L D L^T (SuperLU, MMD)"


def _empty(kind, order):
    integers, numbers = np.zeros(0, np.int32), np.zeros(0, np.float32)
    return Factor(kind, np.zeros((0, 1), np.float32), integers, integers, numbers, numbers, order, NOTHING, numbers)


def _band(indptr, indices, blocks, n):
    from scipy.linalg.lapack import dpbtrf

    width = 2 * int(np.max(np.abs(indices - np.repeat(np.arange(n // 2), np.diff(indptr))))) + 1
    band = np.empty((n, width + 1))
    fill_band(indptr, indices, blocks, band)
    done, info = dpbtrf(band.T, lower=1, overwrite_ab=1)
    if info:
        return None
    single = np.ascontiguousarray(done.T, np.float32)
    single[:, 0] = 1.0 / done[0]
    return _empty(BAND, np.arange(n, dtype=np.int32))._replace(band=single)


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
    return _empty(COLUMNS, lu.perm_c.astype(np.int32))._replace(
        start=lower.indptr.astype(np.int32),
        rows=lower.indices.astype(np.int32),
        values=lower.data.astype(np.float32),
        reciprocal=(1.0 / diagonal).astype(np.float32),
    )
