"""Profiles and force elements over the times of a run, and how profiles change with their numbers along times that move."""

import numpy as np

from polyida.integrate.kinks import beside
from polyida.model.differences import FIRST_ORDER_STEP, along, around, within

ORDERS = ("value", "d1", "d2")


def over(profile, t, order=0):
    """Value or derivative of a profile at times t (k,), (k,); the third by differences that stay on one side of its kinks."""
    if order == len(ORDERS):
        step = FIRST_ORDER_STEP * min(1.0, profile.shortest or 1.0)
        return np.array([within(lambda s, at=at: profile.d2(at + s), around(profile.kinks, at), step) for at in t.tolist()])
    return profile.over(t, order)


def slope_over(profile, made, scale, speeds, orders, t):
    """What `made(s)`, which is the profile at s = 0, changes by with s, in value and derivatives of these orders at times t, (k, orders).

    speeds: of its kinks. Differences are taken along times that move as the kinks do, so that none of them crosses one; what that is too
    much is taken back by the derivatives in time.
    """
    moved = np.interp(t, profile.kinks, speeds) if speeds.any() else np.zeros(len(t))
    if moved.any():
        t = np.array([_beside_kink(profile, at) for at in t.tolist()])

    def table(s):
        near = made(s)
        return np.stack([over(near, t + s * moved, order) for order in orders], axis=1)

    result = along(table, scale)
    return result - np.stack([moved * over(profile, t, order + 1) for order in orders], axis=1) if moved.any() else result


def _beside_kink(profile, t):
    """t, or of a kink the time on the side of which the profile has its values there: both move, and round-off would choose the side."""
    if not any(abs(kink - t) <= 8 * np.spacing(max(1.0, abs(t))) for kink in profile.kinks):
        return t
    at = np.array([beside(t, -1), t, beside(t, 1)])
    apart = sum(np.abs(values - values[1]) for values in (over(profile, at, order) for order in range(len(ORDERS))))
    return float(at[0] if apart[0] < apart[2] else at[2])


def kink_speeds(made, scale):
    """By how much the kinks of `made(s)` move with s at s = 0, (kinks,): evenly."""
    return np.subtract(made(scale / 4).kinks, made(-scale / 4).kinks) / (scale / 2)


def at_sides(own, x):
    """What x (k, n) is at the sides of an OwnForce, (k, sides, 2)."""
    return (own.A @ x.T).T.reshape(len(x), -1, 2)


def element_work(own, element, work):
    """`-w . A^T f` of each entry, (k,), of an element on the sides of an OwnForce, which is of one like it."""
    x, v = own.rest + at_sides(own, work.q), at_sides(own, work.v)
    forces = [element.forces(*state) for state in zip(work.t.tolist(), x, v)]
    return -np.einsum("kie,kie->k", at_sides(own, work.w), np.reshape(forces, x.shape))
