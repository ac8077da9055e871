"""A plate taken as rigid."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from polyida.body.field_body import FieldBody, moments_of, rigid_fields
from polyida.body.plate import Plate
from polyida.body.rigid_body import stays_rigid
from polyida.joint.formula import Row, Vector
from polyida.keywords import named_keywords


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
