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

from polyida.integrate.ida.linear import EchoedSolve
from polyida.linear.condition import scaled
from polyida.linear.lu import LU, SingularSystem
from polyida.linear.matrix import dense

SCALINGS = ("characteristic", "none")


def sizes(scaling, form, n, m, cj, s):
    """Factors (of rows, of columns), (N,) each, of a scaling; n coordinates, m constraints, s the typical size of S."""
    if scaling == "none":
        raw = np.ones(2 * n + m * (2 if form.stabilised else 1))
        return raw, raw
    unit = 1 / cj if form.integrated else 1.0
    kinds = (max(form.rows),) if form.combined else form.rows
    rows = [np.full(n, 1 / cj), np.full(n, 1 / s)] + [np.full(m, cj**-k) for k in kinds]
    columns = [np.ones(n), np.full(n, cj), np.full(m, s * unit)] + [np.full(m, cj * unit)] * form.stabilised
    return np.concatenate(rows), np.concatenate(columns)


def whole_matrix(system, t, y, yp, cj):
    """(J, typical size s of S) at (t, y, y'): CSC where the model's matrices are sparse, dense otherwise."""
    blocks = system.blocks(t, y, yp)
    K = system.model.tangent(*system.at(t, y, yp), 0.0, 0.0, 1.0)
    damping = cj * blocks.M if blocks.C is None else cj * blocks.M + blocks.C
    s = float(np.mean(np.abs(K.diagonal() + cj * damping.diagonal())))
    unit = cj if blocks.integrated else 1.0
    return _joined(blocks, K, damping, cj, unit * blocks.B.T), s if s > 0 else 1.0


def _joined(blocks, K, damping, cj, B_T):
    n, m = blocks.n, blocks.m
    Q = blocks.Q0 + cj * blocks.Q1
    if hasattr(K, "tocsc"):
        from scipy.sparse import block_array, csr_array, eye_array

        lam, mu, below = csr_array(B_T), csr_array(B_T), (csr_array(blocks.P), csr_array(Q))
        first, second = [cj * eye_array(n), -eye_array(n)], [K, csr_array(damping)]
        if not m:
            return block_array([first, second], format="csc")
        if not blocks.stabilised:
            return block_array([[*first, None], [*second, lam], [*below, None]], format="csc")
        return block_array([[*first, None, mu], [*second, lam, None], [*below, None, None]], format="csc")
    columns = (2 if blocks.stabilised else 1) * m
    J = np.zeros((2 * n + columns, 2 * n + columns))
    J[:n, :n], J[:n, n : 2 * n] = cj * np.eye(n), -np.eye(n)
    J[n : 2 * n, :n], J[n : 2 * n, n : 2 * n], J[n : 2 * n, 2 * n : 2 * n + m] = K, dense(damping), B_T
    J[:n, 2 * n + m :] = B_T[:, : columns - m]
    J[2 * n :, :n], J[2 * n :, n : 2 * n] = blocks.P, Q
    return J


class WholeSolve(EchoedSolve):
    """IDA's linear callbacks by one LU of the scaled whole matrix, with partial pivoting: LAPACK's or, sparse, SuperLU's."""

    def __init__(self, system, counts, scaling):
        super().__init__(system, counts)
        self.scaling = scaling

    def setup(self, t, y, yp, res, cj):
        """Evaluate, scale and factor J at (t, y, y')."""
        self.cj, model = cj, self.system.model
        J, s = whole_matrix(self.system, t, y, yp, cj)
        self.rows, self.columns = sizes(self.scaling, self.system.form, model.n, model.m, cj, s)
        self.counts.tangents += 1
        self.counts.factorizations += 1
        self.lu = None
        with suppress(SingularSystem):
            self.lu = LU(scaled(J, self.rows, self.columns), pivoting=True)

    def reduced(self, t, y, yp, r, z):
        """z = J^-1 r; nan, for which IDA tries a smaller step, where J is singular."""
        z[:] = self.columns * self.lu.solve(self.rows * r) if self.lu else np.nan
