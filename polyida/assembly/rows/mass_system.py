"""`[[M, B^T], [B, 0]]` of a scene, B = phi_q: joints act through few points, whose columns of M^-1 are made once a model."""

import numpy as np


class MassSystem:
    """The system at (t, q); `solve` any number of right-hand sides."""

    def __init__(self, model, t, q):
        self.model, self.n = model, model.n
        self._reach, g = model.once(point_columns)
        self._border = model.phi_z(t, q)
        self._schur = sum(self._border[:, axis::2] @ g @ self._border[:, axis::2].T for axis in range(2))

    def solve(self, r, phi):
        """(dq, dlam) for the residuals r (n,) and phi (m,): `M dq + B^T dlam = -r`, `B dq = -phi`."""
        y = -self.model.mass_inverse(r) if r.any() else np.zeros(self.n)
        if not phi.size:
            return y, np.zeros(0)
        dlam = np.linalg.solve(self._schur, self._border @ self.model.dz(y).ravel() + phi)
        pull = (dlam @ self._border).reshape(-1, 2)
        return y - (self._reach @ pull).ravel(), dlam


def at_rest(model):
    """The MassSystem of a scene without motors, always the same."""
    return MassSystem(model, 0.0, np.zeros(model.n))


def point_columns(model):
    """`M^-1 A^T` (nodes, points) and `A M^-1 A^T` (points, points) of one direction; the other's are the same."""
    points, s = model.n_points, model.arrays.links
    both, parts = np.zeros((model.n_nodes, 2, points)), list(zip(s.point_ptr[:-1], s.point_ptr[1:]))
    for f, (a, b) in enumerate(parts):
        both[s.point_nodes[a:b], 0, f] = s.point_weights[a:b]
    reach = np.ascontiguousarray(model.mass_inverse(both.reshape(model.n, points)).reshape(both.shape)[:, 0])
    g = np.array([s.point_weights[a:b] @ reach[s.point_nodes[a:b]] for a, b in parts]).reshape(points, points)
    return reach, g
