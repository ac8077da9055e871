"""The model of a scene: one residual and one constraint vector, from compiled kernels."""

from contextlib import suppress
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polyida.assembly import equilibrium as compiled
from polyida.assembly.arrays import concatenated
from polyida.assembly.build import assemble, extent_of, of_kind, place_bodies
from polyida.assembly.corotated import SceneStepMatrix
from polyida.assembly.equilibrium import add_damping, blocks_at
from polyida.assembly.factors import given_factors, scaled
from polyida.assembly.increments import Increments
from polyida.assembly.independence import Redundant
from polyida.assembly.motion import velocity_at
from polyida.assembly.own_forces import Elastic, OwnForce, OwnForces
from polyida.assembly.own_laws import add_own_forces
from polyida.assembly.placement import dead_loads
from polyida.assembly.projection import MassSystem
from polyida.assembly.scene_bodies import SceneBodies, deepest
from polyida.force.force_element import ForceElement
from polyida.joint.formula import Row, rows_of
from polyida.linear.lu import dense
from polyida.linear.saddle import StepMatrix
from polyida.model import Needs
from polyida.model.differences import along
from polyida.profile import Profile
from polyida.validation import pairs_of

SMALL = 100  # largest n + m with dense matrices at the start and in adjoints: up to there sparse ones cost more in Python
NEAR = 1e-3  # of the size of its sides' places: range over which the energy of an element is differentiated; contacts are that shallow


class SceneModel(SceneBodies):
    """Bodies, joints, masses and forces as `r = M a + g + phi_q^T lam`, `phi(t, q)`; matrices are scipy.sparse.

    q are displacements of pairs (x, y): of the plates' nodes, m, then of the complex coordinates of bodies of few coordinates.

    bodies, few: the plates, and the other bodies, in order; places: {id: either}. arrays: all that the kernels read; laws: the compiled force
    elements and elastic forces, None if one is not compiled; own_forces: the same in Python. compiled: True if kernels can take whole steps.
    rows: {name: slice of phi and lam} of each joint and body with rows.
    """

    is_scene = has_constraint_increments = True
    switching = False  # True if a force element declares switches, by `gap`
    looks_apart = 1024  # without few: joints hold on to points of their own, and only motors turn rows

    def __init__(self, parts, gravity, redundant="refuse"):
        self.parts, self.treats_redundant, self._driven = dict(parts), redundant, (None, None)
        self.gravity = tuple(g if isinstance(g, Profile) else float(g) for g in gravity)
        self.bodies, self.few = place_bodies(parts)
        self.places = {id(body.plate): body for body in self.bodies} | {id(placed.user): placed for placed in self.few}
        self.extent = extent_of(self.bodies, self.few)
        self.n_nodes = [*self.bodies, *self.few][-1].pairs.stop
        self.n = 2 * self.n_nodes
        self._assemble()
        links, size = self.arrays.links, np.diff(self.arrays.links.vector_start)
        elements, elastic = of_kind(parts, ForceElement), [placed for placed in self.few if placed.elastic]
        self.damped = any(placed.damped for placed in (*self.bodies, *self.few))
        self.flexible = bool(self.bodies) or any(placed.deforms for placed in self.few)
        self.needs = Needs(
            mass_varies=False,
            velocity_forces=self.damped or bool(elements),
            driven=bool(len(self.motor_profiles) or len(self.path_profiles)),
            phi_q_varies=bool(((size[links.product_first] > 0) & (size[links.product_second] > 0)).any()),
        )
        self.reference = np.concatenate([body.points for body in self.bodies] + [pairs_of(placed.rest) for placed in self.few])
        forces = [*(OwnForce(name, element, self) for name, element in elements.items()), *(Elastic(own, self.n_nodes) for own in elastic)]
        self.own_forces = OwnForces(forces, self.n)
        self.switching = any(own.switches for own in forces)
        uneven = [body for body in self.few if body.uneven is not None]
        self.uneven_mass = _uneven([(body, 1.0) for body in uneven], self.n)
        self.uneven_drag = _uneven([(body, body.body.damping()[0]) for body in uneven], self.n)
        python = [placed.name for placed in self.few if placed.python]
        python += [name for name, element in elements.items() if not element.compiled_functions()]
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
        """Take arrays and rows of phi from the parts, without the rows with the numbers `left_out`."""
        assembled = assemble(self.bodies, self.few, self.places, self.parts, self.gravity, self.extent, left_out)
        self.arrays, points, table, drives, self.laws = assembled
        self.profiles, self.named_profiles = drives.profiles, tuple(zip(drives.names, drives.profiles))
        self.labels, self.units, self.rows, self.joints = table.labels, table.units, table.rows, table.joints
        self.m, self.n_points, self._derived, self._derived_of_shape, self._reactions = len(self.labels), len(points.nodes), {}, {}, {}
        links = self.arrays.links
        self.motor_profiles, self.path_profiles = np.unique(links.product_drive[links.product_drive >= 0]), np.unique(links.shift_drive)

    @property
    def free_fall(self):
        """|g|, m/s^2: the largest at the start and at kinks of profiles."""
        largest = [max(abs(g(t)) for t in (0.0, *g.kinks)) if isinstance(g, Profile) else abs(g) for g in self.gravity]
        return float(np.hypot(*largest))

    def __repr__(self):
        bodies, joints = len(self.bodies) + len(self.few), len(self.joints)
        return f"<SceneModel: n = {self.n}, m = {self.m}, {bodies} bod{'ies' if bodies != 1 else 'y'}, {joints} joint{'s' * (joints != 1)}>"

    def __reduce__(self):
        return _unpickled, (type(self), self.parts, self.gravity, self.treats_redundant, given_factors(self))

    @property
    def factors(self) -> dict[str, tuple[NDArray, NDArray]]:
        """{plate: (stiffness, mass)}, each (cells,): the factors of all full plates, 1 by default."""
        bodies: Any = self.bodies
        return {body.name: body.factors for body in bodies}

    def with_factors(self, /, **factors: tuple[ArrayLike | None, ArrayLike | None]) -> "SceneModel":
        """This model with factors of the plates' cells: `with_factors(arm=(stiffness, mass))`.

        Parameters
        ----------
        **factors : (stiffness, mass)
            For each plate that changes: two positive numbers, or arrays (cells,) of them, or None for 1. A factor refers to the full plate,
            whatever factors this model has. Other plates keep theirs.

        Returns
        -------
        SceneModel
            A model that shares with this one all that does not depend on factors.

        Raises
        ------
        InputError
            Names the plate and the value.

        Notes
        -----
        Stiffness scales the elastic force, its viscosity and the stabilisation of virtual elements; mass scales inertia, weight and
        mass-proportional damping. A cell with factor f in both is a cell of thickness f t. Stresses are those of the scaled material.
        """
        return scaled(self, factors)

    def evaluate(self, t, q, a, lam, rotation=None):
        """(r (n,), phi (m,), rotation, least det F, least motor cosine) in one compiled pass."""
        r, phi = np.empty((self.n_nodes, 2)), np.empty(self.m)
        rotation = np.empty((0, 2)) if rotation is None else rotation
        dz, forces = np.empty((2, self.n_points, 2))
        state = self.drives(t), self._nodal(q), self._nodal(a), self._flat(lam)
        det, cosine = compiled.equilibrium(self.arrays, *state, r, phi, rotation, dz, forces)
        return r.ravel(), phi, rotation, det, cosine

    def residual(self, t, q, v, a, lam):
        r = self._with_forces(t, q, v, self.evaluate(t, q, a, lam)[0])
        return r if self.uneven_mass is None else r + self.uneven_mass @ a

    def _with_forces(self, t, q, v, r):
        """Add damping and force elements to r, which `evaluate` omits."""
        if self.damped:
            add_damping(self.arrays, self._nodal(q), self._nodal(v), np.empty((self.n_nodes, 2)), r.reshape(-1, 2))
        if self.uneven_drag is not None:
            r += self.uneven_drag @ v
        if self.laws is None:
            self.own_forces.take_from(r, t, q, v)
            return r
        add_own_forces(self.laws, self.arrays.links, self.drives(t), self._nodal(q), self._nodal(v), r.reshape(-1, 2))
        if not np.isfinite(r).all():
            with suppress(Exception):  # the same in Python, so that `not_finite` names the function
                self.own_forces.take_from(r, t, q, v)
        return r

    def call_all(self, t, q, v):
        """Call each function of the user once."""
        self.own_forces.take_from(np.zeros(self.n), t, q, v), self.potential(q)

    def gaps(self, t, q):
        return self.own_forces.gaps(q) if self.switching else np.zeros(0)

    def gap_names(self):
        return self.own_forces.gap_names(np.zeros(self.n)) if self.switching else []

    @property
    def not_finite(self):
        return self.own_forces.not_finite

    def force(self, t, q, v):
        return self._with_forces(t, q, v, self.evaluate(t, q, np.zeros(self.n), np.zeros(self.m))[0])

    def initial_velocity(self, t, q):
        """The velocities that the user gave to the bodies, as far as the joints permit, (n,)."""
        return velocity_at(self, t, q)

    def force_q(self, t, q, v):
        return self._forces_q(t, q, v, 0.0, 1.0)

    def force_v(self, t, q, v):
        return self._forces_q(t, q, v, 1.0, 0.0)

    def _forces_q(self, t, q, v, c_v, c_q):
        """`c_v dg/dv + c_q dg/dq`, (n, n) sparse."""
        from scipy.sparse import bsr_array

        indptr, indices = self.pattern
        blocks = blocks_at(self, self._nodal(q), self._nodal(v), 0.0, c_v, c_q)
        bodies = bsr_array((blocks, indices, indptr), shape=(self.n, self.n)).tocsc()
        if self.uneven_drag is not None:
            bodies = bodies + c_v * self.uneven_drag
        return bodies if not self.own_forces else (bodies + self.own_forces.slopes(t, q, v, c_v, c_q)).tocsc()

    def mass_a_q(self, q, a):
        """d(M a)/dq: zero."""
        from scipy.sparse import csc_array

        return csc_array((self.n, self.n))

    def tangent(self, t, q, v, a, lam, c_m, c_v, c_q):
        """`c_m M + c_v dr/dv + c_q dr/dq`, (n, n) sparse; c_m and c_v are real or complex."""
        c_v, c_v_imag, c_q = map(float, (np.real(c_v), np.imag(c_v), c_q))
        result = self._forces_q(t, q, v, c_v, c_q) + c_m * self._mass
        if c_v_imag and self.needs.velocity_forces:
            result = result + 1j * c_v_imag * self.force_v(t, q, v)
        return (result + c_q * self.reaction_q(t, q, lam) if self.needs.phi_q_varies else result).tocsc()

    @property
    def small(self):
        """True if starts and adjoints take dense matrices."""
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
        """The system of M and phi_q, through the points of the joints if M is regular and equal for x and y."""
        return MassSystem(self, t, q) if self.solid else super().mass_system(t, q)

    def step_matrix(self):
        """The factor in the frame of the nodal rotations; the sparse one for scenes with Python forces, whose slopes the former omits."""
        return SceneStepMatrix(self) if self.compiled else StepMatrix(self)

    def increments(self, t0, t1, ends, h, q, v):
        """Change of the rows in a step, by exact differences."""
        return Increments(self, t0, t1, ends, h, q, v)

    def rotation(self, q):
        """Raw nodal rotations at q, (nodes, 2): area-weighted sums of (F11 + F22, F21 - F12)."""
        rotation = np.empty((self.n_nodes, 2))
        self.evaluate(0.0, q, np.zeros(self.n), np.zeros(self.m), rotation)
        return rotation

    def rejection_reason(self, t, q):
        """Why a state is rejected, or None: an element turned inside out, or a motor on the wrong half-turn."""
        _, _, _, det, cosine = self.evaluate(t, q, np.zeros(self.n), np.zeros(self.m))
        if not det > 0:
            where = deepest(self.bodies, self._nodal(q))
            return f"{where} is turned inside out (least det F {det:.3g}); St. Venant-Kirchhoff has collapsed in compression"
        if cosine > 0:
            return None
        return f"motor {self._flipped(t, q)!r} stands on the wrong half-turn (cosine of its angle error {cosine:.3g})"

    def potential(self, q):
        """Strain energy, energy of force elements and potential of gravity, J, relative to the reference configuration."""
        return sum(self.potentials(q))

    def potentials(self, q):
        """(potential of gravity and force elements, strain energy), J."""
        return self.gravity_potential(q) + self.own_forces.energy(q, strain=False), self.strain_energy(q)

    def strain_energy(self, q):
        """Elastic energy of all bodies, J."""
        return compiled.strain_energy(self.arrays, self._nodal(q)) + self.own_forces.energy(q, strain=True)

    def gravity_potential(self, q):
        """Potential of steady gravity on bodies and masses, J, zero at q = 0. Gravity that follows a profile does work instead."""
        at_points = self.arrays.links.point_mass @ (self.dz(q) @ self.arrays.links.gravity)
        return -float(np.sum(self.arrays.plates.weight * self._nodal(q)) + at_points)

    @property
    def dissipating(self):
        return self.once(Powers).dissipating

    def powers(self, t, q, v, lam):
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
        """First pair of each body, and the end, (bodies + 1,)."""
        return np.concatenate([self.arrays.plates.body_node, self.arrays.compact.pair[1:]])

    def once(self, make, of_shape=False):
        """make(self), computed once. of_shape: True if it does not depend on the factors of cells."""
        derived = self._derived_of_shape if of_shape else self._derived
        if make not in derived:
            derived[make] = make(self)
        return derived[make]


def _dense_mass(model):
    return model.mass().toarray()


def _unpickled(kind, parts, gravity, redundant, factors):
    model = kind(parts, gravity, redundant)
    return model.with_factors(**factors) if factors else model


def _uneven(masses, n):
    """Sum of factor times mass, (n, n) sparse, of (PlacedBody, factor) whose x and y have different masses; None if it is zero."""
    from scipy.sparse import csc_array, eye_array

    if not any(factor for _, factor in masses):
        return None
    result = csc_array((n, n))
    for body, factor in masses:
        place = eye_array(n, format="csr")[2 * body.pairs.start : 2 * body.pairs.stop]
        result = result + place.T @ csc_array(factor * body.uneven) @ place
    return result.tocsc()


class Powers:
    """{name: W} at an instant, of loads, of driven joints, of force elements beyond their energy, and of damping.

    A load has the power `f . v`, also gravity that follows a profile; a joint `lam . phi_t` of its rows (the force `-phi_q^T lam` on `v`, and
    `phi_q v = -phi_t`); an element `sum f . v + dE/dt`; damping of a plate a negative power. dissipating: names of those that only take energy.
    """

    def __init__(self, model):
        self.model = model
        self._loads, self._driven = dead_loads(model.parts, model.gravity, model.places), {}
        for name, part in model.joints.items():
            if any(row.driven for row in rows_of(part.rows()) if isinstance(row, Row)):
                self._driven[name] = model.rows[name]
        self._elements = [own for own in model.own_forces.each if not own.strain]
        self._damped = [placed for placed in (*model.bodies, *model.few) if placed.damped]
        self.dissipating = (*(own.name for own in self._elements if own.element.dissipates), *(body.name for body in self._damped))

    def __call__(self, t, q, v, lam):
        powers = {}
        for load in self._loads:
            powers[load.name] = powers.get(load.name, 0.0) + load.power(t, v)
        if self._driven:
            power = lam * self.model.phi_t(t, q)
            powers |= {name: float(power[rows].sum()) for name, rows in self._driven.items()}
        for own in self._elements:  # `sum f . v + dE/dt`, which is zero if its forces derive from its energy E
            x, speeds = own.places(q), own.velocities(v)
            power, pace = float(np.vdot(own.forces(t, x, speeds), speeds)), float(np.abs(speeds / own.sizes).max())
            if pace:
                power += pace * float(along(lambda s, own=own, x=x, step=speeds / pace: own.energy(x + s * step), NEAR))
            powers[own.name] = power if pace else 0.0
        if not self._damped:
            return powers
        u, speeds = q.reshape(-1, 2).copy(), v.reshape(-1, 2).copy()
        force = np.zeros_like(u)
        add_damping(self.model.arrays, u, speeds, np.empty_like(u), force)
        if self.model.uneven_drag is not None:
            force += (self.model.uneven_drag @ v).reshape(force.shape)
        return powers | {body.name: -float(np.vdot(force[body.pairs], speeds[body.pairs])) for body in self._damped}
