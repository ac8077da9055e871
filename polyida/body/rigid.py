"""A plate taken as rigid."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from polyida.body.field_body import FieldBody, rigid_fields
from polyida.body.plate import Plate
from polyida.joint.formula import Row, Vector, dot
from polyida.keywords import named_keywords
from polyida.mesh.moments import area_moments


@named_keywords
@dataclass(frozen=True, eq=False)
class Rigid(FieldBody):
    """A plate that does not deform: `x = c + z (X - X_S)`, |z| = 1, as a RigidBody of its exact mass and inertia (n = 4).

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
        """1 and X - X_S at the nodes, (N, 2), complex."""
        return self._shapes

    def mass_matrix(self) -> NDArray:
        """diag(mass, inertia), by exact area integrals."""
        area, _, second = area_moments(self.plate.placed)
        return np.diag([area, second]) * (self.plate.material.rho * self.plate.thickness)

    def damping(self) -> tuple[float, float]:
        """The material's drag."""
        return self.plate.material.mass_damping, 0.0

    def rows(self) -> list[Row | Vector]:
        """`s (|z|^2 - 1) / 2`, s the radius of gyration."""
        z, (mass, inertia) = self.point_of("z", np.eye(2)).d, np.diag(self.mass_matrix())
        return [((dot(z, z) - 1.0) * (0.5 * np.sqrt(inertia / mass))).named("length", "N")]
