"""A flexible plate: a polygon mesh with a St. Venant-Kirchhoff material and a thickness, placed in the plane."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from polyida.errors import InputError
from polyida.fields import above_zero, check, check_fields, must_be, none_or, not_negative, pair
from polyida.joint.attachment import Attachment, of_node, of_section
from polyida.mesh import PolygonMesh
from polyida.validation import floats, is_number, is_one_of, is_whole, labelled, named_keywords, number, positive, settle, vector2


def prony_series(part: str, name: str, prony: Any) -> tuple[tuple[float, float], ...]:
    """Return a Prony series as pairs of floats. Raise InputError, naming the part, if it is none."""
    terms = np.zeros((0, 2)) if isinstance(prony, (tuple, list)) and not prony else floats(prony)
    if terms is None or terms.ndim != 2 or terms.shape[1] != 2 or not (terms > 0).all() or not terms[:, 0].sum() < 1:
        what = "must be a list of pairs (g, tau) with g > 0, tau > 0 in s, and a sum of g below 1"
        raise InputError(f"{part}: {name} = {prony!r:.100} {what}")
    return tuple((float(g), float(tau)) for g, tau in terms)


@named_keywords
@dataclass(frozen=True)
class Material:
    """St. Venant-Kirchhoff material, `S = E/(1 - nu^2) [(1 - nu) E_GL + nu tr(E_GL) I]` in plane stress.

    Plane strain is the same formula with E/(1 - nu^2) and nu/(1 - nu).

    Parameters
    ----------
    E : float, Pa, > 0
        Young's modulus.
    nu : float in (-1, 0.5)
        Poisson's ratio.
    rho : float, kg/m3, > 0
        Density.
    plane : "stress" or "strain"
    viscosity : float, s, >= 0
        Kelvin-Voigt relaxation time: `S = D : (E_GL + viscosity E_GL')`. It is objective, so rigid motion dissipates nothing. About the
        state at rest it is Rayleigh's stiffness-proportional damping, with the damping ratio `viscosity w / 2` of a mode of w rad/s. The
        stabilisation of virtual elements is not damped by it.
    mass_damping : float, 1/s, >= 0
        Rayleigh mass coefficient: the force is `mass_damping M v` with the plate's M, the damping ratio `mass_damping / (2 w)`. Rigid motion
        is damped too: a free plate slows down as `exp(-mass_damping t)`. Point masses are not damped.
    prony : list of (g, tau), no unit and s
        Relaxation of a viscoelastic material: `S = D : (E_GL - sum g x)`, `x' = (E_GL - x) / tau`. E is the modulus of a sudden strain, and
        `E (1 - sum g)` that of a constant one after a long time; g > 0, sum g < 1, tau > 0. Modes take the first, `pi.static` the second. The
        stabilisation of virtual elements does not relax, nor do rigid bodies. A reduced plate
        relaxes in the span of its fields, with (modes + 1)^2 states for each term.

    Raises
    ------
    InputError
        If a value is out of range.
    """

    E: float = field(metadata=must_be("a positive modulus in Pa", above_zero, float))
    nu: float = field(metadata=must_be("inside (-1, 0.5)", lambda x: is_number(x) and -1 < x < 0.5, float))
    rho: float = field(metadata=must_be("a positive density in kg/m3", above_zero, float))
    plane: str = field(default="stress", metadata=must_be('"stress" or "strain"', lambda x: is_one_of(x, ("stress", "strain"))))
    viscosity: float = field(default=0.0, metadata=must_be("a time in s, not negative", not_negative, float))
    mass_damping: float = field(default=0.0, metadata=must_be("a rate in 1/s, not negative", not_negative, float))
    prony: Sequence[tuple[float, float]] = field(default=(), metadata=check(prony_series))

    def __post_init__(self):
        """Check the fields of the material. Raises InputError."""
        check_fields(self, "Material")

    @property
    def damped(self) -> bool:
        """True if the material dissipates energy."""
        return self.viscosity > 0 or self.mass_damping > 0

    @property
    def in_plane(self) -> tuple[float, float]:
        """(modulus, ratio) in the plane-stress formula."""
        if self.plane == "stress":
            return self.E, self.nu
        return self.E / (1 - self.nu**2), self.nu / (1 - self.nu)

    @property
    def across(self) -> float:
        """Stress normal to the plane over xx + yy: nu in plane strain (exact for small strains), 0 in plane stress."""
        return self.nu if self.plane == "strain" else 0.0


ELEMENTS = ("wachspress", "virtual")
THINNEST = 1e-8  # thickness of a cell over the mesh's extent: displacements of thinner cells have too few digits for strains
MOST_CORNERS = 16  # the softest mode of a Wachspress cell with more corners has less than 1e-3 of the stiffness of its stiffest mode


@named_keywords
@dataclass(frozen=True, eq=False)
class Plate:
    """A flexible plate in plane stress or plane strain on a polygon mesh.

    Parameters
    ----------
    mesh : PolygonMesh, m
    material : Material
    thickness : float, m, > 0
    origin : (2,) float, m
        Position of the mesh's (0, 0).
    angle : float, rad
        Rotation about the origin.
    name : str, optional
        In joints, tables and files. Default: kind and number in the scene.
    element : "wachspress" or "virtual"
        Virtual elements of first order take any simple polygon and do not lock in plane strain as nu goes to 1/2.
    tau : float, > 0
        Stabilisation of virtual elements and quadratic cells: stiffness, relative to t tr(C), of the deformations that a constant F
        does not contain, in quadratic cells of those that no quadratic field fits.
        The limit under mesh refinement is the same for every tau; on coarse meshes a larger tau is stiffer in bending (tip of a cantilever
        with 2 cells through the thickness, virtual elements: 3.5 % too far with 0.1, 43 % too short with 0.5). One layer of 10 quadratic
        quadrilaterals in a free beam of 20:1 has its third frequency 4.5 % too low with 0.1 and 0.3 % with 0.2; with 30 polygons it
        is right within 0.5 %.
    velocity : (2,) float, m/s
        Of the centre of mass at the start; see `pi.consistent_state`.
    spin : float, rad/s
        About the centre of mass at the start.
    order : 1 or 2, optional
        2: quadratic cells, with a middle node on each side, which the plate adds if its mesh has none; `mesh` is then the mesh with these nodes.
        A tenth of the coordinates is enough where the plate bends, and plane strain does not lock as nu goes to 1/2. Default: that of the mesh,
        1 unless it has middle nodes.

    Raises
    ------
    InputError
        For a wrong value, an unknown element, virtual elements of order 2, or a cell that is a sliver; for Wachspress elements also for a cell
        that is not strictly convex or has more than 16 corners.
    """

    mesh: PolygonMesh
    material: Material
    thickness: float = field(metadata=check(positive, "metres"))
    origin: tuple = field(default=(0.0, 0.0), metadata=check(pair))
    angle: float = field(default=0.0, metadata=check(number, "rad"))
    name: str | None = None
    element: str = "wachspress"
    tau: float = field(default=0.1, metadata=check(positive, "no unit"))
    velocity: tuple = field(default=(0.0, 0.0), metadata=check(pair))
    spin: float = field(default=0.0, metadata=check(number, "rad/s"))
    order: int | None = field(default=None, metadata=must_be("1, or 2 for quadratic cells", none_or(lambda x: is_whole(x, 1, 2))))
    label: str = field(init=False, repr=False)
    is_full = True  # as of Body
    turns_only = False

    def __post_init__(self):
        """Check the fields, and take the mesh with the middle nodes that the order needs."""
        label = labelled("Plate", self.name)
        mesh, material = self.mesh, self.material
        if not isinstance(mesh, PolygonMesh):
            raise InputError(f"{label}: mesh is {type(mesh).__name__}, a polyida mesh is needed (polyida.mesh.rectangle, read, ...)")
        if not isinstance(material, Material):
            raise InputError(f"{label}: material is {material!r}, a polyida.Material is needed")
        settle(self, label=label)
        check_fields(self, label)
        if not is_one_of(self.element, ELEMENTS):
            raise InputError(f"{label}: element {self.element!r} is unknown; known: {', '.join(ELEMENTS)}")
        order = mesh.order if self.order is None else int(self.order)
        if order == 2 and self.element != "wachspress":
            raise InputError(f'{label}: order = 2 with element {self.element!r}; quadratic cells need element="wachspress"')
        mesh = mesh.linear if order == 1 else mesh
        self._require_cells(mesh)
        settle(self, order=order, mesh=mesh.quadratic if order == 2 else mesh)

    def _require_cells(self, mesh):
        """Raise InputError if a cell of a mesh without middle nodes is a sliver, or, for Wachspress elements, not convex or of too many corners."""
        first, corners = mesh.offsets[:-1], mesh.points[mesh.nodes]
        lengths = np.hypot(*(np.maximum.reduceat(corners, first) - np.minimum.reduceat(corners, first)).T)
        heights, extent = mesh.cell_areas / lengths, np.ptp(mesh.points, axis=0).max()
        thinnest = int(np.argmin(heights))
        if heights[thinnest] < THINNEST * extent:
            raise InputError(
                f"{self.label}: cell {thinnest} is a sliver, {heights[thinnest]:.2g} m thick in a mesh of {extent:.3g} m; "
                f"cells must be thicker than {THINNEST:g} of the mesh's extent"
            )
        if self.element == "wachspress":
            self._of_mesh(mesh.require_convex)
            most = int(np.diff(mesh.offsets).max()) // mesh.order
            if most > MOST_CORNERS:
                raise InputError(
                    f"{self.label}: a cell has {most} corners; Wachspress elements grow too soft beyond {MOST_CORNERS}, "
                    'use element="virtual" or a finer mesh'
                )

    @cached_property
    def placed(self) -> PolygonMesh:
        """The mesh rotated by `angle`; the mesh itself for angle 0, so that equal plates share their operator."""
        if self.angle == 0.0:
            return self.mesh
        c, s = np.cos(self.angle), np.sin(self.angle)
        cells = self.mesh.nodes, self.mesh.offsets, self.mesh.sections
        return PolygonMesh(self.mesh.points @ np.array([[c, s], [-s, c]]), *cells, order=self.mesh.order)

    @cached_property
    def points(self) -> np.ndarray:
        """Reference positions of the nodes in the scene, (N, 2), m."""
        return self.placed.points + np.asarray(self.origin, float)

    def section(self, selector: "str | Callable[[np.ndarray], np.ndarray] | ArrayLike") -> Attachment:
        """Return the mean of a section of the boundary: a name of the mesh, a function of its points, or node indices.

        Raises InputError if no node is selected.
        """
        return of_section(self, self._of_mesh(self.mesh.section, selector), selector if isinstance(selector, str) else "section")

    def rim(self, hole: int | str = 0) -> Attachment:
        """Return the rim of a hole of the mesh, by number or section name; its point is the hole's centre.

        The centre is that of the circle if the corners of the rim, four or more, lie on a circle, else the centroid of the hole's area.
        """
        return self.section(f"hole {hole}" if isinstance(hole, (int, np.integer)) else hole)

    def node(self, where: "int | ArrayLike") -> Attachment:
        """Return one node by its index, or the node nearest to a point (x, y) of the mesh, m.

        A joint at one node does not converge under mesh refinement (its compliance grows with the logarithm of the cell size): prefer a
        section.
        """
        if isinstance(where, (int, np.integer)):
            if not 0 <= where < self.mesh.n_nodes:
                raise InputError(f"{self.label}: node {where} does not exist, the mesh has nodes 0 to {self.mesh.n_nodes - 1}")
            return of_node(self, int(where))
        point = vector2(self.label, "node", where)
        return of_node(self, int(np.argmin(((self.mesh.points - point) ** 2).sum(axis=1))))

    def _of_mesh(self, function, *arguments):
        """Return `function(*arguments)` of the mesh; the message of its InputError then names the plate."""
        try:
            return function(*arguments)
        except InputError as error:
            raise InputError(f"{self.label}: {error}") from None
