"""Angle motor: an imposed angle between two sections."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from polyida.errors import InputError
from polyida.given import is_number, settle
from polyida.joint.attachment import labelled
from polyida.joint.formula import Row, Vector
from polyida.joint.joint import Joint
from polyida.joint.shared_rows import held
from polyida.keywords import named_keywords
from polyida.profile import Profile, as_profile


@named_keywords
@dataclass(frozen=True, eq=False)
class AngleMotor(Joint):
    """The angle from section a to section b, beyond theta0, follows a profile theta(t) in rad.

    `phi = R(theta + theta0) d_A x d_B = |d_A| |d_B| sin(angle error)` (1 row): bilinear in q, so it turns any number of times.
    It vanishes half a turn away as well: a step that lands there is rejected.
    a, b: sections, or one of them ground. zero: theta0, rad; where it is None that of the reference configuration, or of the drawing where
    `scene.assemble()` moves the bodies from there to theta(0). The torque on b is `-lam |d_A| |d_B|`, N m.
    """

    angle: Profile | Callable[[float], float] | float
    zero: float | None = None
    kind = "motor"

    def __post_init__(self):
        super().__post_init__()
        self.require_directions()
        object.__setattr__(self, "angle", as_profile(self.angle, labelled("AngleMotor", self.name)))
        if not (self.zero is None or is_number(self.zero)):
            raise InputError(f"{labelled('AngleMotor', self.name)}: zero = {self.zero!r} must be a finite number of rad, or None")

    def rows(self) -> list[Row | Vector]:
        """`R(theta + theta0) d_A x d_B`."""
        return [held(self.a, self.b, self.angle, self.zero)]

    def keep_drawing(self) -> None:
        """Where theta(0) is not zero, keep the angle of the drawing as theta0."""
        if self.zero is None and as_profile(self.angle, "AngleMotor")(0.0):
            drawn = self.facing()
            settle(self, a=drawn.a, b=drawn.b, zero=float(np.angle(drawn.b.d.rest / drawn.a.d.rest)))
