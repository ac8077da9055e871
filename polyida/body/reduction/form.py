"""The exact St. Venant-Kirchhoff energy of a span of complex fields, as a form on the products of their coordinates."""

import numpy as np

from polyida.jit.intrinsics import LANES

CHUNK = 512  # blocks of cells whose strains are held at a time


def form_of_fields(matrices, fields):
    """(form, shift): `W = d^T form d / 2 + shift^T d`, d the gain of y = (Re conj(z_i) z_j, i <= j; Im conj(z_i) z_j, i < j), for
    `x = sum z_k f_k`, fields (N, K).

    With a_k, b_k the slopes of f_k along x and y, conj(z_i) z_j is multiplied in Exx by conj(a_i) a_j / 2, in Eyy by conj(b_i) b_j / 2,
    in 2 Exy by `conj(a_i) b_j + conj(b_i) a_j`, /2; `form = sum weight t Q^T C Q` over the points, Q from y to (Exx, Eyy, 2 Exy).
    shift: of the stabilisation, which is quadratic in z.
    """
    c1, nu = matrices.c1
    C = c1 * np.array([[1.0, nu, 0.0], [nu, 1.0, 0.0], [0.0, 0.0, (1.0 - nu) / 2.0]])
    size = fields.shape[1] ** 2
    form = np.zeros((size, size))
    for weights, slopes in _points(matrices.operator, fields):
        Q = _strains(slopes)
        weighted = np.einsum("ab,bpy->apy", C, Q) * weights[:, None]
        form += Q.reshape(-1, size).T @ weighted.reshape(-1, size)
    if matrices.stabilisation is None:
        return (form + form.T) / 2, np.zeros(size)
    return (form + form.T) / 2, _on_products(fields.conj().T @ (matrices.stabilisation @ fields))


def _on_products(H):
    """shift with `shift . y = z^H H z / 2`, H Hermitian."""
    i, j = np.triu_indices(len(H))
    p, q = np.triu_indices(len(H), 1)
    return np.concatenate([np.where(i == j, 0.5, 1.0) * H[i, j].real, -H[p, q].imag])


def _strains(slopes):
    """Q, (3, points, K^2), from the fields' slopes (points, 2, K)."""
    a, b = slopes[:, 0], slopes[:, 1]
    i, j = np.triu_indices(a.shape[1])
    p, q = np.triu_indices(a.shape[1], 1)
    half = np.where(i == j, 0.5, 1.0)
    found = []
    for left, right in ((a, a), (b, b)):
        found.append(np.concatenate([half * (left[:, i].conj() * right[:, j]).real, -(left[:, p].conj() * right[:, q]).imag], axis=1))
    mixed = a[:, i].conj() * b[:, j] + b[:, i].conj() * a[:, j]
    across = a[:, p].conj() * b[:, q] + b[:, p].conj() * a[:, q]
    found.append(np.concatenate([half * mixed.real, -across.imag], axis=1))
    return np.stack(found)


def _points(operator, fields):
    """Pieces of all integration points: their areas (points,) and the slopes of the fields there (points, 2, K)."""
    layout = operator.layout
    for n, points in np.unique(layout[:, :2], axis=0):
        blocks = layout[(layout[:, 0] == n) & (layout[:, 1] == points)]
        for k in range(0, len(blocks), CHUNK):
            _, _, corner, gradient, weight = blocks[k : k + CHUNK].T[:5]
            corners = _taken(operator.corners, corner, (n, LANES))
            gradients = _taken(operator.gradients, gradient, (points, n - 1, 2, LANES))
            values = fields[corners]
            values = values[:, :-1] - values[:, -1:]
            slopes = np.einsum("bpcdl,bclk->bpldk", gradients, values, optimize=True)
            yield _taken(operator.weights, weight, (points, LANES)).ravel(), slopes.reshape(-1, 2, fields.shape[1])


def _taken(array, starts, shape):
    """Rows of an array from each of the starts, (starts, *shape)."""
    return array[starts[:, None] + np.arange(np.prod(shape))].reshape(len(starts), *shape)
