"""A force at a point: by profiles of time or a function of state, and turning with its body on request."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polyida.errors import InputError
from polyida.force.force_element import ForceElement, by_law
from polyida.force.of_state import answer, is_of_state
from polyida.given import is_flag, settle
from polyida.jit import entry
from polyida.joint.attachment import Attachment, require_attachment
from polyida.keywords import named_keywords
from polyida.profile import Profile, as_profile


@entry
def push(t, x, v, data, f):
    """The force that data are."""
    f[0, 0], f[0, 1] = data[0], data[1]


@entry
def follow(t, x, v, data, f):
    """The force of data's first two turned as the direction, the second side, has been from data's last two; none on the direction."""
    dx, dy = x[1, 0], x[1, 1]
    size = np.sqrt((dx * dx + dy * dy) * (data[2] * data[2] + data[3] * data[3]))
    c, n = (dx * data[2] + dy * data[3]) / size, (dy * data[2] - dx * data[3]) / size
    f[0, 0], f[0, 1] = c * data[0] - n * data[1], n * data[0] + c * data[1]
    f[1, 0] = f[1, 1] = 0.0


@named_keywords
@dataclass(frozen=True, eq=False)
class Force(ForceElement):
    """A force, N, at the point of an attachment.

    force: a pair (fx, fy), each a number, a profile or a function of time; or a function of state `force(t, x, v)` of place, m, and
    velocity, m/s, (2,) each, that gives (fx, fy). follower: whether it turns with the direction of the attachment from where that is in
    the reference configuration. A function of state is Python, and no file holds it.
    Raises InputError for a force that is none of these, and for a follower at an attachment without a direction.
    """

    at: Attachment
    force: Sequence[Profile | Callable[[float], float] | float] | Callable[..., Any]
    follower: bool = False
    name: str | None = None
    law = push

    def __post_init__(self):
        require_attachment(self.label, self.at)
        if not is_flag(self.follower):
            raise InputError(f"{self.label}: follower = {self.follower!r} must be True or False")
        if self.follower and not self.at.has_direction:
            raise InputError(f"{self.label}: {self.at!r} has no direction to follow; {self.at.advice}")
        if is_of_state(self.force, 3):
            return
        if not isinstance(self.force, (tuple, list, np.ndarray)) or len(self.force) != 2:
            raise InputError(f"{self.label}: force = {self.force!r} must be a pair of numbers or profiles, or a function of (t, x, v)")
        settle(self, force=tuple(as_profile(component, self.label) for component in self.force))

    @property
    def compiled_law(self) -> Any:
        """None where the force is Python."""
        return None if callable(self.force) else follow if self.follower else push

    def sides(self) -> tuple:
        """The point, and the direction that it follows."""
        return (self.at, self.at.d) if self.follower else (self.at,)

    def numbers(self) -> list:
        """Both components, and the direction at rest."""
        given: Any = self.force
        return [*given, self.at.d.rest.real, self.at.d.rest.imag] if self.follower else [*given]

    def forces(self, t: float, x: NDArray, v: NDArray) -> NDArray:
        """The force on the point, (1, 2), N, and nothing on a direction that it follows, (2, 2)."""
        if self.compiled_law:
            return by_law(self.compiled_law, self, t, x, v)
        function: Any = self.force
        given = answer(self.label, "force(t, x, v)", function(t, x[0], v[0]), (2,))
        if not self.follower:
            return given[None]
        turn = x[1] @ [1.0, 1j] / self.at.d.rest
        turned = complex(turn / abs(turn) * (given @ [1.0, 1j]))
        return np.array([[turned.real, turned.imag], [0.0, 0.0]])
