"""The adjoint of a step by a factor of its own matrices: a table in Python for any model and both methods.

It serves users' models that are not small, velocity rows, `linear="kkt"`, the stabilised form of generalized-alpha, and single steps at
which the refinement of scenes (scene_table.py) does not converge. ExactSteps solves for all stages at once; OneStageSteps is that of
generalized-alpha.

A step has s stages (generalized-alpha: one). With `dv = R de + D^-1 (B^T dmu + T de)`, R = to_v^T, its equations linearised at the stages
are

    r     (K + C R + M R_a) de + (C + M R) D^-1 (B^T dmu + T de) + B^T dlam
    phi   B de,                R_a = to_a^T
    phi'  H de + B dv,   where the step has mu;  H = d(B v + phi_t)/dq,  T = (B^T mu)_q

The multipliers w, mu* and kappa of these rows solve the transposed system; with b_v, the adjoint of v at the end of the step, its right
side is

    right - T^T D^-1 b_v,    below,    -B D^-1 b_v

A velocity row is psi(q, u) = 0 in place of phi, with u = v without mu: the row is (psi_q + W R) de, W = psi_u. Its multiplier stands among
mu*, and its `W^T mu*` in v*, to which D^-1 T does not belong.
"""

from contextlib import contextmanager

import numpy as np
from scipy.sparse import block_diag, csr_array, diags_array, eye_array, kron

from polyida.adjoint.tables import AdjointTable, by_stages
from polyida.linear.lu import LU, ScaledLU, block_matrix, dense
from polyida.linear.saddle import ENOUGH, Border, ExactSaddle, typical
from polyida.system import ADJOINT
from polyida.system.own import PythonTable

ROUNDS = 2  # solves with a step's own factor: the second takes what round-off left
ITERATIONS = 8  # at most, for what eta turns with q


def of_stages(function, *states):
    """The block-diagonal matrix of function(*state) at each stage."""
    blocks = [csr_array(function(*state)) for state in zip(*states)]
    return blocks[0] if len(blocks) == 1 else block_diag(blocks, format="csr")


class ExactSteps(PythonTable, AdjointTable):
    """The table of any model for steps of s stages, by one factor of the whole system.

    to_v, to_a (s, s): the transposes of dv/de and da/de for h = 1 (see `scale`); lift (n,): the diagonal of D^-1, by default 1; tied: True
    if the steps have mu. counts: Counts to be increased; columns: number of right-hand sides. Matrices of all stages are block diagonal: K,
    C, M (s n, s n), B (s m, s n); row_q, row_v: slopes of phi, or psi, in q and in u.
    """

    def __init__(self, model, to_v, to_a, counts, lift=None, tied=False, columns=1):
        """Take the method's matrices, for h = 1."""
        self.of_h = np.array(to_v, float), np.array(to_a, float)
        self.counts, self.tied, self.columns = counts, tied, columns
        self.stages = len(to_v)
        super().__init__(model)
        n, m, s, kinds = model.n, model.m, self.stages, 1 + tied
        self.of_psi = np.tile(np.isin(np.arange(m), model.velocity_rows), s).astype(float)[:, None]
        shapes = (s, columns, n), (s, columns, m), (columns, n), (s, columns, n), (kinds, s, columns, m), (3, s, columns, n)
        self.shapes = [(int(np.prod(shape)), shape) for shape in shapes]  # of the arguments of `_solve`
        self.lift = diags_array(np.tile(lift, self.stages)) if tied else None
        self.scale(1.0)

    def _entries(self):
        """{number of an entry: method} of the table, which has ADJOINT alone."""
        return {ADJOINT: self._solve}

    def _of_rates(self, factors):
        """The matrix (s n, s n) that combines the stages with these factors (s, s)."""
        return kron(csr_array(factors), eye_array(self.model.n), format="csr")

    def scale(self, h):
        """Take the step h, s: set `to_v` and `to_a` to the method's matrices of h = 1 over h and over h^2."""
        to_v, to_a = self.of_h
        self.to_v, self.to_a = to_v / h, to_a / h**2

    def set_states(self, t, q, v, a, lam, mu=None):
        """Set the stages of some steps, (count, s, .) each, or (count, .) for one stage."""
        self.states = by_stages(self.stages, t, q, v, a, lam, mu)

    @contextmanager
    def at_work(self):
        """(addresses of the functions, address of the workspace)."""
        yield self.functions, 0

    def _solve(self, k, right, below, b_v, w, multipliers, products):
        """The entry ADJOINT: fill w, multipliers and products of step k."""
        arrays = zip((right, below, b_v, w, multipliers, products), self.shapes)
        right, below, b_v, w, multipliers, products = (self._array(x, size).reshape(shape) for x, (size, shape) in arrays)
        self.factor_at(*(x[k] for x in self.states))
        for c in range(self.columns):
            w[:, c], multipliers[:, :, c], products[:, :, c] = self._column(k, c, right[:, c], below[:, c], b_v[c])

    def factor_at(self, t, q, v, a, lam, mu):
        """Evaluate and factor the matrix of all rows of a step, `self.matrix`, at its stages, as `self.lu`. Raises SingularSystem.

        t (s,), q, v, a (s, n), lam, mu (s, m): the stages. For scaling, r and lam are measured in the typical size of `K + to_a M`, with
        to_a of the last stage, phi' in |to_v| of it and mu in 1/|to_v|. It counts as a factorization.
        """
        self._evaluate(t, q, v, a, lam)
        s, R = self.stages, self._of_rates(self.to_v.T)
        self._evaluate_rows(t, q, v, mu)
        rows = self.row_q if self.row_v is None else self.row_q + self.row_v @ R
        blocks = [[self.K + self.C @ R + self.M @ self._of_rates(self.to_a.T), self.B.T], [rows, None]]
        if self.tied:
            here = t.tolist(), q
            self.R = R
            self.H = of_stages(self.model.phi_rate_q, *here, v)
            self.T = of_stages(self.model.reaction_q, *here, mu)
            by_v, by_mu = self.C + self.M @ R, self.lift @ self.B.T
            blocks[0] = [blocks[0][0] + by_v @ self.lift @ self.T, self.B.T, by_v @ by_mu]
            blocks[1] += [None]
            blocks += [[self.H + self.B @ (R + self.lift @ self.T), None, self.B @ by_mu]]
        size, unit = typical(self.K + self.to_a[-1, -1] * self.M), 1.0 / abs(self.to_v[-1, -1])
        heights = s * np.array([self.model.n, self.model.m, self.model.m if self.tied else 0])
        self.cuts, scales = np.cumsum(heights)[:-1], np.array([size, 1.0, 1.0 / unit])
        self.matrix = block_matrix(blocks)
        self.lu = ScaledLU(self.matrix, np.repeat(1.0 / scales, heights), np.repeat([1.0, size, unit], heights))
        self.counts.factorizations += 1

    def _evaluate(self, t, q, v, a, lam):
        """Evaluate K, C, M and B at stages, (s, .) each."""
        model, here = self.model, (t.tolist(), q)
        self.K = of_stages(lambda *state: model.tangent(*state, 0.0, 0.0, 1.0), *here, v, a, lam)
        self.M = of_stages(model.mass, q)
        self.C = of_stages(model.force_v, *here, v) if model.needs.velocity_forces else 0.0 * self.M
        self.B = of_stages(model.phi_q, *here) if model.m else self.M[:0]

    def _evaluate_rows(self, t, q, v, mu):
        """Set row_q and row_v, the slopes of phi, or psi, in q and in u; row_v is None without velocity rows."""
        self.row_q, self.row_v = self.B, None
        if not self.model.velocity_rows.size:
            return
        self.u = v - (self.lift @ (self.B.T @ mu.ravel())).reshape(v.shape) if self.tied else v
        self.row_v = self.B * self.of_psi
        rate_q = of_stages(self.model.phi_rate_q, t.tolist(), q, self.u)
        self.row_q = self.B - self.row_v + (dense(rate_q) if isinstance(self.B, np.ndarray) else rate_q) * self.of_psi

    def _column(self, k, c, right, below, b_v):
        """(w (s, n), multipliers (kinds, s, m), products (3, s, n)) of column c in step k, from right (s, n), below (s, m) and b_v (n,)."""
        n, m, s = self.model.n, self.model.m, self.stages
        ahead, rhs = np.zeros(s * n), np.zeros(s * (n + m * (1 + self.tied)))
        ahead[-n:], rhs[: s * n], rhs[s * n : s * (n + m)] = b_v, right.ravel(), below.ravel()
        if self.tied:
            rhs[: s * n] -= self.T.T @ (self.lift @ ahead)
            rhs[s * (n + m) :] -= self.B @ (self.lift @ ahead)
        x = self._transposed(rhs)
        w, mu, kappa = np.split(x, self.cuts)
        of_a, of_v, of_q = self.M.T @ w, 0.0 * w if self.C is None else self.C.T @ w, self.K.T @ w + self.row_q.T @ mu
        if self.tied:
            of_v = of_v + self.B.T @ kappa
            of_q = of_q + self.H.T @ kappa + self.T.T @ (self.lift @ (of_v + self.R.T @ of_a + ahead))
        if self.row_v is not None:
            of_v = of_v + self.row_v.T @ mu
        return w.reshape(s, n), x[s * n :].reshape(1 + self.tied, s, m), np.stack([of_q, of_v, of_a]).reshape(3, s, n)

    def _transposed(self, rhs):
        """The solution x of `matrix^T x = rhs`, with refinement by the factor."""
        x = np.zeros_like(rhs)
        for _ in range(ROUNDS):
            x -= self.lu.solve(self.matrix.T @ x - rhs, transposed=True)
        self.counts.solves += ROUNDS
        return x

    def newton(self, t, q, v, a, lam, mu):
        """The corrections of e, lam and mu of the stages, (s, .) each, to be subtracted by Newton's method. Raises SingularSystem."""
        self.factor_at(t, q, v, a, lam, mu)
        model, here = self.model, (t.tolist(), q)
        r = [model.residual(*state) for state in zip(*here, v, a, lam)]
        phi = [model.phi(*state) for state in zip(*here)]
        for values, *state in zip(phi, *here, self.u) if model.velocity_rows.size else ():
            values[model.velocity_rows] = model.phi_rate(*state)[model.velocity_rows]
        rate = [model.phi_rate(*state) for state in zip(*here, v)] if self.tied else []
        self.counts.solves += 1
        changes = np.split(self.lu.solve(np.concatenate([*r, *phi, *rate])), self.cuts)
        return [change.reshape(self.stages, size) for change, size in zip(changes, (model.n, model.m, model.m * self.tied))]


class OneStageSteps(ExactSteps):
    """The table of any model for steps of generalized-alpha: refinement with a factor that the steps share, where the model has one for any
    state.

    Rows of velocities are divided by c_v, as the factor has B in their place.
    """

    def __init__(self, model, to_v, to_a, counts, columns=1):
        """Take to_v and to_a, (1, 1) each for h = 1, and make the system whose factor the steps share."""
        super().__init__(model, to_v, to_a, counts, columns=columns)
        self.saddle = ExactSaddle(model, self.to_a[0, 0], self.to_v[0, 0], counts)
        self.units = np.where(np.isin(np.arange(model.m), model.velocity_rows), self.to_v[0, 0], 1.0)

    def factor_at(self, t, q, v, a, lam, mu):
        """Evaluate the matrices of a step at its end, (1, .) each; the first solve factors them."""
        saddle, n, m = self.saddle, self.model.n, self.model.m
        saddle.at(float(t[0]), q[0], v[0], a[0], lam[0])
        if self.model.velocity_rows.size:
            saddle.B = dense(saddle.B)
        self.K, self.M, self.B, self.C = saddle.K, saddle.M, saddle.B, saddle.C
        self.cuts = np.array([n, n + m])
        self._evaluate_rows(t, q, v, mu)
        if self.row_v is not None:
            saddle.slopes = (self.row_q + saddle.c_v * self.row_v) / self.units[:, None]

    def _transposed(self, rhs):
        """The solution (w, mu) of the transposed system for rhs, in one array (n + m,)."""
        w, mu = self.saddle.solve(*np.split(rhs, self.cuts[:1]), transposed=True)
        return np.concatenate([w, mu / self.units])


class StabilisedSteps(OneStageSteps):
    """The table of any model for steps of the stabilised form of generalized-alpha.

    That form has one more unknown, eta in `q = Newmark's + slip`, `M slip + B^T eta = 0`, and one more equation, `B v + phi_t = 0`, with
    the multiplier kappa. With H = d(B v + phi_t)/dq, E = (B^T eta)_q and b_q, the adjoint of q at the end of the step, the transposed
    system is

        S^T w + B^T mu + (H^T + c_v B^T) kappa = right - E^T y',    B w = below
        M y' = -b_q - E^T y' - K^T w - B^T mu - H^T kappa,          B y' = 0

    E^T y' is taken from the iteration before. kappa (columns, count, m) and slips = (y', slip, eta), (columns, count, .) each, are filled.
    """

    def set_states(self, t, q, v, a, lam, slips):
        """Set the states at the ends of some steps; slips (count, n): what eta adds to q."""
        super().set_states(t, q, v, a, lam)
        self.slip = np.array(slips)
        self.kappa = np.zeros((self.columns, *lam.shape))
        self.slips = tuple(np.empty((self.columns, *shape)) for shape in (q.shape, q.shape, lam.shape))

    def _column(self, k, c, right, below, b_q):
        """(w, mu, products) of column c in step k; fills its kappa and slips.

        The part of the slip is taken that satisfies its equation: slips from frames also contain Newton's error.
        """
        model, (t, q, v, _, _), right, below = self.model, self.saddle.here, right[0], below[0]
        H, B, inertia = dense(model.phi_rate_q(t, q, v)), dense(self.B), model.mass_system(t, q)
        still, none = np.zeros(model.n), np.zeros(model.m)
        slip, eta = inertia.solve(still, -B @ self.slip[k])
        turn, solve, ahead = model.reaction_q(t, q, eta).T, self._with_rates(B, H, inertia), still
        for _ in range(ITERATIONS):
            more, before = turn @ ahead, ahead
            w, mu, kappa = solve(right - more, below, b_q + more)
            of_q = more + self.K.T @ w + B.T @ mu + H.T @ kappa
            ahead = inertia.solve(b_q + of_q, none)[0]
            if np.abs(ahead - before).max() <= ENOUGH * np.abs(ahead).max():
                break
        self.kappa[c, k] = kappa
        for part, value in zip(self.slips, (ahead, slip, eta)):
            part[c, k] = value
        of_v = B.T @ kappa if self.C is None else self.C.T @ w + B.T @ kappa
        return w[None], mu[None, None], np.stack([of_q, of_v, 0.0 * of_v])[:, None]

    def _with_rates(self, B, H, inertia):
        """A function (right, below, b_q) -> (w, mu, kappa) that solves the system without E, by a factor of S^T and a border.

        Its last rows are B y' = 0 in the form `L^T (b_q + K^T w + B^T mu + H^T kappa) = 0`, L = M^-1 B^T (B M^-1 B^T)^-1.
        """
        m, lu, c_v = len(B), LU(self.saddle.S.T), self.saddle.c_v
        L = np.stack([-inertia.solve(np.zeros(self.model.n), row)[0] for row in np.eye(m)], axis=1)
        self.counts.factorizations += 1
        self.counts.solves += 2 * m
        X, rows = lu.solve(np.hstack([B.T, H.T + c_v * B.T])), np.vstack([B, (self.K @ L).T])
        corner = np.vstack([np.zeros((m, 2 * m)), np.hstack([L.T @ B.T, L.T @ H.T])])
        border = Border(X)

        def solve(right, below, b_q):
            """(w, mu, kappa) for the right-hand sides `right` and `below`; the last rows take b_q."""
            self.counts.solves += 1
            w, multipliers = border.solve(lu.solve(right), rows, np.concatenate([below, -L.T @ b_q]), corner)
            return w, multipliers[:m], multipliers[m:]

        return solve
