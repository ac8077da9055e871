"""A flexible plate: a polygon mesh of one material, St. Venant-Kirchhoff, and thickness, placed in the plane."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polyida.errors import InputError
from polyida.joint.attachment import Attachment, labelled, of_node, of_section
from polyida.mesh import PolygonMesh
from polyida.validation import is_number, is_one_of, named_keywords, number, positive, settle, vector2

NUMBERS = ("E", "nu", "rho", "viscosity", "mass_damping")


@named_keywords
@dataclass(frozen=True)
class Material:
    """St. Venant-Kirchhoff, `S = E/(1 - nu^2) [(1 - nu) E_GL + nu tr(E_GL) I]` in plane stress.

    E: Young's modulus, Pa, > 0. nu: Poisson's ratio in (-1, 0.5). rho: density, kg/m3, > 0. plane: "stress" or
    "strain"; plane strain is the same formula with E/(1 - nu^2) and nu/(1 - nu).

    viscosity: Kelvin-Voigt time, s, >= 0: `S = D : (E_GL + viscosity E_GL')`. It is Rayleigh's stiffness-proportional
    part about the state at rest, where a mode of frequency w rad/s has the damping ratio `viscosity w / 2`; it is
    objective, so rigid motion, however fast, dissipates nothing. The stabilisation of virtual elements is not damped
    by it: what their cells' constant F does not see swings on freely.
    mass_damping: Rayleigh's mass-proportional part, 1/s, >= 0: a force `mass_damping M v` with the plate's M (point
    masses are not damped), the damping ratio `mass_damping / (2 w)`. It acts on the velocity itself, as a medium at
    rest would: rigid motion is braked too, a free plate slows down as `exp(-mass_damping t)` and falls at `g /
    mass_damping` at most.

    All numbers are kept as floats. Raises InputError naming the value that is out of range.
    """

    E: float
    nu: float
    rho: float
    plane: str = "stress"
    viscosity: float = 0.0
    mass_damping: float = 0.0

    def __post_init__(self):
        for name, value, good, want in (
            ("E", self.E, is_number(self.E) and self.E > 0, "a positive modulus in Pa"),
            ("nu", self.nu, is_number(self.nu) and -1 < self.nu < 0.5, "inside (-1, 0.5)"),
            ("rho", self.rho, is_number(self.rho) and self.rho > 0, "a positive density in kg/m3"),
            ("viscosity", self.viscosity, is_number(self.viscosity) and self.viscosity >= 0, "a time in s, not negative"),
            ("mass_damping", self.mass_damping, is_number(self.mass_damping) and self.mass_damping >= 0, "a rate in 1/s, not negative"),
            ("plane", self.plane, is_one_of(self.plane, ("stress", "strain")), '"stress" or "strain"'),
        ):
            if not good:
                raise InputError(f"Material: {name} = {value!r} must be {want}")
        settle(self, **{name: float(getattr(self, name)) for name in NUMBERS})

    @property
    def damped(self) -> bool:
        """Whether the material brakes motion."""
        return self.viscosity > 0 or self.mass_damping > 0

    @property
    def in_plane(self) -> tuple[float, float]:
        """(modulus, ratio) that the plane-stress formula takes for this material."""
        if self.plane == "stress":
            return self.E, self.nu
        return self.E / (1 - self.nu**2), self.nu / (1 - self.nu)

    @property
    def across(self) -> float:
        """Ratio of the stress across the plane to xx + yy: Hooke's nu in plane strain, which is St. Venant-Kirchhoff's at small strains."""
        return self.nu if self.plane == "strain" else 0.0


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
            angle=number(label, "angle", self.angle, "rad"),
            spin=number(label, "spin", self.spin, "rad/s"),
        )
        if not is_one_of(self.element, ELEMENTS):
            raise InputError(f"{label}: element {self.element!r} is unknown; known: {', '.join(ELEMENTS)}")
        settle(self, tau=positive(label, "tau", self.tau, "no unit"))
        # a cell far thinner than the mesh is long takes its stresses from the round-off of its corners
        mesh, first = self.mesh, self.mesh.offsets[:-1]
        places = mesh.points[mesh.nodes]
        reach = np.hypot(*(np.maximum.reduceat(places, first) - np.minimum.reduceat(places, first)).T)
        heights, extent = mesh.cell_areas / reach, np.ptp(mesh.points, axis=0).max()
        thinnest = int(np.argmin(heights))
        if heights[thinnest] < THINNEST * extent:
            raise InputError(
                f"{self.label}: cell {thinnest} is a sliver, {heights[thinnest]:.2g} m thick in a mesh of {extent:.3g} m; "
                f"cells must be thicker than {THINNEST:g} of the mesh's extent"
            )
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
        return of_section(self, self._of_mesh(self.mesh.section, selector), selector if isinstance(selector, str) else "section")

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

    def _of_mesh(self, function, *arguments):
        """A function of the mesh, its complaints under the plate's name."""
        try:
            return function(*arguments)
        except InputError as error:
            raise InputError(f"{self.label}: {error}") from None
