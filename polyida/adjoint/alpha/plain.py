"""The backward sweep of generalized-alpha over equal steps, for any model: the adjoint of each step's own equations.

Step n solves `r(q, v, a, lam) = 0`, `phi(q) = 0`, the recursion of the algorithmic acceleration A and Newmark's formulas, with multipliers
w, mu, x, y and z. What the later step sends to the state it began with are bars P_q, P_v, P_a, P_A; j are the objective's own:

    [[S^T, B^T], [B, 0]] (w, mu) = (-(P_q + j_q) - gamma' (P_v + j_v) - beta' (P_a + j_a) - P_A/(beta h^2), -j_lam)
    y = -(P_q + j_q) - K^T w - B^T mu        z = -(P_v + j_v) - C^T w        x = (h^2 beta y + h gamma z - P_A)/(1 - alpha_m)
    P_q = -y,  P_v = -z - h y,  P_a = -alpha_f x,  P_A = alpha_m x - h^2 (1/2 - beta) y - h (1 - gamma) z    to the step before

with `S = beta' M + gamma' C + K`, C = dr/dv and K = dr/dq at the accepted state, and `dJ/dp += w . dr/dp + mu . dphi/dp`. y is taken from
K^T w: from the recursion it would carry the error of w, divided by h^2.

The stabilised form has one more unknown, eta in `q = Newmark's - M^-1 B^T eta`, and one more equation, psi = `B v + phi_t = 0`, with the
multiplier kappa: `psi_q^T kappa + (B^T eta)_q^T M^-1 y` stands beside `B^T mu` in y, `B^T kappa` beside `C^T w` in z, and `B M^-1 y = 0`.
"""

from typing import NamedTuple

import numpy as np

from polyida.linear.lu import LU, dense
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


class Sent(NamedTuple):
    """Bars of q, v, a and of the algorithmic acceleration, each (n,), of the state that a step began with."""

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    ahead: np.ndarray


class Swept(NamedTuple):
    """What a sweep over steps leaves: `sent` to the state before; w (count, n), mu (count, m) that multiply r and phi; kappa (count, m)
    that multiplies phi's rate, and (y', slip, eta), of `y' . (M slip + B^T eta)`, or None where there is none.
    """

    sent: Sent
    w: np.ndarray
    mu: np.ndarray
    kappa: np.ndarray | None = None
    slips: tuple | None = None


class PlainSweep:
    """Steps of h on any model, backward. counts: what counts its work."""

    def __init__(self, model, settings, h, counts):
        self.model, self.h, self.c = model, h, settings.coefficients
        self.tied = settings.form == "stabilised" and model.m > 0
        self.saddle = StepAdjoint(model, *self.c.rates(h), counts)

    def back(self, t, q, v, a, lam, slopes, sent, keep=None, slips=None):
        """The Swept of steps that ended at these frames, in order of time, (count, .) each.

        slopes: the objective's own in these frames; sent: what the step after the last sends. keep: where to write y and z, (count, n)
        each, or None. slips (count, n): of the stabilised form, what eta added to q.
        """
        w, mu, kappa, (y, z) = np.empty_like(q), np.empty_like(lam), np.empty_like(lam), keep or np.empty((2, *q.shape))
        parts = np.empty_like(q), np.empty_like(q), np.empty_like(lam)
        for k in reversed(range(len(t))):
            bars = [bar if part is None else bar + part[k] for bar, part in zip(sent, (slopes.q, slopes.v, slopes.a))]
            right, below = self._sides(*bars, sent.ahead), np.zeros(self.model.m) if slopes.lam is None else -slopes.lam[k]
            self.saddle.at(t[k], q[k], v[k], a[k], lam[k])
            if self.tied:
                w[k], mu[k], kappa[k], y[k], damped, found = self.saddle.stabilised(right, below, bars[0], slips[k])
                for part, value in zip(parts, found):
                    part[k] = value
            else:
                w[k], mu[k], stiff, damped = self.saddle.index3(right, below)
                y[k] = -bars[0] - stiff
            z[k] = -bars[1] - damped
            sent = self._sent(y[k], z[k], sent.ahead)
        return Swept(sent, w, mu, kappa, parts) if self.tied else Swept(sent, w, mu)

    def _sides(self, b_q, b_v, b_a, b_ahead):
        to_a, to_v = self.c.rates(self.h)
        return -b_q - to_v * b_v - to_a * b_a - b_ahead / (self.c.beta * self.h**2)

    def _sent(self, y, z, b_ahead):
        c, h = self.c, self.h
        x = (h * h * c.beta * y + h * c.gamma * z - b_ahead) / (1 - c.alpha_m)
        return Sent(-y, -z - h * y, -c.alpha_f * x, c.alpha_m * x - h * h * (0.5 - c.beta) * y - h * (1 - c.gamma) * z)
