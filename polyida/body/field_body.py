"""Bodies whose few coordinates move every node of a plate: `x = sum z_k f_k`, f_k complex fields over its nodes."""

from collections.abc import Callable
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polyida.body.body import Body, BodyPoint
from polyida.body.plate import Plate
from polyida.element.choose import operator_of
from polyida.element.operator import ReferenceOperator
from polyida.errors import InputError
from polyida.joint.attachment import Attachment
from polyida.mesh import PolygonMesh
from polyida.mesh.topology import area_moments
from polyida.validation import complex_of_pairs, pairs_of, settle


class FieldBody(Body, part=False):
    """A plate that moves in the complex span of few fields: 1, the places (X - X_S) / s from its centre of mass over the radius of
    gyration, and what a class adds: so z is a length, m, as all others.

    Sections, rims and nodes are held as those of the plate are.
    """

    plate: Plate

    @property
    def mesh(self) -> PolygonMesh:
        """The plate's mesh."""
        return self.plate.mesh

    @property
    def placed(self) -> PolygonMesh:
        """The plate's mesh, turned by its angle."""
        return self.plate.placed

    @property
    def points(self) -> NDArray:
        """Reference positions of the plate's nodes, (N, 2), m."""
        return self.plate.points

    @property
    def thickness(self) -> float:
        """The plate's thickness, m."""
        return self.plate.thickness

    @cached_property
    def operator(self) -> ReferenceOperator:
        """The reference operator of the plate's element on its mesh."""
        return operator_of(self.plate)

    def require(self) -> None:
        """Nothing: its constructor has looked at what was given."""

    def require_plate(self) -> None:
        """Raise InputError unless it has a Plate, and a name that is a text; take the plate's where it has none."""
        label = self.label
        if not isinstance(self.plate, Plate):
            raise InputError(f"{label}: {str(self.plate)[:80]} is no plate; give a polyida.Plate")
        if self.name is None:
            settle(self, name=self.plate.name)

    def section(self, selector: str | Callable[[NDArray], NDArray] | ArrayLike) -> Attachment:
        """The mean of a section of the boundary, as `Plate.section`."""
        return replace(self.plate.section(selector), body=self)

    def rim(self, hole: int | str = 0) -> Attachment:
        """The mean of the rim of a hole, as `Plate.rim`."""
        return replace(self.plate.rim(hole), body=self)

    def node(self, where: int | ArrayLike) -> Attachment:
        """One node, as `Plate.node`."""
        return replace(self.plate.node(where), body=self)

    def shapes(self) -> NDArray:
        """f_k at the nodes, (N, pairs), complex."""
        return rigid_fields(self.plate)

    def nodal(self, moved: NDArray) -> NDArray:
        """Displacements (N, 2), m, of the nodes from those of its pairs, complex; velocities from velocities."""
        return pairs_of(self.shapes() @ moved)

    def weights_of(self, side: Attachment, part: str) -> NDArray:
        """Weights (pairs,), complex, of which an attachment's "point" or "direction" is the sum."""
        if isinstance(side, BodyPoint):
            return super().weights_of(side, part)
        weights = side.weights if part == "point" else side.turn_weights
        return weights @ self.shapes()[side.nodes]

    def shares_of(self, side: Attachment, forces: NDArray) -> NDArray:
        """What of forces, complex, on the nodes of an attachment acts on each pair, (pairs,): `f_k^H forces`."""
        return self.shapes()[side.nodes].conj().T @ forces

    @property
    def gyration(self) -> float:
        """The radius of gyration s, m."""
        return moments_of(self.plate)[2]

    def coordinates(self) -> NDArray:
        """(X_S, s, 0, 0 ...), m."""
        rest = np.zeros(self.shapes().shape[1], complex)
        rest[:2] = complex(*moments_of(self.plate)[1]), self.gyration
        return rest

    def attachments(self) -> dict[str, ArrayLike]:
        """Its centre of mass alone: it is held by sections, rims and nodes."""
        return {"center": np.eye(self.shapes().shape[1])[0]}

    def x_axis(self) -> NDArray:
        """z / s."""
        return np.eye(self.shapes().shape[1])[1] / self.gyration


def moments_of(plate):
    """(mass, kg, centre of mass in the scene, (2,), m, radius of gyration, m) of a plate, by exact area integrals."""
    area, centre, second = area_moments(plate.placed)
    return area * plate.material.rho * plate.thickness, centre + plate.origin, float(np.sqrt(second / area))


def rigid_fields(plate):
    """1 and (X - X_S) / s at the nodes of a plate, (N, 2), complex."""
    _, centre, gyration = moments_of(plate)
    arms = complex_of_pairs(plate.points - centre)
    return np.stack([np.ones(len(arms)), arms / gyration], axis=1)
