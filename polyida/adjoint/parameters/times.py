"""Profiles over the times of a run, and how they change with their numbers along times that move."""

import numpy as np

from polyida.model.differences import FIRST_ORDER_STEP, along, around, within

ORDERS = ("value", "d1", "d2")


def over(profile, t, order=0):
    """Value or derivative of a profile at times t (k,), (k,); the third by differences that stay on one side of its kinks."""
    if order == len(ORDERS):
        step = FIRST_ORDER_STEP * min(1.0, profile.shortest or 1.0)
        return np.array([within(lambda s, at=at: profile.d2(at + s), around(profile.kinks, at), step) for at in t.tolist()])
    function = getattr(profile, ORDERS[order])
    return np.broadcast_to(function(t), t.shape) if profile.formula else np.array([function(at) for at in t.tolist()])


def slope_over(profile, made, scale, order, t):
    """What `made(s)`, which is the profile at s = 0, changes by with s at times t (k,), (k,).

    Differences are taken along times that move as the kinks do, so that none of them crosses one; what that is too much is taken back by
    the derivatives in time.
    """
    speeds = kink_speeds(made, scale)
    if not speeds.any():
        return along(lambda s: over(made(s), t, order), scale)
    moved = np.interp(t, profile.kinks, speeds)
    return along(lambda s: over(made(s), t + s * moved, order), scale) - moved * over(profile, t, order + 1)


def kink_speeds(made, scale):
    """By how much the kinks of `made(s)` move with s at s = 0, (kinks,): evenly."""
    return np.subtract(made(scale / 4).kinks, made(-scale / 4).kinks) / (scale / 2)
