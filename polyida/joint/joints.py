"""The joints that come with polyida, each by its rows."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np

from polyida.errors import InputError
from polyida.joint.attachment import Attachment, Ground, ground, labelled, require_attachment, require_places
from polyida.joint.formula import Row, Vector, along, cross, dot
from polyida.joint.joint import FORCE, Joint
from polyida.profile import Profile, as_profile
from polyida.validation import is_number, named_keywords, positive, settle


def across(a, b):
    """`d_A x (x_B - x_A)`: b stays on the line through a along its direction."""
    return cross(a.d, b.x - a.x).named("across", "N")


def held(a, b, angle=0.0, offset=None):
    """`R(angle + offset) d_A x d_B`: b stands at an angle against a, a number or a profile, beyond offset, rad; None: that at rest."""
    ahead = a.d.onto(b.d) if offset is None else a.d.turned(offset)
    return cross(ahead.turned(angle), b.d).one_way().named("angle", "N m")


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


@named_keywords
@dataclass(frozen=True, eq=False)
class Slot(Joint):
    """b moves along the line through a in its direction e = d_A, and turns as it likes: `phi = e x (x_B - x_A)` (1 row, m).

    a: a side with a direction, `ground.at(point, direction)` for a slot in the ground; b needs none, and is anywhere on the line at rest.
    Reaction on b, (2,): force, N, across the line.
    """

    components = FORCE
    placing = "place the bodies so that b is on the line through a along its direction"
    directed = ("a",)

    def rows(self) -> list[Row | Vector]:
        """`e x (x_B - x_A)`."""
        return [across(self.a, self.b)]


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
    directed = ("a", "b")

    def rows(self) -> list[Row | Vector]:
        """`e x (x_B - x_A)` and `R1 e x d_B`."""
        return [across(self.a, self.b), held(self.a, self.b)]


@named_keywords
@dataclass(frozen=True, eq=False)
class Weld(Joint):
    """Point and direction of two attachments, or of one and the ground, move as one; what else is of a section stays free.

    `phi = (x_A - x_B, d_A - Q d_B)` (4 rows, m and without unit), Q the rotation between the directions at rest; where one side is of a
    body that keeps the length of its directions by itself, as rigid ones do, `phi = (x_A - x_B, Q d_A x d_B)` (3 rows). Reaction on b,
    (3,): force, N, and moment about its point, N m, counter-clockwise. Raises InputError for a side without a direction.
    """

    directed = ("a", "b")

    def rows(self) -> list[Row | Vector]:
        """`x_A - x_B`, and `d_A - Q d_B` or `Q d_A x d_B`."""
        return welded(self.a, self.b)


def welded(a, b):
    """Rows by which point and direction of b are those of a."""
    alike = held(a, b) if a.turns_only or b.turns_only else a.d - b.d.onto(a.d)
    return [a.x - b.x, alike]


@named_keywords
@dataclass(frozen=True, eq=False)
class Clamp(Joint):
    """A section held fast.

    A plate's, to ground: every node of the section keeps its place, `phi = x_i - X_i` (2 rows a node, m). Between bodies, and of bodies of
    few coordinates, whose nodes do not move one by one: point and direction of both sides move as one, the rows of a Weld. Reaction on b:
    of a plate held to ground the force on each node, (2 nodes,), N, else force, N, and moment about the point of b, N m, (3,), as of a
    Weld. Raises InputError where a side of these has no direction, and for a place of the ground other than where the section is.
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


@named_keywords
@dataclass(frozen=True, eq=False)
class Distance(Joint):
    """Two points stay a length l apart, as by a massless rod: `phi = (w . w - l^2) / (2 l)`, w = x_B - x_A (1 row, m).

    a, b: attachments, one of them perhaps a place of the ground, `ground.at(point)`. length: l, m; that of the drawing where it is None.
    Reaction on b, (2,): force, N, along the line; the tension of the rod is minus the multiplier.
    Raises InputError for a length that is not positive.
    """

    length: float | None = None
    components = FORCE
    placing = "place the bodies so that their points are the length apart"

    def __post_init__(self):
        super().__post_init__()
        label = labelled("Distance", self.name)
        require_places(label, self.a, self.b)
        drawn = float(np.linalg.norm(self.b.point - self.a.point))
        settle(self, length=positive(label, "length", drawn if self.length is None else self.length, "metres"))

    def rows(self) -> list[Row | Vector]:
        """`(w . w - l^2) / (2 l)`."""
        length: Any = self.length
        w = self.b.x - self.a.x
        return [((dot(w, w) - length**2) / (2.0 * length)).named("", "N")]


@named_keywords
@dataclass(frozen=True, eq=False)
class AngleMotor(Joint):
    """The angle from section a to section b, beyond theta0, follows a profile theta(t) in rad.

    `phi = R(theta + theta0) d_A x d_B = |d_A| |d_B| sin(angle error)` (1 row): bilinear in q, so it turns any number of times.
    It vanishes half a turn away as well: a step that lands there is rejected.
    a, b: sections, or one of them ground. offset: theta0, rad; None: that of the reference configuration, or of the drawing where
    `scene.assemble()` moves the bodies from there to theta(0). The torque on b is `-lam |d_A| |d_B|`, N m.
    """

    angle: Profile | Callable[[float], float] | float
    offset: float | None = None
    kind = "motor"
    directed = ("a", "b")

    def __post_init__(self):
        super().__post_init__()
        object.__setattr__(self, "angle", as_profile(self.angle, labelled("AngleMotor", self.name)))
        if not (self.offset is None or is_number(self.offset)):
            raise InputError(f"{labelled('AngleMotor', self.name)}: offset = {self.offset!r} must be a finite number of rad, or None")

    def rows(self) -> list[Row | Vector]:
        """`R(theta + theta0) d_A x d_B`."""
        return [held(self.a, self.b, self.angle, self.offset)]

    def keep_drawing(self) -> None:
        """Where theta(0) is not zero, keep the angle of the drawing as theta0."""
        if self.offset is None and as_profile(self.angle, "AngleMotor")(0.0):
            drawn = self.facing()
            settle(self, a=drawn.a, b=drawn.b, offset=float(np.angle(drawn.b.d.rest / drawn.a.d.rest)))


@named_keywords
@dataclass(frozen=True, eq=False)
class PrescribedPosition(Joint):
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
        label = labelled("PrescribedPosition", self.name)
        require_attachment(label, self.at)
        if self.x is None and self.y is None:
            raise InputError(f"{label}: x and y are both None; give a profile of one at least")
        given = {axis: None if value is None else as_profile(value, label) for axis, value in (("x", self.x), ("y", self.y))}
        settle(self, a=ground.at(self.at.point), b=self.at, **given)

    def rows(self) -> list[Row | Vector]:
        """`x - X(t)` and `y - Y(t)`, or one of them."""
        axes = ("x", 1.0, self.x), ("y", 1j, self.y)
        return [
            (dot(along(e), self.at.x) - as_profile(way, "PrescribedPosition")).named(axis, "N") for axis, e, way in axes if way is not None
        ]

    @property
    def components(self) -> tuple[tuple[str, str], ...]:
        """Forces in the directions in which it leads."""
        return tuple((axis, "N") for axis, way in (("x", self.x), ("y", self.y)) if way is not None)

    def facing(self) -> Self:
        """Itself: it says where it is."""
        return self
