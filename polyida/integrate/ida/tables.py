"""The tables of IDA: those of Radau IIA for one stage and a real mode (integrate/radau/tables), with the rows of IDA's forms.

`linear`: "auto" takes compiled code, of a scene in a stabilised form and of a small model of a user's own; "kkt" any model's step matrix with
a border; "whole" one matrix for everything (integrate/ida/whole.py).
"""

from functools import partial

import numpy as np

from polyida.integrate.ida.whole import FormRows, WholeForm
from polyida.integrate.radau.matrices import Matrices
from polyida.integrate.radau.tableau import Mode, Tableau
from polyida.integrate.radau.tables.python import PythonStages, dense_table
from polyida.linear.step_matrix import MANY
from polyida.system import BIAS
from polyida.system.python import small_own

HEAVY = 1e4  # mass at a point over a plate's, above which a scene takes the general callbacks in double precision
ONE = np.ones(1)
EULER = Tableau(ONE, ONE[None], ONE[None], (Mode(1.0, ONE, ONE),), -ONE)


class PythonForm(PythonStages):
    """The table of any model."""

    def __init__(self, system, kind):
        self.system = system
        super().__init__(system.model, EULER, system.form.stabilised, kind)
        self.functions[BIAS] = self._address(self._bias)

    def stand(self, t):
        """The equations are asked for at t."""
        self.at = [t, t]

    def _bias(self, instant, q, v, a, found, *_):
        model, at = self.model, self._state(instant, q)
        v, a = (self._array(x, model.n).copy() for x in (v, a))
        self._array(found, model.m)[:] = self.B[0] @ a + model.phi_bias(*at, v)

    def _made_rows(self, t, q, v, a):
        B = self.B[0] if self.system.levels[:, 1:].any() else None
        return FormRows(self.system, self.factored.c[0], t, q, v, self._array(a, self.model.n).copy(), B)


def table_of(system, linear, scaling):
    """(the table of a System, whether its rows are made anew for every iterate)."""
    model, form = system.model, system.form
    if model.compiled and form.stabilised and linear == "auto" and not _top_heavy(model):
        from polyida.integrate.ida.scene import SceneForm

        return SceneForm(model, EULER), True
    if linear == "auto" and small_own(model):
        return dense_table(model, EULER, system.levels), system.rows_vary
    if linear == "whole":
        return PythonForm(system, partial(WholeForm, system=system, scaling=scaling)), False
    return PythonForm(system, partial(Matrices, linear="kkt")), system.rows_vary and model.m <= MANY


def _top_heavy(model):
    """Whether a mass at a point is so far above its bodies' that the border drowns in the single precision of their factor."""
    return model.arrays.links.point_mass.max(initial=0.0) > HEAVY * model.lightest
