"""Scenes in which friction slips: its forces, and their slopes in the multipliers that press, are in the kernels (`Slips` of arrays.py)."""

import numpy as np

from polyida.assembly.build import SlidingRow
from polyida.assembly.factors import OF_FACTORS
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
        place, sliding = {int(row): k for k, row in enumerate(rows)}, []
        for (law, sign), on_contact in zip(slips, mode.on_contact):
            on = [place[row] for row in law.on if row in place]
            sliding.append(SlidingRow(law.row, sign * law.constant, sign * law.mu, on_contact and bool(on), on))
        mode.keep_rows(np.asarray(rows).tolist(), sliding)
        return mode

    def reaction_q(self, t, q, lam):
        return self.origin.reaction_q(t, q, self.forces_of_all(lam))
