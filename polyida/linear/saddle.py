"""The saddle-point system of one Newton step: its factor, dense or sparse and scaled on request, its inertia, and dependent constraints.

```
[ S    B^T ] [ dq   ]     [ r   ]
[ B    0   ] [ dlam ] = - [ phi ]        S = c_m M + c_v C + c_q K,  B = phi_q
```
The inertia says whether a symmetric K is positive definite on the null space of B: `[[K, B^T], [B, 0]]` has m negative eigenvalues, m the
rows of B, exactly where K is. It is congruent to itself with `K + g B^T B` in place of K, any g, and so has the negative eigenvalues of that
and those of `-B (K + g B^T B)^-1 B^T` (Haynsworth 1968); those of a symmetric factor L D L^T are the negative entries of D (Sylvester).
"""

from typing import NamedTuple

import numpy as np

from polyida.errors import InputError
from polyida.linear.lu import LU, SYMMETRIC_MODE, SingularSystem, block_matrix, dense

DEPENDENT = 1e-6  # smallest singular value of the rows of phi_q, made of length one, below which they are
SCALINGS = ("none", "bottasso", "physical")


def typical(matrix):
    """The mean size of the diagonal; 1 where that is 0."""
    return float(np.mean(np.abs(matrix.diagonal()))) or 1.0


def scaling_size(kind, step_square, tangent):
    """What rows of r are divided by, and multipliers measured in, for beta h^2 = `step_square`; phi and q keep their units.

    Bottasso, Dopico, Trainelli 2008: 1 / (beta h^2). Physical (Bauchau, Epple, Bottasso 2009): the same times
    s = m_r + gamma h d_r + beta h^2 k_r, of typical mass, damping and stiffness: the mean of the diagonal of S.
    """
    return {"none": 1.0, "bottasso": 1.0 / step_square}.get(kind) or typical(tangent)


def assemble(tangent, phi_q, size=1.0, pull=None):
    """The scaled matrix, (n + m, n + m): dense where S is dense, CSC otherwise. pull: B of the upper right block, where it is another."""
    return block_matrix([[1 / size * tangent, (phi_q if pull is None else pull).T], [phi_q, None]])


class KKT:
    """A factorization of the system, by default with the power of two for `size` that is nearest the physical one, which rounds nothing.

    Raises SingularSystem.
    """

    def __init__(self, tangent, phi_q, size=None, pull=None):
        self.n, self.size = tangent.shape[0], size or 2.0 ** np.round(np.log2(typical(tangent)))
        self.lu = LU(assemble(tangent, phi_q, self.size, pull), pivoting=True)

    def solve(self, r, phi, transposed=False):
        """(dq, dlam) for the residuals r (n,) and phi (m,); transposed: with S^T in place of S."""
        x = self.lu.solve(-np.concatenate([1 / self.size * r, phi]), transposed)
        return x[: self.n], self.size * x[self.n :]


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


SYMMETRIC = 1e-6  # largest deviation of K from its transpose, over its largest entry, that derivatives by differences explain


def falling(tangent, phi_q):
    """Number of independent directions that phi_q allows in which the tangent (n, n), is negative; None where it is not symmetric.

    Raises SingularSystem where the sparse factor breaks down.
    """
    if not symmetric(tangent):
        return None
    m = phi_q.shape[0]
    size = typical(tangent)
    if not hasattr(tangent, "tocsc"):
        matrix = assemble(tangent, phi_q, size)
        return int(np.sum(np.linalg.eigvalsh((matrix + matrix.T) / 2) < 0)) - m
    if not m:
        return _negative(tangent / size)[0]
    from scipy.sparse import csr_array, diags_array

    rows = csr_array(phi_q)
    border = diags_array(1.0 / np.sqrt(rows.multiply(rows).sum(axis=1))) @ rows
    negative, solve = _negative(tangent / size + border.T @ border)
    schur = border @ solve(border.T.toarray())
    return negative + int(np.sum(np.linalg.eigvalsh((schur + schur.T) / 2) > 0)) - m


def symmetric(matrix):
    """Whether a matrix is its transpose, but for what derivatives by differences explain."""
    return abs(matrix - matrix.T).max() <= SYMMETRIC * abs(matrix).max()


def _negative(matrix):
    """(number of negative eigenvalues, solve) of a sparse symmetric matrix, from L D L^T without pivoting."""
    from scipy.sparse.linalg import splu

    try:
        lu = splu(matrix.tocsc(), **SYMMETRIC_MODE)
    except RuntimeError as error:
        raise SingularSystem("the tangent is singular") from error
    if not np.array_equal(lu.perm_r, lu.perm_c):
        raise SingularSystem("the tangent is singular to working precision")
    return int(np.sum(lu.U.diagonal() < 0)), lu.solve


MOST = 3  # constraints that a message names
FULL = 10_000  # numbers of phi_q up to which its zeros cost less than what tells them


class Rows(NamedTuple):
    """phi_q in the sizes of the coordinates, (m, n), the lengths of its rows, and the Gram matrix of the rows made of
    length one, (m, m), where they are above 0."""

    phi_q: object
    lengths: np.ndarray
    gram: np.ndarray


def coordinate_sizes(model, q):
    """`1 / sqrt(M_ii)`, (n,): what each coordinate is measured in, so that its unit does not matter; massless ones get the mean."""
    masses = np.abs(model.mass(q).diagonal())
    known = masses > 0
    return 1.0 / np.sqrt(np.where(known, masses, masses[known].mean() if known.any() else 1.0))


def rows_of(phi_q, sizes):
    """The Rows of a dense or sparse phi_q, its columns times the sizes (n,) of the coordinates."""
    if hasattr(phi_q, "toarray") and np.prod(phi_q.shape) > FULL:
        from scipy.sparse import diags_array

        phi_q = phi_q @ diags_array(sizes)
    else:
        phi_q = dense(phi_q) * sizes
    gram = dense(phi_q @ phi_q.T)
    lengths = np.sqrt(np.diag(gram))
    divisor = np.where(lengths > 0, lengths, 1.0)
    return Rows(phi_q, lengths, gram / np.outer(divisor, divisor))


def least(rows):
    """The smallest singular value of the unit rows, 0 to 1; nan where they are not finite."""
    if not np.isfinite(rows.gram).all():
        return float("nan")
    return float(np.sqrt(max(0.0, np.linalg.eigvalsh(rows.gram)[0])))


def involved(model, rows):
    """Names of the constraints, three at most, that weigh most in the nearest linear dependence, in their order: of joints, where
    rows by which bodies stay rigid are in it too."""
    weights = np.abs(np.linalg.eigh(rows.gram)[1][:, 0])
    of_joints = np.where([model.keeps_body(k) for k in range(len(weights))], 0.0, weights)
    weights = of_joints if of_joints.any() else weights
    heaviest = [int(k) for k in np.argsort(-weights)[:MOST] if weights[k] > 0.05 * weights.max()]
    return ", ".join(model.constraint_name(k) for k in sorted(heaviest))


def between(before, after):
    """The products of the unit rows of two Rows, (m, m)."""
    return dense(before.phi_q @ after.phi_q.T) / np.outer(before.lengths, after.lengths)


def way(products):
    """Frobenius norm of the change of the unit rows, from their products."""
    return float(np.sqrt(max(0.0, 2.0 * (len(products) - np.trace(products)))))


def cosine(before, after, products):
    """Of the angle by which the space of the rows has turned; -1 where a combination of them came back reversed."""
    (sign, size), sizes = np.linalg.slogdet(products), [np.linalg.slogdet(rows.gram)[1] for rows in (before, after)]
    return float(sign * np.exp(size - 0.5 * sum(sizes)))
