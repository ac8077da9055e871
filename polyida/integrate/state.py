"""What an integrator takes and yields: states, one by one or in stretches, between two of them, and the counts of the work done."""

import math
from collections.abc import Callable, Iterator
from copy import copy
from dataclasses import asdict, dataclass, field
from typing import Any, NamedTuple, Protocol, Self

import numpy as np

from polyida.errors import InputError, StepFailure
from polyida.model import Model
from polyida.model.differences import cubic
from polyida.reprs import brief, settings_of
from polyida.validation import instance_of, is_number, settle, takes


@dataclass(frozen=True)
class State:
    """One accepted state of a run.

    Parameters
    ----------
    t : float, s
    q, v, a : (n,) float
        Coordinates, velocities and accelerations.
    lam : (m,) float
        Multipliers.
    memory : {name: float or array of float}
        What the integrator needs, beside the vectors, to continue as if it had not stopped (generalized-alpha: the algorithmic acceleration
        `a_alg` and its step; Radau IIA: the polynomial of the last step; IDA: nothing). Files store it.
    restart : bool
        False if a run cannot continue from this state because the memory is missing: inside a compiled stretch, or between two accepted
        states.
    within : function t -> State or None, optional
        The state at a time t in the step that ends here, by the integrator's own polynomial; None if that is gone.
    states : tuple, optional
        Columns and units of the model's first-order states in v; the states that users see have it.
    """

    t: float
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    lam: np.ndarray
    memory: dict = field(default_factory=dict)
    restart: bool = True
    within: Callable[[float], "State | None"] | None = None
    states: tuple = ()

    __repr__ = brief

    @property
    def x(self) -> np.ndarray:
        """First-order states, (k,), in the order of `run.x`; empty without."""
        return self.v[self.states[0]] * self.states[1] if self.states else np.zeros(0)

    def of(self, model: Model) -> Self:
        """This state with the states x of its model."""
        if not model.k or self.states:
            return self
        other = copy(self)
        settle(other, states=(model.state_columns, model.state_units))
        return other

    def finite(self) -> bool:
        """True if q, v and lam are finite. One product checks each pair."""
        return math.isfinite(self.q.dot(self.v)) and math.isfinite(self.lam.dot(self.lam))


class Stretch:
    """Consecutive accepted states: t (k,), q, v, a (k, n), lam (k, m), and the last one as a State with its memory, if it has one.

    The states before the last have no memory: a run cannot continue from them. spent: {name: count} of the work up to the last state, without
    the steps; None if the counts are those of the whole stretch.
    """

    spent = _last = None

    def __init__(self, t, q, v, a, lam, last=None):
        """Take the arrays of all states; last: the last one as a State, if a run can continue from it."""
        self.t, self.q, self.v, self.a, self.lam, self._last = t, q, v, a, lam, last

    @classmethod
    def of(cls, state):
        """The Stretch of one State."""
        return Alone(state)

    def __len__(self):
        """Number of states in the stretch."""
        return len(self.t)

    def __iter__(self):
        """Iterate over the States of the stretch."""
        return map(self.state, range(len(self)))

    @property
    def last(self):
        """The last State, with its memory if it has one."""
        if self._last is None:
            self._last = self._state(len(self) - 1)
        return self._last

    def state(self, k):
        """The State number k, counted from 0."""
        return self.last if k == len(self) - 1 else self._state(k)

    def _state(self, k):
        """The State number k, without the memory from which a run continues."""
        return State(float(self.t[k]), self.q[k], self.v[k], self.a[k], self.lam[k], restart=False)

    def part(self, first, end, every=1):
        """The Stretch of the states from number `first` to before `end`, or of each `every`-th of them."""
        if first == 0 and end >= len(self) and every == 1:
            return self
        at = slice(first, end, every)
        whole = end >= len(self) and every == 1
        return Stretch(self.t[at], self.q[at], self.v[at], self.a[at], self.lam[at], self.last if whole else None)

    def computed(self):
        """An object that keeps vectors computed at their first reading as long as it is held, so that none is computed twice; None here."""

    def finite(self):
        """True if q, v and lam are finite."""
        return math.isfinite(np.vdot(self.q, self.v)) and math.isfinite(np.vdot(self.lam, self.lam))


class Alone(Stretch):
    """The Stretch of one State. Its vectors are computed when they are first read."""

    def __init__(self, state):
        """Take the State that is alone in the stretch."""
        self._last = state

    def __getattr__(self, name):
        """t (1,), q, v, a (1, n) or lam (1, m): the attribute `name` of the only State, with a first axis of length 1.

        It is called for attributes that are not stored; another name raises AttributeError.
        """
        if name not in ("t", "q", "v", "a", "lam"):
            raise AttributeError(name)
        return np.asarray(getattr(self._last, name))[None]

    def __len__(self):
        """Number of states, which is always 1."""
        return 1

    def finite(self):
        """True if the State is finite."""
        return self._last.finite()


class States:
    """Iterator over the single states of stretches. counts.steps is the number of each state when it is yielded. stretches: their source."""

    def __init__(self, stretches, counts):
        """Take the iterator of stretches, and the counts that are to follow the single states."""
        self.stretches, self._states = stretches, (part.last for stretch in stretches for part in parted(stretch, counts))

    def __iter__(self):
        """The iterator itself, as Python asks of iterators."""
        return self

    def __next__(self):
        """The next single State; the counts are those up to it."""
        return next(self._states)


def first_of(failures, attempts):
    """The first of StepFailures, with the attempts that followed, if any, and the reason of the last one in its message."""
    first, last = failures[0], failures[-1]
    reason = first.reason if last is first else f"{first.reason}; {attempts}, at last: {last.reason}"
    return StepFailure(first.status, reason, first.t, **last.seen)


def parted(stretch, counts, size=lambda: 1):
    """Yield a stretch in parts of `size()` states, with counts as at the last state of each: `steps`, and what `spent` says."""
    done, whole = 0, len(stretch)
    counts.steps -= whole
    while done < whole:
        part = stretch.part(done, done + size())
        done += len(part)
        counts.steps += len(part)
        if part.spent:
            vars(counts).update(part.spent)
        yield part


@dataclass
class Counts:
    """Exact counts of the work in a run; with fixed steps they are the same on every machine.

    Parameters
    ----------
    steps, rejected : int
        Accepted and rejected steps.
    newton_iterations, residuals, tangents : int
        Newton iterations, and evaluations of r and of its tangent.
    factorizations, solves : int
        Factors of the (n, n) step matrix, and solves with them.
    backend : str
        Name of the library that factored.
    """

    steps: int = 0
    rejected: int = 0
    newton_iterations: int = 0
    residuals: int = 0
    tangents: int = 0
    factorizations: int = 0
    solves: int = 0
    backend: str = ""

    def add(self, residuals: int = 0, iterations: int = 0, factors: int = 0, system: Any = None) -> None:
        """Add residuals, Newton iterations with one solve each, and factors of one tangent each; system: a step matrix that was factored."""
        self.residuals += int(residuals)
        self.newton_iterations += int(iterations)
        self.solves += int(iterations)
        self.tangents += int(factors)
        self.factorizations += int(factors)
        if system is not None:
            self.backend = system.backend
            self.solves += system.solves

    def as_dict(self) -> dict:
        """The counts as a plain dictionary."""
        return asdict(self)


def between(before, after, t):
    """The State at t between two accepted ones.

    `after.within(t)` if the integrator has its own polynomial there. Otherwise q is the cubic Hermite polynomial through q and v at both ends, v its
    derivative, and a and lam are linear in t: q is of fourth, v of third, a and lam of second order in the step. At an end it is the accepted
    state itself.
    """
    if t in (before.t, after.t):
        return before if t == before.t else after
    if after.within is not None and (state := after.within(t)) is not None:
        return state
    h = after.t - before.t
    s = (t - before.t) / h
    q, v = cubic(before.q, before.v, after.q, after.v, h, s)
    a, lam = before.a + s * (after.a - before.a), before.lam + s * (after.lam - before.lam)
    return State(float(t), q, v, a, lam, restart=False)


class Restart(NamedTuple):
    """A point from which a run continues: an accepted state with its memory, the number of frames and the counts up to it."""

    state: State
    frames: int
    counts: dict


class HasSteps(Protocol):
    """Any object with `steps`: what `pi.solve` takes as an integrator."""

    def steps(self, model: Model, state: State, t_end: float, counts: Counts, /) -> Iterator[State]:
        """Accepted states after `state` up to t_end, one a step."""
        ...


class Integrator:
    """A time integration method with its settings.

    Only `steps` must be written. All other methods and attributes have the defaults below. A user's class that has `steps` and does not
    inherit from this one gets the same defaults.

    Attributes
    ----------
    velocity_rows : bool
        True if it satisfies `phi_rate = 0` in the rows `model.velocity_rows`, where phi is 0 and phi_rate not its derivative. `solve` refuses
        models with such rows for other integrators of users.
    takes_samples : bool
        True if its steps end at `model.samples(t0, t1)` and go on from `model.sampled(t, q, v)`. `solve` refuses scenes with a Controller for
        other integrators of users.
    takes_laws : bool
        True if it satisfies the laws of `model.row_laws`, contact and friction. `solve` refuses models with laws for other integrators.
    order : int
        Order of convergence of q, v and lam with constant steps; 0 if it is unknown. `pi.error_of(..., again=True)` needs it.
    second_order : bool
        True if the error of a step in v is O(h^3). Steps that end at a switch of `gaps` may then be longer.
    trusted : bool
        True if every State has finite arrays of its own that are never written again. `solve` then uses them without copies and checks.
        `steps` may also return States, whose stretches are taken as they are. It counts for the `steps` of the class that sets it, and is not
        inherited by a class with other ones.
    writes_rows : bool
        True if `steps` takes the keyword `rows`, a function that returns the arrays of the next frames to write into. Needs `trusted`.
    iteration_matrix : function (model, state, h) -> (N, N) matrix, or None
        The matrix of Newton's method, for `pi.study.conditioning`.
    """

    velocity_rows = takes_samples = takes_laws = second_order = trusted = writes_rows = False
    order: int = 0
    iteration_matrix: Any = None

    def steps(self, model: Model, state: State, t_end: float, counts: Counts) -> Iterator[State]:
        """Integrate; called by `solve` after `require` and `require_reach`, and again behind each event and each switch of `model.gaps`.

        Parameters
        ----------
        model : Model
        state : State
            Any consistent state. Its memory is that of the state from which the integrator continues, or has none of the integrator's
            entries: at the start, behind an event and where forces jump.
        t_end : float, s
        counts : Counts
            To be increased; `counts.steps` is the number of each state as it is yielded.

        Yields
        ------
        State
            The accepted state at the end of each step; the last one at t_end.

        Raises
        ------
        StepFailure
            If the integration cannot continue. The run keeps the states so far.
        """
        raise NotImplementedError(f"{type(self).__name__} has no steps(model, state, t_end, counts)")

    def require(self, model: Model) -> None:
        """Raise InputError unless the integrator supports the model; called by `solve` before anything is computed."""

    def require_reach(self, model: Model, state: State, t_end: float) -> None:
        """Raise InputError unless the integrator can go from the initial state to t_end; called by `solve` before the first step."""

    def fixed_step(self) -> float:
        """The constant step, s; 0 if steps vary. By default the attribute `h`, unless there is none or `adaptive` is true."""
        h: Any = getattr(self, "h", None)
        return float(h) if is_number(h) and not getattr(self, "adaptive", False) else 0.0

    def relative_tolerance(self) -> float | None:
        """The relative tolerance that chooses the steps; None without one. By default the attribute `rtol`."""
        return getattr(self, "rtol", None)

    def without_halving(self) -> "Integrator":
        """The integrator that raises StepFailure instead of halving a step that fails; called for models with `gaps`."""
        return self

    def summary_of_steps(self, memory: dict) -> str:
        """Words for the run's summary about the steps, from the memory of its last state; empty for none."""
        return ""

    def settings_used(self, memory: dict) -> dict[str, Any]:
        """{setting: value} as a run used them, by the memory of one of its states. By default those given: fields, or numbers and texts."""
        return settings_of(self)

    def class_name(self) -> str:
        """The name of the class in messages."""
        return type(self).__name__


def written_by_user(integrator: Integrator) -> Any:
    """The object that gives `steps`: the user's own one of an integrator that `declared` made."""
    return integrator.user if isinstance(integrator, _Adapter) else integrator


def promises(integrator: Integrator, name: str) -> bool:
    """Whether `trusted` or `writes_rows` is set for the integrator's own `steps`, not for those of a class from which it inherits."""
    user = written_by_user(integrator)
    if "steps" not in vars(user):
        for kind in type(user).__mro__:
            if name in vars(kind) or "steps" in vars(kind):
                return name in vars(kind) and bool(getattr(integrator, name))
    return bool(getattr(integrator, name))


class _Adapter(Integrator):
    """A user's object that has `steps` and does not inherit from Integrator: what it has replaces the defaults."""

    def __init__(self, user):
        """Take `steps` of the user's object, and all public functions and attributes of Integrator that it has."""
        self.user = user
        for name in ("steps", *(name for name in vars(Integrator) if name[0] != "_" and hasattr(user, name))):
            setattr(self, name, getattr(user, name))

    def fixed_step(self):
        """The constant step of the user's object, s, by its attribute `h`; 0 if steps vary."""
        return Integrator.fixed_step(self.user)

    def relative_tolerance(self):
        """The relative tolerance of the user's object, by its attribute `rtol`; None without one."""
        return Integrator.relative_tolerance(self.user)

    def settings_used(self, memory):
        """{setting: value} of the user's object: its fields, or its numbers and texts."""
        return settings_of(self.user)

    def class_name(self):
        """The name of the user's class in messages."""
        return type(self.user).__name__


def declared(user: object, part: str = "solve") -> Integrator:
    """A user's integrator with all that Integrator declares. Raises InputError, in the name of `part`, unless it has `steps`."""
    steps = getattr(user, "steps", None)
    kind = user if isinstance(user, type) else type(user)
    shown = kind.__name__ if kind is user or kind.__repr__ is object.__repr__ else repr(user)  # without an address
    if steps is None or getattr(steps, "__func__", None) is Integrator.steps:
        lacking = "it has no method steps(model, state, t_end, counts)"
        raise InputError(f"{part}: {shown} is no integrator, {lacking}; use polyida.GeneralizedAlpha(...) or polyida.IDA(...)")
    if isinstance(user, type):
        raise InputError(f"{part}: {instance_of(user)}")
    name = type(user).__name__
    if not callable(steps):
        expected = "must be a function, steps(model, state, t_end, counts), that yields a State a step"
        raise InputError(f"{part}: steps = {steps!r:.100} of {name} {expected}")
    if not takes(steps, 4):
        raise InputError(f"{part}: steps of {name} must take (model, state, t_end, counts)")
    return user if isinstance(user, Integrator) else _Adapter(user)
