"""`[[M, B^T], [B, 0]]` of a scene, B = phi_q: joints act through few points, whose columns of M^-1 are made once a model."""

import numpy as np

from polyida.given import on_pairs


class MassSystem:
    """The system with a `border`; `solve` any number of right-hand sides."""

    def __init__(self, model, border):
        self.model, self.n = model, model.n
        self._reach, self._across, _ = model.once(point_columns)
        self._border, self._schur = border

    def solve(self, r, phi):
        """(dq, dlam) for the residuals r (n,) and phi (m,): `M dq + B^T dlam = -r`, `B dq = -phi`."""
        y = -self.model.mass_inverse(r) if r.any() else np.zeros(self.n)
        if not phi.size:
            return y, np.zeros(0)
        dlam = np.linalg.solve(self._schur, self._border @ self.model.dz(y).ravel() + phi)
        pull = (dlam @ self._border).reshape(-1, 2)
        moved = self._reach @ pull
        if len(self._across):
            moved += self._across @ (pull[:, ::-1] * (-1.0, 1.0))
        return y - moved.ravel(), dlam


def border(model, t, q):
    """(phi_q in the coordinates of the points, its product with M^-1 on both sides) at (t, q)."""
    across = model.phi_z(t, q)
    return across, across @ model.once(point_columns)[2] @ across.T


def border_at_rest(model):
    """The border of a scene without motors, always the same."""
    return border(model, 0.0, np.zeros(model.n))


def point_columns(model):
    """`M^-1 A^T`, the real parts (pairs, points) of complex numbers and their imaginary parts, (0, points) where all are zero, and
    `A M^-1 A^T` (2 points, 2 points).
    """
    weights = model.point_weights
    columns = weights.conj().T.toarray()
    both = np.stack([columns.real, columns.imag], axis=1).reshape(model.n, model.n_points)
    found = model.mass_inverse(both).reshape(model.n_nodes, 2, model.n_points)
    reach, across = (np.ascontiguousarray(found[:, axis]) for axis in range(2))
    return reach, across if across.any() else across[:0], on_pairs(weights @ (reach + 1j * across))
