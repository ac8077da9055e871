"""Meshes from files and from lists; the suffix selects the format from a dictionary that users can extend."""

import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from polyida.errors import InputError
from polyida.files import remove_left_over, replacing
from polyida.mesh import abaqus, meshio_files, polymesher, sections
from polyida.mesh.polygon_mesh import PolygonMesh
from polyida.mesh.raw import MeshWarning, RawMesh, repaired, unit_note, unit_size
from polyida.validation import flag, is_number, is_whole, named_keywords, reals


@named_keywords
@dataclass(frozen=True)
class Format:
    """A file format for `pi.mesh.FORMATS`.

    Parameters
    ----------
    read : function of a Path, returns RawMesh, optional
    write : function of a PolygonMesh and a Path, optional
    largest : int, optional
        Largest number of corners of a cell that the format can store. Default: any.
    names : bool
        True if the format stores the names of sections.
    forces : bool
        True if the format stores supports and loads.
    """

    read: "Callable[[Path], RawMesh] | None" = None
    write: "Callable[[PolygonMesh, Path], None] | None" = None
    largest: int | None = None
    names: bool = True
    forces: bool = False


FORMATS: dict[str, Format] = {
    ".mat": Format(polymesher.read_mat, polymesher.write_mat, forces=True),
    ".vtu": Format(meshio_files.reader("vtu"), meshio_files.writer("vtu")),
    ".vtk": Format(meshio_files.reader("vtk"), meshio_files.writer("vtk")),
    ".obj": Format(meshio_files.reader("obj"), meshio_files.writer("obj"), names=False),
    ".msh": Format(meshio_files.read_gmsh, meshio_files.write_gmsh_2, largest=4),
    ".msh2": Format(meshio_files.read_gmsh, meshio_files.write_gmsh_2, largest=4),
    ".msh4": Format(meshio_files.read_gmsh, meshio_files.write_gmsh_4, largest=4),
    ".inp": Format(abaqus.read_inp, abaqus.write_inp, largest=4, forces=True),
    ".mesh": Format(meshio_files.reader("medit"), meshio_files.writer("medit"), largest=4, names=False),
}


def _format_of(path, name):
    """Format of a path by its suffix, or by a name with or without its point."""
    suffix = path.suffix if name is None else name
    known = FORMATS.get("." + suffix.lower().removeprefix(".")) if isinstance(suffix, str) else None
    if known is None:
        what = f"{'has the suffix' if name is None else 'shall have the format'} {suffix!r}; known are {', '.join(FORMATS)}"
        raise InputError(f"mesh file {path} {what}")
    return known


@named_keywords
def read(path: str | Path, tolerance: float = 1e-9, unit: str | float | None = None, format: str | None = None) -> PolygonMesh:
    """Return the mesh in a file of triangles, quadrilaterals and polygons.

    Close points are merged, unused points and repeated corners dropped, clockwise cells reversed. Elements of order 2 keep their middle nodes
    if all cells have them (`mesh.order`), else they are reduced to their corners, as are elements of higher order; one MeshWarning lists all changes, and nodes within an edge, where cells are not joined. Nodes are renumbered if that reduces the bandwidth by a fifth; cells are sorted by their nodes.

    Parameters
    ----------
    path : str or Path
        .mat (PolyMesher), .msh (Gmsh 2.2, 4.1), .inp (Abaqus), .vtu, .vtk, .obj, .mesh (MEDIT), and formats added to `pi.mesh.FORMATS`.
    tolerance : float, 0 to 1
        Distance of points that merge, relative to the size of the mesh; 0: none.
    unit : str or float, m, optional
        Of the file's lengths: 'm', 'dm', 'cm', 'mm', 'um', 'in', 'ft', or the metres in one unit. Default: the file's, else metres.
    format : str, optional
        Instead of the suffix.

    Returns
    -------
    PolygonMesh
        Sections: physical groups (without a name: by number), node sets, stored sections; left, right, top, bottom and 'hole 0', ... of the
        boundary; 'support', 'support x', 'support y', 'load'.

    Raises
    ------
    InputError
        Naming the file, if it cannot be used.
    """
    path = existing(path)
    kind, tolerance = _format_of(path, format), _merge_tolerance(tolerance)
    if kind.read is None:
        raise InputError(f"mesh file {path} is of a format that can only be written")
    try:
        with np.errstate(all="ignore"):
            raw = kind.read(path)
            mesh, notes = repaired(raw, tolerance, unit_size(unit, raw.metres))
    except InputError as error:
        raise InputError(f"mesh file {path}: {error}") from None
    except Exception as error:
        raise InputError(f"mesh file {path} holds inconsistent data: {type(error).__name__}: {str(error)[:200]}") from error
    if notes := notes + unit_note(mesh.points, unit, raw.metres):
        warnings.warn(f"mesh file {path}: {'; '.join(notes)}", MeshWarning, stacklevel=3)
    return mesh


@named_keywords
def write(mesh: PolygonMesh, path: str | Path, overwrite: bool = False, unit: str | float = "m", format: str | None = None) -> Path:
    """Write a mesh to a file. A temporary file is renamed at the end, so that no incomplete file remains.

    .mat, .vtu, .vtk and .obj store polygons, the others triangles and quadrilaterals. All but .obj and .mesh store the names of sections;
    .mat and .inp also supports and loads. A MeshWarning says what is left out.

    Parameters
    ----------
    mesh : PolygonMesh
    path : str or Path
    overwrite : bool
        True to replace an existing file.
    unit : str or float, m
        Of the lengths in the file, as of `read`.
    format : str, optional
        Instead of the suffix; 'msh4' for Gmsh 4.1 ('msh' is 2.2).

    Returns
    -------
    Path
        Of the file.

    Raises
    ------
    InputError
        For an existing file without overwrite=True, and for formats that cannot store the mesh.
    """
    if not isinstance(mesh, PolygonMesh):
        raise InputError(f"mesh to write is {repr(mesh)[:80]}; it must be a PolygonMesh")
    path = path_of(path)
    kind = _format_of(path, format)
    if unit is None:
        raise InputError(f"mesh file {path}: unit is None; it must be the name of a unit, or the metres in one unit")
    size = unit_size(unit)
    if kind.write is None:
        raise InputError(f"mesh file {path} is of a format that can only be read")
    sizes = np.diff(mesh.offsets)
    if mesh.order == 2:
        raise InputError(f"mesh file {path}: meshes of order 2 are not written; write mesh.linear, the mesh of its corners")
    if kind.largest is not None and sizes.max() > kind.largest:
        able = ", ".join(suffix for suffix, known in FORMATS.items() if known.write and known.largest is None)
        raise InputError(
            f"mesh file {path}: its format holds triangles and quads only; cell {np.argmax(sizes)} has {sizes.max()} corners. "
            f"Polygons go into {able}"
        )
    named = dict(mesh.sections), dict(mesh.supports), dict(mesh.loads)
    scaled = mesh if size == 1.0 else PolygonMesh(mesh.points / size, mesh.nodes, mesh.offsets, *named, mesh.order)
    put(f"mesh file {path}", path, overwrite, lambda temporary: kind.write(scaled, temporary))
    # sections of the boundary are found again by read
    automatic = sections.automatic(mesh.points, mesh.boundary_edges)
    names = [name for name, nodes in mesh.sections.items() if not np.array_equal(np.sort(nodes), np.sort(automatic.get(name, [])))]
    lost = ["the sections " + ", ".join(map(repr, names))] if names and not kind.names else []
    if not kind.forces and (mesh.supports or mesh.loads):
        lost.append("supports and loads")
    if lost:
        warnings.warn(f"mesh file {path}: its format does not hold {' and '.join(lost)}, which were left out", MeshWarning, stacklevel=3)
    return path


def put(part, path, overwrite, write):
    """Write a file by `write(temporary path)` and rename it. Raises InputError in the name of `part` if it exists and overwrite is False."""
    flag(part, "overwrite", overwrite)
    if path.exists() and not overwrite:
        raise InputError(f"{part} exists; pass overwrite=True to replace it")
    remove_left_over(path.parent)
    try:
        with replacing(path) as temporary:
            write(temporary)
    except (OSError, InputError) as error:
        raise InputError(f"{part} cannot be written: {getattr(error, 'strerror', None) or error}") from None


def _merge_tolerance(tolerance):
    """The tolerance, relative to the size of the mesh, within which points are merged, as a float. Raises InputError unless 0 <= it < 1."""
    if not is_number(tolerance) or not 0 <= tolerance < 1:
        raise InputError(f"merge tolerance is {tolerance!r}; it must be a share of the mesh's size from 0 to below 1")
    return float(tolerance)


def path_of(path):
    """Return the Path of a file. Raise InputError for what is no path."""
    try:
        return Path(path)
    except TypeError:
        raise InputError(f"mesh file {path!r} must be a path") from None


def existing(path):
    """Return the Path of an existing file. Raise InputError if there is none."""
    path = path_of(path)
    try:
        exists = path.is_file()
    except (OSError, ValueError):
        exists = False
    if not exists:
        raise InputError(f"mesh file {str(path)!r} does not exist or is not a file")
    return path


@named_keywords
def from_lists(
    points: "ArrayLike",
    cells: Iterable,
    first: int = 0,
    sections: Mapping | None = None,
    supports: Mapping | None = None,
    loads: Mapping | None = None,
    unit: str | float | None = None,
    tolerance: float = 1e-9,
) -> PolygonMesh:
    """Return the mesh of points and lists of nodes, as PolyTop has them.

    Repaired as by `pi.mesh.read`, with a MeshWarning; without repair nodes and cells keep their numbers.

    Parameters
    ----------
    points : (n, 2) float
    cells : list of lists of nodes
    first : 0 or 1
        Number of the first node in cells, sections, supports and loads; 1 as in MATLAB.
    sections : dict of name to nodes, optional
    supports : dict of node to (x fixed, y fixed), optional
    loads : dict of node to (Fx, Fy), N, optional
    unit : str or float, m, optional
        Of the points, as of `pi.mesh.read`.
    tolerance : float, 0 to 1
        As of `pi.mesh.read`.

    Returns
    -------
    PolygonMesh
        With automatic sections, as of `pi.mesh.read`.

    Raises
    ------
    InputError
        Naming the wrong cell, node or value.
    """
    if not is_whole(first, 0, 1):
        raise InputError(f"mesh of lists: first is {first!r}; it must be 0 or 1, the number of the first node")
    if not isinstance(cells, Iterable) or isinstance(cells, (str, bytes, Mapping)):
        raise InputError(f"mesh of lists: cells are {repr(cells)[:80]}; they must be a list of lists of nodes")
    sections = {} if sections is None else sections
    if not isinstance(sections, Mapping):
        raise InputError(f"mesh of lists: sections are {repr(sections)[:80]}; they must be a dictionary, name -> nodes")
    array = reals(points)
    if array is None:
        raise InputError(f"mesh of lists: points are {repr(points)[:80]}; they must be an (n, 2) array of numbers")
    try:
        raw = RawMesh(array, cells, sections, {} if supports is None else supports, {} if loads is None else loads, first=first)
        mesh, notes = repaired(raw, _merge_tolerance(tolerance), unit_size(unit), numbered=False)
    except InputError as error:
        raise InputError(f"mesh of lists: {error}") from None
    if notes := notes + unit_note(mesh.points, unit, None):
        warnings.warn(f"mesh of lists: {'; '.join(notes)}", MeshWarning, stacklevel=3)
    return mesh
