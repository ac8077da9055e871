"""Point masses, and rigid bodies in two complex coordinates: by mass and inertia, or plates taken as rigid."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polyida.body.body import Body
from polyida.body.field_body import FieldBody, moments_of, rigid_fields
from polyida.body.plate import Material, Plate
from polyida.errors import InputError
from polyida.joint.attachment import Attachment, labelled, require_attachment
from polyida.joint.formula import Row, Vector, dot
from polyida.mesh import PolygonMesh
from polyida.mesh.topology import area_moments
from polyida.validation import named_keywords, number, positive, settle, vector2


@named_keywords
@dataclass(frozen=True, eq=False)
class PointMass:
    """A mass (kg, > 0) at the mean point x of an attachment: kinetic energy `m |x'|^2 / 2`, weight `m g`."""

    at: Attachment
    mass: float
    name: str | None = None

    def __post_init__(self):
        label = labelled("PointMass", self.name)
        require_attachment(label, self.at)
        settle(self, mass=positive(label, "mass", self.mass, "kilograms"))


@named_keywords
@dataclass(frozen=True, eq=False)
class RigidBody(Body):
    """A rigid body: `x = c + z (X - X_S) / s` for each of its points X, c the place of its centre of mass X_S, z / s its direction, s the
    radius of gyration `sqrt(inertia / mass)`, m, in which z is measured, so that all coordinates are alike.

    mass: kg. inertia: about the centre of mass, kg m2. points: {name: (x, y)}, m, in the body's own axes. origin: where the own (0, 0)
    lies, m. angle: turn of its axes about it, rad. center: the centre of mass in its own axes, m. velocity of the centre of mass, m/s, and
    spin, rad/s: at the start.

    q holds the displacements of c and z from rest, m; M = mass times the identity is constant, and `phi = (|z|^2 - s^2) / (2 s)` (1 row, m)
    keeps z of its length, so that there are no gyroscopic terms. `body.at(name)` is a point, with the body's x axis as its direction or the
    one that is given. Raises InputError for a mass or inertia that is not positive, and for what is no point.
    """

    mass: float
    inertia: float
    points: Mapping
    origin: tuple = (0.0, 0.0)
    angle: float = 0.0
    center: tuple = (0.0, 0.0)
    velocity: tuple = (0.0, 0.0)
    spin: float = 0.0
    name: str | None = None

    def __post_init__(self):
        settle(
            self, mass=positive(self.label, "mass", self.mass, "kilograms"), inertia=positive(self.label, "inertia", self.inertia, "kg m2")
        )
        for key in ("origin", "center", "velocity"):
            settle(self, **{key: tuple(vector2(self.label, key, getattr(self, key)).tolist())})
        for key, unit in (("angle", "rad"), ("spin", "rad/s")):
            settle(self, **{key: number(self.label, key, getattr(self, key), unit)})
        if not isinstance(self.points, Mapping) or not self.points or not all(isinstance(name, str) and name for name in self.points):
            raise InputError(
                f"{self.label}: points = {str(self.points)[:80]} must be a dictionary {{name: (x, y)}}, with one point at least"
            )
        settle(self, points={name: tuple(vector2(self.label, f"point {name!r}", at).tolist()) for name, at in self.points.items()})

    @classmethod
    def bar(
        cls,
        length: float,
        mass: float,
        origin: ArrayLike = (0.0, 0.0),
        angle: float = 0.0,
        velocity: ArrayLike = (0.0, 0.0),
        spin: float = 0.0,
        name: str | None = None,
    ) -> "RigidBody":
        """A slender bar along its x axis from its origin: points "left", "center", "right", inertia m l^2 / 12."""
        given = labelled(cls.__name__, name)
        length, mass = positive(given, "length", length, "metres"), positive(given, "mass", mass, "kilograms")
        points = {"left": (0.0, 0.0), "center": (length / 2, 0.0), "right": (length, 0.0)}
        pose: dict[str, Any] = {"origin": origin, "angle": angle, "velocity": velocity, "spin": spin, "name": name}
        return cls(mass, mass * length**2 / 12, points, center=points["center"], **pose)

    @classmethod
    def from_mesh(
        cls,
        mesh: PolygonMesh,
        material: Material,
        thickness: float,
        points: Mapping | None = None,
        origin: ArrayLike = (0.0, 0.0),
        angle: float = 0.0,
        velocity: ArrayLike = (0.0, 0.0),
        spin: float = 0.0,
        name: str | None = None,
    ) -> "RigidBody":
        """A body of a mesh's shape: mass, centre and inertia by exact integrals over its polygons; points: further ones beside "center"
        and the mean point of each section of the mesh.
        """
        given = labelled(cls.__name__, name)
        if not isinstance(mesh, PolygonMesh) or not isinstance(material, Material):
            raise InputError(f"{given}: from_mesh takes a polyida mesh and a polyida.Material, not {mesh!r:.60} and {material!r:.60}")
        if not (points is None or isinstance(points, Mapping)):
            raise InputError(f"{given}: points = {str(points)[:80]} must be a dictionary {{name: (x, y)}}")
        area, centre, second = area_moments(mesh)
        density = material.rho * positive(given, "thickness", thickness, "metres")
        known = {section: _mean(mesh, section) for section in mesh.sections} | {"center": tuple(centre.tolist())}
        pose: dict[str, Any] = {"origin": origin, "angle": angle, "velocity": velocity, "spin": spin, "name": name}
        return cls(density * area, density * second, {**known, **(points or {})}, center=known["center"], **pose)

    @property
    def gyration(self) -> float:
        """The radius of gyration s, m."""
        return float(np.sqrt(self.inertia / self.mass))

    def coordinates(self) -> list[complex]:
        """(c, z) at rest, m."""
        turn = np.exp(1j * self.angle)
        return [complex(*self.origin) + turn * complex(*self.center), self.gyration * turn]

    def mass_matrix(self) -> NDArray:
        """diag(mass, mass), the second for the turn."""
        return np.diag([self.mass, self.mass])

    def attachments(self) -> dict[str, ArrayLike]:
        """{name: (1, (X - X_S) / s)}."""
        return {name: [1.0, (complex(*at) - complex(*self.center)) / self.gyration] for name, at in self.points.items()}

    def x_axis(self) -> list[float]:
        """z / s."""
        return [0.0, 1.0 / self.gyration]

    def rows(self) -> list[Row | Vector]:
        """`(|z|^2 - s^2) / (2 s)`."""
        return [stays_rigid(self, self.gyration)]


def stays_rigid(body, gyration):
    """`(|z|^2 - s^2) / (2 s)`, a Row, of the vector z = s d that turns with a body."""
    d = body.point_of("z", np.stack([np.zeros(2), body.x_axis()])).d
    return ((dot(d, d) - 1.0) * (0.5 * gyration)).named("length", "N")


def _mean(mesh, section):
    """The mean point of a section of a mesh, the centre of a hole."""
    found = mesh.section(section)
    return tuple((found.weights @ mesh.points[found.nodes]).tolist())


@named_keywords
@dataclass(frozen=True, eq=False)
class Rigid(FieldBody):
    """A plate that does not deform: `x = c + z (X - X_S) / s`, |z| = s, as a RigidBody of its exact mass and radius of gyration s (n = 4).

    It is held, loaded and drawn as the plate; its stress is zero. Of a damped material it takes mass_damping. Raises InputError for what
    is no plate.
    """

    plate: Plate
    name: str | None = None
    turns_only = True

    def __post_init__(self):
        self.require_plate()

    @cached_property
    def _shapes(self):
        return rigid_fields(self.plate)

    def shapes(self) -> NDArray:
        """1 and (X - X_S) / s at the nodes, (N, 2), complex."""
        return self._shapes

    def mass_matrix(self) -> NDArray:
        """diag(mass, mass), by exact area integrals, the second for the turn."""
        return moments_of(self.plate)[0] * np.eye(2)

    def damping(self) -> tuple[float, float]:
        """The material's drag."""
        return self.plate.material.mass_damping, 0.0

    def rows(self) -> list[Row | Vector]:
        """`(|z|^2 - s^2) / (2 s)`."""
        return [stays_rigid(self, self.gyration)]
