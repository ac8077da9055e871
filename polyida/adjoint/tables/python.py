"""The adjoint of a step of any model, by a factor of its exact matrices; each call is one of Python."""

from contextlib import contextmanager

import numpy as np

from polyida.linear.lu import LU, dense
from polyida.linear.refined import ENOUGH, ExactSaddle
from polyida.system.python import PythonTable
from polyida.system.table import ADJOINT

ROUNDS = 8  # solves, at most, for what eta turns with q


class PythonAdjoint(PythonTable):
    """The table of any model for steps of h, and of the stabilised form.

    That form has one more unknown, eta in `q = Newmark's - M^-1 B^T eta`, and one more equation, psi = `B v + phi_t = 0`, with the
    multiplier kappa: `psi_q^T kappa + (B^T eta)_q^T M^-1 y` stands beside `B^T mu` in y, `B^T kappa` beside `C^T w` in z, and
    `B M^-1 y = 0`. kappa (count, m) and slips = (y', slip, eta) are filled: y' = M^-1 y, slip what eta adds to q.
    """

    kappa = slips = None

    def __init__(self, model, settings, h, counts):
        self.saddle = ExactSaddle(model, *settings.coefficients.rates(h), counts)
        self.stabilised = settings.form == "stabilised" and model.m > 0
        super().__init__(model, False)

    def _fill(self):
        self.functions[ADJOINT] = self._address(self._solve)

    def take(self, t, q, v, a, lam, slips=None):
        """Take the states at the ends of some steps; slips (count, n): of the stabilised form, what eta adds to q."""
        self.states = t, q, v, a, lam
        if self.stabilised:
            self.kappa, self.slips = np.empty_like(lam), (np.empty_like(q), np.array(slips), np.empty_like(lam))

    def prepare(self, k):
        """True: the matrices are made anew in each step."""
        return True

    def drop(self):
        """Nothing."""

    @contextmanager
    def at_work(self):
        """(addresses of the functions, address of the workspace)."""
        yield self.functions, 0

    def _solve(self, k, right, below, bar, w, mu, found):
        n, m, saddle = self.model.n, self.model.m, self.saddle
        w, mu, found = self._array(w, n), self._array(mu, m), self._array(found, 2 * n).reshape(2, n)
        right, below = self._array(right, n).copy(), self._array(below, m).copy()
        saddle.at(*(x[k] for x in self.states))
        damped = lambda: 0.0 if saddle.C is None else saddle.C.T @ w  # noqa: E731
        if self.stabilised:
            w[:], mu[:], found[0], kappa, more = self._stabilised(k, right, below, self._array(bar, n).copy())
            self.kappa[k], found[1] = kappa, damped() + saddle.B.T @ kappa
            for part, value in zip(self.slips, more):
                part[k] = value
        else:
            w[:], mu[:] = saddle.solve(right, below, transposed=True)
            found[0], found[1] = saddle.K.T @ w + saddle.B.T @ mu, damped()

    def _stabilised(self, k, right, below, bar):
        """(w, mu, what y loses beside bar, kappa, (y', slip, eta)).

        slip: the part of q that `M slip + B^T eta = 0` adds, as far as B tells it: by frames it has what Newton left.
        """
        saddle, model, (t, q, v, _, _) = self.saddle, self.model, self.saddle.here
        G, B, system = dense(model.phi_rate_q(t, q, v)), dense(saddle.B), model.mass_system(t, q)
        still, none = np.zeros(model.n), np.zeros(model.m)
        slip, eta = system.solve(still, -B @ self.slips[1][k])
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
