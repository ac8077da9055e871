"""A model's small motions about a state: `M x'' + C x' + K x + B^T mu = 0`, `B x = 0`."""

import warnings
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from polyida.errors import InputError
from polyida.integrate.start import require_near, require_state
from polyida.integrate.state import State
from polyida.linear.lu import dense
from polyida.linear.saddle import KKT, require_independent, symmetric
from polyida.model import Model
from polyida.model.guarded import guard, require_functions

SMALL = 400  # coordinates up to which matrices are made dense
ROUND = 1e-14  # of |x|^T |K| |x|: round-off of x^T K x; a bar 1000 times as long as thick, in cubes, has 8e-14 in its first mode
NOTHING = 1e-28  # of K's largest entry: where a rigid motion is one coordinate, nothing else is left of its round-off
NO_MASS = "the mass matrix is singular on the constraints: every coordinate needs mass or a constraint"


@dataclass(frozen=True, eq=False)
class LinearSystem:
    """M, C = dg/dv, `K = d(g + B^T lam)/dq`, (n, n), C None where no force depends on v, and `B = phi_q`, (m, n), at a state at rest.

    All dense, or all CSC.
    """

    model: Model
    state: State
    M: Any
    C: Any
    K: Any
    B: Any

    @property
    def n(self):
        """Coordinates."""
        return self.model.n

    @property
    def freedoms(self):
        """Independent ones, n - m."""
        return self.model.n - self.model.m

    @cached_property
    def conservative(self):
        """Whether K is symmetric."""
        return symmetric(self.K)

    def factor(self, c_m, c_v):
        """The factored `[[c_m M + c_v C + K, B^T], [B, 0]]`, c_m and c_v real or complex. Raises SingularSystem."""
        matrix = c_m * self.M + self.K
        if self.C is not None and c_v:
            matrix = matrix + c_v * self.C
        return KKT(matrix, self.B)

    @cached_property
    def basis(self):
        """Columns T, (n, freedoms), dense: `B T = 0`, `T^T M T = 1`. Raises InputError where M is singular on B x = 0."""
        from scipy.linalg import cholesky, qr, solve_triangular

        masses = self.M.diagonal()
        sizes = 1.0 / np.sqrt(np.where(masses > 0, masses, 1.0))
        rows = dense(self.B) * sizes
        Z = np.eye(self.n) if not len(rows) else qr(rows.T)[0][:, len(rows) :]
        Z = sizes[:, None] * Z
        mass = Z.T @ (self.M @ Z)
        if mass.size and not np.linalg.eigvalsh(mass)[0] > 1e-13 * np.abs(mass).max():
            raise InputError(NO_MASS)
        return solve_triangular(cholesky(mass, lower=True), Z.T, lower=True).T

    def stiffness_of(self, X):
        """`x^T K x` of columns X (n, k), those that are no more than K's round-off exactly zero."""
        values = np.einsum("ik,ik->k", X.conj(), self.K @ X).real
        values[np.abs(values) <= self.round_off(X)] = 0.0
        return values

    def round_off(self, X):
        """Of `x^T K x`, (k,): of its sums, and of derivatives by differences, which show in what K is not symmetric by."""
        size = np.abs(X)
        least = self._apart + NOTHING * float(abs(self.K).max())
        return ROUND * np.einsum("ik,ik->k", size, abs(self.K) @ size) + least * np.einsum("ik,ik->k", size, size)

    @cached_property
    def _apart(self):
        return float(abs(self.K - self.K.T).max()) if self.conservative else 0.0


def linear_system(part, model, state=None):
    """The LinearSystem of a model about a state, or about q = 0 with lam = 0 at t = 0.

    What moves is taken as if it stood still there, with a warning. Raises InputError, in the name of `part`, for what is no model or
    no state of it, for one that is off its constraints, and for redundant constraints.
    """
    model = guard(model, part)
    rest = np.zeros(model.n)
    state = State(0.0, rest, rest, rest, np.zeros(model.m)) if state is None else require_state(part, model, state)
    if state.v.any():
        fastest = np.abs(state.v).max()
        warnings.warn(f"{part}: the state moves, |v| up to {fastest:.3g}; it is taken as if it stood still there", stacklevel=4)
    t, q = state.t, state.q
    require_functions(model, t, q, rest)
    B = model.phi_q(t, q)
    if model.m:
        require_independent(model, B, q)
        remedy = "give one of this model, such as pi.static(model)"
        require_near(model, f"{part}: the state", "phi", model.phi(t, q), max(1.0, np.abs(q).max()), remedy)
    C = model.force_v(t, q, rest) if model.needs.velocity_forces else None
    M = model.mass(q)
    K = model.tangent(t, q, rest, rest, state.lam, 0.0, 0.0, 1.0)
    given = [matrix for matrix in (M, C, K, B) if matrix is not None]
    sparse = K.shape[0] > SMALL and all(hasattr(matrix, "tocsc") for matrix in given)
    return LinearSystem(model, state, *[None if matrix is None else matrix.tocsc() if sparse else dense(matrix) for matrix in (M, C, K, B)])
