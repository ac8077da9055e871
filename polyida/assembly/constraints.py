"""The constraints of a scene, from compiled kernels: the rows of its joints on the points that these hold on to."""

from functools import cached_property

import numpy as np

from polyida.assembly.named_points import NamedPoints
from polyida.assembly.rows import joints as rows
from polyida.given import on_pairs


class Constraints(NamedPoints):
    """`phi(t, q)` of a scene and what follows from it, as far as points go: `phi = rows(A q)`, A the weights of the points.

    Beside what named points need: `arrays` of the kernels, `profiles`, `labels` and `rows` of phi, `needs`, n, m, n_nodes and n_points.
    """

    def drives(self, t):
        """Value, first and second derivative of every profile at time t, (profiles, 3)."""
        at, table = self._driven
        if at != t:
            table = np.array([profile.at(t) for profile in self.profiles], float).reshape(-1, 3)
            self._driven = t, table
        return table.copy()

    def pushed(self, t, number, by):
        """This model with the value of profile `number` at time t greater by `by`, its rates as they are."""
        table, other = self.drives(t), object.__new__(type(self))
        table[number, 0] += by
        other.__dict__.update(self.__dict__, _driven=(t, table), own_forces=self.own_forces.pushed(self.profiles[number], by))
        return other

    def kinks(self, t0, t1):
        """Times in (t0, t1) at which a profile is not smooth, sorted."""
        first, end = np.searchsorted(self._kinks, t0, side="right"), np.searchsorted(self._kinks, t1)
        return tuple(self._kinks[first:end].tolist())

    @cached_property
    def _kinks(self):
        """All of them, sorted: they are asked for at every one of them."""
        return np.unique(np.array([kink for profile in self.profiles for kink in profile.kinks], float))

    def constraint_name(self, row):
        """The joint and axis of a row of phi."""
        return self.labels[row]

    def keeps_body(self, row):
        """Whether a row of phi is one by which a body stays rigid."""
        return any(self.rows[body.name].start <= row < self.rows[body.name].stop for body in self.few if body.name in self.rows)

    def phi(self, t, q):
        """Constraints, (m,), in m (points) and, without unit, as |d_A| |d_B| sin(angle error) (motors)."""
        phi, dz = np.empty(self.m), self.dz(q)
        rows.joint_forces(self.arrays.links, self.drives(t), dz, np.zeros(self.m), phi, np.zeros_like(dz))
        return phi

    def phi_q(self, t, q):
        """Constraint Jacobian, (m, n) sparse; constant unless `needs.phi_q_varies` or `needs.driven`."""
        return self._jacobian(t, q) if self.needs.driven or self.needs.phi_q_varies else self._phi_q

    @cached_property
    def _phi_q(self):
        return self._jacobian(0.0, np.zeros(self.n))

    def _jacobian(self, t, q):
        return self._slopes(t, q) @ self._points_of_q

    @cached_property
    def _points_of_q(self):
        from scipy.sparse import csr_array

        return csr_array(self._points_t.T)

    def _slopes(self, t, q):
        from scipy.sparse import csr_array

        s = self.arrays.links
        return csr_array((self._slope_values(t, q), s.row_columns, s.row_start), (self.m, 2 * self.n_points))

    def _slope_values(self, t, q):
        s = self.arrays.links
        slopes = np.empty(len(s.row_columns))
        rows.joint_jacobian(s, self.drives(t), self.dz(q), slopes)
        return slopes

    def phi_z(self, t, q):
        """Derivative of phi in the places of the points, (m, 2 points): `phi_q = phi_z A`."""
        found = np.zeros((self.m, 2 * self.n_points))
        found[self._slope_rows, self.arrays.links.row_columns] = self._slope_values(t, q)
        return found

    @cached_property
    def _slope_rows(self):
        return np.repeat(np.arange(self.m), np.diff(self.arrays.links.row_start))

    def small_phi_q(self, t, q):
        """phi_q as a dense array, for scenes of few coordinates."""
        return self.phi_z(t, q) @ self._small_points

    @cached_property
    def _small_points(self):
        return self._points_of_q.toarray()

    def phi_t(self, t, q):
        """Partial derivative of phi in time, (m,)."""
        return self._rates(t, q, np.zeros(self.n))[0]

    def phi_rate(self, t, q, v):
        """`phi_q v + phi_t`, (m,)."""
        return self._slopes(t, q) @ self.dz(v).ravel() + self.phi_t(t, q)

    def phi_bias(self, t, q, v):
        """`(phi_q v)_q v + 2 phi_qt v + phi_tt`, (m,)."""
        return self._rates(t, q, v)[1]

    def phi_rate_q(self, t, q, v):
        """d(phi_q v + phi_t)/dq, (m, n)."""
        return self._rates_q(t, q, v, 1)

    def phi_bias_q(self, t, q, v):
        """d(phi_bias)/dq, (m, n)."""
        return self._rates_q(t, q, v, 2)

    def _rates_q(self, t, q, v, which):
        """The slope of one of `joint_rates`' results: quadratic in the places of points, differences over any length are exact."""
        drives, z, vz, ways = self.drives(t), self.dz(q), self.dz(v), np.eye(2 * self.n_points).reshape(-1, self.n_points, 2)

        def at(places):
            found = np.zeros((3, self.m))
            rows.joint_rates(self.arrays.links, drives, places, vz, *found)
            return found[which]

        slopes = np.array([at(z + way) - at(z - way) for way in ways]).T / 2
        return slopes @ self._points_of_q

    def _rates(self, t, q, v):
        phi_t, rate, bias = np.zeros((3, self.m))
        if self.needs.driven or self.needs.phi_q_varies:
            rows.joint_rates(self.arrays.links, self.drives(t), self.dz(q), self.dz(v), phi_t, rate, bias)
        return phi_t, bias

    def reaction_q(self, t, q, lam):
        """d(phi_q^T lam)/dq, (n, n) sparse: `A^T C A` with C the curvature of the rows on the points."""
        return self._points_t @ self._sparse_curvature(t, lam).tocsr() @ self._points_t.T

    def _sparse_curvature(self, t, lam):
        """C in blocks of points that rows couple."""
        from scipy.sparse import bsr_array

        coupling = self.arrays.links.coupling
        blocks = np.zeros((len(coupling.columns), 2, 2))
        rows.joint_curvature(self.arrays.links, self.drives(t), self._flat(lam), blocks)
        return bsr_array((blocks, coupling.columns, coupling.start), (2 * self.n_points,) * 2)

    def _flipped(self, t, q):
        """Name of a joint whose angle error is beyond a quarter turn."""
        row = rows.flipped(self.arrays.links, self.drives(t), self.dz(q))
        return next((name for name, part in self.rows.items() if part.start <= row < part.stop), None)

    def dz(self, q):
        """Displacements of the points that joints and masses hold on to, (points, 2)."""
        dz = np.empty((self.n_points, 2))
        rows.point_values(self.arrays.links, self._nodal(q), dz)
        return dz

    @cached_property
    def _points_t(self):
        """A^T as a sparse matrix, (n, 2 points)."""
        return on_pairs(self.point_weights).T.tocsr()

    @cached_property
    def point_weights(self):
        """A as complex numbers, (points, pairs) sparse."""
        from scipy.sparse import csr_array

        s = self.arrays.links
        return csr_array((s.point_weights @ (1, 1j), s.point_nodes, s.point_ptr), (self.n_points, self.n_nodes))

    def _nodal(self, q):
        """q as (nodes, 2) for the kernels, which do not check bounds."""
        return _sized(q, self.n, "q").reshape(-1, 2)

    def _flat(self, lam):
        return _sized(lam, self.m, "lam")


def _sized(values, size, name):
    array = np.array(values, float)
    if array.shape != (size,):
        raise ValueError(f"{name} has shape {array.shape}, the model needs ({size},)")
    return array
