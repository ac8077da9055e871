"""A domain from a closed outline with holes: from coordinates, SVG files (svgelements) or DXF files (ezdxf)."""

import warnings
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from polyida.errors import InputError
from polyida.mesh import topology
from polyida.mesh.box_tree import EdgeTree, first_crossing, rings_around
from polyida.mesh.domains import Capsule, Chain, Domain
from polyida.mesh.dxf import dxf_library, read_dxf
from polyida.mesh.polygon_mesh import PolygonMesh
from polyida.mesh.raw import MeshWarning, unit_note, unit_size
from polyida.mesh.read_write import existing, path_of, put
from polyida.mesh.sections import ROUND, centre, signed_area
from polyida.mesh.svg import read_svg, shape_rings, svg_library
from polyida.validation import floats, instance, is_number, listed, named_keywords, one_of

FOLD = np.pi - 1e-6  # rad, turn of a spike without width
STRAIGHT = 0.05  # of the ring's length: a longer edge is no chord of a curve
REENTRANT = np.radians(160.0)  # turn of the sharpest corner that cells can surround
FLAT = 1e-9  # rad, turn of a corner on a straight line
UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
SAME = 1e-9  # of the size: nearer neighbours are one corner


@named_keywords
class Outline(Domain):
    """The domain within a closed outline and outside its holes.

    A node lies exactly at each turn of more than `corner` degrees, and at any bend between two edges longer than 1/20 of the ring. Smaller
    turns are chords of a curve. A ring without corners whose points lie on a circle becomes that circle.

    Parameters
    ----------
    points : (n, 2) float, m
        Corners in order, in either direction; the first may be repeated at the end.
    holes : iterable of (n, 2) float, m
    corner : float, degrees, 0 to 180

    Raises
    ------
    InputError
        If a ring crosses or touches itself or another ring, or if a hole is not within the outline; the message names ring and position.
    """

    def __init__(self, points: "ArrayLike", holes: "Iterable[ArrayLike]" = (), corner: float = 15.0) -> None:
        """Check the rings, that they do not meet and holes lie within the outline, and make walls of them."""
        if not is_number(corner) or not 0.0 < corner < 180.0:
            raise InputError(f"outline corner is {corner!r}; it must be an angle between 0 and 180 degrees")
        holes = listed("outline", "holes", holes)
        rings = {"outline": _points(points, "outline", 1.0)}
        rings |= {f"outline hole {i}": _points(hole, f"outline hole {i}", -1.0) for i, hole in enumerate(holes)}
        _require_apart(rings)
        _require_nested(rings)
        self._rings = [_Ring(ring, np.radians(float(corner)), sign) for ring, sign in zip(rings.values(), [1.0] + [-1.0] * len(rings))]
        self.lower, self.upper = self._rings[0].box
        self.walls = [wall for ring in self._rings for wall in ring.walls]

    def corners(self) -> np.ndarray:
        """Return the points (n, 2) where the outline or a hole turns by more than `corner`."""
        return np.concatenate([ring.corners for ring in self._rings])

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Return the signed distance, (n,), m: negative inside, exact everywhere."""
        return self._boundary.distance(points)

    @cached_property
    def _boundary(self):
        """The _Boundary of all rings, which computes signed distances."""
        return _Boundary(self._rings)

    def on_boundary(self, points: np.ndarray) -> np.ndarray:
        """Return the (n,) mask of points on the boundary. No two walls coincide here: the distance suffices, also in acute corners."""
        return np.abs(self.distance(points)) < 1e-9 * float(np.max(self.upper - self.lower))


class _Ring:
    """A circle, one wall without corners, if the points lie on a circle without a bend; else chords, with walls from corner to corner.

    The domain lies on the left of the points.
    """

    def __init__(self, points, corner, sign):
        """Find the corners of closed points (n, 2), and make a circle or chains of chords as walls."""
        edges = np.roll(points, -1, axis=0) - points
        length = np.hypot(*edges.T)
        between = np.minimum(length, np.roll(length, 1)) > STRAIGHT * length.sum()
        bend = np.abs(topology.ring_turns(points)) > np.where(between, 1e-6, corner * (1 + 1e-9))
        middle = centre(points)
        radii = np.hypot(*(points - middle).T)
        self.circle = not bend.any() and np.ptp(radii) <= ROUND * radii.mean()
        self.points = points
        self.edges = edges
        self.corners = points[bend]
        self.box = points.min(axis=0), points.max(axis=0)
        if self.circle:
            self.walls, self.box = [Capsule(middle, middle, radii.mean(), sign)], (middle - radii.mean(), middle + radii.mean())
        elif not bend.any():
            self.walls = [Chain(np.concatenate([points, points[:1]]), True)]
        else:
            first = int(np.argmax(bend))
            ring, ends = np.roll(points, -first, axis=0), np.append(np.flatnonzero(np.roll(bend, -first)), len(points))
            outward = np.append(topology.ring_turns(ring), topology.ring_turns(ring)[0]) > 0.0
            ring = np.concatenate([ring, ring[:1]])
            self.walls = [Chain(ring[a : b + 1], False, (outward[a], outward[b])) for a, b in zip(ends[:-1], ends[1:])]


class _Boundary:
    """All rings as one set of edges and circles: the nearest piece tells the distance and, by its side, what is inside."""

    def __init__(self, rings):
        """Collect the edges of chords and the circles, with the outward normals of edges and corners."""
        chords = [ring for ring in rings if not ring.circle]
        circles = [ring.walls[0] for ring in rings if ring.circle]
        start = np.concatenate([np.zeros((0, 2)), *(ring.points for ring in chords)])
        along = np.concatenate([np.zeros((0, 2)), *(ring.edges for ring in chords)])
        self.sign = np.array([wall.sign for wall in circles])
        self.tree = EdgeTree(start, along, [wall.start for wall in circles], [wall.radius for wall in circles])
        outward = np.column_stack([along[:, 1], -along[:, 0]]) / np.hypot(*along.T)[:, None]
        sizes = [len(ring.points) for ring in chords]
        before, after = topology.preceding(np.cumsum([0, *sizes])), topology.following(np.cumsum([0, *sizes]))
        self.outward, self.at_start, self.at_end = outward, outward + outward[before], outward + outward[after]

    def distance(self, points):
        """Signed distance of points (n, 2) from the nearest edge, corner or circle, (n,), m: negative inside."""
        tree, edges = self.tree, len(self.outward)
        piece = tree.nearest(points)
        signed = np.empty(len(points))
        at_edge = np.flatnonzero(piece < edges)
        here, edge = points[at_edge], piece[at_edge]
        share = tree.shares(here, edge)[:, None]
        away = here - tree.start[edge] - share * tree.along[edge]
        normal = np.where(share == 0.0, self.at_start[edge], np.where(share == 1.0, self.at_end[edge], self.outward[edge]))
        signed[at_edge] = np.where(np.sum(away * normal, axis=1) > 0.0, 1.0, -1.0) * np.hypot(*away.T)
        at_circle = np.flatnonzero(piece >= edges)
        circle = piece[at_circle] - edges
        signed[at_circle] = self.sign[circle] * (np.hypot(*(points[at_circle] - tree.middle[circle]).T) - tree.radius[circle])
        return signed


def _points(corners, what, orientation):
    """Corners as (n, 2) without equal neighbours, counter-clockwise for orientation 1, clockwise for -1. Raises InputError."""
    points = floats(corners)
    if points is None or points.ndim != 2 or points.shape[1] != 2 or not len(points):
        raise InputError(f"{what} is {repr(corners)[:80]}; it must be an (n, 2) array of finite numbers")
    size = float(np.ptp(points, axis=0).max())
    points = points[np.hypot(*(points - np.roll(points, 1, axis=0)).T) > SAME * size]
    area = signed_area(points) if len(points) > 2 else 0.0
    if not abs(area) > 1e-12 * size**2:
        raise InputError(f"{what} has {len(points)} different corners and the area {abs(area):.3g}; it must go around an area")
    points = points if area * orientation > 0 else points[::-1]
    turn = topology.ring_turns(points)
    back = np.flatnonzero(np.abs(turn) > FOLD)
    if back.size:
        raise InputError(f"{what} folds back on itself at {points[back[0]].tolist()}")
    sharp = np.flatnonzero(turn < -REENTRANT)
    if sharp.size:
        angle, place = 180 + np.degrees(turn[sharp[0]]), points[sharp[0]].tolist()
        raise InputError(f"{what} cuts into the domain by a corner of {angle:.3g} degrees at {place}; it must be 20 or wider, or round")
    return np.roll(points, -int(np.lexsort(points.T)[0]), axis=0)


def _segments(rings):
    """(start, end, number of the ring) of the edges of all rings."""
    start = np.concatenate(list(rings.values()))
    end = np.concatenate([np.roll(ring, -1, axis=0) for ring in rings.values()])
    return start, end, np.repeat(np.arange(len(rings)), [len(ring) for ring in rings.values()])


def _require_apart(rings):
    """Raise InputError for the first two edges, of one or two rings, that meet and are not neighbours."""
    names, (start, end, owner) = list(rings), _segments(rings)
    firsts = np.flatnonzero(np.diff(owner, prepend=-1))
    after = np.arange(1, len(start) + 1)
    after[np.append(firsts[1:], len(start)) - 1] = firsts
    if met := first_crossing(start, end, after):
        edge, other = met
        which = "itself" if owner[edge] == owner[other] else names[owner[other]]
        place = (0.5 * (start[other] + end[other])).tolist()
        raise InputError(f"{names[owner[edge]]} crosses or touches {which} near {place}; its edges may only meet at their ends, in order")


def _require_nested(rings):
    """Raise InputError unless all holes are within the outline, and none within another; the rings do not meet."""
    names, firsts = list(rings), np.array([ring[0] for ring in rings.values()])
    around = [set() for _ in names]
    for hole, other in rings_around(firsts, *_segments(rings)).tolist():
        around[hole].add(other)
    for hole in range(1, len(names)):
        if 0 not in around[hole]:
            raise InputError(f"{names[hole]} at {firsts[hole].tolist()} is not within the outline")
        if others := around[hole] - {0, hole}:
            raise InputError(
                f"{names[hole]} at {firsts[hole].tolist()} is within {names[min(others)]}; what lies in a hole is a part of its own"
            )


@dataclass(frozen=True, eq=False)
class Drawing:
    """rings: closed curves, each (n, 2) in the drawing's unit; metres: size of the unit, None if unknown; notes: for the user."""

    rings: list[np.ndarray]
    metres: float | None = None
    notes: tuple = ()


@named_keywords
def read_outline(path: str | Path, unit: str | float | None = None, part: str | None = None, corner: float = 15.0) -> Outline:
    """Return the outline of the closed curves in a drawing: the largest one, with the others as holes.

    Curves that are not closed are left out with a MeshWarning. The y axis of SVG is reversed: y is upwards from the page's lower edge.

    Parameters
    ----------
    path : str or Path
        .svg (needs svgelements) or .dxf (needs ezdxf): `pip install 'polyida[mesh]'`.
    unit : str or float, m, optional
        Of the drawing's numbers, as of `pi.mesh.read`. Default: the file's (SVG: width in mm, cm, in; DXF: $INSUNITS), else metres.
    part : str, optional
        Id of an SVG element or group, or DXF layer.
    corner : float, degrees
        As of `Outline`.

    Returns
    -------
    Outline
        A domain for `pi.mesh.polygonize`.

    Raises
    ------
    InputError
        Naming the file, if it cannot be used.
    """
    path = existing(path)
    readers = {".svg": read_svg, ".dxf": read_dxf}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise InputError(f"drawing {path} has the suffix {path.suffix!r}; known are {', '.join(readers)}")
    return _outline(f"drawing {path}", lambda: Drawing(*reader(path, part)), unit, corner)


@named_keywords
def svg_path(path: str, unit: str | float | None = None, corner: float = 15.0) -> Outline:
    """Return the outline of an SVG path's text; y is reversed about 0.

    Parameters
    ----------
    path : str
        Such as "M 0 0 h 2 v -1 h -2 z".
    unit : str or float, m, optional
        As of `pi.mesh.read`. Default: metres.
    corner : float, degrees
        As of `Outline`.

    Returns
    -------
    Outline
        A domain for `pi.mesh.polygonize`.

    Raises
    ------
    InputError
        If the text cannot be used.
    """
    if not isinstance(path, str):
        raise InputError(f"SVG path is {repr(path)[:80]}; it must be a text such as 'M 0 0 h 2 v -1 h -2 z'")

    def drawing():
        """The Drawing of the path's text with y upwards. Raises InputError for what is no path."""
        try:
            shape = svg_library().Path(path)
        except Exception:  # noqa: BLE001, the library raises all kinds of errors for what is no path
            raise InputError(f"{path!r:.80} is no path; write one such as 'M 0 0 h 2 v -1 h -2 z'") from None
        rings, notes = shape_rings([shape])
        return Drawing([ring * [1.0, -1.0] for ring in rings], None, notes)

    return _outline("SVG path", drawing, unit, corner)


def _outline(what, read, unit, corner):
    """Outline of the drawing that read() returns, its largest ring with the others as holes; every error names `what`."""
    try:
        drawing = read()
        if not drawing.rings:
            notes = f" ({'; '.join(drawing.notes)})" if drawing.notes else ""
            raise InputError(f"has no closed curve{notes}")
        rings = [ring * unit_size(unit, drawing.metres) for ring in drawing.rings]
        outer = rings.pop(int(np.argmax([abs(signed_area(ring)) for ring in rings])))
        outline = Outline(outer, holes=rings, corner=corner)
    except InputError as error:
        more = "; part= takes one of several parts" if "not within the outline" in str(error) else ""
        raise InputError(f"{what}: {error}{more}") from None
    except Exception as error:
        reason = str(error)[:200].encode("utf-8", "replace").decode()  # it may quote bytes that are no letters
        raise InputError(f"{what} cannot be read: {type(error).__name__}: {reason}") from error
    if notes := [*drawing.notes, *unit_note(outer, unit, drawing.metres)]:
        warnings.warn(f"{what}: {'; '.join(notes)}", MeshWarning, stacklevel=4)
    return outline


@named_keywords
def outline_of(mesh: PolygonMesh) -> list[np.ndarray]:
    """Return the closed rings of a mesh's boundary, the largest first.

    Parameters
    ----------
    mesh : PolygonMesh

    Returns
    -------
    list of (k, 2) float, m
        Corners in order, without those on straight lines, the first not repeated: outer rings counter-clockwise, holes clockwise. Where two cells
        meet in a corner only, the rings keep the cells apart.
    """
    instance("outline_of", "mesh", mesh, PolygonMesh)
    after: dict[int, list[int]] = {}
    for begin, end in mesh.boundary_edges.tolist():
        after.setdefault(begin, []).append(end)
    rings = []
    while after:
        here = first = next(iter(after))
        before: int | None = None
        ring: list[int] = []
        while not ring or here != first:
            ring.append(here)
            ends = after[here]
            chosen = ends[0] if len(ends) == 1 or before is None else min(ends, key=lambda end: _turn(mesh.points, before, ring[-1], end))  # noqa: B023
            ends.remove(chosen)
            if not ends:
                del after[here]
            before, here = here, chosen
        points = mesh.points[ring]
        bent = np.abs(topology.ring_turns(points)) > FLAT
        rings.append(points[bent] if bent.sum() > 2 else points)
    return sorted(rings, key=lambda ring: -abs(signed_area(ring)))


def _turn(points, before, at, end):
    """The angle by which a way along the boundary turns at a node; the least, most to the right, leaves the other cells aside."""
    into, out = points[at] - points[before], points[end] - points[at]
    return -float(np.arctan2(topology.cross(into, out), into @ out))


@named_keywords
def write_outline(mesh: PolygonMesh, path: str | Path, unit: str = "mm", overwrite: bool = False) -> None:
    """Write the outline of a mesh with its holes as a drawing, to be cut or extruded: SVG or DXF, which `read_outline` reads again.

    Parameters
    ----------
    mesh : PolygonMesh
    path : str or Path
        .svg or .dxf (needs ezdxf: `pip install 'polyida[mesh]'`).
    unit : "m", "cm" or "mm"
        Of the drawing.
    overwrite : bool
        True to replace an existing file.

    Raises
    ------
    InputError
        For an existing file without overwrite=True, for another ending or unit, or if ezdxf is not installed.
    """
    path = path_of(path)
    one_of("write_outline", "unit", unit, UNITS)
    rings = [ring / UNITS[unit] for ring in outline_of(mesh)]
    if path.suffix.lower() == ".dxf":
        drawing = dxf_library().new(units={"m": 6, "cm": 5, "mm": 4}[unit])  # codes of $INSUNITS
        for ring in rings:
            drawing.modelspace().add_lwpolyline(ring.tolist(), close=True)
        write = drawing.saveas
    elif path.suffix.lower() == ".svg":
        low, high = np.min([ring.min(axis=0) for ring in rings], axis=0), np.max([ring.max(axis=0) for ring in rings], axis=0)
        width, height = high - low
        lines = [" L ".join(f"{x - low[0]:.9g} {high[1] - y:.9g}" for x, y in ring) for ring in rings]
        ways = " ".join(f"M {line} Z" for line in lines)
        size = f'width="{width:.9g}{unit}" height="{height:.9g}{unit}" viewBox="0 0 {width:.9g} {height:.9g}"'
        text = f'<svg xmlns="http://www.w3.org/2000/svg" {size}><path fill-rule="evenodd" d="{ways}"/></svg>\n'
        write = lambda temporary: temporary.write_text(text, encoding="utf-8")  # noqa: E731
    else:
        raise InputError(f"write_outline: {str(path)!r} must end in .svg or .dxf")
    put(f"drawing {path}", path, overwrite, write)
