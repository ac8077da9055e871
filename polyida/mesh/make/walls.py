"""Walls: the pieces of a domain's boundary, each with a signed distance and its gradient."""

from dataclasses import dataclass, replace

import numpy as np


class Wall:
    """A wall; sign: on which side of it the inside is, closed: whether it goes around."""

    sign: float
    closed = False

    def faces(self, points):
        """(n,) mask: mirror images through the wall may bound cells."""
        return np.ones(len(points), bool)

    def flipped(self):
        """The same wall with its inside outside."""
        return replace(self, sign=-self.sign)


@dataclass(frozen=True, eq=False)
class Line(Wall):
    """coordinate[axis] = value; sign +1: the inside is below the value."""

    axis: int
    value: float
    sign: float

    def distance(self, points):
        """(n,), m, negative inside."""
        return self.sign * (points[:, self.axis] - self.value)

    def normal(self, points):
        """(n, 2), gradient of the distance."""
        n = np.zeros_like(points)
        n[:, self.axis] = self.sign
        return n

    def samples(self, lower, upper):
        """(200, 2) points of the wall within a box."""
        share = (np.arange(200) + 0.5) / 200
        points = lower + share[:, None] * (upper - lower)
        points[:, self.axis] = self.value
        return points

    def moved(self, offset):
        """The wall moved by (x, y), m."""
        return replace(self, value=self.value + offset[self.axis])


@dataclass(frozen=True, eq=False)
class Capsule(Wall):
    """All points at the distance radius from the segment start-end (a circle where they coincide)."""

    start: np.ndarray
    end: np.ndarray
    radius: float
    sign: float
    closed = True

    def _from_segment(self, points):
        along = self.end - self.start
        share = np.clip((points - self.start) @ along / max(along @ along, 1e-300), 0.0, 1.0)
        return points - self.start - share[:, None] * along

    def distance(self, points):
        """(n,), m, negative inside."""
        away = self._from_segment(points)
        return self.sign * (np.hypot(away[:, 0], away[:, 1]) - self.radius)

    def normal(self, points):
        """(n, 2), gradient of the distance (zero on the segment)."""
        away = self._from_segment(points)
        return self.sign * away / np.maximum(np.hypot(away[:, 0], away[:, 1]), 1e-300)[:, None]

    def samples(self, lower, upper):
        """(200, 2) points of the wall, wherever they are."""
        angle = 2 * np.pi * (np.arange(200) + 0.5) / 200
        ray = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        ahead = ray @ (self.end - self.start) > 0.0
        return np.where(ahead[:, None], self.end, self.start) + self.radius * ray

    def moved(self, offset):
        """The wall moved by (x, y), m."""
        return replace(self, start=self.start + offset, end=self.end + offset)


def project(points, wall):
    """Nearest points on the wall (Newton along the gradient, exact for lines and circles)."""
    for _ in range(2):
        points = points - wall.distance(points)[:, None] * wall.normal(points)
    return points


def meet(points, first, second, steps=20):
    """Points where two walls meet, by Newton from the given points; NaN where they are parallel to 2 degrees."""
    with np.errstate(all="ignore"):
        for _ in range(steps):
            a, b = first.normal(points), second.normal(points)
            da, db = first.distance(points), second.distance(points)
            det = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
            det = np.where(np.abs(det) > 0.03, det, np.nan)
            step = np.stack([da * b[:, 1] - db * a[:, 1], db * a[:, 0] - da * b[:, 0]], axis=1) / det[:, None]
            points = points - step
    return points
