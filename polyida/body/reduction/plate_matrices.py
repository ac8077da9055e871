"""Mass and stiffness of one plate at rest, and what holds it, as sparse matrices."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from polyida.element import kernels
from polyida.element import stabilisation as virtual
from polyida.element.choose import operator_of, stabilisation_factor


@dataclass(frozen=True, eq=False)
class PlateMatrices:
    """Of a plate: its operator, M (N, N) of one direction, kg, and K (2N, 2N), N/m, on (x, y) node by node."""

    plate: Any
    operator: Any

    @classmethod
    def of(cls, plate):
        """Those of a plate."""
        return cls(plate, operator_of(plate))

    @property
    def c1(self):
        """`t E / (1 - nu^2)`, N/m, and the ratio, in the plane."""
        modulus, nu = self.plate.material.in_plane
        return self.plate.thickness * modulus / (1 - nu**2), nu

    @cached_property
    def mass(self):
        """M, (N, N) sparse."""
        from scipy.sparse import csr_array

        o = self.operator
        density = self.plate.material.rho * self.plate.thickness
        return csr_array((o.mass * density, o.indices, o.indptr), shape=(o.n_nodes,) * 2)

    @cached_property
    def stabilisation(self):
        """The stabilisation of one direction, (N, N) sparse, N/m, or None."""
        from scipy.sparse import csr_array

        o = self.operator
        factor = stabilisation_factor(self.plate, o)
        return csr_array((o.stabilisation * factor, o.indices, o.indptr), shape=(o.n_nodes,) * 2) if factor else None

    @cached_property
    def stiffness(self):
        """K at rest, (2N, 2N) sparse."""
        from scipy.sparse import bsr_array, eye_array, kron

        o = self.operator
        blocks = np.zeros((len(o.indices), 2, 2))
        kernels.tangent(o.layout, o.corners, o.gradients, o.weights, o.pairs, 0, 0, *self.c1, np.zeros((o.n_nodes, 2)), 1.0, blocks)
        K = bsr_array((blocks, o.indices, o.indptr), shape=(2 * o.n_nodes,) * 2).tocsc()
        return K if self.stabilisation is None else (K + kron(self.stabilisation, eye_array(2))).tocsc()

    def force(self, moved):
        """Internal force (N, 2), N, at displacements (N, 2), m."""
        o, f = self.operator, np.zeros_like(moved)
        kernels.internal_force(*o.force_arrays, 0, *self.c1, np.ascontiguousarray(moved), f, np.empty((0, 2)))
        if self.stabilisation is not None:
            virtual.force(o.indptr, o.indices, o.stabilisation, stabilisation_factor(self.plate, o), 0, np.ascontiguousarray(moved), f)
        return f


def rows_of(plate, sides):
    """What the attachments to nodes hold of a plate at rest, (rows, 2N) dense: mean x, mean y and, where they have a direction, rotation;
    and how these directions grow longer, which nothing holds.
    """
    n = plate.mesh.n_nodes
    held, longer = [np.zeros((0, 2 * n))], [np.zeros((0, 2 * n))]
    for side in {(side.nodes.tobytes(), side.weights.tobytes()): side for side in sides}.values():
        held += [_row(n, side.nodes, side.weights, *way) for way in ((1.0, 0.0), (0.0, 1.0))]
        if side.turn_weights is not None:
            x, y = side.direction
            held.append(_row(n, side.nodes, side.turn_weights, -y, x))
            longer.append(_row(n, side.nodes, side.turn_weights, x, y))
    return np.concatenate(held), np.concatenate(longer)


def _row(n, nodes, weights, x, y):
    row = np.zeros((1, n, 2))
    row[0, nodes, 0], row[0, nodes, 1] = x * weights, y * weights
    return row.reshape(1, -1)
