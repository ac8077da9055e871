"""Torsion spring and damper between two directions."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polyida.body.material import number
from polyida.errors import InputError
from polyida.force.force_element import ForceElement, by_energy
from polyida.given import settle
from polyida.jit import entry, part
from polyida.joint.attachment import Ground, require_sides
from polyida.keywords import named_keywords

# constants of compiled code
FURTHEST = 0.95 * np.pi  # rad: where the angle is taken to be lost soon


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
        for side in (self.a, self.b):
            if not side.has_direction:
                raise InputError(f"{self.label}: {side!r} has no direction; {side.advice}")
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
