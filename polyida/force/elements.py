"""The force elements that come with polyida beside Contact: springs, torques and forces, by numbers, profiles or functions of state."""

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass
from inspect import Parameter, signature
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polyida.errors import InputError
from polyida.force.force_element import ForceElement
from polyida.jit.user_functions import compiled, is_compiled
from polyida.joint.attachment import Attachment, Ground, ground, require_attachment, require_directions, require_places, require_sides
from polyida.profile import Profile, as_profile
from polyida.validation import is_flag, named_keywords, number, reals, settle

PLAIN = (Parameter.POSITIONAL_ONLY, Parameter.POSITIONAL_OR_KEYWORD)
FURTHEST = 0.95 * np.pi  # rad: where the angle is taken to be lost soon


def is_of_state(given, count):
    """Whether it is a function that needs `count` arguments, where one of time takes one."""
    try:
        parameters = signature(given).parameters.values()
    except (TypeError, ValueError):
        return False
    return sum(p.kind in PLAIN and p.default is p.empty for p in parameters) == count


def asked(element, field, arguments, shape=()):
    """The element for Python, its function of state looked at. That raises InputError unless it gives real numbers of a shape."""

    def call(*given):
        answer = function(*given)
        found = reals(answer)
        if found is None or found.shape != shape:
            wanted = "two numbers" if shape else "a number"
            raise InputError(f"{element.label}: {field}({arguments}) must return {wanted}, not {str(answer)[:80]}")
        return found if shape else float(found)

    if not callable(function := getattr(element, field)):
        return element
    other = copy(element)
    settle(other, **{field: call})
    return other


def along(x):
    """(length of the line from the first side to the second, its direction, which is zero where the length is)."""
    wx, wy = x[1, 0] - x[0, 0], x[1, 1] - x[0, 1]
    length = np.sqrt(wx * wx + wy * wy)
    ux, uy = (wx / length, wy / length) if length > 0.0 else (0.0, 0.0)
    return length, ux, uy


def spring(self, t, x, v):
    """`u N` on the first side, `-u N` on the second: `N = k (l - l0) + c u.w' + N0`, u = w/l from the first to the second, zero at l = 0."""
    length, ux, uy = along(x)
    rate = ux * (v[1, 0] - v[0, 0]) + uy * (v[1, 1] - v[0, 1])
    pull = self.stiffness * (length - self.length) + self.damping * rate + self.preload
    return np.array(((pull * ux, pull * uy), (-pull * ux, -pull * uy)))


def spring_with_function(self, t, x, v):
    """The same with `force(l - l0, u.w')` in N."""
    length, ux, uy = along(x)
    rate = ux * (v[1, 0] - v[0, 0]) + uy * (v[1, 1] - v[0, 1])
    pull = self.force(length - self.length, rate) if length > 0.0 else 0.0
    return spring(self, t, x, v) + np.array(((pull * ux, pull * uy), (-pull * ux, -pull * uy)))


def spring_energy(self, x):
    """`k e^2/2 + N0 e`, e = l - l0."""
    e = along(x)[0] - self.length
    return 0.5 * self.stiffness * e * e + self.preload * e


@compiled
@named_keywords
@dataclass(frozen=True, eq=False)
class SpringDamper(ForceElement):
    """A spring and a damper along the line between two points: `N = k (l - l0) + c l' + N0`, N, pulls a and b together where N > 0.

    a, b: attachments or places of the ground. stiffness k, N/m; damping c, N s/m; length l0, m, at which the spring rests, that of the
    drawing where it is None; preload N0, N. Energy `k e^2/2 + N0 e`, e = l - l0; the damper dissipates `c l'^2`. force: a further force
    `force(e, l')`, N, e.g. `lambda e, rate: 1e4 * e**3`, whose energy is the integral of `force(e, 0)`; no file holds it. It is Python
    unless it is compiled (`polyida.compiled`); its energy, which EnergyMomentum asks for in steps, is Python in any case.
    Where l = 0 the line has no direction and there is no force. Raises InputError for wrong values.
    """

    a: Any
    b: Any
    stiffness: float
    damping: float = 0.0
    length: float | None = None
    preload: float = 0.0
    force: Callable[[float, float], float] | None = None
    name: str | None = None
    dissipates = True

    def __post_init__(self):
        require_sides(self.label, self.a, self.b)
        require_places(self.label, self.a, self.b)
        length = np.linalg.norm(self.b.point - self.a.point) if self.length is None else self.length
        settle(
            self,
            stiffness=number(self.label, "stiffness", self.stiffness, "N/m", 0.0),
            damping=number(self.label, "damping", self.damping, "N s/m", 0.0),
            length=number(self.label, "length", length, "m", 0.0),
            preload=number(self.label, "preload", self.preload, "N"),
        )
        if self.force is not None and not callable(self.force):
            raise InputError(f"{self.label}: force = {self.force!r} must be a function of the elongation, m, and its rate, m/s")

    def compiled_functions(self) -> dict[str, Any]:
        """Without the energy of a further force; none if that is Python."""
        if self.force:
            return {"forces": spring_with_function} if is_compiled(self.force) else {}
        return {"forces": spring, "energy": spring_energy}

    def sides(self) -> tuple:
        """Its two points."""
        return self.a, self.b

    def forces(self, t: float, x: NDArray, v: NDArray) -> NDArray:
        """`u N` on a and `-u N` on b, (2, 2), N."""
        return (spring_with_function if self.force else spring)(asked(self, "force", "elongation, rate"), t, x, v)

    def energy(self, x: NDArray) -> float:
        """`k e^2/2 + N0 e` and the integral of `force(e, 0)`, J."""
        further = self.force
        if not further:
            return spring_energy(self, x)
        from scipy.integrate import quad

        length: Any = self.length
        return spring_energy(self, x) + quad(lambda s: further(s, 0.0), 0.0, float(np.linalg.norm(x[1] - x[0])) - length)[0]


def turned(self, x):
    """The angle by which the second direction has turned against the first."""
    ex, ey = self.turn[0] * x[0, 0] - self.turn[1] * x[0, 1], self.turn[1] * x[0, 0] + self.turn[0] * x[0, 1]
    return np.arctan2(ex * x[1, 1] - ey * x[1, 0], ex * x[1, 0] + ey * x[1, 1])


@compiled
@named_keywords
@dataclass(frozen=True, eq=False)
class TorsionSpring(ForceElement):
    """A torsion spring and damper between two directions: moment `M = k (angle - angle0) + c angle'`, N m, on a, and -M on b.

    a, b: sides with a direction, one of them perhaps ground. The angle is that by which b has turned against a since the reference
    configuration, rad. stiffness k, N m/rad; damping c, N m s/rad; angle: angle0, at which the spring rests. Energy `k (angle - angle0)^2
    / 2`; the damper dissipates `c angle'^2`. The angle is told from the directions alone, so it holds less than half a turn to either
    side: beyond 0.95 half-turns the force is not defined, and the run stops there and says so.
    Raises InputError for wrong values, and for a side without a direction.
    """

    a: Any
    b: Any
    stiffness: float
    damping: float = 0.0
    angle: float = 0.0
    name: str | None = None
    dissipates = True

    def __post_init__(self):
        require_sides(self.label, self.a, self.b)
        require_directions(self.label, self.a, self.b)
        settle(
            self,
            stiffness=number(self.label, "stiffness", self.stiffness, "N m/rad", 0.0),
            damping=number(self.label, "damping", self.damping, "N m s/rad", 0.0),
            angle=number(self.label, "angle", self.angle, "rad"),
        )

    def sides(self) -> tuple:
        """Its two directions."""
        a, b = (side.facing(other) if isinstance(side, Ground) else side for side, other in ((self.a, self.b), (self.b, self.a)))
        return a.d, b.d

    @property
    def turn(self) -> NDArray:
        """Cosine and sine of the angle from a to b at rest."""
        a, b = (side.rest for side in self.sides())
        turn = b / a / abs(b / a)
        return np.array([turn.real, turn.imag])

    def forces(self, t: float, x: NDArray, v: NDArray) -> NDArray:
        """`M i d / |d|^2` on the direction of a, the opposite on that of b, (2, 2), J; nan beyond 0.95 half-turns."""
        dx, dy, angle = x[1, 0], x[1, 1], turned(self, x)
        first, second = x[0, 0] * x[0, 0] + x[0, 1] * x[0, 1], dx * dx + dy * dy
        rate = (dx * v[1, 1] - dy * v[1, 0]) / second - (x[0, 0] * v[0, 1] - x[0, 1] * v[0, 0]) / first
        moment = self.stiffness * (angle - self.angle) + self.damping * rate if abs(angle) < FURTHEST else np.nan
        return np.array(((-moment * x[0, 1] / first, moment * x[0, 0] / first), (moment * dy / second, -moment * dx / second)))

    def energy(self, x: NDArray) -> float:
        """`k (angle - angle0)^2 / 2`, J."""
        return 0.5 * self.stiffness * (turned(self, x) - self.angle) ** 2

    def undefined(self, x: NDArray) -> str:
        """Where it is turned too far."""
        angle = turned(self, x)
        return f"it is turned by {angle:.3g} rad, of which it holds {FURTHEST:.3g}" if abs(angle) >= FURTHEST else ""


def turning(self, t, x, v):
    """The moment of time on the direction d, the opposite on a second one."""
    return moments(x, self.moment(t))


def moments(x, moment):
    """`M i d / |d|^2` on each direction d, whose power is M times the angle's rate; M is the opposite on the second."""
    f = np.empty(x.shape)
    for i in range(x.shape[0]):
        square = x[i, 0] * x[i, 0] + x[i, 1] * x[i, 1]
        f[i, 0], f[i, 1], moment = -moment * x[i, 1] / square, moment * x[i, 0] / square, -moment
    return f


def turning_by_state(self, t, x, v):
    """The same of a moment `moment(t, angle, rate)`."""
    cosine, sine, rate, sign = 1.0, 0.0, 0.0, 1.0
    for i in range(x.shape[0]):
        c, s, dx, dy = self.rest[i, 0], self.rest[i, 1], x[i, 0], x[i, 1]
        ex, ey = c * dx + s * dy, sign * (c * dy - s * dx)
        cosine, sine = cosine * ex - sine * ey, cosine * ey + sine * ex
        rate, sign = rate + sign * (dx * v[i, 1] - dy * v[i, 0]) / (dx * dx + dy * dy), -sign
    return moments(x, self.moment(t, np.arctan2(sine, cosine), rate))


@compiled
@named_keywords
@dataclass(frozen=True, eq=False)
class Torque(ForceElement):
    """A moment M, N m, counter-clockwise, on an attachment with a direction d: the generalised force `M i d / |d|^2` on d.

    Its work is M times the angle that d turns by. against: an attachment of another body, on which -M acts, as of a motor between two
    bodies; None: the ground. moment: a number, a profile of time, a function of time, or a function of state `moment(t, angle, rate)` of
    three arguments: the angle that d has turned by, against the other direction where there is one, rad, between -pi and pi, and its
    rate, rad/s. No file holds a function of state; it is Python unless it is compiled (`polyida.compiled`).
    Raises InputError for an attachment without a direction, two of one body, and a moment that is none of these.
    """

    at: Attachment
    moment: Profile | Callable | float
    against: Attachment | None = None
    name: str | None = None

    def __post_init__(self):
        require_sides(self.label, self.at, ground if self.against is None else self.against)
        for side in (self.at,) if self.against is None else (self.at, self.against):
            require_attachment(self.label, side)
            require_directions(self.label, side)
        if not is_of_state(self.moment, 3):
            settle(self, moment=as_profile(self.moment, self.label))

    def compiled_functions(self) -> dict[str, Any]:
        """None where the moment is Python."""
        of_time = isinstance(self.moment, Profile)
        return {"forces": turning if of_time else turning_by_state} if of_time or is_compiled(self.moment) else {}

    @property
    def rest(self) -> NDArray:
        """The directions at rest, (sides, 2)."""
        return np.array([[side.rest.real, side.rest.imag] for side in self.sides()])

    def sides(self) -> tuple:
        """The direction, or both."""
        return (self.at.d,) if self.against is None else (self.at.d, self.against.d)

    def forces(self, t: float, x: NDArray, v: NDArray) -> NDArray:
        """`M i d / |d|^2`, and the opposite on a second direction, (sides, 2), J."""
        if isinstance(self.moment, Profile):
            return turning(self, t, x, v)
        return turning_by_state(asked(self, "moment", "t, angle, rate"), t, x, v)


def push(self, t, x, v):
    """The force of time on the point."""
    return followed(self, x, self.force[0](t), self.force[1](t))


def push_by_state(self, t, x, v):
    """The force of state on the point."""
    fx, fy = self.force(t, x[0], v[0])
    return followed(self, x, fx, fy)


def followed(self, x, fx, fy):
    """The force, turned as the direction, the second side if there is one, has been from rest; none on the direction."""
    f = np.zeros(x.shape)
    f[0, 0], f[0, 1] = fx, fy
    if x.shape[0] > 1:
        dx, dy, wx, wy = x[1, 0], x[1, 1], self.way[0], self.way[1]
        size = np.sqrt((dx * dx + dy * dy) * (wx * wx + wy * wy))
        c, n = (dx * wx + dy * wy) / size, (dy * wx - dx * wy) / size
        f[0, 0], f[0, 1] = c * fx - n * fy, n * fx + c * fy
    return f


@compiled
@named_keywords
@dataclass(frozen=True, eq=False)
class Force(ForceElement):
    """A force, N, at the point of an attachment.

    force: a pair (fx, fy), each a number, a profile or a function of time; or a function of state `force(t, x, v)` of place, m, and
    velocity, m/s, (2,) each, that gives (fx, fy). follower: whether it turns with the direction of the attachment from where that is in
    the reference configuration. No file holds a function of state; it is Python unless it is compiled (`polyida.compiled`).
    Raises InputError for a force that is none of these, and for a follower at an attachment without a direction.
    """

    at: Attachment
    force: Sequence[Profile | Callable[[float], float] | float] | Callable[..., Any]
    follower: bool = False
    name: str | None = None

    def __post_init__(self):
        require_attachment(self.label, self.at)
        if not is_flag(self.follower):
            raise InputError(f"{self.label}: follower = {self.follower!r} must be True or False")
        if self.follower and not self.at.has_direction:
            raise InputError(f"{self.label}: {self.at!r} has no direction to follow; {self.at.advice}")
        if is_of_state(self.force, 3):
            return
        if not isinstance(self.force, (tuple, list, np.ndarray)) or len(self.force) != 2:
            raise InputError(f"{self.label}: force = {self.force!r} must be a pair of numbers or profiles, or a function of (t, x, v)")
        settle(self, force=tuple(as_profile(component, self.label) for component in self.force))

    def compiled_functions(self) -> dict[str, Any]:
        """None where the force is Python."""
        of_state = callable(self.force)
        return {} if of_state and not is_compiled(self.force) else {"forces": push_by_state if of_state else push}

    @property
    def way(self) -> NDArray:
        """The direction at rest that it follows, (2,)."""
        return np.array([self.at.d.rest.real, self.at.d.rest.imag]) if self.follower else np.zeros(2)

    def sides(self) -> tuple:
        """The point, and the direction that it follows."""
        return (self.at, self.at.d) if self.follower else (self.at,)

    def forces(self, t: float, x: NDArray, v: NDArray) -> NDArray:
        """The force on the point, (1, 2), N, and nothing on a direction that it follows, (2, 2)."""
        return push_by_state(asked(self, "force", "t, x, v", (2,)), t, x, v) if callable(self.force) else push(self, t, x, v)
