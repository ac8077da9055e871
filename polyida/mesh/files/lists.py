"""A mesh from arrays and lists that are in memory."""

import warnings
from collections.abc import Iterable, Mapping

from numpy.typing import ArrayLike

from polyida.errors import InputError
from polyida.given import is_whole, reals
from polyida.keywords import named_keywords
from polyida.mesh.files.raw import MeshWarning, RawMesh, hint, scale_of
from polyida.mesh.files.read_write import merge_tolerance
from polyida.mesh.files.repair import repaired
from polyida.mesh.polygon_mesh import PolygonMesh


@named_keywords
def from_lists(
    points: ArrayLike,
    cells: Iterable,
    first: int = 0,
    sections: Mapping | None = None,
    supports: Mapping | None = None,
    loads: Mapping | None = None,
    unit: str | float | None = None,
    tolerance: float = 1e-9,
) -> PolygonMesh:
    """PolygonMesh of points (n, 2) and cells, a list of nodes each, as PolyTop has them.

    first: the number of the first node, 0 or 1 (MATLAB), in cells, in sections (name -> nodes), supports (node -> (x fixed, y fixed))
    and loads (node -> (Fx, Fy), N). Repaired as `pi.mesh.read` does and said so, but where nothing is to repair nodes and cells keep
    their numbers. unit, tolerance: as there.
    Raises InputError naming the cell or node that is wrong.
    """
    if not is_whole(first, 0, 1):
        raise InputError(f"mesh of lists: first is {first!r}; it must be 0 or 1, the number of the first node")
    if not isinstance(cells, Iterable) or isinstance(cells, (str, bytes, Mapping)):
        raise InputError(f"mesh of lists: cells are {repr(cells)[:80]}; they must be a list of lists of nodes")
    sections = {} if sections is None else sections
    if not isinstance(sections, Mapping):
        raise InputError(f"mesh of lists: sections are {repr(sections)[:80]}; they must be a dictionary, name -> nodes")
    given = reals(points)
    if given is None:
        raise InputError(f"mesh of lists: points are {repr(points)[:80]}; they must be an (n, 2) array of numbers")
    try:
        raw = RawMesh(given, cells, sections, {} if supports is None else supports, {} if loads is None else loads, first=first)
        mesh, notes = repaired(raw, merge_tolerance(tolerance), scale_of(unit, None), numbered=False)
    except InputError as error:
        raise InputError(f"mesh of lists: {error}") from None
    if notes := notes + hint(mesh.points, unit, None):
        warnings.warn(f"mesh of lists: {'; '.join(notes)}", MeshWarning, stacklevel=3)
    return mesh
