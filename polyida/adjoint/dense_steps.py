"""The adjoint of a step of a small model with dense matrices, in compiled code: one factor of the whole system of all stages.

The system is that of exact_steps.py. Its unknowns are w of all stages (s n), then mu* (s m), then kappa (s m) if the steps have mu; its rows are
the equations of w, then B_i w_i, then B_i D^-1 v*_i. In: the states of the stages and right sides of a step (adjoint/tables.py). Out: w, the
multipliers and the products of the step.
"""

from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
from numba import carray, typeof

from polyida.adjoint.tables import AdjointTable, by_stages
from polyida.errors import DONE, NOT_FINITE, SINGULAR
from polyida.jit import entry, fast, pack, part
from polyida.jit.intrinsics import pointer
from polyida.jit.user_functions import table_address
from polyida.linear import dense as compiled_lu
from polyida.linear.dense import clear, copy_matrix, put, zero
from polyida.system import ADJOINT, ENTRIES, dense_slots
from polyida.system import dense as small


@pack
class DenseAdjointWork(NamedTuple):
    """The workspace of a model and steps of s stages; count steps are prepared."""

    model: small.Dense
    t: np.ndarray  # (count, s) states of the stages
    q: np.ndarray  # (count, s, n)
    v: np.ndarray  # (count, s, n)
    a: np.ndarray  # (count, s, n)
    lam: np.ndarray  # (count, s, m)
    mu: np.ndarray  # (count, s, m), or (count, s, 0) if the steps have none
    to_v: np.ndarray  # (s, s) of exact_steps.py, for steps of h
    to_a: np.ndarray  # (s, s)
    lift: np.ndarray  # (n,) diagonal of D^-1
    K: np.ndarray  # (s, n, n) dr/dq of the stages
    C: np.ndarray  # (s, n, n) dr/dv
    M: np.ndarray  # (s, n, n) dr/da
    T: np.ndarray  # (s, n, n) (B^T mu)_q D^-1
    B: np.ndarray  # (s, m, n) phi_q
    G: np.ndarray  # (s, m, n) B D^-1
    H: np.ndarray  # (s, m, n) d(B v + phi_t)/dq
    rates: np.ndarray  # (n, n) derivative of v* of a stage in w of a stage
    columns: int  # number of right-hand sides
    matrix: np.ndarray  # (N, N) the system of a step
    pivots: np.ndarray  # (N,) rows that were exchanged
    x: np.ndarray  # (N,) a solution
    solved: np.ndarray  # (1,) number of solutions


@entry
def solve(work, step, right, below, b_v, fields, multipliers, out):
    """The entry ADJOINT: fill w, the multipliers and the products of a step for all columns. Returns a status.

    Addresses of right, fields = w (s, columns, n), below (s, columns, m), b_v (columns, n), the adjoint of v at the end of the step,
    multipliers (1 or 2, s, columns, m) and out (3, s, columns, n).
    """
    (s, m, n), kinds, columns = work.B.shape, 1 + (work.mu.shape[2] > 0), work.columns
    for i in range(s):
        status = evaluate(work, step, i)
        if status != DONE:
            return status
    size, unit = 0.0, 1.0 / abs(work.to_v[s - 1, s - 1])
    for p in range(n):
        size += abs(work.K[s - 1, p, p] + work.to_a[s - 1, s - 1] * work.M[s - 1, p, p]) / n
    size = size if size > 0.0 else 1.0
    assemble(work, size, unit)
    if not compiled_lu.factor(work.matrix, work.pivots):
        return SINGULAR
    right, below = carray(pointer(right), (s, columns, n)), carray(pointer(below), (s, columns, m))
    b_v, fields = carray(pointer(b_v), (columns, n)), carray(pointer(fields), (s, columns, n))
    multipliers, out = carray(pointer(multipliers), (kinds, s, columns, m)), carray(pointer(out), (3, s, columns, n))
    for c in range(columns):
        status = solve_column(work, size, unit, right[:, c], below[:, c], b_v[c], fields[:, c], multipliers[:, :, c], out[:, :, c])
        if status != DONE:
            return status
    return DONE


@part
def evaluate(work, step, stage):
    """Evaluate K, C, M, T, B and H of a stage of a step. Returns a status."""
    d = work.model
    d.t[small.INNER] = d.t[small.END] = work.t[step, stage]
    put(1.0, work.q[step, stage], d.q)
    put(1.0, work.v[step, stage], d.v)
    put(1.0, work.a[step, stage], d.a)
    put(1.0, work.lam[step, stage], d.lam)
    d.flags[small.ENDED] = DONE
    dense_slots.matrices_at(d, work.K[stage], work.C[stage], work.M[stage])
    if work.mu.shape[2] and d.flags[small.ROWS_VARY]:
        differentiate_rows(work, d, work.mu[step, stage], work.H[stage], work.T[stage])
    if d.lam.shape[0] and d.flags[small.ROWS_VARY]:
        small.evaluate(d, small.PHI_Q, small.INNER, d.B)
    copy_matrix(d.B, work.B[stage])
    for k in range(d.B.shape[0]):
        for p in range(d.B.shape[1]):
            work.G[stage, k, p] = d.B[k, p] * work.lift[p]
    return d.flags[small.ENDED]


@part
def differentiate_rows(work, model, mu, rate_q, reaction_q):
    """rate_q = d(B v + phi_t)/dq and reaction_q = (B^T mu)_q D^-1 by differences of fourth order (model/differences.py)."""
    clear(rate_q)
    clear(reaction_q)
    for j in range(model.q.shape[0]):
        at = model.q[j]
        step = small.REACH * max(1.0, abs(at))
        for e in range(4):
            model.q[j], weight = at + (1.0, -1.0, 2.0, -2.0)[e] * step, (8.0, -8.0, -1.0, 1.0)[e] / (12.0 * step)
            small.evaluate(model, small.PHI_Q, small.INNER, model.B)
            if model.flags[small.DRIVEN]:
                small.evaluate(model, small.PHI_T, small.INNER, model.phi_t)
            for k in range(mu.shape[0]):
                rate_q[k, j] += weight * model.phi_t[k]
                for i in range(model.q.shape[0]):
                    rate_q[k, j] += weight * model.B[k, i] * model.v[i]
                    reaction_q[i, j] += weight * model.B[k, i] * mu[k] * work.lift[j]
        model.q[j] = at


@part
def assemble(work, size, unit):
    """Fill the matrix of a step, columns of w in units of 1/size, of kappa in `unit`.

    The rows of the equations of w are not scaled, those of B w are multiplied by size, those of B D^-1 v* by 1/unit: then all blocks have
    entries of similar size.
    """
    A, (stages, m, n) = work.matrix, work.B.shape
    clear(A)
    for i in range(stages):
        lam = stages * n + i * m
        add_transposed(1.0, work.K[i], A[i * n :, i * n :])
        for j in range(stages):
            add_transposed(work.to_a[i, j], work.M[j], A[i * n :, j * n :])
            add_transposed(work.to_v[i, j], work.C[j], A[i * n :, j * n :])
            if work.mu.shape[2]:
                add_rates(work, i, j)
        for e in range(m):
            for p in range(n):
                A[i * n + p, lam + e] = A[lam + e, i * n + p] = work.B[i, e, p]
    of_rows, of_rates = stages * n, stages * (n + m)  # where the second and the third block begin
    for k in range(A.shape[0]):
        row = value_of_block(k, of_rows, of_rates, 1.0, size, 1.0 / unit)
        for o in range(A.shape[0]):
            A[k, o] *= row * value_of_block(o, of_rows, of_rates, 1.0 / size, 1.0, unit)


@part
def value_of_block(number, second_block, third_block, first, second, third):
    """The one of three values that belongs to the block of a row or column with this number."""
    if number < second_block:
        return first
    if number < third_block:
        return second
    return third


@part
def add_rates(work, stage, other):
    """Add the terms of v* of a stage that come from w_j and kappa_j of the stage j = `other`, and those of kappa_j itself, to the matrix.

        v*_i = (C_i^T if i = j) w_j + to_v_ij M_j^T w_j + (B_i^T if i = j) kappa_j

    stands as T_i v*_i in the equations of w_i, and as B_i D^-1 v*_i in the rows of the third block. kappa_j stands in the equations of w_i
    with to_v_ij B_j^T, and with H_i^T if i = j.
    """
    A, (stages, m, n), rates = work.matrix, work.B.shape, work.rates
    rows, columns = stages * (n + m) + stage * m, stages * (n + m) + other * m
    clear(rates)
    add_transposed(work.to_v[stage, other], work.M[other], rates)
    add_transposed(work.to_v[stage, other], work.B[other], A[stage * n :, columns:])
    if stage == other:
        add_transposed(1.0, work.C[stage], rates)
        add_transposed(1.0, work.H[stage], A[stage * n :, columns:])
        add_product(work.T[stage], work.B[stage].T, A[stage * n :, columns:])
        add_product(work.G[stage], work.B[stage].T, A[rows:, columns:])
    add_product(work.T[stage], rates, A[stage * n :, other * n :])
    add_product(work.G[stage], rates, A[rows:, other * n :])


@fast
def add_transposed(factor, matrix, out):
    """out += factor matrix^T, in the upper left corner of out."""
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            out[j, i] += factor * matrix[i, j]


@fast
def add_product(left, right, out):
    """out += left right, in the upper left corner of out."""
    for i in range(left.shape[0]):
        for j in range(right.shape[1]):
            for k in range(right.shape[0]):
                out[i, j] += left[i, k] * right[k, j]


@fast
def add_times(factor, matrix, vector, out):
    """out += factor matrix vector, at the beginning of out."""
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            out[i] += factor * matrix[i, j] * vector[j]


@part
def solve_column(work, size, unit, right, below, b_v, fields, multipliers, out):
    """Solve for a column with the factors of the step. Returns a status."""
    (s, m, n), x = work.B.shape, work.x
    for i in range(s):
        put(1.0, right[i], x[i * n :])
        put(size, below[i], x[s * n + i * m :])
    zero(x[s * (n + m) :])
    if multipliers.shape[0] == 2:
        add_times(-1.0, work.T[s - 1], b_v, x[(s - 1) * n :])
        add_times(-1.0 / unit, work.G[s - 1], b_v, x[s * (n + m) + (s - 1) * m :])
    compiled_lu.solve(work.matrix, work.pivots, x)
    if not small.finite(x):
        return NOT_FINITE
    for i in range(s):
        put(1.0 / size, x[i * n : (i + 1) * n], fields[i])
        for f in range(multipliers.shape[0]):
            at = s * n + (f * s + i) * m
            put(unit if f == 1 else 1.0, x[at : at + m], multipliers[f, i])
    products(work, fields, multipliers, b_v, out)
    work.solved[0] += 1
    return DONE


@part
def products(work, fields, multipliers, b_v, out):
    """Fill out with the products of the multipliers with the transposed matrices: their parts of q*, v* and a*."""
    stages, of_q, of_v, of_a, rate = fields.shape[0], out[0], out[1], out[2], work.x[: fields.shape[1]]
    for i in range(stages):
        zero(of_q[i])
        zero(of_v[i])
        zero(of_a[i])
        add_times(1.0, work.K[i].T, fields[i], of_q[i])
        add_times(1.0, work.C[i].T, fields[i], of_v[i])
        add_times(1.0, work.M[i].T, fields[i], of_a[i])
        add_times(1.0, work.B[i].T, multipliers[0, i], of_q[i])
        if multipliers.shape[0] == 2:
            add_times(1.0, work.H[i].T, multipliers[1, i], of_q[i])
            add_times(1.0, work.B[i].T, multipliers[1, i], of_v[i])
    for i in range(stages if multipliers.shape[0] == 2 else 0):
        for p in range(rate.shape[0]):
            rate[p] = of_v[i, p] + (b_v[p] if i == stages - 1 else 0.0)
            for j in range(stages):
                rate[p] += work.to_v[i, j] * of_a[j, p]
        add_times(1.0, work.T[i], rate, of_q[i])


class DenseAdjoint(AdjointTable):
    """The table of a small model for steps of s stages; table: that of its functions; to_v, to_a (s, s), lift: of exact_steps.py.

    tied: True if the steps have mu. counts: Counts to be increased. columns: number of right-hand sides.
    """

    def __init__(self, table, to_v, to_a, counts, lift=None, tied=False, columns=1):
        """Allocate the workspace for s stages and all columns."""
        n, m, s = table.model.n, table.model.m, len(to_v)
        size = s * (n + m * (1 + tied))
        self.table, self.counts = table, counts
        self.functions = np.zeros(ENTRIES, np.int64)
        self.of_h = np.array(to_v, float), np.array(to_a, float)
        self.w = {
            "model": table.w,
            "lift": np.ones(n) if lift is None else lift,
            **{name: np.zeros((s, n, n)) for name in "KCMT"},
            **{name: np.zeros((s, m, n)) for name in "BGH"},
            "rates": np.zeros((n, n)),
            "columns": columns,
            "matrix": np.zeros((size, size)),
            "pivots": np.zeros(size, np.int64),
            "x": np.zeros(size),
            "solved": np.zeros(1, np.int64),
        }
        self.raise_error = table.raise_error
        self.scale(1.0)

    def scale(self, h):
        """Set the step h; to_v and to_a were given for h = 1."""
        to_v, to_a = self.of_h
        self.w |= {"to_v": to_v / h, "to_a": to_a / h**2}

    def set_states(self, t, q, v, a, lam, mu=None):
        """Set the states of the stages of some steps, (count, s, .) each, or (count, .) for one stage."""
        states = {"t": t, "q": q, "v": v, "a": a, "lam": lam, "mu": mu}
        self.w |= dict(zip(states, by_stages(len(self.of_h[0]), *states.values())))
        self.table.evaluate_constants(float(self.w["t"][0, 0]), self.w["q"][0, 0])

    @contextmanager
    def at_work(self):
        """(addresses of the functions, address of the workspace)."""
        work, self.w["solved"][0] = DenseAdjointWork(**self.w), 0
        self.functions[ADJOINT] = table_address(solve, typeof(work))
        yield self.functions, work.address
        self.counts.factorizations += int(self.w["solved"][0]) // self.w["columns"]
        self.counts.solves += int(self.w["solved"][0])
