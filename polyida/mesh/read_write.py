"""Meshes from files and from lists in memory; the format is that of the file's suffix, of a dictionary that a user can add to."""

import os
import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from polyida.errors import InputError
from polyida.mesh import abaqus, meshio_files, polymesher, sections
from polyida.mesh.polygon_mesh import PolygonMesh
from polyida.mesh.raw import MeshWarning, RawMesh, hint, metres, scale_of
from polyida.mesh.repair import repaired
from polyida.validation import is_flag, is_number, is_whole, named_keywords, reals


@named_keywords
@dataclass(frozen=True)
class Format:
    """One format: read(path) -> RawMesh, write(mesh, path), None where it cannot.

    largest: corners of the largest cells it holds, None for any; names: whether it keeps the names of sections;
    forces: whether it keeps supports and loads.
    """

    read: Callable[[Path], RawMesh] | None = None
    write: Callable[[PolygonMesh, Path], None] | None = None
    largest: int | None = None
    names: bool = True
    forces: bool = False


FORMATS: dict[str, Format] = {
    ".mat": Format(polymesher.read, polymesher.write, forces=True),
    ".vtu": Format(meshio_files.reader("vtu"), meshio_files.writer("vtu")),
    ".vtk": Format(meshio_files.reader("vtk"), meshio_files.writer("vtk")),
    ".obj": Format(meshio_files.reader("obj"), meshio_files.writer("obj"), names=False),
    ".msh": Format(meshio_files.read_gmsh, meshio_files.write_gmsh_2, largest=4),
    ".msh2": Format(meshio_files.read_gmsh, meshio_files.write_gmsh_2, largest=4),
    ".msh4": Format(meshio_files.read_gmsh, meshio_files.write_gmsh_4, largest=4),
    ".inp": Format(abaqus.read, abaqus.write, largest=4, forces=True),
    ".mesh": Format(meshio_files.reader("medit"), meshio_files.writer("medit"), largest=4, names=False),
}


def format_of(path, given=None):
    """Format of a path by its suffix, or by the name given, with or without its point; InputError for unknown ones."""
    suffix = path.suffix if given is None else given
    if isinstance(suffix, str):
        found = FORMATS.get("." + suffix.lower().removeprefix("."))
        if found:
            return found
    what = f"has the suffix {suffix!r}" if given is None else f"shall have the format {given!r}"
    raise InputError(f"mesh file {path} {what}; known are {', '.join(FORMATS)}")


@named_keywords
def read(path: str | Path, tolerance: float = 1e-9, unit: str | float | None = None, format: str | None = None) -> PolygonMesh:
    """PolygonMesh of a file of triangles, quads and polygons, of one or several kinds.

    The suffix tells the format, or format does: .mat (PolyMesher), .msh (Gmsh 2.2, 4.1), .inp (Abaqus), .vtu, .vtk, .obj,
    .mesh (MEDIT), and what you add to `pi.mesh.FORMATS`. unit: of the file's lengths, 'mm', 'in', ... or the metres in one;
    without it they are metres. Points closer than tolerance times the mesh's size merge (0: none), unused ones go, clockwise cells
    turn, elements of higher order become their corners. Whatever is changed so is said by one MeshWarning. Nodes are renumbered
    where that narrows the bandwidth by a fifth, cells always sorted along them.

    Sections: the file's named physical groups and node sets, groups without a name by their number, what write stored, and left,
    right, top, bottom and 'hole 0', ... found from the boundary. Of supports: 'support', 'support x', 'support y', of loads 'load'.
    Raises InputError, naming the file, for anything it cannot use.
    """
    path = existing(path)
    kind, tolerance = format_of(path, format), merge_tolerance(tolerance)
    if kind.read is None:
        raise InputError(f"mesh file {path} is of a format that can only be written")
    mesh, notes = _mesh(path, kind, tolerance, unit)
    if notes:
        warnings.warn(f"mesh file {path}: {'; '.join(notes)}", MeshWarning, stacklevel=3)
    return mesh


@named_keywords
def write(mesh: PolygonMesh, path: str | Path, overwrite: bool = False, unit: str | float = "m", format: str | None = None) -> Path:
    """Write a mesh and return the path; the suffix tells the format as in `read`, or format does: 'msh4' for Gmsh 4.1, 2.2 without.

    .mat, .vtu, .vtk and .obj hold polygons, the others triangles and quads. All but .obj and .mesh keep the names of sections, .mat
    and .inp the supports and loads too; a MeshWarning says what is left out. unit: of the lengths in the file.
    Whole or not at all: a temporary file beside it is renamed. Raises InputError for an existing file without overwrite=True
    and for formats that cannot hold the mesh.
    """
    if not isinstance(mesh, PolygonMesh):
        raise InputError(f"mesh to write is {repr(mesh)[:80]}; it must be a PolygonMesh")
    path = _path(path)
    kind, size = format_of(path, format), metres(unit)
    if not is_flag(overwrite):
        raise InputError(f"mesh file {path}: overwrite = {overwrite!r} must be True or False")
    if kind.write is None:
        raise InputError(f"mesh file {path} is of a format that can only be read")
    sizes = np.diff(mesh.offsets)
    if kind.largest is not None and sizes.max() > kind.largest:
        able = ", ".join(suffix for suffix, known in FORMATS.items() if known.write and known.largest is None)
        raise InputError(
            f"mesh file {path}: its format holds triangles and quads only; cell {np.argmax(sizes)} has {sizes.max()} corners. "
            f"Polygons go into {able}"
        )
    if path.exists() and not overwrite:
        raise InputError(f"mesh file {path} exists; pass overwrite=True to replace it")
    named = dict(mesh.sections), dict(mesh.supports), dict(mesh.loads)
    partial = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        kind.write(mesh if size == 1.0 else PolygonMesh(mesh.points / size, mesh.nodes, mesh.offsets, *named), partial)
        os.replace(partial, path)
    except OSError as error:
        raise InputError(f"mesh file {path} cannot be written: {error.strerror or error}") from None
    except InputError as error:
        raise InputError(f"mesh file {path} cannot be written: {error}") from None
    finally:
        partial.unlink(missing_ok=True)
    lost = _left_out(mesh, kind)
    if lost:
        warnings.warn(f"mesh file {path}: its format does not hold {' and '.join(lost)}, which were left out", MeshWarning, stacklevel=3)
    return path


def _mesh(path, kind, tolerance, unit):
    """(PolygonMesh, notes) of a file; every failure inside names it."""
    try:
        with np.errstate(all="ignore"):
            raw = kind.read(path)
            mesh, notes = repaired(raw, tolerance, scale_of(unit, raw.metres))
        return mesh, notes + hint(mesh.points, unit, raw.metres)
    except InputError as error:
        raise InputError(f"mesh file {path}: {error}") from None
    except Exception as error:
        raise InputError(f"mesh file {path} holds inconsistent data: {type(error).__name__}: {str(error)[:200]}") from error


def _left_out(mesh, kind):
    """[what of the mesh the format does not hold]; sections of the boundary are found again."""
    found = sections.automatic(mesh.points, mesh.boundary_edges)
    named = [name for name, nodes in mesh.sections.items() if not np.array_equal(np.sort(nodes), np.sort(found.get(name, [])))]
    lost = ["the sections " + ", ".join(map(repr, named))] if named and not kind.names else []
    if not kind.forces and (mesh.supports or mesh.loads):
        lost.append("supports and loads")
    return lost


def merge_tolerance(tolerance):
    """A float from 0 to below 1, else InputError."""
    if not is_number(tolerance) or not 0 <= tolerance < 1:
        raise InputError(f"merge tolerance is {tolerance!r}; it must be a share of the mesh's size from 0 to below 1")
    return float(tolerance)


def _path(path):
    try:
        return Path(path)
    except TypeError:
        raise InputError(f"mesh file {path!r} must be a path") from None


def existing(path):
    """The path of a file that there is, as Path; outlines are read so too."""
    path = _path(path)
    try:
        exists = path.is_file()
    except (OSError, ValueError):
        exists = False
    if not exists:
        raise InputError(f"mesh file {str(path)!r} does not exist or is not a file")
    return path


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
