"""The equations of a step of Radau IIA with a sparse factor of their whole matrix: for models in Python, and if refinement does not converge."""

from contextlib import contextmanager

import numpy as np
from scipy.sparse import block_array, block_diag, csr_array, diags_array, eye_array, kron

from polyida.adjoint.run import AdjointTable
from polyida.linear.lu import ScaledLU
from polyida.system import ADJOINT
from polyida.system.python import PythonTable

ROUNDS = 2  # solves with a step's own factor: the second takes what round-off left


class StageEquations(PythonTable, AdjointTable):
    """The equations of radau_sweep.py, linearised at the stages of one step after another, and the table of any model: a callback.

    lift (n,): the diagonal of D^-1; tied: True if there is mu.

    A velocity row has psi(q_i, u_i) = 0 in place of phi, with `u_i = v_0 + sum_j W_ij e_j / h`, v_i without mu. Its multiplier stands among mu*,
    and its `W^T mu*` in v*, which the term of D^-1 in q* does not get.
    """

    def __init__(self, model, tableau, lift, tied, counts):
        self.tableau, self.tied, self.counts, self.h = tableau, tied, counts, 1.0
        self.L = diags_array(np.tile(lift, tableau.stages))
        super().__init__(model, False)

    def _fill(self):
        self.functions[ADJOINT] = self._address(self._solve)

    def scale(self, h):
        """Set the step h."""
        self.h = h

    def set_states(self, *stages):
        """Set the stages of some steps, (count, s, .) each."""
        self.stages = stages

    @contextmanager
    def at_work(self):
        """(addresses of the functions, address of the workspace)."""
        yield self.functions, 0

    def at(self, t, q, v, a, lam, mu):
        """Factor the matrix of a step at its stages, (s, .) each. Raises SingularSystem.

        Rows r, phi and `B v + phi_t` of all stages on e, lam and mu of all of them: `dr/de = K + C dv/de + M da/de`,
        `dv/de = W/h + D^-1 T`, `da/de = W/h dv/de`. r and lam are measured in the size of `K + M / h^2`, mu in 1/h, `B v + phi_t` too.
        """
        model, h, s, n, m = self.model, self.h, len(t), self.model.n, self.model.m
        here = t.tolist(), q
        stacked = lambda function, *states: block_diag([function(*state) for state in zip(*states)], format="csr")  # noqa: E731
        self.R = kron(self.tableau.W / h, eye_array(n), format="csr")
        self.K = stacked(lambda *state: model.tangent(*state, 0.0, 0.0, 1.0), *here, v, a, lam)
        self.M = stacked(model.mass, q)
        self.C = stacked(model.force_v, *here, v) if model.needs.velocity_forces else csr_array(self.M.shape)
        by_v, by_q, sizes = self.C + self.M @ self.R, self.R, [n, m, m if self.tied else 0]
        self.B = stacked(model.phi_q, *here) if m else csr_array((0, s * n))
        self.held, self.bent, self.slid = self.B, self.B, None  # the rows of phi or psi: their slopes in e, in q, and in u
        if model.velocity_rows.size:
            of_psi = np.tile(np.isin(np.arange(m), model.velocity_rows), s).astype(float)
            self.u = v - (self.L @ (self.B.T @ mu.ravel())).reshape(v.shape) if self.tied else v
            self.slid = diags_array(of_psi) @ self.B
            self.bent = self.B - self.slid + diags_array(of_psi) @ stacked(model.phi_rate_q, *here, self.u)
            self.held = self.bent + self.slid @ self.R
        if self.tied:
            self.H, self.T = stacked(model.phi_rate_q, *here, v), stacked(model.reaction_q, *here, mu)
            by_q, G = by_q + self.L @ self.T, self.L @ self.B.T
        blocks = [[self.K + by_v @ by_q, self.B.T], [self.held, None]]
        if self.tied:
            blocks = [[*blocks[0], by_v @ G], [self.held, None, None], [self.H + self.B @ by_q, None, self.B @ G]]
        self.matrix = block_array(blocks, format="csc") if m else blocks[0][0].tocsc()
        size = float(np.mean(np.abs(self.K.diagonal()[:n] + self.M.diagonal()[:n] / h**2))) or 1.0
        self.cuts, self.shapes = np.cumsum(sizes)[:-1] * s, [(s, size) for size in sizes]
        self.lu = ScaledLU(
            self.matrix, np.repeat([1 / size, 1.0, h], s * np.array(sizes)), np.repeat([1.0, size, 1 / h], s * np.array(sizes))
        )
        self.counts.factorizations += 1

    def parts(self, x):
        """Split a solution into (w, mu, kappa), or (e, lam, mu)."""
        return [part.reshape(shape) for part, shape in zip(np.split(x, self.cuts), self.shapes)]

    def newton(self, t, q, v, a, lam, mu):
        """The corrections of e, lam and mu of the stages, (s, .) each, to be subtracted by Newton's method. Raises SingularSystem."""
        self.at(t, q, v, a, lam, mu)
        model, here = self.model, (t.tolist(), q)
        r = [model.residual(*state) for state in zip(*here, v, a, lam)]
        phi = [model.phi(*state) for state in zip(*here)]
        for values, *state in zip(phi, *here, self.u) if model.velocity_rows.size else ():
            values[model.velocity_rows] = model.phi_rate(*state)[model.velocity_rows]
        rate = [model.phi_rate(*state) for state in zip(*here, v)] if self.tied else []
        self.counts.solves += 1
        return self.parts(self.lu.solve(np.concatenate([*r, *phi, *rate])))

    def _solve(self, k, right, below, bar, w, multipliers, out):
        n, m, s = self.model.n, self.model.m, self.tableau.stages
        self.at(*(x[k] for x in self.stages))
        rhs, last = np.zeros(self.matrix.shape[0]), np.zeros(s * n)
        rhs[: s * n], last[-n:] = self._array(right, s * n), self._array(bar, n)
        if self.tied:
            rhs[: s * n] -= self.T @ (self.L @ last)  # T is symmetric
            rhs[s * (n + m) :] -= self.B @ (self.L @ last)
        x = np.zeros_like(rhs)
        for _ in range(ROUNDS):
            x -= self.lu.solve(self.matrix.T @ x - rhs, transposed=True)
        self.counts.solves += ROUNDS
        now, mu, kappa = np.split(x, self.cuts)
        a, v, q = self.M.T @ now, self.C.T @ now, self.K.T @ now + self.bent.T @ mu
        if self.tied:
            v = v + self.B.T @ kappa
            q = q + self.H.T @ kappa + self.T @ (self.L @ (v + self.R.T @ a + last))
        if self.slid is not None:
            v = v + self.slid.T @ mu
        self._array(w, s * n)[:], self._array(multipliers, len(x) - s * n)[:] = now, x[s * n :]
        self._array(out, 3 * s * n)[:] = np.concatenate([q, v, a])
