"""The base class of forces on attachments, and its sides."""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, fields
from inspect import Parameter, signature
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from polyida.body.body import compiled_functions, require_arguments, require_whole, writes
from polyida.errors import InputError
from polyida.joint.attachment import Attachment, Ground, OwnPart
from polyida.joint.formula import Vector
from polyida.profile import Profile
from polyida.validation import floats, reals, settle


class ForceElement(OwnPart, part=False):
    """A force on attachments: base class of a user's frozen dataclass with a field `name`, `sides()` and `forces(t, x, v)`.

    It may have states s, numbers of its own with `s' = rates(t, x, v, s)`: a class with `states = ("current", ...)` writes
    `rates(t, x, v, s)` and `forces(t, x, v, s)`, with an energy `energy(x, s)`. `run.states(name)` returns them.

    States may also be algebraic: a class with `algebraic = ("pressure", ...)` has these behind `states` in s, and the last entries of `rates`
    are zero: `0 = rates(t, x, v, s)`. They are found by Newton's method from `start()`, where forces are evaluated, and have no energy. The
    slope of the last rates in the algebraic states must be regular.

    Its fields (numbers, profiles, attachments) are its data; files store them. A side is a point, or the direction d of an attachment
    (`at.d`) without unit; the force on a direction is the generalised one, J: a moment M is `M i d / |d|^2`, where i d is d turned by
    +90 degrees. x and v, (sides, 2), are read-only. Derivatives that a class does not define are computed by differences.

    `@polyida.compiled` above the class lets numba compile `forces` and `energy`; else compiled steps call them in Python, which run summaries
    say. They must depend on their arguments and fields alone. Slopes in compiled code are differences: `forces_x` and `forces_v` serve
    equilibria, modes and other code in Python. A force that acts only in a part of space needs a `gap`: without it a step may cross that part
    unnoticed.

    Attributes
    ----------
    dissipates : bool
        True if the work beyond the energy is reported as dissipated, False if it is reported as work.
    works : bool
        True if the forces do work beyond the energy even at v = 0, as a spring with an actuator does. If False, `forces` at v = 0 must be
        minus the gradient of `energy` (unless they depend on t): `check_derivatives` reports it and EnergyMomentum requires it.
    states : tuple of str
        Names of its states; a class attribute or a property.
    algebraic : tuple of str
        Names of its algebraic states, in the same way.
    """

    dissipates = False
    works = False
    states: tuple[str, ...] = ()
    algebraic: tuple[str, ...] = ()

    def compiled_functions(self) -> dict[str, Any]:
        """Return {"forces", "energy", "rates": function(self, ...)} for numba; empty for Python."""
        return compiled_functions(self, ForceElement, "forces", "energy", "rates")

    def sides(self) -> Sequence:
        """Return what it acts on: attachments, places of the ground (`ground.at`), or directions of both (`.d`)."""
        raise NotImplementedError

    def forces(self, t: float, x: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the forces on the sides, (sides, 2), N; on a direction J. x in m, v in m/s, t in s."""
        raise NotImplementedError

    def forces_x(self, t: float, x: np.ndarray, v: np.ndarray) -> np.ndarray | None:
        """Return d forces / dx, (sides, 2, sides, 2), N/m; None: by differences, as always with states."""
        return None

    def forces_v(self, t: float, x: np.ndarray, v: np.ndarray) -> np.ndarray | None:
        """Return d forces / dv, (sides, 2, sides, 2), N s/m; None: by differences, as always with states."""
        return None

    def rates(self, t: float, x: np.ndarray, v: np.ndarray, s: np.ndarray) -> ArrayLike:
        """Return s', (states,), in the states' units per s; behind them what is zero for algebraic states."""
        raise NotImplementedError

    def require(self) -> None:
        """Raise InputError unless what is special to its class is right; `Scene.add` calls it."""

    def sizes(self) -> ArrayLike:
        """Return typical sizes of the states and then of the algebraic states, (states,), positive; ones by default.

        Tolerances of s are relative to them.
        """
        return np.ones(len(self.states) + len(self.algebraic))

    def start(self) -> ArrayLike:
        """Return the states at the start, (states,), of algebraic ones a guess; 0 by default."""
        return np.zeros(len(self.states) + len(self.algebraic))

    def energy(self, x: np.ndarray) -> float | None:
        """Return the potential energy, J, of the conservative part of the forces; None: no potential."""
        return None

    def gap(self, x: np.ndarray) -> "ArrayLike | None":
        """Return one or several numbers that are negative while a force acts and positive otherwise; None: the forces do not switch.

        Steps of all integrators end where one of them changes sign, and are short enough after it.
        """
        return None

    def undefined(self, x: np.ndarray) -> str:
        """Return the reason why the forces are not finite at x; empty if unknown."""
        return ""


@dataclass(frozen=True)
class Side:
    """What a force acts on: the "point" or "direction" of an attachment `at`, or the fixed place `rest` (2,) if `at` is None."""

    at: Any
    part: str
    rest: np.ndarray

    def size(self, extent: float) -> float:
        """Return the characteristic size: the scene's extent, m, of a point; 1 of a direction."""
        return extent if self.part == "point" else 1.0


def require_element(element):
    """Raise InputError if the class of a force element is incomplete, or its states are wrong."""
    require_whole(element, ForceElement, ("sides", "forces"))
    element.require()
    label = element.label
    for field in ("states", "algebraic"):
        names = getattr(element, field)
        if not isinstance(names, tuple) or not all(isinstance(name, str) and name for name in names) or len({*names}) < len(names):
            raise InputError(f"{label}: {field} = {names!r:.80} must be a tuple of different names")
    names, outputs = element.states + element.algebraic, getattr(element, "outputs", ())
    if both := {*element.states} & {*element.algebraic}:
        raise InputError(f"{label}: {min(both)!r} is in states and in algebraic")
    behind = "s" * bool(names or outputs) + "u" * bool(outputs)
    moving, held = "txv" + behind, "x" + behind * bool(element.states or outputs)
    if bool(names) != writes(element, ForceElement, "rates"):
        lacking = (
            f"no rates({', '.join(moving)}): it must return their derivatives" if names else "rates(), but no states: it must name them"
        )
        raise InputError(f"{label}: its class has {f'the states {names} and ' * bool(names)}{lacking}")
    others = {"sides": "", "sizes": "", "start": "", "gap": "x", "undefined": "x", "energy": held}
    require_arguments(element, ForceElement, {"forces": moving, "rates": moving} | others)
    for slope in ("forces_x", "forces_v"):
        if names and writes(element, ForceElement, slope):
            raise InputError(f"{label}: {slope}() of an element with states is not used; remove it: its slopes are differences of forces()")
    for function, good in (("sizes", lambda x: (x > 0).all()), ("start", lambda x: True)) if names else ():
        values = floats(getattr(element, function)())
        if values is None or values.shape != (len(names),) or not good(values):
            wanted = f"{len(names)} {'positive' if function == 'sizes' else 'finite'} numbers, one for each of its states {names}"
            raise InputError(f"{label}: {function}() gave {str(getattr(element, function)())[:80]}; it must give {wanted}")


def profiles_of(part):
    """Return a list of the Profiles in the dataclass fields of a part, in their order: single ones and those in a tuple."""
    values = (getattr(part, field.name) for field in fields(part) if field.init)
    return [one for value in values for one in (value if isinstance(value, tuple) else (value,)) if isinstance(one, Profile)]


def sides_of(name, element):
    """Return the Sides of a force element. Raise InputError naming it if `sides()` returns anything else."""
    listed = element.sides()
    sides = []
    for side in listed if isinstance(listed, (tuple, list)) else ():
        place = side.x if isinstance(side, Attachment) or (isinstance(side, Ground) and side.point is not None) else side
        (summand,) = place.summands if isinstance(place, Vector) and len(place.summands) == 1 else (None,)
        terms = [] if summand is None else summand.terms
        plain = summand is not None and summand.profile is None and [w for _, _, w in terms] in ([], [1.0])
        if not plain or (terms and summand.constant):
            hint = "use plate.section(...), plate.node(...), body.at(...) or ground.at(point), or the .d of one of them"
            raise InputError(f"{name}: the side {str(side)[:80]} is no attachment; {hint}")
        at, part = terms[0][:2] if terms else (None, summand.of_ground[0][1] if summand.of_ground else "point")
        sides.append(Side(at, part, np.array([summand.rest.real, summand.rest.imag])))
    if not any(side.at for side in sides):
        expected = "a tuple of attachments, like (self.at,), one at least of a body"
        raise InputError(f"{name}: sides() gave {str(listed)[:80]}; it must give {expected}")
    return tuple(sides)


def takes_three(function):
    """True if a function requires three arguments: it is a function of state, not of time."""
    try:
        parameters = signature(function).parameters.values()
    except (TypeError, ValueError):
        return False
    plain = (Parameter.POSITIONAL_ONLY, Parameter.POSITIONAL_OR_KEYWORD)
    return sum(p.kind in plain and p.default is p.empty for p in parameters) == 3


def with_checked_function(element, field, arguments, shape=()):
    """Return the element, in Python, with a user's function that raises InputError unless it returns real numbers of a shape."""

    def checked(*values):
        """Call the user's function. Raises InputError unless it returns real numbers of the shape."""
        answer = function(*values)
        numbers = reals(answer)
        if numbers is None or numbers.shape != shape:
            expected = "two numbers" if shape else "a number"
            raise InputError(f"{element.label}: {field}({arguments}) must return {expected}, not {str(answer)[:80]}")
        return numbers if shape else float(numbers)

    if not callable(function := getattr(element, field)):
        return element
    other = copy(element)
    settle(other, **{field: checked})
    return other
