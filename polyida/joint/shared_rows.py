"""Rows that several joints have."""

from polyida.joint.formula import cross


def across(a, b):
    """`d_A x (x_B - x_A)`: b stays on the line through a along its direction."""
    return cross(a.d, b.x - a.x).named("across", "N")


def held(a, b, angle=0.0, zero=None):
    """`R(angle + zero) d_A x d_B`: b stands at an angle against a, a number or a profile, beyond zero, rad; None: that at rest."""
    ahead = a.d.onto(b.d) if zero is None else a.d.turned(zero)
    return cross(ahead.turned(angle), b.d).one_way().named("angle", "N m")
