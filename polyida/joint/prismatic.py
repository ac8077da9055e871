"""Prismatic joint."""

from dataclasses import dataclass

from polyida.joint.formula import Row, Vector
from polyida.joint.joint import Joint
from polyida.joint.shared_rows import across, held
from polyida.keywords import named_keywords


@named_keywords
@dataclass(frozen=True, eq=False)
class Prismatic(Joint):
    """b slides along the line through a in its direction e = d_A, and does not turn against a.

    `phi = (e x (x_B - x_A), R1 e x d_B)` (2 rows, m and without unit), R1 the constant rotation by which the second vanishes at rest. That
    vanishes half a turn away as well: a step that lands there is rejected. a, b: sides with a direction, one of them perhaps ground;
    `ground.at(point, direction)` is a guide. b is anywhere on the line at rest.
    Reaction on b, (3,): force, N, across the line, and moment about its point, N m, counter-clockwise.
    """

    placing = "place the bodies so that b is on the line through a along its direction"

    def __post_init__(self):
        super().__post_init__()
        self.require_directions()

    def rows(self) -> list[Row | Vector]:
        """`e x (x_B - x_A)` and `R1 e x d_B`."""
        return [across(self.a, self.b), held(self.a, self.b)]
