"""Weld: two attachments that move as one."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from polyida.joint.formula import Row, Vector
from polyida.joint.joint import Joint
from polyida.joint.shared_rows import FORCE_AND_MOMENT, held, torque
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

    components = FORCE_AND_MOMENT

    def __post_init__(self):
        super().__post_init__()
        self.require_directions()

    def rows(self) -> list[Row | Vector]:
        """`x_A - x_B`, and `d_A - Q d_B` or `Q d_A x d_B`."""
        return welded(self.a, self.b)

    def reaction(self, lam: NDArray, values: Callable[[Vector], NDArray]) -> NDArray:
        """Force and moment on b, (frames, 3), N and N m."""
        if lam.shape[1] == 3:
            return moved_as_one(self, lam, values)
        d = values(self.b.d.onto(self.a.d))
        return np.column_stack([lam[:, :2], d[:, 0] * lam[:, 3] - d[:, 1] * lam[:, 2]])


def moved_as_one(joint, lam, values):
    """Force and moment on b, (frames, 3), N and N m, of the multipliers (frames, 3) of `welded` rows that hold an angle."""
    return np.column_stack([lam[:, :2], torque(joint, lam[:, 2], values)])


def welded(a, b):
    """Rows by which point and direction of b are those of a."""
    alike = held(a, b) if a.turns_only or b.turns_only else a.d - b.d.onto(a.d)
    return [a.x - b.x, alike]
