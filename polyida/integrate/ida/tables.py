"""The tables and iteration matrices of IDA: tables of Radau IIA for one stage and a real mode (integrate/radau/tables) with rows of IDA's forms.

`linear`: "auto" takes compiled code for a scene in a stabilised form and for a user's small model; "kkt" any model's step matrix with a
border; "whole" one matrix for everything,

    |  cj I     -I               B^T |  |dq  |   |r1|
    |  K      cj M + C   B^T         |  |dv  | = |r2|     P = c_q,  Q = c_v + cj c_a
    |  P         Q                   |  |dlam|   |rc|
                                        |dmu |

| scaling | unknowns measured in | rows measured in |
|---|---|---|
| none | 1 | 1 |
| characteristic | dv: cj, dlam: s, dmu: cj, integrated multipliers: another 1/cj | q': cj, r: s, k-th derivative of phi: cj^k |

s is the mean size of the diagonal of `S = K + cj C + cj^2 M`. Unscaled, the condition number grows as h^-3 (index3), h^-2 (ggl2, index2) or
h^-1 (the others), cj = 1/h; scaled, it is bounded. Source: as linear/saddle.py's, for the unknowns of index 2.
"""

from functools import partial

import numpy as np

from polyida import system as of
from polyida.assembly.rate_multipliers import slowing
from polyida.integrate.ida.forms import INSTANT
from polyida.integrate.radau import matrices
from polyida.integrate.radau.matrices import Matrices, WholeModes
from polyida.integrate.radau.tableau import Mode, Tableau
from polyida.integrate.radau.tables.python import DenseStages, PythonStages
from polyida.integrate.radau.tables.scene import SceneStages
from polyida.linear.lu import dense, first_order_sizes
from polyida.linear.saddle import MANY
from polyida.model.differences import bend, reach_along
from polyida.system import BIAS
from polyida.system.own import small_own
from polyida.system.scene import entries
from polyida.system.scene_factors import Factor

SCALINGS = ("characteristic", "none")
HEAVY = 1e4  # mass at a point over a plate's, above which a scene takes the Python callbacks in double precision
ONE = np.ones(1)
EULER = Tableau(ONE, ONE[None], ONE[None], (Mode(1.0, ONE, ONE),), -ONE)


class FormRows:
    """The rows of a System at a state, like radau/matrices.py's Rows: on_q = P, on_v = Q, both = P + cj Q; B: phi_q if it is known."""

    def __init__(self, system, cj, t, q, v, a, lam, B=None):
        """Evaluate B and, if the form has derivatives of phi, its first and second derivative along the motion (t, q, v, a)."""
        model, self.tied = system.model, system.form.stabilised
        self.B = B = dense(model.phi_q(t, q)) if B is None else B
        self.columns, self.G, m = matrices.columns_at(model, t, q, lam, B), B if self.tied else B[:0], len(B)
        H = N = np.zeros_like(B)
        if (model.needs.phi_q_varies or model.needs.driven) and system.levels[:, 1:].any():
            H, N = bend(lambda s: dense(model.phi_q(t + s, q + s * v + s * s / 2 * a)), B, reach_along(q, v))
        self.on_q, self.on_v = np.zeros((2, len(system.levels) * m, model.n))
        for k, order in zip(*np.nonzero(system.levels)):
            weight, at = system.levels[k, order], slice(k * m, (k + 1) * m)
            self.on_q[at] += weight * (B, H, N)[order]
            if order:
                self.on_v[at] += weight * (B if order == 1 else 2 * H + cj * B)
        self.both = self.on_q + cj * self.on_v

    def below(self, c, *rows):
        """The right-hand sides of the rows on dq."""
        return -np.concatenate(rows)

    def corner(self):
        """The block of the multipliers in the rows."""
        corner = np.zeros((len(self.both), len(self.both)))
        corner[:, len(self.B) :] = self.on_v @ self.G.T
        return corner


def sizes(scaling, form, n, m, cj, s):
    """Factors (of rows, of columns), (N,) each, of a scaling; n coordinates, m constraints, s the typical size of S."""
    cj, s = (1.0, 1.0) if scaling == "none" else (cj, s)
    orders = (max(form.rows),) if form.combined else form.rows
    return first_order_sizes(cj, s, n, m, orders, form.stabilised, 1 / cj if form.integrated else 1.0)


def whole_matrix(system, t, y, yp, cj):
    """(J, typical size s of S) at (t, y, y'): CSC if the model's matrices are sparse, else dense."""
    t, q, v, a, lam = system.at(t, y, yp)
    model, D = system.model, cj * system.model.mass(q)
    if model.needs.velocity_forces:
        D = D + model.force_v(t, q, v)
    K = model.tangent(t, q, v, a, lam, 0.0, 0.0, 1.0)
    rows, unit = FormRows(system, cj, t, q, v, a, lam), cj if system.form.integrated else 1.0
    rows.columns, rows.G = unit * rows.columns, unit * rows.G
    return matrices.whole_matrix(cj, K, D, rows)


class WholeForm(WholeModes):
    """WholeModes of a System's rows; its unknowns are the multipliers themselves."""

    def __init__(self, model, modes, h, made_at, system, scaling):
        """Take the System whose constraint rows are solved, and the scaling of the whole matrix."""
        super().__init__(model, modes, h, made_at, scaling)
        self.system = system

    def _sizes(self, c, s):
        """Factors (of rows, of columns) of the whole matrix; multipliers are not integrated here."""
        n, form = self.model.n, self.system.form
        rows, columns = sizes(self.scaling, form, n, self.model.m, c, s)
        columns[2 * n :] *= c if form.integrated else 1.0
        return rows, columns


class PythonForm(PythonStages):
    """The table of any model."""

    def __init__(self, system, kind):
        """Take the System; kind: function (model, modes, h, made_at) that makes its Matrices."""
        self.system = system
        super().__init__(system.model, EULER, system.form.stabilised, kind)

    def _entries(self):
        """{number of an entry: method} of the table, with BIAS for the second derivative of phi."""
        return super()._entries() | {BIAS: self._bias}

    def stand(self, t):
        """Set the time of the equations."""
        self.times[:] = t

    def _bias(self, instant, q, v, a, bias, *_):
        """Write the second derivative of phi, `B a + phi_bias`, with B of the last REACTION."""
        model, at = self.model, self._state(instant, q)
        v, a = (self._array(x, model.n).copy() for x in (v, a))
        self._array(bias, model.m)[:] = self.B[0] @ a + model.phi_bias(*at, v)

    def _made_rows(self, t, q, v, a):
        """The FormRows at a state; a: address of the accelerations. B is that of the last REACTION if derivatives of phi are rows."""
        B = self.B[0] if self.system.levels[:, 1:].any() else None
        at = t, q, v, self._array(a, self.model.n).copy(), self.factored.lam
        return FormRows(self.system, self.factored.c[0], *at, B)


OF_FORMS = of.REACTION, of.RESIDUAL, of.ROWS, of.RATE, of.INERTIA, of.REAL


class SceneForm(SceneStages):
    """The table of a scene in a stabilised form: residuals and one co-rotated solve with a border; one factor that is filled anew in place."""

    def __init__(self, model, tableau):
        """Take the model of a scene and a tableau of one stage; choose the entries and make the step matrix."""
        super().__init__(model, tableau, True)
        self.entries, self.step = entries(*OF_FORMS), model.step_matrix()

    def stand(self, t):
        """Set the time of the equations."""
        if self.model.profiles:
            self.w["drives"][INSTANT] = self.model.drives(t)

    def make(self, slot, h, made_at, counts):
        """Factor S at a state. Raises SingularSystem."""
        model, step, c, before = self.model, self.step, 1.0 / h, self.work and self.work.real
        at = float(made_at[0]), *np.split(made_at[1:], np.cumsum([model.n] * 3))
        step.factor(*at, c * c, c)
        counts.backend = step.backend
        counts.solves += step.solves
        if before is not None and before.factored is step.corotated:
            before.c[:], before.slowing[...] = (c * c, c), slowing(model, *at[:2])
            return
        self.set_factors(real=Factor(np.array([c * c, c]), step.corotated, step.workspace, slowing(model, *at[:2])))


def table_of(system, linear, scaling):
    """(the table of a System, True if its rows are evaluated in every iteration)."""
    model, form = system.model, system.form
    renews = system.rows_vary and max(form.rows) < 2  # phi'' is too expensive to evaluate anew in each iteration
    if model.compiled and form.stabilised and linear == "auto" and not system.exact:
        heaviest = model.arrays.links.point_mass.max(initial=0.0)
        if not heaviest > HEAVY * model.lightest:  # else the border is lost in the single precision of the factor
            return SceneForm(model, EULER), True
    if linear == "auto" and small_own(model):
        return DenseStages(model, EULER, system.levels), renews
    if linear == "whole":
        return PythonForm(system, partial(WholeForm, system=system, scaling=scaling)), False
    own = linear == "auto" and not model.is_scene  # the step matrix of a user's model; that of a scene is of single precision
    return PythonForm(system, Matrices if own else partial(Matrices, linear="kkt")), renews and model.m <= MANY
