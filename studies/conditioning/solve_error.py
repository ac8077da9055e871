"""Accuracy of linear back-ends for the saddle-point system of generalized-alpha and the whole system of IDA, unscaled and scaled."""

import numpy as np

from conditioning.systems import alpha_blocks, alpha_factors
from polyida.integrate.ida.forms import System
from polyida.integrate.ida.integrator import IDA
from polyida.integrate.ida.tables import sizes, whole_matrix
from polyida.linear.lu import dense, scaled
from polyida.linear.saddle import assemble

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
        return splu(csc_array(A), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}).solve(b)
    return splu(csc_array(A), permc_spec="COLAMD").solve(b)


def sparse_pivoting(A, b):
    """SuperLU with partial pivoting and the column order of smallest fill (COLAMD), which may put multipliers first."""
    return _superlu(A, b, False)


def sparse_symmetric(A, b):
    """SuperLU in symmetric mode: it pivots on the diagonal unless the entry is zero."""
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
WHOLE = tuple(name for name, solve in BACKENDS.items() if solve not in (regularised, schur))  # those that IDA's matrix suits


def alpha_errors(model, state, h, backend, scaling):
    """(largest relative error of dq, of dlam) of the system of generalized-alpha."""
    tangent, B, step_square = alpha_blocks(model, state, h)
    factors = alpha_factors(scaling, step_square, tangent, model.m)
    return solve_errors(dense(assemble(tangent, B)), *factors, _unknowns(model, state, h)[::2], backend)


def ida_errors(model, state, h, form, backend, scaling):
    """(largest relative errors of dq, dv, dlam and, if the form has it, dmu) of IDA's whole system, cj = 1/h."""
    system, cj = System(model, form, IDA().baumgarte_rate), 1 / h
    matrix, s = whole_matrix(system, state.t, *system.pack(state), cj)
    rows, columns = sizes(scaling, system.form, model.n, model.m, cj, s)
    dq, dv, dlam = _unknowns(model, state, h)
    unit = h if system.form.integrated else 1.0
    dmu = ((model.m, unit * dv[1]),) if system.form.stabilised else ()
    return solve_errors(dense(matrix), rows, columns, (dq, dv, (model.m, unit * dlam[1]), *dmu), backend)


def _unknowns(model, state, h):
    """(number, size) of dq, dv and dlam in one step: motions of the size of the accelerations, multipliers of their own size."""
    a = np.abs(state.a).max()
    return (model.n, h * h * a), (model.n, h * a), (model.m, np.abs(state.lam).max())


def solve_errors(matrix, rows, columns, unknowns, backend, trials=3, seed=0):
    """|x - x*| / |x*| in the largest entry for each kind of unknown: the maximum over random x* with the (number, size) of each kind in
    `unknowns`. A back-end solves diag(rows) A diag(columns); the right-hand side is computed in extended precision.
    """
    from scipy.sparse import csc_array

    kinds = np.repeat(np.arange(len(unknowns)), [number for number, _ in unknowns])
    exact, scaled_matrix = matrix.astype(np.longdouble), csc_array(scaled(matrix, rows, columns))
    random, worst = np.random.default_rng(seed), np.zeros(len(unknowns))
    for _ in range(trials):
        x = np.array([size for _, size in unknowns])[kinds] * random.standard_normal(len(kinds))
        result = columns * BACKENDS[backend](scaled_matrix, rows * np.asarray(exact @ x, float))
        errors = [np.abs(result - x)[kinds == k].max() / np.abs(x[kinds == k]).max() for k in range(len(unknowns))]
        worst = np.maximum(worst, errors)
    return tuple(worst.tolist())
