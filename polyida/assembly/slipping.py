"""Scenes in which friction slips: its forces, and their slopes in the multipliers that press, are in the kernels (`Slips` of arrays.py)."""

import numpy as np

from polyida.assembly.factors import OF_FACTORS
from polyida.assembly.kept_rows import slips_of
from polyida.assembly.scene_model import SceneModel
from polyida.model.row_laws import Slipping


class SlippingScene(Slipping, SceneModel):
    """A mode of a scene: a copy in which only some rows are equations, and rows of friction slip."""

    slipping = True

    @classmethod
    def of(cls, origin, rows, slips):
        """The mode of a scene. rows: numbers of the equations; slips: (RowLaw, sign of its rate) each."""
        mode = origin._copy({"pattern", "first_pairs", *OF_FACTORS})
        mode.__class__ = cls
        mode.use_slips(origin, slips)
        place = {int(row): k for k, row in enumerate(rows)}
        on = [np.array([place[row] for row in law.on if row in place], np.int64) for law, _ in slips]
        on_contact = [one and len(rows_on) > 0 for one, rows_on in zip(mode.on_contact, on)]
        slipping_rows = np.array(mode.slipping_rows)
        mode.keep_rows(rows, slips_of(origin.arrays.links, slipping_rows, mode.signed_constant, mode.signed_mu, on_contact, on))
        return mode

    def reaction_q(self, t, q, lam):
        """Return d(phi_q^T lam)/dq of all rows of the scene, (n, n), lam with the friction that rows of the mode cause."""
        return self.origin.reaction_q(t, q, self.forces_of_all(lam))
