"""Torque at an attachment."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polyida.errors import InputError
from polyida.force.force_element import ForceElement, by_law
from polyida.force.of_state import answer, is_of_state
from polyida.given import settle
from polyida.jit import entry
from polyida.joint.attachment import Attachment, ground, require_attachment, require_sides
from polyida.keywords import named_keywords
from polyida.profile import Profile, as_profile


@entry
def turning(t, x, v, data, f):
    """`M i d / |d|^2` on the direction d, whose power is M times the angle's rate, and the opposite on a second one."""
    for i in range(x.shape[0]):
        moment = data[0] if i == 0 else -data[0]
        square = x[i, 0] * x[i, 0] + x[i, 1] * x[i, 1]
        f[i, 0], f[i, 1] = -moment * x[i, 1] / square, moment * x[i, 0] / square


@named_keywords
@dataclass(frozen=True, eq=False)
class Torque(ForceElement):
    """A moment M, N m, counter-clockwise, on an attachment with a direction d: the generalised force `M i d / |d|^2` on d.

    Its work is M times the angle that d turns by. against: an attachment of another body, on which -M acts, as of a motor between two
    bodies; None: the ground. moment: a number, a profile of time, a function of time, or a function of state `moment(t, angle, rate)` of
    three arguments: the angle that d has turned by, against the other direction where there is one, rad, between -pi and pi, and its
    rate, rad/s. A function of state is Python, and no file holds it.
    Raises InputError for an attachment without a direction, two of one body, and a moment that is none of these.
    """

    at: Attachment
    moment: Profile | Callable | float
    against: Attachment | None = None
    name: str | None = None
    law = turning

    def __post_init__(self):
        require_sides(self.label, self.at, ground if self.against is None else self.against)
        for side in (self.at,) if self.against is None else (self.at, self.against):
            require_attachment(self.label, side)
            if not side.has_direction:
                raise InputError(f"{self.label}: {side!r} has no direction; {side.advice}")
        if not is_of_state(self.moment, 3):
            settle(self, moment=as_profile(self.moment, self.label))

    @property
    def compiled_law(self) -> Any:
        """None where the moment is Python."""
        return turning if isinstance(self.moment, Profile) else None

    def sides(self) -> tuple:
        """The direction, or both."""
        return (self.at.d,) if self.against is None else (self.at.d, self.against.d)

    def forces(self, t: float, x: NDArray, v: NDArray) -> NDArray:
        """`M i d / |d|^2`, and the opposite on a second direction, (sides, 2), J."""
        moment: Any = self.moment
        if isinstance(moment, Profile):
            return by_law(turning, self, t, x, v)
        d, signs = x @ [1.0, 1j], np.array([1.0, -1.0])[: len(x)]
        turned = d / [side.rest for side in self.sides()]
        angle, rate = np.angle(turned[0] / (turned[1] if len(d) > 1 else 1.0)), signs @ (v @ [1.0, 1j] / d).imag
        f = answer(self.label, "moment(t, angle, rate)", moment(t, float(angle), float(rate))) * signs * 1j / d.conj()
        return np.stack([f.real, f.imag], axis=1)
