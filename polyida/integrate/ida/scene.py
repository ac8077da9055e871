"""The table of a scene in a stabilised form: residuals and one co-rotated solve with a border (assembly/stabilised_border.py)."""

import numpy as np

from polyida import system as of
from polyida.assembly import joints
from polyida.assembly.stabilised_border import mass_columns, stabilised_workspace
from polyida.errors import DONE
from polyida.integrate.ida.forms import INSTANT
from polyida.integrate.radau.tables import scene as stages
from polyida.integrate.radau.tables.scene import DV, SceneStages, pairs, rows
from polyida.integrate.radau.tables.scene_factors import Solver
from polyida.jit import entry


@entry
def rate(w, instant, q, v, out, known, e, f):
    """phi_q v + phi_t at the q of the last residual; known: with its v."""
    vz = w.vz
    if not known:
        vz = w.points[DV]
        joints.point_values(w.scene.links, pairs(w, v), vz)
    joints.joint_rates(w.scene.links, w.drives[instant], w.dz[0], vz, w.spare, rows(w, out), w.spare)
    return DONE


FUNCTIONS = {number: stages.FUNCTIONS[number] for number in (of.REACTION, of.RESIDUAL, of.ROWS, of.INERTIA, of.REAL)} | {of.RATE: rate}


class SceneForm(SceneStages):
    """The table of a scene for IDA, with one factor that is filled anew in place."""

    def __init__(self, model, tableau):
        super().__init__(model, tableau, True)
        self.entries, self.step, self.solver = FUNCTIONS, model.step_matrix(), None

    def stand(self, t):
        """Set the time of the equations."""
        if self.model.profiles:
            self.w["drives"][INSTANT] = self.model.drives(t)

    def make(self, slot, h, made_at, counts):
        """Factor S at a state. Raises SingularSystem."""
        model, step, c, before = self.model, self.step, 1.0 / h, self.solver
        at = float(made_at[0]), *np.split(made_at[1:], np.cumsum([model.n] * 3))
        step.factor(*at, c * c, c)
        damping = model.force_v(*at[:2], np.zeros(model.n)) / c if model.damped else None
        in_place = before is not None and before.factored is step.corotated
        columns = mass_columns(model, step.corotated, damping, before.mass_columns if in_place else None)
        counts.backend = step.backend
        counts.solves += 2 * step.solves
        if in_place:
            before.c[0] = c
            return
        self.solver = Solver(np.array([c]), step.corotated, step.workspace, columns, stabilised_workspace(model))
        self.set_solvers(self.solver, None)
