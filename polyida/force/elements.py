"""The force elements that come with polyida beside Contact: springs, torques and forces, by numbers, profiles or functions of state."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from inspect import Parameter, signature
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polyida.body.material import number
from polyida.errors import InputError
from polyida.force.force_element import ForceElement, by_energy, by_law
from polyida.given import is_flag, reals, settle
from polyida.jit import entry, part
from polyida.joint.attachment import Attachment, Ground, ground, require_attachment, require_directions, require_places, require_sides
from polyida.keywords import named_keywords
from polyida.profile import Profile, as_profile

PLAIN = (Parameter.POSITIONAL_ONLY, Parameter.POSITIONAL_OR_KEYWORD)
# constants of compiled code
FURTHEST = 0.95 * np.pi  # rad: where the angle is taken to be lost soon


def is_of_state(given, count):
    """Whether it is a function that needs `count` arguments, where one of time takes one."""
    try:
        parameters = signature(given).parameters.values()
    except (TypeError, ValueError):
        return False
    return sum(p.kind in PLAIN and p.default is p.empty for p in parameters) == count


def answer(part, call, given, shape=()):
    """What a function of state gave, as real numbers of a shape. Raises InputError naming the part and how it was called."""
    found = reals(given)
    if found is None or found.shape != shape:
        raise InputError(f"{part}: {call} must return {'two numbers' if shape else 'a number'}, not {str(given)[:80]}")
    return found


@entry
def spring(t, x, v, data, f):
    """`-u N` on the second side, `u N` on the first: `N = k (l - l0) + c u.w' + N0`, u = w/l from the first to the second, zero at l = 0."""
    wx, wy = x[1, 0] - x[0, 0], x[1, 1] - x[0, 1]
    length = np.sqrt(wx * wx + wy * wy)
    ux, uy = (wx / length, wy / length) if length > 0.0 else (0.0, 0.0)
    rate = ux * (v[1, 0] - v[0, 0]) + uy * (v[1, 1] - v[0, 1])
    pull = data[0] * (length - data[2]) + data[1] * rate + data[3]
    f[0, 0], f[0, 1] = pull * ux, pull * uy
    f[1, 0], f[1, 1] = -f[0, 0], -f[0, 1]


@entry
def spring_energy(x, data):
    """`k e^2/2 + N0 e`, e = l - l0."""
    e = np.sqrt((x[1, 0] - x[0, 0]) ** 2 + (x[1, 1] - x[0, 1]) ** 2) - data[2]
    return 0.5 * data[0] * e * e + data[3] * e


@named_keywords
@dataclass(frozen=True, eq=False)
class SpringDamper(ForceElement):
    """A spring and a damper along the line between two points: `N = k (l - l0) + c l' + N0`, N, pulls a and b together where N > 0.

    a, b: attachments or places of the ground. stiffness k, N/m; damping c, N s/m; length l0, m, at which the spring rests, that of the
    drawing where it is None; preload N0, N. Energy `k e^2/2 + N0 e`, e = l - l0; the damper dissipates `c l'^2`. force: a further force
    `force(e, l')`, N, e.g. `lambda e, rate: 1e4 * e**3`, whose energy is the integral of `force(e, 0)`; it is Python, and no file holds it.
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
    law = spring
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

    @property
    def compiled_law(self) -> Any:
        """None where a further force is Python."""
        return None if self.force else spring

    @property
    def compiled_energy(self) -> Any:
        """Without that of a further force, which is Python."""
        return spring_energy

    def sides(self) -> tuple:
        """Its two points."""
        return self.a, self.b

    def numbers(self) -> list:
        """k, c, l0 and N0."""
        return [self.stiffness, self.damping, self.length, self.preload]

    def forces(self, t: float, x: NDArray, v: NDArray) -> NDArray:
        """`u N` on a and `-u N` on b, (2, 2), N."""
        f, w = by_law(spring, self, t, x, v), x[1] - x[0]
        length = np.linalg.norm(w)
        if self.force and length:
            given = self.force(self._elongation(x), float(w @ (v[1] - v[0]) / length))
            f += np.outer([1.0, -1.0], answer(self.label, "force(elongation, rate)", given) * w / length)
        return f

    def _elongation(self, x):
        return float(np.linalg.norm(x[1] - x[0])) - self.length

    def energy(self, x: NDArray) -> float:
        """`k e^2/2 + N0 e` and the integral of `force(e, 0)`, J."""
        further = self.force
        if not further:
            return by_energy(self, x)
        from scipy.integrate import quad

        return by_energy(self, x) + quad(lambda s: further(s, 0.0), 0.0, self._elongation(x))[0]


@part
def turned(x, data):
    """The angle by which the second direction has turned against the first."""
    ex, ey = data[3] * x[0, 0] - data[4] * x[0, 1], data[4] * x[0, 0] + data[3] * x[0, 1]
    return np.arctan2(ex * x[1, 1] - ey * x[1, 0], ex * x[1, 0] + ey * x[1, 1])


@entry
def torsion(t, x, v, data, f):
    """`-i M d_B / |d_B|^2` on the second direction, the opposite on the first: `M = k (angle - angle0) + c angle'`; nan beyond FURTHEST.

    data: k, c, angle0, and the turn of the first at rest onto the second.
    """
    dx, dy, angle = x[1, 0], x[1, 1], turned(x, data)
    first, second = x[0, 0] * x[0, 0] + x[0, 1] * x[0, 1], dx * dx + dy * dy
    rate = (dx * v[1, 1] - dy * v[1, 0]) / second - (x[0, 0] * v[0, 1] - x[0, 1] * v[0, 0]) / first
    moment = data[0] * (angle - data[2]) + data[1] * rate if abs(angle) < FURTHEST else np.nan
    f[0, 0], f[0, 1] = -moment * x[0, 1] / first, moment * x[0, 0] / first
    f[1, 0], f[1, 1] = moment * dy / second, -moment * dx / second


@entry
def torsion_energy(x, data):
    """`k (angle - angle0)^2 / 2`."""
    return 0.5 * data[0] * (turned(x, data) - data[2]) ** 2


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
    law = torsion
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

    @property
    def compiled_energy(self) -> Any:
        """That of its angle."""
        return torsion_energy

    def sides(self) -> tuple:
        """Its two directions."""
        a, b = (side.facing(other) if isinstance(side, Ground) else side for side, other in ((self.a, self.b), (self.b, self.a)))
        return a.d, b.d

    def numbers(self) -> list:
        """k, c, angle0, and cosine and sine of the angle from a to b at rest."""
        a, b = (side.rest for side in self.sides())
        turn = b / a / abs(b / a)
        return [self.stiffness, self.damping, self.angle, turn.real, turn.imag]

    def _angle(self, x):
        a, b = (side.rest for side in self.sides())
        d, e = x[0] @ [1.0, 1j], x[1] @ [1.0, 1j]
        return float(np.angle(e * a / (d * b)))

    def energy(self, x: NDArray) -> float:
        """`k (angle - angle0)^2 / 2`, J."""
        return by_energy(self, x)

    def undefined(self, x: NDArray) -> str:
        """Where it is turned too far."""
        angle = self._angle(x)
        return f"it is turned by {angle:.3g} rad, of which it holds {FURTHEST:.3g}" if abs(angle) >= FURTHEST else ""


@entry
def turning(t, x, v, data, f):
    """`M i d / |d|^2` on the direction d, whose power is M times the angle's rate, and the opposite on a second one."""
    for i in range(x.shape[0]):
        moment = data[0] if i == 0 else -data[0]
        square = x[i, 0] * x[i, 0] + x[i, 1] * x[i, 1]
        f[i, 0], f[i, 1] = -moment * x[i, 1] / square, moment * x[i, 0] / square


@named_keywords
@dataclass(frozen=True, eq=False)
class Torque(ForceElement):
    """A moment M, N m, counter-clockwise, on an attachment with a direction d: the generalised force `M i d / |d|^2` on d.

    Its work is M times the angle that d turns by. against: an attachment of another body, on which -M acts, as of a motor between two
    bodies; None: the ground. moment: a number, a profile of time, a function of time, or a function of state `moment(t, angle, rate)` of
    three arguments: the angle that d has turned by, against the other direction where there is one, rad, between -pi and pi, and its
    rate, rad/s. A function of state is Python, and no file holds it.
    Raises InputError for an attachment without a direction, two of one body, and a moment that is none of these.
    """

    at: Attachment
    moment: Profile | Callable | float
    against: Attachment | None = None
    name: str | None = None
    law = turning

    def __post_init__(self):
        require_sides(self.label, self.at, ground if self.against is None else self.against)
        for side in (self.at,) if self.against is None else (self.at, self.against):
            require_attachment(self.label, side)
            require_directions(self.label, side)
        if not is_of_state(self.moment, 3):
            settle(self, moment=as_profile(self.moment, self.label))

    @property
    def compiled_law(self) -> Any:
        """None where the moment is Python."""
        return turning if isinstance(self.moment, Profile) else None

    def sides(self) -> tuple:
        """The direction, or both."""
        return (self.at.d,) if self.against is None else (self.at.d, self.against.d)

    def forces(self, t: float, x: NDArray, v: NDArray) -> NDArray:
        """`M i d / |d|^2`, and the opposite on a second direction, (sides, 2), J."""
        moment: Any = self.moment
        if isinstance(moment, Profile):
            return by_law(turning, self, t, x, v)
        d, signs = x @ [1.0, 1j], np.array([1.0, -1.0])[: len(x)]
        ways = d / [side.rest for side in self.sides()]
        angle, rate = np.angle(ways[0] / (ways[1] if len(d) > 1 else 1.0)), signs @ (v @ [1.0, 1j] / d).imag
        f = answer(self.label, "moment(t, angle, rate)", moment(t, float(angle), float(rate))) * signs * 1j / d.conj()
        return np.stack([f.real, f.imag], axis=1)


@entry
def push(t, x, v, data, f):
    """The force that data are."""
    f[0, 0], f[0, 1] = data[0], data[1]


@entry
def follow(t, x, v, data, f):
    """The force of data's first two turned as the direction, the second side, has been from data's last two; none on the direction."""
    dx, dy = x[1, 0], x[1, 1]
    size = np.sqrt((dx * dx + dy * dy) * (data[2] * data[2] + data[3] * data[3]))
    c, n = (dx * data[2] + dy * data[3]) / size, (dy * data[2] - dx * data[3]) / size
    f[0, 0], f[0, 1] = c * data[0] - n * data[1], n * data[0] + c * data[1]
    f[1, 0] = f[1, 1] = 0.0


@named_keywords
@dataclass(frozen=True, eq=False)
class Force(ForceElement):
    """A force, N, at the point of an attachment.

    force: a pair (fx, fy), each a number, a profile or a function of time; or a function of state `force(t, x, v)` of place, m, and
    velocity, m/s, (2,) each, that gives (fx, fy). follower: whether it turns with the direction of the attachment from where that is in
    the reference configuration. A function of state is Python, and no file holds it.
    Raises InputError for a force that is none of these, and for a follower at an attachment without a direction.
    """

    at: Attachment
    force: Sequence[Profile | Callable[[float], float] | float] | Callable[..., Any]
    follower: bool = False
    name: str | None = None
    law = push

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

    @property
    def compiled_law(self) -> Any:
        """None where the force is Python."""
        return None if callable(self.force) else follow if self.follower else push

    def sides(self) -> tuple:
        """The point, and the direction that it follows."""
        return (self.at, self.at.d) if self.follower else (self.at,)

    def numbers(self) -> list:
        """Both components, and the direction at rest."""
        given: Any = self.force
        return [*given, self.at.d.rest.real, self.at.d.rest.imag] if self.follower else [*given]

    def forces(self, t: float, x: NDArray, v: NDArray) -> NDArray:
        """The force on the point, (1, 2), N, and nothing on a direction that it follows, (2, 2)."""
        if self.compiled_law:
            return by_law(self.compiled_law, self, t, x, v)
        function: Any = self.force
        given = answer(self.label, "force(t, x, v)", function(t, x[0], v[0]), (2,))
        if not self.follower:
            return given[None]
        turn = x[1] @ [1.0, 1j] / self.at.d.rest
        force = complex(turn / abs(turn) * (given @ [1.0, 1j]))
        return np.array([[force.real, force.imag], [0.0, 0.0]])
