"""The transposed system of one step at its accepted state, of index 3 and of the stabilised form."""

import numpy as np

from polyida.linear.lu import LU
from polyida.linear.matrix import dense
from polyida.linear.refined import ENOUGH, ExactSaddle

AGAIN = 8  # solves, at most, for what eta turns with q


class StepAdjoint(ExactSaddle):
    """`S^T w + B^T mu = right`, `B w = below` at one state after another, and what w and mu do in the equations of q and v."""

    def index3(self, right, below):
        """(w, mu, K^T w + B^T mu, C^T w). Raises SingularSystem."""
        w, mu = self.solve(right, below, transposed=True)
        return w, mu, self.K.T @ w + self.B.T @ mu, self._damped(w)

    def _damped(self, w):
        return np.zeros_like(w) if self.C is None else self.C.T @ w

    def stabilised(self, right, below, bar, slip):
        """(w, mu, kappa, y, C^T w + B^T kappa, (y', slip, eta)) of the stabilised form. Raises SingularSystem.

        bar: of q, to which `y = -bar - K^T w - B^T mu - psi_q^T kappa - (B^T eta)_q^T y'`, `y' = M^-1 y`, `B y' = 0` belong; slip: the part
        of q that `M slip + B^T eta = 0` adds, as far as B tells it: by frames it has what Newton left.
        """
        (t, q, v, _, _), model = self.here, self.model
        G, B, system = dense(model.phi_rate_q(t, q, v)), dense(self.B), model.mass_system(t, q)
        (slip, eta), closed = system.solve(np.zeros(model.n), -B @ slip), self._closed(B, G, _ties(model, system))
        turned, ahead = model.reaction_q(t, q, eta).T, np.zeros(model.n)
        for _ in range(AGAIN):
            more = turned @ ahead
            w, mu, kappa = closed(right - more, below, bar + more)
            y, before = -bar - more - self.K.T @ w - B.T @ mu - G.T @ kappa, ahead
            ahead = -system.solve(y, np.zeros(model.m))[0]
            if np.abs(ahead - before).max() <= ENOUGH * np.abs(ahead).max():
                break
        return w, mu, kappa, y, self._damped(w) + B.T @ kappa, (ahead, slip, eta)

    def _closed(self, B, G, ties):
        """A function (right, below, bar) -> (w, mu, kappa) with one factor of S^T and one border."""
        m, lu = len(B), LU(self.S.T)
        self.counts.factorizations += 1
        self.counts.solves += 2 * m
        X, rows = lu.solve(np.hstack([B.T, G.T + self.c_v * B.T])), np.vstack([B, (self.K @ ties).T])
        corner = LU(np.vstack([np.zeros((m, 2 * m)), np.hstack([ties.T @ B.T, ties.T @ G.T])]) - rows @ X)

        def solve(right, below, bar):
            self.counts.solves += 1
            y = lu.solve(right)
            u = corner.solve(np.concatenate([below, -ties.T @ bar]) - rows @ y)
            return y - X @ u, u[:m], u[m:]

        return solve


def _ties(model, system):
    """Columns M^-1 B^T (B M^-1 B^T)^-1, (n, m): where the stabilised form moves q along."""
    zero = np.zeros(model.n)
    return np.stack([-system.solve(zero, row)[0] for row in np.eye(model.m)], axis=1)
