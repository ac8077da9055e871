"""Sizes of the rows of phi, so that a start far from its constraints is refused in any unit of length: a tolerance is relative to the model."""

import numpy as np

from polyida.linear.saddle import coordinate_sizes

SECOND = 1.0  # s


def row_sizes(model, q, rows):
    """Change of each row of phi, (m,), if coordinates change by the model's size: the unit in which phi = 0 is satisfied or not.

    In a scene they move by its extent. In a user's model they change by |q|, and, as they may have different units, by no more than
    `1/sqrt(M_ii)` allows; if q = 0 by 1. rows: phi_q there.
    """
    slopes = abs(rows)
    if model.is_scene:
        moved = np.repeat(model.translation != 0, 2)
        of_places = _largest(slopes[:, np.flatnonzero(moved)])
        return model.extent * np.where(of_places > 0, of_places, _largest(slopes))
    return _largest(slopes * coordinate_changes(model, q, q)[None])


def rate_sizes(model, q, v, rows):
    """Change of each row of `phi_q v + phi_t`, (m,), at the model's speed: the unit in which it is zero or not.

    The speed is |v|, in a scene at least `sqrt(g length)`, in others the size of q in a second.
    """
    if model.is_scene:
        return max(float(np.abs(v).max(initial=0.0)), model.state_speed) / model.extent * row_sizes(model, q, rows)
    changes = np.maximum(coordinate_changes(model, q, q) / SECOND, coordinate_changes(model, q, v) if v.any() else 0.0)
    return _largest(abs(rows) * changes[None])


def coordinate_changes(model, q, x):
    """Typical change of each coordinate of a user's model, (n,), of a vector x of its coordinates, positive: 1 if x = 0."""
    largest, units = float(np.abs(x).max(initial=0.0)), coordinate_sizes(model, q)
    return np.minimum(largest, units * np.abs(x / units).max(initial=0.0)) if largest else np.ones(model.n)


def _largest(slopes):
    """Largest entry of each row of a matrix without negative entries, dense or sparse, (rows,)."""
    largest = slopes.max(axis=1) if slopes.shape[1] else np.zeros(slopes.shape[0])
    return np.asarray(largest.todense() if hasattr(largest, "todense") else largest, float).ravel()
