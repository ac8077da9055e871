"""Closed curves of SVG drawings: lengths, page and viewports are resolved here, shapes and their transforms by svgelements.

Source: SVG 2 (W3C), 5.6 (use), 7.7 (viewBox), 7.9 (preserveAspectRatio), 8 (coordinate systems, units), CSS Values 3, 5.2 (absolute lengths).
"""

import io
import math
import re
from collections import Counter
from xml.etree import ElementTree

import numpy as np

from polyida.errors import InputError
from polyida.mesh.raw import counted
from polyida.validation import library

CHORDS = 24  # for each curved piece, at most a quarter or half of a circle
GAP = 1e-6  # of the drawing's size, between ends of curves that join
MOST = 100_000  # elements, with those that <use> repeats
NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
LENGTH = re.compile(rf"({NUMBER})([A-Za-z]*|%)")
PIXEL = 0.0254 / 96  # m
ABSOLUTE = {"in": 96.0, "cm": 96 / 2.54, "mm": 96 / 25.4, "q": 96 / 101.6, "pt": 96 / 72, "pc": 16.0}  # pixels
PIXELS = ABSOLUTE | {"": 1.0, "px": 1.0}
ALONG_X, ALONG_Y = ("x", "width", "cx", "rx", "x1", "x2"), ("y", "height", "cy", "ry", "y1", "y2")
SIZES = ("width", "height", "r", "rx", "ry")  # negative ones are invalid and count as absent
SHAPES = ("rect", "circle", "ellipse", "line", "path", "polygon", "polyline")
NEVER_DRAWN = ("marker", "mask")  # of themselves
SPACE = "{http://www.w3.org/2000/svg}"
LINKS = ("href", "{http://www.w3.org/1999/xlink}href")


def svg_library():
    """Return svgelements. Raise InputError if it is not installed."""
    return library("svgelements", "it needs svgelements: pip install 'polyida[mesh]'")


def read_svg(path, part):
    """(rings, metres in one user unit along x or None, notes) of a file, or of its element with the id `part`; y is upwards from the lower edge."""
    svgelements = svg_library()
    root = ElementTree.fromstring(path.read_bytes())  # noqa: S314, expat limits what entities expand to
    if _tag(root) != "svg":
        raise InputError(f"is no SVG drawing, its root is <{_tag(root):.40}>")
    _require_few(root)
    page = _Page(root)
    notes = _resolve(root, page.inner)
    for name in ("x", "y", "width", "height", "viewBox", "preserveAspectRatio"):
        root.attrib.pop(name, None)
    tree = svgelements.SVG.parse(io.BytesIO(ElementTree.tostring(root)), reify=False)
    chosen = tree if part is None else tree.get_element_by_id(part)
    if chosen is None:
        known = [element.id for element in tree.elements() if getattr(element, "id", None)]
        raise InputError(f"has no element with the id {part!r}; there are {', '.join(map(repr, known[:20])) or 'none'}")
    elements = list(chosen.select()) if isinstance(chosen, svgelements.Group | svgelements.Use) else [chosen]
    shapes = [element for element in elements if isinstance(element, svgelements.Shape)]
    drawn = [shape for shape in shapes if str(shape.values.get("visibility", "")).lower() not in ("hidden", "collapse")]
    rings, more = shape_rings(drawn)
    if len(drawn) < len(shapes):
        notes.append(f"left out {counted(len(shapes) - len(drawn), 'hidden shape')}")
    return [page.placed(ring) for ring in rings], page.metres, (*notes, *more)


def shape_rings(shapes):
    """(closed curves as (n, 2), notes) of shapes of svgelements, each by its own transform."""
    svgelements, rings, unused = svg_library(), [], 0
    shares = (np.arange(CHORDS) + 1.0) / CHORDS
    for shape in shapes:
        matrix = shape.transform
        for curve in svgelements.Path(*shape.segments(transformed=False)).as_subpaths():
            points = []  # ends of straight pieces, CHORDS points on each curved piece
            for piece in curve:
                straight = isinstance(piece, (svgelements.Move, svgelements.Line, svgelements.Close))
                ends = ([piece.end] if piece.end is not None else []) if straight else piece.npoint(shares)
                points += [[end[0], end[1]] for end in ends]
            points = np.array(points, dtype=float).reshape(-1, 2) @ [[matrix.a, matrix.b], [matrix.c, matrix.d]] + [matrix.e, matrix.f]
            closed = len(points) > 2 and np.hypot(*(points[0] - points[-1])) <= GAP * np.ptp(points, axis=0).max()
            rings += [points] if closed else []
            unused += not closed and len(points) > 1
    return rings, (f"left out {counted(unused, 'open curve')}",) if unused else ()


class _Page:
    """The outermost viewport: its size in pixels and the place of the user units in it."""

    def __init__(self, root):
        """Store height, inner size, scale and shift of the page, and metres per unit, from the root element of an SVG file.

        metres is None if width and height have no absolute unit. Raises InputError for a page without width or height.
        """
        _style_as_attributes(root)
        sizes = {name: LENGTH.fullmatch(root.get(name, "").strip()) for name in ("width", "height")}
        units = {name: found[2].lower() for name, found in sizes.items() if found}
        # a share of the window or of a font's size says nothing of the drawing's
        width, height = (float(sizes[name][1]) * PIXELS[units[name]] if units.get(name) in PIXELS else None for name in sizes)
        box = _view_box(root)
        if width == 0.0 or height == 0.0 or (box and 0.0 in box[2:]):
            raise InputError("its page has no width or height, so that nothing is drawn")
        if box:  # CSS: what is not given follows from the ratio of the viewBox
            ratio = box[3] / box[2]
            width = width or (height / ratio if height else box[2])
            height = height or width * ratio
        self.height = height or 0.0
        self.inner = box[2:] if box else (width, height)
        self.scale, self.shift = _viewport((0.0, 0.0), (width, height), box, root)
        self.metres = PIXEL * self.scale[0] if set(units.values()) & ABSOLUTE.keys() else None

    def placed(self, ring):
        """A ring in the user unit along x, from the lower left corner of the page."""
        pixels = ring * self.scale + self.shift
        return np.column_stack([pixels[:, 0], self.height - pixels[:, 1]]) / self.scale[0]


def _viewport(place, size, box, element):
    """(scale (2,), shift (2,)) from the units within a viewport to those around it."""
    if box is None or None in size:
        return np.ones(2), np.array(place)
    aspect = [word for word in element.get("preserveAspectRatio", "").split() if word != "defer"] or ["xMidYMid"]
    scale = np.array(size) / box[2:]
    if aspect[0] != "none":
        scale = np.full(2, scale.max() if aspect[1:] == ["slice"] else scale.min())
    share = [0.0 if f"{axis}Min" in aspect[0] else 1.0 if f"{axis}Max" in aspect[0] else 0.5 for axis in "xY"]
    share = [0.0, 0.0] if aspect[0] == "none" else share
    return scale, place - scale * box[:2] + share * (size - scale * box[2:])


def _view_box(element):
    """(x, y, width, height), or None; one with negative sizes is invalid and counts as absent."""
    numbers = re.split(r"[\s,]+", element.get("viewBox", "").strip())
    if len(numbers) != 4 or not all(re.fullmatch(NUMBER, number) for number in numbers):
        return None
    box = tuple(map(float, numbers))
    return box if min(box[2:]) >= 0.0 and all(map(math.isfinite, box)) else None


def _resolve(root, page):
    """Write all lengths as numbers and nested viewports as transforms; remove what is not displayed. Return notes on it."""
    symbols = {element.get("id"): element for element in root.iter() if _tag(element) == "symbol"}
    boxes = {name: (_view_box(symbol), symbol) for name, symbol in symbols.items()}
    hidden: Counter = Counter()
    waiting = [(root, page)]
    while waiting:
        parent, outer = waiting.pop()
        for child in list(parent):
            tag, inner = _tag(child), outer
            _style_as_attributes(child)
            if child.get("display", "").strip().lower() == "none":
                parent.remove(child)
                hidden.update(_tag(element) for element in child.iter() if _tag(element) in SHAPES)
                continue
            if tag in (*SHAPES, "use", "svg"):
                _lengths_as_numbers(child, tag, outer)
                _set_absent_sizes(child, tag)
            if tag == "svg":
                inner = _as_group(child, _view_box(child), child, outer)
            elif tag == "use" and (named := boxes.get(_target(child), (None, None)))[0]:
                _as_group(child, *named, outer)
            elif tag == "symbol":  # drawn by <use> only
                parent[list(parent).index(child)] = definitions = ElementTree.Element(SPACE + "defs")
                definitions.append(child)
                inner = _view_box(child)[2:] if _view_box(child) else outer
            if tag in ("svg", "symbol"):
                child.tag = SPACE + "g"
                child.attrib.pop("viewBox", None)
            elif tag in NEVER_DRAWN:
                child.tag = SPACE + "defs"
            waiting.append((child, inner))
    return [f"left out {counted(sum(hidden.values()), 'shape')} with display none"] if hidden else []


def _as_group(element, box, viewport, outer):
    """Move the place, size and viewBox of an element into its transform. Return the size within."""
    place = [float(element.attrib.pop(name, "0")) for name in ("x", "y")]
    given = [element.attrib.pop(name, None) for name in ("width", "height")]
    size = tuple(whole if text is None else float(text) for text, whole in zip(given, outer, strict=True))
    if box and 0.0 in (*size, *box[2:]):
        raise InputError(f"<{_tag(element)}> has a viewport without width or height")
    scale, shift = _viewport(place, size, box, viewport)
    moves = f"translate({shift[0]!s},{shift[1]!s}) scale({scale[0]!s},{scale[1]!s})"
    element.set("transform", f"{element.get('transform', '')} {moves}".strip())
    return box[2:] if box else size


def _lengths_as_numbers(element, tag, viewport):
    """Replace units and percentages of an element's lengths by numbers."""
    width, height = viewport
    diagonal = None if None in viewport else math.sqrt((width**2 + height**2) / 2)
    wholes = dict.fromkeys(ALONG_X, width) | dict.fromkeys(ALONG_Y, height) | {"r": diagonal}
    for name in wholes.keys() & element.attrib.keys():
        text = element.attrib.pop(name).strip()
        found = LENGTH.fullmatch(text)
        unit = found[2].lower() if found else None
        if text in ("auto", ""):
            continue
        if unit == "%" and wholes[name] is not None:
            value = float(found[1]) / 100 * wholes[name]
        elif unit in PIXELS:
            value = float(found[1]) * PIXELS[unit]
        else:
            known = ", ".join(unit for unit in PIXELS if unit)
            raise InputError(f"<{tag}> has {name} = {text!r:.40}; it must be a number alone or with one of the units {known}")
        if value >= 0.0 or name not in SIZES:
            element.set(name, repr(value))


def _set_absent_sizes(element, tag):
    """A shape without a size is not drawn; the half axes of an ellipse are equal if one alone is given."""
    for name in {"rect": ("width", "height"), "circle": ("r",)}.get(tag, ()):
        element.attrib.setdefault(name, "0")
    if tag == "ellipse":
        element.set("rx", element.get("rx", element.get("ry", "0")))
        element.set("ry", element.get("ry", element.get("rx")))


def _style_as_attributes(element):
    """Move lengths and display from the style of an element, which has priority, to its attributes."""
    pairs = [pair.partition(":") for pair in element.get("style", "").split(";")]
    for name, _, value in pairs:
        if name.strip() in (*ALONG_X, *ALONG_Y, "r", "display"):
            element.set(name.strip(), value.removesuffix("!important").strip())
    kept = [f"{name}:{value}" for name, _, value in pairs if name.strip() and name.strip() not in (*ALONG_X, *ALONG_Y, "r")]
    if kept or "style" in element.attrib:
        element.set("style", ";".join(kept))


def _tag(element):
    """The tag of an SVG element without its namespace, for example "path"."""
    return str(element.tag).removeprefix(SPACE)


def _target(element):
    """The id of the element that a <use> repeats, or None."""
    links = [element.get(name) for name in LINKS if element.get(name)]
    return links[0][1:] if links and links[0].startswith("#") else None


def _require_few(root):
    """Raise InputError if <use> repeats itself, or makes more than MOST elements."""
    by_id = {element.get("id"): element for element in root.iter() if element.get("id")}
    totals, open_ids = {}, set()

    def total(element):
        """The number of elements of a subtree with those that <use> repeats."""
        if element in totals:
            return totals[element]
        if element in open_ids:
            raise InputError("a <use> repeats an element around itself")
        open_ids.add(element)
        target = by_id.get(_target(element)) if _tag(element) == "use" else None
        count = 1 + sum(map(total, element)) + (total(target) if target is not None else 0)
        open_ids.discard(element)
        totals[element] = count
        return count

    if total(root) > MOST:
        raise InputError(f"has {total(root):.4g} elements with those that <use> repeats; at most {MOST} can be read")
