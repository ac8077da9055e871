"""The model of a scene: one residual and one constraint vector, from compiled kernels."""

from functools import cached_property

import numpy as np

from polyida.assembly import equilibrium as compiled
from polyida.assembly.arrays import bilinear, concatenated
from polyida.assembly.build import assemble, bodies_of, extent_of, first_nodes, of_kind
from polyida.assembly.constraints import Constraints
from polyida.assembly.damping import add_damping, damped_blocks
from polyida.assembly.own.bodies import Elastic, own_bodies_of, own_mass
from polyida.assembly.own.forces import OwnForce, OwnForces
from polyida.assembly.own.laws import add_own_forces
from polyida.assembly.rows.increments import Increments
from polyida.assembly.rows.mass_system import MassSystem, at_rest
from polyida.assembly.step_matrix import SceneStepMatrix
from polyida.assembly.told.momenta import Momenta
from polyida.assembly.told.powers import Powers
from polyida.body.force_element import ForceElement
from polyida.element import kernels
from polyida.linear.lu import LU
from polyida.linear.step_matrix import StepMatrix
from polyida.model import Needs


class SceneModel(Constraints):
    """Plates, joints, masses and forces as `r = M a + g + phi_q^T lam`, `phi(t, q)`; q are nodal displacements, (x, y) a node, in m.

    bodies: the plates in order, each with its slice of the nodes; own_bodies: those of a user's own, whose coordinates are pairs behind
    the nodes. arrays: all that the compiled kernels read; own_forces: the force elements and bodies' elastic forces, which are
    Python; laws: these by number where all of them are compiled. compiled: whether there is nothing of one's own, so that kernels
    take whole steps. `rows` names the slice of phi and lam that belongs to each joint or body. Matrices are scipy.sparse.
    """

    is_scene = alike = carries = compiled = True
    looks_apart = 1024  # its joints hold on to points of their own, only motors turn rows

    def __init__(self, parts, gravity):
        self.parts, self.gravity = dict(parts), tuple(map(float, gravity))
        self.bodies, self._kept, self._driven = bodies_of(parts), {}, (None, None)
        n_plates = self.bodies[-1].nodes.stop if self.bodies else 0
        self.own_bodies = own_bodies_of(parts, n_plates)
        self.first_node, self.extent = first_nodes(self.bodies, self.own_bodies), extent_of(self.bodies, self.own_bodies)
        self.arrays, points, table, drives, self.laws = assemble(self.bodies, self.own_bodies, parts, gravity)
        self.profiles, self.named_profiles = drives.profiles, tuple(zip(drives.names, drives.profiles))
        self.labels, self.units, self.rows, self.joints = table.labels, table.units, table.rows, table.joints
        self.n_nodes = self.own_bodies[-1].nodes.stop if self.own_bodies else n_plates
        self.n, self.m = 2 * self.n_nodes, len(self.labels)
        self.n_points = len(points.nodes)
        links = self.arrays.links
        self.motor_profiles = np.unique(links.product_drive[links.product_drive >= 0])
        elements, deforming = of_kind(parts, ForceElement), [own for own in self.own_bodies if own.elastic]
        self.damped, self.flexible = any(body.plate.material.damped for body in self.bodies), bool(self.bodies or deforming)
        self.needs = Needs(
            mass_varies=False,
            velocity_forces=self.damped or bool(elements),
            driven=bool((links.product_drive >= 0).any()),
            phi_q_varies=bool(bilinear(links).any()),
        )
        self.reference = np.concatenate([body.points for body in self.bodies] + [own.pairs for own in self.own_bodies])
        self.own_forces = OwnForces(
            [*(OwnForce(name, element, self) for name, element in elements.items()), *(Elastic(own, self.n_nodes) for own in deforming)],
            self.n,
        )
        self.own_mass = own_mass(self.own_bodies, parts, self.first_node, self.n) if self.own_bodies else None
        python = dict.fromkeys([own.name for own in (*self.own_bodies, *self.own_forces.each)] if self.laws is None else [])
        self.compiled, self.alike, self.looks_apart = not python, not self.own_bodies, 1 if self.own_bodies else self.looks_apart
        self.remark = f"plain paths for the Python of {', '.join(map(repr, python))}" if python else ""

    @property
    def free_fall(self):
        """|g|, m/s^2."""
        return float(np.hypot(*self.gravity))

    def __reduce__(self):
        return type(self), (self.parts, self.gravity)

    def evaluate(self, t, q, a, lam, rotation=None):
        """(r (n,), phi (m,), rotation, least det F, least motor cosine) in one compiled pass."""
        r, phi = np.empty((self.n_nodes, 2)), np.empty(self.m)
        rotation = np.empty((0, 2)) if rotation is None else rotation
        dz, forces = np.empty((2, self.n_points, 2))
        det, cosine = compiled.equilibrium(
            self.arrays, self.drives(t), self._nodal(q), self._nodal(a), self._flat(lam), r, phi, rotation, dz, forces
        )
        return r.ravel(), phi, rotation, det, cosine

    def residual(self, t, q, v, a, lam):
        """`r = M a + g + phi_q^T lam`, (n,)."""
        r = self._with_forces(t, q, v, self.evaluate(t, q, a, lam)[0])
        return r if self.own_mass is None else r + self.own_mass @ a

    def _with_forces(self, t, q, v, r):
        """r with what `evaluate` leaves out: damping and force elements."""
        if self.damped:
            add_damping(self.arrays.plates, self._nodal(q), self._nodal(v), np.empty((self.n_nodes, 2)), r.reshape(-1, 2))
        if self.laws is None:
            self.own_forces.take_from(r, t, q, v)
            return r
        add_own_forces(self.laws, self.arrays.links, self.drives(t), self._nodal(q), self._nodal(v), r.reshape(-1, 2))
        if not np.isfinite(r).all():
            self.own_forces.take_from(r, t, q, v)  # which knows by whose doing
        return r

    def call_all(self, t, q, v):
        """Each of a user's functions once."""
        self.force(t, q, v), self.potential(q)

    @property
    def not_finite(self):
        """Which of a user's functions last gave what is not finite, in words; empty where none."""
        return self.own_forces.not_finite

    def force(self, t, q, v):
        """g = g_int - g_ext, (n,)."""
        return self._with_forces(t, q, v, self.evaluate(t, q, np.zeros(self.n), np.zeros(self.m))[0])

    def mass(self, q=None):
        """Mass matrix, constant, (n, n) sparse."""
        return self._mass

    @cached_property
    def _mass(self):
        from scipy.sparse import kron

        nodal = kron(self._nodal_mass, np.eye(2), format="csc")
        return nodal if self.own_mass is None else nodal + self.own_mass

    @cached_property
    def _nodal_mass(self):
        """The mass matrix of one direction, (nodes, nodes), without bodies of one's own: x and y carry the same."""
        from scipy.sparse import csr_array, diags_array

        (indptr, indices), s = self.pattern, self.arrays
        values = [body.operator.mass * density for body, density in zip(self.bodies, s.plates.body_density)]
        mass = csr_array((concatenated(values, float), indices, indptr), shape=(self.n_nodes, self.n_nodes))
        return (mass + self._points_s.T @ diags_array(s.links.point_mass) @ self._points_s).tocsc()

    def mass_inverse(self, b):
        """M^-1 b, b (n,) or (n, k); M is factored once."""
        pairs = b.reshape(self.n_nodes, -1)
        return self._mass_factor.solve(np.ascontiguousarray(pairs)).reshape(b.shape)

    @cached_property
    def _mass_factor(self):
        return LU(self._nodal_mass)

    def force_q(self, t, q, v):
        """dg/dq, (n, n) sparse."""
        return self._forces_q(t, q, v, 0.0, 1.0)

    def force_v(self, t, q, v):
        """dg/dv, (n, n) sparse: zero without damping and force elements."""
        return self._forces_q(t, q, v, 1.0, 0.0)

    def mass_a_q(self, q, a):
        """d(M a)/dq: zero."""
        from scipy.sparse import csc_array

        return csc_array((self.n, self.n))

    def tangent(self, t, q, v, a, lam, c_m, c_v, c_q):
        """`c_m M + c_v dr/dv + c_q dr/dq`, (n, n) sparse; c_m and c_v are real or complex."""
        c_v, turned, c_q = map(float, (np.real(c_v), np.imag(c_v), c_q))
        result = self._forces_q(t, q, v, c_v, c_q) + c_m * self._mass
        if turned and self.needs.velocity_forces:
            result = result + 1j * turned * self.force_v(t, q, v)
        return (result + c_q * self.reaction_q(t, q, lam) if self.needs.phi_q_varies else result).tocsc()

    def mass_system(self, t, q):
        """The system of M and phi_q through the points of the joints; without motors made once."""
        if self.own_bodies:
            return super().mass_system(t, q)
        return MassSystem(self, t, q) if self.needs.driven or self.needs.phi_q_varies else self.once(at_rest)

    def step_matrix(self, linear="auto"):
        """The plates' factor in the frame of their nodal rotations; with force elements, whose slopes that has not, the sparse one."""
        return SceneStepMatrix(self, linear) if self.compiled else StepMatrix(self)

    def increments(self, t0, t1, ends, h, q, v):
        """What the rows gain in a step, by their exact differences."""
        return Increments(self, t0, t1, ends, h, q, v)

    def rotation(self, q):
        """Raw nodal rotations at q, (nodes, 2): area-weighted sums of (F11 + F22, F21 - F12)."""
        rotation = np.empty((self.n_nodes, 2))
        self.evaluate(0.0, q, np.zeros(self.n), np.zeros(self.m), rotation)
        return rotation

    def objection(self, t, q):
        """Why a state cannot be accepted, or None: an element turned inside out, or a motor on the wrong half-turn."""
        _, _, _, det, cosine = self.evaluate(t, q, np.zeros(self.n), np.zeros(self.m))
        if not det > 0:
            where = _deepest(self.bodies, self._nodal(q))
            return f"{where} is turned inside out (least det F {det:.3g}); St. Venant-Kirchhoff has collapsed in compression"
        return (
            None if cosine > 0 else f"motor {self._flipped(t, q)!r} stands on the wrong half-turn (cosine of its angle error {cosine:.3g})"
        )

    def potential(self, q):
        """Strain energy and potential of gravity, J, relative to the reference configuration, and energy of force elements."""
        return sum(self.potentials(q))

    def potentials(self, q):
        """(potential of gravity and force elements, strain energy), J."""
        return self.gravity_potential(q) + self.own_forces.energy(q, strain=False), self.strain_energy(q)

    def strain_energy(self, q):
        """Elastic energy of all bodies, J."""
        return compiled.strain_energy(self.arrays.plates, self._nodal(q)) + self.own_forces.energy(q, strain=True)

    def gravity_potential(self, q):
        """Potential of gravity on bodies and masses, J, zero at q = 0."""
        at_points = self.arrays.links.point_mass @ (self.dz(q) @ self.arrays.links.gravity)
        return -float(np.sum(self.arrays.plates.weight * self._nodal(q)) + at_points)

    def momenta(self, q, v):
        """(px, py, L): momentum, N s, and angular momentum about the origin, N m s."""
        return self.once(Momenta)(q, v)

    @property
    def dissipating(self):
        """Names of force elements and plates that only take energy."""
        return self.once(Powers).dissipating

    def powers(self, t, q, v, lam):
        """{name: power, W} of loads, driven joints, force elements beyond their energy, and damping."""
        return self.once(Powers)(t, q, v, lam)

    @cached_property
    def pattern(self):
        """(indptr, indices) of the nodal block pattern of all plates, int32; rows of other bodies' pairs are empty."""
        s, indptr, indices = self.arrays.plates, [np.zeros(1, np.int32)], []
        for body, first in zip(self.bodies, s.body_block):
            indptr.append(body.operator.indptr[1:] + np.int32(first))
            indices.append(body.operator.indices + np.int32(body.nodes.start))
        indptr = np.concatenate(indptr)
        return np.pad(indptr, (0, self.n_nodes + 1 - len(indptr)), mode="edge"), concatenated(indices, np.int32)

    def _forces_q(self, t, q, v, c_v, c_q):
        """`c_v dg/dv + c_q dg/dq`, (n, n) sparse."""
        plates = self._plates_q(q, v, c_v, c_q)
        return plates if not self.own_forces else (plates + self.own_forces.slopes(t, q, v, c_v, c_q)).tocsc()

    def _plates_q(self, q, v, c_v, c_q):
        from scipy.sparse import bsr_array

        indptr, indices = self.pattern
        blocks = np.empty((len(indices), 2, 2))
        if self.damped:
            damped_blocks(self.arrays.plates, self._nodal(q), self._nodal(v), c_v, c_q, blocks)
        else:
            compiled.tangent_blocks(self.arrays.plates, self._nodal(q), 0.0, c_q, blocks)
        return bsr_array((blocks, indices, indptr), shape=(self.n, self.n)).tocsc()

    def stress(self, q):
        """Cauchy stress of every element, (cells, 3): xx, yy, xy in Pa, plate after plate."""
        parts = [np.zeros((0, 3))]
        for body in self.bodies:
            modulus, nu = body.plate.material.in_plane
            out, operator = np.empty((body.mesh.n_cells, 3)), body.operator
            kernels.stress(
                *operator.force_arrays,
                operator.lane_cells,
                operator.areas,
                body.nodes.start,
                modulus / (1 - nu**2),
                nu,
                self._nodal(q),
                out,
            )
            parts.append(out)
        return np.concatenate(parts)

    def stress_across(self, stress):
        """Stress zz across the plane, (cells,), Pa, from that of every element: nu (xx + yy) in plane strain, 0 in plane stress."""
        ratio = [body.plate.material.across for body in self.bodies]
        return np.repeat(ratio, [body.mesh.n_cells for body in self.bodies]) * (stress[:, 0] + stress[:, 1])

    def once(self, make):
        """make(self), kept: what other layers derive from the model once."""
        if make not in self._kept:
            self._kept[make] = make(self)
        return self._kept[make]


def _deepest(bodies, u):
    """ "cell 3 of 'upper' at (x, y)": that of the least mean det F at displacements u (nodes, 2), and its centre at rest, m."""
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
