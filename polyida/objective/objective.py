"""What is to be made small or large by a design: a function of a run, or of an equilibrium or modes as a run of one frame, with its slopes."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from polyida.errors import InputError
from polyida.integrate.statics.static import Equilibrium
from polyida.model.differences import FIRST_ORDER_STEP
from polyida.validation import floats, is_number, named_keywords

SHARES = np.array([[1.0, 2.0 / 3.0], [-1.0, -2.0 / 3.0], [2.0, -1.0 / 12.0], [-2.0, 1.0 / 12.0]])  # places, and weights of a slope there


@named_keywords
@dataclass(frozen=True, eq=False)
class Slopes:
    """dJ by the frames of a slice of a run: q, v, a (count, n), lam (count, m), t (count,), the times at which the frames are, or a
    function without arguments that gives this, called where times move with a parameter; None where zero.

    direct: {name of a parameter: dJ/dp at fixed frames}, this slice's share, such as "arm.stiffness" (cells,). work: more of the same
    for every parameter, entries (t (k,), q, v, a (k, n), lam (k, m), w (k, n), mu (k, m)): dJ/dp holds the sum over them of
    `w . dr/dp + mu . dphi/dp`; or None. of_model: this slice's share of J, to first order, as a function of the model at fixed frames: for
    parameters that `direct` does not name, such as "arm.nu"; or None.
    """

    q: NDArray | None = None
    v: NDArray | None = None
    a: NDArray | None = None
    lam: NDArray | None = None
    t: NDArray | Callable[[], NDArray] | None = None
    direct: dict[str, NDArray | float] = field(default_factory=dict)
    work: tuple[NDArray, ...] | None = None
    of_model: Callable[[Any], float] | None = None

    def by_time(self) -> NDArray | None:
        """t, (count,), or None."""
        return self.t() if callable(self.t) else self.t

    def times(self, factor: float) -> "Slopes":
        """Those of J times a number."""
        found: dict[str, Any] = {name: _times(factor, getattr(self, name)) for name in FRAMES}
        direct = {name: factor * value for name, value in self.direct.items()}
        work = None if self.work is None else (*self.work[:5], *(factor * x for x in self.work[5:]))
        return Slopes(**found, direct=direct, work=work, of_model=_times(factor, self.of_model))

    def plus(self, other: "Slopes") -> "Slopes":
        """Those of a sum of two objectives, of the same slice."""
        found: dict[str, Any] = {name: _sum(getattr(self, name), getattr(other, name)) for name in FRAMES}
        direct = self.direct | {name: value + self.direct.get(name, 0.0) for name, value in other.direct.items()}
        works = [work for work in (self.work, other.work) if work is not None]
        work = tuple(map(np.concatenate, zip(*works))) if works else None
        return Slopes(**found, direct=direct, work=work, of_model=_sum(self.of_model, other.of_model))


FRAMES = tuple(entry.name for entry in fields(Slopes))[:5]


def _times(factor, x):
    """Of an array or a function, None where there is none."""
    if callable(x):
        return lambda *given: factor * x(*given)
    return None if x is None else factor * x


def _sum(a, b):
    if a is None or b is None:
        return b if a is None else a
    if not (callable(a) or callable(b)):
        return a + b
    return lambda *given: _value(a, given) + _value(b, given)


def _value(x, given):
    return x(*given) if callable(x) else x


def reach(model, q, way):
    """The length along a way over which a model's functions vary, about."""
    return (model.extent or max(1.0, np.abs(q).max())) / (np.abs(way).max() or 1.0)


def along_way(model, t, q, lam, way, w, mu):
    """Entries of the `work` of Slopes whose sum is `d/ds (w . r + mu . phi)` at q + s way, a = 0: exact of plates, whose r is a cubic of s.

    What is linear about a state is so in every parameter too. q, way, w (n,), lam, mu (m,).
    """
    step = FIRST_ORDER_STEP * reach(model, q, way)
    at, weight = SHARES[:, :1] * step, SHARES[:, 1:] / step
    still = np.zeros((len(at), model.n))
    return np.full(len(at), t), q + at * way, still, still, np.tile(lam, (len(at), 1)), weight * w, weight * mu


class Objective:
    """A number that a run, or an equilibrium as a run of one frame, is judged by: `objective(run)`, with `slopes`.

    A run has model, t, q, v, a and lam. `2.0 * one + other`, `one - other` and `sum([...])` are objectives again.
    """

    def __call__(self, run: Any) -> float:
        """Its value."""
        raise NotImplementedError(f"{type(self).__name__} gives no value")

    def slopes(self, run: Any) -> Callable[[slice], Slopes]:
        """A function of a slice of the run's frames that gives the Slopes there; its attribute `value` is J where that is known by then."""
        raise NotImplementedError(f"{type(self).__name__} gives no slopes")

    def named(self, model: Any) -> "Objective":
        """The same with names in place of parts of a model: it may then be asked of one that has another number in a part."""
        return self

    def __add__(self, other: "Objective") -> "Sum":
        return Sum((*_terms(self), *_terms(other)))

    def __radd__(self, other: Any) -> "Objective":
        return self if is_number(other) and other == 0 else Sum((*_terms(other), *_terms(self)))

    def __sub__(self, other: "Objective") -> "Sum":
        return self + -_objective(other)

    def __mul__(self, number: float) -> "Sum":
        if not is_number(number):
            raise InputError(f"an objective is multiplied by {number!r:.100}; use a finite number")
        return Sum(tuple((float(number) * weight, part) for weight, part in _terms(self)))

    __rmul__ = __mul__

    def __truediv__(self, number: float) -> "Sum":
        if not (is_number(number) and number != 0):
            raise InputError(f"an objective is divided by {number!r:.100}; use a finite number that is not zero")
        return self * (1.0 / number)

    def __neg__(self) -> "Sum":
        return self * -1.0


@dataclass(frozen=True, eq=False)
class Sum(Objective):
    """`sum of weight J`, terms (weight, objective)."""

    terms: tuple[tuple[float, Objective], ...]

    def __call__(self, run: Any) -> float:
        return float(sum(weight * part(run) for weight, part in self.terms))

    def named(self, model: Any) -> "Sum":
        """All terms alike."""
        return Sum(tuple((weight, part.named(model)) for weight, part in self.terms))

    def slopes(self, run: Any) -> Callable[[slice], Slopes]:
        """The sum of the terms' slopes."""
        each = [(weight, part.slopes(run)) for weight, part in self.terms]

        def of(part):
            total = Slopes()
            for weight, slopes in each:
                total = total.plus(slopes(part).times(weight))
            return total

        if all(hasattr(slopes, "value") for _, slopes in each):
            of.value = float(sum(weight * slopes.value for weight, slopes in each))  # type: ignore[attr-defined]
        return of


def asked(told: str, function: Callable, *given: Any, advice: str = "") -> Any:
    """What a user's function gives. Raises InputError, which begins with `told`, where it raises."""
    try:
        return function(*given)
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"{told} raised {type(error).__name__}: {error}{advice}") from error


def require_objective(part: str, given: Any) -> Objective:
    """The objective. Raises InputError, in the name of `part`, for anything else."""
    if not isinstance(given, Objective):
        raise InputError(
            f"{part}: objective = {given!r:.100} must be one of pi.objective, such as pi.objective.UserObjective(value, slopes)"
        )
    return given


def _objective(given):
    return require_objective("a sum of objectives", given)


def _terms(given):
    return given.terms if isinstance(given, Sum) else ((1.0, _objective(given)),)


class Still(NamedTuple):
    """A state of a model as a run of one frame; modes: about it, or None."""

    model: Any
    t: NDArray
    q: NDArray
    v: NDArray
    a: NDArray
    lam: NDArray
    modes: Any = None


def run_of(part: str, subject: Any) -> Any:
    """What has model, t, q, v, a and lam. Raises InputError, in the name of `part`, for anything else."""
    if isinstance(subject, Still):
        return subject
    if isinstance(subject, Equilibrium):
        return _still(subject.model, subject)
    if hasattr(subject, "roots") and hasattr(subject, "shapes"):
        return _still(subject.model, subject.state, subject)
    if not all(hasattr(subject, name) for name in Still._fields[:-1]) or not len(subject.t):
        raise InputError(f"{part}: {subject!r:.100} is no run with frames, no equilibrium of pi.static and no pi.modes")
    if subject.model is None and hasattr(subject, "known_model"):
        subject.known_model(part)
    return subject


def _still(model, state, modes=None):
    frames = (np.asarray(x, float)[None] for x in (state.t, state.q, state.v, state.a, state.lam))
    return Still(model, *frames, modes)


@named_keywords
class UserObjective(Objective):
    """A function of a run with its slopes, both written by the user.

    value(run) -> J. slopes(run) -> {"q": dJ/dq (frames, n), "v", "a": alike, "lam": (frames, m), "t": (frames,)} in all frames; what is not
    there is zero. Where J depends on a parameter by itself, its slope at the same frames stands there too, by the parameter's name:
    "arm.mass"; without any such name, slopes of that kind in parameters that `pi.gradient` is asked for by name (`body.inertia`) are
    differences of value(run). Frame 0's v is that before the integrator's start and has no slope. Raises InputError where they are no
    functions, and of a run for other names and shapes, and numbers that are not finite.
    """

    def __init__(self, value: Callable[[Any], float], slopes: Callable[[Any], Mapping[str, Any]]) -> None:
        for name, given in (("value", value), ("slopes", slopes)):
            if not callable(given):
                raise InputError(f"UserObjective: {name} = {given!r:.100} must be a function of a run")
        self._value, self._slopes = value, slopes

    def __call__(self, run: Any) -> float:
        found = _call("value", self._value, run_of("UserObjective", run))
        if not is_number(found):
            raise InputError(f"UserObjective: value(run) must return a finite number, not {found!r:.100}")
        return float(found)

    def slopes(self, run: Any) -> Callable[[slice], Slopes]:
        """What the user's function gives, looked at."""
        run = run_of("UserObjective", run)
        given = _call("slopes", self._slopes, run)
        if not isinstance(given, Mapping):
            raise InputError(f"UserObjective: slopes(run) must return a dictionary, not {given!r:.100}")
        frames = {name: _checked(name, value, np.shape(getattr(run, name))) for name, value in given.items() if name in FRAMES}
        direct = {name: _checked(name, value) for name, value in given.items() if name not in FRAMES}

        def of(part):
            whole = part.indices(len(run.t))[1] == len(run.t)
            of_model = elsewhere if whole and not direct else None
            return Slopes(**{name: value[part] for name, value in frames.items()}, direct=direct if whole else {}, of_model=of_model)

        def elsewhere(model):
            try:
                return self(replace(run, model=model) if is_dataclass(run) else run._replace(model=model))
            except InputError as error:
                raise InputError(
                    f"UserObjective: value(run) fails for the same frames of a model with another number: {error}; use names of parts"
                ) from None

        return of


def _call(name, function, run):
    return asked(f"UserObjective: {name}(run), the function {getattr(function, '__name__', type(function).__name__)},", function, run)


def _checked(name, value, shape=None):
    """The slope in what is called so, as floats, of a shape, or of any where the name is a parameter's."""
    if not isinstance(name, str) or (shape is None and "." not in name):
        raise InputError(
            f"UserObjective: slopes(run) has {name!r:.100}; known: {', '.join(map(repr, FRAMES))}, and parameters, as 'arm.mass'"
        )
    found = floats(value)
    if found is None or (shape is not None and found.shape != shape):
        wanted = "finite numbers" if shape is None else f"finite numbers of shape {shape}"
        raise InputError(f"UserObjective: slopes(run)[{name!r}], {value!r:.100}, must be {wanted}")
    return found
