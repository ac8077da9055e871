"""Contact of a point with a line or a circle."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polyida.errors import InputError
from polyida.force.force_element import ForceElement
from polyida.jit.user_functions import compiled
from polyida.joint.attachment import require_places, require_sides
from polyida.validation import named_keywords, number, positive, settle


def hunt_crossley(self, depth, rate):
    """`k depth^n (1 + 3/2 c rate)`, N, zero where that pulls or there is no contact."""
    if depth <= 0.0:
        return 0.0
    return max(0.0, self.stiffness * depth**self.exponent * (1.0 + 1.5 * self.damping * rate))


def on_line(self, t, x, v):
    """`n F` on the point, the first side, and what that is on the line's point and direction d, the others; n = i d/|d|.

    With w from the line's point to the point: depth `delta = -w . n`, and `F d(delta)/dd = F (i w - delta d/|d|) / |d|` is minus the force
    on d.
    """
    wx, wy, dx, dy = x[0, 0] - x[1, 0], x[0, 1] - x[1, 1], x[2, 0], x[2, 1]
    size, depth = np.sqrt(dx * dx + dy * dy), depth_in_line(self, x)
    nx, ny = -dy / size, dx / size
    ax, ay = (-wy - depth * dx / size) / size, (wx - depth * dy / size) / size
    rate = -((v[0, 0] - v[1, 0]) * nx + (v[0, 1] - v[1, 1]) * ny) + ax * v[2, 0] + ay * v[2, 1]
    force = hunt_crossley(self, depth, rate)
    return np.array(((force * nx, force * ny), (-force * nx, -force * ny), (-force * ax, -force * ay)))


def depth_in_line(self, x):
    """How deep the first side is in the half-plane of the others."""
    wx, wy, dx, dy = x[0, 0] - x[1, 0], x[0, 1] - x[1, 1], x[2, 0], x[2, 1]
    return (wx * dy - wy * dx) / np.sqrt(dx * dx + dy * dy)


def on_circle(self, t, x, v):
    """`n F` on the point, the first side, the opposite on the centre; n from the centre to the point, depth r - |w|."""
    wx, wy = x[0, 0] - x[1, 0], x[0, 1] - x[1, 1]
    size = np.sqrt(wx * wx + wy * wy)
    nx, ny = wx / size, wy / size
    force = hunt_crossley(self, self.radius - size, -((v[0, 0] - v[1, 0]) * nx + (v[0, 1] - v[1, 1]) * ny))
    return np.array(((force * nx, force * ny), (-force * nx, -force * ny)))


def depth_in_circle(self, x):
    """How deep the first side is in the circle about the second."""
    wx, wy = x[0, 0] - x[1, 0], x[0, 1] - x[1, 1]
    return self.radius - np.sqrt(wx * wx + wy * wy)


def stored(self, depth):
    """`k depth^(n + 1) / (n + 1)`, zero where there is no contact."""
    return self.stiffness * max(0.0, depth) ** (self.exponent + 1.0) / (self.exponent + 1.0)


def line_energy(self, x):
    """Of a contact with a line."""
    return stored(self, depth_in_line(self, x))


def circle_energy(self, x):
    """Of a contact with a circle."""
    return stored(self, depth_in_circle(self, x))


@compiled
@named_keywords
@dataclass(frozen=True, eq=False)
class Contact(ForceElement):
    """A point against a line, or against a circle from outside, by a smooth penalty: `F = k delta^n (1 + 3/2 c delta')`, N, which never
    pulls.

    delta: how deep the point a is in what b bounds, m. Without a radius that is the half-plane to the right of the line through b along its
    direction (below `ground.at(point)`, whose direction is the x axis); with a radius, m, the circle about the point b. stiffness k, N/m^n;
    exponent n, 1 or more, 3/2 of Hertz; damping c, s/m: slow blows at a speed v come back with (1 - c v) v. There is no friction. Energy `k
    delta^(n + 1) / (n + 1)`; `3/2 c k delta^n delta'^2` is dissipated. Its `gap` is -delta: steps of all integrators end where the contact
    opens and closes, and are short enough while it is closed. Raises InputError for wrong values, and for a line whose side has no
    direction. Source: Hunt, Crossley, J. Appl. Mech. 42 (1975) 440-445.
    """

    a: Any
    b: Any
    stiffness: float
    damping: float = 0.0
    exponent: float = 1.5
    radius: float | None = None
    name: str | None = None
    dissipates = True

    def __post_init__(self):
        require_sides(self.label, self.a, self.b)
        require_places(self.label, self.a, self.b)
        if self.radius is None and not self.b.has_direction:
            raise InputError(f"{self.label}: {self.b!r} has no direction, and there is no radius; give a radius, or {self.b.advice}")
        settle(
            self,
            stiffness=positive(self.label, "stiffness", self.stiffness, "N/m^exponent"),
            damping=number(self.label, "damping", self.damping, "s/m", 0.0),
            exponent=number(self.label, "exponent", self.exponent, "no unit", 1.0),
            radius=None if self.radius is None else positive(self.label, "radius", self.radius, "metres"),
        )

    def compiled_functions(self) -> dict[str, Any]:
        """Against a line or a circle."""
        return {"forces": on_line, "energy": line_energy} if self.radius is None else {"forces": on_circle, "energy": circle_energy}

    def sides(self) -> tuple:
        """The point, the point of the line or circle, and the line's direction."""
        return (self.a, self.b, self.b.d) if self.radius is None else (self.a, self.b)

    def forces(self, t: float, x: NDArray, v: NDArray) -> NDArray:
        """On the point and what bounds, (sides, 2), N; on a direction J."""
        return self.compiled_functions()["forces"](self, t, x, v)

    def depth(self, x: NDArray) -> float:
        """delta at the places of the sides, m; negative where there is no contact."""
        return float((depth_in_line if self.radius is None else depth_in_circle)(self, x))

    def gap(self, x: NDArray) -> float:
        """`-delta`, m: the distance of the point, negative in contact."""
        return -self.depth(x)

    def energy(self, x: NDArray) -> float:
        """`k delta^(n + 1) / (n + 1)`, J."""
        return float(stored(self, self.depth(x)))

    def undefined(self, x: NDArray) -> str:
        """Where its point is at the centre of its circle, from where no direction leads out."""
        return "its point is at the centre of its circle" if self.radius is not None and not np.any(x[0] - x[1]) else ""
