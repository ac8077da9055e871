"""Outlines from drawings: the closed curves of an SVG or DXF file, the largest with the others as its holes."""

import warnings
from pathlib import Path

import numpy as np

from polyida.errors import InputError
from polyida.keywords import named_keywords
from polyida.mesh.drawings import dxf, svg
from polyida.mesh.files.raw import MeshWarning, hint, scale_of
from polyida.mesh.files.read_write import existing
from polyida.mesh.make.outline import Outline
from polyida.mesh.sections import signed_area

DRAWINGS = {".svg": svg.read, ".dxf": dxf.read}


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
    return _outline("SVG path", lambda: svg.of_path(path), unit, corner)


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
