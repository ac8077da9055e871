"""The transposed equations of a compiled scene's stages: its products without matrices, and few factors that refine."""

import numpy as np

from polyida.adjoint.radau.equations import Linearised, Multipliers
from polyida.adjoint.radau.modes import Modes
from polyida.adjoint.scene.products import products_at
from polyida.linear.lu import Kept, SingularSystem, dense
from polyida.linear.refined import ENOUGH, LEFT, SLOW

MOST = 25  # corrections with one pair of factors


class SceneLinearised(Linearised):
    """Of a compiled scene; linear: what factors its step matrices."""

    def __init__(self, model, tableau, lift, tied, counts, linear):
        super().__init__(model, tableau, lift, tied, counts)
        self.linear, self.kept = linear, Kept()

    def at(self, stages):
        """Take a step's stages, their constraints' rows and nodal rotations."""
        self.stages, self.h = stages, stages.h
        self._take_rows()
        self.B = [dense(B) for B in self.B]
        if self.tied:
            self.H = [dense(H) for H in self.H]
        self.drives = [self.model.drives(t) for t in stages.t.tolist()]
        raw = np.array([self.model.rotation(q) for q in stages.q]).view(complex)[..., 0]
        frames = raw / np.abs(raw)
        self.turns = frames[self.tableau.middle] * frames.conj()

    def back(self, b_q, b_v):
        """As of Linearised: exact by refinement, or by that one's factor where this does not converge."""
        key = f"{self.h:.9e}"
        found = self._refined(self.kept.take(key), b_q, b_v)
        if found is None:
            self.kept.keep(key, self._factored())
            found = self._refined(self.kept.take(key), b_q, b_v)
        if found is not None:
            return found
        self._take_forces()
        return super().back(b_q, b_v)

    def _factored(self):
        x, k = self.stages, self.tableau.middle
        try:
            at = float(x.t[k]), x.q[k], x.v[k], x.a[k], x.lam[k]
            return Modes(self.model, self.tableau, self.h, at, self.linear, self.counts)
        except SingularSystem:
            return None

    def _refined(self, modes, b_q, b_v):
        """The Multipliers, or None where there are no factors or they are too old."""
        if modes is None:
            return None
        modes.surround(*self._middle(modes))
        found, last = self._none(), np.inf
        for _ in range(MOST):
            change = modes.solve(*self._left(found, b_q, b_v)[1])
            found = [part - more for part, more in zip(found, change)]
            moved, size = np.linalg.norm(change[0]), np.linalg.norm(found[0])
            rate = moved / last
            ahead = rate / (1.0 - rate) if 0.0 < rate < 0.5 else 1.0
            if moved * ahead <= ENOUGH * size:
                return Multipliers(*found, *self._left(found, b_q, b_v)[0])
            if rate > SLOW:
                break
            last = moved
        return Multipliers(*found, *self._left(found, b_q, b_v)[0]) if moved <= LEFT * size else None

    def _middle(self, modes):
        """What the factors take of a step: q, turns, B, and with mu H and c M + C."""
        x, k = self.stages, self.tableau.middle
        if not self.tied:
            return x.q[k], self.turns, self.B[k], None, None
        M = self.model.mass(x.q[k])
        C = self.model.force_v(x.t[k], x.q[k], x.v[k]) if self.model.needs.velocity_forces else 0.0 * M
        return x.q[k], self.turns, self.B[k], self.H[k], [c * M + C for c in modes.c]

    def _pulled(self, w, mu):
        found = [np.zeros_like(w), np.zeros_like(w), np.zeros_like(w), np.zeros_like(mu)]
        for k, state in enumerate(zip(self.drives, self.stages.q, self.stages.v, self.stages.lam, w, mu)):
            x = products_at(self.model, *state)
            for part, made in zip(found, (x.stiff, x.slowing, x.heavy, x.rows)):
                part[k] = made.ravel() if made.size else 0.0
        return found
