"""Angle motor: an imposed angle between two sections."""

from dataclasses import dataclass

from polyida.errors import InputError
from polyida.joint.attachment import ground, labelled, require_sides
from polyida.joint.rows import MotorRow
from polyida.profile import Profile, as_profile


@dataclass(frozen=True, eq=False)
class AngleMotor:
    """The angle from section a to section b, beyond that of the reference configuration, follows a profile theta(t) in rad.

    `phi = (R(theta + theta0) d_A)^T J d_B = |d_A| |d_B| sin(angle error)` (1 row), J = [[0, 1], [-1, 0]]: bilinear in q, so it turns
    any number of times. It vanishes half a turn away as well: a step that lands there is rejected.
    a, b: sections, or one of them ground. The torque on b is `-lam |d_A| |d_B|`, N m.
    """

    a: object
    b: object
    angle: Profile
    name: str | None = None
    multiplier = "torque on b, N m"

    def __post_init__(self):
        label = labelled("AngleMotor", self.name)
        require_sides(label, self.a, self.b)
        for side in (self.a, self.b):
            if side is not ground and side.turn_weights is None:
                raise InputError(f"{label}: {side!r} has no direction; use a section of two nodes or more")
        object.__setattr__(self, "angle", as_profile(self.angle, label))

    def rows(self):
        """The constraint row, as data."""
        return [MotorRow(self.a, self.b, self.angle)]
