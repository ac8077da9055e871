"""Plane polygons side by side: corners (n, 2, c), counter-clockwise, c cells on the last axis."""

import numpy as np


def cross(a, b):
    """a_x b_y - a_y b_x for vectors along axis -2."""
    return a[..., 0, :] * b[..., 1, :] - a[..., 1, :] * b[..., 0, :]


def after(array):
    """The next corner's entry at every corner."""
    return np.roll(array, -1, axis=0)


def before(array):
    """The previous corner's entry at every corner."""
    return np.roll(array, 1, axis=0)


def measures(corners):
    """Area (c,), centroid (2, c) and the exact mean gradients (n, 2, c) = oint N_i n ds / area of linear edges."""
    follower = after(corners)
    double = cross(corners, follower)
    area = double.sum(axis=0) / 2
    centroid = np.einsum("nc,ndc->dc", double, corners + follower) / (6 * area)
    chord = (follower - before(corners)) / (2 * area)
    return area, centroid, np.stack([chord[:, 1], -chord[:, 0]], axis=1)


def second_moments(corners):
    """int x (x) x over the polygons, (2, 2, c), about the origin: exact, from the triangles origin - edge."""
    follower = after(corners)
    double = cross(corners, follower)
    return sum(np.einsum("nc,ndc,nec->dec", double, x, x) for x in (corners, follower, corners + follower)) / 24
