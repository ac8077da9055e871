"""How well linear back-ends solve generalized-alpha's saddle-point system, unscaled and scaled."""

import numpy as np

from polyida.linear.kkt import Scaling, assemble
from polyida.study.conditioning import alpha_blocks, alpha_factors, dense

REGULARISATION = 1e-8  # of the LDL^T without pivoting, on the multipliers' diagonal


def dense_pivoting(A, b):
    """LAPACK LU with partial pivoting."""
    from scipy.linalg import lu_factor, lu_solve

    return lu_solve(lu_factor(dense(A)), b)


def equilibrated(solve):
    """The same solve after dividing rows and then columns by their largest entries (powers of two)."""

    def solved(A, b):
        from scipy.sparse import csr_array, diags_array

        A = csr_array(A)
        row = 2.0 ** -np.round(np.log2(abs(A).max(axis=1).toarray().ravel()))
        column = 2.0 ** -np.round(np.log2(abs(diags_array(row) @ A).max(axis=0).toarray().ravel()))
        return column * solve((diags_array(row) @ A @ diags_array(column)).tocsc(), row * b)

    return solved


def _superlu(A, b, symmetric):
    from scipy.sparse import csc_array
    from scipy.sparse.linalg import splu

    if symmetric:
        return splu(
            csc_array(A), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        ).solve(b)
    return splu(csc_array(A), permc_spec="COLAMD").solve(b)


def sparse_pivoting(A, b):
    """SuperLU with partial pivoting in the columns' order of least fill (COLAMD), which may put multipliers first."""
    return _superlu(A, b, False)


def sparse_symmetric(A, b):
    """SuperLU in symmetric mode: it pivots on the diagonal wherever that is not zero."""
    return _superlu(A, b, True)


def regularised(A, b):
    """LDL^T on the diagonal without pivoting, -1e-8 on the diagonal of the multipliers."""
    from scipy.sparse import diags_array

    return _superlu(A - diags_array(REGULARISATION * (A.diagonal() == 0)), b, True)


def schur(A, b):
    """A factor of S alone and the Schur complement of the constraints; A is unscaled or scaled."""
    from scipy.sparse.linalg import splu

    n = int(np.flatnonzero(A.diagonal())[-1]) + 1
    A = A.tocsc()
    factor = splu(A[:n, :n], permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    columns = factor.solve(A[:n, n:].toarray())
    y = factor.solve(b[:n])
    lam = np.linalg.solve(A[n:, :n] @ columns, A[n:, :n] @ y - b[n:])
    return np.concatenate([y - columns @ lam, lam])


BACKENDS = {
    "dense LU, partial pivoting": dense_pivoting,
    "dense LU, equilibrated": equilibrated(dense_pivoting),
    "sparse LU, partial pivoting": sparse_pivoting,
    "sparse LU, partial pivoting, equilibrated": equilibrated(sparse_pivoting),
    "sparse LU, pivots on the diagonal": sparse_symmetric,
    "sparse LU, pivots on the diagonal, equilibrated": equilibrated(sparse_symmetric),
    "LDL^T, regularised": regularised,
    "factor of S, Schur complement": schur,
}


def solve_errors(model, state, h, backend, scaling, trials=3, seed=0):
    """(largest relative error of dq, of dlam) over random solutions: |x - x*| / |x*| in the largest entry.

    dq* is a random motion of the accelerations' size h^2 |a|, dlam* of the multipliers'; the right-hand side is formed
    in extended precision.
    """
    tangent, B, step_square = alpha_blocks(model, state, h)
    factors, random, worst = (
        Scaling(*alpha_factors(scaling, step_square, tangent)),
        np.random.default_rng(seed),
        np.zeros(2),
    )
    S, border = dense(tangent).astype(np.longdouble), dense(B).astype(np.longdouble)
    for _ in range(trials):
        dq = h * h * np.abs(state.a).max() * random.standard_normal(model.n)
        dlam = np.abs(state.lam).max() * random.standard_normal(model.m)
        r, phi = np.asarray(S @ dq + border.T @ dlam, float), np.asarray(border @ dq, float)
        found = _solve(backend, tangent, B, factors, r, phi)
        errors = [np.abs(x - known).max() / np.abs(known).max() for x, known in zip(found, (dq, dlam))]
        worst = np.maximum(worst, errors)
    return float(worst[0]), float(worst[1])


def _solve(backend, tangent, B, factors, r, phi):
    from scipy.sparse import csc_array

    matrix = csc_array(assemble(tangent, B, factors))
    n, x = len(r), BACKENDS[backend](matrix, np.concatenate([factors.row * r, phi]))
    return x[:n], factors.column * x[n:]
