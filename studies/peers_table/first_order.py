"""The pendulum for solvers that take F(t, y, y') = 0."""

import numpy as np

from peers_table.rows import GRAVITY

START = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])  # q, v, and the integrals of both multipliers


def pendulum(t, y, yp):
    """F of a mass on a rod of 1 m: the stabilised form of Gear, Gupta and Leimkuhler in the multipliers' integrals, which makes it index 1."""
    q, v, lam, mu = y[:2], y[2:4], yp[4], yp[5]
    weight = np.array([0.0, GRAVITY])
    return np.concatenate([yp[:2] - v + 2 * q * mu, yp[2:4] + weight + 2 * q * lam, [q @ q - 1.0, 2 * q @ v]])


def slopes():
    """y' at the start."""
    return np.array([0.0, 0.0, 0.0, -GRAVITY, 0.0, 0.0])
