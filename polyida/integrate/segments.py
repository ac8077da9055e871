"""Pieces of a run between the kinks of its loads and motors, so that no step crosses one."""

import numpy as np

PULSE = 4  # steps in which a piece is taken at least where its loads are no straight lines
STRAIGHT = 1e-6  # distance from a straight line, over the forces' size, that is none


def segments(model, t0, t_end):
    """[(begin, end)] from t0 to t_end, parted at the model's kinks; kinks within round-off of an end are left out."""
    near = 1e-12 * max(abs(t0), abs(t_end), t_end - t0)
    inner = [t for t in model.kinks(t0, t_end) if t0 + near < t < t_end - near]
    edges = [t0, *inner, t_end]
    return list(zip(edges[:-1], edges[1:]))


def enough_steps(model, state, begin, end, h):
    """Equal steps, none above h, for the piece from begin to end, at which the run is in `state`.

    A single step sees the loads at its ends only: a pulse that begins and ends at zero would not be there. So where loads
    are no straight lines there are some more.
    """
    number = max(1, int(np.ceil((end - begin) / h * (1 - 1e-12))))
    return number if number >= PULSE or not _bent(model, state, begin, end) else PULSE


def _bent(model, state, begin, end):
    near = 1e-9 * (end - begin)
    first, middle, last = (model.force(t, state.q, state.v) for t in (begin + near, (begin + end) / 2, end - near))
    size = max(np.abs(first).max(initial=0.0), np.abs(middle).max(initial=0.0), np.abs(last).max(initial=0.0))
    return np.abs(middle - (first + last) / 2).max(initial=0.0) > STRAIGHT * size
