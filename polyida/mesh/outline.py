"""A domain from a closed outline with holes: from coordinates, SVG files (svgelements) or DXF files (ezdxf)."""

import logging
import re
import warnings
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from polyida.errors import InputError
from polyida.mesh import topology
from polyida.mesh.domains import Capsule, Chain, Domain, nearest
from polyida.mesh.polygon_mesh import PolygonMesh
from polyida.mesh.raw import MeshWarning, counted, guarded, unit_note, unit_size
from polyida.mesh.read_write import existing, path_of, put
from polyida.mesh.sections import ROUND, centre, signed_area
from polyida.validation import floats, instance, is_number, library, listed, named_keywords, one_of

AT_ONCE = 2_000_000  # pairs of points and edges in memory
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
        if not is_number(corner) or not 0.0 < corner < 180.0:
            raise InputError(f"outline corner is {corner!r}; it must be an angle between 0 and 180 degrees")
        holes = listed("outline", "holes", holes)
        rings = {"outline": _points(points, "outline", 1.0)}
        rings |= {f"outline hole {i}": _points(hole, f"outline hole {i}", -1.0) for i, hole in enumerate(holes)}
        _require_apart(rings)
        (_, outer), *inners = rings.items()

        def contains(ring, point):
            return _depth(point, ring, np.roll(ring, -1, axis=0) - ring)[0] > 0.0

        for name, inner in inners:
            if not contains(outer, inner[:1]):
                raise InputError(f"{name} at {inner[0].tolist()} is not within the outline")
            for other, around in inners:
                if other != name and contains(around, inner[:1]):
                    raise InputError(f"{name} at {inner[0].tolist()} is within {other}; what lies in a hole is a part of its own")
        self._rings = [_Ring(ring, np.radians(float(corner)), sign) for ring, sign in zip(rings.values(), [1.0] + [-1.0] * len(rings))]
        self.lower, self.upper = self._rings[0].box
        self.walls = [wall for ring in self._rings for wall in ring.walls]

    def corners(self) -> np.ndarray:
        """Return the points (n, 2) where the outline or a hole turns by more than `corner`."""
        return np.concatenate([ring.corners for ring in self._rings])

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Return the signed distance, (n,), m: negative inside, exact everywhere."""
        return np.max([ring.distance(points) for ring in self._rings], axis=0)

    def on_boundary(self, points: np.ndarray) -> np.ndarray:
        """Return the (n,) mask of points on the boundary. No two walls coincide here: the distance suffices, also in acute corners."""
        return np.abs(self.distance(points)) < 1e-9 * float(np.max(self.upper - self.lower))


class _Ring:
    """A circle, one wall without corners, if the points lie on a circle without a bend; else chords, with walls from corner to corner.

    The domain lies on the left of the points.
    """

    def __init__(self, points, corner, sign):
        edges = np.roll(points, -1, axis=0) - points
        length = np.hypot(*edges.T)
        between = np.minimum(length, np.roll(length, 1)) > STRAIGHT * length.sum()
        bend = np.abs(topology.ring_turns(points)) > np.where(between, 1e-6, corner * (1 + 1e-9))
        middle = centre(points)
        radii = np.hypot(*(points - middle).T)
        self.circle = not bend.any() and np.ptp(radii) <= ROUND * radii.mean()
        self.points, self.edges, self.corners = points, edges, points[bend]
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

    def distance(self, points):
        if self.circle:
            return self.walls[0].distance(points)
        parts = np.array_split(points, max(1, -(-len(points) * len(self.points) // AT_ONCE)))
        inside = -1.0 if signed_area(self.points) > 0 else 1.0
        return inside * np.concatenate([_depth(part, self.points, self.edges) for part in parts])


def _points(corners, what, orientation):
    """(n, 2) without equal neighbours, counter-clockwise for orientation 1."""
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


def _depth(points, start, along):
    """(n,) distance to the nearest edge of a ring, negative outside: if a ray crosses an even number of edges."""
    edge, share = nearest(points, start, along)
    away = np.hypot(*(points - start[edge] - share[:, None] * along[edge]).T)
    above = points[:, 1:] >= start[:, 1]
    point, edge = np.nonzero(above != np.roll(above, -1, axis=1))
    to = points[point] - start[edge]
    left = along[edge, 0] * to[:, 1] > along[edge, 1] * to[:, 0]
    crossed = np.bincount(point[left == above[point, edge]], minlength=len(points))
    return np.where(crossed % 2, away, -away)


def _require_apart(rings):
    """Raise InputError for the first two edges, of one or two rings, that meet and are not neighbours."""
    names, sizes = list(rings), [len(ring) for ring in rings.values()]
    start = np.concatenate(list(rings.values()))
    end = np.concatenate([np.roll(ring, -1, axis=0) for ring in rings.values()])
    after = np.concatenate([first + np.roll(np.arange(n), -1) for n, first in zip(sizes, np.cumsum([0, *sizes]))])
    owner = np.repeat(np.arange(len(rings)), sizes)
    low, high = np.minimum(start, end), np.maximum(start, end)

    def side(p, q, r):
        return np.sign(topology.cross(q - p, r - p))

    for i in range(len(start)):
        others = np.arange(i + 1, len(start))
        others = others[(low[others] <= high[i]).all(axis=1) & (low[i] <= high[others]).all(axis=1)]
        others = others[(others != after[i]) & (after[others] != i)]
        a, b, c, d = start[i], end[i], start[others], end[others]
        met = others[(side(a, b, c) * side(a, b, d) <= 0) & (side(c, d, a) * side(c, d, b) <= 0)]
        if met.size:
            which = "itself" if owner[i] == owner[met[0]] else names[owner[met[0]]]
            place = (0.5 * (start[met[0]] + end[met[0]])).tolist()
            raise InputError(f"{names[owner[i]]} crosses or touches {which} near {place}; its edges may only meet at their ends, in order")


CHORDS = 24  # for each curved piece, at most a quarter or half of a circle
GAP = 1e-6  # of the drawing's size, between ends of curves that join
LENGTHS = {"mm": 1e-3, "cm": 1e-2, "in": 0.0254, "pt": 0.0254 / 72, "pc": 0.0254 / 6, "Q": 2.5e-4}  # m, units of SVG


@dataclass(frozen=True, eq=False)
class Drawing:
    """rings: closed curves, each (n, 2) in the drawing's unit; metres: size of the unit, None if unknown; notes: for the user."""

    rings: list[np.ndarray]
    metres: float | None = None
    notes: tuple = ()


def _library(name):
    return library(name, f"it needs {name}: pip install 'polyida[mesh]'")


def _dxf(path, part):
    """Drawing of the model space, or of its layer `part`."""
    _library("ezdxf")
    from ezdxf import edgeminer, readfile, units
    from ezdxf.disassemble import recursive_decompose

    log = logging.getLogger("ezdxf")  # it quotes bytes that are no letters; errors come as exceptions
    disabled, log.disabled = log.disabled, True
    try:
        with guarded(path.stat().st_size):
            document = readfile(path)
            entities = list(recursive_decompose(document.modelspace()))
    finally:
        log.disabled = disabled
    layers = sorted({entity.dxf.layer for entity in entities})
    if part is not None and part not in layers:
        raise InputError(f"has nothing on the layer {part!r}; there are {', '.join(map(repr, layers)) or 'none'}")

    def curves_of(entity):
        kind = entity.dxftype()
        if kind in ("LWPOLYLINE", "POLYLINE"):
            return [curve for piece in entity.virtual_entities() for curve in curves_of(piece)]
        if kind == "LINE":
            points = [entity.dxf.start, entity.dxf.end]
        elif kind == "CIRCLE":
            points = entity.vertices(np.linspace(0.0, 360.0, 4 * CHORDS + 1))
        elif kind == "ARC":
            points = entity.vertices(entity.angles(2 * CHORDS))
        elif kind == "ELLIPSE":
            points = entity.vertices(entity.params(4 * CHORDS + 1))
        elif kind == "SPLINE":
            points = entity.construction_tool().approximate(4 * CHORDS)
        else:
            return []
        return [np.array([[point[0], point[1]] for point in map(tuple, points)], dtype=float)]

    curves, skipped = [], Counter()
    for entity in (entity for entity in entities if part in (None, entity.dxf.layer)):
        pieces = curves_of(entity)
        curves += pieces
        skipped[entity.dxftype()] += not pieces
    notes = [f"left out {count} {kind}" for kind, count in skipped.items() if count]
    gap = GAP * float(np.ptp(np.concatenate(curves), axis=0).max()) if curves else 0.0
    closed = [np.hypot(*(curve[0] - curve[-1])) <= gap for curve in curves]
    rings = [curve for curve, ring in zip(curves, closed) if ring]
    edges = [edgeminer.make_edge(curve[0], curve[-1], payload=curve) for curve, ring in zip(curves, closed) if not ring]
    unused = len(edges)
    for chain in edgeminer.find_all_simple_chains(edgeminer.Deposit(edges, gap_tol=gap)) if edges else ():
        if edgeminer.is_loop(chain, gap_tol=gap):
            rings.append(np.concatenate([(edge.payload[::-1] if edge.is_reverse else edge.payload)[:-1] for edge in chain]))
            unused -= len(chain)
    notes += [f"left out {counted(unused, 'open curve')}"] if unused else []
    return Drawing(rings, units.conversion_factor(document.units, units.M) if document.units else None, tuple(notes))


def _svg(path, part):
    """Drawing of an SVG file, or of its element with the id `part`, in user units, y upwards. Raises InputError for an unknown id."""
    svgelements = _library("svgelements")
    with guarded(path.stat().st_size):
        tree = svgelements.SVG.parse(str(path))
    pixels = svgelements.Matrix(tree.viewbox_transform).a if tree.viewbox_transform else 1.0
    height = tree.height if tree.values.get("height") or tree.viewbox else 0.0
    root = tree if part is None else tree.get_element_by_id(part)
    if root is None:
        known = [element.id for element in tree.elements() if getattr(element, "id", None)]
        raise InputError(f"has no element with the id {part!r}; there are {', '.join(map(repr, known[:20])) or 'none'}")
    elements = root.select() if isinstance(root, svgelements.Group) else [root]
    rings, notes = _svg_rings(svgelements, [shape for shape in elements if isinstance(shape, svgelements.Shape)])
    width = re.fullmatch(r"([\d.]+)(\w+)", str(tree.values.get("width", "")).strip())
    metres = float(width[1]) * LENGTHS[width[2]] * pixels / tree.width if width and width[2] in LENGTHS else None
    return Drawing([(ring * [1.0, -1.0] + [0.0, height]) / pixels for ring in rings], metres, notes)


def _svg_rings(svgelements, shapes):
    """(closed curves as (n, 2), notes)."""
    rings, unused = [], 0
    for shape in shapes:
        for curve in svgelements.Path(shape).as_subpaths():
            points = []  # ends of straight pieces, CHORDS points on each curved piece
            for piece in curve:
                straight = isinstance(piece, (svgelements.Move, svgelements.Line, svgelements.Close))
                ends = [piece.end] if straight else [piece.point(share) for share in (np.arange(CHORDS) + 1.0) / CHORDS]
                points += [[end.x, end.y] for end in ends if end is not None]
            points = np.array(points, dtype=float).reshape(-1, 2)
            closed = len(points) > 2 and np.hypot(*(points[0] - points[-1])) <= GAP * np.ptp(points, axis=0).max()
            rings += [points] if closed else []
            unused += not closed and len(points) > 1
    return rings, (f"left out {counted(unused, 'open curve')}",) if unused else ()


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
    readers = {".svg": _svg, ".dxf": _dxf}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise InputError(f"drawing {path} has the suffix {path.suffix!r}; known are {', '.join(readers)}")
    return _outline(f"drawing {path}", lambda: reader(path, part), unit, corner)


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
        svgelements = _library("svgelements")
        rings, notes = _svg_rings(svgelements, [svgelements.Path(path)])
        return Drawing([ring * [1.0, -1.0] for ring in rings], None, notes)

    return _outline("SVG path", drawing, unit, corner)


def _outline(what, read, unit, corner):
    """Outline of the drawing that read() returns; every error names `what`."""
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
        _library("ezdxf")
        import ezdxf

        drawing = ezdxf.new(units={"m": 6, "cm": 5, "mm": 4}[unit])  # codes of $INSUNITS
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
