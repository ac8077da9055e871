"""Point masses, rigid bodies, and the base class of bodies whose few coordinates move all nodes of a plate."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from polyida.body.body import Body, BodyPoint
from polyida.body.plate import Material, Plate
from polyida.element.choice import operator_of
from polyida.element.operator import ReferenceOperator
from polyida.errors import InputError
from polyida.fields import check, check_fields, pair
from polyida.joint.attachment import Attachment, require_attachment
from polyida.joint.formula import Row, Vector, dot
from polyida.mesh import PolygonMesh
from polyida.mesh.topology import area_moments
from polyida.validation import complex_of_pairs, labelled, named_keywords, number, pairs_of, positive, settle


@named_keywords
@dataclass(frozen=True, eq=False)
class PointMass:
    """A mass at the mean point x of an attachment: kinetic energy `m |x'|^2 / 2`, weight `m g`.

    Parameters
    ----------
    at : Attachment
    mass : float, kg, > 0
    name : str, optional

    Raises
    ------
    InputError
        For an `at` that is no attachment of a body, or a mass that is not positive.
    """

    at: Attachment
    mass: float = field(metadata=check(positive, "kilograms"))
    name: str | None = None

    def __post_init__(self):
        """Check that `at` is an attachment, and the other fields. Raises InputError."""
        label = labelled("PointMass", self.name)
        require_attachment(label, self.at)
        check_fields(self, label)


@named_keywords
@dataclass(frozen=True, eq=False)
class RigidBody(Body):
    """A rigid body: each point X moves as `x = c + z (X - X_S) / s`, c the centre of mass, z / s the direction of the body.

    s is the radius of gyration `sqrt(inertia / mass)`, m, so that c and z have the same unit and the same mass. q holds the displacements
    of c and z, m; M = mass times the identity is constant, and `phi = (|z|^2 - s^2) / (2 s)` (1 row, m) keeps |z| = s: there are no
    gyroscopic terms. `body.at(name)` is a point, by default with the body's x axis as its direction.

    Parameters
    ----------
    mass : float, kg, > 0
    inertia : float, kg m2, > 0
        About the centre of mass.
    points : dict of name to (x, y), m
        In the body's own axes; at least one.
    origin : (2,) float, m
        Position of the body's own (0, 0).
    angle : float, rad
        Rotation of the body's axes about the origin.
    center : (2,) float, m
        Centre of mass in the body's own axes.
    velocity : (2,) float, m/s
        Of the centre of mass at the start.
    spin : float, rad/s
        At the start.
    name : str, optional

    Raises
    ------
    InputError
        For a mass or inertia that is not positive, wrong points or other wrong values.
    """

    mass: float = field(metadata=check(positive, "kilograms"))
    inertia: float = field(metadata=check(positive, "kg m2"))
    points: Mapping
    origin: tuple = field(default=(0.0, 0.0), metadata=check(pair))
    angle: float = field(default=0.0, metadata=check(number, "rad"))
    center: tuple = field(default=(0.0, 0.0), metadata=check(pair))
    velocity: tuple = field(default=(0.0, 0.0), metadata=check(pair))
    spin: float = field(default=0.0, metadata=check(number, "rad/s"))
    name: str | None = None

    def __post_init__(self):
        """Check the fields and the points."""
        label = self.label
        check_fields(self, label)
        if not isinstance(self.points, Mapping) or not self.points or not all(isinstance(name, str) and name for name in self.points):
            raise InputError(f"{label}: points = {str(self.points)[:80]} must be a dictionary {{name: (x, y)}}, with one point at least")
        settle(self, points={name: pair(label, f"point {name!r}", at) for name, at in self.points.items()})

    @classmethod
    def bar(
        cls,
        length: float,
        mass: float,
        origin: "ArrayLike" = (0.0, 0.0),
        angle: float = 0.0,
        velocity: "ArrayLike" = (0.0, 0.0),
        spin: float = 0.0,
        name: str | None = None,
    ) -> "RigidBody":
        """Return a slender bar (length, m; mass, kg) along its x axis, with the points "left" (its origin), "center" and "right"."""
        label = labelled(cls.__name__, name)
        length, mass = positive(label, "length", length, "metres"), positive(label, "mass", mass, "kilograms")
        points = {"left": (0.0, 0.0), "center": (length / 2, 0.0), "right": (length, 0.0)}
        pose: dict[str, Any] = {"origin": origin, "angle": angle, "velocity": velocity, "spin": spin, "name": name}
        return cls(mass, mass * length * length / 12, points, center=points["center"], **pose)

    @classmethod
    def from_mesh(
        cls,
        mesh: PolygonMesh,
        material: Material,
        thickness: float,
        points: Mapping | None = None,
        origin: "ArrayLike" = (0.0, 0.0),
        angle: float = 0.0,
        velocity: "ArrayLike" = (0.0, 0.0),
        spin: float = 0.0,
        name: str | None = None,
    ) -> "RigidBody":
        """Return a body of a mesh's shape: mass, centre and inertia by exact integrals over its polygons.

        points: in addition to "center" and the mean point of each section of the mesh.
        """
        label = labelled(cls.__name__, name)
        if not isinstance(mesh, PolygonMesh) or not isinstance(material, Material):
            raise InputError(f"{label}: from_mesh takes a polyida mesh and a polyida.Material, not {mesh!r:.60} and {material!r:.60}")
        if not (points is None or isinstance(points, Mapping)):
            raise InputError(f"{label}: points = {str(points)[:80]} must be a dictionary {{name: (x, y)}}")
        area, centre, second = area_moments(mesh)
        density = material.rho * positive(label, "thickness", thickness, "metres")
        sections = {name: mesh.section(name) for name in mesh.sections}
        known = {name: tuple((s.weights @ mesh.points[s.nodes]).tolist()) for name, s in sections.items()}
        known["center"] = tuple(centre.tolist())
        pose: dict[str, Any] = {"origin": origin, "angle": angle, "velocity": velocity, "spin": spin, "name": name}
        return cls(density * area, density * second, {**known, **(points or {})}, center=known["center"], **pose)

    @property
    def gyration(self) -> float:
        """Radius of gyration s, m."""
        return float(np.sqrt(self.inertia / self.mass))

    def coordinates(self) -> list[complex]:
        """(c, z) in the reference configuration, m."""
        turn = np.exp(1j * self.angle)
        return [complex(*self.origin) + turn * complex(*self.center), self.gyration * turn]

    def mass_matrix(self) -> np.ndarray:
        """The mass matrix diag(mass, mass) of (c, z), kg."""
        return np.diag([self.mass, self.mass])

    def attachments(self) -> "dict[str, ArrayLike]":
        """{name: weights [1, (X - X_S) / s]} of the named points on the pairs (c, z), complex.

        X: the point, X_S: the centre of mass, both complex in the axes of the drawing; s: the radius of gyration, m. The place is
        `x = c + z (X - X_S) / s`.
        """
        return {name: [1.0, (complex(*at) - complex(*self.center)) / self.gyration] for name, at in self.points.items()}

    def x_axis(self) -> list[float]:
        """Weights (2,) of the pairs for the body's x axis, a unit vector: z / s."""
        return [0.0, 1.0 / self.gyration]

    def rows(self) -> list[Row | Vector]:
        """The row `(|z|^2 - s^2) / (2 s)`, m, which keeps the length of z constant."""
        return [constant_length(self)]


def constant_length(body):
    """The row `(|z|^2 - s^2) / (2 s)` of a body with the x axis z / s."""
    d = body.point_of("z", np.stack([np.zeros(2), body.x_axis()])).d
    return ((dot(d, d) - 1.0) * (0.5 * body.gyration)).named("length", "N")


class FieldBody(Body, part=False):
    """A plate that moves as `x = sum z_k f_k` with few complex fields f_k over its nodes: 1, (X - X_S) / s, and those of a subclass.

    s is the radius of gyration, so that all z_k are lengths, m. Sections, rims and nodes are those of the plate.
    """

    plate: Plate

    def __post_init__(self):
        """Check the fields; the default name is that of the plate."""
        if not isinstance(self.plate, Plate):
            raise InputError(f"{self.label}: {str(self.plate)[:80]} is no plate; give a polyida.Plate")
        if self.name is None:
            settle(self, name=self.plate.name)
        check_fields(self, self.label)

    @property
    def mesh(self) -> PolygonMesh:
        """The mesh of the plate, in its own axes."""
        return self.plate.mesh

    @property
    def placed(self) -> PolygonMesh:
        """The plate's mesh rotated by its angle."""
        return self.plate.placed

    @property
    def points(self) -> np.ndarray:
        """Reference positions of the plate's nodes, (N, 2), m."""
        return self.plate.points

    @property
    def thickness(self) -> float:
        """Thickness of the body's plate, m."""
        return self.plate.thickness

    @cached_property
    def operator(self) -> ReferenceOperator:
        """ReferenceOperator of the plate: the element's matrices on its mesh."""
        return operator_of(self.plate)

    @cached_property
    def _moments(self):
        """(mass, kg; centre of mass in the scene, (2,), m; radius of gyration, m) of the plate, by exact area integrals."""
        area, centre, second = area_moments(self.plate.placed)
        return area * self.plate.material.rho * self.plate.thickness, centre + self.plate.origin, float(np.sqrt(second / area))

    def require(self) -> None:
        """Do nothing: the constructor has checked the values."""

    def section(self, selector: "str | Callable[[np.ndarray], np.ndarray] | ArrayLike") -> Attachment:
        """Return the mean of a section of the plate's boundary: a name of the mesh, a function of its points, or node indices."""
        return replace(self.plate.section(selector), body=self)

    def rim(self, hole: int | str = 0) -> Attachment:
        """Return the rim of a hole of the plate's mesh, by number or section name; its point is the hole's centre."""
        return replace(self.plate.rim(hole), body=self)

    def node(self, where: "int | ArrayLike") -> Attachment:
        """Return the attachment of one node of the plate, by its index or nearest to a point (x, y) of the mesh, m."""
        return replace(self.plate.node(where), body=self)

    @cached_property
    def _rigid_shapes(self):
        """The fields of a rigid motion at the nodes: 1 and (X - X_S) / s, (N, 2), complex."""
        _, centre, gyration = self._moments
        arms = complex_of_pairs(self.plate.points - centre)
        return np.stack([np.ones(len(arms)), arms / gyration], axis=1)

    def shapes(self) -> np.ndarray:
        """Return f_k at the nodes, (N, pairs), complex."""
        return self._rigid_shapes

    def nodal(self, moved: np.ndarray) -> np.ndarray:
        """Return the displacements (N, 2), m, of the nodes for displacements of the pairs, complex; velocities for velocities."""
        return pairs_of(self.shapes() @ moved)

    def weights_of(self, side: Attachment, part: str) -> np.ndarray:
        """Return the weights (pairs,), complex, of an attachment's "point" or "direction"."""
        weights = super().weights_of(side, part)
        return weights if isinstance(side, BodyPoint) else weights @ self.shapes()[side.nodes]

    def pair_forces(self, side: Attachment, forces: np.ndarray) -> np.ndarray:
        """Return `f_k^H forces`, (pairs,), for complex forces on the nodes of an attachment."""
        return self.shapes()[side.nodes].conj().T @ forces

    @property
    def gyration(self) -> float:
        """Radius of gyration s, m."""
        return self._moments[2]

    def coordinates(self) -> np.ndarray:
        """The pairs in the reference configuration, complex, m: (X_S, s, 0, 0, ...)."""
        rest = np.zeros(self.shapes().shape[1], complex)
        rest[:2] = complex(*self._moments[1]), self.gyration
        return rest

    def attachments(self) -> "dict[str, ArrayLike]":
        """Weights of the named points on the pairs: the centre of mass alone; parts use sections, rims and nodes."""
        return {"center": np.eye(self.shapes().shape[1])[0]}

    def x_axis(self) -> np.ndarray:
        """Weights (2,) of the pairs for the body's x axis, a unit vector: z / s."""
        return np.eye(self.shapes().shape[1])[1] / self.gyration


@named_keywords
@dataclass(frozen=True, eq=False)
class Rigid(FieldBody):
    """A plate that does not deform: a rigid body of its exact mass and radius of gyration s, `x = c + z (X - X_S) / s`, |z| = s (n = 4).

    Attachments, loads and pictures are those of the plate; its stress is zero. Of the material's damping only mass_damping acts.

    Parameters
    ----------
    plate : Plate
    name : str, optional
        Default: the plate's name.

    Raises
    ------
    InputError
        If `plate` is no Plate.
    """

    plate: Plate = field()  # required, although Body has the attribute
    name: str | None = None
    turns_only = True

    def mass_matrix(self) -> np.ndarray:
        """The mass matrix diag(mass, mass), kg, of the pairs (c, z), by exact area integrals."""
        return self._moments[0] * np.eye(2)

    def damping(self) -> tuple[float, float]:
        """Rayleigh mass coefficient of the material, 1/s, and 0."""
        return self.plate.material.mass_damping, 0.0

    def rows(self) -> list[Row | Vector]:
        """The row `(|z|^2 - s^2) / (2 s)`, m, which keeps the length of z constant."""
        return [constant_length(self)]
