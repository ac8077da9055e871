"""Clamp: a section held fast to the ground, or two sections welded."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from polyida.errors import InputError
from polyida.joint.attachment import Ground, ground, labelled
from polyida.joint.formula import Row, Vector
from polyida.joint.joint import Joint
from polyida.joint.weld import welded
from polyida.keywords import named_keywords


@named_keywords
@dataclass(frozen=True, eq=False)
class Clamp(Joint):
    """A section held fast.

    A plate's, to ground: every node of the section keeps its place, `phi = x_i - X_i` (2 rows a node, m).
    Between bodies, and of bodies of few coordinates, whose nodes do not move one by one: point and direction of both sides move as one, the rows
    of a Weld.
    Reaction on b: of a plate held to ground the force on each node, (2 nodes,), N, else force, N, and moment about the point of b, N m, (3,),
    as of a Weld. Raises InputError where a side of these has no direction, and for a place of the ground other than where the section is.
    """

    b: Any = ground
    kind = "clamp"

    def __post_init__(self):
        super().__post_init__()
        grounds = [isinstance(side, Ground) for side in (self.a, self.b)]
        if not self.by_points:
            self.require_directions()
        if not any(grounds):
            return
        place, held = (self.a, self.b) if grounds[0] else (self.b, self.a)
        if place.point is not None and not np.array_equal(place.point, held.point):
            label = labelled("Clamp", self.name)
            raise InputError(
                f"{label}: it holds {held!r} where that is at rest, not at {place!r}; give ground itself, and place the body there"
            )

    @property
    def by_points(self) -> bool:
        """Whether a full plate is held to the ground: its reaction is the force on each node."""
        sides = [side for side in (self.a, self.b) if not isinstance(side, Ground)]
        return len(sides) == 1 and not sides[0].body.few

    def rows(self) -> list[Row | Vector]:
        """`x_i - X_i` of every node, or those of a Weld."""
        if not self.by_points:
            return welded(self.a, self.b)
        if isinstance(self.b, Ground):
            return [node.x - ground.at(node.point).x for node in self.a.each()]
        return [ground.at(node.point).x - node.x for node in self.b.each()]
