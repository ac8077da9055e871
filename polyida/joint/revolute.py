"""Revolute joint."""

from dataclasses import dataclass

from polyida.joint.formula import Row, Vector
from polyida.joint.joint import Joint
from polyida.keywords import named_keywords


@named_keywords
@dataclass(frozen=True, eq=False)
class Revolute(Joint):
    """Two points stay together: `phi = x_A - x_B` (2 rows, m). phi_q is constant.

    a, b: attachments or ground; ground stands for the place of the other side in the reference configuration.
    The multiplier is the force on b in N, (2,).
    """

    kind = "revolute"

    def rows(self) -> list[Row | Vector]:
        """`x_A - x_B`."""
        return [self.a.x - self.b.x]
