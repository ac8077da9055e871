"""Outlines from drawings: the closed curves of an SVG file (svgelements) or DXF file (ezdxf), the largest with the others as its holes."""

import logging
import re
import warnings
from collections import Counter
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path

import numpy as np

from polyida.errors import InputError
from polyida.mesh.outline import Outline
from polyida.mesh.raw import MeshWarning, guarded, hint, scale_of
from polyida.mesh.read_write import existing
from polyida.mesh.repair import several
from polyida.mesh.sections import signed_area
from polyida.validation import named_keywords

CHORDS = 24  # of each curved piece, a quarter or half of a circle at most


@dataclass(frozen=True, eq=False)
class Drawing:
    """rings: closed curves, each (n, 2) in the drawing's unit; metres: of one unit, where the drawing says it; notes: for the user."""

    rings: list[np.ndarray]
    metres: float | None = None
    notes: tuple = ()


def library(name):
    """A module of the extra `mesh`; InputError where it is not installed."""
    try:
        return import_module(name)
    except ImportError:
        raise InputError(f"it needs {name.partition('.')[0]}: pip install 'polyida[mesh]'") from None


GAP = 1e-6  # of the drawing's size, that ends of one ring may be apart


def read_dxf(path, part):
    """Drawing of the model space, or of what is there on the layer `part`."""
    library("ezdxf")
    from ezdxf import readfile, units
    from ezdxf.disassemble import recursive_decompose

    with guarded(path.stat().st_size), _unheard("ezdxf"):
        document = readfile(path)
        entities = list(recursive_decompose(document.modelspace()))
    layers = sorted({entity.dxf.layer for entity in entities})
    if part is not None and part not in layers:
        raise InputError(f"has nothing on the layer {part!r}; there are {', '.join(map(repr, layers)) or 'none'}")
    curves, skipped = [], Counter()
    for entity in (entity for entity in entities if part in (None, entity.dxf.layer)):
        found = _curves(entity)
        curves += found
        skipped[entity.dxftype()] += not found
    notes = [f"left out {count} {kind}" for kind, count in skipped.items() if count]
    rings, left = _joined(curves)
    notes += [f"left out {several(left, 'open curve')}"] if left else []
    metres = units.conversion_factor(document.units, units.M) if document.units else None
    return Drawing(rings, metres, tuple(notes))


@contextmanager
def _unheard(name):
    """Without what a library logs: it quotes bytes of the file that are no letters, and what matters comes back as an exception."""
    log = logging.getLogger(name)
    before, log.disabled = log.disabled, True
    try:
        yield
    finally:
        log.disabled = before


def _curves(entity):
    """[(n, 2)] of the pieces of an entity, none where it is no curve."""
    kind = entity.dxftype()
    if kind in ("LWPOLYLINE", "POLYLINE"):
        return [curve for piece in entity.virtual_entities() for curve in _curves(piece)]
    if kind == "LINE":
        return [_plane([entity.dxf.start, entity.dxf.end])]
    if kind == "CIRCLE":
        return [_plane(entity.vertices(np.linspace(0.0, 360.0, 4 * CHORDS + 1)))]
    if kind == "ARC":
        return [_plane(entity.vertices(entity.angles(2 * CHORDS)))]
    if kind == "ELLIPSE":
        return [_plane(entity.vertices(entity.params(4 * CHORDS + 1)))]
    return [_plane(entity.construction_tool().approximate(4 * CHORDS))] if kind == "SPLINE" else []


def _plane(points):
    return np.array([[point[0], point[1]] for point in map(tuple, points)], dtype=float)


def _joined(curves):
    """(rings (n, 2), number of curves that are part of none)."""
    from ezdxf import edgeminer

    if not curves:
        return [], 0
    gap = GAP * float(np.ptp(np.concatenate(curves), axis=0).max())
    rings = [curve for curve in curves if np.hypot(*(curve[0] - curve[-1])) <= gap]
    open_ones = [curve for curve in curves if np.hypot(*(curve[0] - curve[-1])) > gap]
    edges = [edgeminer.make_edge(curve[0], curve[-1], payload=curve) for curve in open_ones]
    left = len(open_ones)
    if not edges:
        return rings, 0
    for chain in edgeminer.find_all_simple_chains(edgeminer.Deposit(edges, gap_tol=gap)):
        if edgeminer.is_loop(chain, gap_tol=gap):
            rings.append(np.concatenate([(edge.payload[::-1] if edge.is_reverse else edge.payload)[:-1] for edge in chain]))
            left -= len(chain)
    return rings, left


LENGTHS = {"mm": 1e-3, "cm": 1e-2, "in": 0.0254, "pt": 0.0254 / 72, "pc": 0.0254 / 6, "Q": 2.5e-4}  # metres


def read_svg(path, part):
    """Drawing of a file, in its user units, y up from the page's lower edge; metres as the page's width says."""
    svgelements = library("svgelements")
    with guarded(path.stat().st_size):
        tree = svgelements.SVG.parse(str(path))
    pixels = svgelements.Matrix(tree.viewbox_transform).a if tree.viewbox_transform else 1.0
    height = tree.height if tree.values.get("height") or tree.viewbox else 0.0
    root = tree if part is None else tree.get_element_by_id(part)
    if root is None:
        known = [element.id for element in tree.elements() if getattr(element, "id", None)]
        raise InputError(f"has no element with the id {part!r}; there are {', '.join(map(repr, known[:20])) or 'none'}")
    parts = root.select() if isinstance(root, svgelements.Group) else [root]
    rings, notes = _rings(svgelements, [shape for shape in parts if isinstance(shape, svgelements.Shape)])
    width = re.fullmatch(r"([\d.]+)(\w+)", str(tree.values.get("width", "")).strip())
    metres = float(width[1]) * LENGTHS[width[2]] * pixels / tree.width if width and width[2] in LENGTHS else None
    return Drawing([(ring * [1.0, -1.0] + [0.0, height]) / pixels for ring in rings], metres, notes)


def of_path(text):
    """Drawing of a path's text."""
    svgelements = library("svgelements")
    rings, notes = _rings(svgelements, [svgelements.Path(text)])
    return Drawing([ring * [1.0, -1.0] for ring in rings], None, notes)


def _rings(svgelements, shapes):
    """(closed curves as (n, 2), notes)."""
    rings, left = [], 0
    for shape in shapes:
        for curve in svgelements.Path(shape).as_subpaths():
            points = []  # ends of straight pieces, and CHORDS points on each curve
            for piece in curve:
                straight = isinstance(piece, (svgelements.Move, svgelements.Line, svgelements.Close))
                shares = [1.0] if straight else (np.arange(CHORDS) + 1.0) / CHORDS
                points += [
                    [place.x, place.y] for place in (piece.end if straight else piece.point(share) for share in shares) if place is not None
                ]
            points = np.array(points, dtype=float).reshape(-1, 2)
            closed = len(points) > 2 and np.hypot(*(points[0] - points[-1])) <= 1e-6 * np.ptp(points, axis=0).max()
            rings += [points] if closed else []
            left += not closed and len(points) > 1
    return rings, (f"left out {several(left, 'open curve')}",) if left else ()


DRAWINGS = {".svg": read_svg, ".dxf": read_dxf}


@named_keywords
def read_outline(path: str | Path, unit: str | float | None = None, part: str | None = None, corner: float = 15.0) -> Outline:
    """Outline of the closed curves in a drawing: the one around the largest area, with the others as holes; `polygonize` meshes it.

    .svg needs svgelements and .dxf ezdxf (`pip install 'polyida[mesh]'`). part: the id of an SVG element or group, or a DXF layer;
    all without it. unit: of the drawing's numbers, as of `pi.mesh.read`; without it what the file says (SVG: width in mm, cm, in;
    DXF: $INSUNITS), else metres. SVG's y runs down: it is turned up, from the lower edge of the page. corner: see `Outline`.
    Curves that are not closed are left out, and said so. Raises InputError, naming the file, for anything it cannot use.
    """
    path = existing(path)
    reader = DRAWINGS.get(path.suffix.lower())
    if reader is None:
        raise InputError(f"drawing {path} has the suffix {path.suffix!r}; known are {', '.join(DRAWINGS)}")
    return _outline(f"drawing {path}", lambda: reader(path, part), unit, corner)


@named_keywords
def svg_path(path: str, unit: str | float | None = None, corner: float = 15.0) -> Outline:
    """Outline of an SVG path's text, such as "M 0 0 h 2 v -1 h -2 z": as `read_outline`, with y turned up about 0."""
    if not isinstance(path, str):
        raise InputError(f"SVG path is {repr(path)[:80]}; it must be a text such as 'M 0 0 h 2 v -1 h -2 z'")
    return _outline("SVG path", lambda: of_path(path), unit, corner)


def _outline(what, drawing, unit, corner):
    """Outline of what drawing() gives, every failure under the name `what`."""
    try:
        found = drawing()
        if not found.rings:
            notes = f" ({'; '.join(found.notes)})" if found.notes else ""
            raise InputError(f"has no closed curve{notes}")
        rings = [ring * scale_of(unit, found.metres) for ring in found.rings]
        outer = rings.pop(int(np.argmax([abs(signed_area(ring)) for ring in rings])))
        outline = Outline(outer, holes=rings, corner=corner)
    except InputError as error:
        more = "; part= takes one of several parts" if "not within the outline" in str(error) else ""
        raise InputError(f"{what}: {error}{more}") from None
    except Exception as error:
        reason = str(error)[:200].encode("utf-8", "replace").decode()  # it may quote bytes that are no letters
        raise InputError(f"{what} cannot be read: {type(error).__name__}: {reason}") from error
    if notes := [*found.notes, *hint(outer, unit, found.metres)]:
        warnings.warn(f"{what}: {'; '.join(notes)}", MeshWarning, stacklevel=4)
    return outline
