"""Static equilibrium: `g(t, q, 0) + phi_q^T lam = 0`, `phi(t, q) = 0`, by Newton's method along a growing load."""

import warnings
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from polyida.assembly.relaxation import relaxed_velocities
from polyida.errors import InputError, StepFailure
from polyida.integrate.left_out import LeftOut
from polyida.integrate.loose import FREE, naming_loose, yielding_elements
from polyida.integrate.sizes import extent, memory_of_rest
from polyida.integrate.start import vector_of
from polyida.integrate.state import State
from polyida.linear.lu import SingularSystem, dense
from polyida.linear.saddle import KKT, negative_directions, require_independent, typical
from polyida.model import Model
from polyida.model.check import require_declared
from polyida.model.functions import writes
from polyida.model.guarded import guard, unguarded
from polyida.model.row_laws import require_no_laws
from polyida.reprs import brief
from polyida.validation import is_flag, is_number, is_whole, named_keywords

FAR = 5.0  # times the structure's extent: a larger Newton step is that of a mechanism
REGULARIZATION = 1e-13  # of the typical stiffness over the typical mass: far above round-off, far below the slowest vibration
SLOW = 0.3  # contraction above which a model's own step matrix is made anew
MOST_STEPS = 10**6  # of the load
HALVINGS = 10  # of a part of the load, in a row
ATTEMPTS = 200  # parts of the load that are tried beyond those that were asked for


@dataclass(frozen=True)
class Equilibrium(State):
    """A State at rest in equilibrium.

    falling: number of independent directions that the constraints allow and in which the potential energy falls; None if there is no
    potential (dr/dq is not symmetric), if the structure can move without a change of energy, as one that nothing holds or loads, and for
    small displacements. parts, halved: number of parts in which the load was applied, and of parts that were halved because Newton's method
    failed. model: the model. linear: True for small displacements.
    """

    falling: int | None = None
    parts: int = 1
    halved: int = 0
    model: Any = field(default=None, repr=False)
    linear: bool = False

    __repr__ = brief

    @property
    def stable(self) -> bool | None:
        """True if the potential energy has a minimum here on phi = 0, False if it falls in some direction, None if that is unknown."""
        return None if self.falling is None else self.falling == 0

    def summary(self) -> str:
        """One line: the time, the kind of equilibrium and how the load was applied."""
        if self.linear:
            return f"equilibrium at t = {self.t:.9g} s for small displacements"
        unknown = "of unknown stability: its forces have no potential, or it can move without a change of energy"
        ways = f"{self.falling} direction{'s' if self.falling != 1 else ''}"
        kinds = {True: "stable", False: f"UNSTABLE: the energy falls in {ways}", None: unknown}
        how = f"; load in {self.parts} parts, halved {self.halved} times" if self.halved else ""
        return f"equilibrium at t = {self.t:.9g} s, {kinds[self.stable]}{how}"


class OwnSystem:
    """The system of `c_m M + K` and B at a state with v = 0, by the model's own step matrix. Raises SingularSystem."""

    def __init__(self, model, t, q, lam, c_m):
        """Factor `c_m M + K` at (t, q, lam) with v = 0 and a = 0."""
        self.step, self.at, zero = model.step_matrix(), (t, q, lam), np.zeros(model.n)
        self.step.factor(t, q, zero, zero, lam, c_m, 0.0)

    def solve(self, r, phi):
        """(dq, dlam) for the residuals r (n,) and phi (m,)."""
        return self.step.saddle(*self.at, r, phi)


def own_system(model, t, q, lam, c_m=0.0):
    """The OwnSystem of a model that writes its step matrix; None for others, and if that matrix is singular."""
    if not (model.is_scene or model.k) and writes(model, "step_matrix"):
        with suppress(SingularSystem):
            return OwnSystem(model, t, q, lam, c_m)
    return None


@dataclass(frozen=True, eq=False)
class Loading:
    """`g(t, q, 0) + phi_q^T lam = base + factor slope`, `phi(t, q) = 0`; base and slope (n,), N. Converged: |dq| <= tolerance (length + |q|)."""

    model: Model
    t: float
    base: np.ndarray
    slope: np.ndarray
    tolerance: float
    max_iterations: int

    def residuals(self, q, lam, factor):
        """r (n,) and phi (m,). Raises StepFailure if they are not finite."""
        r = self.model.residual(self.t, *self.at_rest(q), lam) - self.base - factor * self.slope
        phi = self.model.phi(self.t, q)
        if not (np.isfinite(r).all() and np.isfinite(phi).all()):
            raise StepFailure("not finite", "r or phi is not finite; use more load steps", self.t)
        return r, phi

    def at_rest(self, q):
        """(q, v, a) of a state at rest. The entries of q that belong to first-order states are their velocities: unknowns, as q is."""
        columns, zero = self.model.state_columns, np.zeros(self.model.n)
        if not len(columns):
            return q, zero, zero
        place, v = q.copy(), zero.copy()
        place[columns], v[columns] = 0.0, q[columns]
        return place, v, zero

    def stiffness(self, q, lam):
        """`K = d(g + phi_q^T lam)/dq`, (n, n), with the derivatives in first-order states. A state whose rate is zero identically stays."""
        model, state = self.model, self.at_rest(q)
        K = model.tangent(self.t, *state, lam, 0.0, 0.0, 1.0)
        if not model.k:
            return K
        from scipy.sparse import csc_array, diags_array

        chosen, stay = np.zeros((2, model.n))
        chosen[model.state_columns] = 1.0
        K = csc_array(K) + csc_array(model.force_v(self.t, *state[:2])) @ diags_array(chosen)
        stay[model.hidden] = abs(K).sum(axis=1)[model.hidden] == 0.0
        return (K + diags_array(stay)).tocsc()

    def multipliers(self, q, factor):
        """lam (m,) that best balances the forces at q, for all stiffness may come from it. Raises InputError for redundant constraints."""
        model = self.model
        if not model.m:
            return np.zeros(0)
        B = model.phi_q(self.t, q)
        require_independent(model, B, q)
        return np.linalg.solve(dense(B @ B.T), B @ (self.base + factor * self.slope - model.force(self.t, *self.at_rest(q)[:2])))

    def solve(self, q, lam, factor, system=None):
        """(q, lam, the system factored there) in equilibrium, from a guess; system: that of the guess, if it is known. Raises StepFailure."""
        own, last = system if isinstance(system, OwnSystem) else None, np.inf
        for iteration in range(self.max_iterations):
            r, phi = self.residuals(q, lam, factor)
            if own := own or own_system(self.model, self.t, q, lam):
                with suppress(SingularSystem, np.linalg.LinAlgError, StepFailure):  # the user's matrix may raise that of numpy
                    dq, dlam = own.step.saddle(self.t, q, lam, r, phi)
                    self.require_near(q, dq, iteration)
                    q, lam, regular, moved = q + dq, lam + dlam, True, np.abs(dq).max()
                    if self.converged(q, dq) and (here := own_system(self.model, self.t, q, lam)):
                        return q, lam, here
                    if not own.step.near_any_state or moved > SLOW * last:
                        own, moved = None, np.inf
                    last = moved
                    continue
                own = None
            dq, dlam, system, regular = self._correction(q, lam, r, phi, iteration)
            q, lam = q + dq, lam + dlam
            if regular and self.converged(q, dq):
                return q, lam, system
        if not regular:
            raise StepFailure("singular", FREE, self.t)
        reason, moved = "static equilibrium not found; use more load steps", float(np.abs(dq).max())
        raise StepFailure("newton", reason, self.t, iterations=self.max_iterations, moved=moved)

    def _correction(self, q, lam, r, phi, iteration):
        """(dq, dlam, the factored system, True if it is K's own) of Newton's method. Raises StepFailure.

        Where K is singular, as of a hanging chain that is not stretched yet, a small mass regularizes it.
        """
        K, B = self.stiffness(q, lam), self.model.phi_q(self.t, q)
        with suppress(StepFailure):
            system = self.factored(K, B)
            dq, dlam = system.solve(r, phi)
            self.require_near(q, dq, iteration)
            return dq, dlam, system, True
        M = self.model.mass(q)
        system = self.factored(K + REGULARIZATION * typical(K) / typical(M) * M, B)
        dq, dlam = system.solve(r, phi)
        self.require_near(q, dq, iteration)
        return dq, dlam, system, False

    def factored(self, K, B, reason=FREE, columns=None):
        """The factored KKT. Raises StepFailure if it is singular."""
        try:
            return KKT(K, B, columns=columns)
        except SingularSystem:
            raise StepFailure("singular", reason, self.t) from None

    def require_near(self, q, dq, iteration):
        """Raise StepFailure for a Newton step that is a mechanism's."""
        moved = np.abs(dq).max()
        if not moved <= FAR * extent(self.model, q):
            yielding = yielding_elements(self, q, dq) if self.model.is_scene and np.isfinite(moved) else ""
            raise StepFailure("singular", FREE + yielding, self.t, iteration=iteration, **{"|dq|": float(moved)})

    def converged(self, q, dq):
        """True if a step is below the tolerance."""
        return np.abs(dq).max() <= self.tolerance * extent(self.model, q)

    def require_accepted(self, q):
        """Raise StepFailure if the model rejects q."""
        if objection := self.model.rejection_reason(self.t, q):
            raise StepFailure("objection", objection, self.t)
        if reason := LeftOut(self.model).contradiction(self.t, q):
            raise StepFailure("contradiction", reason, self.t)

    def equilibrium(self, q, lam, solve, definite=False, **parts):
        """The Equilibrium at (q, lam); solve: of the system factored there; definite: True if K is known to be positive definite."""
        model, t, (place, v, zero) = self.model, self.t, self.at_rest(q)
        memory = {} if model.k else memory_of_rest(model, t, q, model.residual(t, q, v, zero, lam), solve)
        directions = 0 if definite else None
        if not definite:
            with suppress(SingularSystem):
                directions = negative_directions(self.stiffness(q, lam), model.phi_q(t, q))
        return Equilibrium(t, place, v, zero.copy(), lam, memory, falling=directions, model=unguarded(model), **parts).of(model)

    def small_displacements(self):
        """The Equilibrium of small displacements under the whole load. Raises InputError for redundant constraints, StepFailure."""
        model, zero, none = self.model, np.zeros(self.model.n), np.zeros(self.model.m)
        r, phi = self.residuals(zero, none, 1.0)
        K, B = self.stiffness(zero, none), model.phi_q(self.t, zero)
        if model.m:
            require_independent(model, B, zero)
        system = self.factored(K, B)
        if system.lu.doubtful():
            raise StepFailure("singular", FREE, self.t)
        q, lam = system.solve(r, phi)
        return Equilibrium(self.t, *self.at_rest(q), lam, model=unguarded(model), linear=True).of(model)


def whole_load(part, model, t, tolerance, max_iterations):
    """The Loading whose factor goes from 0, no load, to 1, the model's load. Raises InputError, in the name of `part`, for wrong settings."""
    if not is_whole(max_iterations):
        raise InputError(f"{part}: max_iterations = {max_iterations!r} must be a whole number of at least 1")
    if not is_number(t):
        raise InputError(f"{part}: t = {t!r} must be a finite time in s")
    if not (is_number(tolerance) and 0 < tolerance < 1):
        raise InputError(f"{part}: tolerance = {tolerance!r} must be between 0 and 1")
    require_no_laws(part, model, "put joints in their place, such as polyida.Slot for a closed contact, or let a damped run come to rest")
    load = model.force(float(t), np.zeros(model.n), np.zeros(model.n))
    load = np.where(np.isfinite(load), load, 0.0)  # a model that is singular at q = 0 gets its whole load at once
    return Loading(model, float(t), load, -load, tolerance, max_iterations)


def relaxed(model, elastic):
    """The Equilibrium of a model of viscoelastic plates, from that of its `elastic(relaxed=True)`."""
    q = np.append(elastic.q, np.zeros(model.n - len(elastic.q)))
    v = relaxed_velocities(model, q)
    v[: len(elastic.v)] = elastic.v
    return replace(elastic, q=q, v=v, a=np.zeros(model.n), memory={}, model=unguarded(model), states=()).of(model)


def start_of_unknowns(model, q0):
    """The unknowns of Loading at a user's q0, with the states at the start of a run."""
    q = vector_of("q0", q0, model)
    q[model.state_columns] = model.state_start
    return q


def apply_load(loading, q, steps):
    """(q, lam, the system factored there, parts, halved): the equilibrium under the whole load, which grows from zero.

    The load is applied in `steps` equal parts. A part for which Newton's method fails is halved; parts grow again, up to the first size, after two
    that succeed. parts, halved: numbers of parts that succeeded and that were halved. Raises StepFailure.
    """
    factor, part, lam, system = 0.0, 1.0 / steps, None, None
    parts = halved = in_a_row = 0
    while factor < 1.0:
        target = 1.0 if factor + part > 1.0 - 1e-9 else factor + part
        try:
            *reached, system = loading.solve(q, loading.multipliers(q, target) if lam is None else lam, target, system)
            loading.require_accepted(reached[0])
        except StepFailure as failure:
            if part * steps < 0.5**HALVINGS * 1.5 or parts + halved > steps + ATTEMPTS:
                if not factor:
                    raise naming_loose(failure, loading, q) from None
                hint = f"{failure.reason}; {factor:.6g} of the load is borne: if that is the most, pi.equilibrium_path goes beyond"
                raise StepFailure(failure.status, hint, failure.t, **failure.seen) from None
            part, halved, in_a_row = part / 2, halved + 1, 0
            continue
        factor, parts, (q, lam) = target, parts + 1, reached
        part, in_a_row = (min(2 * part, 1.0 / steps), 0) if in_a_row else (part, 1)
    return q, lam, system, parts, halved


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
    """Solve `g(t, q, 0) + phi_q^T lam = 0`, `phi(t, q) = 0`, and `rates = 0` of first-order states, for the static equilibrium.

    Parameters
    ----------
    model : Model
        The model.
    t : float, s
        Time at which loads and motors are evaluated.
    q0 : (n,) array_like, optional
        Guess of the coordinates, zero by default. Motors are at their places at t at once: Newton's method finds angles up to about one rad
        away. For larger ones take equilibria at successive t, each with the q of the one before.
    steps : int
        Number of equal parts in which the load is applied: at its factor s `g(q) + phi_q^T lam = (1 - s) g(0)`. A part for which Newton's
        method fails is halved; parts grow again after two that succeed.
    tolerance : float
        Newton's method ends at |dq| <= tolerance (length + |q|), largest entries; length: of the scene, 1 of an own model.
    max_iterations : int
        Largest number of Newton iterations in a part of the load.
    linear : bool
        Small displacements: `K q + phi_q^T lam = -g`, `phi + phi_q q = 0`, with all matrices at q = 0 and lam = 0. The other settings have no
        effect.

    Returns
    -------
    Equilibrium
        A State at rest, with `stable`; an unstable one comes with a warning.

    Raises
    ------
    InputError
        For a wrong setting and for redundant constraints.
    StepFailure
        If a part of 1/1024 of the load fails or the structure can move freely.

    Notes
    -----
    `equilibrium_path` continues beyond the largest load that a structure bears. Viscoelastic plates have their long-time modulus, and their
    strains have relaxed.
    """
    model = guard(model, "static")
    if model.strains:
        q = vector_of("q0", q0, model)[: 2 * model.n_factored]
        return relaxed(model, static(model.elastic(relaxed=True), t, q, steps, tolerance, max_iterations, linear))
    loading = whole_load("static", model, t, tolerance, max_iterations)
    if not is_whole(steps, most=MOST_STEPS):
        raise InputError(f"static: steps = {steps!r:.100} must be a whole number from 1 to {MOST_STEPS}")
    if not is_flag(linear):
        raise InputError(f"static: linear = {linear!r} must be True or False")
    q = start_of_unknowns(model, q0)
    require_declared(model, loading.t, q, np.zeros(model.n))
    if linear:
        try:
            return loading.small_displacements()
        except StepFailure as failure:
            raise naming_loose(failure, loading, np.zeros(model.n)) from None
    q, lam, system, parts, halved = apply_load(loading, q, steps)
    definite = isinstance(system, OwnSystem) and system.step.positive_definite()
    equilibrium = loading.equilibrium(q, lam, system.solve, definite, parts=parts, halved=halved)
    if not isinstance(system, OwnSystem) and system.lu.doubtful():  # the energy stays the same in some direction: signs are round-off
        equilibrium = replace(equilibrium, falling=None)
    if model.velocity_rows.size:
        name = model.constraint_name(int(model.velocity_rows[0]))
        path = "the path of the bodies, here that of Newton's method; more steps follow the load"
        warnings.warn(f"static: with the velocity row {name} the equilibrium depends on {path}", stacklevel=3)
    if equilibrium.stable is False:
        warnings.warn(f"static: {equilibrium.summary()}; look for another from a disturbed q0", stacklevel=3)
    return equilibrium
