"""The cubic through values and slopes at both ends of an interval."""


def cubic(x0, v0, x1, v1, h, s):
    """(x, x') at the part s of an interval of length h, from values x0, x1 and slopes v0, v1 at its ends: Hermite's polynomial."""
    move = x1 - x0
    x = x0 + s * s * (3 - 2 * s) * move + h * s * (1 - s) * ((1 - s) * v0 - s * v1)
    return x, 6 * s * (1 - s) / h * move + (1 - s) * (1 - 3 * s) * v0 + s * (3 * s - 2) * v1
