"""Polygon meshes: the container, the mesher and its domains, structured meshes, files."""

from polyida.mesh.domains import Circle, Difference, Domain, Intersection, Link, Rectangle, Union
from polyida.mesh.mesher import polygonize, quads, rectangle, triangles
from polyida.mesh.outline import Outline, outline_of, read_outline, svg_path, write_outline
from polyida.mesh.polygon_mesh import MeshQuality, PolygonMesh, density_filter, moved
from polyida.mesh.raw import MeshWarning, RawMesh
from polyida.mesh.read_write import FORMATS, Format, from_lists, read, write
from polyida.mesh.refinement import refine
from polyida.mesh.sections import Section

__all__ = [
    "FORMATS",
    "Circle",
    "Difference",
    "Domain",
    "Format",
    "Intersection",
    "Link",
    "MeshQuality",
    "MeshWarning",
    "Outline",
    "PolygonMesh",
    "RawMesh",
    "Rectangle",
    "Section",
    "Union",
    "density_filter",
    "from_lists",
    "moved",
    "outline_of",
    "polygonize",
    "quads",
    "read",
    "read_outline",
    "rectangle",
    "refine",
    "svg_path",
    "triangles",
    "write",
    "write_outline",
]


def __dir__():
    """Return the public names of the package, `__all__`, for `dir()`."""
    return __all__
