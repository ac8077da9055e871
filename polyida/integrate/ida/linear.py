"""The linear systems of IDA: one n x n factor and a small border solve its whole iteration matrix exactly.

IDA asks for `J d = r`, J = dF/dy + cj dF/dy'. With y = (q, v, lam, mu) and mu only where the form has it:

    |  cj I     -I               B^T |  |dq  |   |r1|     q' - v + B^T mu
    |  K      cj M + C   B^T         |  |dv  | = |r2|     M v' + g + B^T lam
    |  P         Q                   |  |dlam|   |rc|     the form's constraint rows c(t, q, v, v')
                                        |dmu |            P = c_q,  Q = c_v + cj c_a

The first row gives dv; what remains is `S = K + cj C + cj^2 M` bordered by as many rows as there are multipliers.
IDA runs its GMRES on it with this solve as preconditioner. Its product with the matrix is replaced by handing the
vector through, and the solve that follows it by an echo: one real solve a Newton iteration, none to confirm it.
"""

import math

import numpy as np

SAME_CJ = 1e-3  # relative change of cj below which the factor serves on

def factor(matrix):
    """A function b -> matrix^-1 b, b (n,) or (n, k); it returns NaN where the matrix is singular or not finite.

    Sparse matrices go to SuperLU in symmetric mode with minimum degree on the pattern of A + A^T, dense ones to LAPACK.
    """
    return _sparse_factor(matrix) if hasattr(matrix, "tocsc") else dense_factor(np.asarray(matrix))


def _sparse_factor(matrix):
    from scipy.sparse.linalg import splu

    if not np.isfinite(matrix.data).all():
        return not_a_number
    options = {"SymmetricMode": True}
    try:
        return splu(matrix.tocsc(), permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options).solve
    except RuntimeError:  # what SuperLU raises where the matrix is singular
        return not_a_number


def dense_factor(matrix):
    """As `factor`, for a dense matrix (LAPACK LU with partial pivoting)."""
    from scipy.linalg.lapack import dgetrf, dgetrs

    if not matrix.size:
        return np.copy
    lu, pivots, info = dgetrf(matrix)
    return not_a_number if info else lambda b: dgetrs(lu, pivots, b)[0]


def not_a_number(b):
    """The answer of a factor that there is not: IDA takes it for a failure and tries a smaller step."""
    return np.full(np.shape(b), np.nan)


class EchoedSolve:
    """IDA's linear callbacks around a solve with the whole iteration matrix: `setup` factors at a cj, `reduced` solves.

    IDA itself keeps a factor while cj moves by up to 5/3. Here S is factored whenever cj has moved: with a stale cj
    Newton contracts at up to 0.5, needs up to 1.7 times the residuals, and on flexible bodies stops further from the
    solution; the factors saved are few.
    """

    def __init__(self, system, counts):
        self.system, self.counts = system, counts
        self.cj = math.nan
        self.echo = False

    def product(self, t, y, yp, res, vector, result, cj):
        """IDA's matrix times vector: hand it through, and have the next `solve` echo it."""
        self.echo = True
        result[:] = vector

    def solve(self, t, y, yp, res, r, z, cj, delta):
        """z = J^-1 r, or the echo of r where `product` came before."""
        if self.echo:
            self.echo = False
            z[:] = r
            return
        if not abs(cj - self.cj) <= SAME_CJ * cj:
            self.setup(t, y, yp, res, cj)
        self.counts.newton_iterations += 1
        self.counts.solves += 1
        self.reduced(t, r, z)


class ReducedSolve(EchoedSolve):
    """The preconditioner of `system` (integrate/ida/forms.py) for any model."""

    def setup(self, t, y, yp, res, cj):
        """Evaluate the blocks at (t, y, y'), factor S and the border."""
        self.cj, self.blocks = cj, self.system.blocks(t, y, yp)
        self.inverse = factor(self.system.iteration_matrix(t, y, yp, cj))
        self.counts.tangents += 1
        self.counts.factorizations += 1
        if self.blocks.border:
            self._border()

    def _border(self):
        blocks, cj = self.blocks, self.cj
        self.rows, self.velocity_rows = blocks.rows(cj)
        self.X = self.inverse(np.asfortranarray(blocks.columns(cj)))
        small = self.rows @ self.X
        if blocks.stabilised:
            small[:, blocks.m:] -= self.velocity_rows @ blocks.B.T
        self.inner = dense_factor(small)

    def reduced(self, t, r, z):
        """z = J^-1 r."""
        n, m, blocks, cj = self.blocks.n, self.blocks.m, self.blocks, self.cj
        r1 = r[:n]
        dq = self.inverse(r[n:2 * n] + blocks.damping_product(cj, r1))
        dv = -r1
        if blocks.border:
            w = self.inner(self.rows @ dq - r[2 * n:] - self.velocity_rows @ r1)
            dq = dq - self.X @ w
            if blocks.stabilised:
                dv = dv + blocks.B.T @ w[m:]
            z[2 * n:] = w / cj if blocks.integrated else w
        z[:n] = dq
        z[n:2 * n] = dv + cj * dq
