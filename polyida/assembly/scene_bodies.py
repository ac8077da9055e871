"""The constraints of a scene from compiled kernels, its points by name, its mass matrix, and its bodies as they are drawn."""

from dataclasses import replace
from functools import cached_property

import numpy as np

from polyida.assembly import joints
from polyida.assembly.arrays import concatenated
from polyida.assembly.own_laws import with_callbacks
from polyida.assembly.placement import PlacedPlate
from polyida.assembly.relaxation import fields_at_points, viscous_strain_at_points
from polyida.body.body import points_of, sticks_between
from polyida.element import kernels
from polyida.element.operator import LISTED, Material
from polyida.element.quadratic import to_nodes
from polyida.element.relaxation import change_of_strain, relax_stress
from polyida.errors import InputError
from polyida.jit.intrinsics import LANES
from polyida.joint.attachment import Attachment
from polyida.joint.edges import links_at
from polyida.joint.formula import rest_of
from polyida.joint.joint import Joint, Reaction
from polyida.linear.lu import LU
from polyida.model import Model
from polyida.validation import complex_of_pairs, on_pairs, pairs_of


class Constraints(Model):
    """`phi(t, q)` of a scene and its derivatives: `phi = rows(A q)`, A the weights of the points.

    It needs `parts`, `joints` and `places` of the bodies, `arrays` of the kernels, `profiles`, `labels` and `rows` of phi, `edge_rows`,
    `needs`, n, m, n_nodes and n_points.
    """

    def altered(self, without=(), **attributes):
        """A copy with these attributes in place of its own, without those named in `without`."""
        other = object.__new__(type(self))
        other.__dict__.update({name: value for name, value in vars(self).items() if name not in without}, **attributes)
        return other

    def drives(self, t):
        """Value, first and second derivative of each profile at time t, (profiles, 3)."""
        at, table = self._driven
        if at != t:
            table = np.array([profile.at(t) for profile in self.profiles], float).reshape(-1, 3)
            self._driven = t, table
        return table.copy()

    def pushed(self, t, number, by):
        """This model with the value of profile `number` at time t increased by `by`, its rates unchanged."""
        table = self.drives(t)
        table[number, 0] += by
        forces = tuple(own.pushed(self.profiles[number], by) for own in self.own_forces)
        callbacks = [one.of(own.functions) for one, own in zip(self.callbacks, forces)]
        return self.altered(_driven=(t, table), own_forces=forces, callbacks=callbacks, laws=with_callbacks(self.laws, callbacks))

    def kinks(self, t0, t1):
        """Return the times in (t0, t1) at which a profile is not smooth."""
        if not self._kinks.size:
            return ()
        first, end = np.searchsorted(self._kinks, t0, side="right"), np.searchsorted(self._kinks, t1)
        return tuple(self._kinks[first:end].tolist())

    @cached_property
    def _kinks(self):
        return np.unique(np.array([kink for profile in self.profiles for kink in profile.kinks], float))

    def constraint_name(self, row):
        return self.labels[row]

    def keeps_body(self, row):
        return any(self.rows[body.name].start <= row < self.rows[body.name].stop for body in self.reduced_bodies if body.name in self.rows)

    def phi(self, t, q):
        """Constraints, (m,): of points in m, of motors |d_A| |d_B| sin(angle error)."""
        phi, dz = np.empty(self.m), self.dz(q)
        joints.joint_forces(self._links(dz), self.drives(t), dz, np.zeros(self.m), phi, np.zeros_like(dz))
        return phi

    def facing(self, q):
        return self.altered(_facing=(None, self._links(self.dz(q)))) if self.edge_rows else self

    def _links(self, dz):
        """The Links at displacements of the points; those of the last position are kept."""
        if not self.edge_rows:
            return self.arrays.links
        at, links = self._facing
        if at is not None and at != (key := dz.tobytes()):
            links = links_at(self.arrays.links, self.edge_rows, dz)
            self._facing = key, links
        return links

    def phi_q(self, t, q):
        """Constraint Jacobian, (m, n) sparse; constant unless `needs.phi_q_varies` or `needs.driven`."""
        return self._slopes(t, q) @ self._points_of_q if self.needs.driven or self.needs.phi_q_varies else self._phi_q

    @cached_property
    def _phi_q(self):
        return self._slopes(0.0, np.zeros(self.n)) @ self._points_of_q

    @cached_property
    def _points_of_q(self):
        """A, (2 points, n), sparse."""
        return on_pairs(self.point_weights)

    @cached_property
    def point_weights(self):
        """A as complex numbers, (points, pairs) sparse."""
        from scipy.sparse import csr_array

        s = self.arrays.links
        return csr_array((s.point_weights @ (1, 1j), s.point_nodes, s.point_ptr), (self.n_points, self.n_nodes))

    def _slopes(self, t, q):
        """phi_z, (m, 2 points), sparse."""
        from scipy.sparse import csr_array

        s = self.arrays.links
        return csr_array((self.slope_values(t, q), s.row_columns, s.row_start), (self.m, 2 * self.n_points))

    def slope_values(self, t, q):
        """The entries of phi_z that may differ from zero, row after row."""
        dz = self.dz(q)
        s = self._links(dz)
        slopes = np.empty(len(s.row_columns))
        joints.joint_jacobian(s, self.drives(t), dz, slopes)
        return slopes

    def small_phi_q(self, t, q):
        """phi_q as a dense array, for scenes of few coordinates."""
        slopes = np.zeros((self.m, 2 * self.n_points))
        slopes[self._slope_rows, self.arrays.links.row_columns] = self.slope_values(t, q)
        return slopes @ self._small_points

    def phi_q_rows(self, t, q, rows):
        """The rows of phi_q with these numbers, (k, n), dense."""
        if self.small:
            return self.small_phi_q(t, q)[rows]
        links, slopes = self.arrays.links, np.zeros((2 * self.n_points, len(rows)))
        counts, first = np.diff(links.row_start)[rows], links.row_start[rows]
        entries = np.arange(counts.sum()) + np.repeat(first - np.cumsum(counts) + counts, counts)
        slopes[links.row_columns[entries], np.repeat(np.arange(len(rows)), counts)] = self.slope_values(t, q)[entries]
        return np.ascontiguousarray((self._points_of_q_transposed @ slopes).T)

    @cached_property
    def _points_of_q_transposed(self):
        return self._points_of_q.T.tocsr()

    @cached_property
    def _slope_rows(self):
        return np.repeat(np.arange(self.m), np.diff(self.arrays.links.row_start))

    @cached_property
    def _small_points(self):
        return self._points_of_q.toarray()

    def phi_t(self, t, q):
        return self._rates(t, q, np.zeros(self.n))[0] if self.needs.driven else np.zeros(self.m)

    def phi_rate(self, t, q, v):
        return self._rates(t, q, v)[1]

    def phi_bias(self, t, q, v):
        return self._rates(t, q, v)[2] if self.needs.driven or self.needs.phi_q_varies else np.zeros(self.m)

    def _rates(self, t, q, v):
        rates, dz = np.zeros((3, self.m)), self.dz(q)
        joints.joint_rates(self._links(dz), self.drives(t), dz, self.dz(v), *rates)
        return rates

    def phi_of_frames(self, t, q, v):
        """Return phi and its rate in frames, (frames, m) each, by compiled code."""
        phi, rates = np.empty((2, len(t), self.m))
        drives = np.array([self.drives(one) for one in t]) if self.profiles else np.zeros((len(t), 0, 3))
        frames = [np.ascontiguousarray(x, float).reshape(len(t), -1, 2) for x in (q, v)]
        joints.rows_of_frames(self.arrays.links, drives, *frames, np.empty((3, self.n_points, 2)), np.empty((2, self.m)), phi, rates)
        return phi, rates

    def phi_rate_q(self, t, q, v):
        return self._rates_q(t, q, v, 1)

    def phi_bias_q(self, t, q, v):
        return self._rates_q(t, q, v, 2)

    def phi_bias_v(self, t, q, v):
        return self._rates_q(t, q, v, 2, 0.0, 1.0)

    def _rates_q(self, t, q, v, which, of_q=1.0, of_v=0.0):
        """Derivative of one result of `joint_rates` in q or v: it is quadratic in the points, so central differences with any step are exact."""
        drives, z, vz, steps = self.drives(t), self.dz(q), self.dz(v), np.eye(2 * self.n_points).reshape(-1, self.n_points, 2)

        def at(step):
            rates = np.zeros((3, self.m))
            joints.joint_rates(self.arrays.links, drives, z + of_q * step, vz + of_v * step, *rates)
            return rates[which]

        slopes = np.array([at(step) - at(-step) for step in steps]).T / 2
        return slopes @ self._points_of_q

    def reaction_q(self, t, q, lam):
        """d(phi_q^T lam)/dq, (n, n) sparse: `A^T C A` with C the curvature of the rows on the points."""
        return self._points_of_q.T @ self._sparse_curvature(t, lam).tocsr() @ self._points_of_q

    def _sparse_curvature(self, t, lam):
        """C in blocks of points that rows couple."""
        from scipy.sparse import bsr_array

        coupling = self.arrays.links.coupling
        blocks = np.zeros((len(coupling.columns), 2, 2))
        joints.joint_curvature(self.arrays.links, self.drives(t), self._flat(lam), blocks)
        return bsr_array((blocks, coupling.columns, coupling.start), (2 * self.n_points,) * 2)

    def _flipped(self, t, q):
        """Name of a joint whose angle error is beyond a quarter turn."""
        row = joints.flipped(self.arrays.links, self.drives(t), self.dz(q))
        return next((name for name, part in self.rows.items() if part.start <= row < part.stop), None)

    def dz(self, q):
        """Displacements of the points that joints and masses hold on to, (points, 2)."""
        dz = np.empty((self.n_points, 2))
        joints.point_values(self.arrays.links, self._nodal(q), dz)
        return dz

    def _nodal(self, q):
        """q as (nodes, 2) for the kernels, which do not check bounds."""
        return _sized(q, self.n, "q").reshape(-1, 2)

    def _flat(self, lam):
        return _sized(lam, self.m, "lam")

    @property
    def named(self):
        """{name: attachment of a mass, load or joint}; of a joint its side b, or side a if b is ground."""
        sides = {name: getattr(part, "at", None) for name, part in self.parts.items()}
        sides |= {name: part.a if part.b.body is None else part.b for name, part in self.parts.items() if isinstance(part, Joint)}
        return {name: side for name, side in sides.items() if isinstance(side, Attachment)}

    def attachment(self, name):
        """One of `named`. Raises InputError for another name."""
        named = self.named
        if name not in named:
            has = "has no single point; give an attachment of a body" if name in self.parts else "is the name of no mass, load or joint"
            raise InputError(f"{name!r} {has}; known names: {', '.join(map(repr, named)) or 'none'}")
        return named[name]

    def pairs_and_weights(self, side, part="point"):
        """(pairs of q, complex weights) of an attachment's "point" or "direction". Raises InputError for a body of another scene."""
        if id(side.body) not in self.places:
            raise InputError(f"{side!r}: its body is not in the scene")
        return self.places[id(side.body)].pairs_and_weights(side, part)

    def displacement(self, name, q):
        """Displacement (2,), m, of the point of a mass, load or joint; its velocity for q = v."""
        return self._moved(self.attachment(name), "point", q[None])[0]

    def position(self, name, q):
        """Positions (frames, 2), m, over frames q (frames, n), of a mass, load or joint, given by name or itself, or of an attachment.

        Raises InputError for anything that is not in the scene.
        """
        side = self.side(name)
        return side.point + self._moved(side, "point", q)

    def velocity(self, name, v):
        """Velocity (2,), m/s, of the same, for v (n,)."""
        return self._moved(self.side(name), "point", v[None])[0]

    def _moved(self, side, part, q):
        """Change of an attachment's "point" or "direction" over frames q (frames, n), (frames, 2)."""
        pairs, weights = self.pairs_and_weights(side, part)
        return pairs_of(complex_of_pairs(q.reshape(len(q), -1, 2)[:, pairs]) @ weights)

    def side(self, name):
        """The attachment of a part, or of the part with a name; an attachment itself."""
        if isinstance(name, Attachment):
            return name
        name = next((known for known, part in self.parts.items() if part is name), name)
        if not isinstance(name, str):
            raise InputError(f"position({name!r}): give the name of a mass, load or joint, the part itself, or an attachment")
        return self.attachment(name)

    def reactions(self, name, q, lam, t=0.0, whole=False):
        """Force, N, and moment, N m, of a joint on its side b, over frames q (frames, n), lam (frames, k), t (frames,) or one number.

        whole: (fx, fy, m) of any joint. For a body: the multipliers of its own rows.
        """
        reaction = self.reaction_of(name, whole)
        edges = next((one for one in self.edge_rows if one.first == self.rows[name].start), None)
        if edges:
            return self._reactions_of_edges(edges, name, q, lam, whole)
        return lam.copy() if reaction is None else reaction(np.broadcast_to(t, len(q)), lam, lambda place: self.place(place, q))

    def _reactions_of_edges(self, edges, name, q, lam, whole):
        """`reactions` of a contact between edges: the sum of the forces on the points of its second side."""
        result = []
        for at, forces in zip(q, lam):
            on_points = -(self._slopes(0.0, at)[self.rows[name]].T @ forces).reshape(-1, 2)[edges.b]
            arms = edges.rest[edges.points :] + self.dz(at)[edges.b] - self.position(self.joints[name].b, at[None])[0]
            moment = arms[:, 0] @ on_points[:, 1] - arms[:, 1] @ on_points[:, 0]
            result.append([*on_points.sum(axis=0), *[moment] * whole])
        return np.array(result).reshape(len(q), -1)

    def reaction_of(self, name, whole=False):
        """The Reaction of a joint; None for a body."""
        if (name, whole) not in self._reactions:
            self._reactions[name, whole] = Reaction(self.joints[name], whole) if isinstance(self.joints[name], Joint) else None
        return self._reactions[name, whole]

    def place(self, place, q):
        """Position or direction, (frames,), complex, of a place (attachment, "point" or "direction") over frames q (frames, n)."""
        rest = np.full(len(q), rest_of(*place))
        return rest if place[0].body is None else rest + complex_of_pairs(self._moved(*place, q))

    def rate_of(self, place, v):
        """Rate of change, (frames,), complex, of a place of a body over frames v (frames, n)."""
        return complex_of_pairs(self._moved(*place, v))

    def turn(self, name, q):
        """Angle by which side b of a joint has turned against side a since rest, over frames q (frames, n): (frames,), rad in [-pi, pi].

        Raises InputError if a side has no direction.
        """
        joint = self.joints[name]
        joint.require_directions()
        a, b = (self.place((side, "direction"), q) / side.d.rest for side in (joint.a, joint.b))
        return np.angle(b * a.conj())

    def pulled(self, place, forces):
        """Generalised forces (frames, n) of forces (frames,), complex, on a place."""
        result = np.zeros((len(forces), self.n_nodes), complex)
        pairs, weights = self.pairs_and_weights(*place)
        np.add.at(result, (slice(None), pairs), forces[:, None] * np.conj(weights))
        return result.view(float)


def _sized(values, size, name):
    """Values as a new array (size,); ValueError, with the name, for another shape."""
    array = np.array(values, float)
    if array.shape != (size,):
        raise ValueError(f"{name} has shape {array.shape}, the model needs ({size},)")
    return array


class SceneBodies(Constraints):
    """The mass matrix of a scene with `bodies`, `reduced_bodies`, `arrays`, `pattern` and `uneven_mass`, and its bodies as they are drawn.

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
    """ "cell 3 of 'upper' at (x, y)": the cell of the least mean det F at displacements u (nodes, 2), and its centre at rest, m."""
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
