"""Spring and damper between two points."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from polyida.body.material import number
from polyida.errors import InputError
from polyida.force.force_element import ForceElement, by_energy, by_law
from polyida.force.of_state import answer
from polyida.given import settle
from polyida.jit import entry
from polyida.joint.attachment import require_sides
from polyida.keywords import named_keywords


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
    drawing where it is None; preload N0, N. Energy `k e^2/2 + N0 e`, e = l - l0; the damper dissipates `c l'^2`.
    force: a further force `force(e, l')`, N, e.g. `lambda e, rate: 1e4 * e**3`, whose energy is the integral of `force(e, 0)`; it is Python,
    and no file holds it. Where l = 0 the line has no direction and there is no force.
    Raises InputError for wrong values.
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
        length = np.linalg.norm(self._drawn()) if self.length is None else self.length
        settle(
            self,
            stiffness=number(self.label, "stiffness", self.stiffness, "N/m", 0.0),
            damping=number(self.label, "damping", self.damping, "N s/m", 0.0),
            length=number(self.label, "length", length, "m", 0.0),
            preload=number(self.label, "preload", self.preload, "N"),
        )
        if self.force is not None and not callable(self.force):
            raise InputError(f"{self.label}: force = {self.force!r} must be a function of the elongation, m, and its rate, m/s")

    def _drawn(self):
        """From a to b in the reference configuration, (2,), m."""
        for side in (self.a, self.b):
            if side.point is None:
                raise InputError(f"{self.label}: ground has no place by itself; use ground.at(point)")
        return self.b.point - self.a.point

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
