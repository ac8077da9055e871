"""The step matrix of a scene for Python code: the factor in the frame of the nodal rotations (corotated.py) as a StepMatrix."""

import numpy as np

from polyida.assembly.border import border, border_workspace
from polyida.assembly.corotated import columns_together, condense_states, corotated, solve, solve_workspace
from polyida.assembly.equilibrium import combined, step_blocks, symmetric_parts
from polyida.assembly.own_laws import add_own_curvature
from polyida.assembly.strain_elimination import eliminate, recover
from polyida.linear.lu import SingularSystem
from polyida.linear.saddle import StepMatrix


class SceneStepMatrix(StepMatrix):
    """`S = c_m M + c_v C + K` of a scene, computed from q; C and K are those of zero velocity, and so symmetric.

    c_m and c_v are both real, or both complex: c^2 and c, the real part of c positive. corotated, workspace: the factor and its workspace, for
    compiled loops. solves: number of solves for the border.
    """

    backend = "multifrontal L D L^T"
    near_any_state, caution = True, 1.0

    def __init__(self, model):
        """Take the model of a scene, and count the solves for its border; nothing is factored yet."""
        super().__init__(model)
        self.solves, self.corotated = columns_together(model.once(border, of_shape=True)), None

    def factor(self, t, q, v, a, lam, c_m, c_v, parts=None):
        """Factor S at q. Force elements depend on t and v, the joints' curvature in `solve` on t and lam. Raises SingularSystem.

        parts: `symmetric_parts` at q, if they are known.
        """
        model, self.made_at, self.c_m, self.at = self.model, np.concatenate([[t], q, v, a, lam]), c_m, (t, lam)
        self.c_v = c_v
        parts = symmetric_parts(model, q, v) if parts is None and isinstance(c_v, complex) else parts
        blocks = step_blocks(model, q, v, c_m, c_v) if parts is None else combined(model, c_m, c_v, *parts)
        before, self.corotated = self.corotated, None
        self.corotated = corotated(model, blocks, model.rotation(q)[: model.n_factored], before)
        self.workspace = self.workspace if self.corotated is before else solve_workspace(model, self.corotated)
        if model.strains:
            self.workspace.elimination.rates[:] = (c_m / c_v, c_v) if c_v else np.inf
        if len(self.workspace.element_slopes):
            coupling, self.workspace.element_slopes[...] = model.arrays.links.coupling, 0.0
            add_own_curvature(model.laws, coupling, model.drives(t), model.dz(q), model.dz(v), 1.0, c_v, self.workspace.element_slopes)
            model.raise_error()
            condense_states(coupling, self.corotated, self.workspace.element_slopes)

    def beside(self, c_m, c_v, change):
        """The matrix with other c_m and c_v. C and M are those of zero velocity, not those of `change`."""
        other = type(self)(self.model)
        other.again(self.made_at, c_m, c_v)
        return other

    def stands_alone(self):
        """True: each node of a plate has mass."""
        return True

    def solve(self, q, b, transposed=False):
        """S^-1 b, or S^-T b, b (n,) or (n, k), in the frame of q; only users' forces are not symmetric. Raises SingularSystem."""
        free, own = self.corotated._replace(border=self.model.once(border, of_shape=True, multipliers=False)), self.workspace.element_slopes
        if transposed and len(own):
            own = np.ascontiguousarray(own[self.model.arrays.links.coupling.mirror].transpose(0, 2, 1))
        workspace = self.workspace._replace(
            element_slopes=own, border=border_workspace(self.model, free.border, self.workspace.point_forces.dtype)
        )
        return self._solved(free, workspace, *self.at, q, -b, np.zeros((0, *b.shape[1:])))[0]

    def saddle(self, t, q, lam, r, phi):
        """(dq, dlam) of `S dq + B^T dlam = -r`, `B dq = -phi`, S in the frame of q and B that of (t, q). Raises SingularSystem.

        r (n,) and phi (m,), or (n, k) and (m, k).
        """
        return self._solved(self.corotated, self.workspace, t, lam, q, r, phi)

    def _solved(self, factored, workspace, t, lam, q, r, phi):
        """(dq, dlam) of the bordered system for the columns of r and phi. Raises SingularSystem."""
        model, dtype = self.model, workspace.point_forces.dtype
        at = model.drives(t), model.rotation(q), model.dz(q), np.array(lam, float)
        strains = workspace.elimination, np.array(q, float).reshape(-1, 2)
        dq, dlam = np.empty(r.shape, dtype), np.empty(phi.shape, dtype)
        for k in np.ndindex(r.shape[1:]):
            right, below = np.array(r[:, *k], dtype).reshape(-1, 2), np.array(phi[:, *k], dtype)
            one, forces = np.empty(right.shape, dtype), np.empty(len(phi), dtype)
            right = eliminate(*strains, right) if model.strains else right
            workspace.keeps[0] = any(k)  # all columns have the same border
            regular = solve(model.arrays.links, factored, workspace, *at, right, below, self.c_m, one, forces)
            workspace.keeps[0] = 0
            if not regular:
                raise SingularSystem("the constraints' system is singular")
            if model.strains:
                recover(*strains, one)
            dq[:, *k], dlam[:, *k] = one.ravel(), forces
        return dq, dlam
