"""The rows of phi of a scene's model, their derivatives, and the places and reactions of its joints.

All of it depends on q through the points of the joints alone, `dz = A q`: kernels compute rows and slopes in dz (joints.py), and
derivatives in q are products with A.
"""

from functools import cached_property

import numpy as np

from polyida.assembly import joints
from polyida.assembly.gather_laws import with_callbacks
from polyida.errors import InputError
from polyida.joint.attachment import Attachment
from polyida.joint.edges import links_at
from polyida.joint.formula import rest_of
from polyida.joint.joint import Joint, Reaction
from polyida.model import Model
from polyida.validation import complex_of_pairs, on_pairs, pairs_of


class Constraints(Model):
    """`phi(t, q)` of a scene and its derivatives: `phi = rows(A q)`, A the weights of the points.

    It needs `parts`, `joints` and `places` of the bodies, `arrays` of the kernels, `profiles`, `labels` and `rows` of phi, `edge_rows`,
    `needs`, n, m, n_nodes and n_points.
    """

    def altered(self, without=(), **attributes):
        """A shallow copy of this object with these attributes in place of its own, and without those whose names are in `without`."""
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
        """All times, s, at which a profile is not smooth, sorted."""
        return np.unique(np.array([kink for profile in self.profiles for kink in profile.kinks], float))

    def constraint_name(self, row):
        """Return the name of a row of phi for messages."""
        return self.labels[row]

    def keeps_body(self, row):
        """Return True if a row of phi belongs to a body of few coordinates, which it keeps rigid."""
        return any(self.rows[body.name].start <= row < self.rows[body.name].stop for body in self.reduced_bodies if body.name in self.rows)

    def phi(self, t, q):
        """phi (m,), a new array: rows of points in m, of motors |d_A| |d_B| sin(angle error), d_A and d_B the directions of both sides."""
        phi, dz = np.empty(self.m), self.dz(q)
        joints.joint_forces(self._links(dz), self.drives(t), dz, np.zeros(self.m), phi, np.zeros_like(dz))
        return phi

    def facing(self, q):
        """Return the model in which edges of plates face what they face at q, whatever moves; itself if no contact has edges."""
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
        """phi_q, (m, n) sparse, of a scene in which it is constant."""
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
        """A^T, (n, 2 points), as sparse rows; made once."""
        return self._points_of_q.T.tocsr()

    @cached_property
    def _slope_rows(self):
        """The row of phi of each of the `slope_values`, (entries,)."""
        return np.repeat(np.arange(self.m), np.diff(self.arrays.links.row_start))

    @cached_property
    def _small_points(self):
        """A, (2 points, n), as a dense array; made once."""
        return self._points_of_q.toarray()

    def phi_t(self, t, q):
        """Return the partial derivative of phi in time, (m,)."""
        return self._rates(t, q, np.zeros(self.n))[0] if self.needs.driven else np.zeros(self.m)

    def phi_rate(self, t, q, v):
        """Return d phi/dt = `phi_q v + phi_t`, (m,)."""
        return self._rates(t, q, v)[1]

    def phi_bias(self, t, q, v):
        """Return `(phi_q v)_q v + 2 phi_qt v + phi_tt`, (m,); zero if phi_q is constant and nothing is driven."""
        return self._rates(t, q, v)[2] if self.needs.driven or self.needs.phi_q_varies else np.zeros(self.m)

    def _rates(self, t, q, v):
        """phi_t, `phi_q v + phi_t` and phi_bias at (t, q, v), as the rows of one array (3, m)."""
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
        """Return d(phi_q v + phi_t)/dq, (m, n), by central differences, which are exact since the rate is quadratic in q."""
        return self._rates_q(t, q, v, 1)

    def phi_bias_q(self, t, q, v):
        """Return d(phi_bias)/dq, (m, n), at (t, q, v), by central differences, which are exact: phi_bias is quadratic in the points."""
        return self._rates_q(t, q, v, 2)

    def phi_bias_v(self, t, q, v):
        """Return d(phi_bias)/dv, (m, n), at (t, q, v), by central differences, which are exact: phi_bias is quadratic in the points."""
        return self._rates_q(t, q, v, 2, 0.0, 1.0)

    def _rates_q(self, t, q, v, which, of_q=1.0, of_v=0.0):
        """Derivative of one result of `joint_rates` in q or v: it is quadratic in the points, so central differences with any step are exact."""
        drives, z, vz, steps = self.drives(t), self.dz(q), self.dz(v), np.eye(2 * self.n_points).reshape(-1, self.n_points, 2)

        def at(step):
            """Number `which` of phi_t, rate and bias (m,) of `joint_rates`.

            The points are moved by of_q, and their velocities by of_v, times a step; both (points, 2).
            """
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
        """lam as (m,) for the kernels, which do not check bounds."""
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
        """Velocity (2,), m/s, of a mass, load or joint, given by name or itself, or of an attachment, for v (n,)."""
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
        """Angle by which side b of a joint has turned against side a since the reference configuration, over frames q (frames, n): (frames,), rad in [-pi, pi].

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
