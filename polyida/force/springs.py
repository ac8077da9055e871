"""Springs, dampers and contact."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from polyida.errors import InputError
from polyida.fields import check, check_fields, optional
from polyida.force.force_element import ForceElement, with_checked_function
from polyida.jit.user_functions import compiled, is_compiled
from polyida.joint.attachment import Ground, require_directions, require_places, require_sides
from polyida.validation import named_keywords, number, positive, settle

LARGEST = 0.95 * np.pi  # rad, of a torsion spring's rotation: the directions determine it only up to half a turn


def elongation(self, x):
    """(l - l0, unit vector of the line from the first side to the second, zero if l = 0)."""
    wx, wy = x[1, 0] - x[0, 0], x[1, 1] - x[0, 1]
    length = np.sqrt(wx * wx + wy * wy)
    ux, uy = (wx / length, wy / length) if length > 0.0 else (0.0, 0.0)
    return length - self.length, ux, uy


def spring(self, t, x, v):
    """`u N` on the first side, `-u N` on the second: `N = k e + c e' + N0`, e = l - l0."""
    e, ux, uy = elongation(self, x)
    rate = ux * (v[1, 0] - v[0, 0]) + uy * (v[1, 1] - v[0, 1])
    tension = self.stiffness * e + self.damping * rate + self.preload
    return np.array(((tension * ux, tension * uy), (-tension * ux, -tension * uy)))


def spring_with_function(self, t, x, v):
    """`u N` on the first side, `-u N` on the second: `N = k e + c e' + N0 + force(e, e')`."""
    e, ux, uy = elongation(self, x)
    rate = ux * (v[1, 0] - v[0, 0]) + uy * (v[1, 1] - v[0, 1])
    tension = self.force(e, rate) if ux != 0.0 or uy != 0.0 else 0.0
    return spring(self, t, x, v) + np.array(((tension * ux, tension * uy), (-tension * ux, -tension * uy)))


def spring_energy(self, x):
    """Energy of the spring, `k e^2 / 2 + N0 e`, J, at the places x of both sides."""
    e, _, _ = elongation(self, x)
    return 0.5 * self.stiffness * e * e + self.preload * e


@compiled
@named_keywords
@dataclass(frozen=True, eq=False)
class SpringDamper(ForceElement):
    """A spring and a damper along the line between two points: the tension is `N = k e + c e' + N0`, e = l - l0.

    Energy `k e^2 / 2 + N0 e`, dissipation `c e'^2`. At l = 0 the line has no direction and the force is zero.

    Parameters
    ----------
    a, b : Attachment or Ground
    stiffness : float, N/m, k >= 0
    damping : float, N s/m, c >= 0
    length : float, m, l0 >= 0
        Length without tension. Default: the distance in the reference configuration.
    preload : float, N
        N0.
    force : function of (e, e'), m and m/s, optional
        Additional tension, N, e.g. `lambda e, rate: 1e4 * e**3`; its energy is the integral of `force(e, 0)`. Files do not store it; it is
        called in Python unless it is compiled (`polyida.compiled`). Its energy, which EnergyMomentum needs, is always computed in Python.
    name : str, optional

    Raises
    ------
    InputError
        For a wrong number or function, or sides that are no points of two bodies or of a body and the ground.
    """

    a: Any
    b: Any
    stiffness: float = field(metadata=check(number, "N/m", 0.0))
    damping: float = field(default=0.0, metadata=check(number, "N s/m", 0.0))
    length: float | None = field(default=None, metadata=check(number, "m", 0.0))
    preload: float = field(default=0.0, metadata=check(number, "N"))
    force: "Callable[[float, float], float] | None" = None
    name: str | None = None
    dissipates = True

    def __post_init__(self):
        """Check the sides and the fields; the default length is the distance in the reference configuration."""
        require_sides(self.label, self.a, self.b)
        require_places(self.label, self.a, self.b)
        if self.length is None:
            settle(self, length=np.linalg.norm(self.b.point - self.a.point))
        check_fields(self, self.label)
        if self.force is not None and not callable(self.force):
            raise InputError(f"{self.label}: force = {self.force!r} must be a function of the elongation, m, and its rate, m/s")

    def compiled_functions(self) -> dict[str, Any]:
        """Return {"forces", "energy"}; without energy for an additional force, empty if that is Python."""
        if self.force:
            return {"forces": spring_with_function} if is_compiled(self.force) else {}
        return {"forces": spring, "energy": spring_energy}

    def sides(self) -> tuple:
        """Return the two points a and b on which the element acts."""
        return self.a, self.b

    def forces(self, t: float, x: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return `u N` on a and `-u N` on b, (2, 2), N."""
        return (spring_with_function if self.force else spring)(with_checked_function(self, "force", "elongation, rate"), t, x, v)

    def energy(self, x: np.ndarray) -> float:
        """Return `k e^2 / 2 + N0 e` plus the integral of `force(e, 0)`, J."""
        function, energy = self.force, spring_energy(self, x)
        if function:
            from scipy.integrate import quad

            energy += quad(lambda e: function(e, 0.0), 0.0, elongation(self, x)[0])[0]
        return energy


def rotation(self, x):
    """Rotation, rad, -pi to pi, of direction x[1] relative to direction x[0] since the reference configuration; x (2, 2): of both sides."""
    c, s = self.rest_angle[0], self.rest_angle[1]
    ex, ey = c * x[0, 0] - s * x[0, 1], s * x[0, 0] + c * x[0, 1]
    return np.arctan2(ex * x[1, 1] - ey * x[1, 0], ex * x[1, 0] + ey * x[1, 1])


@compiled
@named_keywords
@dataclass(frozen=True, eq=False)
class TorsionSpring(ForceElement):
    """A torsion spring and damper between two directions: moment `M = k (angle - angle0) + c angle'` on a, and -M on b.

    The angle is the rotation of b relative to a since the reference configuration. It is determined by the directions alone: beyond 0.95
    half-turns the force is undefined, and the run stops with a message, also if a step of up to half a turn passes these places. Energy `k (angle - angle0)^2 / 2`, dissipation `c angle'^2`.

    Parameters
    ----------
    a, b : Attachment or Ground
        With directions.
    stiffness : float, N m/rad, k >= 0
    damping : float, N m s/rad, c >= 0
    angle : float, rad
        angle0, without moment.
    name : str, optional

    Raises
    ------
    InputError
        For a wrong number, a side without a direction, or sides of one body.
    """

    a: Any
    b: Any
    stiffness: float = field(metadata=check(number, "N m/rad", 0.0))
    damping: float = field(default=0.0, metadata=check(number, "N m s/rad", 0.0))
    angle: float = field(default=0.0, metadata=check(number, "rad"))
    name: str | None = None
    dissipates = True

    def __post_init__(self):
        """Check the fields, and that both sides have directions. Raises InputError."""
        require_sides(self.label, self.a, self.b)
        require_directions(self.label, self.a, self.b)
        check_fields(self, self.label)

    def sides(self) -> tuple:
        """Return the directions of a and b, on which the element acts."""
        a, b = (side.facing(other) if isinstance(side, Ground) else side for side, other in ((self.a, self.b), (self.b, self.a)))
        return a.d, b.d

    @property
    def rest_angle(self) -> np.ndarray:
        """Cosine and sine of the angle from a to b in the reference configuration."""
        a, b = (side.rest for side in self.sides())
        turn = b / a / abs(b / a)
        return np.array([turn.real, turn.imag])

    def forces(self, t: float, x: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return `M i d / |d|^2` on the direction of a, the opposite on that of b, (2, 2), J; NaN beyond 0.95 half-turns."""
        dx, dy, angle = x[1, 0], x[1, 1], rotation(self, x)
        first, second = x[0, 0] * x[0, 0] + x[0, 1] * x[0, 1], dx * dx + dy * dy
        rate = (dx * v[1, 1] - dy * v[1, 0]) / second - (x[0, 0] * v[0, 1] - x[0, 1] * v[0, 0]) / first
        moment = self.stiffness * (angle - self.angle) + self.damping * rate if abs(angle) < LARGEST else np.nan
        return np.array(((-moment * x[0, 1] / first, moment * x[0, 0] / first), (moment * dy / second, -moment * dx / second)))

    def energy(self, x: np.ndarray) -> float:
        """Return the energy of the spring, `k (angle - angle0)^2 / 2`, J."""
        return 0.5 * self.stiffness * (rotation(self, x) - self.angle) ** 2

    def undefined(self, x: np.ndarray) -> str:
        """Return why the moment is undefined, for a rotation of LARGEST or more; otherwise an empty text."""
        angle = rotation(self, x)
        return f"it is turned by {angle:.3g} rad, of which it holds {LARGEST:.3g}" if abs(angle) >= LARGEST else ""


def hunt_crossley(self, depth, rate):
    """`k depth^n (1 + 3/2 c rate)`, N; zero if that is negative or there is no contact."""
    if depth <= 0.0:
        return 0.0
    return max(0.0, self.stiffness * depth**self.exponent * (1.0 + 1.5 * self.damping * rate))


def line_depth(self, x):
    """Depth of the first side in the half-plane bounded by the line through the second side along the third."""
    wx, wy, dx, dy = x[0, 0] - x[1, 0], x[0, 1] - x[1, 1], x[2, 0], x[2, 1]
    return (wx * dy - wy * dx) / np.sqrt(dx * dx + dy * dy)


def line_force(self, t, x, v):
    """`n F` on the point, `-n F` on the line's point, and `-F d(depth)/dd = -F (i w - depth d/|d|) / |d|` on its direction d.

    n = i d/|d|; w from the line's point to the point, depth = -w . n.
    """
    wx, wy, dx, dy = x[0, 0] - x[1, 0], x[0, 1] - x[1, 1], x[2, 0], x[2, 1]
    size, depth = np.sqrt(dx * dx + dy * dy), line_depth(self, x)
    nx, ny = -dy / size, dx / size
    ax, ay = (-wy - depth * dx / size) / size, (wx - depth * dy / size) / size
    rate = -((v[0, 0] - v[1, 0]) * nx + (v[0, 1] - v[1, 1]) * ny) + ax * v[2, 0] + ay * v[2, 1]
    force = hunt_crossley(self, depth, rate)
    return np.array(((force * nx, force * ny), (-force * nx, -force * ny), (-force * ax, -force * ay)))


def circle_depth(self, x):
    """Depth, m, of the first point in the circle about the second one; negative outside."""
    wx, wy = x[0, 0] - x[1, 0], x[0, 1] - x[1, 1]
    return self.radius - np.sqrt(wx * wx + wy * wy)


def circle_force(self, t, x, v):
    """`n F` on the point, `-n F` on the centre; n from the centre to the point."""
    wx, wy = x[0, 0] - x[1, 0], x[0, 1] - x[1, 1]
    size = np.sqrt(wx * wx + wy * wy)
    nx, ny = wx / size, wy / size
    force = hunt_crossley(self, self.radius - size, -((v[0, 0] - v[1, 0]) * nx + (v[0, 1] - v[1, 1]) * ny))
    return np.array(((force * nx, force * ny), (-force * nx, -force * ny)))


def contact_energy(self, depth):
    """Energy `k depth^(n + 1) / (n + 1)`, J, of a penalty contact; zero without contact."""
    return self.stiffness * max(0.0, depth) ** (self.exponent + 1.0) / (self.exponent + 1.0)


def line_energy(self, x):
    """Energy, J, of a penalty contact with a line, at the places x of both sides."""
    return contact_energy(self, line_depth(self, x))


def circle_energy(self, x):
    """Energy, J, of a penalty contact with a circle, at the places x of both sides."""
    return contact_energy(self, circle_depth(self, x))


@compiled
@named_keywords
@dataclass(frozen=True, eq=False)
class PenaltyContact(ForceElement):
    """Frictionless contact of a point with a line, or with a circle from outside: `F = k delta^n (1 + 3/2 c delta')` >= 0, delta the depth.

    Energy `k delta^(n + 1) / (n + 1)`, dissipation `3/2 c k delta^n delta'^2`; a slow impact with speed v rebounds with (1 - c v) v. The
    `gap` is -delta: steps of all integrators end where the contact opens or closes, and are short enough while it is closed.

    Parameters
    ----------
    a : Attachment or Ground
        The point.
    b : Attachment or Ground
        Without radius: the point is in contact to the right of the line through b along its direction, i.e. below `ground.at(point)`. With
        radius: within the circle about b.
    stiffness : float, N/m^n, k > 0
    damping : float, s/m, c >= 0
    exponent : float, n >= 1
        3/2 for Hertzian contact.
    radius : float, m, > 0, optional
    name : str, optional

    Raises
    ------
    InputError
        For a wrong number, or a line whose side has no direction.

    Notes
    -----
    Hunt, Crossley, J. Appl. Mech. 42 (1975) 440-445.
    """

    a: Any
    b: Any
    stiffness: float = field(metadata=check(positive, "N/m^exponent"))
    damping: float = field(default=0.0, metadata=check(number, "s/m", 0.0))
    exponent: float = field(default=1.5, metadata=check(number, "no unit", 1.0))
    radius: float | None = field(default=None, metadata=check(optional, positive, "metres"))
    name: str | None = None
    dissipates = True

    def __post_init__(self):
        """Check the sides and the fields: a line needs a direction, a circle a radius."""
        require_sides(self.label, self.a, self.b)
        require_places(self.label, self.a, self.b)
        if self.radius is None and not self.b.has_direction:
            raise InputError(f"{self.label}: {self.b!r} has no direction, and there is no radius; give a radius, or {self.b.advice}")
        check_fields(self, self.label)

    def compiled_functions(self) -> dict[str, Any]:
        """Return {"forces", "energy": function} of a contact with a line or with a circle, for numba."""
        if self.radius is None:
            return {"forces": line_force, "energy": line_energy}
        return {"forces": circle_force, "energy": circle_energy}

    def sides(self) -> tuple:
        """Return the sides (a, b, b.d): the point, the line's point and its direction; with a radius (a, b), b the circle's centre."""
        return (self.a, self.b, self.b.d) if self.radius is None else (self.a, self.b)

    def forces(self, t: float, x: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Return the forces on the sides, (sides, 2), N; on a direction J."""
        return self.compiled_functions()["forces"](self, t, x, v)

    def depth(self, x: np.ndarray) -> float:
        """Return the depth delta, m, of the point; it is negative without contact."""
        return float((line_depth if self.radius is None else circle_depth)(self, x))

    def gap(self, x: np.ndarray) -> float:
        """Return -delta, m: the distance of the point, negative in contact."""
        return -self.depth(x)

    def energy(self, x: np.ndarray) -> float:
        """Return `k delta^(n + 1) / (n + 1)`, J."""
        return float(contact_energy(self, self.depth(x)))

    def undefined(self, x: np.ndarray) -> str:
        """Return that the point is at the centre of the circle, if it is: the force has no direction there."""
        return "its point is at the centre of its circle" if self.radius is not None and not np.any(x[0] - x[1]) else ""
