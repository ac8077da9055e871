"""Polygon meshes: the container, the mesher and its domains, structured meshes, files."""

from polyida.mesh.density_filter import density_filter
from polyida.mesh.drawings.outlines import read_outline, svg_path
from polyida.mesh.files.lists import from_lists
from polyida.mesh.files.raw import MeshWarning, RawMesh
from polyida.mesh.files.read_write import FORMATS, Format, read, write
from polyida.mesh.make.domains import Circle, Difference, Domain, Intersection, Link, Rectangle, Union
from polyida.mesh.make.mesher import polygonize
from polyida.mesh.make.outline import Outline
from polyida.mesh.make.rectangles import quads, rectangle, triangles
from polyida.mesh.polygon_mesh import PolygonMesh
from polyida.mesh.quality import MeshQuality
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
    "polygonize",
    "quads",
    "read",
    "read_outline",
    "rectangle",
    "svg_path",
    "triangles",
    "write",
]
