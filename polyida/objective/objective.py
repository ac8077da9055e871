"""What is to be made small or large by a design: a function of a run, or of an equilibrium or modes as a run of one frame, with its slopes."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, is_dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from polyida.errors import InputError
from polyida.integrate.statics.static import Equilibrium
from polyida.objective.slopes import FRAMES, Slopes
from polyida.validation import floats, is_number, named_keywords


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
        raise InputError(f"{part}: objective = {given!r:.100} must be one of pi.objective, such as pi.objective.Own(value, slopes)")
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
class Own(Objective):
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
                raise InputError(f"Own: {name} = {given!r:.100} must be a function of a run")
        self._value, self._slopes = value, slopes

    def __call__(self, run: Any) -> float:
        found = _asked_own("value", self._value, run_of("Own", run))
        if not is_number(found):
            raise InputError(f"Own: value(run) must return a finite number, not {found!r:.100}")
        return float(found)

    def slopes(self, run: Any) -> Callable[[slice], Slopes]:
        """What the user's function gives, looked at."""
        run = run_of("Own", run)
        given = _asked_own("slopes", self._slopes, run)
        if not isinstance(given, Mapping):
            raise InputError(f"Own: slopes(run) must return a dictionary, not {given!r:.100}")
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
                    f"Own: value(run) fails for the same frames of a model with another number: {error}; use names of parts"
                ) from None

        return of


def _asked_own(name, function, run):
    return asked(f"Own: {name}(run), the function {getattr(function, '__name__', type(function).__name__)},", function, run)


def _checked(name, value, shape=None):
    """The slope in what is called so, as floats, of a shape, or of any where the name is a parameter's."""
    if not isinstance(name, str) or (shape is None and "." not in name):
        raise InputError(f"Own: slopes(run) has {name!r:.100}; known: {', '.join(map(repr, FRAMES))}, and parameters, as 'arm.mass'")
    found = floats(value)
    if found is None or (shape is not None and found.shape != shape):
        wanted = "finite numbers" if shape is None else f"finite numbers of shape {shape}"
        raise InputError(f"Own: slopes(run)[{name!r}], {value!r:.100}, must be {wanted}")
    return found
