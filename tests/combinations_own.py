"""Bodies, a joint, forces and a sampled controller of one's own, for the random scenes of combinations_scenes.py."""

from dataclasses import dataclass

import numpy as np

import polyida as pi


@dataclass(frozen=True, eq=False)
class OwnBar(pi.Body):
    """A rigid bar whose first pair is a point ahead of the centre of mass: M is not diagonal."""

    mass: float
    length: float
    origin: tuple
    angle: float
    velocity: tuple = (0.0, 0.0)
    spin: float = 0.0
    name: str | None = None

    def coordinates(self):
        z = np.exp(1j * self.angle)
        return [complex(*self.origin) + 0.3 * self.length * z, self.length * z]

    def mass_matrix(self):
        off = 0.2
        return self.mass * np.array([[1.0, off], [off, 1.0 / 12.0 + off**2]])

    def attachments(self):
        return {name: [1.0, at - 0.3] for name, at in (("left", 0.0), ("center", 0.5), ("right", 1.0))}

    def x_axis(self):
        return [0.0, 1.0 / self.length]

    def rows(self):
        d = self.at("left").d
        return [(pi.dot(d, d) - 1.0) * (0.5 * self.length)]


@pi.compiled
@dataclass(frozen=True, eq=False)
class Stretchy(pi.Body):
    """A straight bar that stretches evenly: z_1 is its own length."""

    mass: float
    length: float
    origin: tuple
    angle: float
    stiffness: float
    velocity: tuple = (0.0, 0.0)
    spin: float = 0.0
    name: str | None = None

    def coordinates(self):
        z = self.length * np.exp(1j * self.angle)
        return [complex(*self.origin) + 0.5 * z, z]

    def mass_matrix(self):
        return self.mass * np.diag([1.0, 1.0 / 12.0])

    def attachments(self):
        return {name: [1.0, at - 0.5] for name, at in (("left", 0.0), ("center", 0.5), ("right", 1.0))}

    def x_axis(self):
        return [0.0, 1.0 / self.length]

    def elastic(self, z):
        size = np.abs(z[1])
        pull = self.stiffness * (size - self.length) / size * z[1]
        return np.array([0.0 * pull, pull])

    def energy(self, z):
        return 0.5 * self.stiffness * (np.abs(z[1]) - self.length) ** 2


class Rod(pi.Joint):
    """A joint of one's own: the distance of two points."""

    def rows(self):
        w = self.b.x - self.a.x
        square = abs(w.rest) ** 2
        return [((pi.dot(w, w) - square) / (2.0 * square**0.5)).named("", "N")]


@dataclass(frozen=True, eq=False)
class _Between:
    """What acts between two points."""

    a: object
    b: object

    def sides(self):
        return self.a, self.b


@dataclass(frozen=True, eq=False)
class Band(_Between, pi.ForceElement):
    """A force of one's own with an energy: a spring of rest length 0."""

    k: float
    name: str | None = None

    def forces(self, t, x, v):
        pull = self.k * (x[1] - x[0])
        return np.stack((pull, -pull))

    def energy(self, x):
        w = x[1] - x[0]
        return 0.5 * self.k * (w[0] * w[0] + w[1] * w[1])


@pi.compiled
@dataclass(frozen=True, eq=False)
class FastBand(Band):
    """The same, compiled."""


@dataclass(frozen=True, eq=False)
class Lag(_Between, pi.ForceElement):
    """A force of one's own with a state: a tension `k s` that follows the elongation, `s' = (e - s) / tau`."""

    k: float
    tau: float
    length: float
    name: str | None = None
    states = ("late",)

    def rates(self, t, x, v, s):
        w = x[1] - x[0]
        return np.array([(np.sqrt(w[0] * w[0] + w[1] * w[1]) - self.length - s[0]) / self.tau])

    def forces(self, t, x, v, s):
        w = x[1] - x[0]
        pull = self.k * s[0] / np.sqrt(w[0] * w[0] + w[1] * w[1]) * w
        return np.stack((pull, -pull))


@pi.compiled
@dataclass(frozen=True, eq=False)
class FastLag(Lag):
    """The same, compiled."""


@dataclass(frozen=True, eq=False)
class Held(_Between, pi.Controller):
    """A sampled controller: the tension between two points is held at that of a spring when it was sampled."""

    k: float
    length: float
    period: float
    name: str | None = None
    outputs = ("tension",)

    def sample(self, t, x, v, s, u):
        return [self.k * (np.linalg.norm(x[1] - x[0]) - self.length)]

    def forces(self, t, x, v, s, u):
        w = x[1] - x[0]
        pull = u[0] / np.sqrt(w[0] * w[0] + w[1] * w[1]) * w
        return np.stack((pull, -pull))


@pi.compiled
@dataclass(frozen=True, eq=False)
class FastHeld(Held):
    """The same, compiled."""
