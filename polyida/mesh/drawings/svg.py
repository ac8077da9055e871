"""Closed curves of SVG files and of the text of SVG paths, through svgelements."""

import re

import numpy as np

from polyida.errors import InputError
from polyida.mesh.drawings.drawing import CHORDS, Drawing, library
from polyida.mesh.files.guarded import guarded
from polyida.mesh.files.repair import several

LENGTHS = {"mm": 1e-3, "cm": 1e-2, "in": 0.0254, "pt": 0.0254 / 72, "pc": 0.0254 / 6, "Q": 2.5e-4}  # metres


def read(path, part):
    """Drawing of a file, in its user units, y up from the page's lower edge; metres as the page's width says."""
    svgelements = library("svgelements")
    with guarded(path.stat().st_size):
        tree = svgelements.SVG.parse(str(path))
    pixels = svgelements.Matrix(tree.viewbox_transform).a if tree.viewbox_transform else 1.0
    height = tree.height if tree.values.get("height") or tree.viewbox else 0.0
    rings, notes = _rings(svgelements, _shapes(svgelements, tree, part))
    width = re.fullmatch(r"([\d.]+)(\w+)", str(tree.values.get("width", "")).strip())
    metres = float(width[1]) * LENGTHS[width[2]] * pixels / tree.width if width and width[2] in LENGTHS else None
    return Drawing([(ring * [1.0, -1.0] + [0.0, height]) / pixels for ring in rings], metres, notes)


def of_path(text):
    """Drawing of a path's text."""
    svgelements = library("svgelements")
    rings, notes = _rings(svgelements, [svgelements.Path(text)])
    return Drawing([ring * [1.0, -1.0] for ring in rings], None, notes)


def _shapes(svgelements, tree, part):
    """What is drawn, in pixels: of the element or group with the id `part`, or all."""
    root = tree if part is None else tree.get_element_by_id(part)
    if root is None:
        known = [element.id for element in tree.elements() if getattr(element, "id", None)]
        raise InputError(f"has no element with the id {part!r}; there are {', '.join(map(repr, known[:20])) or 'none'}")
    parts = root.select() if isinstance(root, svgelements.Group) else [root]
    return [shape for shape in parts if isinstance(shape, svgelements.Shape)]


def _rings(svgelements, shapes):
    """(closed curves as (n, 2), notes)."""
    rings, left = [], 0
    for shape in shapes:
        for curve in svgelements.Path(shape).as_subpaths():
            points = _points(svgelements, list(curve))
            closed = len(points) > 2 and np.hypot(*(points[0] - points[-1])) <= 1e-6 * np.ptp(points, axis=0).max()
            rings += [points] if closed else []
            left += not closed and len(points) > 1
    return rings, (f"left out {several(left, 'open curve')}",) if left else ()


def _points(svgelements, pieces):
    """(n, 2): ends of straight pieces, and CHORDS points on each curve."""
    points = []
    for piece in pieces:
        straight = isinstance(piece, (svgelements.Move, svgelements.Line, svgelements.Close))
        shares = [1.0] if straight else (np.arange(CHORDS) + 1.0) / CHORDS
        points += [[place.x, place.y] for place in (piece.end if straight else piece.point(share) for share in shares) if place is not None]
    return np.array(points, dtype=float).reshape(-1, 2)
