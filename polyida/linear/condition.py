"""Condition number of a matrix, exact or estimated, right also where singular values lose their digits."""

import numpy as np

EXACT = 2000  # unknowns up to which the dense inverse is computed


def condition(matrix, exact=None):
    """|A| |A^-1| of A, (N, N), real or complex, dense or sparse: in the 2-norm (exact; by default up to 2000 unknowns), otherwise an estimate
    of that in the 1-norm (Higham, Tisseur 2000). inf where A is singular.
    """
    if exact is None:
        exact = matrix.shape[0] <= EXACT
    return _exact(matrix) if exact else _estimate(matrix)


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


def _estimate(matrix):
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
