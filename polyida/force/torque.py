"""Torque at an attachment."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polyida.compiled import entry
from polyida.errors import InputError
from polyida.force.force_element import ForceElement, by_law
from polyida.force.of_state import answer, is_of_state
from polyida.given import settle
from polyida.joint.attachment import Attachment, require_attachment
from polyida.keywords import named_keywords
from polyida.profile import Profile, as_profile


@entry
def turning(t, x, v, data, f):
    """`M i d / |d|^2` on the direction d: M times the angle's rate is its power."""
    square = x[0, 0] * x[0, 0] + x[0, 1] * x[0, 1]
    f[0, 0], f[0, 1] = -data[0] * x[0, 1] / square, data[0] * x[0, 0] / square


@named_keywords
@dataclass(frozen=True, eq=False)
class Torque(ForceElement):
    """A moment M, N m, counter-clockwise, on an attachment with a direction d: the generalised force `M i d / |d|^2` on d.

    Its work is M times the angle that d turns by. moment: a number, a profile of time, a function of time, or a function of state
    `moment(t, angle, rate)` of three arguments: the angle of d from its direction at rest, rad, between -pi and pi, and its rate, rad/s. A function of
    state is Python, and no file holds it.
    Raises InputError where the attachment has no direction, and for a moment that is none of these.
    """

    at: Attachment
    moment: Profile | Callable | float
    name: str | None = None
    law = turning

    def __post_init__(self):
        require_attachment(self.label, self.at)
        if not self.at.has_direction:
            raise InputError(f"{self.label}: {self.at!r} has no direction; {self.at.advice}")
        if not is_of_state(self.moment, 3):
            settle(self, moment=as_profile(self.moment, self.label))

    @property
    def compiled_law(self) -> Any:
        """None where the moment is Python."""
        return turning if isinstance(self.moment, Profile) else None

    def sides(self) -> tuple:
        """The direction."""
        return (self.at.d,)

    def forces(self, t: float, x: NDArray, v: NDArray) -> NDArray:
        """`M i d / |d|^2`, (1, 2), J."""
        moment: Any = self.moment
        if isinstance(moment, Profile):
            return by_law(turning, self, t, x, v)
        d, speed = x[0] @ [1.0, 1j], v[0] @ [1.0, 1j]
        angle, rate = float(np.angle(d * self.at.d.rest.conjugate())), float((speed / d).imag)
        f = 1j * answer(self.label, "moment(t, angle, rate)", moment(t, angle, rate)) / d.conjugate()
        return np.array([[f.real, f.imag]])
