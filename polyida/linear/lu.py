"""LU factors of any square matrix, dense or sparse, real or complex; matrices made of blocks; and how many factors of any kind are kept."""

import numpy as np

LEAST = 4 * np.finfo(float).eps  # pivot over n times the largest entry that may be round-off of zero
SYMMETRIC_MODE = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
# constants of compiled code, some of them
KEPT = 6  # factors that are kept, of the steps h used last


class SingularSystem(Exception):
    """The system has no unique solution."""


def dense(matrix):
    """The matrix, dense or scipy.sparse, as a dense array of floats."""
    return matrix.toarray() if hasattr(matrix, "toarray") else np.asarray(matrix, float)


def block_matrix(blocks):
    """The matrix made of rows of blocks, None for zeros: CSC where the first of them is sparse, dense otherwise."""
    heights = [next(block.shape[0] for block in row if block is not None) for row in blocks]
    widths = [next(block.shape[1] for block in column if block is not None) for column in zip(*blocks)]
    if hasattr(blocks[0][0], "tocsc"):
        from scipy.sparse import block_array, csr_array

        rows = [[block for block, width in zip(row, widths) if width] for row, height in zip(blocks, heights) if height]
        return block_array([[None if block is None else csr_array(block) for block in row] for row in rows], format="csc")
    kinds = [block.dtype for row in blocks for block in row if block is not None]
    matrix = np.zeros((sum(heights), sum(widths)), np.result_type(float, *kinds))
    rows, columns = np.cumsum([0, *heights]), np.cumsum([0, *widths])
    for i, row in enumerate(blocks):
        for j, block in enumerate(row):
            if block is not None:
                matrix[rows[i] : rows[i + 1], columns[j] : columns[j + 1]] = block.toarray() if hasattr(block, "toarray") else block
    return matrix


class LU:
    """A factor of A (n, n): LAPACK's, dense, or SuperLU's, sparse. Raises SingularSystem where A is singular or not finite.

    pivoting: SuperLU's too with partial pivoting; by default it keeps the order of minimum degree on the pattern of A + A^T.
    """

    def __init__(self, matrix, pivoting=False):
        sparse = hasattr(matrix, "tocsc")
        matrix = matrix.tocsc() if sparse else np.asarray(matrix)
        if not np.isfinite(matrix.data if sparse else matrix).all():
            raise SingularSystem("the iteration matrix is not finite")
        self._solve, self._pivots = _sparse(matrix, {} if pivoting else SYMMETRIC_MODE) if sparse else _dense(matrix)
        self._size = abs(matrix).max() if matrix.shape[0] else 0.0

    def solve(self, b, transposed=False):
        """A^-1 b, or A^-T b, b (n,) or (n, k)."""
        return self._solve(b, transposed) if np.size(b) else np.array(b)

    def doubtful(self):
        """Whether a pivot may be round-off of zero."""
        pivots = np.abs(self._pivots())
        return bool(pivots.min(initial=np.inf) <= LEAST * len(pivots) * self._size)


def _dense(matrix):
    from scipy.linalg import get_lapack_funcs

    getrf, getrs = get_lapack_funcs(("getrf", "getrs"), (matrix,))
    lu, pivots, info = getrf(matrix)
    if info:
        raise SingularSystem("the iteration matrix is singular")
    return (lambda b, transposed: getrs(lu, pivots, b, trans=int(transposed))[0]), lu.diagonal


def _sparse(matrix, options):
    from scipy.sparse.linalg import splu

    try:
        lu = splu(matrix, **options)
    except RuntimeError as error:  # what SuperLU raises where the matrix is singular
        raise SingularSystem("the iteration matrix is singular") from error
    return (lambda b, transposed: lu.solve(b, trans="T" if transposed else "N")), lambda: lu.U.diagonal()


class Kept:
    """The factors of the few steps h that were used last: adaptive steps come back to them."""

    def __init__(self):
        self.factors = {}

    def take(self, h):
        """What is kept of this h, or None."""
        found = self.factors.pop(h, None)
        if found is not None:
            self.factors[h] = found
        return found

    def keep(self, h, factor):
        """Keep a factor, in place of that of the h that has not been used for the longest time."""
        self.factors.pop(h, None)
        self.factors[h] = factor
        while len(self.factors) > KEPT:
            self.factors.pop(next(iter(self.factors)))
