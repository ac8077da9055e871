"""A flexible plate: a polygon mesh of one material and thickness, placed in the plane."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polyida.body.material import Material
from polyida.errors import InputError
from polyida.given import is_number, is_one_of, positive, settle, vector2
from polyida.joint.attachment import Attachment, labelled, of_node, of_section
from polyida.keywords import named_keywords
from polyida.mesh import PolygonMesh

ELEMENTS = ("wachspress", "virtual")
THINNEST = 1e-8  # of the mesh's extent: below, displacements have no digits left for a cell's strain
MOST_CORNERS = 16  # beyond, the corner modes of one polygon are 1e-3 of its stiffest and less


@named_keywords
@dataclass(frozen=True, eq=False)
class Plate:
    """A flexible plate in plane stress or plane strain, meshed by convex polygons.

    mesh: PolygonMesh, m. thickness: m. origin: where the mesh's (0, 0) lies, m. angle: turn about it, rad. name: how
    joints, tables and files call it (given by the scene where it is None). element: "wachspress", or "virtual" (virtual
    element of first order, which takes any simple polygon and does not lock in plane strain as nu goes to 1/2).
    tau: of virtual elements alone, no unit, > 0, usually 0.1: the stiffness, as a part of t tr(C), of the deformations
    that a cell's constant F does not see. Larger is stiffer and smaller softer in bending, most on coarse meshes (a
    cantilever of 2 cells through the thickness: its tip moves 3.5 % too far with 0.1 and 43 % too little with 0.5).
    The limit under mesh refinement is the same for every tau.
    velocity: of its centre of mass at the start, m/s, and spin about it, rad/s, as of a rigid body; `pi.consistent_state` says what joints
    make of them.
    Numbers are kept as floats. Raises InputError for a thickness or tau that is not positive, an unknown element, a
    cell that is a sliver; for wachspress, a cell that is not strictly convex or of more than 16 corners.
    """

    mesh: PolygonMesh
    material: Material
    thickness: float
    origin: tuple = (0.0, 0.0)
    angle: float = 0.0
    name: str | None = None
    element: str = "wachspress"
    tau: float = 0.1
    velocity: tuple = (0.0, 0.0)
    spin: float = 0.0
    label: str = field(init=False, repr=False)
    few = turns_only = False

    def __post_init__(self):
        label = labelled("Plate", self.name)
        settle(self, label=label)
        if not isinstance(self.mesh, PolygonMesh):
            raise InputError(f"{label}: mesh is {type(self.mesh).__name__}, a polyida mesh is needed (polyida.mesh.rectangle, read, ...)")
        if not isinstance(self.material, Material):
            raise InputError(f"{label}: material is {self.material!r}, a polyida.Material is needed")
        settle(
            self,
            thickness=positive(label, "thickness", self.thickness, "metres"),
            origin=tuple(vector2(label, "origin", self.origin).tolist()),
            velocity=tuple(vector2(label, "velocity", self.velocity).tolist()),
        )
        for key, unit in (("angle", "rad"), ("spin", "rad/s")):
            if not is_number(getattr(self, key)):
                raise InputError(f"{label}: {key} = {getattr(self, key)!r} must be a finite number of {unit}")
        if not is_one_of(self.element, ELEMENTS):
            raise InputError(f"{label}: element {self.element!r} is unknown; known: {', '.join(ELEMENTS)}")
        settle(self, angle=float(self.angle), spin=float(self.spin), tau=positive(label, "tau", self.tau, "no unit"))
        self._require_thick_cells()
        if self.element == "wachspress":
            self._of_mesh(self.mesh.require_convex)
            corners = int(np.diff(self.mesh.offsets).max())
            if corners > MOST_CORNERS:
                raise InputError(
                    f"{label}: a cell has {corners} corners; Wachspress elements grow too soft beyond {MOST_CORNERS}, "
                    'use element="virtual" or a finer mesh'
                )

    @cached_property
    def placed(self) -> PolygonMesh:
        """The mesh turned by `angle`: itself where the angle is zero, so that equal plates share their operator."""
        if self.angle == 0.0:
            return self.mesh
        c, s = np.cos(self.angle), np.sin(self.angle)
        return PolygonMesh(self.mesh.points @ np.array([[c, s], [-s, c]]), self.mesh.nodes, self.mesh.offsets, self.mesh.sections)

    @cached_property
    def points(self) -> NDArray:
        """Reference positions of the nodes in the scene, (N, 2), m."""
        return self.placed.points + np.asarray(self.origin, float)

    def section(self, selector: str | Callable[[NDArray], NDArray] | ArrayLike) -> Attachment:
        """The mean of a section of the boundary: a name of the mesh, a function of its points, or node indices.

        Raises InputError where it selects no node.
        """
        return of_section(self, self._of_mesh(self.mesh.section, selector), _called(selector))

    def rim(self, hole: int | str = 0) -> Attachment:
        """The rim of a hole of the mesh, by number or section name; its point is the hole's centre.

        That is the circle's where the rim's corners, four or more, are on one, in `pi.mesh.Link` and in meshes from files alike; the
        centroid of the area of any other hole.
        """
        return self.section(f"hole {hole}" if isinstance(hole, (int, np.integer)) else hole)

    def node(self, where: int | ArrayLike) -> Attachment:
        """One node: its index, or the node nearest to a point (x, y) of the mesh.

        A joint at one node does not converge under mesh refinement (its compliance grows with the logarithm of the size): use a
        section unless that is what is studied.
        """
        if isinstance(where, (int, np.integer)):
            if not 0 <= where < self.mesh.n_nodes:
                raise InputError(f"{self.label}: node {where} does not exist, the mesh has nodes 0 to {self.mesh.n_nodes - 1}")
            return of_node(self, int(where))
        point = vector2(self.label, "node", where)
        return of_node(self, int(np.argmin(((self.mesh.points - point) ** 2).sum(axis=1))))

    def _require_thick_cells(self):
        """A cell far thinner than the mesh is long takes its stresses from the round-off of its corners."""
        mesh, first = self.mesh, self.mesh.offsets[:-1]
        corners = mesh.points[mesh.nodes]
        reach = np.hypot(*(np.maximum.reduceat(corners, first) - np.minimum.reduceat(corners, first)).T)
        heights, extent = mesh.cell_areas / reach, np.ptp(mesh.points, axis=0).max()
        thinnest = int(np.argmin(heights))
        if heights[thinnest] < THINNEST * extent:
            raise InputError(
                f"{self.label}: cell {thinnest} is a sliver, {heights[thinnest]:.2g} m thick in a mesh of {extent:.3g} m; "
                f"cells must be thicker than {THINNEST:g} of the mesh's extent"
            )

    def _of_mesh(self, function, *arguments):
        """A function of the mesh, its complaints under the plate's name."""
        try:
            return function(*arguments)
        except InputError as error:
            raise InputError(f"{self.label}: {error}") from None


def _called(selector):
    return selector if isinstance(selector, str) else "section"
