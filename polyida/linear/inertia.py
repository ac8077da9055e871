"""Whether a symmetric matrix K is positive definite on the null space of B, from the inertia of `[[K, B^T], [B, 0]]`.

That matrix has m negative eigenvalues, m the rows of B, exactly where K is. It is congruent to itself with `K + g B^T B` in place of K,
any g, and so has the negative eigenvalues of that and those of `-B (K + g B^T B)^-1 B^T` (Haynsworth 1968); those of a symmetric
factor L D L^T are the negative entries of D (Sylvester).
"""

import numpy as np

from polyida.linear.kkt import assemble, scaling_factors
from polyida.linear.lu import SYMMETRIC_MODE, SingularSystem

SYMMETRIC = 1e-6  # largest deviation of K from its transpose, over its largest entry, that derivatives by differences explain


def falling(tangent, phi_q):
    """Number of independent directions that phi_q allows in which the tangent (n, n), is negative; None where it is not symmetric.

    Raises SingularSystem where the sparse factor breaks down.
    """
    if not symmetric(tangent):
        return None
    m = phi_q.shape[0]
    if not hasattr(tangent, "tocsc"):
        matrix = assemble(tangent, phi_q, scaling_factors("physical", 1.0, tangent))
        return int(np.sum(np.linalg.eigvalsh((matrix + matrix.T) / 2) < 0)) - m
    size = float(np.mean(np.abs(tangent.diagonal()))) or 1.0
    if not m:
        return _negative(tangent / size)[0]
    from scipy.sparse import csr_array, diags_array

    rows = csr_array(phi_q)
    border = diags_array(1.0 / np.sqrt(rows.multiply(rows).sum(axis=1))) @ rows
    negative, solve = _negative(tangent / size + border.T @ border)
    schur = border @ solve(border.T.toarray())
    return negative + int(np.sum(np.linalg.eigvalsh((schur + schur.T) / 2) > 0)) - m


def symmetric(matrix):
    """Whether a matrix is its transpose, but for what derivatives by differences explain."""
    return abs(matrix - matrix.T).max() <= SYMMETRIC * abs(matrix).max()


def _negative(matrix):
    """(number of negative eigenvalues, solve) of a sparse symmetric matrix, from L D L^T without pivoting."""
    from scipy.sparse.linalg import splu

    try:
        lu = splu(matrix.tocsc(), **SYMMETRIC_MODE)
    except RuntimeError as error:
        raise SingularSystem("the tangent is singular") from error
    if not np.array_equal(lu.perm_r, lu.perm_c):
        raise SingularSystem("the tangent is singular to working precision")
    return int(np.sum(lu.U.diagonal() < 0)), lu.solve
