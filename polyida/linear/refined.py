"""The saddle-point system of a step with S exact at a state, or its transpose.

```
[ S   B^T ] [ x  ]   [ right ]
[ B   0   ] [ mu ] = [ below ]        S = c_m M + c_v C + K,  C = dr/dv,  K = dr/dq,  B = phi_q
```
A compiled scene's factor, co-rotated, symmetric and in single precision, is kept from state to state and refines; the matrices of small
scenes, which are dense, and of any other model are factored at each state.
"""

import numpy as np

from polyida.linear.kkt import KKT, scaling_factors

ENOUGH = 1e-11  # of |x|: the error at which refinement ends
LEFT = 1e3 * ENOUGH  # of |x|: below it a correction that no longer falls is round-off
SLOW = 0.3  # contraction above which the factor is made anew
MOST = 12  # corrections with one factor


class ExactSaddle:
    """The system at one state after another, of a model with c_m and c_v. counts: anything that counts factorizations and solves."""

    def __init__(self, model, c_m, c_v, counts):
        self.model, self.c_m, self.c_v, self.counts = model, c_m, c_v, counts
        self.system = self.direct = self.M = self.K = self.C = self.S = self.B = None
        self.here = ()

    def at(self, t, q, v, a, lam):
        """Take the matrices of a state."""
        model, self.here, self.direct = self.model, (t, q, v, a, lam), None
        self.C = model.force_v(t, q, v) if model.needs.velocity_forces else None
        if model.is_scene and model.small:
            self.K, self.M, self.B = model.small_tangent(t, q, v, lam), model.small_mass(), model.small_phi_q(t, q)
            self.C = None if self.C is None else self.C.toarray()
        else:
            self.K, self.M, self.B = model.tangent(t, q, v, a, lam, 0.0, 0.0, 1.0), model.mass(q), model.phi_q(t, q)
        self.S = self.c_m * self.M + self.K
        self.S = self.S if self.C is None else self.S + self.c_v * self.C

    def solve(self, right, below, transposed=False):
        """(x, mu). Raises SingularSystem."""
        if isinstance(self.S, np.ndarray):
            return self._direct(right, below, transposed)
        S, self.system = self.S.T if transposed else self.S, self.system or self.model.step_matrix()
        return self._refined(S, right, below, transposed) if self.system.near_any_state else self._direct(right, below, transposed)

    def _direct(self, right, below, transposed):
        if self.direct is None:
            self.counts.factorizations += 1
            self.direct = KKT(self.S, self.B, scaling_factors("physical", 1 / abs(self.c_m), self.S))
        self.counts.solves += 1
        return (self.direct.adjoint if transposed else self.direct.solve)(-right, -below)

    def _refined(self, S, right, below, transposed):
        found = self._refine(S, right, below) if len(self.system.made_at) else None
        if found is None:
            self._factor()
            found = self._refine(S, right, below)
        return self._direct(right, below, transposed) if found is None else found

    def _factor(self):
        self.system = self.model.step_matrix()
        self.system.factor(*self.here, self.c_m, self.c_v)
        self.counts.factorizations += 1
        self.counts.solves += self.system.solves

    def _refine(self, S, right, below):
        """(x, mu), or None where the factor is too old."""
        t, q, _, _, lam = self.here
        x, mu, r, rows, last = np.zeros_like(right), np.zeros_like(below), right, below, np.inf
        for _ in range(MOST):
            dx, dmu = self.system.saddle(t, q, lam, -r, -rows)
            self.counts.solves += 1
            x, mu, moved = x + dx, mu + dmu, np.linalg.norm(dx)
            size, rate = np.linalg.norm(x), moved / last
            ahead = rate / (1.0 - rate) if 0.0 < rate < 0.5 else 1.0
            if moved * ahead <= ENOUGH * size:
                return x, mu
            if rate > SLOW:
                break
            r, rows, last = right - S @ x - self.B.T @ mu, below - self.B @ x, moved
        return (x, mu) if moved <= LEFT * size else None
