"""Objective: a function of a run with its derivatives; an equilibrium or modes are a run of one frame."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from polyida.errors import InputError
from polyida.integrate.static import Equilibrium
from polyida.model.differences import FIRST_ORDER_STEP
from polyida.validation import floats, is_number, named_keywords

SHARES = np.array([[1.0, 2.0 / 3.0], [-1.0, -2.0 / 3.0], [2.0, -1.0 / 12.0], [-2.0, 1.0 / 12.0]])  # places, and weights of a slope there


@named_keywords
@dataclass(frozen=True, eq=False)
class Slopes:
    """Derivatives of an objective J in the frames of a slice of a run, and its direct derivatives in parameters. None is zero.

    Parameters
    ----------
    q, v, a : (count, n) float, optional
        dJ/dq, dJ/dv, dJ/da of the frames.
    lam : (count, m) float, optional
        dJ/dlam.
    t : (count,) float or function () -> (count,) float, optional
        dJ/dt in the times of the frames. The function is called if times depend on a parameter.
    direct : dict, {name of a parameter: dJ/dp at fixed frames}
        The part of this slice, such as "arm.stiffness" (cells,).
    work : tuple (t (k,), q, v, a (k, n), lam (k, m), w (k, n), mu (k, m)), optional
        Entries of every parameter: dJ/dp contains the sum over them of `w . dr/dp + mu . dphi/dp`.
    of_model : function f(model) -> float, optional
        The part of J of this slice, to first order, at fixed frames: for parameters that `direct` does not name, such as "arm.nu".
    energies : dict, {body: (count,) float}
        dJ/dW, W the strain energy of a body in the frames: for errors of meshes.
    """

    q: NDArray | None = None
    v: NDArray | None = None
    a: NDArray | None = None
    lam: NDArray | None = None
    t: NDArray | Callable[[], NDArray] | None = None
    direct: dict[str, NDArray | float] = field(default_factory=dict)
    work: tuple[NDArray, ...] | None = None
    of_model: Callable[[Any], float] | None = None
    energies: dict[str, NDArray] = field(default_factory=dict)

    def by_time(self) -> NDArray | None:
        """Return t, (count,), or None; its function is called."""
        return self.t() if callable(self.t) else self.t

    def times(self, factor: float) -> Slopes:
        """Return the slopes of J times a number."""
        frames: dict[str, Any] = {name: _times(factor, getattr(self, name)) for name in FRAMES}
        direct = {name: factor * value for name, value in self.direct.items()}
        work = None if self.work is None else (*self.work[:5], *(factor * x for x in self.work[5:]))
        energies = {name: factor * value for name, value in self.energies.items()}
        return Slopes(**frames, direct=direct, work=work, of_model=_times(factor, self.of_model), energies=energies)

    def plus(self, other: Slopes) -> Slopes:
        """Return the slopes of the sum of two objectives, of the same slice."""
        frames: dict[str, Any] = {name: _sum(getattr(self, name), getattr(other, name)) for name in FRAMES}
        direct = self.direct | {name: value + self.direct.get(name, 0.0) for name, value in other.direct.items()}
        energies = self.energies | {name: value + self.energies.get(name, 0.0) for name, value in other.energies.items()}
        works = [work for work in (self.work, other.work) if work is not None]
        work = tuple(map(np.concatenate, zip(*works))) if works else None
        return Slopes(**frames, direct=direct, work=work, of_model=_sum(self.of_model, other.of_model), energies=energies)


FRAMES = tuple(entry.name for entry in fields(Slopes))[:5]


def slopes_at(objective: Objective, of: Callable[[slice], Slopes], run: Any, part: slice) -> Slopes:
    """The Slopes of a slice of frames, by the function `of` that `objective.slopes(run)` returned; InputError for wrong types and shapes."""
    name = type(objective).__name__
    if not callable(of):
        raise InputError(
            f"{name}: slopes(run) must return a function of a slice of the frames, which returns Slopes, not {type(of).__name__}"
        )
    result, label = of(part), f"{name}: slopes(run)(part)"
    if not isinstance(result, Slopes):
        raise InputError(f"{label} must return polyida.objective.Slopes, not {result!r:.100}")
    frames = run_of("gradient", run)
    count, n, m = len(range(*part.indices(len(frames.t)))), frames.q.shape[1], frames.lam.shape[1]
    shapes = {"q": (count, n), "v": (count, n), "a": (count, n), "lam": (count, m), "t": (count,)}
    for name, shape in shapes.items():
        value = getattr(result, name)
        if not (value is None or callable(value) or np.shape(value) == shape):
            raise InputError(f"{label}.{name} has the shape {np.shape(value)}; it must be {shape}, a row for each frame of the slice")
    return result


def _times(factor, x):
    """factor x of an array or a function; None of None."""
    if callable(x):
        return lambda *arguments: factor * x(*arguments)
    return None if x is None else factor * x


def _sum(a, b):
    """The sum of two arrays or functions; None is zero."""
    if a is None or b is None:
        return b if a is None else a
    if not (callable(a) or callable(b)):
        return a + b
    return lambda *arguments: _value(a, arguments) + _value(b, arguments)


def _value(x, arguments):
    """The value of a function, or the array itself."""
    return x(*arguments) if callable(x) else x


def reach(model, q, way):
    """The length along a direction `way` of q over which a model's functions vary, approximately."""
    return (model.extent or max(1.0, np.abs(q).max())) / (np.abs(way).max() or 1.0)


def along_way(model, t, q, lam, way, w, mu):
    """Entries of `Slopes.work` whose sum is `d/ds (w . r + mu . phi)` at q + s way, a = 0; exact for plates, whose r is cubic in s.

    q, way, w (n,), lam, mu (m,).
    """
    step = FIRST_ORDER_STEP * reach(model, q, way)
    at, weight = SHARES[:, :1] * step, SHARES[:, 1:] / step
    still = np.zeros((len(at), model.n))
    return np.full(len(at), t), q + at * way, still, still, np.tile(lam, (len(at), 1)), weight * w, weight * mu


class Objective:
    """Base class of objectives: a number `objective(run)` of a run, with its derivatives `slopes(run)`.

    A run has model, t, q, v, a and lam; an equilibrium is a run of one frame. `pi.gradient` calls `objective(run)` once for the value, then
    `slopes(run)` once, and the function that it returns for slice after slice of the frames, from the last to the first. `2.0 * one +
    other`, `one - other` and `sum([...])` are objectives again. UserObjective makes one of two functions.

    Attributes
    ----------
    of_frames : bool
        False if J depends on the model alone: `pi.gradient` then takes no backward sweep.
    """

    of_frames: bool = True

    def __call__(self, run: Any) -> float:
        """Return the value J of a run."""
        raise NotImplementedError(f"{type(self).__name__} gives no value")

    def slopes(self, run: Any) -> Callable[[slice], Slopes]:
        """Return a function of a slice of frames that returns their Slopes.

        Its attribute `value` is J if that is known by then. `quadrature`, if it has one, is a function of the smooth pieces of the run,
        (first frame, last frame, state behind the first frame as a OneFrame or None) each: what J, a sum over frames, lacks of an integral,
        (frames - 1,).
        """
        raise NotImplementedError(f"{type(self).__name__} gives no slopes")

    def named(self, model: Any) -> Objective:
        """Return the objective with names instead of parts of a model, for models with other values of parameters."""
        return self

    def largest(self, run: Any) -> float | None:
        """Return the maximum over the frames of a run that J approximates from below; None if J stands for no maximum."""
        return None

    def __add__(self, other: Objective) -> Sum:
        """Return the sum with another objective."""
        return Sum((*terms_of(self), *terms_of(other)))

    def __radd__(self, other: Any) -> Objective:
        """Return the sum with an objective on the left; 0 there adds nothing, for `sum([...])`."""
        return self if is_number(other) and other == 0 else Sum((*terms_of(other), *terms_of(self)))

    def __sub__(self, other: Objective) -> Sum:
        """Return the difference to another objective."""
        return self + -require_objective("a sum of objectives", other)

    def __mul__(self, number: float) -> Sum:
        """Return the objective times a finite number. Raises InputError for any other factor."""
        if not is_number(number):
            raise InputError(f"an objective is multiplied by {number!r:.100}; use a finite number")
        return Sum(tuple((float(number) * weight, part) for weight, part in terms_of(self)))

    __rmul__ = __mul__

    def __truediv__(self, number: float) -> Sum:
        """Return the objective over a number. Raises InputError for zero, and for what is no finite number."""
        if not (is_number(number) and number != 0):
            raise InputError(f"an objective is divided by {number!r:.100}; use a finite number that is not zero")
        return self * (1.0 / number)

    def __neg__(self) -> Sum:
        """Return the objective times -1, for differences of objectives."""
        return self * -1.0


@dataclass(frozen=True, eq=False)
class Sum(Objective):
    """A weighted sum of objectives.

    Parameters
    ----------
    terms : tuple of (weight, objective)
    """

    terms: tuple[tuple[float, Objective], ...]

    @property
    def of_frames(self) -> bool:  # type: ignore[override]
        """True if a term depends on frames."""
        return any(part.of_frames for _, part in self.terms)

    def __call__(self, run: Any) -> float:
        """Return the weighted sum of the values of its objectives."""
        return float(sum(weight * part(run) for weight, part in self.terms))

    def named(self, model: Any) -> Sum:
        """Return the sum with names instead of parts of a model in its objectives."""
        return Sum(tuple((weight, part.named(model)) for weight, part in self.terms))

    def slopes(self, run: Any) -> Callable[[slice], Slopes]:
        """Return a function of a slice of frames: the weighted sum of the terms' Slopes."""
        each = [(weight, term, term.slopes(run)) for weight, term in self.terms]

        def of(part):
            """The weighted sum of the Slopes of a slice."""
            total = Slopes()
            for weight, term, slopes in each:
                total = total.plus(slopes_at(term, slopes, run, part).times(weight))
            return total

        if all(hasattr(slopes, "value") for *_, slopes in each):
            of.value = float(sum(weight * slopes.value for weight, _, slopes in each))  # type: ignore[attr-defined]
        rules = [(weight, slopes.quadrature) for weight, _, slopes in each if hasattr(slopes, "quadrature")]
        if rules:
            of.quadrature = lambda pieces: np.sum([w * lacks(pieces) for w, lacks in rules], axis=0)  # type: ignore[attr-defined]
        return of


def call_user(label: str, function: Callable, *arguments: Any, advice: str = "") -> Any:
    """The value of a user's function; its exceptions become an InputError that begins with `label`."""
    try:
        return function(*arguments)
    except InputError:
        raise
    except Exception as error:
        raise InputError(f"{label} raised {type(error).__name__}: {error}{advice}") from error


def require_objective(part: str, objective: Any) -> Objective:
    """The objective; InputError, in the name of `part`, for anything else."""
    if not isinstance(objective, Objective):
        raise InputError(
            f"{part}: objective = {objective!r:.100} must be one of pi.objective, such as pi.objective.UserObjective(value, slopes)"
        )
    return objective


def terms_of(objective):
    """(weight, objective) of each term of a sum, or of the objective itself."""
    return objective.terms if isinstance(objective, Sum) else ((1.0, require_objective("a sum of objectives", objective)),)


@named_keywords
@dataclass(frozen=True, eq=False)
class Limit:
    """`J <= upper` of a design.

    Parameters
    ----------
    objective : Objective
        J. If it stands for a maximum (PeakStress, PeakReaction, PeakTorque, PeakPower), the limit holds for the maximum over the frames
        itself: `J (max / J) <= upper` with the ratio of the last stage of the optimiser.
    upper : float
        In the unit of J; not zero.
    case : str, optional
        Name of the load case that it holds in; by default all.

    Raises
    ------
    InputError
        For anything else.
    """

    objective: Objective
    upper: float
    case: str | None = None

    def __post_init__(self):
        """Check the fields. Raises InputError for what is no Objective, and for an upper that is zero or not finite."""
        require_objective("Limit", self.objective)
        if not (is_number(self.upper) and self.upper):
            raise InputError(f"Limit: upper = {self.upper!r:.100} must be a finite number that is not zero, in the unit of the objective")

    def value(self, run: Any) -> float:
        """Return the maximum that the objective stands for, or J."""
        largest = self.objective.largest(run)
        return self.objective(run) if largest is None else largest


class OneFrame(NamedTuple):
    """A state of a model as a run of one frame, with the modes about it or None."""

    model: Any
    t: NDArray
    q: NDArray
    v: NDArray
    a: NDArray
    lam: NDArray
    modes: Any = None


def run_of(part: str, subject: Any) -> Any:
    """The run, or an equilibrium or modes as a OneFrame; InputError, in the name of `part`, for anything else."""
    if isinstance(subject, OneFrame):
        return subject
    if isinstance(subject, Equilibrium):
        return _one_frame(subject.model, subject)
    if hasattr(subject, "roots") and hasattr(subject, "shapes"):
        return _one_frame(subject.model, subject.state, subject)
    if not all(hasattr(subject, name) for name in OneFrame._fields[:-1]) or not len(subject.t):
        raise InputError(f"{part}: {subject!r:.100} is no run with frames, no equilibrium of pi.static and no pi.modes")
    if subject.model is None and hasattr(subject, "known_model"):
        subject.known_model(part)
    return subject


def _one_frame(model, state, modes=None):
    """A state as a run of one frame."""
    frames = (np.asarray(x, float)[None] for x in (state.t, state.q, state.v, state.a, state.lam))
    return OneFrame(model, *frames, modes)


@named_keywords
class UserObjective(Objective):
    """An objective made of two functions of the user.

    Parameters
    ----------
    value : function f(run) -> float
        J.
    slopes : function f(run) -> dict
        {"q": dJ/dq (frames, n), "v", "a": the same shape, "lam": (frames, m), "t": (frames,)}; a missing entry is zero. If J depends on a
        parameter directly, the dict has the derivative at fixed frames under the parameter's name too, such as "arm.mass". Without any such
        name, direct derivatives in parameters that `pi.gradient` is asked for by name (`body.inertia`) are differences of value(run).
        The v of frame 0 is that before the integrator's start and has no slope.

    Raises
    ------
    InputError
        If they are not functions; of a run for other names and shapes, and for numbers that are not finite.
    """

    def __init__(self, value: Callable[[Any], float], slopes: Callable[[Any], Mapping[str, Any]]) -> None:
        """Check that both arguments are functions."""
        for name, function in (("value", value), ("slopes", slopes)):
            if not callable(function):
                raise InputError(f"UserObjective: {name} = {function!r:.100} must be a function of a run")
        self._value, self._slopes = value, slopes

    def __call__(self, run: Any) -> float:
        """Return the value of the user's function. Raises InputError unless it is a finite number."""
        result = _call("value", self._value, run_of("UserObjective", run))
        if not is_number(result):
            raise InputError(f"UserObjective: value(run) must return a finite number, not {result!r:.100}")
        return float(result)

    def slopes(self, run: Any) -> Callable[[slice], Slopes]:
        """Call the user's slopes with the run; return a function of a slice of frames that returns the Slopes of these frames.

        Slopes in parameters come only with the slice that has the last frame.
        """
        run = run_of("UserObjective", run)
        result = _call("slopes", self._slopes, run)
        if not isinstance(result, Mapping):
            raise InputError(f"UserObjective: slopes(run) must return a dictionary, not {result!r:.100}")
        frames = {name: _checked(name, value, np.shape(getattr(run, name))) for name, value in result.items() if name in FRAMES}
        direct = {name: _checked(name, value) for name, value in result.items() if name not in FRAMES}

        def of(part):
            """The Slopes of a slice of frames; slopes in parameters come with the slice that has the last frame."""
            whole = part.indices(len(run.t))[1] == len(run.t)
            of_model = elsewhere if whole and not direct else None
            return Slopes(**{name: value[part] for name, value in frames.items()}, direct=direct if whole else {}, of_model=of_model)

        def elsewhere(model):
            """The value of the run with the frames held and another model."""
            try:
                return self(replace(run, model=model) if is_dataclass(run) else run._replace(model=model))
            except InputError as error:
                raise InputError(
                    f"UserObjective: value(run) fails for the same frames of a model with another number: {error}; use names of parts"
                ) from None

        return of


def _call(name, function, run):
    """What the user's function of that name returns for a run. Raises InputError, with its name, for an exception."""
    return call_user(f"UserObjective: {name}(run), the function {getattr(function, '__name__', type(function).__name__)},", function, run)


def _checked(name, value, shape=None):
    """The slope of that name as floats, of a shape, or of any shape if it is a parameter's."""
    if not isinstance(name, str) or (shape is None and "." not in name):
        raise InputError(
            f"UserObjective: slopes(run) has {name!r:.100}; known: {', '.join(map(repr, FRAMES))}, and parameters, as 'arm.mass'"
        )
    array = floats(value)
    if array is None or (shape is not None and array.shape != shape):
        expected = "finite numbers" if shape is None else f"finite numbers of shape {shape}"
        raise InputError(f"UserObjective: slopes(run)[{name!r}], {value!r:.100}, must be {expected}")
    return array
