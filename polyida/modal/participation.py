"""How much of a model's mass each mode moves along x and y."""

import numpy as np


def effective_masses(model, M, X):
    """`|x^H M r|^2`, (count, 2), kg, of mass-normalised shapes X (n, count), r the unit translations along x and y; and `r^T M r`, kg.

    None and nan of a model that has no bodies.
    """
    r = translations(model)
    if r is None:
        return None, float("nan")
    return np.abs(X.conj().T @ (M @ r)) ** 2, float(r[:, 0] @ (M @ r[:, 0]))


def translations(model):
    """Columns (n, 2): how q moves where all bodies move by 1 m along x, and along y; None where the model has no bodies."""
    if not model.is_scene:
        return None
    T = model.translation
    return np.stack([T.view(float), (1j * T).view(float)], axis=1)
