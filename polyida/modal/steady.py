"""Steady rotation: the equilibrium in the frame that turns with constant speed, and the modes about it.

All places turn about a centre c: x = c + e^(i spin t) (z - c), z constant in the turning frame. With places z = X + u the equations are

    M (u'' + 2 spin J u' - spin^2 (z - c)) + g(u) + B^T lam = 0,     phi = 0,

J a right angle. M u'' and g keep their form, for the forces within bodies turn with them. The equilibrium is that of g and the centrifugal force; small motions
about it have `(s^2 M + 2 s spin M J + K - spin^2 M) x + B^T mu = 0`, K the tangent there: stress stiffens it.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polyida.errors import InputError, StepFailure
from polyida.joint.joints import AngleMotor
from polyida.linear.lu import SingularSystem, dense
from polyida.linear.saddle import KKT, require_independent
from polyida.modal.eigen import LinearSystem
from polyida.model import Model
from polyida.model.guarded import guard
from polyida.model.row_laws import require_no_laws
from polyida.reprs import brief
from polyida.validation import complex_of_pairs, named_keywords, number, on_pairs, pairs_of, vector, vector2, whole

CLOSE = 1e-10  # of the extent: a Newton step that ends the search
ITERATIONS, PARTS = 40, 4  # Newton steps at one speed; parts of the speed, each beginning at the equilibrium before
ANGLE = 0.7  # rad: forces and constraints are compared with those after that turn
SAME = 1e-7  # of their size: what they may change by
LARGE = 2000  # coordinates of dense matrices
NO_RATE = 1e-8  # of |s|: a real part that small is round-off
ZERO = 1e-7  # of the speed or the first natural frequency: a root that small is a rigid motion


@named_keywords
@dataclass(frozen=True, eq=False)
class Steady:
    """An equilibrium in a frame that turns with a constant speed; the result of `pi.steady`.

    Parameters
    ----------
    model : Model
    spin : float, rad/s
        Counter-clockwise.
    about : (2,) float, m
        The centre.
    q : (n,) float
        Displacements in the turning frame, from the reference configuration.
    lam : (m,) float
        Multipliers of the constraints.
    """

    model: Model
    spin: float
    about: NDArray
    q: NDArray
    lam: NDArray

    __repr__ = brief

    @property
    def v(self) -> NDArray:
        """Velocities at the time at which the turning frame has the axes of the scene, (n,), m/s: a start for `pi.solve(..., q0=, v0=)`."""
        return self.spin * (_turn(len(self.q)) @ _places(self.model, self.q, self.about))

    def campbell(self, speeds: ArrayLike, count: int = 3) -> Campbell:
        """Compute the frequencies of the slowest modes over speeds.

        Parameters
        ----------
        speeds : (k,) float, rad/s
            Ascending.
        count : int
            Number of modes.

        Returns
        -------
        Campbell
            Frequencies, with a plot.

        Raises
        ------
        InputError
            For speeds that do not ascend.
        StepFailure
            If there is no equilibrium at a speed.
        """
        numbers, count = vector("steady.campbell", "speeds", speeds), whole("steady.campbell", "count", count)
        if not len(numbers) or not (np.diff(numbers) > 0.0).all():
            raise InputError(f"steady.campbell: speeds = {speeds!r:.200} must be ascending numbers of rad/s, at least one")
        each = [modes_of(steady(self.model, float(spin), self.about), count)[0] for spin in numbers]
        least = min(map(len, each))
        return Campbell(numbers, np.array([np.abs(roots[:least].imag) / (2.0 * np.pi) for roots in each]))


@named_keywords
@dataclass(frozen=True, eq=False)
class Campbell:
    """Natural frequencies in the turning frame over its speed.

    Parameters
    ----------
    speeds : (k,) float, rad/s
    frequencies : (k, count) float, Hz
    """

    speeds: NDArray
    frequencies: NDArray

    __repr__ = brief

    @named_keywords
    def plot(self, axes: Any = None) -> Any:
        """Return a matplotlib Figure of the frequencies over the speed, with lines of one, two and three times the speed.

        Parameters
        ----------
        axes : matplotlib axes, optional
            To draw on.

        Returns
        -------
        Figure
            The Campbell diagram.
        """
        from polyida.show.styles import on_axes

        with on_axes(axes) as axis:
            axis.plot(self.speeds, self.frequencies, "o-")
            top = 1.1 * float(self.frequencies.max(initial=0.0)) or 1.0
            for times in (1, 2, 3):
                axis.plot(self.speeds, times * self.speeds / (2.0 * np.pi), ":", color="0.6", lw=0.8)
            axis.set(xlabel="speed, rad/s", ylabel="frequency, Hz", ylim=(0.0, top))
        return axis.figure


@named_keywords
def steady(model: Model, spin: float, about: ArrayLike = (0.0, 0.0)) -> Steady:
    """Find the equilibrium in the frame that turns with a constant speed about a point: `g(u) + B^T lam = spin^2 M (x - about)`.

    The model is evaluated at t = 0: motors hold the angle that they have there, in the turning frame. `pi.modes(steady)` gives the modes
    with centrifugal and Coriolis terms and the stiffness of stress, `steady.campbell(speeds)` their frequencies over the speed.

    Parameters
    ----------
    model : Model
        A scene without gravity, all of whose parts may turn about the point: what holds the ground holds it there.
    spin : float, rad/s
        Counter-clockwise.
    about : (2,) float, m
        The centre.

    Returns
    -------
    Steady
        Displacements, multipliers.

    Raises
    ------
    InputError
        For wrong arguments, a model that is no scene, first-order states, contact and friction, and for loads and joints that do not turn with the frame.
    StepFailure
        If Newton's method finds no equilibrium.

    Examples
    --------
    >>> pi.modes(pi.steady(model, spin=6.0)).frequencies  # doctest: +SKIP
    """
    guarded = guard(model, "steady")
    if not guarded.is_scene or guarded.k:
        raise InputError("steady: the model must be a scene without first-order states (controllers, viscoelastic plates)")
    require_no_laws("steady", guarded, "a steady rotation needs joints in place of contact and friction")
    spin, centre = number("steady", "spin", spin, "rad/s"), vector2("steady", "about", about)
    q, lam = np.zeros(guarded.n), np.zeros(guarded.m)
    require_independent(guarded, guarded.phi_q(0.0, q), q)
    for part in range(1, PARTS + 1):
        q, lam = _equilibrium(guarded, spin * np.sqrt(part / PARTS), centre, q, lam)
    _require_turning(guarded, centre, q)
    return Steady(model, spin, centre, q, lam)


def _turn(n):
    """Sparse matrix J (n, n) that rotates each pair of coordinates (x, y) by +90 degrees."""
    from scipy.sparse import eye_array

    return on_pairs(1j * eye_array(n // 2))


def _places(model, q, centre):
    """The coordinates as places from the centre, (n,); those of directions are vectors, which do not move with a translation."""
    guarded: Any = guard(model)
    z = complex_of_pairs((guarded.reference.ravel() + q).reshape(-1, 2)) - guarded.translation * complex(*centre)
    return pairs_of(z).ravel()


def _equilibrium(model, spin, centre, q, lam):
    """(q, lam) of the steady rotation at a speed `spin`, rad/s, by Newton's method from a first guess."""
    still, mass = np.zeros(model.n), model.mass(q)
    for _ in range(ITERATIONS):
        B = model.phi_q(0.0, q)
        r = B.T @ lam + model.force(0.0, q, still) - spin**2 * (mass @ _places(model, q, centre))
        K = model.tangent(0.0, q, still, still, lam, 0.0, 0.0, 1.0) - spin**2 * mass
        try:
            dq, dlam = KKT(K, B).solve(r, model.phi(0.0, q))
        except SingularSystem:
            raise StepFailure("singular", f"steady: at {spin:.6g} rad/s nothing holds the bodies in the turning frame", 0.0) from None
        q, lam = q + dq, lam + dlam
        if not np.isfinite(q).all():
            break
        if np.abs(dq).max() <= CLOSE * (model.extent or 1.0):
            return q, lam
    raise StepFailure("newton", f"steady: no equilibrium is found at {spin:.6g} rad/s", 0.0, iterations=ITERATIONS)


def _require_turning(model, centre, q):
    """Raise InputError unless forces turn with the bodies about the centre, and joints to the ground allow it."""
    still, turn = np.zeros(model.n), _turn(model.n)
    at = _places(model, q, centre)
    turned = q + (np.cos(ANGLE) - 1.0) * at + np.sin(ANGLE) * (turn @ at)
    here, there = model.force(0.0, q, still), model.force(0.0, turned, still)
    stiffness = float(abs(model.tangent(0.0, q, still, still, np.zeros(model.m), 0.0, 0.0, 1.0)).max()) * (model.extent or 1.0)
    size = max(np.abs(here).max(initial=0.0), SAME * stiffness)
    off = there - (np.cos(ANGLE) * here + np.sin(ANGLE) * (turn @ here))
    if not np.abs(off).max(initial=0.0) <= SAME * size:
        raise InputError(
            "steady: forces do not turn with the bodies, as of gravity, a load or a spring to the ground beside the centre; leave them out, or give about="
        )
    for row in np.flatnonzero(np.abs(model.phi(0.0, turned)) > SAME * (model.extent or 1.0)).tolist():
        joint = next((model.joints[name] for name, rows in model.rows.items() if rows.start <= row < rows.stop), None)
        if not isinstance(joint, AngleMotor):
            name, place = model.constraint_name(row), f"({centre[0]:g}, {centre[1]:g})"
            raise InputError(
                f"steady: {name} does not let the bodies turn about {place}; use a Revolute and an AngleMotor there, or give about="
            )


def modes_of(found, count):
    """(roots with a positive imaginary part, by size, shapes (n, .)) of a Steady."""
    from scipy.linalg import eig

    model, still = guard(found.model), np.zeros(len(found.q))
    if model.n > LARGE:
        raise InputError(
            f"modes: {model.n} coordinates are more than {LARGE} for modes of a steady rotation; use fewer cells or pi.Reduced"
        )
    M, B = dense(model.mass(found.q)), dense(model.phi_q(0.0, found.q))
    K = dense(model.tangent(0.0, found.q, still, still, found.lam, 0.0, 0.0, 1.0)) - found.spin**2 * M
    T = LinearSystem(model, None, M, None, K, B).basis  # type: ignore[arg-type]
    gyro = 2.0 * found.spin * (T.T @ (M @ (_turn(model.n) @ T)))
    d = T.shape[1]
    A = np.block([[np.zeros((d, d)), np.eye(d)], [-T.T @ K @ T, -gyro]])
    roots, vectors = eig(A)
    least = ZERO * max(abs(found.spin), float(np.sort(np.abs(roots))[min(len(roots) - 1, 2)]) if len(roots) else 0.0)
    kept = np.flatnonzero((roots.imag > least) | (roots.real > least))
    kept = kept[np.argsort(np.abs(roots[kept]), kind="stable")][:count]
    if (roots[kept].real > NO_RATE * np.abs(roots[kept])).any():
        warnings.warn("modes: UNSTABLE, the steady rotation is not stable: see .unstable", stacklevel=4)
    roots = np.where(np.abs(roots.real) <= NO_RATE * np.abs(roots), 1j * roots.imag, roots)
    return roots[kept], T @ vectors[:d, kept]
