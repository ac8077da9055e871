"""A domain from a closed outline with holes, given by their corners."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polyida.errors import InputError
from polyida.mesh import topology
from polyida.mesh.domains import Capsule, Chain, Domain, nearest
from polyida.mesh.sections import ROUND, centre, signed_area
from polyida.validation import floats, is_number, named_keywords

AT_ONCE = 2_000_000  # pairs of points and edges
FOLD = np.pi - 1e-6  # rad
STRAIGHT = 0.05  # of the way around: a longer edge is no chord of a curve
REENTRANT = np.radians(160.0)  # no more cells fit around a corner
SAME = 1e-9  # of the size: neighbours nearer than that are one corner


@named_keywords
class Outline(Domain):
    """What lies within a closed outline and without its holes, m; `polygonize` meshes it, `|`, `-` and `&` combine it.

    points (n, 2): the corners in order, either way round, the first may be repeated at the end; holes: such arrays, one each.
    Where the way turns by more than `corner` degrees, and at any bend between two edges longer than a twentieth of the way,
    the mesh has a node exactly there. What turns by less is a curve of chords, nodes lie on it wherever they come; a ring without
    corners whose points all lie on a circle is that circle. Raises InputError, naming outline or hole and its place, for anything that
    crosses or touches itself, and for holes that are not within the outline.
    """

    def __init__(self, points: ArrayLike, holes: Iterable[ArrayLike] = (), corner: float = 15.0) -> None:
        if not is_number(corner) or not 0.0 < corner < 180.0:
            raise InputError(f"outline corner is {corner!r}; it must be an angle between 0 and 180 degrees")
        if not isinstance(holes, Iterable) or isinstance(holes, (str, bytes, dict)):
            raise InputError(f"outline holes are {repr(holes)[:80]}; they must be a list of (n, 2) arrays")
        rings = {"outline": _points(points, "outline", 1.0)}
        rings |= {f"outline hole {i}": _points(hole, f"outline hole {i}", -1.0) for i, hole in enumerate(holes)}
        _require_apart(rings)
        (_, outer), *inners = rings.items()
        for name, inner in inners:
            if not _holds(outer, inner[:1]):
                raise InputError(f"{name} at {inner[0].tolist()} is not within the outline")
            for other, around in inners:
                if other != name and _holds(around, inner[:1]):
                    raise InputError(f"{name} at {inner[0].tolist()} is within {other}; what lies in a hole is a part of its own")
        self._rings = [_ring(ring, np.radians(corner), sign) for ring, sign in zip(rings.values(), [1.0] + [-1.0] * len(rings))]
        self.lower, self.upper = self._rings[0].box
        self.walls = [wall for ring in self._rings for wall in ring.walls]

    def corners(self) -> NDArray:
        """(n, 2) points where the outline or a hole turns by more than `corner`."""
        return np.concatenate([ring.corners for ring in self._rings])

    def distance(self, points: NDArray) -> NDArray:
        """Signed distance, m: negative inside, exact everywhere."""
        return np.max([ring.distance(points) for ring in self._rings], axis=0)

    def on_boundary(self, points: NDArray) -> NDArray:
        """(n,) mask: no two walls coincide here, so that the distance tells it, in acute corners too."""
        return np.abs(self.distance(points)) < 1e-9 * float(np.max(self.upper - self.lower))


@dataclass(frozen=True, eq=False)
class _Polygon:
    """A ring of chords: walls from corner to corner, the domain on the left of its points."""

    points: np.ndarray
    walls: list
    corners: np.ndarray

    @property
    def box(self):
        return self.points.min(axis=0), self.points.max(axis=0)

    def distance(self, points):
        along = np.roll(self.points, -1, axis=0) - self.points
        parts = np.array_split(points, max(1, -(-len(points) * len(along) // AT_ONCE)))
        inside = -1.0 if signed_area(self.points) > 0 else 1.0
        return inside * np.concatenate([_depth(part, self.points, along) for part in parts])


@dataclass(frozen=True, eq=False)
class _Round:
    """A ring that is a circle, one wall without corners."""

    walls: list
    corners: np.ndarray

    @property
    def box(self):
        return self.walls[0].start - self.walls[0].radius, self.walls[0].start + self.walls[0].radius

    def distance(self, points):
        return self.walls[0].distance(points)


def _ring(points, corner, sign):
    """_Round where the points lie on a circle without a corner, else _Polygon."""
    length = np.hypot(*(np.roll(points, -1, axis=0) - points).T)
    between = np.minimum(length, np.roll(length, 1)) > STRAIGHT * length.sum()
    bend = np.abs(topology.ring_turns(points)) > np.where(between, 1e-6, corner * (1 + 1e-9))
    middle = centre(points)
    radii = np.hypot(*(points - middle).T)
    if not bend.any() and np.ptp(radii) <= ROUND * radii.mean():
        return _Round([Capsule(middle, middle, radii.mean(), sign)], points[:0])
    return _Polygon(points, _chains(points, bend), points[bend])


def _points(given, what, orientation):
    """(n, 2) of different neighbours, counter-clockwise for orientation 1."""
    points = floats(given)
    if points is None or points.ndim != 2 or points.shape[1] != 2 or not len(points):
        raise InputError(f"{what} is {repr(given)[:80]}; it must be an (n, 2) array of finite numbers")
    size = float(np.ptp(points, axis=0).max())
    points = points[np.hypot(*(points - np.roll(points, 1, axis=0)).T) > SAME * size]
    area = signed_area(points) if len(points) > 2 else 0.0
    if not abs(area) > 1e-12 * size**2:
        raise InputError(f"{what} has {len(points)} different corners and the area {abs(area):.3g}; it must go around an area")
    points = points if area * orientation > 0 else points[::-1]
    # spikes without width, and corners so far re-entrant that no cells fit around them
    turn = topology.ring_turns(points)
    back = np.flatnonzero(np.abs(turn) > FOLD)
    if back.size:
        raise InputError(f"{what} folds back on itself at {points[back[0]].tolist()}")
    sharp = np.flatnonzero(turn < -REENTRANT)
    if sharp.size:
        angle = 180 + np.degrees(turn[sharp[0]])
        place = points[sharp[0]].tolist()
        raise InputError(f"{what} cuts into the domain by a corner of {angle:.3g} degrees at {place}; it must be 20 or wider, or round")
    return np.roll(points, -int(np.lexsort(points.T)[0]), axis=0)


def _chains(ring, bend):
    """Walls from corner to corner; one closed wall where there is no corner."""
    if not bend.any():
        return [Chain(np.concatenate([ring, ring[:1]]), True)]
    first = int(np.argmax(bend))
    ring, ends = np.roll(ring, -first, axis=0), np.append(np.flatnonzero(np.roll(bend, -first)), len(ring))
    outward = np.append(topology.ring_turns(ring), topology.ring_turns(ring)[0]) > 0.0
    ring = np.concatenate([ring, ring[:1]])
    return [Chain(ring[a : b + 1], False, (outward[a], outward[b])) for a, b in zip(ends[:-1], ends[1:], strict=True)]


def _depth(points, start, along):
    """(n,) distance to the nearest edge of a ring, negative where a ray crosses an even number of them: outside."""
    edge, share = nearest(points, start, along)
    away = np.hypot(*(points - start[edge] - share[:, None] * along[edge]).T)
    above = points[:, 1:] >= start[:, 1]
    point, edge = np.nonzero(above != np.roll(above, -1, axis=1))
    to = points[point] - start[edge]
    left = along[edge, 0] * to[:, 1] > along[edge, 1] * to[:, 0]
    crossed = np.bincount(point[left == above[point, edge]], minlength=len(points))
    return np.where(crossed % 2, away, -away)


def _require_apart(rings):
    """InputError for the first two edges, of one ring or of two, that meet without being neighbours."""
    names, sizes = list(rings), [len(ring) for ring in rings.values()]
    start = np.concatenate(list(rings.values()))
    end = np.concatenate([np.roll(ring, -1, axis=0) for ring in rings.values()])
    after = np.concatenate([first + np.roll(np.arange(n), -1) for n, first in zip(sizes, np.cumsum([0, *sizes]))])
    owner = np.repeat(np.arange(len(rings)), sizes)
    low, high = np.minimum(start, end), np.maximum(start, end)
    for i in range(len(start)):
        others = np.arange(i + 1, len(start))
        others = others[(low[others] <= high[i]).all(axis=1) & (low[i] <= high[others]).all(axis=1)]
        others = others[(others != after[i]) & (after[others] != i)]
        met = others[_meet(start[i], end[i], start[others], end[others])]
        if met.size:
            which = "itself" if owner[i] == owner[met[0]] else names[owner[met[0]]]
            place = (0.5 * (start[met[0]] + end[met[0]])).tolist()
            raise InputError(f"{names[owner[i]]} crosses or touches {which} near {place}; its edges may only meet at their ends, in order")


def _meet(a, b, c, d):
    """(n,) mask: the edge a-b meets the edges c-d, whose boxes meet."""

    def side(p, q, r):
        return np.sign((q[..., 0] - p[..., 0]) * (r[..., 1] - p[..., 1]) - (q[..., 1] - p[..., 1]) * (r[..., 0] - p[..., 0]))

    return (side(a, b, c) * side(a, b, d) <= 0) & (side(c, d, a) * side(c, d, b) <= 0)


def _holds(ring, point):
    return _depth(point, ring, np.roll(ring, -1, axis=0) - ring)[0] > 0.0
