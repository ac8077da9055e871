"""Static equilibrium: `g(t, q, 0) + phi_q^T lam = 0`, `phi(t, q) = 0`, by Newton's method along a growing load."""

import warnings
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from polyida.errors import InputError, StepFailure
from polyida.integrate.rest import equilibrium
from polyida.integrate.start import given
from polyida.integrate.state import State
from polyida.linear.lu import SingularSystem, dense
from polyida.linear.saddle import KKT, falling, require_independent, typical
from polyida.model import Model
from polyida.model.check import require_declared
from polyida.model.guarded import guard, unguarded
from polyida.reprs import brief
from polyida.validation import is_flag, is_number, is_whole, named_keywords

FREE = "the structure can move freely, or nearly so: hold it by joints or a clamp, and draw what hangs near to where it rests"
FAR = 5.0  # a Newton step of so many times the structure's extent is that of a mechanism
TOUCH = 1e-13  # of the typical stiffness over the typical mass: far above round-off, far below the slowest vibration


@dataclass(frozen=True)
class Equilibrium(State):
    """A State at rest in equilibrium, and what it is worth.

    falling: number of independent directions that the constraints allow and in which the potential energy falls; None where there
    is no potential (dr/dq is not symmetric) or its matrix breaks down, and of small displacements. parts, halved: parts in which the load
    was put on, and how many times a part was halved because Newton's method failed. model: whose equilibrium it is. linear: whether it is
    that of small displacements.
    """

    falling: int | None = None
    parts: int = 1
    halved: int = 0
    model: Any = field(default=None, repr=False)
    linear: bool = False

    __repr__ = brief

    @property
    def stable(self) -> bool | None:
        """True where the energy is least here, False where the structure would leave at a touch, None where it cannot be told."""
        return None if self.falling is None else self.falling == 0

    def summary(self) -> str:
        """The time, the kind of equilibrium and how the load was put on, in one line."""
        if self.linear:
            return f"equilibrium at t = {self.t:.9g} s for small displacements"
        unknown = "of unknown stability: its forces have no potential, or its matrix breaks down"
        ways = f"{self.falling} direction{'s' if self.falling != 1 else ''}"
        kinds = {True: "stable", False: f"UNSTABLE: the energy falls in {ways}", None: unknown}
        how = f"; load in {self.parts} parts, halved {self.halved} times" if self.halved else ""
        return f"equilibrium at t = {self.t:.9g} s, {kinds[self.stable]}{how}"


@dataclass(frozen=True, eq=False)
class Loading:
    """`g(t, q, 0) + phi_q^T lam = base + factor slope`, `phi(t, q) = 0`; base and slope (n,), N. Converged: |dq| <= tolerance max(1, |q|)."""

    model: Model
    t: float
    base: np.ndarray
    slope: np.ndarray
    tolerance: float
    max_iterations: int

    def residuals(self, q, lam, factor):
        """r (n,) and phi (m,). Raises StepFailure where they are not finite."""
        still = np.zeros(self.model.n)
        r = self.model.residual(self.t, q, still, still, lam) - self.base - factor * self.slope
        phi = self.model.phi(self.t, q)
        if not (np.isfinite(r).all() and np.isfinite(phi).all()):
            raise StepFailure("not finite", "r or phi is not finite; use more load steps", self.t)
        return r, phi

    def stiffness(self, q, lam):
        """`K = d(g + phi_q^T lam)/dq`, (n, n)."""
        still = np.zeros(self.model.n)
        return self.model.tangent(self.t, q, still, still, lam, 0.0, 0.0, 1.0)

    def multipliers(self, q, factor):
        """lam (m,) that best balance the forces at q: they may be all that gives stiffness. Raises InputError for redundant constraints."""
        model = self.model
        if not model.m:
            return np.zeros(0)
        B = model.phi_q(self.t, q)
        require_independent(model, B, q)
        missing = self.base + factor * self.slope - model.force(self.t, q, np.zeros(model.n))
        return np.linalg.solve(dense(B @ B.T), B @ missing)

    def solve(self, q, lam, factor):
        """(q, lam, the factored system) in equilibrium, from a guess. Raises StepFailure."""
        for iteration in range(self.max_iterations):
            r, phi = self.residuals(q, lam, factor)
            K = self.stiffness(q, lam)
            try:
                dq, dlam, system = self._correction(K, q, r, phi, iteration)
                regular = True
            except StepFailure:  # as of what hangs and is not stretched yet: a touch of mass tells which way
                M = self.model.mass(q)
                dq, dlam, system = self._correction(K + TOUCH * typical(K) / typical(M) * M, q, r, phi, iteration)
                regular = False
            q, lam = q + dq, lam + dlam
            if regular and self.converged(q, dq):
                return q, lam, system
        moved = float(np.abs(dq).max())
        if not regular:
            raise StepFailure("singular", FREE, self.t)
        reason = "static equilibrium not found; use more load steps"
        raise StepFailure("newton", reason, self.t, iterations=self.max_iterations, moved=moved)

    def _correction(self, matrix, q, r, phi, iteration):
        try:
            system = KKT(matrix, self.model.phi_q(self.t, q))
        except SingularSystem:
            raise StepFailure("singular", FREE, self.t) from None
        dq, dlam = system.solve(r, phi)
        self.require_near(q, dq, iteration)
        return dq, dlam, system

    def require_near(self, q, dq, iteration):
        """Raise StepFailure for a step that is a mechanism's."""
        moved = np.abs(dq).max()
        if not moved <= FAR * (np.abs(q).max() + (self.model.extent or 1.0)):
            raise StepFailure("singular", FREE, self.t, iteration=iteration, **{"|dq|": float(moved)})

    def converged(self, q, dq):
        """Whether a step is no more than the tolerance."""
        return np.abs(dq).max() <= self.tolerance * max(1.0, np.abs(q).max())

    def require_accepted(self, q):
        """Raise StepFailure for what the model objects to."""
        if objection := self.model.rejection_reason(self.t, q):
            raise StepFailure("objection", objection, self.t)

    def found(self, q, lam, solve, **told):
        """The Equilibrium at (q, lam); solve: of the system factored there."""
        model, t, rest = self.model, self.t, np.zeros(self.model.n)
        memory = equilibrium(model, t, q, lam, model.residual(t, q, rest, rest, lam), solve)
        return Equilibrium(t, q, rest, rest.copy(), lam, memory, falling=self.falls(q, lam), model=unguarded(model), **told)

    def small(self):
        """The Equilibrium of small displacements under all of the load. Raises InputError for redundant constraints, StepFailure."""
        model, rest, none = self.model, np.zeros(self.model.n), np.zeros(self.model.m)
        r, phi = self.residuals(rest, none, 1.0)
        K, B = self.stiffness(rest, none), model.phi_q(self.t, rest)
        if model.m:
            require_independent(model, B, rest)
        try:
            system = KKT(K, B)
        except SingularSystem:
            raise StepFailure("singular", FREE, self.t) from None
        if system.lu.doubtful():
            raise StepFailure("singular", FREE, self.t)
        q, lam = system.solve(r, phi)
        return Equilibrium(self.t, q, rest, rest.copy(), lam, model=unguarded(model), linear=True)

    def falls(self, q, lam):
        """Number of directions in which the energy falls, or None."""
        try:
            return falling(self.stiffness(q, lam), self.model.phi_q(self.t, q))
        except SingularSystem:
            return None


HALVINGS = 10  # of a part of the load, at most, in a row
ATTEMPTS = 200  # at parts, at most, beyond those that were asked for


@named_keywords
def static(
    model: Model,
    t: float = 0.0,
    q0: ArrayLike | None = None,
    steps: int = 1,
    tolerance: float = 1e-10,
    max_iterations: int = 50,
    linear: bool = False,
) -> Equilibrium:
    """The Equilibrium at time t: a State at rest with `stable`; one that is not stable comes with a warning.

    The load grows in `steps` equal parts: at a factor s of it `g(q) + phi_q^T lam = (1 - s) g(0)`, g(0) being the load at q = 0. Where
    Newton's method fails a part is halved, and grows again after two that succeeded; the summary says so. Converged where |dq| <= tolerance
    max(1, |q|) (largest entries). linear: for small displacements, `K q + B^T lam = -g`, `phi + B q = 0`, all of q = 0 and lam = 0: one
    factor, no iterations, and what linear elasticity says; q0, steps, tolerance and max_iterations have no part in it. Raises InputError
    for a wrong setting and for redundant constraints, StepFailure where a part of 1/1024 fails or the structure can move freely. Beyond the
    greatest load that a structure bears go `pi.equilibrium_path`.
    """
    model = guard(model, "static")
    loading = whole_load("static", model, t, tolerance, max_iterations)
    if not is_whole(steps):
        raise InputError(f"static: steps = {steps!r} must be a whole number of at least 1")
    if not is_flag(linear):
        raise InputError(f"static: linear = {linear!r} must be True or False")
    q = given(model, "q0", q0)
    require_declared(model, loading.t, q, np.zeros(model.n))
    if linear:
        return loading.small()
    found = _climb(loading, q, steps)
    if found.stable is False:
        warnings.warn(f"static: {found.summary()}; look for another from a disturbed q0", stacklevel=2)
    return found


def whole_load(part, model, t, tolerance, max_iterations):
    """The Loading from no load, factor 0, to all of the model's, factor 1. Raises InputError, in the name of `part`, for wrong settings."""
    if not is_whole(max_iterations):
        raise InputError(f"{part}: max_iterations = {max_iterations!r} must be a whole number of at least 1")
    if not is_number(t):
        raise InputError(f"{part}: t = {t!r} must be a finite time in s")
    if not (is_number(tolerance) and 0 < tolerance < 1):
        raise InputError(f"{part}: tolerance = {tolerance!r} must be between 0 and 1")
    load = model.force(float(t), np.zeros(model.n), np.zeros(model.n))
    load = np.where(np.isfinite(load), load, 0.0)  # a model that is singular at q = 0 has all of its load on at once
    return Loading(model, float(t), load, -load, tolerance, max_iterations)


def _climb(loading, q, steps):
    """The Equilibrium at factor 1, from q, in parts of 1/steps or less."""
    factor, part, lam, system = 0.0, 1.0 / steps, None, None
    parts = halved = in_a_row = 0
    while factor < 1.0:
        target = 1.0 if factor + part > 1.0 - 1e-9 else factor + part
        try:
            guess = loading.multipliers(q, target) if lam is None else lam
            *now, system = loading.solve(q, guess, target)
            loading.require_accepted(now[0])
        except StepFailure as failure:
            if part * steps < 0.5**HALVINGS * 1.5 or parts + halved > steps + ATTEMPTS:
                raise _at(failure, factor) from None
            part, halved, in_a_row = part / 2, halved + 1, 0
            continue
        factor, parts, (q, lam) = target, parts + 1, now
        part, in_a_row = (min(2 * part, 1.0 / steps), 0) if in_a_row else (part, 1)
    return loading.found(q, lam, system.solve, parts=parts, halved=halved)


def _at(failure, factor):
    """The failure, with the part of the load that was borne."""
    if not factor:
        return failure
    hint = f"{failure.reason}; {factor:.6g} of the load is borne: if that is the most, pi.equilibrium_path goes beyond"
    return StepFailure(failure.status, hint, failure.t, **failure.seen)
