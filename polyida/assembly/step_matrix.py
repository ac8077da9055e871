"""The step matrix of a scene: the plates' factor in the frame of the nodal rotations, joints through their few points."""

import numpy as np

from polyida.assembly import corotated
from polyida.assembly.bodies.damping import combined, symmetric_blocks
from polyida.assembly.border import border, border_room
from polyida.assembly.own.laws import add_own_curvature
from polyida.linear.cholesky.factor import NotFactorable
from polyida.linear.lu import SingularSystem
from polyida.linear.step_matrix import StepMatrix


class SceneStepMatrix(StepMatrix):
    """`S = c_m M + c_v C + K` of a scene, C and K as if at rest and so symmetric; made from q alone (assembly/corotated.py).

    c_m and c_v are both real, or both complex: c^2 and c, the real part of c positive.
    corotated, room: the factor and its scratch, for compiled loops. solves: those that its border took.
    """

    near_any_state, caution = True, 1.0

    def __init__(self, model, linear="auto"):
        super().__init__(model)
        self.linear, self.solves, self.corotated = linear, corotated.columns_together(model.once(border, of_shape=True)), None

    def factor(self, t, q, v, a, lam, c_m, c_v, parts=None):
        """Factor S at q; t and v are for force elements, t and lam for the joints' curvature in `solve`. Raises SingularSystem.

        parts: `symmetric_parts` at q, for who wants several matrices there.
        """
        model, self.made_at, self.c_m, self.at = self.model, np.concatenate([[t], q, v, a, lam]), c_m, (t, lam)
        blocks = symmetric_blocks(model, q.reshape(-1, 2), c_m, c_v) if parts is None else combined(c_m, c_v, *parts)
        phase = abs(c_v) / c_v if np.iscomplexobj(blocks) else 1.0
        before, self.corotated = self.corotated, None
        try:
            self.corotated, self.backend = corotated.corotated(model, blocks, model.rotation(q), self.linear, phase, before)
        except NotFactorable as error:
            raise SingularSystem(str(error)) from None
        self.room = self.room if self.corotated is before else corotated.room(model, self.corotated)
        if model.laws is not None:
            coupling, self.room.own[...] = model.arrays.links.coupling, 0.0
            add_own_curvature(model.laws, coupling, model.drives(t), model.dz(q), model.dz(v), 1.0, c_v, self.room.own)

    def beside(self, c_m, c_v, change):
        """The same with other c_m and c_v, of C and M as if at rest: not those of change."""
        other = type(self)(self.model, self.linear)
        other.again(self.made_at, c_m, c_v)
        return other

    def stands_alone(self):
        """True: every node of a plate has mass."""
        return True

    def solve(self, q, b, transposed=False):
        """S^-1 b, or S^-T b, b (n,) or (n, k), in the frame of q; all of S but forces of one's own is symmetric. Raises SingularSystem."""
        free, own = self.corotated._replace(border=self.model.once(border_without_rows, of_shape=True)), self.room.own
        if transposed and len(own):
            own = np.ascontiguousarray(own[self.model.arrays.links.coupling.mirror].transpose(0, 2, 1))
        room = self.room._replace(own=own, border=border_room(self.model, free.border, self.room.pull.dtype))
        columns = [self._solved(free, room, *self.at, q, -column, np.zeros(0))[0] for column in np.reshape(b, (len(q), -1)).T]
        return np.stack(columns, axis=1).reshape(np.shape(b))

    def saddle(self, t, q, lam, r, phi):
        """(dq, dlam) of `S dq + B^T dlam = -r`, `B dq = -phi`, S in the frame of q and B that of (t, q). Raises SingularSystem."""
        return self._solved(self.corotated, self.room, t, lam, q, r, phi)

    def _solved(self, factored, room, t, lam, q, r, phi):
        model, dtype = self.model, room.pull.dtype
        dq, dlam = np.empty((model.n_nodes, 2), dtype), np.empty(len(phi), dtype)
        at = model.drives(t), model.rotation(q), model.dz(q), np.array(lam, float)
        r, phi = np.array(r, dtype).reshape(dq.shape), np.array(phi, dtype)
        if not corotated.solve(model.arrays.links, factored, room, *at, r, phi, self.c_m, dq, dlam):
            raise SingularSystem("the constraints' system is singular")
        return dq.ravel(), dlam


def border_without_rows(model):
    """The Border of a scene for S alone."""
    return border(model, rows=False)
