"""Slopes along a way in q as entries of a Work: what is linear about a state is so in every parameter too."""

import numpy as np

from polyida.gradient.parameters.work import Work
from polyida.model.differences import FIRST_ORDER_STEP

SHARES = np.array([[1.0, 2.0 / 3.0], [-1.0, -2.0 / 3.0], [2.0, -1.0 / 12.0], [-2.0, 1.0 / 12.0]])  # places, and weights of a slope there


def along_way(model, t, q, lam, way, w, mu):
    """Entries (t, q, v, a, lam, w, mu) whose sum is `d/ds (w . r + mu . phi)` at q + s way, a = 0: a plate's r is a cubic of s, and it is exact.

    way, w (n,), mu and lam (m,).
    """
    size = np.abs(way).max()
    step = FIRST_ORDER_STEP * (model.extent or max(1.0, np.abs(q).max())) / (size or 1.0)
    at, weight = SHARES[:, :1] * step, SHARES[:, 1:] / step
    still, count = np.zeros((len(at), model.n)), (len(at), 1)
    return Work(np.full(len(at), t), q + at * way, still, still, np.tile(lam, count), weight * w, weight * mu)
