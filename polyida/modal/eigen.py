"""Small motions of a model about a state: `M x'' + C x' + K x + B^T mu = 0`, `B x = 0`, their matrices, roots s and shapes x of least |s|.

There are 2 (n - m) roots. Both of a complex pair have conjugate shapes, and one of them stands for the two; a real root stands for itself.

Without C: dense on a basis of what B allows, or by Lanczos' method in shift-invert, whose operator `x -> z` of
`[[K - shift M, B^T], [B, 0]] (z, mu) = (M x, 0)` is symmetric in the metric of M and never leaves `B x = 0` (Lehoucq, Sorensen, Yang 1998).
With C: the same of the linear form in (x, w = s x). Rigid motions, which K and C leave alone, are taken out beforehand: there that form has
roots of no full set of shapes.
"""

import warnings
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from scipy.linalg import eigh, null_space
from scipy.sparse import csc_array

from polyida.errors import InputError, StepFailure
from polyida.integrate.row_sizes import row_sizes
from polyida.integrate.start import require_near, require_state
from polyida.integrate.state import State
from polyida.integrate.static import own_system
from polyida.linear.lu import SingularSystem, dense
from polyida.linear.saddle import KKT, negative_directions, require_independent, symmetric
from polyida.model import Model
from polyida.model.guarded import guard, require_functions
from polyida.model.row_laws import require_no_laws

MOST = 2000  # coordinates of dense matrices
SMALL = 400  # coordinates up to which matrices are made dense
# of |x|^T |K| |x|: round-off of x^T K x, and likewise of C; a bar 1000 times as long as thick, in cubes, has 8e-14 in its first mode
ROUND = 1e-14
INDEPENDENT = 1e-12  # of the largest: smaller strains of places are round-off
NOTHING = 1e-26  # of K's largest entry: round-off of a rigid motion that is one coordinate
NO_MASS = "the mass matrix is singular on the constraints: every coordinate needs mass or a constraint"
SHIFTS = 1e-9 * 100.0 ** np.arange(10)  # of a typical k/m; the first: below the modes of a fine mesh, above the round-off of K
NEAR = 0.1  # shift of the damped form, of the slowest undamped vibration
SPARE = 4  # undamped modes beyond the wanted ones, among which rigid motions are searched
STILL = 1e-12  # of the largest entry of A: smaller roots of models with first-order states are round-off
RESTARTS = 100  # of Arnoldi's method
GATHERED = "the damped modes did not converge: roots of strongly damped bodies gather, as at -1/viscosity; ask for fewer modes"
TOLERANCE = 1e-12  # of Arnoldi's roots: those of viscous bodies gather at -1/viscosity, where round-off is not reached


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
        """Number of the coordinates of the system."""
        return self.M.shape[0]

    @property
    def freedoms(self):
        """Number of independent coordinates, n - m."""
        return self.n - self.B.shape[0]

    @cached_property
    def places(self):
        """Numbers of the coordinates that are no integrals of first-order states."""
        return np.setdiff1d(np.arange(self.model.n), self.model.hidden)

    def with_states_held(self):
        """The LinearSystem of the coordinates `places` alone: first-order states do not change."""
        at = self.places
        parts = [None if matrix is None else matrix[:, at] for matrix in (self.M, self.C, self.K, self.B)]
        return LinearSystem(self.model, self.state, *[None if part is None else part[at] for part in parts[:3]], parts[3])

    def whole(self, X):
        """Columns X (places, k) as columns (n, k) of all coordinates, zero for integrals of first-order states."""
        result = np.zeros((self.model.n, X.shape[1]), X.dtype)
        result[self.places] = X
        return result

    @cached_property
    def conservative(self):
        """True if K is symmetric."""
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
        """`x^T K x` of columns X (n, k); values below K's round-off are set to zero."""
        values = np.einsum("ik,ik->k", X.conj(), self.K @ X).real
        values[np.abs(values) <= self.round_off(X)] = 0.0
        return values

    def round_off(self, X):
        """Round-off of `x^T K x`, (k,): of its sums, and of derivatives by differences, estimated by the asymmetry of K.

        In a scene both components of a place have the round-off of the larger one: the stiffness of an unstretched spring across its axis.
        """
        size = np.abs(X)
        least = self._apart + NOTHING * float(abs(self.K).max())
        of_squares = least * np.einsum("ik,ik->k", size, size)
        if self.model.is_scene:
            size = size[0::2] + size[1::2]
        return ROUND * np.einsum("ik,ik->k", size, self._sizes @ size) + of_squares

    @cached_property
    def _sizes(self):
        """|K|, in a scene the largest entry of each block of two places, (n / 2, n / 2)."""
        K = abs(self.K)
        if not self.model.is_scene:
            return K
        blocks = [K[i::2][:, j::2] for i in range(2) for j in range(2)]
        if isinstance(K, np.ndarray):
            return np.max(blocks, axis=0)
        return blocks[0].maximum(blocks[1]).maximum(blocks[2]).maximum(blocks[3])

    @cached_property
    def _apart(self):
        """Largest asymmetry |K - K^T| of a symmetric K, its round-off; 0 if K is not symmetric."""
        return float(abs(self.K - self.K.T).max()) if self.conservative else 0.0


def linear_system(part, model, state=None):
    """The LinearSystem of a model about a state, or about q = 0 with lam = 0 at t = 0.

    Velocities of the state are ignored, with a warning. Raises InputError, in the name of `part`, for a wrong model or state, a state off
    the constraints, and redundant constraints.
    """
    model = guard(model, part)
    require_no_laws(part, model, "modes need a linear system: put joints in their place, such as polyida.Slot for a closed contact")
    zero = np.zeros(model.n)
    state = State(0.0, zero, zero, zero, np.zeros(model.m)) if state is None else require_state(part, model, state)
    moving = model.without_states(state.v)
    rest = state.v - moving
    if moving.any():
        fastest = np.abs(moving).max()
        warnings.warn(f"{part}: the state moves, |v| up to {fastest:.3g}; it is taken as if it stood still there", stacklevel=4)
    t, q = state.t, state.q
    require_functions(model, t, q, rest)
    B = model.phi_q(t, q)
    if model.m:
        require_independent(model, B, q)
        remedy = "give one of this model, such as pi.static(model)"
        require_near(model, f"{part}: the state", "phi", model.phi(t, q), row_sizes(model, q, B), remedy)
    C = model.force_v(t, q, rest) if model.needs.velocity_forces else None
    M = model.mass(q)
    K = model.tangent(t, q, rest, zero, state.lam, 0.0, 0.0, 1.0)
    matrices = [matrix for matrix in (M, C, K, B) if matrix is not None]
    sparse = K.shape[0] > SMALL and all(hasattr(matrix, "tocsc") for matrix in matrices if matrix.shape[0])  # without rows B may be dense
    return LinearSystem(
        model, state, *[None if matrix is None else csc_array(matrix) if sparse else dense(matrix) for matrix in (M, C, K, B)]
    )


def undamped(system, count):
    """(omega^2 (count,), ascending, exactly zero of rigid modes; shapes X (n, count), `X^T M X = 1`). K is symmetric."""
    X = _lanczos(system, count) if _large(system, count) else _dense(system, count)
    values = system.stiffness_of(X)
    order = np.argsort(values, kind="stable")
    return values[order], X[:, order]


def damped(system, count):
    """(roots s, complex, and shapes (n, .), complex, `|x^H M x| = 1`), by |s|: one of each complex pair, and each real root; `count` of
    them, or all where these are fewer. A rigid motion x, which has s = 0 twice, x and x t, comes once. With first-order states: dense.
    """
    if system.model.k:
        return _with_states(system, count)
    slow, N = _rigid(system, count)
    remaining = count - N.shape[1]
    roots, X = np.zeros(N.shape[1], complex), N.astype(complex)
    if remaining:
        solve = _arnoldi if _large(system, count) else _dense_damped
        s, Y = _least(*solve(system, remaining, N, slow), remaining)
        # exactly zero where a shape without stiffness stays where it is: of its two roots, 0 and -c/m, the other one fades
        mass = np.einsum("ik,ik->k", Y.conj(), system.M @ Y).real
        drag = 0.0 if system.C is None else np.einsum("ik,ik->k", Y.conj(), system.C @ Y).real
        stays = (system.stiffness_of(Y) == 0.0) & (np.abs(s) <= np.abs(s + drag / mass))
        roots, X = np.concatenate([roots, np.where(stays, 0.0, s)]), np.concatenate([X, Y], axis=1)
    return roots, X


def state_basis(system, T):
    """(S (n, .), units (.,), names) of first-order states: velocities `S y`, `S^T M S = 1`, of the states `units y`, for places T z.

    Relaxed strains that belong to places are `B T y` with one y for each z and time tau, B = dE/dq. S has an orthonormal basis of them.
    """
    model, masses, strains = system.model, system.M.diagonal(), system.model.strains.values()
    count = model.k - sum(len(placed.columns) for placed in strains)
    S = np.zeros((system.n, count))
    S[model.state_columns[:count], np.arange(count)] = 1.0
    parts, units = [S], [model.state_units[:count]]
    names = [f"{name} {one}" for name, placed in model.states.items() for one in placed.names]
    for time in times_of(model):
        own = (placed.columns.reshape(len(placed.terms), -1)[[tau == time for _, tau in placed.terms]] for placed in strains)
        rows = np.concatenate([each.ravel() for each in own])
        U, sizes, _ = np.linalg.svd(dense(system.K[rows] @ T), full_matrices=False)
        S = np.zeros((system.n, int((sizes > INDEPENDENT * sizes.max(initial=0.0)).sum())))
        S[rows] = U[:, : S.shape[1]]
        parts.append(S)
        units.append(np.full(S.shape[1], model.state_units[-1]))
        names += [f"strain {k} of tau = {time:g} s" for k in range(S.shape[1])]
    S = np.hstack(parts)
    sizes = np.sqrt(np.einsum("ik,i,ik->k", S, masses, S))
    return S / sizes, np.concatenate(units) / sizes, names


def times_of(model):
    """The different relaxation times of a model's viscoelastic plates, s."""
    return sorted({time for placed in model.strains.values() for _, time in placed.terms})


def first_order(system):
    """(A, T, S) of the small motions of a system: `(z', z'', y') = A (z, z', y)`, A (2 d + e, 2 d + e).

    T (n, d): basis of places, x = T z. S (n, e): basis of first-order states, whose velocities are S y.
    """
    T = system.whole(system.with_states_held().basis)
    S, _, _ = state_basis(system, T)
    d, both = T.shape[1], np.hstack([T, S])
    A = np.zeros((2 * d + S.shape[1],) * 2)
    A[:d, d : 2 * d] = np.eye(d)
    A[d:] = -both.T @ np.hstack([system.K @ T, system.C @ T, system.C @ S])
    return A, T, S


def _with_states(system, count):
    """`damped` of a model with first-order states; a shape is that of the places, and for the states x/s."""
    d, most = system.with_states_held().freedoms, 2 * MOST // (2 + len(times_of(system.model)))
    if d > most:
        raise InputError(f"modes: with first-order states the {d} coordinates are at most {most}")
    A, T, S = first_order(system)
    s, Y = np.linalg.eig(A)
    still = STILL * np.abs(A).max()
    s = np.where(np.abs(s) <= still, 0.0, s)
    order = [k for k in np.lexsort((-s.imag, np.abs(s))) if s[k].imag >= 0.0][:count]
    X = T @ Y[: T.shape[1], order] + S @ (Y[2 * T.shape[1] :, order] / np.where(s[order] == 0.0, 1.0, s[order]))
    s, X = s[order], X.astype(complex)
    # a rigid motion has s = 0 twice: of a double root round-off makes two of the size of its square root
    mass = np.einsum("ik,ik->k", X.conj(), system.M @ X).real
    rigid = (system.stiffness_of(X) == 0.0) & (np.abs(s) ** 2 * mass <= system.round_off(X))
    return np.where(rigid, 0.0, s), X


def _large(system, count):
    """True if the matrices are sparse and few of the modes are asked for, so that Lanczos' or Arnoldi's method is used."""
    return hasattr(system.K, "tocsc") and 4 * count < system.freedoms


def _dense(system, count):
    """The `count` slowest undamped shapes, (n, count), by the dense eigenvalue problem on the constraints."""
    T = system.basis
    K = T.T @ (system.K @ T)
    return T @ eigh((K + K.T) / 2, subset_by_index=(0, count - 1))[1]


def _lanczos(system, count):
    """The `count` slowest undamped shapes, (n, count), by Lanczos' method with a shift below all omega^2."""
    from scipy.sparse.linalg import LinearOperator, eigsh

    shift, solve = _below_all(system)
    inverse = LinearOperator((system.n,) * 2, solve, dtype=float)
    start = inverse @ np.random.default_rng(0).standard_normal(system.n)
    X = eigsh(system.K, count, system.M, sigma=shift, OPinv=inverse, v0=start)[1]
    K, M = (X.T @ (matrix @ X) for matrix in (system.K, system.M))
    return X @ eigh((K + K.T) / 2, (M + M.T) / 2)[1]


def _below_all(system):
    """(a shift below all omega^2, b -> x of `[[K - shift M, B^T], [B, 0]] (x, mu) = (b, 0)`), by the count of directions in which K - shift M falls."""
    size, none, at = np.abs(system.K.diagonal()).mean() / np.abs(system.M.diagonal()).mean(), np.zeros(system.B.shape[0]), system.state
    for shift in -size * SHIFTS:
        own = own_system(system.model, at.t, at.q, at.lam, -shift)
        if own and own.step.positive_definite():
            return shift, lambda b: own.solve(-b, none)[0]  # noqa: B023
        if not _falls(system, shift):
            factor = system.factor(-shift, 0.0)
            return shift, lambda b: factor.solve(-b, none)[0]  # noqa: B023
    raise InputError(NO_MASS)


def _falls(system, shift):
    """True if K - shift M is not positive definite on B x = 0, or singular there."""
    try:
        return bool(negative_directions(system.K - shift * system.M, system.B))
    except SingularSystem:
        return True


def _rigid(system, count):
    """(square of the slowest vibration, 1/s^2, rigid shapes N (n, k)) that neither K nor C feels."""
    if not system.conservative:
        return 1.0, np.zeros((system.n, 0))
    values, X = undamped(system, min(count + SPARE, system.freedoms))
    N, slow = X[:, values == 0.0], np.abs(values[values != 0.0]).min(initial=np.inf)
    if system.C is not None and N.shape[1]:
        drag, size = N.T @ (system.C @ N), np.abs(N)
        rate = np.sqrt(slow) if np.isfinite(slow) else np.abs(drag).max()  # N contains round-off of vibrations, which C feels
        drag[np.abs(drag) <= ROUND * (size.T @ (abs(system.C) @ size) + rate)] = 0.0
        N = N @ null_space(drag)
    return float(slow), N[:, :count]


def _dense_damped(system, count, N, slow):
    """All roots s, 1/s, and shapes (n, roots), dense, in the complement of the columns N."""
    T = system.basis
    if N.shape[1]:
        T = T @ null_space(N.T @ (system.M @ T))
    d = T.shape[1]
    K, C = T.T @ (system.K @ T), np.zeros((d, d)) if system.C is None else T.T @ (system.C @ T)
    roots, Y = np.linalg.eig(np.block([[np.zeros((d, d)), np.eye(d)], [-K, -C]]))
    return roots, T @ Y[:d]


def _arnoldi(system, count, N, slow):
    """The roots nearest to a small positive number, which is no root of a stable system, and their shapes, by Arnoldi's method."""
    from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigs

    n, shift = system.n, NEAR * np.sqrt(slow if np.isfinite(slow) else 1.0)
    factor, none = system.factor(shift**2, shift), np.zeros(system.model.m)
    C = 0.0 * system.M if system.C is None else system.C
    MN = system.M @ N

    def apply(y):
        """(z, w) of `w - s z = x`, `s M w + C w + K z + B^T mu = -M u`, for y = (x, u)."""
        x, u = (half - N @ (MN.T @ half) for half in np.split(y, 2))
        z = factor.solve(system.M @ (shift * u + shift * x) + C @ x, none)[0]
        return np.concatenate([z, (x + shift * z) / shift])

    inverse = LinearOperator((2 * n, 2 * n), apply, dtype=float)
    start = inverse @ np.random.default_rng(0).standard_normal(2 * n)
    try:
        values, Y = eigs(inverse, 2 * count + SPARE, v0=start, ncv=min(2 * n, max(40, 6 * count)), tol=TOLERANCE, maxiter=RESTARTS)
    except ArpackNoConvergence as error:
        raise StepFailure("arnoldi", GATHERED, system.state.t, wanted=count, found=len(error.eigenvalues) // 2) from None
    return shift + 1.0 / values, Y[:n]


def _least(roots, X, count):
    """Of complex pairs those in the upper half plane, and the real ones: the `count` of least |s|, of equal ones those that grow first."""
    upper = np.flatnonzero(roots.imag >= 0.0)
    upper = upper[np.argsort(-roots[upper].real, kind="stable")]
    upper = upper[np.argsort(np.abs(roots[upper]), kind="stable")][:count]
    return roots[upper], X[:, upper]
