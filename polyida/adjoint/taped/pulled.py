"""Transposed derivatives of a model's residual times a vector; of a compiled scene without its matrices."""

import numpy as np


def residual_q(model, t, q, v, a, lam, w):
    """r_q^T w, (n,)."""
    if model.compiled:
        return _products(model, t, q, v, lam, w).stiff.ravel().copy()
    return model.tangent(t, q, v, a, lam, 0.0, 0.0, 1.0).T @ w


def residual_v(model, t, q, v, w):
    """r_v^T w, (n,)."""
    if model.compiled:
        return _products(model, t, q, v, np.zeros(model.m), w).slowing.ravel().copy()
    return model.force_v(t, q, v).T @ w


def _products(model, t, q, v, lam, w):
    from polyida.adjoint.scene.products import products_at

    return products_at(model, model.drives(t), q, v, lam, w, np.zeros(model.m))
