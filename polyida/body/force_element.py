"""What every force of one's own is: sides, and the forces on them."""

from dataclasses import fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polyida.body.own_part import OwnPart, require_whole, writes
from polyida.errors import InputError
from polyida.given import floats
from polyida.joint.attachment import Attachment, Ground


class ForceElement(OwnPart):
    """A force on attachments, written in Python: a frozen dataclass with a field `name`, `sides()` and `forces(t, x, v)`.

    Its fields (numbers, profiles, attachments) are its data and are saved with it. Its functions get the places x, m, and
    velocities v, m/s, of its sides, (sides, 2) each, to read only. What it does not write of the rest is taken by differences,
    or is not there. A scene with such forces goes through the integrators' plain paths, which its summaries say.
    Instead of `forces` it may have `law`, a function decorated with `numba.njit`: `law(t, x, v, data, f)` fills f (sides, 2), N, where
    data are the element's `numbers()`. Kernels call it by its address, and take its slopes by differences; where all force elements of
    a scene have one, generalized-alpha, Radau IIA and IDA keep their compiled loops.
    """

    law = None

    def sides(self) -> tuple:
        """What it acts on: a tuple of attachments and places of the ground (`ground.at`)."""
        raise NotImplementedError

    def forces(self, t: float, x: NDArray, v: NDArray) -> NDArray:
        """Forces on the sides, (sides, 2), N."""
        f = np.full(x.shape, np.nan)
        type(self).law(float(t), np.array(x), np.array(v), numbers_of(self), f)  # type: ignore[misc]
        return f

    def numbers(self) -> ArrayLike:
        """What `law` gets as data, finite numbers: those among its fields, one after the other."""
        values = [floats(getattr(self, field.name)) for field in fields(self)]  # type: ignore[arg-type]
        return np.concatenate([np.zeros(0), *(value.ravel() for value in values if value is not None)])

    def forces_x(self, t: float, x: NDArray, v: NDArray) -> NDArray | None:
        """Derivatives of the forces in the places, (sides, 2, sides, 2), N/m; None: by differences."""
        return None

    def forces_v(self, t: float, x: NDArray, v: NDArray) -> NDArray | None:
        """Derivatives of the forces in the velocities, (sides, 2, sides, 2), N s/m; None: by differences."""
        return None

    def energy(self, x: NDArray) -> float | None:
        """Potential energy at the places x, J, of which `forces` are the falling slope, as far as they have one; None: they have none."""
        return None


def require_element(element):
    """Raise InputError unless the class of a force element is whole."""
    law = type(element).law
    require_whole(element, ForceElement, ("sides",) if law else ("sides", "forces"))
    if law and not hasattr(law, "py_func"):
        raise InputError(f"{element.label}: its law is {law!r:.80}; it must be a function decorated with numba.njit")
    if law and writes(element, ForceElement, "forces"):
        raise InputError(f"{element.label}: its class gives forces() and a law; it must give one of them")


def numbers_of(element):
    """The numbers of an element's law as one array. Raises InputError."""
    found = floats(element.numbers())
    if found is None or found.ndim != 1:
        raise InputError(f"{element.label}: numbers() must give a list of finite numbers")
    return found


def sides_of(name, element):
    """The sides of a force element, looked at. Raises InputError naming it."""
    sides = element.sides()
    if not isinstance(sides, (tuple, list)) or not any(isinstance(side, Attachment) for side in sides):
        wanted = "a tuple of attachments, like (self.at,), one at least of a body"
        raise InputError(f"{name}: sides() gave {str(sides)[:80]}; it must give {wanted}")
    for side in sides:
        if not isinstance(side, Attachment) and not (isinstance(side, Ground) and side.point is not None):
            hint = "use plate.section(...), plate.node(...), body.at(...) or ground.at(point)"
            raise InputError(f"{name}: the side {str(side)[:80]} is no attachment; {hint}")
    return tuple(sides)
