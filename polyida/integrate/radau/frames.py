"""Frames that turn with the nodes of a scene: in them a factor serves on while the bodies rotate.

A turn is a complex number of size one for each node, (..., nodes), or None where a model has no nodes that turn: `P = R(q) R_ref^T`.
"""

import numpy as np


def rotations(model, q):
    """The nodes' rotations at q, (nodes,), or None of a model that has none, or whose factors do not turn with it."""
    if not model.compiled:
        return None
    raw = model.rotation(q).view(complex)[:, 0]
    size = np.abs(raw)
    return np.where(size > 0.0, raw, 1.0) / np.where(size > 0.0, size, 1.0)


def turned(x, p):
    """P x, for x (..., n) in pairs; of the conjugate of p it is P^T x."""
    if p is None:
        return x
    return (np.ascontiguousarray(x).view(complex) * p).view(float)


def conj(p):
    """The way back."""
    return None if p is None else p.conj()
