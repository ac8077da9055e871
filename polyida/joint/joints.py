"""The joints of polyida, each defined by its rows."""

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
    """`d_A x (x_B - x_A)`: the point of b stays on the line through a along its direction."""
    return cross(a.d, b.x - a.x).named("across", "N")


def fixed_angle(a, b, angle=0.0, offset=None):
    """`R(angle + offset) d_A x d_B`: the angle from a to b is angle + offset, rad; offset None: the angle at rest."""
    reference = a.d.onto(b.d) if offset is None else a.d.turned(offset)
    return cross(reference.turned(angle), b.d).one_way().named("angle", "N m")


def welded(a, b):
    """Rows that make point and direction of b equal to those of a."""
    return [a.x - b.x, fixed_angle(a, b) if a.turns_only or b.turns_only else a.d - b.d.onto(a.d)]


@named_keywords
@dataclass(frozen=True, eq=False)
class Revolute(Joint):
    """Keep two points together: `phi = x_A - x_B` (2 rows, m), phi_q constant.

    Reaction on b, (2,): force, N.

    Parameters
    ----------
    a, b : Attachment or Ground
        `ground` alone stands for the reference place of the other side.
    name : str, optional

    Raises
    ------
    InputError
        As for Joint.
    """

    kind = "revolute"

    def rows(self) -> list[Row | Vector]:
        """`x_A - x_B`."""
        return [self.a.x - self.b.x]


@named_keywords
@dataclass(frozen=True, eq=False)
class Slot(Joint):
    """Keep the point of b on the line through a in its direction: `phi = d_A x (x_B - x_A)` (1 row, m). b may turn.

    Reaction on b, (2,): force, N, across the line.

    Parameters
    ----------
    a : Attachment or Ground
        With a direction; `ground.at(point, direction)` for a slot in the ground.
    b : Attachment or Ground
        Anywhere on the line at rest.
    name : str, optional

    Raises
    ------
    InputError
        If a has no direction, and as for Joint.
    """

    components = FORCE
    placing = "place the bodies so that b is on the line through a along its direction"
    directed = ("a",)

    def rows(self) -> list[Row | Vector]:
        """`d_A x (x_B - x_A)`."""
        return [across(self.a, self.b)]


@named_keywords
@dataclass(frozen=True, eq=False)
class Prismatic(Joint):
    """Let b slide along the line through a in its direction, without relative rotation.

    `phi = (d_A x (x_B - x_A), Q d_A x d_B)` (2 rows, m and no unit) with the constant rotation Q that makes the second row vanish at rest.
    The second row also vanishes after half a turn: a step that ends there is rejected.
    Reaction on b, (3,): force, N, across the line, and moment about the point of b, N m, counter-clockwise.

    Parameters
    ----------
    a, b : Attachment or Ground
        With directions; `ground.at(point, direction)` is a guide. b is anywhere on the line at rest.
    name : str, optional

    Raises
    ------
    InputError
        If a side has no direction, and as for Joint.
    """

    placing = "place the bodies so that b is on the line through a along its direction"
    directed = ("a", "b")

    def rows(self) -> list[Row | Vector]:
        """`d_A x (x_B - x_A)` and `Q d_A x d_B`."""
        return [across(self.a, self.b), fixed_angle(self.a, self.b)]


@named_keywords
@dataclass(frozen=True, eq=False)
class Weld(Joint):
    """Move point and direction of two sides together; all other deformation of the sections stays free.

    `phi = (x_A - x_B, d_A - Q d_B)` (4 rows, m and no unit), Q the rotation between the directions at rest. If a side belongs to a body
    that keeps its directions of constant length, such as a rigid body, `phi = (x_A - x_B, Q d_A x d_B)` (3 rows).
    Reaction on b, (3,): force, N, and moment about the point of b, N m, counter-clockwise.

    Parameters
    ----------
    a, b : Attachment or Ground
    name : str, optional

    Raises
    ------
    InputError
        If a side has no direction, and as for Joint.
    """

    directed = ("a", "b")

    def rows(self) -> list[Row | Vector]:
        """`x_A - x_B`, and `d_A - Q d_B` or `Q d_A x d_B`."""
        return welded(self.a, self.b)


@named_keywords
@dataclass(frozen=True, eq=False)
class Clamp(Joint):
    """Fix a section.

    A full plate's section to ground: every node keeps its position, `phi = x_i - X_i` (2 rows for each node, m); reaction on b, (2 nodes,):
    force on each node, N. All other pairs of sides: as a Weld, reaction (3,).

    Parameters
    ----------
    a, b : Attachment or Ground
    name : str, optional

    Raises
    ------
    InputError
        If a side has no direction (except a plate's section to ground), for a place of the ground that differs from the section's, and as
        for Joint.
    """

    b: Any = ground
    kind = "clamp"

    def __post_init__(self):
        super().__post_init__()
        if not self.by_points:
            self.require_directions()
        place, side = (self.a, self.b) if isinstance(self.a, Ground) else (self.b, self.a)
        if isinstance(place, Ground) and place.point is not None and not np.array_equal(place.point, side.point):
            raise InputError(
                f"{labelled('Clamp', self.name)}: it holds {side!r} where that is at rest, not at {place!r}; give ground itself, and place "
                "the body there"
            )

    @property
    def by_points(self) -> bool:
        """True if it fixes a full plate to the ground: the reaction is then the force on each node."""
        sides = [side for side in (self.a, self.b) if not isinstance(side, Ground)]
        return len(sides) == 1 and not sides[0].body.few

    def rows(self) -> list[Row | Vector]:
        """`x_i - X_i` of every node, or the rows of a Weld."""
        if not self.by_points:
            return welded(self.a, self.b)
        if isinstance(self.b, Ground):
            return [node.x - ground.at(node.point).x for node in self.a.each()]
        return [ground.at(node.point).x - node.x for node in self.b.each()]


@named_keywords
@dataclass(frozen=True, eq=False)
class Distance(Joint):
    """Keep two points a distance l apart, like a massless rod: `phi = (w . w - l^2) / (2 l)`, w = x_B - x_A (1 row, m).

    Reaction on b, (2,): force, N, along the line; the tension of the rod is minus the multiplier.

    Parameters
    ----------
    a, b : Attachment or Ground
        One of them may be a place of the ground, `ground.at(point)`.
    length : float, m, optional
        l > 0. Default: the distance in the drawing.
    name : str, optional

    Raises
    ------
    InputError
        For a length that is not positive, and as for Joint.
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
    """Prescribe the angle from section a to section b as theta0 + theta(t).

    `phi = R(theta + theta0) d_A x d_B = |d_A| |d_B| sin(angle error)` (1 row): bilinear in q, so any number of turns is possible. The row
    also vanishes after half a turn: a step that ends there is rejected. The torque on b is `-lam |d_A| |d_B|`, N m.

    Parameters
    ----------
    a, b : Attachment or Ground
        With directions.
    angle : Profile, function of time or float, rad
        theta(t).
    offset : float, rad, optional
        theta0. Default: the angle of the reference configuration, or of the drawing if `Scene.assemble` moves the bodies to theta(0).
    name : str, optional

    Raises
    ------
    InputError
        For an angle that is no profile, an offset that is no number, a side without a direction, and as for Joint.
    """

    angle: "Profile | Callable[[float], float] | float"
    offset: float | None = None
    kind = "motor"
    directed = ("a", "b")

    def __post_init__(self):
        super().__post_init__()
        label = labelled("AngleMotor", self.name)
        settle(self, angle=as_profile(self.angle, label))
        if not (self.offset is None or is_number(self.offset)):
            raise InputError(f"{label}: offset = {self.offset!r} must be a finite number of rad, or None")

    def rows(self) -> list[Row | Vector]:
        """`R(theta + theta0) d_A x d_B`."""
        return [fixed_angle(self.a, self.b, self.angle, self.offset)]

    def keep_drawing(self) -> None:
        """Store the angle of the drawing as theta0 if theta(0) is not zero."""
        if self.offset is None and as_profile(self.angle, "AngleMotor")(0.0):
            drawn = self.facing()
            settle(self, a=drawn.a, b=drawn.b, offset=float(np.angle(drawn.b.d.rest / drawn.a.d.rest)))


@named_keywords
@dataclass(frozen=True, eq=False)
class PrescribedPosition(Joint):
    """Prescribe the position of a point by profiles of time, in both directions or in one: `phi = (x - X(t), y - Y(t))`, m.

    Reaction, (rows,): force on the attachment in these directions, N.

    Parameters
    ----------
    at : Attachment
    x, y : Profile, function of time or float, m, or None
        Coordinates of the point, not its displacements; None: free in that direction. At the start of a run the point must be there.
    name : str, optional

    Raises
    ------
    InputError
        If x and y are both None, or not profiles, or if `at` is not an attachment of a body.
    """

    a: Any = field(default=ground, init=False)
    b: Any = field(default=None, init=False)
    at: Attachment
    x: "Profile | Callable[[float], float] | float | None"
    y: "Profile | Callable[[float], float] | float | None"

    def __post_init__(self):
        label = labelled("PrescribedPosition", self.name)
        require_attachment(label, self.at)
        if self.x is None and self.y is None:
            raise InputError(f"{label}: x and y are both None; give a profile of one at least")
        profiles = {axis: None if value is None else as_profile(value, label) for axis, value in (("x", self.x), ("y", self.y))}
        settle(self, a=ground.at(self.at.point), b=self.at, **profiles)

    def rows(self) -> list[Row | Vector]:
        """`x - X(t)` and `y - Y(t)`, or one of them."""
        axes = ("x", 1.0, self.x), ("y", 1j, self.y)
        label = "PrescribedPosition"
        return [
            (dot(along(e), self.at.x) - as_profile(profile, label)).named(axis, "N") for axis, e, profile in axes if profile is not None
        ]

    @property
    def components(self) -> tuple[tuple[str, str], ...]:
        """Forces in the prescribed directions."""
        return tuple((axis, "N") for axis, profile in (("x", self.x), ("y", self.y)) if profile is not None)

    def facing(self) -> Self:
        """Return itself: a is already a place of the ground."""
        return self
