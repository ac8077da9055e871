"""Revolute joint."""

from dataclasses import dataclass

from polyida.joint.attachment import labelled, require_sides
from polyida.joint.rows import LinearRows


@dataclass(frozen=True, eq=False)
class Revolute:
    """Two points stay together: `phi = x_A - x_B` (2 rows, m). phi_q is constant.

    a, b: attachments or ground; ground stands for the place of the other side in the reference configuration.
    The multiplier is the force on b in N, (2,).
    """

    a: object
    b: object
    name: str | None = None
    multiplier = "force on b, N"

    def __post_init__(self):
        require_sides(labelled("Revolute", self.name), self.a, self.b)

    def rows(self):
        """The constraint rows, as data."""
        return [LinearRows(self.a, self.b, "point")]
