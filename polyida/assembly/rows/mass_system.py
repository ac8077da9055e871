"""`[[M, B^T], [B, 0]]` of a scene, B = phi_q: joints act through few points, whose columns of M^-1 are made once a model."""

import numpy as np

from polyida.assembly.rows import joints
from polyida.assembly.rows.tie import project, tie
from polyida.jit import entry


class MassSystem:
    """The system at (t, q); `solve` any number of right-hand sides."""

    def __init__(self, model, t, q):
        self.model, self.tie = model, tie(model)
        joints.joint_jacobian(model.arrays.links, model.drives(t), model.dz(q), self.tie.slopes)

    def solve(self, r, phi):
        """(dq, dlam) for the residuals r (n,) and phi (m,): `M dq + B^T dlam = -r`, `B dq = -phi`. Raises LinAlgError."""
        y = -self.model.mass_inverse(r) if r.any() else np.zeros(self.model.n)
        if not phi.size:
            return y, np.zeros(0)
        dlam = np.empty(len(phi))
        if not constrained(self.model.arrays.links, self.tie, np.array(phi, float), y.reshape(-1, 2), dlam):
            raise np.linalg.LinAlgError("the constraints' system is singular")
        return y, dlam


@entry
def constrained(s, t, phi, y, dlam):
    """y -= M^-1 B^T dlam with `B y = -phi` then. False where that is singular."""
    joints.point_values(s, y, t.vz)
    for k in range(phi.shape[0]):
        t.bias[k] = phi[k] + joints.along(s, t.slopes, k, t.vz)
    good = project(s, t, t.bias, y)
    for k in range(phi.shape[0]):
        dlam[k] = t.eta[k]
    return good
