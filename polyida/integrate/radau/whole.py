"""The system of one mode of Radau IIA as a whole, its rows and columns divided by characteristic sizes or raw.

c = l/h, l an eigenvalue of `W = A^-1`, real or complex (radau/tableau.py), `G = B D^-1`, `H = d(B v + phi_t)/dq` (radau/matrices.py):

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

from polyida.linear import whole

NOTHING = 1e-12  # of the largest mass: none


def lift(shares):
    """D^-1 (n,), D the diagonal of M over its mean, from the coordinates' shares in the mass; those without mass count as any."""
    heavy = shares > NOTHING * shares.max()
    return np.where(heavy, 1.0 / (len(shares) * np.where(heavy, shares, 1.0)), 1.0)


def whole_matrix(c, K, M, C, rows):
    """(the matrix, typical size s of S) of K, M, C, or None for none, and the constraints' Rows: CSC where K is sparse, else dense."""
    slope, level = c * M if C is None else c * M + C, np.zeros_like(rows.B)
    on_v, mu = (np.vstack([level, rows.B]), rows.G.T) if rows.tied else (level, None)
    return whole.joined(c, K, slope, rows.B.T, mu, rows.both, on_v), whole.typical(c, K, slope)


def sizes(scaling, c, s, n, m, tied):
    """Factors (of rows, of columns), (N,) each, of a scaling; tied: whether there is mu."""
    if scaling == "none":
        return whole.raw(n, m, tied)
    size = abs(c)
    return whole.sizes(size, s if scaling == "physical" else size**2, n, m, (0, 1) if tied else (0,), tied)
