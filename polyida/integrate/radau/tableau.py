"""Radau IIA of s stages: the collocation method on the right Radau points (Hairer and Wanner, Solving ODEs II, IV.5 and IV.8).

The stages are the values of a polynomial of degree s, at the step's start too; the last one, c_s = 1, is the step's end.
"""

from functools import cache
from typing import NamedTuple

import numpy as np


class Mode(NamedTuple):
    """An eigenvalue of W = A^-1: real, or the one of a pair with positive imaginary part.

    row x is its part of stages x (s, ...); outer(column, .) leads back, of a pair twice its real part.
    """

    value: complex
    row: np.ndarray
    column: np.ndarray

    @property
    def paired(self):
        """Whether its conjugate stands for it."""
        return isinstance(self.value, complex)

    def back(self, x):
        """Its share (s, n) of the stages, from its part x (n,)."""
        share = np.outer(self.column, x)
        return 2.0 * share.real if self.paired else share


class Tableau(NamedTuple):
    """Nodes c (s,), A and W = A^-1 (s, s), the modes of W, and -1 times the slopes at 0 of the polynomials that are 1 at one node (s,)."""

    c: np.ndarray
    A: np.ndarray
    W: np.ndarray
    modes: tuple
    start: np.ndarray

    @property
    def stages(self):
        """s."""
        return len(self.c)

    @property
    def middle(self):
        """Number of the middle stage, whose constraint rows serve all."""
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
    """The real modes first."""
    values, columns = np.linalg.eig(W)
    rows, found = np.linalg.inv(columns), []
    for k in np.argsort(np.abs(values.imag), kind="stable"):
        if abs(values[k].imag) < 1e-9:
            found.append(Mode(float(values[k].real), rows[k].real, columns[:, k].real))
        elif values[k].imag > 0:
            found.append(Mode(complex(values[k]), rows[k], columns[:, k]))
    return tuple(found)


def through_zero(c, s):
    """Weights (..., s) of values at the nodes in the polynomial that is zero at 0, at s (...): that of q - q_0 and v - v_0."""
    return np.asarray(s)[..., None] / c * through(c, s)


def through(c, s):
    """Weights (..., s) of values at the nodes in the polynomial through them alone, at s (...): that of a and lam."""
    s, others = np.asarray(s)[..., None], [np.delete(c, i) for i in range(len(c))]
    return np.stack([np.prod((s - rest) / (c[i] - rest), axis=-1) for i, rest in enumerate(others)], axis=-1)
