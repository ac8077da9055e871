"""The linear systems of a step: for each mode of the tableau one n x n factor and a small border.

With c = l/h, l the mode's eigenvalue, the transformed stages of one mode solve

    |  c I    -I             G^T |  |dq  |     |r1|     q' - v + G^T mu,   G = B D^-1, D the diagonal of M over its mean
    |  K     c M + C   B^T       |  |dv  | = - |r2|     M v' + g + B^T lam
    |  B                         |  |dlam|     |r3|     phi
    |  H      B                  |  |dmu |     |r4|     phi' = B v + phi_t,   H = d phi'/dq

The first row gives dv; what remains is `S = K + c C + c^2 M` bordered by B, and by H with its mu where the form has them.
"""

import numpy as np

from polyida.integrate.radau.frames import conj, rotations, turned
from polyida.linear.border import Border
from polyida.linear.lu import LU, SingularSystem
from polyida.linear.matrix import dense
from polyida.model.differences import along


class Rows:
    """The constraints' rows at (t, q, v), in the frame that is turned by p: B (m, n), and H and G (m, n) where there is mu.

    lift: D^-1 (n,), or None where there is no mu.
    """

    def __init__(self, model, t, q, v, lift, p=None):
        B, self.p, self.tied = dense(model.phi_q(t, q)), p, lift is not None
        self.B = turned(B, conj(p))
        self.G = self.B * lift if self.tied else self.B[:0]
        self.H = turned(_slope(model, t, q, v, B), conj(p)) if self.tied else np.zeros((0, model.n))
        self.both = np.vstack([self.B, self.H])

    def below(self, c, r1, r3, r4):
        """The right-hand sides of the rows on dq."""
        return np.concatenate([-r3, c * r3 - self.B @ r1 - r4]) if self.tied else -r3

    def corner(self):
        """What the multipliers add to the rows."""
        m = len(self.B)
        corner = np.zeros((len(self.both), len(self.both)))
        if self.tied:
            corner[m:, m:] = self.B @ self.G.T
        return corner


def _slope(model, t, q, v, B):
    """d(phi_q v + phi_t)/dq, which is the slope of phi_q along the motion."""
    if not (model.needs.phi_q_varies or model.needs.driven):
        return np.zeros_like(B)
    reach = min(1.0, (1.0 + np.abs(q).max(initial=0)) / (1e-300 + np.abs(v).max(initial=0)))
    return along(lambda s: dense(model.phi_q(t + s, q + s * v)), reach)


class Matrices:
    """The factored S of every mode for steps of h, made when first used from `made_at`: t, q, v, a and lam in one array.

    M and the modes' slopes, c M + C, are those of there.
    Of scenes they are taken in the frame of the nodes, one for each stage: what goes in is turned back, what comes out is turned.
    price: iterations that it cost beyond those of a good one.
    """

    def __init__(self, model, modes, h, made_at):
        self.model, self.modes, self.made_at, self.price = model, modes, made_at, 0.0
        self.c = [mode.value / h for mode in modes]
        self.factors = self.borders = None

    def make(self):
        """Factor, where it is not done. Raises SingularSystem."""
        if self.factors is not None:
            return
        model, at = self.model, (float(self.made_at[0]), *np.split(self.made_at[1:], np.cumsum([self.model.n] * 3)))
        K = model.tangent(*at, 0.0, 0.0, 1.0)
        self.rotations = rotations(model, at[1])
        self.M, damped = model.mass(at[1]), model.needs.velocity_forces
        C = model.force_v(*at[:3]) if damped else None
        self.slopes = [c * self.M + C if damped else c * self.M for c in self.c]
        matrices = [K + c * slope for c, slope in zip(self.c, self.slopes)]
        try:
            self.factors, self.added = [LU(S) for S in matrices], 0.0
            if model.m and any(factor.doubtful() for factor in self.factors):
                raise SingularSystem("the step matrix may be singular")
        except SingularSystem:
            self.factors, self.added = self._held(matrices, at[0], at[1])

    def _held(self, matrices, t, q):
        """(factors of S + s B^T B, s), where S may be singular: coordinates have no mass and are held by constraints alone.

        With `B dq = -r3` nothing has changed but dlam, by s r3.
        """
        B = self.model.phi_q(t, q)
        s = float(np.abs(matrices[0].diagonal()).max(initial=0.0)) / max(float(abs(B).max()), 1e-300) ** 2 if self.model.m else 0.0
        return [LU(S + s * (B.T @ B)) for S in matrices], s

    def turn(self, q):
        """How far the nodes have turned since at q (s, n), (s, nodes), or None."""
        return None if self.rotations is None else np.array([rotations(self.model, x) for x in q]) * self.rotations.conj()

    def surround(self, rows):
        """Take the constraints' rows, and make the columns that belong to them."""
        self.rows, self.corner, self.borders = rows, rows.corner(), []
        for mode, slope, factor in zip(self.modes, self.slopes, self.factors):
            columns = np.hstack([rows.B.T, slope @ rows.G.T]) if rows.tied else rows.B.T
            self.borders.append(Border(_solve(factor, columns, mode.paired)))

    def solve(self, k, r1, r2, r3, r4):
        """(dq, dv, dlam, dmu) of mode k. Raises SingularSystem."""
        c, m = self.c[k], len(self.rows.B)
        y = -_solve(self.factors[k], r2 + self.slopes[k] @ r1, self.modes[k].paired)
        dq, w = self.borders[k].solve(y, self.rows.both, self.rows.below(c, r1, r3, r4), self.corner)
        dv = c * dq + r1 + self.rows.G.T @ w[m:]
        return dq, dv, w[:m] - self.added * r3, w[m:]

    def stages(self, q, r1, r2, r3, r4):
        """The corrections of all stages at q (s, n), each (s, ...), from their residuals, each (s, ...). Raises SingularSystem."""
        total, p = None, self.turn(q)
        residuals = turned(r1, conj(p)), turned(r2, conj(p)), r3, r4
        for k, mode in enumerate(self.modes):
            share = [mode.back(x) for x in self.solve(k, *(mode.row @ r for r in residuals))]
            total = share if total is None else [x + y for x, y in zip(total, share)]
        dq, dv, dlam, dmu = total
        return turned(dq, p), turned(dv, p), dlam, dmu


def _solve(factor, b, paired):
    return factor.solve(b.astype(complex) if paired else b)
