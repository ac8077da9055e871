"""Roots and shapes of a LinearSystem: `(s^2 M + s C + K) x + B^T mu = 0`, `B x = 0`, those of least |s|.

There are 2 (n - m) roots. Both of a complex pair have conjugate shapes, and one of them stands for the two; a real root stands for itself.

Without C: dense on a basis of what B allows, or by Lanczos' method in shift-invert, whose operator `x -> z` of
`[[K - shift M, B^T], [B, 0]] (z, mu) = (M x, 0)` is symmetric in the metric of M and never leaves `B x = 0` (Lehoucq, Sorensen, Yang 1998).
With C: the same of the linear form in (x, w = s x). Rigid motions, which K and C leave alone, are taken out beforehand: there that form has
roots of no full set of shapes.
"""

import numpy as np
from scipy.linalg import eigh, null_space

from polyida.errors import InputError, StepFailure
from polyida.linear.lu import SingularSystem
from polyida.linear.saddle import falling
from polyida.modal.system import NO_MASS

SHIFTS = 1e-9 * 100.0 ** np.arange(10)  # of a typical k/m; the first: below the modes of a fine mesh, above the round-off of K
NEAR = 0.1  # shift of the damped form, of the slowest undamped vibration
SPARE = 4  # undamped modes beyond the wanted ones in which rigid motions are looked for
STILL = 1e-12  # of |C| |x|: what round-off leaves of C x
LEAST = 1e-14  # of the largest of C and x: less of C x is round-off too, where a rigid motion is few coordinates
RESTARTS = 100  # of Arnoldi's method
GATHERED = "the damped modes did not converge: roots of strongly damped bodies gather, as at -1/viscosity; ask for fewer modes"
TOLERANCE = 1e-12  # of Arnoldi's roots: those of viscous bodies gather at -1/viscosity, where round-off is not reached


def undamped(system, count):
    """(omega^2 (count,), ascending, exactly zero of rigid modes; shapes X (n, count), `X^T M X = 1`). K is symmetric."""
    X = _lanczos(system, count) if _large(system, count) else _dense(system, count)
    values = system.stiffness_of(X)
    order = np.argsort(values, kind="stable")
    return values[order], X[:, order]


def damped(system, count):
    """(roots s, complex, and shapes (n, .), complex, `|x^H M x| = 1`), by |s|: one of each complex pair, and each real root; `count` of
    them, or all where these are fewer. A rigid motion x, which has s = 0 twice, x and x t, comes once.
    """
    slow, N = _rigid(system, count)
    left = count - N.shape[1]
    roots, X = np.zeros(N.shape[1], complex), N.astype(complex)
    if left:
        solve = _arnoldi if _large(system, count) else _dense_damped
        s, Y = _least(*solve(system, left, N, slow), left)
        # exactly zero where a shape without stiffness stays where it is: of its two roots, 0 and -c/m, the other one fades
        mass = np.einsum("ik,ik->k", Y.conj(), system.M @ Y).real
        drag = 0.0 if system.C is None else np.einsum("ik,ik->k", Y.conj(), system.C @ Y).real
        stays = (system.stiffness_of(Y) == 0.0) & (np.abs(s) <= np.abs(s + drag / mass))
        roots, X = np.concatenate([roots, np.where(stays, 0.0, s)]), np.concatenate([X, Y], axis=1)
    return roots, X


def _large(system, count):
    return hasattr(system.K, "tocsc") and 4 * count < system.freedoms


def _dense(system, count):
    T = system.basis
    K = T.T @ (system.K @ T)
    return T @ eigh((K + K.T) / 2, subset_by_index=(0, count - 1))[1]


def _lanczos(system, count):
    from scipy.sparse.linalg import LinearOperator, eigsh

    shift = _below_all(system)
    factor, none = system.factor(-shift, 0.0), np.zeros(system.model.m)
    inverse = LinearOperator((system.n,) * 2, lambda b: factor.solve(-b, none)[0], dtype=float)
    start = inverse @ np.random.default_rng(0).standard_normal(system.n)
    X = eigsh(system.K, count, system.M, sigma=shift, OPinv=inverse, v0=start)[1]
    K, M = (X.T @ (matrix @ X) for matrix in (system.K, system.M))
    return X @ eigh((K + K.T) / 2, (M + M.T) / 2)[1]


def _below_all(system):
    """A shift below all omega^2, by the count of directions in which K - shift M falls."""
    size = np.abs(system.K.diagonal()).mean() / np.abs(system.M.diagonal()).mean()
    for shift in -size * SHIFTS:
        if not _falls(system, shift):
            return shift
    raise InputError(NO_MASS)


def _falls(system, shift):
    try:
        return bool(falling(system.K - shift * system.M, system.B))
    except SingularSystem:
        return True


def _rigid(system, count):
    """(square of the slowest vibration, 1/s^2, rigid shapes N (n, k)) that neither K nor C feels."""
    if not system.conservative:
        return 1.0, np.zeros((system.n, 0))
    values, X = undamped(system, min(count + SPARE, system.freedoms))
    N, moving = X[:, values == 0.0], np.abs(values[values != 0.0])
    if system.C is not None and N.shape[1]:
        drag = system.C @ N
        felt = STILL * (abs(system.C) @ np.abs(N)) + LEAST * abs(system.C).max() * np.abs(N).max()
        drag[np.abs(drag) <= felt] = 0.0
        N = N @ null_space(N.T @ drag)
    return float(moving.min(initial=np.inf)), N[:, :count]


def _dense_damped(system, count, N, slow):
    """All roots and shapes, dense, in the complement of N."""
    T = system.basis
    if N.shape[1]:
        T = T @ null_space(N.T @ (system.M @ T))
    d = T.shape[1]
    K, C = T.T @ (system.K @ T), np.zeros((d, d)) if system.C is None else T.T @ (system.C @ T)
    roots, Y = np.linalg.eig(np.block([[np.zeros((d, d)), np.eye(d)], [-K, -C]]))
    return roots, T @ Y[:d]


def _arnoldi(system, count, N, slow):
    """Those nearest to a small positive number, which is no root of a stable system."""
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
