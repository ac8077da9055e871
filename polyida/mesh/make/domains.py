"""Plane domains by signed distance: negative inside, combined by minimum and maximum.

A domain is a list of walls and a rule that combines their distances. Source of the idea: Talischi, Paulino, Pereira,
Menezes, PolyMesher, Struct. Multidisc. Optim. 45 (2012).
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polyida.errors import InputError
from polyida.given import floats, reals
from polyida.keywords import named_keywords
from polyida.mesh.concave import domain_corners
from polyida.mesh.make import walls as w


def positive(value, what):
    """value as a finite float > 0, else InputError."""
    number = finite(value, what)
    if not number > 0.0:
        raise InputError(f"{what} is {value!r}; it must be positive")
    return number


def finite(value, what):
    """value as a finite float, else InputError."""
    given = reals(value)
    if given is None or given.ndim:
        raise InputError(f"{what} is {value!r}; it must be a number")
    number = float(given.item())
    if not np.isfinite(number):
        raise InputError(f"{what} is {value!r}; it must be finite")
    return number


def place(value, what):
    """value as two finite floats, else InputError."""
    pair = floats(value)
    if pair is None or pair.shape != (2,):
        raise InputError(f"{what} is {value!r}; it must be two finite numbers (x, y)")
    return pair


class Domain:
    """Base: subclasses set walls (list), lower and upper corner of the bounding box, and distance(points) -> (n,)."""

    convex = False
    walls: list
    lower: NDArray
    upper: NDArray

    def distance(self, points: NDArray) -> NDArray:
        """Signed distance, m: negative inside, exact at the walls, a bound elsewhere."""
        return np.max([wall.distance(points) for wall in self.walls], axis=0)

    def corners(self) -> NDArray:
        """(n, 2) points of the boundary where two walls meet."""
        return np.zeros((0, 2)) if self.convex else domain_corners(self)

    def on_boundary(self, points: NDArray) -> NDArray:
        """(n,) mask: on a wall, with points of the domain nearby (walls that coincide may have none)."""
        size = float(np.max(self.upper - self.lower))
        on = np.abs(self.distance(points)) < 1e-9 * size
        if self.convex:
            return on
        angle = (np.arange(8) + 0.3) * (np.pi / 4)
        ring = 1e-6 * size * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return on & np.any([self.distance(points + step) < 0.0 for step in ring], axis=0)

    def __or__(self, other: "Domain") -> "Union":
        return Union(self, other)

    def __sub__(self, other: "Domain") -> "Difference":
        return Difference(self, other)

    def __and__(self, other: "Domain") -> "Intersection":
        return Intersection(self, other)


@named_keywords
class Rectangle(Domain):
    """Axis-parallel rectangle; origin is its lower left corner."""

    convex = True

    def __init__(self, length: float, height: float, origin: ArrayLike = (0.0, 0.0)) -> None:
        size = np.array([positive(length, "rectangle length"), positive(height, "rectangle height")])
        self.lower = place(origin, "rectangle origin")
        self.upper = self.lower + size
        self.walls = [
            w.Line(0, self.lower[0], -1.0),
            w.Line(0, self.upper[0], 1.0),
            w.Line(1, self.lower[1], -1.0),
            w.Line(1, self.upper[1], 1.0),
        ]


@named_keywords
class Circle(Domain):
    """Disc, m."""

    convex = True

    def __init__(self, radius: float, center: ArrayLike = (0.0, 0.0)) -> None:
        radius, center = positive(radius, "circle radius"), place(center, "circle center")
        self.lower, self.upper = center - radius, center + radius
        self.walls = [w.Capsule(center, center, radius, 1.0)]


class Pair(Domain):
    """Two domains as one."""

    def __init__(self, first: Domain, second: Domain) -> None:
        for part in (first, second):
            if not isinstance(part, Domain):
                raise InputError(f"{type(self).__name__.lower()} of {part!r}; both parts must be domains such as Rectangle or Circle")
        self.first, self.second, self.walls = first, second, first.walls + second.walls


@named_keywords
class Union(Pair):
    """Points in either domain."""

    def __init__(self, first: Domain, second: Domain) -> None:
        super().__init__(first, second)
        self.lower, self.upper = np.minimum(first.lower, second.lower), np.maximum(first.upper, second.upper)

    def distance(self, points: NDArray) -> NDArray:
        return np.minimum(self.first.distance(points), self.second.distance(points))


@named_keywords
class Intersection(Pair):
    """Points in both domains."""

    def __init__(self, first: Domain, second: Domain) -> None:
        super().__init__(first, second)
        self.lower, self.upper = np.maximum(first.lower, second.lower), np.minimum(first.upper, second.upper)
        if not (self.upper > self.lower).all():
            raise InputError("intersection of two domains is empty: their bounding boxes do not overlap")
        self.convex = first.convex and second.convex

    def distance(self, points: NDArray) -> NDArray:
        return np.maximum(self.first.distance(points), self.second.distance(points))


@named_keywords
class Difference(Pair):
    """Points of the first domain that are not in the second."""

    def __init__(self, first: Domain, second: Domain) -> None:
        super().__init__(first, second)
        self.lower, self.upper = first.lower, first.upper
        self.walls = first.walls + [wall.flipped() for wall in second.walls]

    def distance(self, points: NDArray) -> NDArray:
        return np.maximum(self.first.distance(points), -self.second.distance(points))


class Moved(Domain):
    """A domain moved by an offset (x, y), m."""

    def __init__(self, domain, offset):
        self.domain, self.offset, self.convex = domain, offset, domain.convex
        self.lower, self.upper = domain.lower + offset, domain.upper + offset
        self.walls = [wall.moved(offset) for wall in domain.walls]

    def distance(self, points: NDArray) -> NDArray:
        return self.domain.distance(points - self.offset)

    def corners(self) -> NDArray:
        return self.domain.corners() + self.offset

    def on_boundary(self, points: NDArray) -> NDArray:
        return self.domain.on_boundary(points - self.offset)


@named_keywords
class Link(Domain):
    """Bar with rounded ends and a pin hole in each: the pins' centres are (0, 0) and (length, 0) from origin.

    height is the bar's width and the ends' diameter. The holes become the sections 'hole 0' and 'hole 1'.
    """

    def __init__(self, length: float, height: float, pin_radius: float, origin: ArrayLike = (0.0, 0.0)) -> None:
        length, height = positive(length, "link length"), positive(height, "link height")
        pin_radius = positive(pin_radius, "link pin radius")
        if 2 * pin_radius >= min(height, length):
            raise InputError(f"link pin radius is {pin_radius}; it must be below half its height {height} and half its length {length}")
        left = place(origin, "link origin")
        right = left + [length, 0.0]
        self.lower, self.upper = left - 0.5 * height, right + 0.5 * height
        self.walls = [
            w.Capsule(left, right, 0.5 * height, 1.0),
            w.Capsule(left, left, pin_radius, -1.0),
            w.Capsule(right, right, pin_radius, -1.0),
        ]
