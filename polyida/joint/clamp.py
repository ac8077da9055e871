"""Clamp: a section held fast to the ground, or two sections welded."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polyida.errors import InputError
from polyida.joint.attachment import Ground, ground, labelled
from polyida.joint.formula import Row, Vector
from polyida.joint.joint import Joint
from polyida.joint.weld import moved_as_one, welded
from polyida.keywords import named_keywords


@named_keywords
@dataclass(frozen=True, eq=False)
class Clamp(Joint):
    """A section held fast.

    A plate's, to ground: every node of the section keeps its place, `phi = x_i - X_i` (2 rows a node, m).
    Between bodies, and of bodies of few coordinates, whose nodes do not move one by one: point and direction of both sides move as one, the rows
    of a Weld.
    Multipliers: force on b, N; of the direction a moment over length; reaction on b, (3,), where a side keeps the length of its direction: force, N,
    and moment about its point, N m, as of a Weld. Raises InputError where a side of these has no direction, and for a
    place of the ground other than where the section is.
    """

    b: Any = ground
    kind = "clamp"

    def __post_init__(self):
        super().__post_init__()
        grounds = [isinstance(side, Ground) for side in (self.a, self.b)]
        if not self._by_nodes:
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
    def _by_nodes(self):
        """Whether a full plate is held to the ground."""
        sides = [side for side in (self.a, self.b) if not isinstance(side, Ground)]
        return len(sides) == 1 and not sides[0].body.few

    def rows(self) -> list[Row | Vector]:
        """`x_i - X_i` of every node, or those of a Weld."""
        if not self._by_nodes:
            return welded(self.a, self.b)
        if isinstance(self.b, Ground):
            return [node.x - ground.at(node.point).x for node in self.a.each()]
        return [ground.at(node.point).x - node.x for node in self.b.each()]

    def reaction(self, lam: NDArray, values: Callable[[Vector], NDArray]) -> NDArray:
        """Force and moment on b, (frames, 3), N and N m; the multipliers where they are more."""
        return moved_as_one(self, lam, values) if lam.shape[1] == 3 else lam.copy()
