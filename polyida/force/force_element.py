"""What every force of one's own is: sides, and the forces on them."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polyida.body.body import OwnPart, compiled_functions, require_whole
from polyida.errors import InputError
from polyida.joint.attachment import Attachment, Ground
from polyida.joint.formula import Vector
from polyida.profile import Profile


class ForceElement(OwnPart):
    """A force on attachments: a frozen dataclass with a field `name`, `sides()` and `forces(t, x, v)`.

    Its fields (numbers, profiles, attachments) are its data and are saved with it. Its functions get the places x, m, and
    velocities v, m/s, of its sides, (sides, 2) each, to read only. A side is a point, or the direction of an attachment, `at.d`: its
    "place" is then the direction d, and the force on it the generalised one, J: `M i d / |d|^2` is a moment M. What it does not
    write of the rest is taken by differences, or is not there. A scene with forces in Python goes through the integrators' plain paths,
    which its summaries say. With `@polyida.compiled` above the class numba compiles `forces` and `energy`, and integrators keep their
    compiled loops if all force elements of a scene are compiled.
    A force that acts only in a part of space gives a `gap`; without one it may be stepped over, and nothing in the result shows it.
    dissipates: whether what its forces do beyond its energy is reported as dissipated, and not as work. works: whether they do more than
    its energy says where nothing moves, as of a spring with an actuator; else `forces` at v = 0 must be the falling slope of an `energy`
    that is given (unless they depend on t), which `check_derivatives` reports and the energy-momentum method requires.
    """

    dissipates = False
    works = False

    def compiled_functions(self) -> dict[str, Any]:
        """{"forces", "energy": function(self, ...)} that numba compiles, empty where it is Python."""
        return compiled_functions(self, ForceElement, "forces", "energy")

    def sides(self) -> Sequence:
        """What it acts on: attachments, places of the ground (`ground.at`), directions of both (`.d`)."""
        raise NotImplementedError

    def forces(self, t: float, x: NDArray, v: NDArray) -> NDArray:
        """Forces on the sides, (sides, 2), N; on a direction J."""
        raise NotImplementedError

    def forces_x(self, t: float, x: NDArray, v: NDArray) -> NDArray | None:
        """Derivatives of the forces in the places, (sides, 2, sides, 2), N/m; None: by differences."""
        return None

    def forces_v(self, t: float, x: NDArray, v: NDArray) -> NDArray | None:
        """Derivatives of the forces in the velocities, (sides, 2, sides, 2), N s/m; None: by differences."""
        return None

    def energy(self, x: NDArray) -> float | None:
        """Potential energy at the places x, J, of which `forces` are the falling slope, as far as they have one; None: they have none."""
        return None

    def gap(self, x: NDArray) -> ArrayLike | None:
        """Where the forces switch at the places x: a number or several, each negative where a force acts and positive where it does not.

        Steps of all integrators end where one of them changes sign, and are short enough behind it; None: the forces have no switch.
        """
        return None

    def undefined(self, x: NDArray) -> str:
        """Why the forces are not finite at the places x, in words; empty where it cannot say."""
        return ""


@dataclass(frozen=True)
class Side:
    """What a force acts on: the "point" or "direction" of an attachment, None where it stays at `rest` (2,) with the ground."""

    at: Any
    part: str
    rest: NDArray

    def size(self, extent: float) -> float:
        """Of what it says of itself: a scene's extent, m, or that of a direction, one."""
        return extent if self.part == "point" else 1.0


def require_element(element):
    """Raise InputError unless the class of a force element is whole."""
    require_whole(element, ForceElement, ("sides", "forces"))


def profiles_of(part):
    """The profiles in a part's fields, alone or in tuples."""
    given = (getattr(part, field.name) for field in fields(part) if field.init)
    return [one for value in given for one in (value if isinstance(value, tuple) else (value,)) if isinstance(one, Profile)]


def sides_of(name, element):
    """The Sides of a force element, looked at. Raises InputError naming it."""
    given = element.sides()
    found = [(side, _side(side)) for side in given] if isinstance(given, (tuple, list)) else []
    for side, known in found:
        if known is None:
            hint = "use plate.section(...), plate.node(...), body.at(...) or ground.at(point), or the .d of one of them"
            raise InputError(f"{name}: the side {str(side)[:80]} is no attachment; {hint}")
    if not any(side.at for _, side in found):
        wanted = "a tuple of attachments, like (self.at,), one at least of a body"
        raise InputError(f"{name}: sides() gave {str(given)[:80]}; it must give {wanted}")
    return tuple(side for _, side in found)


def _side(given):
    """The Side that an attachment, a place of the ground, or the x or d of one of them is; None for anything else."""
    if isinstance(given, Attachment) or (isinstance(given, Ground) and given.point is not None):
        given = given.x
    if not (isinstance(given, Vector) and len(given.pieces) == 1):
        return None
    (piece,) = given.pieces
    if piece.profile is not None or [w for _, _, w in piece.terms] not in ([], [1.0]) or (piece.terms and piece.constant):
        return None
    at, part = piece.terms[0][:2] if piece.terms else (None, "point")
    return Side(at, part, np.array([piece.rest.real, piece.rest.imag]))
