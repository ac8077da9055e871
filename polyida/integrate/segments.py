"""Pieces of a run between the kinks of its loads and motors, so that no step crosses one."""

import math

import numpy as np

PULSE = 4  # steps in which a piece is taken at least where its loads are no straight lines
INSIDE = (0.29, 0.5, 0.62)  # where they are looked at, and not only in the middle, where a whole sine is zero too
STRAIGHT = 1e-6  # distance from a straight line, over the forces' size, that is none


def segments(model, t0, t_end):
    """[(begin, end)] from t0 to t_end, parted at the model's kinks; kinks within round-off of an end are left out."""
    near = 1e-12 * max(abs(t0), abs(t_end), t_end - t0)
    inner = [t for t in model.kinks(t0, t_end) if t0 + near < t < t_end - near]
    edges = [t0, *inner, t_end]
    return list(zip(edges[:-1], edges[1:]))


def enough_steps(model, state, begin, end, h):
    """Equal steps, none above h, for the piece from begin to end, at which the run is in `state`.

    A single step sees the loads at its ends only: a pulse between two kinks that begins and ends at zero would not be
    there. So behind a kink there are some more, unless the loads are straight lines.
    """
    number = max(1, int(np.ceil((end - begin) / h * (1 - 1e-12))))
    enough = number >= PULSE or not at_kink(model, begin) or not _bent(model, state, begin, end)
    return number if enough else PULSE


def at_kink(model, t):
    """Whether a load or motor has a kink at t."""
    near = 1e-12 * max(abs(t), 1e-300)
    return bool(model.kinks(t - near, t + near))


def beside(t, side):
    """A time next to t, later where side is 1 and earlier where it is -1."""
    return t + side * 32 * math.ulp(max(abs(t), 1.0))


def _bent(model, state, begin, end):
    near = 1e-9 * (end - begin)
    first, last = (model.force(t, state.q, state.v) for t in (begin + near, end - near))
    for s in INSIDE:
        force = model.force(begin + s * (end - begin), state.q, state.v)
        size = max(np.abs(x).max(initial=0.0) for x in (first, force, last))
        if np.abs(force - (1 - s) * first - s * last).max(initial=0.0) > STRAIGHT * size:
            return True
    return False
