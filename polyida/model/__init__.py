"""Model: one residual r and one constraint vector phi, which every integrator solves."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from copy import copy
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polyida.errors import InputError
from polyida.linear.lu import SingularSystem, dense
from polyida.linear.saddle import KKT, StepMatrix
from polyida.model import differences
from polyida.reprs import table
from polyida.validation import named_keywords

Matrix = Any  # an array, or one of scipy.sparse
NONE: MappingProxyType[str, Any] = MappingProxyType({})
FEW, ROUND_OFF = 200, 1e-12  # coordinates and constraints of a model whose free coordinates are looked for; a relative singular value
NEARBY = 1e-4  # of a parameter's size: a change with which kinks move linearly


@named_keywords
@dataclass(frozen=True)
class Needs:
    """The structure of a model. What is False is evaluated once or never.

    Parameters
    ----------
    mass_varies : bool
        M depends on q.
    velocity_forces : bool
        g depends on v.
    driven : bool
        phi depends on t, or psi is not zero at v = 0.
    phi_q_varies : bool
        phi is not linear in q. Models with velocity rows are taken as True.
    """

    mass_varies: bool = True
    velocity_forces: bool = True
    driven: bool = True
    phi_q_varies: bool = True


class Model:
    """A constrained mechanical system `r = M(q) a + g(t, q, v) + phi_q^T lam = 0`, `phi(t, q) = 0` (index 3).

    A user's model sets `n` and `m` and writes `mass` and `force`, and with constraints `phi` and `phi_q`, or `psi` with `p` velocity rows. All other functions have
    defaults: derivatives are fourth-order differences. Override them if the exact form is known, and check them with `check_derivatives`.
    Shapes: q, v, a (n,), lam and phi (m,), matrices dense or scipy.sparse. The multipliers have the sign of r.

    `solve` calls each of the four functions once before the run and checks their values. Then it compares with differences `needs` and,
    if they are written, phi_q, phi_t, phi_rate, phi_bias and psi_v; `EnergyMomentum` compares the slope of `potential` with the force. No
    run compares force_q, force_v, mass_a_q, reaction_q, tangent, residual_p and phi_p: `pi.check_derivatives(model)` compares these,
    phi_q, phi_t, phi_bias and the slope of `potential`. Integrators call `residual`, `phi`, `tangent` and `phi_q` in Newton's method;
    `phi_rate`, `phi_bias` and `mass_system` at the start and after kinks; `rejection_reason` at the end of a step; `kinks` once for a
    run; `gaps` after each step. `run.energy` calls `potentials` and `powers`, `run.momentum` calls `momenta`, `pi.gradient` calls
    `residual_p` and `phi_p`. A model whose forces act only in a part of the motion, as a contact, must write `gaps`: otherwise steps may
    miss them.

    Attributes
    ----------
    n, m : int
        Numbers of coordinates and constraints.
    p : int
        Number of velocity rows, 0 by default. In runs lam has m + p entries, those of psi last.
    k : int
        Number of states x, first-order unknowns with `x' = rates(t, q, v, x)`. With states `force`, and if they are written `residual` and
        `powers`, get x (k,) as their last argument, and derivatives of forces are differences. In a run q and v have n + k columns: behind v
        the states over their sizes, behind q the integrals of these. An unknown z without a derivative, with `0 = f(t, q, z)`, is a
        coordinate without mass, and f a row of phi.
    algebraic : int
        Number of algebraic states, 0 by default: x has them behind the k others, and `rates` returns behind their derivatives what is zero,
        `0 = f(t, q, v, x)`, with a regular slope in them. They are solved for wherever forces are, by Newton's method from x0, and are in
        `run.states()`, not in `run.x`.
    x0, sizes_x : (k + algebraic,) float
        Start values of the states, zero by default, and their typical sizes, 1 by default: an error of one size counts like an error of 1
        in v.
    needs : Needs
    parameters : tuple of str
        Names of attributes, numbers or arrays, for gradients of runs.
    row_laws : tuple of RowLaw
        Laws of rows of phi and psi in place of their equations: contact and friction.
    uniform_units : bool
        True if all coordinates are in m: Newton's |dq| is then their root mean square; otherwise it is weighted by mass.
    has_constraint_increments : bool
        True if `increments` is written.
    flexible : bool
        True if bodies deform: BDF of order 3 to 5 is unstable, or slow, on mesh modes with little damping.
    extent : float, m, or None
        Size in space that does not depend on the state.
    free_fall : float, m/s^2
        Acceleration of gravity of a model that has an extent.
    dissipating : tuple of str
        Names in `powers` of parts that only dissipate.
    """

    n: int
    m: int
    k = algebraic = 0
    x0: Any = None
    sizes_x: Any = None
    needs: Needs = Needs()
    p = 0
    by_numba = False  # True if numba compiles the functions (jit/user_functions.py)
    is_scene = False  # True for the model of a scene
    checked = False  # True for a model that calls a checked one
    parameters: tuple[str, ...] = ()
    uniform_units = has_constraint_increments = False
    compiled = False  # True for a scene with regular masses, equal in x and y: integrators have compiled loops over its `arrays`
    own_forces: Any = ()  # the force elements of a scene
    remark = ""  # a note for a run's summary
    flexible = False
    extent = None
    longest_stretch = 1024  # steps that an integrator takes before they are looked at
    slipping = False  # True for a scene in which friction slips: forces of users of M and phi_q alone are without it
    free_fall = 0.0
    reference = None  # places of its nodes at q = 0, (nodes, 2), m
    bodies = drawn = ()  # its full plates; all bodies with a mesh: full plates, then reduced and rigid ones
    reduced_bodies = ()  # its bodies of few coordinates
    strains = NONE  # by name: relaxed strains of viscoelastic plates
    parts = rows = joints = NONE  # by name: its parts, their slices of phi and lam, the joints among them
    labels = units = ()  # of the rows of phi: names, and units of the multipliers
    named_profiles = ()  # (name, profile) of its loads and motors, the k-th that of row k of drives(t)
    motor_profiles = ()  # indices of profiles that turn rows of phi, rad
    path_profiles = ()  # indices of profiles that are added to rows of phi, m
    states = NONE  # {name: PlacedStates} of force elements with states
    velocity_rows = np.zeros(0, np.int64)  # rows of phi that are velocity rows: phi = 0, phi_q = W, phi_rate = psi
    state_columns = np.zeros(0, np.int64)  # coordinates whose velocities are states: x = state_units v[state_columns]
    state_units = np.zeros(0)
    state_start = np.zeros(0)  # velocities of the states at the start of a run
    own_states: Any = None  # OwnStates of a user's model
    state_speed = 1.0  # the velocity that stands for a state of typical size
    looks_apart = 1  # states between checks of the independence of phi_q's rows
    dissipating = ()
    row_laws: Any = ()  # a RowLaw of each row of contact or friction; the other rows are equations
    treats_redundant = "refuse"  # the argument `redundant` of Scene.build
    redundant: Any = None  # rows of phi that are left out, as assembly/independence.py has them
    absent: Any = frozenset()  # names of parts that do not act, of a scene that events change
    columns: Any = slice(None)  # numbers of the rows of phi among the columns of a run's lam
    not_finite = ""  # names of the functions that last returned numbers that are not finite

    @property
    def all_bodies(self) -> list:
        """Its bodies in the order of q: full plates, then bodies of few coordinates."""
        return [*self.bodies, *self.reduced_bodies]

    @property
    def few(self) -> Any:
        """Its bodies of few coordinates, `reduced_bodies`."""
        return self.reduced_bodies

    def __repr__(self):
        """Return the name of the class, n and m, in one line."""
        return f"<{type(self).__name__}: n = {getattr(self, 'n', '?')}, m = {getattr(self, 'm', '?')}>"

    def _repr_html_(self):
        """Its numbers, and a table of the parts, for notebooks."""
        sizes = {body.name: f"{2 * (body.pairs.stop - body.pairs.start)} coordinates" for body in self.all_bodies}
        counts = {name: rows.stop - rows.start for name, rows in self.rows.items()}
        of_rows = {name: f"{count} row{'s' * (count != 1)} of phi" for name, count in counts.items()}
        rows = [
            (name, type(part).__name__, ", ".join(descriptions[name] for descriptions in (sizes, of_rows) if name in descriptions))
            for name, part in self.parts.items()
        ]
        return table(repr(self)[1:-1], ("name", "kind", "in the model") if rows else (), rows)

    def mass(self, q: NDArray) -> Matrix:
        """Return the mass matrix M, (n, n), symmetric."""
        raise NotImplementedError

    def force(self, t: float, q: NDArray, v: NDArray) -> NDArray:
        """Return the force g = g_gyr + g_int - g_ext, (n,), of r = M a + g + phi_q^T lam."""
        raise NotImplementedError

    def rates(self, t: float, q: NDArray, v: NDArray, x: NDArray) -> NDArray:
        """Return the derivatives of the states x in time, (k,); behind them what is zero for algebraic ones, (algebraic,)."""
        raise NotImplementedError

    def phi(self, t: float, q: NDArray) -> NDArray:
        """Return the holonomic constraints, (m,)."""
        return np.zeros(0)

    def phi_q(self, t: float, q: NDArray) -> Matrix:
        """Return the constraint Jacobian, (m, n)."""
        return np.zeros((0, self.n))

    def psi(self, t: float, q: NDArray, v: NDArray) -> NDArray:
        """Return the velocity rows `psi = W(t, q) v + w(t, q)`, (p,): nonholonomic constraints, such as rolling. Their force is `-W^T nu`."""
        return np.zeros(0)

    def psi_v(self, t: float, q: NDArray) -> Matrix:
        """Return W, (p, n); by default from values of psi."""
        raise NotImplementedError

    def force_q(self, t: float, q: NDArray, v: NDArray) -> Matrix:
        """Return the derivative dg/dq of the force, (n, n)."""
        return differences.jacobian(lambda x: self.force(t, x, v), q, self.n)

    def force_v(self, t: float, q: NDArray, v: NDArray) -> Matrix:
        """Return the derivative dg/dv of the force, (n, n)."""
        return differences.jacobian(lambda x: self.force(t, q, x), v, self.n)

    def mass_a_q(self, q: NDArray, a: NDArray) -> Matrix:
        """Return d(M a)/dq, (n, n)."""
        return differences.jacobian(lambda x: self.mass(x) @ a, q, self.n)

    def reaction_q(self, t: float, q: NDArray, lam: NDArray) -> Matrix:
        """Return d(phi_q^T lam)/dq, (n, n)."""
        return differences.jacobian(lambda x: self.phi_q(t, x).T @ lam, q, self.n)

    def phi_t(self, t: float, q: NDArray) -> NDArray:
        """Return the partial derivative of phi in time, (m,)."""
        if not self.needs.driven:
            return np.zeros(self.m)
        return differences.along(lambda s: self.phi(t + s, q), bounds=self._smooth(t))

    def phi_rate(self, t: float, q: NDArray, v: NDArray) -> NDArray:
        """Return d phi/dt = `phi_q v + phi_t`, (m,)."""
        return self.phi_q(t, q) @ v + self.phi_t(t, q)

    def phi_of_frames(self, t: NDArray, q: NDArray, v: NDArray) -> tuple[NDArray, NDArray]:
        """Return phi and its rate in frames, (frames, m) each."""
        rates = [self.phi_rate(*at) for at in zip(t, q, v)]
        return np.array([self.phi(*at) for at in zip(t, q)]), np.array(rates)

    def phi_bias(self, t: float, q: NDArray, v: NDArray) -> NDArray:
        """Return `(phi_q v)_q v + 2 phi_qt v + phi_tt`, (m,), so that d2 phi/dt2 = phi_q a + phi_bias."""
        if not (self.needs.driven or self.needs.phi_q_varies):
            return np.zeros(self.m)
        reach = differences.reach_along(q, v)
        return differences.along(lambda s: self.phi_q(t + s, q + s * v) @ v + self.phi_t(t + s, q + s * v), reach, self._smooth(t))

    def phi_rate_q(self, t: float, q: NDArray, v: NDArray) -> Matrix:
        """Return d(phi_q v + phi_t)/dq, (m, n)."""
        return differences.jacobian(lambda x: self.phi_rate(t, x, v), q, self.m)

    def phi_bias_q(self, t: float, q: NDArray, v: NDArray) -> Matrix:
        """Return the derivative of phi_bias in q, (m, n)."""
        return differences.jacobian(lambda x: self.phi_bias(t, x, v), q, self.m)

    def phi_bias_v(self, t: float, q: NDArray, v: NDArray) -> Matrix:
        """Return d(phi_bias)/dv, (m, n): without velocity rows 2 phi_rate_q. phi_bias is quadratic in v."""
        if not self.velocity_rows.size:
            return 2.0 * self.phi_rate_q(t, q, v)
        steps = np.maximum(1.0, np.abs(v))
        changes = [self.phi_bias(t, q, v + step) - self.phi_bias(t, q, v - step) for step in np.diag(steps)]
        return np.array(changes).T / (2.0 * steps)

    def _smooth(self, t):
        """The range of s around 0 in which t + s is not at a kink."""
        return differences.around(self.kinks(t - 1.0, t + 1.0), t)

    def potential(self, q: NDArray) -> float | None:
        """Return the potential energy of all conservative forces at q, J, or None if unknown."""
        return None

    def potentials(self, q: NDArray) -> tuple[float, float]:
        """Return (potential of loads, strain energy), J. A user's model has `potential` as the first and 0 as the second; nan if unknown."""
        value = self.potential(q)
        return np.nan if value is None else value, 0.0

    def with_rows(self, rows: Any) -> Model:
        """Return the model in which only these rows of phi are there, as equations, (k,) int."""
        from polyida.model.row_laws import WithRows

        return WithRows(self, rows)

    def spread(self, lam: NDArray, width: int) -> NDArray:
        """Return multipliers of this model, (..., m), as those of all `width` rows of a run whose model changes."""
        result = np.zeros((*np.shape(lam)[:-1], width))
        result[..., self.columns] = lam
        return result

    @property
    def hidden(self) -> NDArray:
        """Coordinates that are integrals of states, or unused beside them."""
        return self.state_columns

    def states_of(self, v: NDArray) -> NDArray:
        """Return the states x, (..., k), from velocities v (..., n)."""
        return v[..., self.state_columns] * self.state_units

    def without_states(self, v: NDArray) -> NDArray:
        """Return q, v or a with zeros in the columns of the states."""
        if self.k:
            v = v.copy()
            v[self.state_columns] = 0.0
        return v

    def momenta(self, q: NDArray, v: NDArray) -> NDArray | None:
        """Return (px, py, L): momentum, N s, and angular momentum about the origin, N m s, or None if unknown."""
        return None

    def powers(self, t: float, q: NDArray, v: NDArray, lam: NDArray) -> dict[str, float]:
        """Return {name: power, W} of external work and of forces without a part in `potential`; `run.energy.work` has the integrals."""
        return {}

    def initial_velocity(self, t: float, q: NDArray) -> NDArray:
        """Return the default initial velocities, (n,); they need not be consistent."""
        return np.zeros(self.n)

    def rejection_reason(self, t: float, q: NDArray) -> str | None:
        """Return why the state at the end of a step cannot be accepted, or None; the step is then halved or fails."""
        return None

    def facing(self, q: NDArray) -> Any:
        """Return the model in which edges of plates face what they face at q, whatever moves: smooth rows for Newton's method in a step."""
        return self

    def sticks(self, q: NDArray) -> NDArray:
        """Return line segments (segments, 2, 2), m, that show bodies without a mesh."""
        return np.zeros((0, 2, 2))

    def attachment(self, name: Any) -> Any:
        """Return the attachment of the part of this name; InputError if there is none."""
        raise InputError(f"{type(self).__name__} has no named points, so none called {name!r}; read q")

    def position(self, name: Any, q: NDArray) -> NDArray:
        """Return the path of a named point over frames q (frames, n): (frames, 2), m; InputError if there is none."""
        raise InputError(f"position({name!r}): {type(self).__name__} has no named points; read q")

    def constraint_name(self, row: int) -> str:
        """Return the name of a row of phi in messages."""
        return f"phi[{row}]"

    def keeps_body(self, row: int) -> bool:
        """Return True if a row of phi keeps a body rigid; messages then name other rows."""
        return False

    def kinks(self, t0: float, t1: float) -> tuple[float, ...]:
        """Return the sorted times in (t0, t1) at which a load or motor profile is not smooth; steps end there."""
        return ()

    def samples(self, t0: float, t1: float) -> Iterable[float]:
        """Return the sorted times in (t0, t1) at which controllers sample; steps end there."""
        return ()

    def sampled(self, t: float, q: NDArray, v: NDArray) -> NDArray:
        """Return v with the outputs of the controllers that sample at t; v itself if there are none."""
        return v

    @property
    def switching(self) -> bool:
        """True if `gaps` is written."""
        return type(self).gaps is not Model.gaps

    def gaps(self, t: float, q: NDArray) -> NDArray:
        """Return switching functions (k,), such as distances: each is negative where its force acts and changes sign where it switches.

        Steps of all integrators end where one of them changes sign; a contact without one may be missed.
        """
        return np.zeros(0)

    def gap_names(self) -> list[str]:
        """Return the names of `gaps` in messages."""
        return [f"gaps[{k}]" for k in range(self.gaps(0.0, np.zeros(self.n)).size)]

    def residual(self, t: float, q: NDArray, v: NDArray, a: NDArray, lam: NDArray) -> NDArray:
        """Return the residual `r = M a + g + phi_q^T lam`, (n,), g = force(t, q, v): the equations of motion are r = 0."""
        r = self.mass(q) @ a + self.force(t, q, v)
        return r + self.phi_q(t, q).T @ lam if self.m else r

    def tangent(self, t: float, q: NDArray, v: NDArray, a: NDArray, lam: NDArray, c_m: float, c_v: float, c_q: float) -> Matrix:
        """Return `c_m M + c_v dr/dv + c_q dr/dq`, (n, n), without the terms that `needs` excludes."""
        result = c_m * self.mass(q) + c_q * self.force_q(t, q, v)
        if self.needs.velocity_forces and c_v:
            result = result + c_v * self.force_v(t, q, v)
        if self.needs.mass_varies:
            result = result + c_q * self.mass_a_q(q, a)
        if self.needs.phi_q_varies and self.m:
            result = result + c_q * self.reaction_q(t, q, lam)
        return result

    def replaced(self, name: str, value: Any) -> Model:
        """Return a copy with another value of an attribute; of a dataclass by `dataclasses.replace`.

        A class that derives other attributes from it, except cached properties, must override this function.
        """
        if is_dataclass(self) and any(field.init and field.name == name for field in fields(self)):
            return replace(self, **{name: value})
        other = copy(self)
        for key in [key for key in vars(self) if isinstance(getattr(type(self), key, None), cached_property)]:
            del other.__dict__[key]
        object.__setattr__(other, name, value)
        return other

    def residual_p(self, name: str, t: float, q: NDArray, v: NDArray, a: NDArray, lam: NDArray) -> NDArray:
        """Return dr/dp of one of `parameters`, (n,), of an array (n, ...); by default differences of copies."""
        return self.slope_p(name, lambda model: model.residual(t, q, v, a, lam), t)

    def phi_p(self, name: str, t: float, q: NDArray) -> NDArray:
        """Return dphi/dp of one of `parameters`, (m,), of an array (m, ...); by default differences of copies."""
        return self.slope_p(name, lambda model: model.phi(t, q), t)

    def parameter(self, name: str) -> Any:
        """Return the value of one of `parameters`; None if there is none of this name."""
        return getattr(self, name, None)

    def slope_p(self, name: str, function: Callable[[Model], NDArray], t: float | None = None) -> NDArray:
        """Return the derivative of `function(model)`, (k,), in one of `parameters`, by differences of copies: (k,), of an array (k, ...).

        t: the time of the function; differences are limited so that no kink that moves with the parameter passes it.
        """
        value = np.asarray(self.parameter(name), float)
        bounds: tuple[float, float] = differences.EVERYWHERE if t is None or value.ndim else self._bounds(name, float(value), t)
        columns = []
        for unit in np.eye(value.size).reshape(value.size, *value.shape):
            size = float(np.abs(value[unit == 1.0]).item()) or 1.0
            columns.append(differences.along(lambda s, unit=unit: function(self.replaced(name, (value + s * unit)[()])), size, bounds))
        return np.stack(columns, axis=-1).reshape(len(columns[0]), *value.shape)

    def _bounds(self, name, value, t):
        """The range in which a number may change before a kink that moves with it passes time t."""
        about, step = (t - 1.0, t + 1.0), NEARBY * (abs(value) or 1.0)
        kinks = self.kinks(*about)
        low, high = (self.replaced(name, value + s).kinks(*about) for s in (-step, step)) if kinks else ((), ())
        if not kinks or not len(low) == len(high) == len(kinks):
            return differences.EVERYWHERE
        speeds = np.subtract(high, low) / (2 * step)
        reached = [(t - kink) / speed for kink, speed in zip(kinks, speeds) if speed and t != kink]
        return max((s for s in reached if s < 0), default=-np.inf), min((s for s in reached if s > 0), default=np.inf)

    def columns_of_forces(self, t: float, q: NDArray, lam: NDArray) -> Matrix | None:
        """Return `(dr/dlam)^T`, (m, n), if it is not phi_q; else None."""
        return None

    def step_matrix(self) -> Any:
        """Return a StepMatrix of this model (linear/saddle.py), not factored yet."""
        return StepMatrix(self)

    def increments(self, t0: float, t1: float, ends: tuple[float, float], h: float, q: NDArray, v: NDArray) -> Any:
        """Return a function (dd, dv, phi, rate) -> (phi, rate) after a step of h from (q, v) at t0 in which q changes by h v + dd and v by dv.

        Its error is the round-off of the increment, not of q. Called if `has_constraint_increments` is True. ends: t0 and t1, or times just
        within if there is a kink.
        """
        raise NotImplementedError

    def _not_held(self, t, q):
        """The coordinates that neither mass nor a row of phi holds, in words; empty for large models, and if rows alone depend on each other."""
        if self.n + self.m > FEW:
            return ""
        M, B = dense(self.mass(q)), dense(self.phi_q(t, q))
        sizes, rows = np.linalg.svd(np.vstack([M, B]))[1:] if np.isfinite(M).all() and np.isfinite(B).all() else (np.ones(1), M)
        if sizes[-1] > ROUND_OFF * sizes[0]:
            return ""
        free, names = np.abs(rows[-1]), getattr(self, "coordinates", None) or [f"q[{k}]" for k in range(self.n)]
        return ", where nothing holds " + ", ".join(str(name) for name, share in zip(names, free) if share > 1e-3 * free.max())

    def mass_system(self, t: float, q: NDArray) -> Any:
        """Return the factored `[[M, B^T], [B, 0]]` at (t, q), B = phi_q; its `solve(r, phi)` returns (dq, dlam), see linear/saddle.py.

        Raises InputError if it is singular.
        """
        try:
            return KKT(self.mass(q), self.phi_q(t, q), 1.0)
        except SingularSystem:
            needed = "every coordinate needs mass or a constraint"
            raise InputError(f"the mass matrix is singular on the constraints{self._not_held(t, q)}: {needed}") from None
