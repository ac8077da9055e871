"""The model of a scene: one residual and one constraint vector, from compiled kernels."""

from contextlib import suppress
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polyida.assembly import equilibrium as compiled
from polyida.assembly.arrays import bilinear, concatenated, shifting_drives, turning_drives
from polyida.assembly.build import assemble, extent_of, few_of, of_kind, plates_of
from polyida.assembly.corotated import SceneStepMatrix
from polyida.assembly.equilibrium import add_damping, blocks_at
from polyida.assembly.factors import factors_of, scaled, told
from polyida.assembly.increments import Increments
from polyida.assembly.independence import Redundant
from polyida.assembly.motion import velocity_at
from polyida.assembly.own_forces import Elastic, OwnForce, OwnForces, uneven_drag, uneven_mass
from polyida.assembly.own_laws import add_own_forces
from polyida.assembly.placement import dead_loads, largest
from polyida.assembly.projection import MassSystem
from polyida.assembly.scene_bodies import SceneBodies, deepest
from polyida.force.force_element import ForceElement
from polyida.joint.formula import Row, rows_of
from polyida.linear.lu import dense
from polyida.linear.step_matrix import StepMatrix
from polyida.model import Needs
from polyida.model.differences import along
from polyida.profile import Profile
from polyida.validation import pairs_of

NEAR = 1e-3  # of the size of its sides' places, over which an element's energy is differentiated: contacts are that shallow
SMALL = 100  # coordinates and multipliers up to which dense matrices are cheaper than what sparse ones cost in Python


class SceneModel(SceneBodies):
    """Bodies, joints, masses and forces as `r = M a + g + phi_q^T lam`, `phi(t, q)`; q are displacements of pairs (x, y): of the plates'
    nodes, m, then of the complex coordinates of bodies that have few.

    bodies: the plates in order, each with its slice of the nodes; few: the other bodies; places: all by id. arrays: all that the compiled
    kernels read; own_forces: the force elements and own bodies' elastic forces, for Python; laws: the same by number, if all are compiled.
    compiled: whether there is no Python in it, so that kernels take whole steps. `rows` names the slice of phi and lam that
    belongs to each joint or body. Matrices are scipy.sparse.
    """

    is_scene = has_constraint_increments = True
    looks_apart = 1024  # its joints hold on to points of their own, only motors turn rows

    def __init__(self, parts, gravity, redundant="refuse"):
        self.parts, self.treats_redundant = dict(parts), redundant
        self.gravity = tuple(g if isinstance(g, Profile) else float(g) for g in gravity)
        self.bodies, self._driven = plates_of(parts), (None, None)
        self.few = few_of(parts, self.bodies[-1].nodes.stop if self.bodies else 0)
        self.places = {id(body.plate): body for body in self.bodies} | {id(placed.user): placed for placed in self.few}
        self.extent = extent_of(self.bodies, self.few)
        self.n_nodes = [*self.bodies, *self.few][-1].pairs.stop
        self.n = 2 * self.n_nodes
        self._assemble()
        links = self.arrays.links
        elements, elastic = of_kind(parts, ForceElement), [placed for placed in self.few if placed.elastic]
        self.damped = any(placed.damped for placed in (*self.bodies, *self.few))
        self.flexible = bool(self.bodies) or any(placed.deforms for placed in self.few)
        self.needs = Needs(
            mass_varies=False,
            velocity_forces=self.damped or bool(elements),
            driven=bool(len(self.motor_profiles) or len(self.path_profiles)),
            phi_q_varies=bool(bilinear(links).any()),
        )
        self.reference = np.concatenate([body.points for body in self.bodies] + [pairs_of(placed.rest) for placed in self.few])
        self.own_forces = OwnForces(
            [*(OwnForce(name, element, self) for name, element in elements.items()), *(Elastic(own, self.n_nodes) for own in elastic)],
            self.n,
        )
        self._switching = any(own.switches for own in self.own_forces.each)
        self.uneven_mass, self.uneven_drag = uneven_mass(self.few, self.n), uneven_drag(self.few, self.n)
        python = [placed.name for placed in self.few if placed.python] + [
            name for name, element in elements.items() if not element.compiled_functions()
        ]
        massless = [placed.name for placed in self.few if placed.massless]
        self.solid = not massless and self.uneven_mass is None
        self.compiled, self.uniform_units, self.looks_apart = self.solid and not python, not self.few, 1 if self.few else self.looks_apart
        why = (("the Python of", python), ("the massless coordinates of", massless))
        self.remark = " and ".join(f"plain paths for {what} {', '.join(map(repr, names))}" for what, names in why if names)
        if redundant == "least-norm":
            whole = object.__new__(type(self))
            whole.__dict__.update(self.__dict__)
            self.redundant = Redundant(whole)
            self._assemble(self.redundant.left_out)
            self.remark = " and ".join(filter(None, (self.remark, self.redundant.remark())))

    def _assemble(self, left_out=()):
        """Take arrays and rows of phi from the parts, without the rows `left_out`, by number."""
        found = assemble(self.bodies, self.few, self.places, self.parts, self.gravity, self.extent, left_out)
        self.arrays, points, table, drives, self.laws = found
        self.profiles, self.named_profiles = drives.profiles, tuple(zip(drives.names, drives.profiles))
        self.labels, self.units, self.rows, self.joints = table.labels, table.units, table.rows, table.joints
        self.m, self.n_points, self._kept, self._of_shape, self._reactions = len(self.labels), len(points.nodes), {}, {}, {}
        links = self.arrays.links
        self.motor_profiles, self.path_profiles = turning_drives(links), shifting_drives(links)

    @property
    def free_fall(self):
        """|g|, m/s^2."""
        return largest(self.gravity)

    def __repr__(self):
        bodies, joints = len(self.bodies) + len(self.few), len(self.joints)
        return f"<SceneModel: n = {self.n}, m = {self.m}, {bodies} bod{'ies' if bodies != 1 else 'y'}, {joints} joint{'s' * (joints != 1)}>"

    def __reduce__(self):
        return again, (type(self), self.parts, self.gravity, self.treats_redundant, told(self))

    @property
    def factors(self) -> dict[str, tuple[NDArray, NDArray]]:
        """{plate: (stiffness, mass)}, each (cells,): the factors of all full plates, 1 where none were given."""
        return factors_of(self)

    def with_factors(self, /, **factors: tuple[ArrayLike | None, ArrayLike | None]) -> "SceneModel":
        """This model with the cells of plates scaled: `with_factors(arm=(stiffness, mass))`.

        Each is a positive number, one a cell, (cells,), or None for 1: a factor of the full plate, whatever factors this model has; plates
        that are not named keep theirs. Stiffness scales the elastic force, its viscosity and the stabilisation of virtual elements, mass
        the inertia, the weight and mass-proportional damping; a cell of factor f in both is a cell of thickness f t. Stresses are those
        of the scaled material, strains those of the motion. Nothing is built anew: the two models share all that does not follow from
        factors. Raises InputError naming plate and value.
        """
        return scaled(self, factors)

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
        return r if self.uneven_mass is None else r + self.uneven_mass @ a

    def _with_forces(self, t, q, v, r):
        """r with what `evaluate` leaves out: damping and force elements."""
        if self.damped:
            add_damping(self.arrays, self._nodal(q), self._nodal(v), np.empty((self.n_nodes, 2)), r.reshape(-1, 2))
        if self.uneven_drag is not None:
            r += self.uneven_drag @ v
        if self.laws is not None:
            add_own_forces(self.laws, self.arrays.links, self.drives(t), self._nodal(q), self._nodal(v), r.reshape(-1, 2))
        if self.laws is None:
            self.own_forces.take_from(r, t, q, v)
        elif not np.isfinite(r).all():
            with suppress(Exception):  # in Python, so that `not_finite` says whose fault it is
                self.own_forces.take_from(r, t, q, v)
        return r

    def call_all(self, t, q, v):
        """Each of a user's functions once."""
        self.own_forces.take_from(np.zeros(self.n), t, q, v), self.potential(q)

    @property
    def switching(self):
        """Whether one of its force elements declares switches, by `gap`."""
        return self._switching

    def gaps(self, t, q):
        """Gaps of its force elements, (k,)."""
        return self.own_forces.gaps(q) if self._switching else np.zeros(0)

    def gap_names(self):
        """The force element of each of `gaps`."""
        return self.own_forces.gap_names(np.zeros(self.n)) if self._switching else []

    @property
    def not_finite(self):
        """Which of a user's functions last gave what is not finite, in words; empty where none."""
        return self.own_forces.not_finite

    def force(self, t, q, v):
        """g = g_int - g_ext, (n,)."""
        return self._with_forces(t, q, v, self.evaluate(t, q, np.zeros(self.n), np.zeros(self.m))[0])

    def initial_velocity(self, t, q):
        """What the bodies were given, as far as their joints let them, (n,)."""
        return velocity_at(self, t, q)

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

    @property
    def small(self):
        """Whether it has few coordinates: starts and adjoints then take dense matrices."""
        return self.n + self.m <= SMALL

    def small_mass(self):
        """The mass matrix of a small scene as a dense array."""
        return self.once(_dense_mass)

    def small_tangent(self, t, q, v, lam):
        """dr/dq of a small scene as a dense array."""
        (indptr, indices), result = self.pattern, np.zeros((self.n, self.n))
        pairs = np.repeat(np.arange(self.n_nodes), np.diff(indptr))
        blocks = blocks_at(self, self._nodal(q), self._nodal(v), 0.0, 0.0, 1.0)
        result.reshape(self.n_nodes, 2, self.n_nodes, 2)[pairs, :, indices, :] = blocks
        if self.own_forces:
            result += dense(self.own_forces.slopes(t, q, v, 0.0, 1.0))
        if self.needs.phi_q_varies:
            result += self._small_points.T @ self._sparse_curvature(t, lam) @ self._small_points
        return result

    def mass_system(self, t, q):
        """The system of M and phi_q through the points of the joints."""
        if not self.solid:
            return super().mass_system(t, q)
        return MassSystem(self, t, q)

    def step_matrix(self):
        """The plates' factor in the frame of their nodal rotations; with force elements, whose slopes that has not, the sparse one."""
        return SceneStepMatrix(self) if self.compiled else StepMatrix(self)

    def increments(self, t0, t1, ends, h, q, v):
        """What the rows gain in a step, by their exact differences."""
        return Increments(self, t0, t1, ends, h, q, v)

    def rotation(self, q):
        """Raw nodal rotations at q, (nodes, 2): area-weighted sums of (F11 + F22, F21 - F12)."""
        rotation = np.empty((self.n_nodes, 2))
        self.evaluate(0.0, q, np.zeros(self.n), np.zeros(self.m), rotation)
        return rotation

    def rejection_reason(self, t, q):
        """Why a state cannot be accepted, or None: an element turned inside out, or a motor on the wrong half-turn."""
        _, _, _, det, cosine = self.evaluate(t, q, np.zeros(self.n), np.zeros(self.m))
        if not det > 0:
            where = deepest(self.bodies, self._nodal(q))
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
        return compiled.strain_energy(self.arrays, self._nodal(q)) + self.own_forces.energy(q, strain=True)

    def gravity_potential(self, q):
        """Potential of steady gravity on bodies and masses, J, zero at q = 0; of what follows a profile there is work."""
        at_points = self.arrays.links.point_mass @ (self.dz(q) @ self.arrays.links.gravity)
        return -float(np.sum(self.arrays.plates.weight * self._nodal(q)) + at_points)

    @property
    def dissipating(self):
        """Names of force elements and plates that only take energy."""
        return self.once(Powers).dissipating

    def powers(self, t, q, v, lam):
        """{name: power, W} of loads, driven joints, force elements beyond their energy, and damping."""
        return self.once(Powers)(t, q, v, lam)

    @cached_property
    def pattern(self):
        """(indptr, indices) of the pairs' block pattern, int32: of the plates' nodes, and of all pairs of each other body."""
        s, indptr, indices = self.arrays.plates, [np.zeros(1, np.int32)], []
        for body, first in zip(self.bodies, s.body_block):
            indptr.append(body.operator.indptr[1:] + np.int32(first))
            indices.append(body.operator.indices + np.int32(body.nodes.start))
        for placed, first in zip(self.few, self.arrays.compact.block):
            pairs = np.arange(placed.pairs.start, placed.pairs.stop)
            indptr.append((first + len(pairs) * np.arange(1, len(pairs) + 1)).astype(np.int32))
            indices.append(np.tile(pairs, len(pairs)))
        return np.concatenate(indptr), concatenated(indices, np.int32)

    @cached_property
    def first_pairs(self):
        """The first pair of every body, and the end, (bodies + 1,)."""
        return np.concatenate([self.arrays.plates.body_node, self.arrays.compact.pair[1:]])

    def _forces_q(self, t, q, v, c_v, c_q):
        """`c_v dg/dv + c_q dg/dq`, (n, n) sparse."""
        from scipy.sparse import bsr_array

        indptr, indices = self.pattern
        blocks = blocks_at(self, self._nodal(q), self._nodal(v), 0.0, c_v, c_q)
        bodies = bsr_array((blocks, indices, indptr), shape=(self.n, self.n)).tocsc()
        if self.uneven_drag is not None:
            bodies = bodies + c_v * self.uneven_drag
        return bodies if not self.own_forces else (bodies + self.own_forces.slopes(t, q, v, c_v, c_q)).tocsc()

    def once(self, make, of_shape=False):
        """make(self), kept: what other layers derive from the model once; of_shape: what is the same whatever the factors."""
        kept = self._of_shape if of_shape else self._kept
        if make not in kept:
            kept[make] = make(self)
        return kept[make]


def _dense_mass(model):
    return model.mass().toarray()


def again(kind, parts, gravity, redundant, factors):
    """A model of a kind behind pickle."""
    model = kind(parts, gravity, redundant)
    return model.with_factors(**factors) if factors else model


class Powers:
    """{name: W} at an instant, of loads, of joints whose rows a profile drives, of force elements beyond their energy, of damping.

    A load gives `f . v`, alike gravity that follows a profile, a joint `lam . phi_t` of its rows (the force `-phi_q^T lam` on `v`, and
    `phi_q v = -phi_t`), an element `sum f . v + dE/dt`, a plate minus what its damping takes. dissipating: names of those that only take.
    """

    def __init__(self, model):
        self.model = model
        self._loads = dead_loads(model.parts, model.gravity, model.places)
        self._driven = {name: model.rows[name] for name, part in model.joints.items() if _driven(part)}
        self._elements = [own for own in model.own_forces.each if not own.strain]
        self._damped = [placed for placed in (*model.bodies, *model.few) if placed.damped]
        self.dissipating = (*(own.name for own in self._elements if own.element.dissipates), *(body.name for body in self._damped))

    def __call__(self, t, q, v, lam):
        found = {}
        for load in self._loads:
            found[load.name] = found.get(load.name, 0.0) + load.power(t, v)
        if self._driven:
            power = lam * self.model.phi_t(t, q)
            found |= {name: float(power[rows].sum()) for name, rows in self._driven.items()}
        found |= {own.name: _beyond_energy(own, t, own.places(q), own.velocities(v)) for own in self._elements}
        if not self._damped:
            return found
        u, speeds = q.reshape(-1, 2).copy(), v.reshape(-1, 2).copy()
        force = np.zeros_like(u)
        add_damping(self.model.arrays, u, speeds, np.empty_like(u), force)
        if self.model.uneven_drag is not None:
            force += (self.model.uneven_drag @ v).reshape(force.shape)
        return found | {body.name: -float(np.vdot(force[body.pairs], speeds[body.pairs])) for body in self._damped}


def _driven(part):
    """Whether a profile drives one of the rows of a joint."""
    return any(row.driven for row in rows_of(part.rows()) if isinstance(row, Row))


def _beyond_energy(own, t, x, v):
    """`sum f . v + dE/dt` of a force element, W: zero where its forces are those of its energy E."""
    power, pace = float(np.vdot(own.forces(t, x, v), v)), float(np.abs(v / own.sizes).max())
    if not pace:
        return 0.0
    return power + pace * float(along(lambda s: own.energy(x + s / pace * v), NEAR))
