"""IDA's iteration matrix as a whole, factored in one piece, its rows and columns divided by characteristic sizes or raw.

    |  cj I     -I               B^T |  |dq  |   |r1|
    |  K      cj M + C   B^T         |  |dv  | = |r2|     P = c_q,  Q = c_v + cj c_a
    |  P         Q                   |  |dlam|   |rc|
                                        |dmu |

| scaling | unknowns measured in | rows measured in |
|---|---|---|
| none | 1 | 1 |
| characteristic | dv: cj, dlam: s, dmu: cj, integrated multipliers: another 1/cj | q': cj, r: s, k-th derivative of phi: cj^k |

s is the mean size of the diagonal of `S = K + cj C + cj^2 M`. Raw, the condition number grows as h^-3 (index3), h^-2 (ggl2,
index2) or h^-1 (the others), cj = 1/h; scaled, it is flat. Source: as linear/saddle.py's, for the unknowns of index 2.
"""

import numpy as np

from polyida.integrate.radau import matrices
from polyida.integrate.radau.matrices import WholeModes
from polyida.linear.lu import dense, first_order_sizes, first_order_units
from polyida.model.differences import bend, reach_along

SCALINGS = ("characteristic", "none")


class FormRows:
    """The rows of a System (integrate/ida/forms.py) at a state, as radau/matrices.py's Rows: on_q = P, on_v = Q, both = P + cj Q.

    B: phi_q there, or None where it is to be asked for.
    """

    def __init__(self, system, cj, t, q, v, a, B=None):
        model, self.tied = system.model, system.form.stabilised
        self.B = B = dense(model.phi_q(t, q)) if B is None else B
        self.G, m = B if self.tied else B[:0], len(B)
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
        """What the multipliers add to the rows."""
        corner = np.zeros((len(self.both), len(self.both)))
        corner[:, len(self.B) :] = self.on_v @ self.G.T
        return corner


def sizes(scaling, form, n, m, cj, s):
    """Factors (of rows, of columns), (N,) each, of a scaling; n coordinates, m constraints, s the typical size of S."""
    if scaling == "none":
        return first_order_units(n, m, form.stabilised)
    kinds = (max(form.rows),) if form.combined else form.rows
    return first_order_sizes(cj, s, n, m, kinds, form.stabilised, 1 / cj if form.integrated else 1.0)


def whole_matrix(system, t, y, yp, cj):
    """(J, typical size s of S) at (t, y, y'): CSC where the model's matrices are sparse, dense otherwise."""
    t, q, v, a, lam = system.at(t, y, yp)
    model, D = system.model, cj * system.model.mass(q)
    if model.needs.velocity_forces:
        D = D + model.force_v(t, q, v)
    K = model.tangent(t, q, v, a, lam, 0.0, 0.0, 1.0)
    rows = FormRows(system, cj, t, q, v, a)
    rows.B, rows.G = unit(system, cj) * rows.B, unit(system, cj) * rows.G
    return matrices.whole_matrix(cj, K, D, rows)


def unit(system, cj):
    """What multipliers are over the unknowns: these may be the integrals."""
    return cj if system.form.integrated else 1.0


class WholeForm(WholeModes):
    """WholeModes of a System's rows; its unknowns are the multipliers themselves."""

    def __init__(self, model, modes, h, made_at, system, scaling):
        super().__init__(model, modes, h, made_at, scaling)
        self.system = system

    def _sizes(self, c, s):
        n, m, system = self.model.n, self.model.m, self.system
        rows, columns = sizes(self.scaling, system.form, n, m, c, s)
        columns[2 * n :] *= unit(system, c)
        return rows, columns
