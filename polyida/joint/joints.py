"""The joints of polyida, each defined by its rows."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Self

import numpy as np

from polyida.errors import InputError
from polyida.fields import check, check_fields, must_be, none_or, optional, time_profile
from polyida.joint.attachment import Attachment, Ground, ground, require_attachment, require_places
from polyida.joint.formula import Row, Vector, along, cross, dot
from polyida.joint.joint import FORCE, Joint
from polyida.profile import Profile, as_profile
from polyida.validation import is_number, named_keywords, number, positive, settle

FRICTION = check(number, "no unit", 0.0)  # of a field
COINCIDENT = 1e-12  # of the coordinates: distances that are round-off


def across(a, b):
    """`d_A x (x_B - x_A)`: the point of b stays on the line through a along its direction."""
    return cross(a.d, b.x - a.x).named("across", "N")


def fixed_angle(a, b, angle=0.0, offset=None):
    """`R(angle + offset) d_A x d_B`: the angle from a to b is angle + offset, rad; offset None: the angle in the reference configuration."""
    reference = a.d.onto(b.d) if offset is None else a.d.turned(offset)
    return cross(reference.turned(angle), b.d).one_way().named("angle", "N m")


def sliding(a, b):
    """`d_A . (x_B - x_A)`: the way of b along the line through a."""
    return dot(a.d, b.x - a.x).named("friction", "N")


def welded(a, b):
    """Rows of a weld: x_A - x_B, and d_A - Q d_B, or one angle if a body keeps the length of its direction."""
    return [a.x - b.x, fixed_angle(a, b) if a.turns_only or b.turns_only else a.d - b.d.onto(a.d)]


@named_keywords
@dataclass(frozen=True, eq=False)
class Revolute(Joint):
    """Keep two points together: `phi = x_A - x_B` (2 rows, m), phi_q constant.

    Reaction on b, (2,): force, N; with friction (3,): also the moment, N m.

    Parameters
    ----------
    a, b : Attachment or Ground
        `ground` alone stands for the reference place of the other side.
    friction : float
        Coefficient mu of dry friction in the pin: the moment is at most `mu pin_radius |force|`. Both sides then need a direction.
    pin_radius : float, m, optional
        Needed with friction.
    name : str, optional

    Raises
    ------
    InputError
        For a negative coefficient, friction without a radius or a direction, and as for Joint.
    """

    friction: float = field(default=0.0, metadata=FRICTION)
    pin_radius: float | None = None
    kind = "revolute"

    def __post_init__(self):
        """Check the fields, and that friction has a radius and directions."""
        super().__post_init__()
        if self.friction or self.pin_radius is not None:
            positive(self.label, "pin_radius", self.pin_radius, "metres")
            self.require_directions(*(side for side in (self.a, self.b) if not isinstance(side, Ground)))

    def rows(self) -> list[Row | Vector]:
        """`x_A - x_B`, and with friction the relative angular velocity."""
        apart, radius = self.a.x - self.b.x, self.pin_radius
        if not self.friction or radius is None:
            return [apart]
        spin = cross(self.b.d, self.b.d.rate) - cross(self.a.d, self.a.d.rate)
        return [apart, spin.named("friction", "N m").rubs(self.friction * radius, on=[apart])]


@named_keywords
@dataclass(frozen=True, eq=False)
class Slot(Joint):
    """Keep the point of b on the line through a in its direction: `phi = d_A x (x_B - x_A)` (1 row, m). b may turn.

    Reaction on b, (2,): force, N, across the line, and along it with friction.

    Parameters
    ----------
    a : Attachment or Ground
        With a direction; `ground.at(point, direction)` for a slot in the ground.
    b : Attachment or Ground
        Anywhere on the line in the reference configuration.
    friction : float
        Coefficient mu of dry friction: the force along the line is at most `mu |N|`, N the force across it.
    name : str, optional

    Raises
    ------
    InputError
        If a has no direction, for a negative coefficient, and as for Joint.
    """

    friction: float = field(default=0.0, metadata=FRICTION)
    components = FORCE
    placing = "place the bodies so that b is on the line through a along its direction"
    directed = ("a",)

    def rows(self) -> list[Row | Vector]:
        """Return the row `d_A x (x_B - x_A)`; with friction also `d_A . (x_B - x_A)`, a row with the law of dry friction."""
        normal = across(self.a, self.b)
        return [normal, sliding(self.a, self.b).rubs(self.friction, on=[normal])] if self.friction else [normal]


@named_keywords
@dataclass(frozen=True, eq=False)
class Prismatic(Joint):
    """Let b slide along the line through a in its direction, without relative rotation.

    `phi = (d_A x (x_B - x_A), Q d_A x d_B)` (2 rows, m and no unit) with the constant rotation Q that makes the second row vanish in the reference configuration.
    The second row also vanishes after half a turn: a step that ends there is rejected.
    Reaction on b, (3,): force, N, across the line, and along it with friction, and moment about the point of b, N m, counter-clockwise.

    Parameters
    ----------
    a, b : Attachment or Ground
        With directions; `ground.at(point, direction)` is a guide. b is anywhere on the line in the reference configuration.
    friction : float
        Coefficient mu of dry friction: the force along the line is at most `mu |N|`, N the force across it. The moment adds none: a guide
        of length L, which a load along the line jams at distances above L/(2 mu) from it, is a `Slot` with friction at each end.
    name : str, optional

    Raises
    ------
    InputError
        If a side has no direction, for a negative coefficient, and as for Joint.
    """

    friction: float = field(default=0.0, metadata=FRICTION)
    placing = "place the bodies so that b is on the line through a along its direction"
    directed = ("a", "b")

    def rows(self) -> list[Row | Vector]:
        """`d_A x (x_B - x_A)` and `Q d_A x d_B`, and with friction the way along the line."""
        normal, angle = across(self.a, self.b), fixed_angle(self.a, self.b)
        slip = [sliding(self.a, self.b).rubs(self.friction, on=[normal])] if self.friction else []
        return [normal, angle, *slip]


@named_keywords
@dataclass(frozen=True, eq=False)
class Weld(Joint):
    """Move point and direction of two sides together; all other deformation of the sections stays free.

    `phi = (x_A - x_B, d_A - Q d_B)` (4 rows, m and no unit), Q the rotation between the directions in the reference configuration. If a side belongs to a body
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
        """Check the sides: a direction for a weld, and no other place of the ground."""
        super().__post_init__()
        if not self.by_points:
            self.require_directions()
        place, side = (self.a, self.b) if isinstance(self.a, Ground) else (self.b, self.a)
        if isinstance(place, Ground) and place.point is not None and not np.array_equal(place.point, side.point):
            raise InputError(
                f"{self.label}: it holds {side!r} where that is at rest, not at {place!r}; give ground itself, and place the body there"
            )

    @property
    def by_points(self) -> bool:
        """True if it fixes a full plate to the ground: the reaction is then the force on each node."""
        sides = [side for side in (self.a, self.b) if not isinstance(side, Ground)]
        return len(sides) == 1 and sides[0].body.is_full

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
        l > 0. Default: the distance in the reference configuration.
    name : str, optional

    Raises
    ------
    InputError
        For a length that is not positive or only round-off, and as for Joint.
    """

    length: float | None = None
    components = FORCE
    placing = "place the bodies so that their points are the length apart"

    def __post_init__(self):
        """Check the places and the length; the default length is the distance in the reference configuration."""
        super().__post_init__()
        label = self.label
        require_places(label, self.a, self.b)
        drawn = float(np.linalg.norm(self.b.point - self.a.point))
        length, size = positive(label, "length", drawn if self.length is None else self.length, "metres"), max(self.a.size, self.b.size)
        if length <= COINCIDENT * size:
            what = "the points coincide: their distance" if self.length is None else "length"
            raise InputError(f"{label}: {what} is {length:.3g} m, round-off beside coordinates of {size:.3g} m; it must be larger")
        settle(self, length=length)

    def rows(self) -> list[Row | Vector]:
        """The row `(w . w - l^2) / (2 l)`, m, with w from one point to the other."""
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

    angle: "Profile | Callable[[float], float] | float" = field(metadata=check(time_profile))
    offset: float | None = field(default=None, metadata=must_be("a finite number of rad, or None", none_or(is_number)))
    kind = "motor"
    directed = ("a", "b")

    def rows(self) -> list[Row | Vector]:
        """The row `R(theta + theta0) d_A x d_B`, which is zero at the prescribed angle."""
        return [fixed_angle(self.a, self.b, self.angle, self.offset)]

    def keep_drawing(self) -> None:
        """Set theta0 to the angle between the sections in the drawing, unless it is given or theta(0) is zero."""
        if self.offset is None and as_profile(self.angle, "AngleMotor")(0.0):
            drawn = self.facing()
            settle(self, a=drawn.a, b=drawn.b, offset=float(np.angle(drawn.b.d.rest / drawn.a.d.rest)))


@named_keywords
@dataclass(frozen=True, eq=False)
class PrescribedPosition(Joint):
    """Prescribe the position of a point by profiles of time, in both directions or in one: `phi = (x - X(t), y - Y(t))`, m.

    Reaction, (rows,): force on the attachment in these directions, N; with friction (2,).

    Parameters
    ----------
    at : Attachment
    x, y : Profile, function of time or float, m, or None
        Coordinates of the point, not its displacements; None: free in that direction. At the start of a run the point must be there.
    friction : float
        Coefficient mu of dry friction in the free direction, as on a wall that moves only across its surface: the force is at most `mu |N|`,
        N that in the prescribed direction.
    name : str, optional

    Raises
    ------
    InputError
        If x and y are both None, or not profiles, if `at` is not an attachment of a body, for a negative coefficient, and for friction if no
        direction is free.
    """

    a: Any = field(default=ground, init=False)
    b: Any = field(default=None, init=False)
    at: Attachment
    x: "Profile | Callable[[float], float] | float | None" = field(metadata=check(optional, time_profile))
    y: "Profile | Callable[[float], float] | float | None" = field(metadata=check(optional, time_profile))
    friction: float = field(default=0.0, metadata=FRICTION)

    def __post_init__(self):
        """Check the fields; the sides are the ground and the attachment."""
        label = self.label
        require_attachment(label, self.at)
        if self.x is None and self.y is None:
            raise InputError(f"{label}: x and y are both None; give a profile of one at least")
        check_fields(self, label)
        if self.friction and self.x is not None and self.y is not None:
            raise InputError(f"{label}: friction = {self.friction:g} needs a direction to slide in: one of x and y must be None")
        settle(self, a=ground.at(self.at.point), b=self.at)

    def rows(self) -> list[Row | Vector]:
        """`x - X(t)` and `y - Y(t)`, or one of them, and with friction the other coordinate."""
        axes = ("x", 1.0, self.x), ("y", 1j, self.y)
        label = "PrescribedPosition"
        driven: list[Row | Vector] = [
            (dot(along(e), self.at.x) - as_profile(profile, label)).named(axis, "N") for axis, e, profile in axes if profile is not None
        ]
        if not self.friction:
            return driven
        way = dot(along(1.0 if self.x is None else 1j), self.at.x)
        return [*driven, way.named("friction", "N").rubs(self.friction, on=driven)]

    @property
    def components(self) -> tuple[tuple[str, str], ...]:
        """Forces in the prescribed directions, with friction in both."""
        return tuple((axis, "N") for axis, profile in (("x", self.x), ("y", self.y)) if profile is not None or self.friction)

    def facing(self) -> Self:
        """Return itself: a is already a place of the ground."""
        return self


@named_keywords
@dataclass(frozen=True, eq=False)
class RollingDisc(Joint):
    """Let a disc roll without slip on a line, or on a circle: one row of phi, its distance, m, and one velocity row, the slip, m/s.

    On the line through a along d_A, with the angular velocity w_B of b and s = 1 if the disc is on the left of the line, else -1:

        `phi = d_A x (x_B - x_A) - s r`,   `psi = d_A . (x_B' - x_A') + s r w_B`

    On a circle of radius R about a, with s = 1 if the disc is drawn outside it, s = -1 inside, and e = s r:

        `phi = (w . w - (R + e)^2) / (2 (R + e))`,   `psi = (w x w') / (R + e) - e w_B - R w_A`,   `w = x_B - x_A`

    The line or circle moves with its body. The disc neither lifts off nor slips, whatever the force. Reaction on b, (2,): force at the contact,
    N; its moment about the centre is not listed.

    Parameters
    ----------
    a : Attachment or Ground
        A point on the line with its direction, or the centre of the circle.
    b : Attachment
        The centre of the disc.
    radius : float, m
        r > 0 of the disc.
    circle : float, m, optional
        R > 0. Default: a line.
    name : str, optional

    Raises
    ------
    InputError
        For a radius that is not positive, a side without a direction, and as for Joint.

    Notes
    -----
    Bloch, Nonholonomic Mechanics and Control (2015), section 1.4.
    """

    radius: float = field(metadata=check(positive, "metres"))
    circle: float | None = field(default=None, metadata=check(optional, positive, "metres"))
    components = FORCE
    placing = "place the disc so that it touches the line or the circle"
    directed = ("a", "b")

    def __post_init__(self):
        """Check the fields, and that both sides have places in the plane. Raises InputError."""
        super().__post_init__()
        require_places(self.label, self.a, self.b)

    def rows(self) -> list[Row | Vector]:
        """The distance of the centre from the line or the circle."""
        if self.circle is None:
            return [(cross(self.a.d, self.b.x - self.a.x) - self._signed).named("normal", "N")]
        w, distance = self.b.x - self.a.x, self.circle + self._signed
        return [((dot(w, w) - distance**2) / (2.0 * distance)).named("normal", "N")]

    def velocity_rows(self) -> list[Row | Vector]:
        """The velocity of the disc at the contact against the line or the circle."""
        r, w, spin = self._signed, self.b.x - self.a.x, cross(self.b.d, self.b.d.rate)
        if self.circle is None:
            return [(dot(self.a.d, w.rate) + r * spin).named("friction", "N")]
        slip = cross(w, w.rate) / (self.circle + r) - r * spin - self.circle * cross(self.a.d, self.a.d.rate)
        return [slip.named("friction", "N")]

    @property
    def _signed(self):
        """Radius of the disc with the sign of the side of the line on which it rolls, or of inside (-) and outside (+) of the circle."""
        w = self.b.x.rest - self.a.x.rest
        on_line = self.circle is None
        left = (self.a.d.rest.conjugate() * w).imag >= 0.0 if on_line else max(self.radius, abs(w)) >= self.circle
        return self.radius if left else -self.radius


@named_keywords
@dataclass(frozen=True, eq=False)
class Skate(Joint):
    """Let a point move along its direction only, like a skate or a wheel: `psi = Q d x x'` (1 velocity row, m/s), Q a rotation by an angle.

    Reaction, (2,): force, N, across the direction.

    Parameters
    ----------
    at : Attachment
        With a direction.
    angle : Profile, function of time or float, rad
        From the direction of the attachment to that of the skate, as of a steered wheel; 0 by default.
    name : str, optional

    Raises
    ------
    InputError
        For an angle that is no profile, an attachment without a direction, and if `at` is not an attachment of a body.
    """

    a: Any = field(default=ground, init=False)
    b: Any = field(default=None, init=False)
    at: Attachment
    angle: "Profile | Callable[[float], float] | float" = 0.0
    components = FORCE
    directed = ("b",)

    def __post_init__(self):
        """Check the fields; the sides are the ground and the attachment."""
        label = self.label
        require_attachment(label, self.at)
        angle = float(self.angle) if is_number(self.angle) else as_profile(self.angle, label)
        settle(self, a=ground.at(self.at.point), b=self.at, angle=angle)
        self.require_directions(self.b)

    def velocity_rows(self) -> list[Row | Vector]:
        """The velocity row `Q d x x'`, m/s: the velocity of the point across the skate's direction."""
        return [cross(self.b.d.turned(self.angle), self.b.x.rate).named("across", "N")]

    def facing(self) -> Self:
        """Return itself: a is already a place of the ground."""
        return self
