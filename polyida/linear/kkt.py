"""The saddle-point system of one Newton step, dense or sparse, scaled on request.

```
[ S    B^T ] [ dq   ]     [ r   ]
[ B    0   ] [ dlam ] = - [ phi ]        S = c_m M + c_v C + c_q K,  B = phi_q
```
"""

from dataclasses import dataclass

import numpy as np

from polyida.errors import InputError
from polyida.linear.independence import MOST, coordinate_sizes, involved, least, rows_of
from polyida.linear.lu import LU, block_matrix

DEPENDENT = 1e-6  # smallest singular value of the rows of phi_q, made of length one, below which they are
SCALINGS = ("none", "bottasso", "physical")


@dataclass(frozen=True)
class Scaling:
    """Row and column factors of the system: rows of r by `row`, multipliers by `column`; phi and q keep theirs.

    Bottasso, Dopico, Trainelli 2008: row = beta h^2, column = 1/(beta h^2). Physical (Bauchau, Epple, Bottasso 2009): both
    divided by, and multiplied with, s = m_r + gamma h d_r + beta h^2 k_r, of typical mass, damping and stiffness.
    """

    row: float = 1.0
    column: float = 1.0


def scaling_factors(kind, step_square, tangent):
    """Scaling of a kind for beta h^2 = `step_square`; beta h^2 S has the typical size s, the mean of its diagonal."""
    if kind == "none":
        return Scaling()
    if kind == "bottasso":
        return Scaling(step_square, 1.0 / step_square)
    size = step_square * float(np.mean(np.abs(tangent.diagonal())))
    return Scaling(step_square / size, size / step_square) if size > 0 else Scaling()


def assemble(tangent, phi_q, scaling=Scaling(), pull=None):
    """The scaled matrix, (n + m, n + m): dense where S is dense, CSC otherwise. pull: B of the upper right block, where it is another."""
    pull = phi_q if pull is None else pull
    return block_matrix([[scaling.row * tangent, scaling.row * scaling.column * pull.T], [phi_q, None]])


class KKT:
    """A factorization of the system; `solve` any number of right-hand sides. Raises SingularSystem."""

    def __init__(self, tangent, phi_q, scaling=Scaling(), pull=None):
        self.n, self.scaling = tangent.shape[0], scaling
        self.lu = LU(assemble(tangent, phi_q, scaling, pull), pivoting=True)

    def solve(self, r, phi):
        """(dq, dlam) for the residuals r (n,) and phi (m,)."""
        x = self.lu.solve(-np.concatenate([self.scaling.row * r, phi]))
        return x[: self.n], self.scaling.column * x[self.n :]

    def adjoint(self, r, phi):
        """(w, mu) of `S^T w + B^T mu = -r`, `B w = -phi`."""
        row, column = self.scaling.row, self.scaling.column
        x = self.lu.solve(-np.concatenate([row * r, row * column * phi]), transposed=True)
        return x[: self.n], x[self.n :] / row


def require_independent(model, phi_q, q):
    """Raise InputError naming the constraints where the rows of phi_q (m, n) are linearly dependent."""
    rows = rows_of(phi_q, coordinate_sizes(model, q))
    if not np.all(rows.lengths > 0):
        names = ", ".join(model.constraint_name(int(k)) for k in np.flatnonzero(~(rows.lengths > 0))[:MOST])
        raise InputError(f"constraints {names}: phi_q has a row of zeros there; a constraint must depend on q")
    if least(rows) < DEPENDENT:
        solve = ', or let build(redundant="least-norm") leave it out' if model.is_scene else ""
        raise InputError(
            f"constraints {involved(model, rows)} are redundant: one of them follows from the others (or "
            f"contradicts them); remove it{solve}, or start elsewhere where only this position is singular"
        )
