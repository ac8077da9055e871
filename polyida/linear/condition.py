"""Condition number of generalized-alpha's iteration matrix, for each scaling and each choice of the unknowns."""

import numpy as np

from polyida.errors import InputError
from polyida.linear.kkt import SCALINGS, assemble, scaling_factors

UNKNOWNS = ("q", "v", "a")
EXACT = 2000  # unknowns up to which the singular values are computed


def condition_number(model, integrator, state, scaling=None, unknown="q", exact=None):
    """Condition number of `[[S, B^T], [B, 0]]` at a state, `S = beta' M + gamma' C + K`, scaled as the integrator or
    `scaling` says.

    unknown: "q" for the unknowns (dq, dlam), or "v" or "a", whose increments are gamma' dq and beta' dq. exact: in the
    2-norm, from singular values (dense; by default up to 2000 unknowns); otherwise an estimate of the condition number
    in the 1-norm, from a sparse factor (Higham, Tisseur 2000), which is within a factor n + m of it and mostly within
    10. Returns inf where the matrix is singular. Raises InputError for an unknown scaling or unknown.
    """
    matrix = iteration_matrix(model, integrator, state, scaling, unknown)
    if exact is None:
        exact = matrix.shape[0] <= EXACT
    return _exact(matrix) if exact else _estimate(matrix)


def iteration_matrix(model, integrator, state, scaling=None, unknown="q"):
    """The matrix of `condition_number`, (n + m, n + m): CSC where the model's matrices are sparse, dense otherwise."""
    kind = integrator.scaling if scaling is None else scaling
    for name, value, known in (("scaling", kind, SCALINGS), ("unknown", unknown, UNKNOWNS)):
        if value not in known:
            raise InputError(f"condition_number: {name} = {value!r} must be one of {', '.join(known)}")
    c, h = integrator.coefficients, integrator.h
    to_a, to_v = (1 - c.alpha_m) / (c.beta * h * h * (1 - c.alpha_f)), c.gamma / (c.beta * h)
    tangent = model.tangent(state.t, state.q, state.v, state.a, state.lam, to_a, to_v, 1.0)
    phi_q = model.phi_q(state.t, state.q)
    divided = {"q": 1.0, "v": to_v, "a": to_a}[unknown]
    matrix = assemble(tangent, phi_q, scaling_factors(kind, c.beta * h * h, tangent))
    columns = np.ones(matrix.shape[0])
    columns[: model.n] = 1 / divided
    if hasattr(matrix, "tocsc"):
        from scipy.sparse import diags_array

        return (matrix @ diags_array(columns)).tocsc()
    return matrix * columns


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
    inverse = LinearOperator(matrix.shape, lu.solve, rmatvec=lambda b: lu.solve(b, trans="T"), matmat=lu.solve,
                             rmatmat=lambda b: lu.solve(b, trans="T"), dtype=float)
    return float(abs(matrix).sum(axis=0).max() * onenormest(inverse))
