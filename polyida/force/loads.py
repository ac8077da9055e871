"""Loads: forces, edge tractions and torques given by numbers, profiles of time or functions of state."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from polyida.errors import InputError
from polyida.fields import check, check_fields, pair, time_profile
from polyida.force.force_element import ForceElement, takes_three, with_checked_function
from polyida.jit.user_functions import compiled, is_compiled
from polyida.joint.attachment import Attachment, ground, require_attachment, require_directions, require_sides
from polyida.profile import Profile, as_profile
from polyida.validation import flag, labelled, listed, named_keywords, settle


@named_keywords
@dataclass(frozen=True, eq=False)
class PointLoad:
    """A dead force at the mean point of an attachment, times a profile of time.

    Parameters
    ----------
    at : Attachment
    force : (2,) float, N
    profile : Profile, function of time or float, default 1
    name : str, optional

    Raises
    ------
    InputError
        For an `at` that is no attachment of a body, a force that is not two finite numbers, or a wrong profile.
    """

    at: Attachment
    force: tuple = field(metadata=check(pair))
    profile: "Profile | Callable[[float], float] | float" = field(default=1.0, metadata=check(time_profile))
    name: str | None = None

    def __post_init__(self):
        """Check that `at` is an attachment, and the other fields. Raises InputError."""
        label = labelled("PointLoad", self.name)
        require_attachment(label, self.at)
        check_fields(self, label)

    def nodal(self) -> np.ndarray:
        """Return the forces on the attachment's nodes for a profile value of 1, (k, 2), N."""
        return self.at.share(self.force)


@named_keywords
@dataclass(frozen=True, eq=False)
class EdgeTraction:
    """A dead traction on a section of the boundary, times a profile of time.

    Parameters
    ----------
    at : Attachment
        A section with a length.
    traction : (2,) float, Pa
        Force per reference area (length times thickness).
    profile : Profile, function of time or float, default 1
    name : str, optional

    Raises
    ------
    InputError
        For an attachment without length, a traction that is not two finite numbers, or a wrong profile.
    """

    at: Attachment
    traction: tuple = field(metadata=check(pair))
    profile: "Profile | Callable[[float], float] | float" = field(default=1.0, metadata=check(time_profile))
    name: str | None = None

    def __post_init__(self):
        """Check the fields, and that the section has a length."""
        label = labelled("EdgeTraction", self.name)
        require_attachment(label, self.at)
        if not self.at.length > 0:
            raise InputError(f"{label}: {self.at!r} has no length to act on; use a section of two neighbouring nodes or more")
        check_fields(self, label)

    def nodal(self) -> np.ndarray:
        """Return the forces on the section's nodes for a profile value of 1, (k, 2), N: exact for the elements' linear edges."""
        section = self.at.body.mesh.section(self.at.nodes)
        lengths = np.empty(len(self.at.nodes))
        lengths[np.argsort(self.at.nodes)] = section.lengths[np.argsort(section.nodes)]
        return np.outer(lengths * self.at.body.thickness, np.asarray(self.traction, float))


def profile_torque(self, t, x, v):
    """Forces on the directions, (sides, 2), of a moment given by a profile of time."""
    return as_forces(x, self.moment(t))


def state_torque(self, t, x, v):
    """The forces on the directions of a moment given by a function `moment(t, angle, rate)`."""
    angle, rate = measured(self, x, v)
    return as_forces(x, self.moment(t, angle, rate))


def measured(self, x, v):
    """(angle, rate) of the rotation since the reference configuration of the first direction, relative to the second if there is one, rad, in (-pi, pi]."""
    cosine, sine, rate, sign = 1.0, 0.0, 0.0, 1.0
    for i in range(x.shape[0]):
        c, s, dx, dy = self.rest_directions[i, 0], self.rest_directions[i, 1], x[i, 0], x[i, 1]
        ex, ey = c * dx + s * dy, sign * (c * dy - s * dx)
        cosine, sine = cosine * ex - sine * ey, cosine * ey + sine * ex
        rate, sign = rate + sign * (dx * v[i, 1] - dy * v[i, 0]) / (dx * dx + dy * dy), -sign
    return np.arctan2(sine, cosine), rate


def as_forces(x, moment):
    """`M i d / |d|^2` on each direction d, whose power is M times the angle's rate; -M on the second."""
    f = np.empty(x.shape)
    for i in range(x.shape[0]):
        square = x[i, 0] * x[i, 0] + x[i, 1] * x[i, 1]
        f[i, 0], f[i, 1], moment = -moment * x[i, 1] / square, moment * x[i, 0] / square, -moment
    return f


class RotationElement(ForceElement, part=False):
    """A force element that acts on the direction of `at`, and with the opposite sign on that of `against`, if this is not None."""

    at: Any
    against: Any

    def require_rotation(self) -> None:
        """Raise InputError unless `at` and `against` are attachments of two bodies, with directions."""
        require_sides(self.label, self.at, ground if self.against is None else self.against)
        for side in (self.at,) if self.against is None else (self.at, self.against):
            require_attachment(self.label, side)
            require_directions(self.label, side)

    @property
    def rest_directions(self) -> np.ndarray:
        """The directions in the reference configuration, (sides, 2)."""
        return np.array([[side.rest.real, side.rest.imag] for side in self.sides()])

    def sides(self) -> tuple:
        """Return the direction on which it acts, or both directions."""
        return (self.at.d,) if self.against is None else (self.at.d, self.against.d)


@compiled
@named_keywords
@dataclass(frozen=True, eq=False)
class Torque(RotationElement):
    """A moment M, counter-clockwise, on the direction d of an attachment: the generalised force `M i d / |d|^2` on d.

    Its work is M times the angle by which d turns.

    Parameters
    ----------
    at : Attachment
        With a direction.
    moment : float, Profile, function of time or of state, N m
        A function of state is `moment(t, angle, rate)`: the angle by which d has turned since the reference configuration, relative to `against` if given,
        rad, between -pi and pi, and its rate, rad/s. Files do not store it; it is called in Python unless it is compiled
        (`polyida.compiled`).
    against : Attachment, optional
        Of another body; -M acts on it. Default: the ground.
    name : str, optional

    Raises
    ------
    InputError
        For an attachment without a direction, two attachments of one body, or a wrong moment.
    """

    at: Attachment
    moment: "Profile | Callable | float"
    against: Attachment | None = None
    name: str | None = None

    def __post_init__(self):
        """Check that it acts on a direction; a moment that is no function of state becomes a profile of time."""
        self.require_rotation()
        if not takes_three(self.moment):
            settle(self, moment=as_profile(self.moment, self.label))

    def compiled_functions(self) -> dict[str, Any]:
        """Return {"forces": function}; empty if the moment is a Python function of state."""
        of_time = isinstance(self.moment, Profile)
        return {"forces": profile_torque if of_time else state_torque} if of_time or is_compiled(self.moment) else {}

    def forces(self, t: float, x: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return `M i d / |d|^2`, and the opposite for a second direction, (sides, 2), J."""
        if isinstance(self.moment, Profile):
            return profile_torque(self, t, x, v)
        return state_torque(with_checked_function(self, "moment", "t, angle, rate"), t, x, v)


def profile_force(self, t, x, v):
    """Forces on the sides of a force given by two profiles of time."""
    return followed(self, x, self.force[0](t), self.force[1](t))


def state_force(self, t, x, v):
    """The forces on the sides of a force given by a function `force(t, x, v)`."""
    fx, fy = self.force(t, x[0], v[0])
    return followed(self, x, fx, fy)


def followed(self, x, fx, fy):
    """The force on the first side, rotated by the rotation of the direction, the second side if there is one."""
    f = np.zeros(x.shape)
    f[0, 0], f[0, 1] = fx, fy
    if x.shape[0] > 1:
        dx, dy, wx, wy = x[1, 0], x[1, 1], self.rest_direction[0], self.rest_direction[1]
        size = np.sqrt((dx * dx + dy * dy) * (wx * wx + wy * wy))
        c, n = (dx * wx + dy * wy) / size, (dy * wx - dx * wy) / size
        f[0, 0], f[0, 1] = c * fx - n * fy, n * fx + c * fy
    return f


@compiled
@named_keywords
@dataclass(frozen=True, eq=False)
class Force(ForceElement):
    """A force at the point of an attachment.

    Parameters
    ----------
    at : Attachment
    force : pair of float, Profile or function of time, or one function of state, N
        A function of state is `force(t, x, v)` of position, m, and velocity, m/s, (2,) each; it returns (fx, fy). Files do not store it; it
        is called in Python unless it is compiled (`polyida.compiled`).
    follower : bool, default False
        True if the force rotates with the direction of the attachment; its components are then those in the reference configuration, along x and y of the
        scene.
    name : str, optional

    Raises
    ------
    InputError
        For a wrong force, or a follower force at an attachment without a direction.
    """

    at: Attachment
    force: "Sequence[Profile | Callable[[float], float] | float] | Callable[..., Any]"
    follower: bool = field(default=False, metadata=check(flag))
    name: str | None = None

    def __post_init__(self):
        """Check the fields: numbers, profiles or a function of state, and a direction to follow."""
        require_attachment(self.label, self.at)
        check_fields(self, self.label)
        if self.follower and not self.at.has_direction:
            raise InputError(f"{self.label}: {self.at!r} has no direction to follow; {self.at.advice}")
        if takes_three(self.force):
            return
        if len(listed(self.label, "force", self.force)) != 2:
            raise InputError(f"{self.label}: force = {self.force!r} must be a pair of numbers or profiles, or a function of (t, x, v)")
        settle(self, force=tuple(as_profile(component, self.label) for component in self.force))

    def compiled_functions(self) -> dict[str, Any]:
        """Return {"forces": function}; empty if the force is a Python function of state."""
        of_state = callable(self.force)
        return {} if of_state and not is_compiled(self.force) else {"forces": state_force if of_state else profile_force}

    @property
    def rest_direction(self) -> np.ndarray:
        """Direction (2,) in the reference configuration that a follower force follows; zero for a dead force."""
        return np.array([self.at.d.rest.real, self.at.d.rest.imag]) if self.follower else np.zeros(2)

    def sides(self) -> tuple:
        """Return the point, and the direction that it follows."""
        return (self.at, self.at.d) if self.follower else (self.at,)

    def forces(self, t: float, x: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the force on the point, (1, 2), N, and zero for a direction that it follows, (2, 2)."""
        if callable(self.force):
            return state_force(with_checked_function(self, "force", "t, x, v", (2,)), t, x, v)
        return profile_force(self, t, x, v)
