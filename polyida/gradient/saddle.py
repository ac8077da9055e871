"""The transposed saddle-point system of one step, exact at its accepted state.

```
[ S^T  B^T ] [ w  ]   [ right ]
[ B    0   ] [ mu ] = [ below ]        S = beta' M + gamma' C + K,  B = phi_q
```
A compiled scene keeps one factor, co-rotated and in single precision, and refines; the matrices of any other model are factored in each step.
"""

import numpy as np

from polyida.gradient.rates import pulled_rate
from polyida.linear.kkt import KKT, scaling_factors
from polyida.linear.lu import LU, SingularSystem
from polyida.linear.matrix import dense

ENOUGH = 1e-11  # of |w|: the error at which refinement ends
SLOW = 0.3  # contraction above which the factor is made anew
MOST = 12  # refinements with one factor


class Saddle:
    """The system at one state after another; counts: what it takes."""

    def __init__(self, model, to_a, to_v, counts):
        self.model, self.to_a, self.to_v, self.counts = model, to_a, to_v, counts
        self.system = self.K = self.C = self.S = self.B = None
        self.here, self.scaling = (), None

    def at(self, t, q, v, a, lam):
        """Take the matrices of a state."""
        model = self.model
        self.here = t, q, v, a, lam
        self.K = model.tangent(t, q, v, a, lam, 0.0, 0.0, 1.0)
        self.C = model.force_v(t, q, v) if model.needs.velocity_forces else None
        self.S = self.to_a * model.mass(q) + self.K
        self.S = self.S if self.C is None else self.S + self.to_v * self.C
        self.B = model.phi_q(t, q)

    def solve(self, right, below):
        """(w, mu, K^T w + B^T mu, C^T w). Raises SingularSystem."""
        w, mu = self._refined(right, below) if self.model.compiled else self._direct(right, below)
        return w, mu, self.K.T @ w + self.B.T @ mu, self._damped(w)

    def _damped(self, w):
        return np.zeros_like(w) if self.C is None else self.C.T @ w

    def _direct(self, right, below):
        self.counts.factorizations += 1
        self.counts.solves += 1
        return KKT(self.S.T, self.B, scaling_factors("physical", 1 / self.to_a, self.S)).solve(-right, -below)

    def _refined(self, right, below):
        if self.system is None:
            self._factor()
        found = self._refine(right, below)
        if found is None:
            self._factor()
            found = self._refine(right, below)
        return self._direct(right, below) if found is None else found

    def _factor(self):
        self.system = self.model.step_matrix()
        self.system.factor(*self.here, self.to_a, self.to_v)
        self.counts.factorizations += 1
        self.counts.solves += self.system.solves

    def _refine(self, right, below):
        """(w, mu), or None where the factor is too old."""
        t, q, _, _, lam = self.here
        w, mu, r, rows, last = np.zeros_like(right), np.zeros_like(below), right, below, np.inf
        for _ in range(MOST):
            dw, dmu = self.system.saddle(t, q, lam, -r, -rows)
            self.counts.solves += 1
            w, mu, moved = w + dw, mu + dmu, np.linalg.norm(dw)
            size, rate = np.linalg.norm(w), 1.0 if last == np.inf else moved / last if last > 0 else 0.0
            if moved * min(1.0, rate / max(1e-300, 1.0 - rate) if rate < 1 else 1.0) <= ENOUGH * size:
                return w, mu
            if rate > SLOW and moved > 1e3 * ENOUGH * size:
                return None
            r, rows, last = right - self.S.T @ w - self.B.T @ mu, below - self.B @ w, moved
        return (w, mu) if moved <= 1e3 * ENOUGH * size else None

    def tied(self, right, below, bar):
        """(w, mu, kappa, K^T w + B^T mu + psi_q^T kappa, C^T w + B^T kappa) of the stabilised form; bar: of q, for `B M^-1 y = 0`."""
        t, q, v, _, _ = self.here
        m, B = self.model.m, dense(self.B)
        G, ties = _rate_q(self.model, t, q, v), _ties(self.model, t, q)
        try:
            lu = LU(self.S.T)
        except SingularSystem:
            raise SingularSystem("the adjoint of the stabilised form needs a step matrix that is regular without constraints") from None
        self.counts.factorizations += 1
        self.counts.solves += 2 * m + 1
        columns = np.hstack([B.T, G.T + self.to_v * B.T])
        X, y = lu.solve(columns), lu.solve(right)
        rows = np.vstack([B, (self.K @ ties).T])
        corner = np.vstack([np.zeros((m, 2 * m)), np.hstack([ties.T @ B.T, ties.T @ G.T])])
        u = np.linalg.solve(corner - rows @ X, np.concatenate([below, -ties.T @ bar]) - rows @ y)
        w = y - X @ u
        return w, u[:m], u[m:], self.K.T @ w + B.T @ u[:m] + G.T @ u[m:], self._damped(w) + B.T @ u[m:]


def _rate_q(model, t, q, v):
    """d(phi_q v + phi_t)/dq, (m, n)."""
    return np.stack([pulled_rate(model, t, q, v, row) for row in np.eye(model.m)])


def _ties(model, t, q):
    """Columns M^-1 B^T (B M^-1 B^T)^-1, (n, m): where the stabilised form moves q along."""
    system, zero = model.mass_system(t, q), np.zeros(model.n)
    return np.stack([-system.solve(zero, row)[0] for row in np.eye(model.m)], axis=1)
