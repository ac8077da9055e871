"""Radau IIA of s stages: the collocation method on the right Radau points (Hairer and Wanner, Solving ODEs II, IV.5 and IV.8).

The stages are the values of a polynomial of degree s, at the step's start too; the last one, c_s = 1, is the step's end.
"""

from functools import cache
from typing import NamedTuple

import numpy as np


class Mode(NamedTuple):
    """An eigenvalue of W = A^-1: a real one, or the one of a complex pair with positive imaginary part.

    row @ x is the part of stages x (s, ...) in this mode; outer(column, y) transforms y back, for a pair twice its real part.
    """

    value: complex
    row: np.ndarray
    column: np.ndarray

    @property
    def paired(self):
        """True if it represents a complex pair."""
        return isinstance(self.value, complex)

    def back(self, x):
        """The contribution (s, n) to the stages of a part y (n,) of this mode."""
        share = np.outer(self.column, x)
        return 2.0 * share.real if self.paired else share


class Tableau(NamedTuple):
    """Nodes c (s,), A and W = A^-1 (s, s), the modes of W, and minus the slopes at 0 of the Lagrange polynomials on the nodes (s,)."""

    c: np.ndarray
    A: np.ndarray
    W: np.ndarray
    modes: tuple
    start: np.ndarray

    @property
    def stages(self):
        """The number s of stages."""
        return len(self.c)

    @property
    def middle(self):
        """Number of the middle stage, whose constraint rows are used for all stages."""
        return len(self.c) // 2


@cache
def radau(stages):
    """The Tableau of 2 or 3 stages, order 3 or 5."""
    root = np.sqrt(6.0)
    c = np.array([1.0 / 3.0, 1.0] if stages == 2 else [(4.0 - root) / 10.0, (4.0 + root) / 10.0, 1.0])
    powers = np.arange(stages)
    A = (c[:, None] ** (powers + 1) / (powers + 1)) @ np.linalg.inv(c[:, None] ** powers)
    W = np.linalg.inv(A)
    start = [-np.prod(-np.delete(c, i) / (c[i] - np.delete(c, i))) / c[i] for i in range(stages)]
    return Tableau(c, A, W, _modes(W), np.array(start))


def _modes(W):
    """The modes of W, real ones first."""
    values, columns = np.linalg.eig(W)
    rows, modes = np.linalg.inv(columns), []
    for k in np.argsort(np.abs(values.imag), kind="stable"):
        if abs(values[k].imag) < 1e-9:
            modes.append(Mode(float(values[k].real), rows[k].real, columns[:, k].real))
        elif values[k].imag > 0:
            modes.append(Mode(complex(values[k]), rows[k], columns[:, k]))
    return tuple(modes)


def through(c, s):
    """Weights (stages,) at a time s of the step of the polynomial through values at the nodes alone; times s/c also through zero at 0."""
    own = np.eye(len(c))
    return np.prod(np.where(own, 1.0, (s - c) / (c[:, None] - c + own)), axis=1)
