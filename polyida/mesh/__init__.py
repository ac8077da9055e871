"""Polygon meshes: the container, the mesher and its domains, structured meshes, files."""

from polyida.mesh.files import read, write
from polyida.mesh.make.domains import Circle, Difference, Domain, Intersection, Link, Rectangle, Union
from polyida.mesh.make.mesher import polygonize
from polyida.mesh.make.rectangles import quads, rectangle, triangles
from polyida.mesh.polygon_mesh import PolygonMesh
from polyida.mesh.quality import MeshQuality
from polyida.mesh.sections import Section

__all__ = [
    "Circle",
    "Difference",
    "Domain",
    "Intersection",
    "Link",
    "MeshQuality",
    "PolygonMesh",
    "Rectangle",
    "Section",
    "Union",
    "polygonize",
    "quads",
    "read",
    "rectangle",
    "triangles",
    "write",
]
