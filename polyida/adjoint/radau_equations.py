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

A scene's system is refined with products without matrices and one stale co-rotated factor for each mode of the tableau. With `W^T = sum l row
column^T` it falls into one system for each eigenvalue l, c = l/h, of K, M and C as old as the factor, in the frames of the nodes, each stage
turned from its own to the middle one's, and B and H of the middle stage:

    | S                   B^T   (c B + H)^T |  |w    |     S = K + c C + c^2 M
    | B                                     |  |mu   |
    | B (c M + C)^T              B B^T      |  |kappa|     the last row and column where there is mu in the step
"""

from typing import NamedTuple

import numpy as np

from polyida.integrate.start import rows_at
from polyida.linear.lu import FactorCache, ScaledLU, SingularSystem, block_matrix, dense, scaled
from polyida.linear.saddle import ENOUGH, LEFT, SLOW, Border

ROUNDS = 2  # solves with a step's own factor: the second takes what round-off left
MOST = 25  # corrections with one set of factors of the modes
DENSE = 300  # unknowns of a step of a small scene up to which its own matrix is factored


class StageMultipliers(NamedTuple):
    """Of a step's equations, w (s, n), mu and kappa (s, m), and bars of its stages' q, v and v', (s, n) each."""

    w: np.ndarray
    mu: np.ndarray
    kappa: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray


class StageEquations:
    """The equations at the stages of one step after another, of any model. lift (n,): the diagonal of D^-1; tied: whether there is mu."""

    def __init__(self, model, tableau, lift, tied, counts):
        self.model, self.tableau, self.lift, self.tied, self.counts = model, tableau, lift, tied, counts
        self.small = model.is_scene and model.small

    def at(self, stages):
        """Take a step's stages, and their matrices, dense where a scene is small."""
        self._take_rows(stages)
        self._take_forces()

    def _take_rows(self, stages):
        model, x = self.model, stages
        self.stages, self.h, self.B = stages, stages.h, [rows_at(model, *state) for state in zip(x.t, x.q)]
        if self.tied:
            self.H = self._shaped(model.phi_rate_q, x.t, x.q, x.v)
            self.T = self._shaped(model.reaction_q, x.t, x.q, x.mu)

    def _shaped(self, function, *stages):
        """A matrix of each stage."""
        found = [function(*state) for state in zip(*stages)]
        return [dense(matrix) for matrix in found] if self.small else found

    def _take_forces(self):
        model, x = self.model, self.stages
        if self.small:
            self.K = [model.small_tangent(*state) for state in zip(x.t, x.q, x.v, x.lam)]
            self.M = [model.small_mass()] * len(x.t)
        else:
            self.K = [model.tangent(*state, 0.0, 0.0, 1.0) for state in zip(x.t, x.q, x.v, x.a, x.lam)]
            self.M = [model.mass(q) for q in x.q]
        self.C = self._shaped(model.force_v, x.t, x.q, x.v) if model.needs.velocity_forces else None

    def back(self, b_q, b_v):
        """The StageMultipliers of the step whose end has bars b_q and b_v, (n,) each. Raises SingularSystem."""
        lu = self._lu()
        self.counts.solves += ROUNDS
        found = self._none()
        for _ in range(ROUNDS):
            left = np.concatenate([part.ravel() for part in self._left(found, b_q, b_v)[1]])
            change = self._parts(lu.solve(left, transposed=True))
            found = [part - more for part, more in zip(found, change)]
        return StageMultipliers(*found, *self._left(found, b_q, b_v)[0])

    def newton(self):
        """The changes of e, lam and mu of the stages, (s, .) each, that Newton's method subtracts. Raises SingularSystem."""
        model, x = self.model, self.stages
        self.counts.solves += 1
        r = [model.residual(*state) for state in zip(x.t, x.q, x.v, x.a, x.lam)]
        phi = [model.phi(*state) for state in zip(x.t, x.q)]
        rate = [model.phi_rate(*state) for state in zip(x.t, x.q, x.v)] if self.tied else []
        return self._parts(self._lu().solve(np.concatenate([*r, *phi, *rate])))

    def _lu(self):
        """The factor of the matrix of a step.

        r and lam are measured in the size of `K + M / h^2`, mu in 1/h, `B v + phi_t` too.
        """
        s, n, m, h = len(self.B), self.model.n, self.model.m, self.h
        size = float(np.mean(np.abs(self.K[0].diagonal() + self.M[0].diagonal() / h**2))) or 1.0
        more = s * m if self.tied else 0
        rows = np.concatenate([np.full(s * n, 1 / size), np.ones(s * m), np.full(more, h)])
        columns = np.concatenate([np.ones(s * n), np.full(s * m, size), np.full(more, 1 / h)])
        self.counts.factorizations += 1
        return ScaledLU(self._matrix(), rows, columns)

    def _none(self):
        """(w, mu, kappa), zero."""
        return self._parts(np.zeros(self.tableau.stages * (self.model.n + 2 * self.model.m)))

    def _parts(self, x):
        """(w, mu, kappa), or (e, lam, mu), of all of their numbers in order."""
        s, n, m = self.tableau.stages, self.model.n, self.model.m
        first, second, third = np.split(x, [s * n, s * (n + m)])
        return first.reshape(s, n), second.reshape(s, m), third.reshape(s, m) if self.tied else np.zeros((s, m))

    def _left(self, found, b_q, b_v):
        """((q*, v*, a*), what is left of the rows of e, lam and mu, (s, .) each) with multipliers (w, mu, kappa)."""
        w, mu, kappa = found
        rates = self.tableau.W.T / self.h
        q, v, a, on_lam = self._products(w, mu)
        v = v + rates @ a
        q[-1] += b_q
        v[-1] += b_v
        on_mu = np.zeros((len(w), 0))
        if self.tied:
            v = v + _each(self.B, kappa)
            q = q + _each(self.H, kappa) + np.array([T @ row for T, row in zip(self.T, self.lift * v)])  # T is symmetric
            on_mu = np.array([B @ row for B, row in zip(self.B, self.lift * v)])
        return (q, v, a), (q + rates @ v, on_lam, on_mu)

    def _products(self, w, mu):
        """K^T w + B^T mu, C^T w, M w and B w of the stages."""
        damped = np.zeros_like(w) if self.C is None else _each(self.C, w)
        return _each(self.K, w) + _each(self.B, mu), damped, _each(self.M, w), np.array([B @ row for B, row in zip(self.B, w)])

    def pushed(self, mu, v):
        """The slope in the diagonal of D^-1, (n,), from bars v (s, n) of the stages."""
        return (_each(self.B, mu) * v).sum(axis=0)

    def _matrix(self):
        """Rows r, phi and `B v + phi_t` of all stages on e, lam and mu of all of them.

        `dr/de = K + C dv/de + M da/de`, `dv/de = W/h + D^-1 T`, `da/de = W/h dv/de`.
        """
        s, W, tied = range(len(self.B)), self.tableau.W / self.h, self.tied
        WW, m = W @ W, self.model.m
        lifted = [[scaled(x, self.lift, np.ones(x.shape[1])) for x in given] for given in (self.T, [B.T for B in self.B])] if tied else None
        blocks = [[None] * (len(s) * (1 + (m > 0) + tied)) for _ in range(len(s) * (1 + (m > 0) + tied))]
        for i in s:
            lam, mu = i + len(s), i + 2 * len(s)
            if m:
                blocks[i][lam], blocks[lam][i] = self.B[i].T, self.B[i]
            if tied:
                blocks[mu][mu] = self.B[i] @ lifted[1][i]
            for j in s:
                r_v = W[i, j] * self.M[i]
                r_v = r_v if self.C is None or i != j else self.C[i] + r_v
                r_e = WW[i, j] * self.M[i]
                r_e = r_e if self.C is None else r_e + W[i, j] * self.C[i]
                if tied:
                    blocks[i][j + 2 * len(s)] = r_v @ lifted[1][j]
                    r_e, rate = r_e + r_v @ lifted[0][j], W[i, j] * self.B[i]
                    blocks[mu][j] = rate + self.H[i] + self.B[i] @ lifted[0][i] if i == j else rate
                blocks[i][j] = r_e + self.K[i] if i == j else r_e
        return block_matrix(blocks)


def _each(matrices, x):
    """The transpose of each on its row of x, (s, .)."""
    return np.array([matrix.T @ row for matrix, row in zip(matrices, x)])


class SceneStageEquations(StageEquations):
    """Of a compiled scene."""

    def __init__(self, model, tableau, lift, tied, counts):
        super().__init__(model, tableau, lift, tied, counts)
        self.kept = FactorCache()

    def at(self, stages):
        """Take a step's stages, their constraints' rows and nodal rotations."""
        self._take_rows(stages)
        self.B = [dense(B) for B in self.B]
        if self.tied:
            self.H = [dense(H) for H in self.H]
        self.drives = [self.model.drives(t) for t in stages.t.tolist()]
        raw = np.array([self.model.rotation(q) for q in stages.q]).view(complex)[..., 0]
        frames = raw / np.abs(raw)
        self.turns = frames[self.tableau.middle] * frames.conj()

    def back(self, b_q, b_v):
        """As of StageEquations: exact by refinement, or by that one's factor where this does not converge."""
        key = f"{self.h:.9e}"
        found = self._refined(self.kept.take(key), b_q, b_v)
        if found is None:
            self.kept.keep(key, self._factored())
            found = self._refined(self.kept.take(key), b_q, b_v)
        if found is None:
            self._take_forces()
            found = super().back(b_q, b_v)
        return found

    def _factored(self):
        x, k = self.stages, self.tableau.middle
        try:
            at = float(x.t[k]), x.q[k], x.v[k], x.a[k], x.lam[k]
            return ModeFactors(self.model, self.tableau, self.h, at, self.counts)
        except SingularSystem:
            return None

    def _refined(self, factors, b_q, b_v):
        """The StageMultipliers, or None where there are no factors or they are too old."""
        if factors is None:
            return None
        factors.surround(self)
        found, last = self._none(), np.inf
        for _ in range(MOST):
            change = factors.solve(*self._left(found, b_q, b_v)[1])
            found = [part - more for part, more in zip(found, change)]
            moved, size = np.linalg.norm(change[0]), np.linalg.norm(found[0])
            rate = moved / last
            ahead = rate / (1.0 - rate) if 0.0 < rate < 0.5 else 1.0
            done = moved * ahead <= ENOUGH * size
            if done or rate > SLOW:
                break
            last = moved
        return StageMultipliers(*found, *self._left(found, b_q, b_v)[0]) if done or moved <= LEFT * size else None

    def _products(self, w, mu):
        from polyida.adjoint.products import products_at

        found = [np.zeros_like(w), np.zeros_like(w), np.zeros_like(w), np.zeros_like(mu)]
        for k, state in enumerate(zip(self.drives, self.stages.q, self.stages.v, self.stages.lam, w, mu)):
            x = products_at(self.model, *state)
            for part, made in zip(found, (x.stiff, x.slowing, x.heavy, x.rows)):
                part[k] = made.ravel() if made.size else 0.0
        return found


class ModeFactors:
    """The factors for steps of h, made at a state (t, q, v, a, lam); `surround` takes a step's rows, `solve` solves. Raises SingularSystem."""

    def __init__(self, model, tableau, h, at, counts):
        self.model, self.tableau, self.counts = model, tableau, counts
        self.c = [mode.value / h for mode in tableau.modes]
        first = model.step_matrix()
        first.factor(*at, self.c[0] ** 2, self.c[0])
        self.factors = [first, *(first.beside(c**2, c, None) for c in self.c[1:])]
        self.counts.factorizations += len(self.factors)
        self.counts.backend = first.backend

    def surround(self, equations):
        """Take the q and the rows of the middle stage, and the stages' turns to there (s, nodes), complex."""
        x, k, model = equations.stages, self.tableau.middle, self.model
        self.q, self.turns, self.tied, B = x.q[k], equations.turns, equations.tied, equations.B[k]
        self.borders, self.rows, self.corner, rows = [], [], np.zeros((len(B), len(B))), B
        if self.tied:
            rows = np.vstack([B, equations.H[k]])
            self.corner = np.zeros((len(rows), len(rows)))
            self.corner[len(B) :, len(B) :] = B @ B.T
            MB = model.mass(x.q[k]) @ B.T
            CB = model.force_v(x.t[k], x.q[k], x.v[k]) @ B.T if model.needs.velocity_forces else 0.0
        for k, factor in enumerate(self.factors):
            self.counts.solves += len(rows)
            self.borders.append(Border(factor.solve(self.q, self._of_type(k, rows.T), True)))
            self.rows.append(np.vstack([B, (self.c[k] * MB + CB).T]) if self.tied else B)

    def solve(self, on_e, on_lam, on_mu):
        """(w, mu, kappa), (s, .) each, of a right-hand side in the rows of e, lam and mu."""
        parts, m = (_turned(on_e, self.turns), on_lam, on_mu), self.model.m
        w, mu, kappa = np.zeros_like(on_e), np.zeros_like(on_lam), np.zeros_like(on_lam)
        for k, (mode, factor) in enumerate(zip(self.tableau.modes, self.factors)):
            right, *below = (mode.column @ part for part in parts)
            self.counts.solves += 1
            y = factor.solve(self.q, self._of_type(k, right), True)
            y, x = self.borders[k].solve(y, self.rows[k], np.concatenate(below), self.corner)
            w += _back(mode, y)
            mu += _back(mode, x[:m] - self.c[k] * x[m:] if self.tied else x)
            if self.tied:
                kappa += _back(mode, x[m:])
        return _turned(w, self.turns.conj()), mu, kappa

    def _of_type(self, k, x):
        return np.ascontiguousarray(x, complex if self.tableau.modes[k].paired else float)


def _turned(x, turns):
    """Each pair of coordinates turned."""
    return (turns * np.ascontiguousarray(x).view(complex)).view(float)


def _back(mode, x):
    """The contribution of the part x (k,) of a mode of W^T to the stages, (s, k); of a pair twice its real part."""
    share = np.outer(mode.row, x)
    return 2.0 * share.real if mode.paired else share
