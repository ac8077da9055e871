"""Slopes along a way in q as sums over states: what is linear about a state is so in every parameter too."""

import numpy as np

from polyida.model.differences import FIRST_ORDER_STEP

SHARES = np.array([[1.0, 2.0 / 3.0], [-1.0, -2.0 / 3.0], [2.0, -1.0 / 12.0], [-2.0, 1.0 / 12.0]])  # places, and weights of a slope there


def reach(model, q, way):
    """The length along a way over which a model's functions vary, about."""
    return (model.extent or max(1.0, np.abs(q).max())) / (np.abs(way).max() or 1.0)


def along_way(model, t, q, lam, way, w, mu):
    """Entries of the `work` of Slopes whose sum is `d/ds (w . r + mu . phi)` at q + s way, a = 0: exact of plates, whose r is a cubic of s.

    q, way, w (n,), lam, mu (m,).
    """
    step = FIRST_ORDER_STEP * reach(model, q, way)
    at, weight = SHARES[:, :1] * step, SHARES[:, 1:] / step
    still = np.zeros((len(at), model.n))
    return np.full(len(at), t), q + at * way, still, still, np.tile(lam, (len(at), 1)), weight * w, weight * mu
