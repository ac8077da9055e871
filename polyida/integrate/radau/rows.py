"""The constraints' rows of the middle stage, and the weights by which mu moves v (radau/step.py)."""

import numpy as np

from polyida.linear.lu import dense
from polyida.model.differences import along, reach_along

NOTHING = 1e-12  # of the largest mass: none


def lift(model, shares):
    """D^-1 (n,) from the coordinates' shares in the mass; those without mass count as any, and as all where all are alike."""
    heavy = shares > NOTHING * shares.max()
    masses = np.where(heavy, 1.0 / (len(shares) * np.where(heavy, shares, 1.0)), 1.0)
    return np.ones_like(shares) if model.alike else masses


class Rows:
    """The constraints' rows at (t, q, v): B (m, n), and H and G (m, n) where there is mu.

    lift: the diagonal of D^-1 (n,), or None where there is no mu.
    """

    def __init__(self, model, t, q, v, lift):
        self.B, self.tied = dense(model.phi_q(t, q)), lift is not None
        self.G = self.B * lift if self.tied else self.B[:0]
        self.H = _slope(model, t, q, v, self.B) if self.tied else np.zeros((0, model.n))
        self.both = np.vstack([self.B, self.H])

    def below(self, c, r3, r4):
        """The right-hand sides of the rows on dq."""
        return np.concatenate([-r3, c * r3 - r4]) if self.tied else -r3

    def corner(self):
        """What the multipliers add to the rows."""
        m = len(self.B)
        corner = np.zeros((len(self.both), len(self.both)))
        if self.tied:
            corner[m:, m:] = self.B @ self.G.T
        return corner


def _slope(model, t, q, v, B):
    """d(phi_q v + phi_t)/dq, which is the slope of phi_q along the motion."""
    return along(lambda s: dense(model.phi_q(t + s, q + s * v)), reach_along(q, v))
