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
index2) or h^-1 (the others), cj = 1/h; scaled, it is flat. Source: as linear/kkt.py's, for the unknowns of index 2.
"""

from contextlib import suppress

import numpy as np

from polyida.integrate.ida.linear import Correction
from polyida.linear import whole
from polyida.linear.lu import SingularSystem

SCALINGS = ("characteristic", "none")


def sizes(scaling, form, n, m, cj, s):
    """Factors (of rows, of columns), (N,) each, of a scaling; n coordinates, m constraints, s the typical size of S."""
    if scaling == "none":
        return whole.raw(n, m, form.stabilised)
    kinds = (max(form.rows),) if form.combined else form.rows
    return whole.sizes(cj, s, n, m, kinds, form.stabilised, 1 / cj if form.integrated else 1.0)


def whole_matrix(system, t, y, yp, cj):
    """(J, typical size s of S) at (t, y, y'): CSC where the model's matrices are sparse, dense otherwise."""
    D, (B, P, Q) = system.slope(t, y, yp, cj), system.rows(t, y, yp, cj)
    K = system.model.tangent(*system.at(t, y, yp), 0.0, 0.0, 1.0)
    columns = (cj if system.form.integrated else 1.0) * B.T
    return whole.joined(cj, K, D, columns, columns if system.form.stabilised else None, P, Q), whole.typical(cj, K, D)


class WholeSolve(Correction):
    """IDA's correction by one LU of the scaled whole matrix."""

    def __init__(self, system, counts, order, scaling):
        super().__init__(system, counts, order)
        self.scaling = scaling

    def setup(self, t, y, yp, cj):
        """Evaluate, scale and factor J at (t, y, y')."""
        self.cj, model = cj, self.system.model
        J, s = whole_matrix(self.system, t, y, yp, cj)
        self.counts.tangents += 1
        self.counts.factorizations += 1
        self.lu = None
        with suppress(SingularSystem):
            self.lu = whole.ScaledLU(J, *sizes(self.scaling, self.system.form, model.n, model.m, cj, s))

    def reduced(self, t, y, yp, r, z):
        """z = J^-1 r; nan, for which IDA tries a smaller step, where J is singular."""
        z[:] = self.lu.solve(r) if self.lu else np.nan
