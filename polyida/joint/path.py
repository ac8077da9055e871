"""Path: a point that is led along a given way in time."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Self

from polyida.errors import InputError
from polyida.given import settle
from polyida.joint.attachment import Attachment, ground, labelled, require_attachment
from polyida.joint.formula import Row, Vector, along, dot
from polyida.joint.joint import Joint
from polyida.keywords import named_keywords
from polyida.profile import Profile, as_profile


@named_keywords
@dataclass(frozen=True, eq=False)
class Path(Joint):
    """The point of an attachment is where profiles of time say, in both directions or in one: `phi = (x - X(t), y - Y(t))`, m.

    x, y: coordinates of the point, m, not its displacements: a profile, a function of time or a number each, or None where the
    point is free in that direction. At the start of a run it is there.
    Reaction, (rows,): force on the attachment in these directions, N.
    Raises InputError where both are None.
    """

    a: Any = field(default=ground, init=False)
    b: Any = field(default=None, init=False)
    at: Attachment
    x: Profile | Callable[[float], float] | float | None
    y: Profile | Callable[[float], float] | float | None

    def __post_init__(self):
        label = labelled("Path", self.name)
        require_attachment(label, self.at)
        if self.x is None and self.y is None:
            raise InputError(f"{label}: x and y are both None; give a profile of one at least")
        given = {axis: None if value is None else as_profile(value, label) for axis, value in (("x", self.x), ("y", self.y))}
        settle(self, a=ground.at(self.at.point), b=self.at, **given)

    def rows(self) -> list[Row | Vector]:
        """`x - X(t)` and `y - Y(t)`, or one of them."""
        axes = ("x", 1.0, self.x), ("y", 1j, self.y)
        return [(dot(along(e), self.at.x) - as_profile(way, "Path")).named(axis, "N") for axis, e, way in axes if way is not None]

    @property
    def components(self) -> tuple[tuple[str, str], ...]:
        """Forces in the directions in which it leads."""
        return tuple((axis, "N") for axis, way in (("x", self.x), ("y", self.y)) if way is not None)

    def facing(self) -> Self:
        """Itself: it says where it is."""
        return self
