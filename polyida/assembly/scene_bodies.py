"""The mass matrix of a scene's model, and its bodies as pictures and stresses show them: the nodes of all plates, full and reduced ones."""

from dataclasses import replace
from functools import cached_property

import numpy as np

from polyida.assembly.arrays import concatenated
from polyida.assembly.placement import PlacedPlate
from polyida.assembly.relaxation_slopes import fields_at_points, viscous_strain_at_points
from polyida.assembly.scene_constraints import Constraints
from polyida.body.body import points_of, sticks_between
from polyida.element import kernels
from polyida.element.operator import LISTED, Material
from polyida.element.quadratic import to_nodes
from polyida.element.relaxation import change_of_strain, relax_stress
from polyida.jit.intrinsics import LANES
from polyida.linear.lu import LU
from polyida.validation import complex_of_pairs, on_pairs, pairs_of


class SceneBodies(Constraints):
    """The mass matrix of a scene with `bodies`, `reduced_bodies`, `arrays`, `pattern` and `uneven_mass`, and its bodies as they are drawn.

    The even mass is Hermitian on the pairs of q as complex numbers, constant, and factored once.
    """

    def mass(self, q=None):
        """Mass matrix, constant, (n, n) sparse."""
        return self._mass

    @cached_property
    def _mass(self):
        """M, (n, n), CSC: the mass that is equal for x and y, and the uneven mass."""
        even = on_pairs(self._even_mass).tocsc()
        return even if self.uneven_mass is None else even + self.uneven_mass

    @cached_property
    def _even_mass(self):
        """The mass that is equal for x and y, Hermitian, (pairs, pairs); real if possible."""
        from scipy.sparse import csr_array, diags_array

        (indptr, indices), s = self.pattern, self.arrays
        values = [body.operator.mass * density for body, density in zip(self.bodies, s.plates.body_density)]
        values = [concatenated(values, float), s.reduced.mass @ (1, 1j)]
        for placed in self.strains.values():
            count = placed.pairs.stop - placed.pairs.start
            values.append(np.full(count, placed.mass))
            indptr = np.append(indptr, indptr[-1] + np.arange(1, count + 1, dtype=np.int32))
            indices = np.append(indices, np.arange(placed.pairs.start, placed.pairs.stop, dtype=np.int32))
        values, weights = np.concatenate(values), self.point_weights
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
        x = self._mass_factor.solve(pairs[:, 0] + 1j * pairs[:, 1])
        return np.stack([x.real, x.imag], axis=1).reshape(b.shape)

    @cached_property
    def _mass_factor(self):
        """The factor of the mass that is equal for x and y, (pairs, pairs), made once."""
        return LU(self._even_mass)

    @cached_property
    def translation(self):
        """Velocity of each pair of q if all bodies translate with unit velocity, (pairs,), complex."""
        placed = (*self.all_bodies, *self.states.values(), *self.strains.values())
        return np.concatenate([np.zeros(0, complex), *(one.translation for one in placed)])

    @property
    def lightest(self):
        """Mass of the lightest body, kg."""
        return min(placed.whole_mass for placed in self.all_bodies)

    def momenta(self, q, v):
        """(px, py, L): momentum, N s, and angular momentum about the origin, N m s: `p = T^H M z'` and `L = Im(z^H M z')`.

        z are the pairs of all bodies as points of the complex plane, masses at points included.
        """
        z, momentum = (complex_of_pairs(x.reshape(-1, 2)) for x in (self.reference.ravel() + q, self._mass @ self.without_states(v)))
        p = np.vdot(self.translation, momentum)
        return np.array([p.real, p.imag, np.vdot(z, momentum).imag])

    @cached_property
    def drawn(self):
        """All bodies with a mesh, full plates first; `nodes` is the slice of the drawn nodes."""
        return [*self.bodies, *(plate for plate, _ in self._meshed)]

    @cached_property
    def _meshed(self):
        """(PlacedPlate, PlacedBody) of the bodies of few coordinates with a mesh."""
        meshed, first = [], self.bodies[-1].nodes.stop if self.bodies else 0
        for placed in self.reduced_bodies:
            if (plate := placed.body.plate) is not None:
                meshed.append((PlacedPlate(placed.name, plate, placed.body.operator, slice(first, first + plate.mesh.n_nodes)), placed))
                first = meshed[-1][0].nodes.stop
        return meshed

    @cached_property
    def drawn_points(self):
        """Reference positions of the drawn nodes, (nodes, 2), m."""
        return np.concatenate([np.zeros((0, 2)), *(body.points for body in self.drawn)])

    def nodal(self, q):
        """Displacements of the drawn nodes, (nodes, 2), m; their velocities for q = v."""
        pairs = self._nodal(q)
        parts = [pairs[body.nodes] for body in self.bodies]
        parts += [placed.body.nodal(pairs[placed.pairs] @ (1, 1j)) for _, placed in self._meshed]
        return np.concatenate([np.zeros((0, 2)), *parts])

    def of_nodal(self, forces):
        """Generalised forces (n,) of forces (nodes, 2) on the drawn nodes: the transpose of `nodal`."""
        result, forces = np.zeros(self.n_nodes, complex), complex_of_pairs(forces)
        for body in self.bodies:
            result[body.nodes] += forces[body.nodes]
        for plate, placed in self._meshed:
            result[placed.pairs] += placed.body.shapes().conj().T @ forces[plate.nodes]
        return pairs_of(result).ravel()

    def sticks(self, q):
        """Bodies with named points and no mesh as segments between their points, in the order of angles, (segments, 2, 2), m."""
        segments, pairs = [np.zeros((0, 2, 2))], self._nodal(q)
        for placed in self.reduced_bodies:
            if placed.body.plate is None:
                z = placed.rest + complex_of_pairs(pairs[placed.pairs])
                points = np.array([placed.body.weights_of(point, "point") @ z for point in points_of(placed.body)])
                segments.append(sticks_between(pairs_of(points)))
        return np.concatenate(segments)

    def stress(self, q, v=None, at_points=False):
        """Cauchy stress of each element, (cells, 3): xx, yy, xy in Pa, plate after plate; without v no viscous or relaxed stress.

        at_points: of plates of order 2 three values for each cell, at its points.
        """
        parts, nodal, rates = [np.zeros((0, 3))], self.nodal(q), None if v is None else self.nodal(v)
        rigid = [plate.name for plate, placed in self._meshed if not placed.deforms]
        for body in self.drawn:
            operator = by_points(body.operator) if at_points and body.plate.order == 2 else body.operator
            if body.name in rigid:
                parts.append(np.zeros((len(operator.areas), 3)))
                continue
            modulus, nu = body.plate.material.in_plane
            parts.append(np.empty((len(operator.areas), 3)))
            cells, material = operator.cells(body.nodes.start), Material(modulus / (1 - nu**2), nu)
            kernels.stress(cells, operator.lane_cells, operator.areas, material, nodal, parts[-1])
            viscosity, relaxes = body.plate.material.viscosity, body.name in self.strains
            if v is not None and (viscosity or relaxes):
                viscous_strain = np.zeros(3 * len(operator.weights))
                change_of_strain(cells, nodal, rates, viscous_strain)
                viscous_strain *= -viscosity
                if relaxes:
                    relaxed, fields = (
                        self.strains[body.name].viscous_strain_of(v),
                        self.once(fields_at_points, of_shape=True).get(body.name),
                    )
                    viscous_strain += relaxed if fields is None else viscous_strain_at_points(fields, relaxed)
                relax_stress(cells, operator.lane_cells, operator.areas, material, nodal, viscous_strain, parts[-1])
        return np.concatenate(parts)


def by_points(operator):
    """The operator of which each point is a cell of its own: point p of cell i is cell `points i + p`."""
    layout, points = operator.layout, int(operator.layout[:, 1].max())
    size = 2 * (layout[:, 0] - 1) * LANES
    shift = np.zeros((len(layout), points, 2 + len(LISTED)), np.int64)
    number = np.arange(points)
    shift[..., 2 + LISTED.index("gradients")] = size[:, None] * number
    shift[..., 2 + LISTED.index("weights")] = LANES * number
    shift[..., 1] = 1 - points
    lanes = points * operator.lane_cells.reshape(-1, 1, LANES) + number[:, None]
    return replace(
        operator,
        layout=(layout[:, None] + shift).reshape(-1, layout.shape[1]),
        lane_cells=lanes.astype(np.int32).ravel(),
        areas=np.repeat(operator.areas / points, points),
    )


def nodal_stress(model, q, v=None):
    """Stress at the nodes of all plates, (nodes, 3), Pa: means over their cells, weighted by areas; of order 2 after extrapolation from the points."""
    values, first, result = model.stress(q, v, at_points=True), 0, [np.zeros((0, 3))]
    for body in model.drawn:
        mesh, points = body.mesh, 3 if body.plate.order == 2 else 1
        own = values[first : first + points * mesh.n_cells].reshape(-1, points, 3)
        first += points * mesh.n_cells
        sums = np.zeros((mesh.n_nodes, 4))
        for n in np.unique(np.diff(mesh.offsets)).tolist():
            cells = np.flatnonzero(np.diff(mesh.offsets) == n)
            nodes = mesh.nodes[mesh.offsets[cells][:, None] + np.arange(n)]
            weights = to_nodes(mesh.points[nodes].transpose(1, 2, 0)).transpose(2, 0, 1) if points > 1 else np.ones((len(cells), n, 1))
            areas = np.broadcast_to(mesh.cell_areas[cells, None, None], (*nodes.shape, 1))
            np.add.at(sums, nodes, areas * np.concatenate([weights @ own[cells], np.ones_like(areas)], axis=2))
        result.append(sums[:, :3] / sums[:, 3:])
    return np.concatenate(result)


def deepest(bodies, u):
    """ "cell 3 of 'upper' at (x, y)": the cell of the least mean det F at displacements u (nodes, 2), and its centre in the reference configuration, m."""
    cells = []
    for body in bodies:
        operator = body.operator
        outer = u[body.nodes][operator.nodes][:, :, None] * operator.mean_gradients[:, None, :]
        det = np.linalg.det(np.eye(2) + np.add.reduceat(outer, operator.offsets[:-1]))
        cells.append((det.min(), int(np.argmin(det)), body))
    if not cells:
        return "a body"
    _, cell, body = min(cells, key=lambda entry: entry[0])
    x, y = body.points[body.mesh.cell(cell)].mean(axis=0)
    return f"cell {cell} of {body.name!r} at ({x:.6g}, {y:.6g})"


def inverse_masses(model):
    """The inverse masses of the bodies of a scene without plates."""
    each = [model._even_mass[placed.pairs, placed.pairs].toarray() for placed in (*model.reduced_bodies, *model.states.values())]
    flat = np.concatenate([np.linalg.inv(mass).ravel() for mass in each])
    return model.arrays.reduced._replace(mass=np.stack([flat.real, flat.imag], axis=1))
