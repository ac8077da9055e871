"""Plane domains by signed distance functions: negative inside, combined by minimum and maximum.

A domain has walls, the pieces of its boundary, each with a signed distance and its gradient, and a rule that combines the distances.
Source: Talischi, Paulino, Pereira, Menezes, PolyMesher, Struct. Multidisc. Optim. 45 (2012).
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from polyida.errors import InputError
from polyida.mesh.box_tree import FEW, EdgeTree
from polyida.validation import named_keywords, positive, vector2


class Wall:
    """A piece of the boundary. sign: of the inside; closed: True if it is a closed curve. Distances are in m, negative inside."""

    sign: float
    closed = False

    def faces(self, points):
        """(n,) mask: points whose mirror image through the wall may bound a cell."""
        return np.ones(len(points), bool)

    def flipped(self):
        """Return the wall with inside and outside exchanged."""
        return replace(self, sign=-self.sign)


@dataclass(frozen=True, eq=False)
class Line(Wall):
    """coordinate[axis] = value; sign +1: the inside is below the value."""

    axis: int
    value: float
    sign: float

    def distance(self, points):
        """Signed distance of points (n, 2) from the line, (n,), m, negative inside."""
        return self.sign * (points[:, self.axis] - self.value)

    def normal(self, points):
        """(n, 2) gradient of the signed distance, the unit normal that points outwards."""
        n = np.zeros_like(points)
        n[:, self.axis] = self.sign
        return n

    def samples(self, lower, upper):
        """(200, 2) points of the line from one side of the box (lower, upper) to the other."""
        share = (np.arange(200) + 0.5) / 200
        points = lower + share[:, None] * (upper - lower)
        points[:, self.axis] = self.value
        return points

    def moved(self, offset):
        """Return the line translated by an offset (2,), m."""
        return replace(self, value=self.value + offset[self.axis])


@dataclass(frozen=True, eq=False)
class Capsule(Wall):
    """Points at the distance radius from the segment start-end; a circle if both coincide."""

    start: np.ndarray
    end: np.ndarray
    radius: float
    sign: float
    closed = True

    def _from_segment(self, points):
        """Vectors (n, 2), m, to points (n, 2) from their nearest positions on the segment."""
        along = self.end - self.start
        share = np.clip((points - self.start) @ along / max(along @ along, 1e-300), 0.0, 1.0)
        return points - self.start - share[:, None] * along

    def distance(self, points):
        """Signed distance of points (n, 2) from the wall, (n,), m, negative inside."""
        away = self._from_segment(points)
        return self.sign * (np.hypot(away[:, 0], away[:, 1]) - self.radius)

    def normal(self, points):
        """(n, 2) gradient of the signed distance at points (n, 2), of length one; zero on the segment itself."""
        away = self._from_segment(points)
        return self.sign * away / np.maximum(np.hypot(away[:, 0], away[:, 1]), 1e-300)[:, None]

    def samples(self, lower, upper):
        """(200, 2) points of the wall, by 200 directions from the ends of the segment."""
        angle = 2 * np.pi * (np.arange(200) + 0.5) / 200
        ray = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        ahead = ray @ (self.end - self.start) > 0.0
        return np.where(ahead[:, None], self.end, self.start) + self.radius * ray

    def moved(self, offset):
        """Return the capsule translated by an offset (2,), m."""
        return replace(self, start=self.start + offset, end=self.end + offset)


def project(points, wall):
    """Return the nearest points on the wall (Newton's method along the gradient, exact for lines and circles)."""
    for _ in range(2):
        points = points - wall.distance(points)[:, None] * wall.normal(points)
    return points


def meet(points, first, second, steps=20):
    """Return intersections of two walls, by Newton's method from start points; NaN if the walls are parallel within 2 degrees."""
    with np.errstate(all="ignore"):
        for _ in range(steps):
            a, b = first.normal(points), second.normal(points)
            da, db = first.distance(points), second.distance(points)
            det = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
            det = np.where(np.abs(det) > 0.03, det, np.nan)
            step = np.stack([da * b[:, 1] - db * a[:, 1], db * a[:, 0] - da * b[:, 0]], axis=1) / det[:, None]
            points = points - step
    return points


def nearest(points, start, along, low=0.0, high=1.0):
    """Return (edge (n,), share (n,)) of the nearest position start + share along, low <= share <= high, for each point."""
    x, y = points[:, :1] - start[:, 0], points[:, 1:] - start[:, 1]
    share = np.clip((x * along[:, 0] + y * along[:, 1]) / np.maximum(np.sum(along**2, axis=1), 1e-300), low, high)
    x -= share * along[:, 0]
    y -= share * along[:, 1]
    edge = np.argmin(x * x + y * y, axis=1)
    return edge, share[np.arange(len(points)), edge]


@dataclass(frozen=True, eq=False)
class Chain:
    """A polyline with vertices (k + 1, 2) and the inside on its left. A closed one ends at its start, an open one continues straight.

    outward: True if the continuation at the start, at the end, leaves the domain; it does at corners that are not re-entrant.
    """

    vertices: np.ndarray
    closed: bool
    outward: tuple[bool, bool] = (True, True)
    sign: float = 1.0

    def _nearest(self, points):
        """(nearest position (n, 2); unit direction of the chain there (n, 2); (n,) -1 before the start, 1 beyond the end, else 0)."""
        along = np.diff(self.vertices, axis=0)
        piece, share = self._nearest_of_many(points) if len(along) > FEW else self._nearest_of_few(points)
        foot = self.vertices[piece] + share[:, None] * along[piece]
        return foot, (along / np.hypot(*along.T)[:, None])[piece], (share > 1.0).astype(int) - (share < 0.0)

    def _nearest_of_few(self, points):
        """(edge, share) of the nearest position on the chain or on its straight continuations, from all edges."""
        along = np.diff(self.vertices, axis=0)
        low, high = np.zeros(len(along)), np.ones(len(along))
        if not self.closed:
            low[0], high[-1] = -np.inf, np.inf
        return nearest(points, self.vertices[:-1], along, low, high)

    @cached_property
    def _edges(self):
        """The EdgeTree of the chain's edges, which finds the nearest edge to each point."""
        return EdgeTree(self.vertices[:-1], np.diff(self.vertices, axis=0))

    def _nearest_of_many(self, points):
        """(edge, share) of the nearest position, by a tree of the edges; both continuations are compared afterwards."""
        piece = self._edges.nearest(points)
        share = self._edges.shares(points, piece)
        if self.closed:
            return piece, share
        last = len(self.vertices) - 2
        ends, along = [0, last], np.diff(self.vertices, axis=0)
        end, beyond = nearest(points, self.vertices[ends], along[ends], np.array([-np.inf, 0.0]), np.array([1.0, np.inf]))
        ends = np.array(ends)[end]
        away = [np.hypot(*(points - self.vertices[p] - s[:, None] * along[p]).T) for p, s in ((piece, share), (ends, beyond))]
        continued = away[1] < away[0]
        return np.where(continued, ends, piece), np.where(continued, beyond, share)

    def distance(self, points):
        """Signed distance of points (n, 2), (n,), negative on the left of the chain."""
        foot, along, _ = self._nearest(points)
        away = points - foot
        right = along[:, 1] * away[:, 0] - along[:, 0] * away[:, 1]
        return self.sign * np.where(right < 0.0, -1.0, 1.0) * np.hypot(*away.T)

    def normal(self, points):
        """(n, 2) gradient of the distance; on the chain itself the normal of its edge."""
        foot, along, _ = self._nearest(points)
        away = points - foot
        outwards = np.column_stack([along[:, 1], -along[:, 0]])
        length = np.hypot(*away.T)
        near = length < 1e-9 * np.ptp(self.vertices, axis=0).max()
        side = np.where(np.einsum("nx,nx->n", outwards, away) < 0.0, -1.0, 1.0)
        return self.sign * np.where(near[:, None], outwards, side[:, None] * away / np.where(near, 1.0, length)[:, None])

    def faces(self, points):
        """(n,) mask: the nearest position is on the chain or on a continuation outside the domain."""
        where = np.zeros(len(points), int) if self.closed else self._nearest(points)[2]
        return (where == 0) | np.where(where < 0, *self.outward)

    def samples(self, lower, upper):
        """(200, 2) points of the chain at equal distances along it; the bounds of the domain are not needed."""
        ends = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(self.vertices, axis=0).T))])
        at = ends[-1] * (np.arange(200) + 0.5) / 200
        return np.column_stack([np.interp(at, ends, column) for column in self.vertices.T])

    def flipped(self):
        """Return the chain with inside and outside exchanged, also at its continuations."""
        return replace(self, sign=-self.sign, outward=tuple(not out for out in self.outward))

    def moved(self, offset):
        """Return the chain translated by an offset (2,), m."""
        return replace(self, vertices=self.vertices + offset)


class Domain:
    """Base class of domains: a subclass sets the walls, the corners of the bounding box, and distance(points).

    Attributes
    ----------
    walls : list
        Pieces of the boundary.
    lower, upper : (2,) float, m
        Corners of the bounding box.
    convex : bool
    """

    convex = False
    walls: list
    lower: np.ndarray
    upper: np.ndarray

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Return the signed distance of points (n, 2), (n,), m: negative inside, exact at the walls, a bound elsewhere."""
        return np.max([wall.distance(points) for wall in self.walls], axis=0)

    def corners(self) -> np.ndarray:
        """Return the points (n, 2) of the boundary where two walls meet, by Newton's method from a grid over the bounding box."""
        if self.convex:
            return np.zeros((0, 2))
        size = float(np.max(self.upper - self.lower))
        grid = np.stack(np.meshgrid(*np.linspace(self.lower, self.upper, 12).T), axis=-1).reshape(-1, 2)
        candidates = np.zeros((0, 2))
        for i, first in enumerate(self.walls):
            for second in self.walls[:i]:
                point = meet(grid, first, second)
                point = point[np.isfinite(point).all(axis=1)]
                miss = np.max([np.abs(d(point)) for d in (self.distance, first.distance, second.distance)], axis=0)
                candidates = np.concatenate([candidates, point[miss < 1e-9 * size]])
        _, one = np.unique(np.round(candidates / (1e-7 * size)), axis=0, return_index=True)
        angle = (np.arange(720) + 0.5) * (2 * np.pi / 720)
        ring = 1e-5 * size * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        # the share of a small circle that lies inside is 1/2 on a smooth boundary
        share = np.array([np.mean(self.distance(point + ring) < 0.0) for point in candidates[one]])
        return candidates[one][(share > 0.0) & (np.abs(share - 0.5) > 0.01)]

    def on_boundary(self, points: np.ndarray) -> np.ndarray:
        """Return the (n,) mask of points on a wall with points inside and outside nearby, which walls between two parts have not."""
        size = float(np.max(self.upper - self.lower))
        on = np.abs(self.distance(points)) < 1e-9 * size
        if self.convex:
            return on
        angle = (np.arange(8) + 0.3) * (np.pi / 4)
        ring = 1e-6 * size * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        around = np.array([self.distance(points + step) for step in ring])
        return on & (around < 0.0).any(axis=0) & (around > 0.0).any(axis=0)

    def __or__(self, other: "Domain") -> "Union":
        """Return the union of both domains."""
        return Union(self, other)

    def __sub__(self, other: "Domain") -> "Difference":
        """Return this domain without the other one."""
        return Difference(self, other)

    def __and__(self, other: "Domain") -> "Intersection":
        """Return the intersection of both domains."""
        return Intersection(self, other)


@named_keywords
class Rectangle(Domain):
    """An axis-parallel rectangle.

    Parameters
    ----------
    length, height : float, m, > 0
    origin : (2,) float, m
        Lower left corner.

    Raises
    ------
    InputError
        For wrong values.
    """

    convex = True

    def __init__(self, length: float, height: float, origin: "ArrayLike" = (0.0, 0.0)) -> None:
        """Check the lengths and make the four walls."""
        size = np.array([positive("Rectangle", name, value, "metres") for name, value in (("length", length), ("height", height))])
        self.lower = vector2("Rectangle", "origin", origin)
        self.upper = self.lower + size
        self.walls = [Line(0, self.lower[0], -1.0), Line(0, self.upper[0], 1.0), Line(1, self.lower[1], -1.0), Line(1, self.upper[1], 1.0)]


@named_keywords
class Circle(Domain):
    """A disc.

    Parameters
    ----------
    radius : float, m, > 0
    center : (2,) float, m

    Raises
    ------
    InputError
        For wrong values.
    """

    convex = True

    def __init__(self, radius: float, center: "ArrayLike" = (0.0, 0.0)) -> None:
        """Check the radius and make the one wall."""
        radius, center = positive("Circle", "radius", radius, "metres"), vector2("Circle", "center", center)
        self.lower, self.upper = center - radius, center + radius
        self.walls = [Capsule(center, center, radius, 1.0)]


class Pair(Domain):
    """Base class of combinations of two domains."""

    def __init__(self, first: Domain, second: Domain) -> None:
        """Check that both are domains, and collect their walls."""
        for part in (first, second):
            if not isinstance(part, Domain):
                raise InputError(f"{type(self).__name__.lower()} of {part!r}; both parts must be domains such as Rectangle or Circle")
        self.first = first
        self.second = second
        self.walls = first.walls + second.walls


@named_keywords
class Union(Pair):
    """Points in either domain.

    Parameters
    ----------
    first, second : Domain

    Raises
    ------
    InputError
        If a part is no domain.
    """

    def __init__(self, first: Domain, second: Domain) -> None:
        """Check the parts; the bounding box is that of both."""
        super().__init__(first, second)
        self.lower, self.upper = np.minimum(first.lower, second.lower), np.maximum(first.upper, second.upper)

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Return the signed distance of points (n, 2), (n,), m, negative inside: the smaller one of both domains' distances."""
        return np.minimum(self.first.distance(points), self.second.distance(points))


@named_keywords
class Intersection(Pair):
    """Points in both domains.

    Parameters
    ----------
    first, second : Domain

    Raises
    ------
    InputError
        If a part is no domain, or if the bounding boxes do not overlap.
    """

    def __init__(self, first: Domain, second: Domain) -> None:
        """Check the parts; the bounding box is what those of both have in common."""
        super().__init__(first, second)
        self.lower, self.upper = np.maximum(first.lower, second.lower), np.minimum(first.upper, second.upper)
        if not (self.upper > self.lower).all():
            raise InputError("intersection of two domains is empty: their bounding boxes do not overlap")
        self.convex = first.convex and second.convex

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Return the signed distance of points (n, 2), (n,), m, negative inside: the larger one of both domains' distances."""
        return np.maximum(self.first.distance(points), self.second.distance(points))


@named_keywords
class Difference(Pair):
    """Points of the first domain that are not in the second.

    Parameters
    ----------
    first, second : Domain

    Raises
    ------
    InputError
        If a part is no domain.
    """

    def __init__(self, first: Domain, second: Domain) -> None:
        """Check the parts; the walls of the second have their inside outside."""
        super().__init__(first, second)
        self.lower, self.upper = first.lower, first.upper
        self.walls = first.walls + [wall.flipped() for wall in second.walls]

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Return the signed distance of points (n, 2), (n,), m, negative inside: the larger one of d_first and -d_second."""
        return np.maximum(self.first.distance(points), -self.second.distance(points))


class Moved(Domain):
    """A domain translated by an offset (2,), m."""

    def __init__(self, domain, offset):
        """Make a domain that is a copy of `domain`, shifted by offset (2,): bounding box and walls. The original does not change."""
        self.domain = domain
        self.offset = offset
        self.convex = domain.convex
        self.lower, self.upper = domain.lower + offset, domain.upper + offset
        self.walls = [wall.moved(offset) for wall in domain.walls]

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Return the signed distance of points (n, 2) from the translated domain, (n,), m, negative inside."""
        return self.domain.distance(points - self.offset)

    def corners(self) -> np.ndarray:
        """Return the corners (k, 2), m, of the translated domain."""
        return self.domain.corners() + self.offset

    def on_boundary(self, points: np.ndarray) -> np.ndarray:
        """Return the (n,) mask of points (n, 2) on the boundary of the translated domain."""
        return self.domain.on_boundary(points - self.offset)


@named_keywords
class Link(Domain):
    """A bar with rounded ends and a pin hole in each; the holes become the sections 'hole 0' and 'hole 1'.

    Parameters
    ----------
    length : float, m
        Distance of the pins.
    height : float, m
        Width of the bar and diameter of its ends.
    pin_radius : float, m
        Below half the height and half the length.
    origin : (2,) float, m
        Centre of the left pin; the right one is at origin + (length, 0).

    Raises
    ------
    InputError
        For wrong values.
    """

    def __init__(self, length: float, height: float, pin_radius: float, origin: "ArrayLike" = (0.0, 0.0)) -> None:
        """Check the lengths and make the walls: the bar with round ends, and both holes."""
        length, height = positive("Link", "length", length, "metres"), positive("Link", "height", height, "metres")
        pin_radius, left = positive("Link", "pin_radius", pin_radius, "metres"), vector2("Link", "origin", origin)
        if 2 * pin_radius >= min(height, length):
            raise InputError(f"Link: pin_radius = {pin_radius} must be below half its height {height} and half its length {length}")
        right = left + [length, 0.0]
        self.lower, self.upper = left - 0.5 * height, right + 0.5 * height
        self.walls = [
            Capsule(left, right, 0.5 * height, 1.0),
            Capsule(left, left, pin_radius, -1.0),
            Capsule(right, right, pin_radius, -1.0),
        ]
