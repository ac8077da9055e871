"""Factors of the plates' matrix `S = c_m M + K` in the layout that the compiled solves read."""

from typing import NamedTuple

import numpy as np

from polyida.linear.triangular import fill_band

BAND, COLUMNS = 0, 1
BAND_ENTRIES = 4_000_000  # above that, fill-reducing order beats the band


class Factor(NamedTuple):
    """A symmetric factor: banded Cholesky, or L D L^T in columns. order (n,): the place of each coordinate in the factor."""

    kind: int
    band: np.ndarray
    start: np.ndarray
    rows: np.ndarray
    values: np.ndarray
    reciprocal: np.ndarray
    order: np.ndarray


class NotFactorable(Exception):
    """S has no factor: it is singular or not finite."""


def factor(pattern, blocks, backend="auto"):
    """(Factor, its name) of a symmetric nodal block matrix: pattern (indptr, indices), blocks (nnz, 2, 2).

    backend: "auto", "band" (LAPACK) or "superlu". Where S is not positive definite the band gives way to SuperLU's L D L^T.
    Raises NotFactorable.
    """
    indptr, indices = pattern
    n = 2 * (len(indptr) - 1)
    if not np.isfinite(blocks).all():
        raise NotFactorable("the tangent is not finite")
    width = 2 * int(np.max(np.abs(indices - np.repeat(np.arange(n // 2), np.diff(indptr))))) + 1
    if backend == "band" or (backend == "auto" and n * width <= BAND_ENTRIES):
        found = _band(indptr, indices, blocks, n, width)
        if found is not None:
            return found, "band Cholesky (LAPACK)"
    return _columns(indptr, indices, blocks, n), "L D L^T (SuperLU, MMD)"


def _band(indptr, indices, blocks, n, width):
    from scipy.linalg.lapack import dpbtrf

    band = np.empty((n, width + 1))
    fill_band(indptr, indices, blocks, band)
    done, info = dpbtrf(band.T, lower=1, overwrite_ab=1)
    if info:
        return None
    single = np.ascontiguousarray(done.T, np.float32)
    single[:, 0] = 1.0 / done[0]
    none = np.zeros(0, np.int32)
    return Factor(BAND, single, none, none, np.zeros(0, np.float32), np.zeros(0, np.float32), np.arange(n, dtype=np.int32))


def _columns(indptr, indices, blocks, n):
    from scipy.sparse import bsr_array, tril
    from scipy.sparse.linalg import splu

    matrix = bsr_array((blocks, indices, indptr), shape=(n, n)).tocsc()
    try:
        lu = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    except RuntimeError as error:
        raise NotFactorable("the tangent is singular") from error
    if not np.array_equal(lu.perm_r, lu.perm_c):
        raise NotFactorable("the tangent is singular to working precision")
    lower, diagonal = tril(lu.L, -1, format="csc"), lu.U.diagonal()
    return Factor(COLUMNS, np.zeros((0, 1), np.float32), lower.indptr.astype(np.int32), lower.indices.astype(np.int32),
                  lower.data.astype(np.float32), (1.0 / diagonal).astype(np.float32), lu.perm_c.astype(np.int32))
