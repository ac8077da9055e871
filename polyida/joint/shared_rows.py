"""Rows that several joints have, and what their multipliers do to side b."""

import numpy as np

from polyida.joint.formula import cross

FORCE = (("x", "N"), ("y", "N"))  # axis and unit of a reaction's components
FORCE_AND_MOMENT = (*FORCE, ("", "N m"))


def across(a, b):
    """`d_A x (x_B - x_A)`: b stays on the line through a along its direction."""
    return cross(a.d, b.x - a.x).named("across", "N")


def held(a, b, angle=0.0, zero=None):
    """`R(angle + zero) d_A x d_B`: b stands at an angle against a, a number or a profile, beyond zero, rad; None: that at rest."""
    ahead = a.d.onto(b.d) if zero is None else a.d.turned(zero)
    return cross(ahead.turned(angle), b.d).one_way().named("angle", "N m")


def force_across(joint, lam, values):
    """The force on b, (frames, 2), N, of the multipliers (frames,) of `across`."""
    d = values(joint.a.d)
    return -lam[:, None] * np.stack([-d[:, 1], d[:, 0]], axis=1)


def torque(joint, lam, values):
    """The torque on b, (frames,), N m, of the multipliers (frames,) of `held`."""
    sizes = [np.linalg.norm(values(side.d), axis=1) for side in (joint.a, joint.b)]
    return -lam * sizes[0] * sizes[1]
