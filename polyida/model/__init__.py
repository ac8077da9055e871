"""The seam: a model gives one residual r and one constraint vector phi, and every integrator solves those two."""

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polyida.errors import InputError
from polyida.linear.lu import SingularSystem
from polyida.linear.saddle import KKT
from polyida.linear.step_matrix import StepMatrix
from polyida.model import differences
from polyida.reprs import table
from polyida.validation import named_keywords

Matrix = Any  # an array, or one of scipy.sparse
NONE: MappingProxyType[str, Any] = MappingProxyType({})
NEARBY = 1e-4  # of a parameter's size: over which kinks move evenly


@named_keywords
@dataclass(frozen=True)
class Needs:
    """What a model needs evaluated anew. Everything that is False is computed once or never.

    mass_varies: M depends on q. velocity_forces: g depends on v. driven: phi depends on t. phi_q_varies: phi is not linear in q.
    """

    mass_varies: bool = True
    velocity_forces: bool = True
    driven: bool = True
    phi_q_varies: bool = True


class Model:
    """A constrained mechanical system `r = M(q) a + g(t, q, v) + phi_q^T lam = 0`, `phi(t, q) = 0` (index 3).

    A model of one's own sets `n` and `m` and writes `mass`, `force`, `phi` and `phi_q`; all other derivatives have right defaults by
    fourth-order differences. Override them where the exact form is known, and check the override with `check_derivatives`. A model whose
    forces act only in a part of the motion, like those of contacts, writes `gaps` too: without it steps may pass over them unseen. Shapes:
    q, v, a (n,), lam and phi (m,), matrices dense or scipy.sparse. The multipliers' sign is that of r.

    The attributes below it are what else is asked of every model; these are the values of one that has nothing of the kind.
    """

    n: int
    m: int
    needs: Needs = Needs()
    by_numba = False  # True of a model whose functions numba compiles (jit/compiled.py)
    is_scene = False  # True of a scene, whose functions are tested and called as they are
    parameters: tuple[str, ...] = ()  # names of attributes, numbers or arrays, in which gradients of runs are taken
    uniform_units = (
        False  # True where all coordinates are of one kind, m: Newton's |dq| is then their plain root mean square, by mass elsewhere
    )
    has_constraint_increments = False  # True where `increments` tells what phi gains in a step
    compiled = False  # True of a scene without Python in it: integrators have compiled loops over its `arrays`
    own_forces: Any = ()  # the force elements of a scene
    remark = ""  # what a run's summary says of the model
    flexible = False  # True where bodies deform: BDF of order 3 to 5 is unstable, or slow, on mesh modes with little damping
    extent = None  # size in space, m, that does not depend on the state
    free_fall = 0.0  # acceleration of gravity, m/s^2, of a model that has an extent
    reference = None  # places of its nodes at q = 0, (nodes, 2), m
    bodies = drawn = ()  # its full plates, and all that have a mesh: reduced and rigid ones behind them
    few = ()  # its bodies of few coordinates
    parts = rows = joints = NONE  # by name: its parts, their slices of phi and lam, the joints among them
    labels = units = ()  # of the rows of phi: what each is called, and the unit of its multiplier
    named_profiles = ()  # (name, profile) of its loads and motors, the k-th that of row k of drives(t)
    motor_profiles = ()  # which of them turn rows of phi, rad
    path_profiles = ()  # which of them are added to rows of phi, m
    looks_apart = 1  # states from one look at the independence of phi_q's rows to the next
    dissipating = ()  # names in `powers` of what only takes
    treats_redundant = "refuse"  # what a scene was told to do with redundant constraints
    redundant: Any = None  # rows of phi that it leaves out, as assembly/independence.py has them
    not_finite = ""  # which of its functions last gave numbers that are not finite, in words

    def __repr__(self):
        return f"<{type(self).__name__}: n = {getattr(self, 'n', '?')}, m = {getattr(self, 'm', '?')}>"

    def _repr_html_(self):
        """Its numbers, and a table of the parts, for notebooks."""
        sizes = {body.name: f"{2 * (body.pairs.stop - body.pairs.start)} coordinates" for body in (*self.bodies, *self.few)}
        counts = {name: rows.stop - rows.start for name, rows in self.rows.items()}
        held = {name: f"{count} row{'s' * (count != 1)} of phi" for name, count in counts.items()}
        told = lambda name: ", ".join(found[name] for found in (sizes, held) if name in found)  # noqa: E731
        rows = [(name, type(part).__name__, told(name)) for name, part in self.parts.items()]
        return table(repr(self)[1:-1], ("name", "kind", "in the model") if rows else (), rows)

    def mass(self, q: NDArray) -> Matrix:
        """Mass matrix M, (n, n), symmetric."""
        raise NotImplementedError

    def force(self, t: float, q: NDArray, v: NDArray) -> NDArray:
        """Force g = g_gyr + g_int - g_ext, (n,): what stands on the left of r beside M a."""
        raise NotImplementedError

    def phi(self, t: float, q: NDArray) -> NDArray:
        """Holonomic constraints, (m,)."""
        return np.zeros(0)

    def phi_q(self, t: float, q: NDArray) -> Matrix:
        """Constraint Jacobian, (m, n)."""
        return np.zeros((0, self.n))

    def force_q(self, t: float, q: NDArray, v: NDArray) -> Matrix:
        """dg/dq, (n, n)."""
        return differences.jacobian(lambda x: self.force(t, x, v), q, self.n)

    def force_v(self, t: float, q: NDArray, v: NDArray) -> Matrix:
        """dg/dv, (n, n)."""
        return differences.jacobian(lambda x: self.force(t, q, x), v, self.n)

    def mass_a_q(self, q: NDArray, a: NDArray) -> Matrix:
        """d(M a)/dq, (n, n)."""
        return differences.jacobian(lambda x: self.mass(x) @ a, q, self.n)

    def reaction_q(self, t: float, q: NDArray, lam: NDArray) -> Matrix:
        """d(phi_q^T lam)/dq, (n, n)."""
        return differences.jacobian(lambda x: self.phi_q(t, x).T @ lam, q, self.n)

    def phi_t(self, t: float, q: NDArray) -> NDArray:
        """Partial derivative of phi in time, (m,)."""
        if not self.needs.driven:
            return np.zeros(self.m)
        return differences.along(lambda s: self.phi(t + s, q), room=self._smooth(t))

    def phi_rate(self, t: float, q: NDArray, v: NDArray) -> NDArray:
        """`phi_q v + phi_t`, (m,): d phi/dt."""
        return self.phi_q(t, q) @ v + self.phi_t(t, q)

    def phi_bias(self, t: float, q: NDArray, v: NDArray) -> NDArray:
        """`(phi_q v)_q v + 2 phi_qt v + phi_tt`, (m,), so that d2 phi/dt2 = phi_q a + phi_bias."""
        if not (self.needs.driven or self.needs.phi_q_varies):
            return np.zeros(self.m)
        reach = differences.reach_along(q, v)
        return differences.along(lambda s: self.phi_q(t + s, q + s * v) @ v + self.phi_t(t + s, q + s * v), reach, self._smooth(t))

    def phi_rate_q(self, t: float, q: NDArray, v: NDArray) -> Matrix:
        """d(phi_q v + phi_t)/dq, (m, n)."""
        return differences.jacobian(lambda x: self.phi_rate(t, x, v), q, self.m)

    def phi_bias_q(self, t: float, q: NDArray, v: NDArray) -> Matrix:
        """d(phi_bias)/dq, (m, n); in v it is 2 phi_rate_q."""
        return differences.jacobian(lambda x: self.phi_bias(t, x, v), q, self.m)

    def _smooth(self, t):
        """The range of s around 0 in which t + s meets no kink."""
        return differences.around(self.kinks(t - 1.0, t + 1.0), t)

    def potential(self, q: NDArray) -> float | None:
        """Potential energy of all conservative forces at q, J, or None where the model does not say."""
        return None

    def potentials(self, q: NDArray) -> tuple[float, float]:
        """(potential of loads, strain energy), J; nan where the model does not say."""
        value = self.potential(q)
        return np.nan if value is None else value, 0.0

    def momenta(self, q: NDArray, v: NDArray) -> NDArray | None:
        """(px, py, L): momentum, N s, and angular momentum about the origin, N m s, or None where the model does not say."""
        return None

    def powers(self, t: float, q: NDArray, v: NDArray, lam: NDArray) -> dict[str, float]:
        """{name: power, W} of what works on it from outside, or without a part in `potential`; `run.energy.work` holds its integrals."""
        return {}

    def initial_velocity(self, t: float, q: NDArray) -> NDArray:
        """Velocities (n,) at the start of runs that are given none; they need not be consistent."""
        return np.zeros(self.n)

    def rejection_reason(self, t: float, q: NDArray) -> str | None:
        """Why a state cannot be accepted, or None."""
        return None

    def sticks(self, q: NDArray) -> NDArray:
        """Segments (segments, 2, 2), m, that show bodies without a mesh."""
        return np.zeros((0, 2, 2))

    def attachment(self, name: Any) -> Any:
        """What a part of this name holds on to; raises InputError where there is none."""
        raise InputError(f"{type(self).__name__} has no named points, so none called {name!r}; read q")

    def position(self, name: Any, q: NDArray) -> NDArray:
        """Path of a named point over frames q (frames, n): (frames, 2), m; raises InputError where there is none."""
        raise InputError(f"position({name!r}): {type(self).__name__} has no named points; read q")

    def constraint_name(self, row: int) -> str:
        """What row `row` of phi is called in a message."""
        return f"phi[{row}]"

    def keeps_body(self, row: int) -> bool:
        """Whether row `row` of phi is one by which a body stays rigid, so that a message names others rather."""
        return False

    def kinks(self, t0: float, t1: float) -> tuple[float, ...]:
        """Times in (t0, t1) at which a load or motor profile is not smooth, sorted."""
        return ()

    @property
    def switching(self) -> bool:
        """Whether it declares switches, by `gaps`."""
        return type(self).gaps is not Model.gaps

    def gaps(self, t: float, q: NDArray) -> NDArray:
        """Where forces switch, (k,): each of its values changes sign there, and is negative where its force acts, like a distance.

        Steps of all integrators end where one of them changes sign; a contact that is not declared so may be stepped over.
        """
        return np.zeros(0)

    def gap_names(self) -> list[str]:
        """What each of `gaps` is called in a message."""
        return [f"gaps[{k}]" for k in range(self.gaps(0.0, np.zeros(self.n)).size)]

    def residual(self, t: float, q: NDArray, v: NDArray, a: NDArray, lam: NDArray) -> NDArray:
        """`r = M a + g + phi_q^T lam`, (n,)."""
        r = self.mass(q) @ a + self.force(t, q, v)
        return r + self.phi_q(t, q).T @ lam if self.m else r

    def tangent(self, t: float, q: NDArray, v: NDArray, a: NDArray, lam: NDArray, c_m: float, c_v: float, c_q: float) -> Matrix:
        """`c_m M + c_v dr/dv + c_q dr/dq`, (n, n); terms that `needs` excludes are not evaluated."""
        result = c_m * self.mass(q) + c_q * self.force_q(t, q, v)
        if self.needs.velocity_forces and c_v:
            result = result + c_v * self.force_v(t, q, v)
        if self.needs.mass_varies:
            result = result + c_q * self.mass_a_q(q, a)
        if self.needs.phi_q_varies and self.m:
            result = result + c_q * self.reaction_q(t, q, lam)
        return result

    def replaced(self, name: str, value: Any) -> "Model":
        """A copy with another value of an attribute, made as its class makes it where that is a dataclass.

        What a class derives from the attribute elsewhere than in cached properties it must make anew by a `replaced` of its own.
        """
        if is_dataclass(self) and any(field.init and field.name == name for field in fields(self)):
            return replace(self, **{name: value})
        other = copy(self)
        for kept in [key for key in vars(self) if isinstance(getattr(type(self), key, None), cached_property)]:
            del other.__dict__[kept]
        object.__setattr__(other, name, value)
        return other

    def residual_p(self, name: str, t: float, q: NDArray, v: NDArray, a: NDArray, lam: NDArray) -> NDArray:
        """dr/dp of one of `parameters`, (n,), of an array (n, ...); by differences of copies unless it is written."""
        return self.slope_p(name, lambda model: model.residual(t, q, v, a, lam), t)

    def phi_p(self, name: str, t: float, q: NDArray) -> NDArray:
        """dphi/dp of one of `parameters`, (m,), of an array (m, ...); by differences of copies unless it is written."""
        return self.slope_p(name, lambda model: model.phi(t, q), t)

    def parameter(self, name: str) -> Any:
        """The value of one of `parameters`; None where there is none of this name."""
        return getattr(self, name, None)

    def slope_p(self, name: str, function: Callable[["Model"], NDArray], t: float | None = None) -> NDArray:
        """The derivative of `function(model)`, (k,), in one of `parameters`, by differences of copies, (k,), of an array (k, ...).

        t: the time that the function is of, which no kink that moves with a number passes then.
        """
        value = np.asarray(self.parameter(name), float)
        room: tuple[float, float] = differences.EVERYWHERE if t is None or value.ndim else self._room(name, float(value), t)
        columns = []
        for unit in np.eye(value.size).reshape(value.size, *value.shape):
            size = float(np.abs(value[unit == 1.0]).item()) or 1.0
            columns.append(differences.along(lambda s, unit=unit: function(self.replaced(name, (value + s * unit)[()])), size, room))
        return np.stack(columns, axis=-1).reshape(len(columns[0]), *value.shape)

    def _room(self, name, value, t):
        """By how much a number may change before a kink that moves with it passes time t."""
        about, step = (t - 1.0, t + 1.0), NEARBY * (abs(value) or 1.0)
        kinks = self.kinks(*about)
        low, high = (self.replaced(name, value + s).kinks(*about) for s in (-step, step)) if kinks else ((), ())
        if not kinks or not len(low) == len(high) == len(kinks):
            return differences.EVERYWHERE
        speeds = np.subtract(high, low) / (2 * step)
        reached = [(t - kink) / speed for kink, speed in zip(kinks, speeds) if speed and t != kink]
        return max((s for s in reached if s < 0), default=-np.inf), min((s for s in reached if s > 0), default=np.inf)

    def step_matrix(self) -> Any:
        """A StepMatrix of this model (linear/step_matrix.py), not factored yet."""
        return StepMatrix(self)

    def increments(self, t0: float, t1: float, ends: tuple[float, float], h: float, q: NDArray, v: NDArray) -> Any:
        """A function (dd, dv, phi, rate) -> (phi, rate) behind a step of h from (q, v) at t0 in which q moves by h v + dd and v by dv.

        To the round-off of what is gained, not of q; where `has_constraint_increments` is True. ends: t0 and t1, beside them within where there is a kink.
        """
        raise NotImplementedError

    def mass_system(self, t: float, q: NDArray) -> Any:
        """The factored `[[M, B^T], [B, 0]]` at (t, q), B = phi_q; its `solve(r, phi)` gives (dq, dlam) as linear/saddle.py's.

        Raises InputError where it is singular.
        """
        try:
            return KKT(self.mass(q), self.phi_q(t, q), 1.0)
        except SingularSystem:
            raise InputError("the mass matrix is singular on the constraints: every coordinate needs mass or a constraint") from None


def require_model(part, model):
    """Raise InputError unless it is a Model."""
    if not isinstance(model, Model):
        hint = "; of a Scene, call its build()"
        if model is None:
            hint = "; a run that was loaded has none where a class of its file is not known, which run.summary() names: import that before loading"
        raise InputError(f"{part}: the model is {type(model).__name__}, a polyida.Model is needed{hint}")
