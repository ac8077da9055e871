"""Time profiles of motors and loads: a value with its first and second derivative in time, and the times of its kinks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial
from math import isfinite
from warnings import warn

import numpy as np
from numpy.polynomial.polynomial import polyder
from numpy.typing import ArrayLike, NDArray

from polyida.errors import InputError
from polyida.model.differences import around, within
from polyida.reprs import cut, short
from polyida.samples import baseline as line_too_much
from polyida.samples import continued, evaluated, joined, kinks_of
from polyida.validation import LARGEST, flag, floats, instance, is_number, is_whole, named_keywords, number, positive, takes, vector

__all__ = [
    "Profile",
    "constant",
    "difference",
    "from_function",
    "from_samples",
    "linear",
    "polynomial",
    "quintic",
    "ramp",
    "scaled",
    "sine",
]

SHAPES = {  # coefficients of moves from 0 to 1
    "linear": (0, 1),
    "quintic": (0, 0, 0, 10, -15, 6),
    "ramp": (0, 0, 0, 0, 0, 126, -420, 540, -315, 70),
}
SAMPLES = "samples"  # the kind of profiles through samples, of whose formula the other entries are the arguments of `from_samples`
MEASURED = ("samples", "samples of the rate", "samples of the second derivative")
APART = 1e-12  # least distance of samples, relative to 1 s or the largest time
DRIFT = 0.01  # of the largest velocity: what may remain at the end of an acceleration that was integrated twice, without a warning
REACH = {1: 2e-5, 2: 2e-4}  # s between the values of which differences make a first or second derivative; it resolves 1 kHz or 100 Hz


def __dir__():
    """Return the public names of the module, `__all__`, for `dir()`."""
    return __all__


@named_keywords
@dataclass(frozen=True)
class Profile:
    """A function of time with its first and second derivative.

    Profiles can be pickled if their functions can: those of this module always, a user's if they are defined in a module.

    Parameters
    ----------
    value, d1, d2 : function of t
        Value and derivatives.
    kinks : tuple of float, s
        Times at which the profile is not smooth.
    formula : tuple
        (kind, numbers) of a profile made by this module, which files can hold; empty for others.
    shortest : float, s, optional
        The shortest time in which the profile moves and comes to rest or turns back. None if unknown: solvers then look for pulses that
        lie between their steps.
    takes_arrays : bool
        True if the functions take arrays of times too.
    """

    value: Callable
    d1: Callable
    d2: Callable
    kinks: tuple = ()
    formula: tuple = ()
    shortest: float | None = None
    takes_arrays: bool = False

    def __repr__(self):
        """Kind and numbers; of samples their number, times and the end; of a user's function its name."""
        if self.formula[:1] == (SAMPLES,):
            t, derivative = self.formula[1], self.formula[3]
            return f"Profile({len(t)} {MEASURED[derivative]} from {t[0]:g} to {t[-1]:g} s, {_at_end(self, t[-1])})"
        inner = getattr(self.value, "args", ())[:1] or [self.value]
        return f"Profile({cut(', '.join(map(str, self.formula)) or getattr(inner[0], '__name__', type(inner[0]).__name__))})"

    def __call__(self, t: float) -> float:
        """Return the value of the profile at time t, s."""
        return self.value(t)

    def at(self, t: float) -> tuple[float, float, float]:
        """Evaluate value, first and second derivative at a time t, s."""
        return self.value(t), self.d1(t), self.d2(t)

    def over(self, t: NDArray, order: int = 0) -> NDArray:
        """Evaluate the derivative of order 0, 1 or 2 at times t, s, of any shape."""
        function = (self.value, self.d1, self.d2)[order]
        if self.formula or self.takes_arrays:
            return np.broadcast_to(function(t), t.shape)
        return np.array([function(at) for at in t.ravel().tolist()]).reshape(t.shape)


@named_keywords
def constant(value: float) -> Profile:
    """Make a profile with the same value at all times.

    Parameters
    ----------
    value : float

    Returns
    -------
    Profile
        The constant.
    """
    _require_numbers("constant", value=value)
    return polynomial([value])


@named_keywords
def polynomial(coefficients: ArrayLike) -> Profile:
    """Make the profile `c0 + c1 t + c2 t^2 + ...`.

    Parameters
    ----------
    coefficients : (k,) float
        c0, c1, c2, ...

    Returns
    -------
    Profile
        The polynomial.
    """
    numbers = floats(coefficients)
    if numbers is None or numbers.ndim != 1 or not numbers.size:
        raise InputError(f"profile.polynomial: coefficients = {coefficients!r} must be finite numbers, at least one")
    value, first, second = _with_derivatives(tuple(numbers.tolist()))
    return Profile(value, first, second, formula=("polynomial", *numbers.tolist()), shortest=np.inf)


@lru_cache(maxsize=64)
def _with_derivatives(c):
    """The polynomial `c0 + c1 t + ...` and its first two derivatives, as functions of t."""
    return tuple(partial(_horner, tuple(polyder(np.array(c, float), order).tolist())) for order in range(3))


def _horner(c, t):
    """`c0 + c1 t + ...` at a time, or at each of an array: for one time several times faster than numpy's."""
    total = c[-1] + 0.0 * t
    for coefficient in c[-2::-1]:
        total = total * t + coefficient
    return total


@named_keywords
def quintic(start: float, end: float, duration: float, begin: float = 0.0) -> Profile:
    """Make a smooth move, `start + (end - start)(10 s^3 - 15 s^4 + 6 s^5)`, s = (t - begin)/duration limited to [0, 1].

    Velocity and acceleration are zero at both ends.

    Parameters
    ----------
    start, end : float
        Values before and after the move.
    duration : float, s
        Above 0.
    begin : float, s

    Returns
    -------
    Profile
        The move.
    """
    return _move(start, end, duration, begin, "quintic")


@named_keywords
def ramp(start: float, end: float, duration: float, begin: float = 0.0) -> Profile:
    """Make a move of class C^4, the smooth step of ninth degree.

    Parameters
    ----------
    start, end, duration, begin
        As of `quintic`.

    Returns
    -------
    Profile
        The move.
    """
    return _move(start, end, duration, begin, "ramp")


@named_keywords
def linear(start: float, end: float, duration: float, begin: float = 0.0) -> Profile:
    """Make a linear move from start to end, with a kink at both ends.

    Parameters
    ----------
    start, end, duration, begin
        As of `quintic`.

    Returns
    -------
    Profile
        The move.
    """
    return _move(start, end, duration, begin, "linear")


def _require_numbers(kind, **values):
    """Raise InputError unless all arguments, by their names, of a profile of that kind are finite numbers."""
    for name, value in values.items():
        number(f"profile.{kind}", name, value, "its unit")


def _move(start, end, duration, begin, kind):
    """The Profile of a move from start to end in the shape of a kind of SHAPES."""
    _require_numbers(kind, start=start, end=end, duration=duration, begin=begin)
    duration = positive(f"profile.{kind}", "duration", duration, "seconds")
    shape, first, second = _with_derivatives(SHAPES[kind])
    start, end, duration, begin = map(float, (start, end, duration, begin))
    span = end - start
    value = partial(_moved, shape, span, start, span, duration, begin)
    d1, d2 = (partial(_moved, each, span / duration**order, 0.0, 0.0, duration, begin) for order, each in ((1, first), (2, second)))
    return Profile(value, d1, d2, (begin, begin + duration), (kind, start, end, duration, begin), duration)


def _moved(function, factor, start, span, duration, begin, t):
    """`start + factor function(s)` within a move, start before it, start + span behind it: its value or, from 0 to 0, a derivative."""
    s = (np.asarray(t, float) - begin) / duration
    if not s.ndim:
        return factor * function(s) + start if 0 < s < 1 else np.float64(span * (s >= 1) + start)
    clamped = np.where(s >= 1, span, 0.0) + start
    return np.where((s > 0) & (s < 1), factor * function(np.clip(s, 0.0, 1.0)) + start, clamped)[()]


@named_keywords
def sine(amplitude: float, frequency: float, phase: float = 0.0) -> Profile:
    """Make the profile `amplitude sin(2 pi frequency t + phase)`.

    Parameters
    ----------
    amplitude : float
    frequency : float, Hz
    phase : float, rad

    Returns
    -------
    Profile
        The oscillation.
    """
    _require_numbers("sine", amplitude=amplitude, frequency=frequency, phase=phase)
    amplitude, frequency, phase = map(float, (amplitude, frequency, phase))
    w = 2 * np.pi * frequency
    waves = (np.sin, amplitude), (np.cos, amplitude * w), (np.sin, -amplitude * w * w)
    value, d1, d2 = (partial(_wave, function, size, w, phase) for function, size in waves)
    return Profile(value, d1, d2, formula=("sine", amplitude, frequency, phase), shortest=0.5 / abs(frequency) if frequency else np.inf)


def _wave(function, size, w, phase, t):
    """Value at time t, s, of `size * function(w t + phase)`; w in rad/s, phase in rad."""
    return size * function(w * t + phase)


@named_keywords
def from_function(
    value: Callable[[float], float],
    d1: Callable[[float], float] | None = None,
    d2: Callable[[float], float] | None = None,
    kinks: ArrayLike = (),
    shortest: float | None = None,
) -> Profile:
    """Make a profile from functions of time.

    Compiled functions (`polyida.compiled`, numba.njit) are called at many times at once, without Python.

    Parameters
    ----------
    value : function f(t) -> float
    d1, d2 : function f(t) -> float, optional
        Derivatives; by default differences of values on one side of all kinks.
    kinks : (k,) float, s
        Times at which the profile is not smooth.
    shortest : float, s, optional
        Its shortest move; by default solvers look for pulses that lie between their steps.

    Returns
    -------
    Profile
        The functions as a profile.

    Raises
    ------
    InputError
        For wrong arguments; and, when the profile is evaluated, if a function returns anything but a finite number.
    """
    for name, function in (("value", value), ("d1", d1), ("d2", d2)):
        if not (callable(function) or (function is None and name != "value")):
            raise InputError(f"profile.from_function: {name} = {function!r} must be a function of t")
    times = floats(kinks)
    if times is None or times.ndim != 1:
        raise InputError(f"profile.from_function: kinks = {kinks!r} must be finite times in s")
    times = np.sort(times)
    if not (shortest is None or (is_number(shortest) and shortest > 0)):
        raise InputError(f"profile.from_function: shortest = {shortest!r} must be a positive time in s")
    _values(value, np.zeros(0))  # a function that numba cannot compile is refused here
    value = partial(_values, value)
    d1, d2 = (function and partial(_values, function) for function in (d1, d2))
    slope, order = (d1, 1) if d1 else (value, 2)
    return Profile(
        value,
        d1 or partial(_derivative, value, 1, times),
        d2 or partial(_derivative, slope, order, times),
        tuple(times.tolist()),
        shortest=shortest,
        takes_arrays=True,
    )


@named_keywords
def from_samples(
    t: ArrayLike, y: ArrayLike, derivative: int = 0, smooth: bool | None = None, baseline: bool = False, start: float = 0.0
) -> Profile:
    """Make a profile from measured values, velocities or accelerations.

    Velocities and accelerations are integrated from `start` at the first sample, accelerations from rest. Before and behind the samples the
    profile is at rest, or goes on at the velocity that it has there if velocities or accelerations were measured. Steps end at all samples.

    Parameters
    ----------
    t : (k,) float, s
        Times of the samples, ascending; two at least.
    y : (k,) float
        Values of the derivative at these times.
    derivative : int
        What was measured: 0 the value, 1 its velocity, 2 its acceleration.
    smooth : bool, optional
        True: a cubic spline through the samples (not-a-knot). False: straight lines between them. By default straight lines for accelerations,
        a spline for the others. A value that drives a joint needs a spline: straight lines would jump in velocity.
    baseline : bool
        True: take a straight line off accelerations so that the motion ends at rest where it began, or a constant off velocities so that it
        ends where it began.
    start : float
        Value at the first sample, of velocities and accelerations.

    Returns
    -------
    Profile
        The curve; `repr(profile)` states the value and velocity at the end, the drift of what was integrated.

    Raises
    ------
    InputError
        For times that do not ascend and other wrong arguments.

    Warns
    -----
    UserWarning
        If an acceleration leaves more than 1 % of the largest velocity at the end.

    Examples
    --------
    >>> t = np.linspace(0.0, 1.0, 101)
    >>> shaken = pi.profile.from_samples(t, 3.0 * np.sin(2.0 * np.pi * t), derivative=2, baseline=True)
    """
    part = "profile.from_samples"
    times, numbers = vector(part, "t", t), vector(part, "y", y)
    if len(times) < 2 or not (np.diff(times) >= APART * max(1.0, np.abs(times).max())).all():
        raise InputError(f"{part}: t = {t!r:.100} must be two ascending times or more, s")
    if len(numbers) != len(times):
        raise InputError(f"{part}: y has {len(numbers)} values, t has {len(times)}")
    if not is_whole(derivative, 0, 2):
        raise InputError(f"{part}: derivative = {derivative!r:.100} must be 0 for values, 1 for velocities or 2 for accelerations")
    smooth = derivative < 2 if smooth is None else flag(part, "smooth", smooth)
    if flag(part, "baseline", baseline) and not derivative:
        raise InputError(f"{part}: baseline = True needs derivative = 1 or 2: values that were measured do not drift")
    start = number(part, "start", start, "the unit of the value")
    if start and not derivative:
        raise InputError(f"{part}: start = {start!r} needs derivative = 1 or 2: values that were measured begin at y[0]")
    made = _through(times, numbers, int(derivative), bool(smooth), bool(baseline), start)
    rates = made.d1(times)
    if derivative == 2 and abs(rates[-1]) > DRIFT * np.abs(rates).max():
        end = _at_end(made, times[-1])
        warn(f"{part}: the motion {end}; if it should be at rest there, baseline=True takes an offset off the accelerations", stacklevel=3)
    return made


def _through(t, y, derivative, smooth, baseline, start):
    """The profile through samples (t, y) with the checked arguments of `from_samples`."""
    t, y = np.array(t, float), np.array(y, float)
    with np.errstate(all="ignore"):
        measured = joined(t, y, smooth)
        if baseline:
            constant, slope = line_too_much(measured, derivative)
            measured = joined(t, y - constant - slope * (t - t[0]), smooth)
        curve = measured.antiderivative(derivative) if derivative else measured
        curve.c[-1] += start
        curve = continued(curve, bool(derivative))
        curves = curve, curve.derivative(1), curve.derivative(2)
    if not all((np.abs(one.c) <= LARGEST).all() for one in curves):
        raise InputError(f"profile.from_samples: y = {short(y)} is too large: the profile or a derivative of it would be above {LARGEST:g}")
    formula = (SAMPLES, tuple(t.tolist()), tuple(y.tolist()), derivative, smooth, baseline, start)
    value, d1, d2 = (partial(evaluated, one) for one in curves)
    return Profile(value, d1, d2, tuple(kinks_of(measured).tolist()), formula, float(np.diff(t).min()))


def _at_end(profile, t):
    """Value and velocity at the end t of a profile through samples, in words."""
    return f"ends at {profile.value(t):.4g} with the velocity {profile.d1(t):.4g} per second"


def _values(function, t):
    """The finite values of a user's function at a time or an array of times."""
    if not np.ndim(t):
        return _checked(function, t)
    from polyida.jit.user_functions import over

    times = np.asarray(t, float)
    values = over("profile", function, times.ravel())
    if values is None or not np.isfinite(values).all():
        values = np.array([_checked(function, at) for at in times.ravel().tolist()])
    return values.reshape(times.shape)


def _checked(function, t):
    """A user's function at one time as a float. Raises InputError unless it is a finite number."""
    value = function(t)
    if type(value) is float and isfinite(value):
        return value
    value = value.item() if isinstance(value, (np.ndarray, np.generic)) and value.ndim == 0 else value
    if not is_number(value):
        name = getattr(function, "__name__", type(function).__name__)
        raise InputError(f"profile {name}: it gives {value!r} at t = {t!r}, a finite number is needed")
    return float(value)


def _derivative(function, order, kinks, t):
    """First or second derivative of a function at t, one time or an array, by differences on one side of all kinks."""
    if not np.ndim(t):
        return float(within(lambda s: function(t + s), around(kinks, t), REACH[order], order))
    bounds, k = np.array([-np.inf, *kinks, np.inf]), np.searchsorted(kinks, t, side="right")
    return within(lambda s: function(t + s), (bounds[k] - t, bounds[k + 1] - t), REACH[order], order)


@named_keywords
def difference(first: Profile, second: Profile) -> Profile:
    """Make the profile `first - second`, its derivatives included.

    Parameters
    ----------
    first, second : Profile

    Returns
    -------
    Profile
        The difference.
    """
    for name, value in (("first", first), ("second", second)):
        instance("profile.difference", name, value, Profile)
    kinks = tuple(sorted({*first.kinks, *second.kinks}))
    pairs = (first.value, second.value), (first.d1, second.d1), (first.d2, second.d2)
    value, d1, d2 = (partial(_less, f, g) for f, g in pairs)
    arrays = all(profile.formula or profile.takes_arrays for profile in (first, second))
    return Profile(value, d1, d2, kinks, takes_arrays=arrays)


def _less(f, g, t):
    """Difference f(t) - g(t) of two functions of time."""
    return f(t) - g(t)


@named_keywords
def scaled(profile: Profile, factor: float) -> Profile:
    """Make the profile `factor * profile`, its derivatives included.

    Parameters
    ----------
    profile : Profile
    factor : float

    Returns
    -------
    Profile
        The product.
    """
    instance("profile.scaled", "profile", profile, Profile)
    _require_numbers("scaled", factor=factor)
    value, d1, d2 = (partial(_times, f, float(factor)) for f in (profile.value, profile.d1, profile.d2))
    return Profile(value, d1, d2, profile.kinks, shortest=profile.shortest, takes_arrays=bool(profile.formula or profile.takes_arrays))


def _times(f, factor, t):
    """Product of a factor and a function of time, at t."""
    return factor * f(t)


def as_profile(source: Profile | Callable[[float], float] | float, part: str) -> Profile:
    """The Profile of a Profile, a number or a function; `part` names the owner in the InputError. It is evaluated at t = 0."""
    if callable(source) and not isinstance(source, Profile) and not takes(source, 1):
        raise InputError(f"{part}: {source!r:.80} is no function of time: it must take t, s, and nothing else")
    if isinstance(source, Profile) or callable(source):
        result = source if isinstance(source, Profile) else from_function(source)
        try:
            value = result.value(0.0)
        except InputError as error:
            raise InputError(f"{part}: {error}") from None
        if np.ndim(value) or not np.issubdtype(np.asarray(value).dtype, np.number) or not np.isfinite(value):
            raise InputError(f"{part}: its profile gives {value!r} at t = 0, a finite number is needed")
        return result
    if is_number(source):
        return constant(float(source))
    raise InputError(f"{part}: {source!r} is no time profile: give a number, a function of t, or polyida.profile.*")


MAKERS: dict[str, Callable[..., Profile]] = {
    "polynomial": lambda *c: polynomial(c),
    "quintic": quintic,
    "ramp": ramp,
    "linear": linear,
    "sine": sine,
    SAMPLES: _through,
}


@named_keywords
def from_formula(formula: tuple) -> Profile | None:
    """The profile that `Profile.formula` describes, or None if the formula is empty."""
    return MAKERS[formula[0]](*formula[1:]) if formula else None
