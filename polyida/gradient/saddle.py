"""The transposed system of one step at its accepted state, of index 3 and of the stabilised form."""

import numpy as np

from polyida.linear.lu import LU
from polyida.linear.matrix import dense
from polyida.linear.refined import ExactSaddle


class StepAdjoint(ExactSaddle):
    """`S^T w + B^T mu = right`, `B w = below` at one state after another, and what w and mu do in the equations of q and v."""

    def index3(self, right, below):
        """(w, mu, K^T w + B^T mu, C^T w). Raises SingularSystem."""
        w, mu = self.solve(right, below, transposed=True)
        return w, mu, self.K.T @ w + self.B.T @ mu, self._damped(w)

    def _damped(self, w):
        return np.zeros_like(w) if self.C is None else self.C.T @ w

    def stabilised(self, right, below, bar):
        """(w, mu, kappa, K^T w + B^T mu + psi_q^T kappa, C^T w + B^T kappa), bar: of q, for `B M^-1 y = 0`. Raises SingularSystem."""
        (t, q, v, _, _), model = self.here, self.model
        m, B = model.m, dense(self.B)
        G, ties = dense(model.phi_rate_q(t, q, v)), _ties(model, t, q)
        lu = LU(self.S.T)
        self.counts.factorizations += 1
        self.counts.solves += 2 * m + 1
        X, y = lu.solve(np.hstack([B.T, G.T + self.c_v * B.T])), lu.solve(right)
        rows = np.vstack([B, (self.K @ ties).T])
        corner = np.vstack([np.zeros((m, 2 * m)), np.hstack([ties.T @ B.T, ties.T @ G.T])])
        u = np.linalg.solve(corner - rows @ X, np.concatenate([below, -ties.T @ bar]) - rows @ y)
        w, mu, kappa = y - X @ u, u[:m], u[m:]
        return w, mu, kappa, self.K.T @ w + B.T @ mu + G.T @ kappa, self._damped(w) + B.T @ kappa


def _ties(model, t, q):
    """Columns M^-1 B^T (B M^-1 B^T)^-1, (n, m): where the stabilised form moves q along."""
    system, zero = model.mass_system(t, q), np.zeros(model.n)
    return np.stack([-system.solve(zero, row)[0] for row in np.eye(model.m)], axis=1)
