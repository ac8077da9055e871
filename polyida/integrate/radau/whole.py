"""The system of one mode of Radau IIA as a whole, its rows and columns divided by characteristic sizes or raw.

c = l/h, l an eigenvalue of `W = A^-1`, real or complex (radau/tableau.py), `G = B D^-1`, `H = d(B v + phi_t)/dq` (radau/step.py):

    |  c I    -I             G^T |  |dq  |     q' - v + G^T mu
    |  K     c M + C   B^T       |  |dv  |     M v' + g + B^T lam
    |  B                         |  |dlam|     phi
    |  H      B                  |  |dmu |     B v + phi_t

| scaling | unknowns measured in | rows measured in |
|---|---|---|
| none | 1 | 1 |
| bottasso | dv: c, dlam: c^2, dmu: c | q': c, r: c^2, B v + phi_t: c |
| physical | dv: c, dlam: s, dmu: c | q': c, r: s, B v + phi_t: c |

with |c| for c, s the mean size of the diagonal of `S = K + c C + c^2 M`. Form "index3" has neither dmu nor the last row. Raw, the condition
number grows as h^-3 (index3) or h^-2 (ggl) where h is small; scaled, it is flat. Sources: as linear/kkt.py's.
"""

import numpy as np

from polyida.integrate.radau.matrices import Matrices
from polyida.linear import whole


def whole_matrix(c, K, slope, rows):
    """(the matrix, typical size s of S) of K, slope = c M + C and the constraints' Rows: CSC where K is sparse, else dense."""
    level = np.zeros_like(rows.B)
    on_v, mu = (np.vstack([level, rows.B]), rows.G.T) if rows.tied else (level, None)
    return whole.joined(c, K, slope, rows.B.T, mu, rows.both, on_v), whole.typical(c, K, slope)


def sizes(scaling, c, s, n, m, tied):
    """Factors (of rows, of columns), (N,) each, of a scaling; tied: whether there is mu."""
    if scaling == "none":
        return whole.raw(n, m, tied)
    size = abs(c)
    return whole.sizes(size, s if scaling == "physical" else size**2, n, m, (0, 1) if tied else (0,), tied)


class WholeModes(Matrices):
    """The Matrices of a step by one factor of each mode's whole matrix; K, M and C are of where they are made, the rows those given."""

    def __init__(self, model, modes, h, made_at, scaling):
        super().__init__(model, modes, h, made_at)
        self.scaling, self.K = scaling, None

    def make(self):
        """Evaluate, where it is not done."""
        if self.K is None:
            self.K = self.model.tangent(*self._evaluated(), 0.0, 0.0, 1.0)

    def surround(self, rows, counts):
        """Take the constraints' rows, and with them the factors when they are first used."""
        counts.factorizations += len(self.modes)
        self.rows, self.borders = rows, [None] * len(self.modes)

    def corrections(self, k, r, r3, r4):
        """As of Matrices."""
        n, m = self.model.n, self.model.m
        x = -self._whole(k, r, r3, r4)
        return x[:n], x[2 * n : 2 * n + m], x[2 * n + m :]

    def _whole(self, k, *below):
        """The solution with no right-hand side of q', which v follows as it is. Raises SingularSystem."""
        n, m = self.model.n, self.model.m
        if self.borders[k] is None:
            matrix, s = whole_matrix(self.c[k], self.K, self.slopes[k], self.rows)
            self.borders[k] = whole.ScaledLU(matrix, *sizes(self.scaling, self.c[k], s, n, m, self.rows.tied))
        return self.borders[k].solve(np.concatenate([np.zeros(n), *below]))
