"""The formats of mesh files by suffix: a dictionary that a user can add to."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from polyida.errors import InputError
from polyida.keywords import named_keywords
from polyida.mesh.files import abaqus, gmsh, meshio_files, polymesher
from polyida.mesh.files.raw import RawMesh
from polyida.mesh.polygon_mesh import PolygonMesh


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
    ".msh": Format(gmsh.read, gmsh.write_2, largest=4),
    ".msh2": Format(gmsh.read, gmsh.write_2, largest=4),
    ".msh4": Format(gmsh.read, gmsh.write_4, largest=4),
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
