"""The model of a scene: one residual and one constraint vector, from compiled kernels."""

from contextlib import suppress
from functools import cached_property
from heapq import merge
from itertools import count, dropwhile, takewhile
from math import floor

import numpy as np

from polyida.assembly import equilibrium as compiled
from polyida.assembly.arrays import concatenated
from polyida.assembly.build import assemble, extent_of, of_kind, place_bodies, place_states
from polyida.assembly.equilibrium import add_damping, blocks_at
from polyida.assembly.factors import given_factors
from polyida.assembly.increments import Increments
from polyida.assembly.motion import velocity_at
from polyida.assembly.own_forces import Elastic, OwnForce, slope_entries, slopes_of, take_from
from polyida.assembly.own_laws import add_own_forces
from polyida.assembly.projection import MassSystem
from polyida.assembly.relaxation import add_relaxation
from polyida.assembly.relaxation_slopes import slope_entries as relaxation_entries
from polyida.assembly.scaled_scene import ScaledScene
from polyida.assembly.scene_bodies import deepest
from polyida.assembly.scene_energies import SceneEnergies
from polyida.assembly.scene_modes import SceneModes
from polyida.assembly.scene_step_matrix import SceneStepMatrix
from polyida.force.force_element import ForceElement
from polyida.linear.lu import dense, summed
from polyida.linear.saddle import StepMatrix
from polyida.model import Needs
from polyida.model.row_laws import require_no_laws
from polyida.profile import Profile
from polyida.validation import pairs_of

SMALL = 100  # largest n + m with dense matrices at the start and in adjoints: up to there sparse ones cost more in Python
SAME_TIME = 1e-9  # of a period: distance of a time from a sample that is round-off
SECOND = 1.0  # s: time in which a state of typical size passes the scene's extent, without gravity


class SceneModel(ScaledScene, SceneEnergies, SceneModes):
    """Bodies, joints, masses and forces as `r = M a + g + phi_q^T lam`, `phi(t, q)`; matrices are scipy.sparse.

    q are displacements of pairs (x, y): of the plates' nodes, m, then of the complex coordinates of bodies of few coordinates.

    bodies, reduced_bodies: the plates, and the bodies of few coordinates, in the order of q; places: {id: either}. arrays: all that the
    kernels read; laws: the force elements and elastic forces for kernels, which call functions in Python by `callbacks`; own_forces: the same
    for Python. compiled: True if kernels can take whole steps. rows: {name: slice of phi and lam} of each joint and body with rows. late:
    names of the parts that events add, or None without events; see `mode` (scene_modes.py).

    Caches, each valid for one value of its key: `_driven` (t, table of the profiles), `_facing` (dz as bytes, Links with the edges that face
    each other there), `_rotated` [(q, rotation)], shared with copies, `_modes` {parts or rows: model}, `_derived` and `_derived_of_shape`
    {(function, options): result} of `once`, `_reactions` {(name, whole): Reaction}. `_assembled` is (held, left_out) of the last `_assemble`.
    """

    is_scene = has_constraint_increments = True
    switching = False  # True if a force element declares switches, by `gap`
    looks_apart = (
        1024  # steps between proofs that the rows of phi_q are independent: joints hold on to points of their own, only motors turn rows
    )

    def __init__(self, parts, gravity, redundant="refuse", without_strains=False, late=None):
        """Place the parts {name: part} of a scene.

        redundant, without_strains: as for Scene.build. late: names of parts that only events add.
        """
        self.parts = dict(parts)
        self.treats_redundant = redundant
        self.without_strains = without_strains
        self.late = late
        self.gravity = tuple(g if isinstance(g, Profile) else float(g) for g in gravity)
        self._modes = {}
        self._rotated = [(None, None)]  # q and its rotations, also of models with other rows
        self._place()
        self._take_kinds()
        self._use_parts(self._late_joints())
        if redundant == "least-norm":
            require_no_laws("Scene.build", self, 'redundant="least-norm" is for equations alone; redundant contacts need none')
        if redundant == "least-norm" and late is None:
            self._leave_out_redundant(0.0, np.zeros(self.n))

    def _place(self):
        """Place the bodies and states of the parts, and number their coordinates: of plates, of bodies of few coordinates, states, strains."""
        placed_bodies = place_bodies(self.parts)
        self.bodies = [placed for placed in placed_bodies if placed.is_full]
        self.reduced_bodies = [placed for placed in placed_bodies if not placed.is_full]
        self.places = {id(placed.user): placed for placed in placed_bodies}
        self.extent = extent_of(placed_bodies)
        self.state_speed = float(np.sqrt(self.free_fall * self.extent) or self.extent / SECOND)
        self.states, self.strains = place_states(self.parts, placed_bodies, self.state_speed, self.without_strains)
        self.places |= {id(placed): placed for placed in self.states.values()}
        self.n_factored = [*placed_bodies, *self.states.values()][-1].pairs.stop
        self.n_nodes = list(self.strains.values())[-1].pairs.stop if self.strains else self.n_factored
        self.n = 2 * self.n_nodes
        all_states = [*self.states.values(), *self.strains.values()]
        self.state_columns = concatenated([placed.columns for placed in all_states], np.int64)
        self.state_units = concatenated([placed.units for placed in all_states], float)
        self.state_start = concatenated([placed.start for placed in all_states], float) / self.state_units
        self.k = len(self.state_columns)
        behind_plates = [*self.reduced_bodies, *all_states]
        self.reference = np.concatenate([body.points for body in self.bodies] + [pairs_of(placed.rest) for placed in behind_plates])

    def _take_kinds(self):
        """Set what depends on the kinds of the bodies: damping, masses that differ in x and y, units."""
        self.damped = any(placed.damped for placed in [*self.bodies, *self.reduced_bodies])
        self.flexible = bool(self.bodies) or any(placed.deforms for placed in self.reduced_bodies)
        uneven = [body for body in self.reduced_bodies if body.uneven is not None]
        self.uneven_mass = _uneven([(body, 1.0) for body in uneven], self.n)
        self.uneven_drag = _uneven([(body, body.body.damping()[0]) for body in uneven], self.n)
        self.solid = not any(placed.massless for placed in self.reduced_bodies) and self.uneven_mass is None
        self.uniform_units = not (self.reduced_bodies or self.strains)

    def _use_parts(self, held, left_out=()):
        """Take from the parts all that depends on which of them act. held: {name: joint as it holds}; left_out: rows to omit."""
        self._assemble(held, left_out)
        elements, elastic = of_kind(self.parts, ForceElement), [placed for placed in self.reduced_bodies if placed.elastic]
        functions = iter([one.functions for one in self.callbacks])
        forces = [OwnForce(name, element, self, next(functions)) for name, element in elements.items()]
        self.own_forces = (*forces, *(Elastic(own, self.n_nodes, next(functions)) for own in elastic))
        self.switching = any(own.switches for own in self.own_forces)
        self.controllers = [own for own in self.own_forces if own.period]
        self.compiled = self.solid
        if self.reduced_bodies:
            self.looks_apart = 1
        self.remark = self._remark_on_speed()

    def _remark_on_speed(self):
        """Return the note that names bodies and elements for which compiled steps cannot be used, or are slow; empty if there are none."""
        plain = [placed.name for placed in self.reduced_bodies if placed.massless or placed.uneven is not None]
        python = [one.functions.name for one in self.callbacks if one.addresses.keys() - {"energy"}]
        why = (("plain paths for the masses of", plain), ("calls in every step of the Python of", python))
        return " and ".join(f"{what} {', '.join(map(repr, names))}" for what, names in why if names)

    def _assemble(self, held, left_out=()):
        """Take arrays and rows of phi from the parts, without the rows with the numbers `left_out`.

        held: {name: joint} of joints that need not hold in the reference configuration, in the form in which they hold.
        """
        self._assembled = held, list(left_out)
        assembled = assemble(self.all_bodies, self.states, self.strains, self.places, self.parts, self.gravity, self.extent, left_out, held)
        self._driven = None, None
        self.arrays, points, table, drives, self.laws, self.callbacks = assembled
        self.profiles = drives.profiles
        self.named_profiles = tuple(zip(drives.names, drives.profiles))
        self.labels = table.labels
        self.units = table.units
        self.rows = table.rows
        self.joints = table.joints
        self.m = len(self.labels)
        self.n_points = len(points.nodes)
        self.row_laws = tuple(table.laws)
        self.edge_rows = table.edges
        self._use_links(self.arrays.links)

    def _use_links(self, links):
        """Set the Links, and all that depends on them."""
        self.arrays, self._facing = self.arrays._replace(links=links), (b"", links)
        self._derived, self._derived_of_shape, self._reactions = {}, {}, {}
        self.velocity_rows, size = links.velocity_rows, np.diff(links.vector_start)
        self.motor_profiles, self.path_profiles = np.unique(links.product_drive[links.product_drive >= 0]), np.unique(links.shift_drive)
        self.needs = Needs(
            mass_varies=False,
            velocity_forces=self.damped or bool(of_kind(self.parts, ForceElement) or self.strains),
            driven=bool(len(self.motor_profiles) or len(self.path_profiles) or links.row_constant[self.velocity_rows].any()),
            phi_q_varies=bool(self.edge_rows or ((size[links.product_first] > 0) & (size[links.product_second] > 0)).any()),
        )

    @property
    def free_fall(self):
        """|g|, m/s^2: the largest at the start and at kinks of profiles."""
        largest = [max(abs(g(t)) for t in (0.0, *g.kinks)) if isinstance(g, Profile) else abs(g) for g in self.gravity]
        return float(np.hypot(*largest))

    def __repr__(self):
        """Return the numbers of coordinates, rows of phi, bodies and joints, in one line."""
        bodies, joints = len(self.all_bodies), len(self.joints)
        return f"<SceneModel: n = {self.n}, m = {self.m}, {bodies} bod{'ies' if bodies != 1 else 'y'}, {joints} joint{'s' * (joints != 1)}>"

    def __reduce__(self):
        """Return what pickle needs to make the model again: its parts, options and factors of cells."""
        arguments = self.parts, self.gravity, self.treats_redundant, self.without_strains, self.late
        return _unpickled, (type(self), *arguments, given_factors(self))

    def evaluate(self, t, q, a, lam, rotation=None):
        """(r (n,), phi (m,), rotation, least det F, least motor cosine) in one compiled pass."""
        r, phi = np.empty((self.n_nodes, 2)), np.empty(self.m)
        rotation = np.empty((0, 2)) if rotation is None else rotation
        dz, forces = np.empty((2, self.n_points, 2))
        state = self.drives(t), self._nodal(q), self._nodal(a), self._flat(lam)
        arrays = self.arrays._replace(links=self._links(self.dz(q))) if self.edge_rows else self.arrays
        det, cosine = compiled.equilibrium(arrays, *state, r, phi, rotation, dz, forces)
        return r.ravel(), phi, rotation, det, cosine

    def residual(self, t, q, v, a, lam):
        """Return `r = M a + g + phi_q^T lam`, (n,), and keep the nodal rotations at q."""
        r, _, rotation, *_ = self.evaluate(t, q, a, lam, np.empty((self.n_nodes, 2)))
        r, self._rotated[0] = self._with_forces(t, q, v, r), (np.array(q), rotation)
        return r if self.uneven_mass is None else r + self.uneven_mass @ a

    def _with_forces(self, t, q, v, r):
        """Add to r, in place, what the compiled residual leaves out: damping, relaxation and force elements at (t, q, v). Returns r."""
        if self.damped:
            add_damping(self.arrays, self._nodal(q), self._nodal(v), np.empty((self.n_nodes, 2)), r.reshape(-1, 2))
        if self.uneven_drag is not None:
            r += self.uneven_drag @ v
        if self.strains:
            add_relaxation(self.arrays, self._nodal(q), None, self._nodal(v), 1.0, r.reshape(-1, 2))
        if not self.own_forces:
            return r
        self.callbacks[0].calls.known.clear()
        add_own_forces(self.laws, self.arrays.links, self.drives(t), self._nodal(q), self._nodal(v), r.reshape(-1, 2))
        self.raise_error()
        if not np.isfinite(r).all():
            with suppress(Exception):  # the same in Python, so that `not_finite` names the function
                take_from(r, self.own_forces, t, q, v)
        return r

    def take_error(self):
        """What a Python function of a part raised in compiled code that has returned, or None."""
        return self.callbacks[0].calls.take_error() if self.callbacks else None

    def raise_error(self):
        """Raise what a Python function of a part raised in compiled code that has returned."""
        if (error := self.take_error()) is not None:
            raise error

    def call_all(self, t, q, v):
        """Call the force and energy of each own force element once at (t, q, v), and drop the results: what they raise shows early."""
        take_from(np.zeros(self.n), self.own_forces, t, q, v)
        for own in self.own_forces:
            own.energy(own.places(q), own.velocities(v))

    @property
    def hidden(self):
        """Columns of q of all first-order states and of the relaxing strains of viscoelastic plates, (k,) int."""
        placed = [*self.states.values(), *self.strains.values()]
        return np.concatenate([np.zeros(0, np.int64), *(np.arange(2 * one.pairs.start, 2 * one.pairs.stop) for one in placed)])

    def samples(self, t0, t1):
        """Return the sorted times in (t0, t1) at which controllers sample."""

        def of_period(period):
            """The multiples of a period, s, that lie in (t0, t1), sorted."""
            times = (k * period for k in count(floor(t0 / period)))
            return takewhile(lambda t: t < t1, dropwhile(lambda t: t <= t0, times))

        return merge(*map(of_period, {own.period for own in self.controllers}))

    def sampled(self, t, q, v):
        """Return v with the outputs of the controllers that sample at t; v itself if there are none."""
        due = [own for own in self.controllers if abs(round(t / own.period) * own.period - t) <= SAME_TIME * own.period]
        if not due:
            return v
        after = v.copy()
        for own in due:
            own.sample(t, q, v, after)
        return after

    def gaps(self, t, q):
        """Return the switching functions (k,) of the force elements at q, such as distances."""
        return np.concatenate([own.gaps(q) for own in self.own_forces if own.switches]) if self.switching else np.zeros(0)

    def gap_names(self):
        """Return for each of `gaps` the name of its force element, in quotes."""
        return [repr(own.name) for own in self.own_forces if own.switches for _ in own.gaps(np.zeros(self.n))]

    @property
    def not_finite(self):
        """The functions of force elements that last gave numbers that are not finite, in words; empty if none did."""
        return " and ".join(own.not_finite for own in self.own_forces if own.not_finite)

    def force(self, t, q, v):
        """Return the force g, (n,): r at a = 0 and lam = 0, with damping and force elements."""
        return self._with_forces(t, q, v, self.evaluate(t, q, np.zeros(self.n), np.zeros(self.m))[0])

    def force_change(self, t, q, before, after):
        """`force(t, q, after) - force(t, q, before)` of two velocities, without the forces that do not depend on them."""
        return self._with_forces(t, q, after, np.zeros(self.n)) - self._with_forces(t, q, before, np.zeros(self.n))

    def initial_velocity(self, t, q):
        """The velocities that the user gave to the bodies, as far as the joints permit, and the start of states, (n,)."""
        v = velocity_at(self, t, q)
        v[self.state_columns] = self.state_start
        return v

    def force_q(self, t, q, v):
        """Return the derivative dg/dq of the force, (n, n) sparse."""
        return self._forces_q(t, q, v, 0.0, 1.0)

    def force_v(self, t, q, v):
        """Return the derivative dg/dv of the force, (n, n) sparse."""
        return self._forces_q(t, q, v, 1.0, 0.0)

    def _forces_q(self, t, q, v, c_v, c_q):
        """`c_v dg/dv + c_q dg/dq`, (n, n) sparse."""
        return summed(self._slope_entries(t, q, v, c_v, c_q), self.n)

    def _slope_entries(self, t, q, v, c_v, c_q):
        """[(rows, columns, values)] of `c_v dg/dv + c_q dg/dq`."""
        entries = [(*self._block_entries, blocks_at(self, self._nodal(q), self._nodal(v), 0.0, c_v, c_q).ravel())]
        if self.uneven_drag is not None:
            drag = self.uneven_drag.tocoo()
            entries.append((drag.row, drag.col, c_v * drag.data))
        if self.strains:
            entries += relaxation_entries(self, q, c_v, c_q)
        return entries + slope_entries(self.own_forces, t, q, v, c_v, c_q)

    @cached_property
    def _block_entries(self):
        """(rows, columns) of the entries of `blocks_at`."""
        (indptr, indices), both = self.pattern, np.arange(2)
        rows = np.repeat(np.arange(len(indptr) - 1), np.diff(indptr))
        at = np.broadcast_arrays(2 * rows[:, None, None] + both[:, None], 2 * indices[:, None, None] + both)
        return tuple(each.ravel() for each in at)

    def mass_a_q(self, q, a):
        """Return d(M a)/dq, (n, n), zero: M is constant."""
        from scipy.sparse import csc_array

        return csc_array((self.n, self.n))

    def tangent(self, t, q, v, a, lam, c_m, c_v, c_q):
        """`c_m M + c_v dr/dv + c_q dr/dq`, (n, n) sparse; c_m and c_v are real or complex."""
        c_v, c_v_imag, c_q = map(float, (np.real(c_v), np.imag(c_v), c_q))
        mass = self._mass.tocoo()
        result = summed([*self._slope_entries(t, q, v, c_v, c_q), (mass.row, mass.col, c_m * mass.data)], self.n)
        if c_v_imag and self.needs.velocity_forces:
            result = result + 1j * c_v_imag * self.force_v(t, q, v)
        return (result + c_q * self.reaction_q(t, q, lam) if self.needs.phi_q_varies else result).tocsc()

    @property
    def small(self):
        """True if starts and adjoints take dense matrices."""
        return self.n + self.m <= SMALL and not self.strains

    def small_mass(self):
        """The mass matrix of a small scene as a dense array."""
        return self.once(_dense_mass)

    def small_tangent(self, t, q, v, lam):
        """dr/dq of a small scene as a dense array."""
        (indptr, indices), result = self.pattern, np.zeros((self.n, self.n))
        pairs = np.repeat(np.arange(self.n_nodes), np.diff(indptr))
        blocks = blocks_at(self, self._nodal(q), self._nodal(v), 0.0, 0.0, 1.0)
        # result as (pairs, 2, pairs, 2): the block of a pair of pairs
        result.reshape(self.n_nodes, 2, self.n_nodes, 2)[pairs, :, indices, :] = blocks
        if self.own_forces:
            result += dense(slopes_of(self.own_forces, t, q, v, 0.0, 1.0))
        if self.needs.phi_q_varies:
            result += self._small_points.T @ self._sparse_curvature(t, lam) @ self._small_points
        return result

    def mass_system(self, t, q):
        """The system of M and phi_q, through the points of the joints if M is regular and equal for x and y."""
        return MassSystem(self, t, q) if self.solid else super().mass_system(t, q)

    def step_matrix(self):
        """The factor in the frame of the nodal rotations; the sparse one for masses that differ in x and y, or are missing."""
        return SceneStepMatrix(self) if self.compiled else StepMatrix(self)

    def increments(self, t0, t1, ends, h, q, v):
        """Change of the rows in a step, by exact differences."""
        return Increments(self, t0, t1, ends, h, q, v)

    def rotation(self, q):
        """Raw nodal rotations at q, (nodes, 2): area-weighted sums of (F11 + F22, F21 - F12)."""
        at, rotation = self._rotated[0]
        if not np.array_equal(at, q):  # several solves at one q, as at a sample, need it
            rotation = np.empty((self.n_nodes, 2))
            self.evaluate(0.0, q, np.zeros(self.n), np.zeros(self.m), rotation)
            self._rotated[0] = np.array(q), rotation
        return rotation.copy()

    def rejection_reason(self, t, q):
        """Why a state is rejected, or None: an element turned inside out, or a motor on the wrong half-turn."""
        _, _, _, det, cosine = self.evaluate(t, q, np.zeros(self.n), np.zeros(self.m))
        if not det > 0:
            where = deepest(self.bodies, self._nodal(q))
            return f"{where} is turned inside out (least det F {det:.3g}); St. Venant-Kirchhoff has collapsed in compression"
        if cosine > 0:
            return None
        return f"motor {self._flipped(t, q)!r} stands on the wrong half-turn (cosine of its angle error {cosine:.3g})"

    @cached_property
    def pattern(self):
        """(indptr, indices) of the pairs' block pattern, int32: of the plates' nodes, and of all pairs of each other body."""
        s, indptr, indices = self.arrays.plates, [np.zeros(1, np.int32)], []
        for body, first in zip(self.bodies, s.body_block):
            indptr.append(body.operator.indptr[1:] + np.int32(first))
            indices.append(body.operator.indices + np.int32(body.nodes.start))
        for placed, first in zip([*self.reduced_bodies, *self.states.values()], self.arrays.reduced.block):
            pairs = np.arange(placed.pairs.start, placed.pairs.stop)
            indptr.append((first + len(pairs) * np.arange(1, len(pairs) + 1)).astype(np.int32))
            indices.append(np.tile(pairs, len(pairs)))
        return np.concatenate(indptr), concatenated(indices, np.int32)

    @cached_property
    def first_pairs(self):
        """First pair of each body, and the end, (bodies + 1,)."""
        return np.concatenate([self.arrays.plates.body_node, self.arrays.reduced.pair[1:]])

    def once(self, make, of_shape=False, **options):
        """make(self, **options), computed once. of_shape: True if it does not depend on the factors of cells."""
        derived, key = self._derived_of_shape if of_shape else self._derived, (make, *options.items())
        if key not in derived:
            derived[key] = make(self, **options)
        return derived[key]


def _dense_mass(model):
    """M of a scene as a dense array, (n, n)."""
    return model.mass().toarray()


def _unpickled(kind, parts, gravity, redundant, without_strains, late, factors):
    """The model of a class made from parts, options and factors of cells, for pickle."""
    model = kind(parts, gravity, redundant, without_strains, late)
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
