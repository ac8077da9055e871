"""LU factors of square matrices, dense or sparse, real or complex; matrices made of blocks; scaling and condition numbers."""

import numpy as np

LEAST = 4 * np.finfo(float).eps  # a pivot below n times this times the largest entry may be round-off of zero
SYMMETRIC_MODE = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
# constants of compiled code
FACTORS = 6  # factors in a FactorCache, and in those of the compiled drivers


class SingularSystem(Exception):
    """The system has no unique solution."""


def dense(matrix):
    """The matrix, dense or scipy.sparse, as a dense array of floats."""
    return matrix.toarray() if hasattr(matrix, "toarray") else np.asarray(matrix, float)


def block_matrix(blocks):
    """The matrix of rows of blocks, None for zeros: CSC if the first block is sparse, dense otherwise."""
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


def summed(entries, n, columns=None):
    """The matrix (n, columns), by default (n, n), CSC, of which `entries` are parts, (rows, columns, values) each; equal places are added."""
    from scipy.sparse import csc_array

    none = np.zeros(0, int), np.zeros(0, int), np.zeros(0)
    i, j, values = map(np.concatenate, zip(none, *entries))
    return csc_array((values, (i, j)), shape=(n, columns or n))


class LU:
    """A factor of A (n, n): LAPACK's, dense, or SuperLU's, sparse. Raises SingularSystem if A is singular or not finite.

    pivoting: partial pivoting of SuperLU too; by default it keeps the order of minimum degree on the pattern of A + A^T.
    """

    def __init__(self, matrix, pivoting=False):
        """Factor a matrix, dense or sparse."""
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
        """True if a pivot may be round-off of zero."""
        pivots = np.abs(self._pivots())
        return bool(pivots.min(initial=np.inf) <= LEAST * len(pivots) * self._size)


def _dense(matrix):
    """(function (b, transposed) that solves by LAPACK's factor, function that returns its pivots). Raises SingularSystem."""
    from scipy.linalg import get_lapack_funcs

    getrf, getrs = get_lapack_funcs(("getrf", "getrs"), (matrix,))
    lu, pivots, info = getrf(matrix)
    if info:
        raise SingularSystem("the iteration matrix is singular")
    return (lambda b, transposed: getrs(lu, pivots, b, trans=int(transposed))[0]), lu.diagonal


def _sparse(matrix, options):
    """(function (b, transposed) that solves by SuperLU's factor, function that returns its pivots). Raises SingularSystem."""
    from scipy.sparse.linalg import splu

    try:
        lu = splu(matrix, **options)
    except RuntimeError as error:  # SuperLU: the matrix is singular
        raise SingularSystem("the iteration matrix is singular") from error
    return (lambda b, transposed: lu.solve(b, trans="T" if transposed else "N")), lambda: lu.U.diagonal()


class FactorCache:
    """The factors of the step sizes h that were used last: adaptive steps return to them."""

    def __init__(self):
        """Begin without factors; those used last are at the end."""
        self.factors = {}

    def get(self, h):
        """The factor of a step h, or None."""
        factor = self.factors.pop(h, None)
        if factor is not None:
            self.factors[h] = factor
        return factor

    def keep(self, h, factor):
        """Store a factor and drop that of the h that has not been used for the longest time."""
        self.factors.pop(h, None)
        self.factors[h] = factor
        while len(self.factors) > FACTORS:
            self.factors.pop(next(iter(self.factors)))


def first_order_matrix(c, K, slope, lam, mu, on_q, on_v):
    """The matrix, (N, N), of a Newton iteration on q' - v and r together, N = 2 n and the multipliers; CSC if K is sparse.

        |  c I    -I                mu  |  |dq  |     q'
        |  K    c M + C    lam          |  |dv  |     r
        |  on q    on v                 |  |dlam|     derivatives of phi, in their order
                                           |dmu |

    c, 1/s, real or complex: the rate of q and v of a method divided by q and v. slope: c M + C. lam, mu: columns (n, m); mu is None in some
    forms. on_q, on_v: rows of the constraints.
    """
    if hasattr(K, "tocsc"):
        from scipy.sparse import eye_array as eye
    else:
        eye = np.eye
    unit = eye(K.shape[0])
    rows = [[c * unit, -unit, None, mu], [K, slope, lam, None], [on_q, on_v, None, None]]
    return block_matrix(rows if mu is not None else [row[:3] for row in rows])


def first_order_sizes(c, s, n, m, orders, mu, unit=1.0):
    """Factors (of rows, of columns), (N,) each, of `first_order_matrix`.

    Rows: q' is divided by c, r by s, the k-th derivative of phi, k in `orders`, by c^k. Columns: dv and mu are measured in c, lam in s, both
    multipliers in `unit` besides. mu: True if there are columns mu. All factors are 1 for c = s = unit = 1.
    """
    rows = [np.full(n, 1 / c), np.full(n, 1 / s)] + [np.full(m, c**-k) for k in orders]
    columns = [np.ones(n), np.full(n, c), np.full(m, s * unit)] + [np.full(m, c * unit)] * mu
    return np.concatenate(rows), np.concatenate(columns)


class ScaledLU:
    """A factor of diag(rows) A diag(columns) with partial pivoting: LAPACK's or, sparse, SuperLU's. Raises SingularSystem."""

    def __init__(self, matrix, rows, columns):
        """Factor the matrix A (N, N) with the scaling factors of its rows (N,) and columns (N,)."""
        self.rows, self.columns = rows, columns
        self.lu = LU(scaled(matrix, rows, columns), pivoting=True)

    def solve(self, b, transposed=False):
        """A^-1 b, or A^-T b, (N,)."""
        before, behind = (self.columns, self.rows) if transposed else (self.rows, self.columns)
        return behind * self.lu.solve(before * b, transposed)


EXACT = 2000  # unknowns up to which the dense inverse is computed


def condition(matrix, exact=None):
    """Condition number `|A| |A^-1|` of A (N, N), real or complex, dense or sparse; inf if A is singular.

    exact: in the 2-norm (default up to 2000 unknowns), otherwise an estimate in the 1-norm (Higham, Tisseur 2000).
    """
    if exact is None:
        exact = matrix.shape[0] <= EXACT
    if exact:
        return _exact(matrix)
    from scipy.sparse import csc_array
    from scipy.sparse.linalg import LinearOperator, onenormest, splu

    matrix = csc_array(matrix)
    try:
        lu = splu(matrix)
    except RuntimeError:
        return np.inf
    back = lambda b: lu.solve(b, trans="H")  # noqa: E731
    inverse = LinearOperator(matrix.shape, lu.solve, back, lu.solve, matrix.dtype, back)
    return float(abs(matrix).sum(axis=0).max() * onenormest(inverse))


def scaled(matrix, rows, columns):
    """diag(rows) A diag(columns) for rows and columns (N,): CSC where A is sparse."""
    if isinstance(matrix, np.ndarray):
        return rows[:, None] * matrix * columns
    from scipy.sparse import diags_array

    return (diags_array(rows) @ matrix @ diags_array(columns)).tocsc()


def _exact(matrix):
    """|A| |A^-1| in the 2-norm. The inverse is that of the equilibrated matrix, scaled back: right also beyond 1e16."""
    matrix = matrix.toarray() if hasattr(matrix, "toarray") else matrix
    with np.errstate(divide="ignore", invalid="ignore"):
        rows = 1 / np.abs(matrix).max(axis=1)
        columns = 1 / np.abs(rows[:, None] * matrix).max(axis=0)
    if not (np.isfinite(rows).all() and np.isfinite(columns).all()):
        return np.inf
    try:
        inverse = np.linalg.inv(rows[:, None] * matrix * columns)
    except np.linalg.LinAlgError:
        return np.inf
    return float(np.linalg.norm(matrix, 2) * np.linalg.norm(columns[:, None] * inverse * rows, 2))
