"""Static equilibrium: `g(t, q, 0) + phi_q^T lam = 0`, `phi(t, q) = 0`, by Newton's method along a growing load."""

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from polyida.errors import InputError
from polyida.given import is_number, is_whole
from polyida.integrate.start import given
from polyida.integrate.state import State, StepFailure
from polyida.integrate.stepping.rest import equilibrium
from polyida.keywords import named_keywords
from polyida.linear.inertia import falling
from polyida.linear.kkt import KKT, require_independent, scaling_factors
from polyida.linear.lu import SingularSystem
from polyida.linear.matrix import dense
from polyida.model import Model
from polyida.model.guarded import guard, require_functions

FREE = "the structure can move freely, or nearly so: hold it by joints or a clamp"
FAR = 5.0  # a Newton step of so many times the structure's extent is that of a mechanism


@dataclass(frozen=True)
class Equilibrium(State):
    """A State at rest in equilibrium, and what it is worth.

    falling: number of independent directions that the constraints allow and in which the potential energy falls; None where there
    is no potential (dr/dq is not symmetric) or its matrix breaks down.
    """

    falling: int | None = None

    @property
    def stable(self) -> bool | None:
        """True where the energy is least here, False where the structure would leave at a touch, None where it cannot be told."""
        return None if self.falling is None else self.falling == 0

    def summary(self) -> str:
        """The time and the kind of equilibrium, in one line."""
        unknown = "of unknown stability: its forces have no potential, or its matrix breaks down"
        ways = f"{self.falling} direction{'s' if self.falling != 1 else ''}"
        kinds = {True: "stable", False: f"UNSTABLE: the energy falls in {ways}", None: unknown}
        return f"equilibrium at t = {self.t:.9g} s, {kinds[self.stable]}"


@named_keywords
def static(
    model: Model, t: float = 0.0, q0: ArrayLike | None = None, steps: int = 1, tolerance: float = 1e-10, max_iterations: int = 50
) -> Equilibrium:
    """The Equilibrium at time t: a State at rest with `stable`; one that is not stable comes with a warning.

    The load grows in `steps` equal parts: part s solves `g(q) + phi_q^T lam = (1 - s) g(0)`, g(0) being the load at q = 0.
    Converged where |dq| <= tolerance max(1, |q|) (largest entries). Raises InputError for a wrong setting and for redundant
    constraints, StepFailure where Newton does not converge or the structure can move freely.
    """
    model = guard(model, "static")
    for name, value in (("steps", steps), ("max_iterations", max_iterations)):
        if not is_whole(value):
            raise InputError(f"static: {name} = {value!r} must be a whole number of at least 1")
    if not is_number(t):
        raise InputError(f"static: t = {t!r} must be a finite time in s")
    if not (is_number(tolerance) and 0 < tolerance < 1):
        raise InputError(f"static: tolerance = {tolerance!r} must be between 0 and 1")
    q = given(model, "q0", q0)
    rest = np.zeros(model.n)
    require_functions(model, float(t), q, rest)
    load, lam = model.force(t, rest, rest), np.zeros(model.m)
    if model.m:
        B = model.phi_q(t, q)
        require_independent(model, B, q)
        open_load = (1 - 1 / steps) * load - model.force(t, q, rest)
        lam = np.linalg.solve(dense(B @ B.T), B @ open_load)  # not zero: it may be all that gives stiffness
    for part in range(1, steps + 1):
        q, lam, system = _newton(model, t, q, lam, (1 - part / steps) * load, tolerance, max_iterations)
    if objection := model.objection(t, q):
        raise StepFailure("objection", objection, t)
    memory = equilibrium(model, t, q, lam, model.residual(t, q, rest, rest, lam), system.solve)
    found = Equilibrium(float(t), q, rest.copy(), rest.copy(), lam, memory, falling=_falling(model, t, q, lam))
    if found.stable is False:
        warnings.warn(f"static: {found.summary()}; look for another from a disturbed q0", stacklevel=2)
    return found


def _falling(model, t, q, lam):
    still = np.zeros(model.n)
    try:
        return falling(model.tangent(t, q, still, still, lam, 0.0, 0.0, 1.0), model.phi_q(t, q))
    except SingularSystem:
        return None


def _newton(model, t, q, lam, offset, tolerance, max_iterations):
    still = np.zeros(model.n)
    for iteration in range(max_iterations):
        r, phi = model.residual(t, q, still, still, lam) - offset, model.phi(t, q)
        if not (np.isfinite(r).all() and np.isfinite(phi).all()):
            raise StepFailure("not finite", "r or phi is not finite; use more load steps", t, iteration=iteration)
        matrix = model.tangent(t, q, still, still, lam, 0.0, 0.0, 1.0)
        try:
            system = KKT(matrix, model.phi_q(t, q), scaling_factors("physical", 1.0, matrix))
        except SingularSystem:
            raise StepFailure("singular", FREE, t) from None
        dq, dlam = system.solve(r, phi)
        if not np.abs(dq).max() <= FAR * (np.abs(q).max() + (model.extent or 1.0)):
            raise StepFailure("singular", FREE, t, iteration=iteration, **{"|dq|": float(np.abs(dq).max())})
        q, lam = q + dq, lam + dlam
        moved = np.abs(dq).max()
        if moved <= tolerance * max(1.0, np.abs(q).max()):
            return q, lam, system
    raise StepFailure("newton", "static equilibrium not found; use more load steps", t, iterations=max_iterations, moved=float(moved))
