"""The backward sweep of generalized-alpha over equal steps, for any model: the adjoint of each step's own equations.

Step n solves `r(q, v, a, lam) = 0`, `phi(q) = 0`, the recursion of the algorithmic acceleration A and Newmark's formulas, with multipliers
w, mu, x, y and z. What the later step sends to the state it began with are bars P_q, P_v, P_a, P_A; j are the objective's own:

    [[S^T, B^T], [B, 0]] (w, mu) = (-(P_q + j_q) - gamma' (P_v + j_v) - beta' (P_a + j_a) - P_A/(beta h^2), -j_lam)
    y = -(P_q + j_q) - K^T w - B^T mu        z = -(P_v + j_v) - C^T w        x = (h^2 beta y + h gamma z - P_A)/(1 - alpha_m)
    P_q = -y,  P_v = -z - h y,  P_a = -alpha_f x,  P_A = alpha_m x - h^2 (1/2 - beta) y - h (1 - gamma) z    to the step before

with `S = beta' M + gamma' C + K`, C = dr/dv and K = dr/dq at the accepted state, and `dJ/dp += w . dr/dp + mu . dphi/dp`. y is taken from
K^T w: from the recursion it would carry the error of w, divided by h^2.

The stabilised form has one more unknown, eta in `q = Newmark's - M^-1 B^T eta`, and one more equation, psi = `B v + phi_t = 0`, with the
multiplier kappa: `+ psi_q^T kappa` stands beside `B^T mu` in y, `+ B^T kappa` beside `C^T w` in z, and `B M^-1 y = 0`.
"""

from typing import NamedTuple

import numpy as np

from polyida.gradient.saddle import StepAdjoint


class Sent(NamedTuple):
    """Bars of q, v, a and of the algorithmic acceleration, each (n,), of the state that a step began with."""

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    ahead: np.ndarray


class PlainSweep:
    """Steps of h on any model, backward. counts: what counts its work."""

    def __init__(self, model, settings, h, counts):
        self.model, self.h = model, h
        self.c = settings.coefficients
        self.tied = settings.form == "stabilised" and model.m > 0
        self.saddle = StepAdjoint(model, *self.c.rates(h), counts)

    def back(self, t, q, v, a, lam, slopes, sent, keep=None):
        """(Sent to the state before, w (count, n), mu, kappa (count, m)) of steps that ended at these frames, in order of time.

        slopes: the objective's own in these frames; sent: what the step after the last sends. keep: where to write y and z, (count, n).
        """
        w, mu, kappa = np.empty_like(q), np.empty_like(lam), np.zeros_like(lam)
        for k in reversed(range(len(t))):
            own = [None if part is None else part[k] for part in (slopes.q, slopes.v, slopes.a, slopes.lam)]
            sent, w[k], mu[k], kappa[k], y, z = self._step(t[k], q[k], v[k], a[k], lam[k], own, sent)
            if keep is not None:
                keep[0][k], keep[1][k] = y, z
        return sent, w, mu, kappa

    def _step(self, t, q, v, a, lam, own, sent):
        c, h = self.c, self.h
        to_a, to_v = c.rates(h)
        b_q, b_v, b_a = (bar if slope is None else bar + slope for bar, slope in zip(sent, own[:3]))
        right = -b_q - to_v * b_v - to_a * b_a - sent.ahead / (c.beta * h * h)
        j_lam = np.zeros(self.model.m) if own[3] is None else own[3]
        self.saddle.at(t, q, v, a, lam)
        if self.tied:
            w, mu, kappa, stiff, damp = self.saddle.stabilised(right, -j_lam, b_q)
        else:
            w, mu, stiff, damp = self.saddle.index3(right, -j_lam)
            kappa = np.zeros(self.model.m)
        y, z = -b_q - stiff, -b_v - damp
        x = (h * h * c.beta * y + h * c.gamma * z - sent.ahead) / (1 - c.alpha_m)
        return _sent(c, h, x, y, z), w, mu, kappa, y, z


def _sent(c, h, x, y, z):
    return Sent(-y, -z - h * y, -c.alpha_f * x, c.alpha_m * x - h * h * (0.5 - c.beta) * y - h * (1 - c.gamma) * z)
