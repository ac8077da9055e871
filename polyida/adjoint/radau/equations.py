"""The collocation equations of a step, linearised at its stages, and their transpose.

With c_i, W of the tableau, `q_i = q_0 + c_i h v_0 + e_i`, `v_i = v_0 + sum_j W_ij e_j / h + D^-1 B_i^T mu_i` and `v_i' = sum_j W_ij (v_j -
v_0) / h` the equations are `r_i = 0`, `phi_i = 0` and, where there is mu, `B_i v_i + phi_t = 0`; their multipliers are w_i, mu*_i and
kappa_i. Bars of a stage, b_q and b_v those of the step's end, which is the last one's:

    a*_i = M_i^T w_i
    v*_i = C_i^T w_i + B_i^T kappa_i + sum_j W_ji a*_j / h + [b_v]
    q*_i = K_i^T w_i + B_i^T mu*_i + H_i^T kappa_i + (B_i^T mu_i)_q^T D^-1 v*_i + [b_q]

and `q*_j + sum_i W_ij v*_i / h = 0`, `B_i w_i = 0`, `B_i D^-1 v*_i = 0` are the transposed system. To the step before go

    q*_0 = sum_i q*_i,    v*_0 = sum_i c_i h q*_i + v*_i - sum_ij W_ij a*_i / h

K, C and H are dr/dq, dr/dv and d(B v + phi_t)/dq.
"""

from typing import NamedTuple

import numpy as np

from polyida.linear.condition import scaled
from polyida.linear.lu import LU, block_matrix

ROUNDS = 2  # solves with a step's factor: the second takes what round-off left


class Multipliers(NamedTuple):
    """Of a step's equations, w (s, n), mu and kappa (s, m), and bars of its stages' q, v and v', (s, n) each."""

    w: np.ndarray
    mu: np.ndarray
    kappa: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray


class Linearised:
    """The equations at the stages of one step after another, of any model. lift (n,): the diagonal of D^-1; tied: whether there is mu."""

    def __init__(self, model, tableau, lift, tied, counts):
        self.model, self.tableau, self.lift, self.tied, self.counts = model, tableau, lift, tied, counts

    def at(self, stages):
        """Take a step's stages, and their matrices."""
        self.stages, self.h = stages, stages.h
        self._take_rows()
        self._take_forces()

    def _take_rows(self):
        model, x = self.model, self.stages
        self.B = [model.phi_q(*state) for state in zip(x.t, x.q)]
        if self.tied:
            self.H = [model.phi_rate_q(*state) for state in zip(x.t, x.q, x.v)]
            self.T = [model.reaction_q(*state) for state in zip(x.t, x.q, x.mu)]

    def _take_forces(self):
        model, x = self.model, self.stages
        self.K = [model.tangent(*state, 0.0, 0.0, 1.0) for state in zip(x.t, x.q, x.v, x.a, x.lam)]
        self.M = [model.mass(q) for q in x.q]
        self.C = [model.force_v(*state) for state in zip(x.t, x.q, x.v)] if model.needs.velocity_forces else None

    def back(self, b_q, b_v):
        """The Multipliers of the step whose end has bars b_q and b_v, (n,) each. Raises SingularSystem."""
        rows, columns, lu = self._lu()
        self.counts.solves += ROUNDS
        found = self._none()
        for _ in range(ROUNDS):
            left = np.concatenate([part.ravel() for part in self._left(found, b_q, b_v)[1]])
            change = self._parts(rows * lu.solve(columns * left, transposed=True))
            found = [part - more for part, more in zip(found, change)]
        return Multipliers(*found, *self._left(found, b_q, b_v)[0])

    def newton(self):
        """What Newton's method takes from e, lam and mu of the stages, (s, .) each. Raises SingularSystem."""
        model, x, (rows, columns, lu) = self.model, self.stages, self._lu()
        self.counts.solves += 1
        r = [model.residual(*state) for state in zip(x.t, x.q, x.v, x.a, x.lam)]
        phi = [model.phi(*state) for state in zip(x.t, x.q)]
        rate = [model.phi_rate(*state) for state in zip(x.t, x.q, x.v)] if self.tied else []
        return self._parts(columns * lu.solve(rows * np.concatenate([*r, *phi, *rate])))

    def _lu(self):
        """(factors of rows, of columns, LU) of the matrix of a step."""
        rows, columns = self._sizes()
        self.counts.factorizations += 1
        return rows, columns, LU(scaled(self._matrix(), rows, columns), pivoting=True)

    def _none(self):
        """(w, mu, kappa), zero."""
        s, m = self.tableau.stages, self.model.m
        return np.zeros((s, self.model.n)), np.zeros((s, m)), np.zeros((s, m))

    def _parts(self, x):
        """(w, mu, kappa), or (e, lam, mu), of all of their numbers in order."""
        s, n, m = self.tableau.stages, self.model.n, self.model.m
        first, second, third = np.split(x, [s * n, s * (n + m)])
        return first.reshape(s, n), second.reshape(s, m), third.reshape(s, m) if self.tied else np.zeros((s, m))

    def _left(self, found, b_q, b_v):
        """((q*, v*, a*), what is left of the rows of e, lam and mu, (s, .) each) with multipliers (w, mu, kappa)."""
        w, mu, kappa = found
        rates = self.tableau.W.T / self.h
        q, v, a, on_lam = self._pulled(w, mu)
        v = v + rates @ a
        q[-1] += b_q
        v[-1] += b_v
        on_mu = np.zeros((len(w), 0))
        if self.tied:
            v = v + _each(self.B, kappa)
            q = q + _each(self.H, kappa) + np.array([T @ row for T, row in zip(self.T, self.lift * v)])  # T is symmetric
            on_mu = np.array([B @ row for B, row in zip(self.B, self.lift * v)])
        return (q, v, a), (q + rates @ v, on_lam, on_mu)

    def _pulled(self, w, mu):
        """K^T w + B^T mu, C^T w, M w and B w of the stages."""
        damped = np.zeros_like(w) if self.C is None else _each(self.C, w)
        return _each(self.K, w) + _each(self.B, mu), damped, _each(self.M, w), np.array([B @ row for B, row in zip(self.B, w)])

    def pushed(self, mu, v):
        """The slope in the diagonal of D^-1, (n,), from bars v (s, n) of the stages."""
        return (_each(self.B, mu) * v).sum(axis=0)

    def _sizes(self):
        """Factors of rows and columns: r and lam measured in the size of `K + M / h^2`, mu in 1/h, `B v + phi_t` too."""
        s, n, m, h = len(self.B), self.model.n, self.model.m, self.h
        size = float(np.mean(np.abs(self.K[0].diagonal() + self.M[0].diagonal() / h**2))) or 1.0
        more = s * m if self.tied else 0
        rows = np.full(s * n, 1 / size), np.ones(s * m), np.full(more, h)
        columns = np.ones(s * n), np.full(s * m, size), np.full(more, 1 / h)
        return np.concatenate(rows), np.concatenate(columns)

    def _matrix(self):
        """Rows r, phi and `B v + phi_t` of all stages on e, lam and mu of all of them."""
        stages = range(len(self.B))
        if self.tied:
            self.DT, self.DB = ([scaled(x, self.lift, np.ones(x.shape[1])) for x in given] for given in (self.T, [B.T for B in self.B]))
        only = lambda i, j, block: block if i == j else None  # noqa: E731
        r = [[self._r_e(i, j) for j in stages] + [only(i, j, self.B[i].T) for j in stages] for i in stages]
        phi = [[only(i, j, self.B[i]) for j in stages] + [None] * len(stages) for i in stages]
        if not self.tied:
            return block_matrix(r + phi if self.model.m else [row[: len(stages)] for row in r])
        r = [row + [self._r_v(i, j) @ self.DB[j] for j in stages] for i, row in enumerate(r)]
        rate = [[self._rate_e(i, j) for j in stages] + [None] * len(stages) for i in stages]
        rate = [row + [only(i, j, self.B[i] @ self.DB[i]) for j in stages] for i, row in enumerate(rate)]
        return block_matrix(r + [row + [None] * len(stages) for row in phi] + rate)

    def _r_e(self, i, j):
        """`K + C dv/de + M da/de`, `dv/de = W/h + D^-1 T`, `da/de = W/h dv/de`."""
        W, h = self.tableau.W, self.h
        found = (W @ W)[i, j] / h**2 * self.M[i]
        if self.C is not None:
            found = found + W[i, j] / h * self.C[i]
        if self.tied:
            found = found + self._r_v(i, j) @ self.DT[j]
        return found + self.K[i] if i == j else found

    def _r_v(self, i, j):
        """What v of stage j does in r of stage i: C and `M W / h`."""
        massive = self.tableau.W[i, j] / self.h * self.M[i]
        return massive if self.C is None or i != j else self.C[i] + massive

    def _rate_e(self, i, j):
        found = self.tableau.W[i, j] / self.h * self.B[i]
        return found + self.H[i] + self.B[i] @ self.DT[i] if i == j else found


def _each(matrices, x):
    """The transpose of each on its row of x, (s, .)."""
    return np.array([matrix.T @ row for matrix, row in zip(matrices, x)])
