"""The matrix of a Newton iteration on q' - v and r at once, in one piece, its rows and columns divided by typical sizes.

    |  c I    -I                mu  |  |dq  |     q'
    |  K    c M + C    lam          |  |dv  |     r
    |  on q    on v                 |  |dlam|     derivatives of phi, in their order
                                       |dmu |

c, 1/s, is what a method's rate of q and v grows by with them, real or complex; columns lam and mu (n, m), the latter not in every form.
"""

import numpy as np

from polyida.linear.lu import LU, block_matrix


def joined(c, K, slope, lam, mu, on_q, on_v):
    """The matrix, (N, N), of slope = c M + C, columns lam and mu (or None) and constraint rows on dq and dv: CSC where K is sparse."""
    if hasattr(K, "tocsc"):
        from scipy.sparse import eye_array as eye
    else:
        eye = np.eye
    unit = eye(K.shape[0])
    rows = [[c * unit, -unit, None, mu], [K, slope, lam, None], [on_q, on_v, None, None]]
    return block_matrix(rows if mu is not None else [row[:3] for row in rows])


def sizes(c, s, n, m, orders, mu, unit=1.0):
    """Factors (of rows, of columns), (N,) each: r divided by s, q' by c, the k-th derivative of phi, k in `orders`, by c^k; dv and mu,
    where there is any, measured in c, lam in s, both multipliers in `unit` more.
    """
    rows = [np.full(n, 1 / c), np.full(n, 1 / s)] + [np.full(m, c**-k) for k in orders]
    columns = [np.ones(n), np.full(n, c), np.full(m, s * unit)] + [np.full(m, c * unit)] * mu
    return np.concatenate(rows), np.concatenate(columns)


def raw(n, m, mu):
    """The same of a matrix as it is."""
    return tuple(np.ones((2, 2 * n + m * (2 if mu else 1))))


class ScaledLU:
    """A factor of diag(rows) A diag(columns) with partial pivoting: LAPACK's or, sparse, SuperLU's. Raises SingularSystem."""

    def __init__(self, matrix, rows, columns):
        self.rows, self.columns = rows, columns
        self.lu = LU(scaled(matrix, rows, columns), pivoting=True)

    def solve(self, b, transposed=False):
        """A^-1 b, or A^-T b, (N,)."""
        before, behind = (self.columns, self.rows) if transposed else (self.rows, self.columns)
        return behind * self.lu.solve(before * b, transposed)


EXACT = 2000  # unknowns up to which the dense inverse is computed


def condition(matrix, exact=None):
    """|A| |A^-1| of A, (N, N), real or complex, dense or sparse: in the 2-norm (exact; by default up to 2000 unknowns), otherwise an estimate
    of that in the 1-norm (Higham, Tisseur 2000). inf where A is singular.
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
