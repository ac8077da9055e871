"""What every force of one's own is: sides, and the forces on them."""

from numpy.typing import NDArray

from polyida.body.own_part import OwnPart, require_whole
from polyida.errors import InputError
from polyida.joint.attachment import Attachment, Ground


class ForceElement(OwnPart):
    """A force on attachments, written in Python: a frozen dataclass with a field `name`, `sides()` and `forces(t, x, v)`.

    Its fields (numbers, profiles, attachments) are its data and are saved with it. Its functions get the places x, m, and
    velocities v, m/s, of its sides, (sides, 2) each, to read only. What it does not write of the rest is taken by differences,
    or is not there. A scene with such forces goes through the integrators' plain paths, which its summaries say.
    """

    def sides(self) -> tuple:
        """What it acts on: a tuple of attachments and places of the ground (`ground.at`)."""
        raise NotImplementedError

    def forces(self, t: float, x: NDArray, v: NDArray) -> NDArray:
        """Forces on the sides, (sides, 2), N."""
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


def require_element(element):
    """Raise InputError unless the class of a force element is whole."""
    require_whole(element, ForceElement, ("sides", "forces"))


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
