"""Tables for the backward sweeps: C functions that solve the adjoint of one step, of any model by generalized-alpha and of a small one."""

from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
from numba import carray, typeof

from polyida.adjoint.run import AdjointTable
from polyida.errors import DONE, NOT_FINITE, SINGULAR
from polyida.jit import entry, pack, part
from polyida.jit.intrinsics import pointer
from polyida.jit.user_functions import table_address
from polyida.linear import dense as compiled_lu
from polyida.linear.dense import copy_matrix, put, zero
from polyida.linear.lu import LU, dense
from polyida.linear.saddle import ENOUGH, ExactSaddle
from polyida.system import ADJOINT, ENTRIES, dense_slots
from polyida.system import dense as small
from polyida.system.own import PythonTable

ROUNDS = 8  # solves, at most, for what eta turns with q


class CallbackAdjoint(PythonTable, AdjointTable):
    """A table whose entry is the Python function `_solve`."""

    def _entries(self):
        return {ADJOINT: self._solve}

    @contextmanager
    def at_work(self):
        """(addresses of the functions, address of the workspace)."""
        yield self.functions, 0


class PythonAdjoint(CallbackAdjoint):
    """The table of any model for steps of h, and of the stabilised form.

    That form has one more unknown, eta in `q = Newmark's - M^-1 B^T eta`, and one more equation, psi = `B v + phi_t = 0`, with the
    multiplier kappa: `psi_q^T kappa + (B^T eta)_q^T M^-1 y` stands beside `B^T mu` in y, `B^T kappa` beside `C^T w` in z, and
    `B M^-1 y = 0`. kappa (columns, count, m) and slips = (y', slip, eta), (columns, count, .) each, are filled: y' = M^-1 y, slip what eta adds
    to q.

    The multiplier of a velocity row psi = W v + w is kappa too: `psi_q^T kappa` stands in y and `W^T kappa` in z, and there is no mu.
    """

    def __init__(self, model, settings, h, counts, columns=1):
        self.saddle, self.columns = ExactSaddle(model, *settings.coefficients.rates(h), counts), columns
        self.stabilised = settings.form == "stabilised" and model.m > 0
        super().__init__(model)

    def set_states(self, t, q, v, a, lam, slips=None):
        """Set the states at the ends of some steps; slips (count, n): of the stabilised form, the part of q from eta."""
        self.states = t, q, v, a, lam
        if self.stabilised or self.model.velocity_rows.size:
            self.kappa = np.zeros((self.columns, *lam.shape))
        if self.stabilised:
            self.slip, shapes = np.array(slips), (q.shape, q.shape, lam.shape)
            self.slips = tuple(np.empty((self.columns, *shape)) for shape in shapes)

    def _solve(self, k, right, below, bar, w, mu, out):
        n, m, count = self.model.n, self.model.m, self.columns
        w, mu, out = self._array(w, count * n), self._array(mu, count * m), self._array(out, 3 * count * n)
        vectors = (self._array(x, count * size).reshape(count, size).copy() for x, size in ((right, n), (below, m), (bar, n)))
        w, mu, out = w.reshape(count, n), mu.reshape(count, m), out.reshape(3, count, n)
        self.saddle.at(*(x[k] for x in self.states))
        for c, given in enumerate(zip(*vectors)):
            w[c], mu[c], out[0, c], out[1, c] = self._column(k, c, *given)

    def _column(self, k, c, right, below, bar):
        """(w, mu, K^T w + B^T mu, C^T w) of a column."""
        saddle = self.saddle
        damped = lambda w: 0.0 if saddle.C is None else saddle.C.T @ w  # noqa: E731
        if self.stabilised:
            w, mu, lost, kappa, more = self._stabilised(k, right, below, bar)
            self.kappa[c, k] = kappa
            for part, value in zip(self.slips, more):
                part[c, k] = value
            return w, mu, lost, damped(w) + saddle.B.T @ kappa
        of_psi, c_v, W = self.model.velocity_rows, saddle.c_v, saddle.B
        if of_psi.size:  # dv = c_v dq: kappa is solved for times c_v
            W, slopes = dense(W), dense(W).copy()
            slopes[of_psi] += dense(self.model.phi_rate_q(*(x[k] for x in self.states[:3])))[of_psi] / c_v
            saddle.B, saddle.slopes = W, slopes
        w, mu = saddle.solve(right, below, transposed=True)
        stiff, slow = saddle.K.T @ w + saddle.slopes.T @ mu, damped(w)
        if of_psi.size:
            mu = np.array(mu)
            self.kappa[c, k, of_psi], mu[of_psi] = mu[of_psi] / c_v, 0.0
            pull = W.T @ self.kappa[c, k]
            stiff, slow = stiff - c_v * pull, slow + pull
        return w, mu, stiff, slow

    def _stabilised(self, k, right, below, bar):
        """(w, mu, loss of y beside bar, kappa, (y', slip, eta)).

        slip: the part of q from `M slip + B^T eta = 0`, projected onto B: slips from frames also contain Newton's error.
        """
        saddle, model, (t, q, v, _, _) = self.saddle, self.model, self.saddle.here
        G, B, system = dense(model.phi_rate_q(t, q, v)), dense(saddle.B), model.mass_system(t, q)
        still, none = np.zeros(model.n), np.zeros(model.m)
        slip, eta = system.solve(still, -B @ self.slip[k])
        ties = np.stack([-system.solve(still, row)[0] for row in np.eye(model.m)], axis=1)  # M^-1 B^T (B M^-1 B^T)^-1: where eta moves q
        closed, turned, ahead = self._closed(B, G, ties), model.reaction_q(t, q, eta).T, still
        for _ in range(ROUNDS):
            more = turned @ ahead
            w, mu, kappa = closed(right - more, below, bar + more)
            lost, before = more + saddle.K.T @ w + B.T @ mu + G.T @ kappa, ahead
            ahead = system.solve(bar + lost, none)[0]
            if np.abs(ahead - before).max() <= ENOUGH * np.abs(ahead).max():
                break
        return w, mu, lost, kappa, (ahead, slip, eta)

    def _closed(self, B, G, ties):
        """A function (right, below, bar) -> (w, mu, kappa) with one factor of S^T and one border."""
        m, lu, saddle = len(B), LU(self.saddle.S.T), self.saddle
        saddle.counts.factorizations += 1
        saddle.counts.solves += 2 * m
        X, rows = lu.solve(np.hstack([B.T, G.T + saddle.c_v * B.T])), np.vstack([B, (saddle.K @ ties).T])
        corner = LU(np.vstack([np.zeros((m, 2 * m)), np.hstack([ties.T @ B.T, ties.T @ G.T])]) - rows @ X)

        def solve(right, below, bar):
            saddle.counts.solves += 1
            y = lu.solve(right)
            u = corner.solve(np.concatenate([below, -ties.T @ bar]) - rows @ y)
            return y - X @ u, u[:m], u[m:]

        return solve


@pack
class DenseAdjointWork(NamedTuple):
    """The workspace of a model and steps of s stages; t (count, s), q, v, a (count, s, n), lam, mu (count, s, m): their states.

    mu is (count, s, 0) if the steps have none. to_v, to_a (s, s), lift (n,): of `solve`. K, C, M, T (s, n, n), B, H (s, m, n): matrices of the
    stages. columns: number of right-hand sides. matrix, pivots, x: the system of a step and a solution; solved (1,): the number of solutions.
    """

    model: small.Dense
    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    lam: np.ndarray
    mu: np.ndarray
    to_v: np.ndarray
    to_a: np.ndarray
    lift: np.ndarray
    K: np.ndarray
    C: np.ndarray
    M: np.ndarray
    T: np.ndarray
    B: np.ndarray
    H: np.ndarray
    columns: int
    matrix: np.ndarray
    pivots: np.ndarray
    x: np.ndarray
    solved: np.ndarray


@part
def evaluate(work, step, stage):
    """K, C, M, T, B and H of a stage of a step. Returns a status."""
    d = work.model
    d.t[small.INNER] = d.t[small.END] = work.t[step, stage]
    put(1.0, work.q[step, stage], d.q)
    put(1.0, work.v[step, stage], d.v)
    put(1.0, work.a[step, stage], d.a)
    put(1.0, work.lam[step, stage], d.lam)
    d.flags[small.ENDED] = DONE
    dense_slots.matrices_at(d, work.K[stage], work.C[stage], work.M[stage])
    if work.mu.shape[2] and d.flags[small.ROWS_VARY]:
        bend(work, d, work.mu[step, stage], work.H[stage], work.T[stage])
    if d.lam.shape[0] and d.flags[small.ROWS_VARY]:
        small.evaluate(d, small.PHI_Q, small.INNER, d.B)
    copy_matrix(d.B, work.B[stage])
    return d.flags[small.ENDED]


@part
def bend(work, model, mu, H, T):
    """`H = d(B v + phi_t)/dq` and `T = (B^T mu)_q D^-1` by differences of fourth order (model/differences.py)."""
    H[:], T[:] = 0.0, 0.0
    for j in range(model.q.shape[0]):
        at = model.q[j]
        step = small.REACH * max(1.0, abs(at))
        for e in range(4):
            model.q[j], weight = at + (1.0, -1.0, 2.0, -2.0)[e] * step, (8.0, -8.0, -1.0, 1.0)[e] / (12.0 * step)
            small.evaluate(model, small.PHI_Q, small.INNER, model.B)
            if model.flags[small.DRIVEN]:
                small.evaluate(model, small.PHI_T, small.INNER, model.phi_t)
            for k in range(mu.shape[0]):
                H[k, j] += weight * model.phi_t[k]
                for i in range(model.q.shape[0]):
                    H[k, j] += weight * model.B[k, i] * model.v[i]
                    T[i, j] += weight * model.B[k, i] * mu[k] * work.lift[j]
        model.q[j] = at


@part
def assemble(work, size, unit):
    """The matrix of a step, columns of w in units of 1/size, of kappa in `unit`."""
    A, (s, m, n), tied = work.matrix, work.B.shape, work.mu.shape[2] > 0
    A[:] = 0.0
    for i in range(s):
        lam, mu = s * n + i * m, s * (n + m) + i * m
        for j in range(s):
            to_v, to_a, same = work.to_v[i, j], work.to_a[i, j], i == j
            for p in range(n):
                for r in range(n):
                    total = to_a * work.M[j, r, p] + to_v * work.C[j, r, p]
                    if same:
                        total += work.K[i, r, p]
                    if tied:
                        for o in range(n):
                            total += work.T[i, p, o] * (to_v * work.M[j, r, o] + (work.C[i, r, o] if same else 0.0))
                    A[i * n + p, j * n + r] = total / size
            for e in range(m if tied else 0):
                for p in range(n):
                    total = to_v * work.B[j, e, p]
                    if same:
                        total += work.H[i, e, p]
                        for o in range(n):
                            total += work.T[i, p, o] * work.B[i, e, o]
                    A[i * n + p, s * (n + m) + j * m + e] = total * unit
                for r in range(n):
                    total = 0.0
                    for o in range(n):
                        total += work.B[i, e, o] * work.lift[o] * (to_v * work.M[j, r, o] + (work.C[i, r, o] if same else 0.0))
                    A[mu + e, j * n + r] = total / (unit * size)
        for e in range(m):
            for p in range(n):
                A[i * n + p, lam + e] = A[lam + e, i * n + p] = work.B[i, e, p]
            for o in range(m if tied else 0):
                total = 0.0
                for p in range(n):
                    total += work.B[i, e, p] * work.lift[p] * work.B[i, o, p]
                A[mu + e, mu + o] = total


@entry
def solve(work, step, right, below, bar, now, multipliers, out):
    """Solve a step. Returns a status."""
    (s, m, n), kinds = work.B.shape, 1 + (work.mu.shape[2] > 0)
    for i in range(s):
        ended = evaluate(work, step, i)
        if ended != DONE:
            return ended
    size, unit = 0.0, 1.0 / abs(work.to_v[s - 1, s - 1])
    for p in range(n):
        size += abs(work.K[s - 1, p, p] + work.to_a[s - 1, s - 1] * work.M[s - 1, p, p]) / n
    size = size if size > 0.0 else 1.0
    assemble(work, size, unit)
    if not compiled_lu.factor(work.matrix, work.pivots):
        return SINGULAR
    right, below = carray(pointer(right), (s, work.columns, n)), carray(pointer(below), (s, work.columns, m))
    bar = carray(pointer(bar), (work.columns, n))
    now, multipliers = carray(pointer(now), (s, work.columns, n)), carray(pointer(multipliers), (kinds, s, work.columns, m))
    out = carray(pointer(out), (3, s, work.columns, n))
    for c in range(work.columns):
        ended = solve_column(work, size, unit, right[:, c], below[:, c], bar[c], now[:, c], multipliers[:, :, c], out[:, :, c])
        if ended != DONE:
            return ended
    return DONE


@part
def solve_column(work, size, unit, right, below, bar, now, multipliers, out):
    """Solve for a column with the factors of the step. Returns a status."""
    (s, m, n), x = work.B.shape, work.x
    for i in range(s):
        for p in range(n):
            x[i * n + p] = right[i, p]
        for e in range(m):
            x[s * n + i * m + e] = size * below[i, e]
    zero(x[s * (n + m) :])
    if multipliers.shape[0] == 2:
        for p in range(n):
            for o in range(n):
                x[(s - 1) * n + p] -= work.T[s - 1, p, o] * bar[o]
        for e in range(m):
            for p in range(n):
                x[s * (n + m) + (s - 1) * m + e] -= work.B[s - 1, e, p] * work.lift[p] * bar[p] / unit
    compiled_lu.solve(work.matrix, work.pivots, x)
    if not small.finite(x):
        return NOT_FINITE
    for i in range(s):
        for p in range(n):
            now[i, p] = x[i * n + p] / size
        for e in range(m):
            multipliers[0, i, e] = x[s * n + i * m + e]
            if multipliers.shape[0] == 2:
                multipliers[1, i, e] = unit * x[s * (n + m) + i * m + e]
    products(work, now, multipliers, bar, out)
    work.solved[0] += 1
    return DONE


@part
def products(work, now, multipliers, bar, out):
    """Products of the multipliers with the matrices: their parts of q*, v* and a*."""
    (s, m, n), stiff, damped, heavy = work.B.shape, out[0], out[1], out[2]
    for i in range(s):
        for p in range(n):
            stiff[i, p] = damped[i, p] = heavy[i, p] = 0.0
            for r in range(n):
                stiff[i, p] += work.K[i, r, p] * now[i, r]
                damped[i, p] += work.C[i, r, p] * now[i, r]
                heavy[i, p] += work.M[i, r, p] * now[i, r]
            for e in range(m):
                stiff[i, p] += work.B[i, e, p] * multipliers[0, i, e]
                if multipliers.shape[0] == 2:
                    stiff[i, p] += work.H[i, e, p] * multipliers[1, i, e]
                    damped[i, p] += work.B[i, e, p] * multipliers[1, i, e]
    for i in range(s if multipliers.shape[0] == 2 else 0):
        for o in range(n):
            rate = damped[i, o] + (bar[o] if i == s - 1 else 0.0)
            for j in range(s):
                rate += work.to_v[i, j] * heavy[j, o]
            for p in range(n):
                stiff[i, p] += work.T[i, p, o] * rate


class DenseAdjoint(AdjointTable):
    """The table of a small model for steps of s stages; table: that of its functions; to_v, to_a (s, s), lift: of the system of `solve`.

    tied: True if the steps have mu. counts: Counts to be increased. columns: number of right-hand sides.
    """

    def __init__(self, table, to_v, to_a, counts, lift=None, tied=False, columns=1):
        n, m, s = table.model.n, table.model.m, len(to_v)
        size = s * (n + m * (1 + tied))
        self.table, self.counts, self.functions = table, counts, np.zeros(ENTRIES, np.int64)
        self.factors = np.array(to_v, float), np.array(to_a, float)
        self.w = {
            "model": table.w,
            "lift": np.ones(n) if lift is None else lift,
            **{name: np.zeros((s, n, n)) for name in "KCMT"},
            **{name: np.zeros((s, m, n)) for name in "BH"},
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
        self.w |= {"to_v": self.factors[0] / h, "to_a": self.factors[1] / h**2}

    def set_states(self, t, q, v, a, lam, mu=None):
        """Set the states of the stages of some steps, (count, s, .) each, or (count, .) for one stage."""
        arrays = {"t": t, "q": q, "v": v, "a": a, "lam": lam, "mu": np.zeros((*np.shape(t), 0)) if mu is None else mu}
        s = len(self.factors[0])
        self.w |= {k: np.ascontiguousarray(x, float).reshape(len(t), s, *([] if k == "t" else np.shape(x)[-1:])) for k, x in arrays.items()}
        self.table.evaluate_constants(float(self.w["t"][0, 0]), self.w["q"][0, 0])

    @contextmanager
    def at_work(self):
        """(addresses of the functions, address of the workspace)."""
        work, self.w["solved"][0] = DenseAdjointWork(**self.w), 0
        self.functions[ADJOINT] = table_address(solve, typeof(work))
        yield self.functions, work.address
        self.counts.factorizations += int(self.w["solved"][0]) // self.w["columns"]
        self.counts.solves += int(self.w["solved"][0])
