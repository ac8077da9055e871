"""What is to be made small or large by a design: a function of a run, or of an equilibrium or modes as a run of one frame, with its slopes."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from polyida.errors import InputError
from polyida.given import is_number
from polyida.integrate.statics.static import Equilibrium
from polyida.objective.slopes import Slopes


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
