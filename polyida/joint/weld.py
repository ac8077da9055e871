"""Weld: two attachments that move as one."""

from dataclasses import dataclass

from polyida.joint.formula import Row, Vector
from polyida.joint.joint import Joint
from polyida.joint.shared_rows import held
from polyida.keywords import named_keywords


@named_keywords
@dataclass(frozen=True, eq=False)
class Weld(Joint):
    """Point and direction of two attachments, or of one and the ground, move as one; what else is of a section stays free.

    `phi = (x_A - x_B, d_A - Q d_B)` (4 rows, m and without unit), Q the rotation between the directions at rest; where one side is of a body
    that keeps the length of its directions by itself, as rigid ones do, `phi = (x_A - x_B, Q d_A x d_B)` (3 rows).
    Reaction on b, (3,): force, N, and moment about its point, N m, counter-clockwise.
    Raises InputError for a side without a direction.
    """

    def __post_init__(self):
        super().__post_init__()
        self.require_directions()

    def rows(self) -> list[Row | Vector]:
        """`x_A - x_B`, and `d_A - Q d_B` or `Q d_A x d_B`."""
        return welded(self.a, self.b)


def welded(a, b):
    """Rows by which point and direction of b are those of a."""
    alike = held(a, b) if a.turns_only or b.turns_only else a.d - b.d.onto(a.d)
    return [a.x - b.x, alike]
