"""Slot: a pin in a straight slot."""

from dataclasses import dataclass

from polyida.joint.formula import Row, Vector
from polyida.joint.joint import FORCE, Joint
from polyida.joint.shared_rows import across
from polyida.keywords import named_keywords


@named_keywords
@dataclass(frozen=True, eq=False)
class Slot(Joint):
    """b moves along the line through a in its direction e = d_A, and turns as it likes: `phi = e x (x_B - x_A)` (1 row, m).

    a: a side with a direction, `ground.at(point, direction)` for a slot in the ground; b needs none, and is anywhere on the line at rest.
    Reaction on b, (2,): force, N, across the line.
    """

    components = FORCE
    placing = "place the bodies so that b is on the line through a along its direction"

    def __post_init__(self):
        super().__post_init__()
        self.require_directions(self.a)

    def rows(self) -> list[Row | Vector]:
        """`e x (x_B - x_A)`."""
        return [across(self.a, self.b)]
