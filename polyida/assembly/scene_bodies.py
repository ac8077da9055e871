"""The bodies of a scene together: their mass, and how they are drawn."""

from functools import cached_property

import numpy as np

from polyida.assembly.arrays import concatenated
from polyida.assembly.bodies.places import PlacedPlate
from polyida.assembly.constraints import Constraints
from polyida.body.body import points_of
from polyida.element import kernels
from polyida.given import complex_of_pairs, on_pairs, pairs_of
from polyida.linear.lu import LU


class SceneBodies(Constraints):
    """M of a scene with `bodies`, `few`, `arrays`, `pattern`, and `uneven_mass` where x and y of pairs carry different ones; what is drawn.

    The even mass is Hermitian on the pairs of q as complex numbers, constant, and factored once.
    """

    def mass(self, q=None):
        """Mass matrix, constant, (n, n) sparse."""
        return self._mass

    @cached_property
    def _mass(self):
        even = on_pairs(self._even_mass).tocsc()
        return even if self.uneven_mass is None else even + self.uneven_mass

    @cached_property
    def _even_mass(self):
        """The mass that x and y of pairs carry alike, Hermitian, (pairs, pairs); real where it can be."""
        from scipy.sparse import csr_array, diags_array

        (indptr, indices), s = self.pattern, self.arrays
        values = [body.operator.mass * density for body, density in zip(self.bodies, s.plates.body_density)]
        values = np.concatenate([concatenated(values, float), s.compact.mass @ (1, 1j)])
        weights = self.point_weights
        mass = csr_array((values, indices, indptr), shape=(self.n_nodes, self.n_nodes))
        mass = (mass + weights.conj().T @ diags_array(s.links.point_mass) @ weights).tocsc()
        if not mass.data.imag.any():
            mass.data = mass.data.real.copy()
        return mass

    def mass_inverse(self, b):
        """M^-1 b, b (n,) or (n, k), of a `solid` scene; M is factored once."""
        pairs = b.reshape(self.n_nodes, 2, -1)
        if np.isrealobj(self._even_mass.data):
            return self._mass_factor.solve(np.ascontiguousarray(pairs.reshape(self.n_nodes, -1))).reshape(b.shape)
        found = self._mass_factor.solve(pairs[:, 0] + 1j * pairs[:, 1])
        return np.stack([found.real, found.imag], axis=1).reshape(b.shape)

    @cached_property
    def _mass_factor(self):
        return LU(self._even_mass)

    @cached_property
    def translation(self):
        """By how much each pair of q moves where all bodies move by one, (pairs,), complex."""
        return np.concatenate([np.zeros(0, complex), *(placed.translation for placed in (*self.bodies, *self.few))])

    @property
    def lightest(self):
        """Mass of its lightest body, kg."""
        return min(placed.whole_mass for placed in (*self.bodies, *self.few))

    def momenta(self, q, v):
        """(px, py, L): momentum, N s, and angular momentum about the origin, N m s: `p = T^H M z'` and `L = Im(z^H M z')`.

        z are the pairs of all bodies as points of the complex plane, masses at points included.
        """
        z, momentum = (complex_of_pairs(x.reshape(-1, 2)) for x in (self.reference.ravel() + q, self._mass @ v))
        p = np.vdot(self.translation, momentum)
        return np.array([p.real, p.imag, np.vdot(z, momentum).imag])

    @cached_property
    def drawn(self):
        """Every body that has a mesh, full plates first; `nodes` is its slice of the nodes that are drawn."""
        return [*self.bodies, *(plate for plate, _ in self._of_fields)]

    @cached_property
    def _of_fields(self):
        """(PlacedPlate, PlacedBody) of those that have few coordinates."""
        found, first = [], self.bodies[-1].nodes.stop if self.bodies else 0
        for placed in self.few:
            if (plate := placed.body.plate) is not None:
                found.append((PlacedPlate(placed.name, plate, placed.body.operator, slice(first, first + plate.mesh.n_nodes)), placed))
                first = found[-1][0].nodes.stop
        return found

    @cached_property
    def drawn_points(self):
        """Reference positions of the nodes that are drawn, (nodes, 2), m."""
        return np.concatenate([np.zeros((0, 2)), *(body.points for body in self.drawn)])

    def nodal(self, q):
        """Displacements of the nodes that are drawn, (nodes, 2), m, or, of a v, their velocities."""
        pairs = self._nodal(q)
        parts = [pairs[body.nodes] for body in self.bodies]
        parts += [placed.body.nodal(pairs[placed.pairs] @ (1, 1j)) for _, placed in self._of_fields]
        return np.concatenate([np.zeros((0, 2)), *parts])

    def of_nodal(self, forces):
        """What forces (nodes, 2) on the nodes that are drawn do to each coordinate, (n,): the transpose of `nodal`."""
        found, forces = np.zeros(self.n_nodes, complex), complex_of_pairs(forces)
        for body in self.bodies:
            found[body.nodes] += forces[body.nodes]
        for plate, placed in self._of_fields:
            found[placed.pairs] += placed.body.shapes().conj().T @ forces[plate.nodes]
        return pairs_of(found).ravel()

    def sticks(self, q):
        """The bodies that have named points and no mesh, as segments between these, (segments, 2, 2), m: round about where there are more
        than two.
        """
        found, pairs = [np.zeros((0, 2, 2))], self._nodal(q)
        for placed in self.few:
            if placed.body.plate is None:
                z = placed.rest + complex_of_pairs(pairs[placed.pairs])
                points = np.array([placed.body.weights_of(point, "point") @ z for point in points_of(placed.body)])
                points = pairs_of(points[np.argsort(np.angle(points - points.mean()))])
                found.append(np.stack([points, np.roll(points, -1, axis=0)], axis=1)[: 1 if len(points) == 2 else None])
        return np.concatenate(found)

    def stress(self, q):
        """Cauchy stress of every element, (cells, 3): xx, yy, xy in Pa, plate after plate."""
        parts, nodal = [np.zeros((0, 3))], self.nodal(q)
        for body in self.drawn:
            modulus, nu = body.plate.material.in_plane
            out, operator = np.empty((body.mesh.n_cells, 3)), body.operator
            kernels.stress(
                *operator.force_arrays, operator.lane_cells, operator.areas, body.nodes.start, modulus / (1 - nu**2), nu, nodal, out
            )
            parts.append(out)
        return np.concatenate(parts)

    def stress_across(self, stress):
        """Stress zz across the plane, (cells,), Pa, from that of every element: nu (xx + yy) in plane strain, 0 in plane stress."""
        ratio = [body.plate.material.across for body in self.drawn]
        return np.repeat(ratio, [body.mesh.n_cells for body in self.drawn]) * (stress[:, 0] + stress[:, 1])


def deepest(bodies, u):
    """ "cell 3 of 'upper' at (x, y)": that of the least mean det F at displacements u (nodes, 2), and its centre at rest, m."""
    if not bodies:
        return "a body"
    found = []
    for body in bodies:
        operator = body.operator
        outer = u[body.nodes][operator.nodes][:, :, None] * operator.mean_gradients[:, None, :]
        gradient = np.eye(2) + np.add.reduceat(outer, operator.offsets[:-1])
        det = np.linalg.det(gradient)
        cell = int(np.argmin(det))
        found.append((det[cell], cell, body))
    _, cell, body = min(found, key=lambda entry: entry[0])
    x, y = body.points[body.mesh.cell(cell)].mean(axis=0)
    return f"cell {cell} of {body.name!r} at ({x:.6g}, {y:.6g})"
