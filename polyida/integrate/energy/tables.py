"""The tables of models for the energy-momentum method: forces at the middle of a step, constraints at its end.

Scenes take the algorithmic stress of their elements. For users' models the work of the force at the middle is not the difference of the
potential; Gonzalez (J. Nonlinear Sci. 6 (1996) 449-467) adds the difference along M dq:

    M (v_1 - v_0)/h + g(t_m, q_m, v_m) + [V_1 - V_0 - V'] M dq / (dq^T M dq) + phi_q(q_m)^T lam = 0,     V' = grad V(q_m) . dq

Forces beyond the potential act at the middle. A constraint that is at most quadratic satisfies `phi_q(q_m) dq = phi_1 - phi_0` and does no
work. The matrix leaves out the derivative of the bracket, which is of second order in dq: Newton's method converges without.
"""

import numpy as np
from numba import carray

from polyida.assembly import equilibrium as kernels
from polyida.assembly import joints, reduced_kernels
from polyida.assembly.increments import drive_table
from polyida.assembly.optional import DAMPING, LAW_FORCES, LAW_MIDDLE, LAW_SLOPES, PARTS, RELAXING_MIDDLE
from polyida.assembly.own_laws import NOISE, POINTS, add_midpoint_forces
from polyida.assembly.relaxation import add_relaxation_middle
from polyida.assembly.scene_bodies import inverse_masses
from polyida.element import kernels as elements
from polyida.element import viscous_midpoint
from polyida.element.operator import Material
from polyida.errors import DONE, INVERTED, NOT_FINITE
from polyida.jit import entry, part, served
from polyida.jit.intrinsics import call, pointer
from polyida.linear.dense import clear
from polyida.model.functions import OF_STEPS
from polyida.system import ACCELERATION, ACCEPT, FACTOR, INSTANTS, MIDDLE, PROJECT, RATE, SOLVE
from polyida.system.dense import INNER
from polyida.system.own import DenseTable, PythonTable, small_own
from polyida.system.scene import OneFactorScene, entries
from polyida.system.scene_functions import DV, DX, START, VX, idle, pairs, renew_slopes, rows

ENDS = 2 * INSTANTS  # first instant of frames, behind those of steps
AT_MIDDLE, AT_END = range(2)  # stages of a step: numbers of work.dz and work.rotation
OF_ENERGY = (*OF_STEPS, "potential")


def table_of(model):
    """The table of a model with the entries of the method."""
    if model.is_scene:
        return EnergyTable(model) if model.compiled else PythonScene(model)
    if not small_own(model):
        return PythonOwn(model)
    return DenseOwn(model)


def discrete_derivative(potential, x0, x1, metric):
    """`[V_1 - V_0 - V'] M dx / (dx^T M dx)` from x0 to x1, (n,); zero if it is round-off.

    x0, x1, metric = M dx: (n,). V' is integrated from central differences; POINTS are their (s, weight).
    """
    dx, middle = x1 - x0, 0.5 * (x0 + x1)
    size, first, last = np.vdot(dx, metric), potential(x0), potential(x1)
    work = sum(weight * (potential(middle + s * dx) - potential(middle - s * dx)) / (2.0 * s) for s, weight in POINTS)
    bracket = last - first - work
    if not size > 0.0 or abs(bracket) <= NOISE * max(abs(first), abs(last)):
        return np.zeros_like(dx)
    return bracket / size * metric


class MiddleTable:
    """Mixed into tables with instants of a step's middle and end.

    complete: True if the table itself computes v, a and lam of frames, by its entries RATE, PROJECT and ACCELERATION.

    `prepare` takes `last`, not the pair `ends` of PythonTable: a step's beginning is never evaluated.
    """

    instants = 3 * INSTANTS
    complete = False

    def prepare(self, times, last, h):
        """Prepare steps between the times; last: the last time, or one beside it at a kink."""
        steps, self.h, at = len(times) - 1, h, np.repeat(times[1:], 2)
        at[::2] -= 0.5 * h
        self.times[: 2 * steps] = at[:, None]
        self.times[2 * steps - 1, INNER] = last

    def prepare_ends(self, times, last):
        """Prepare frames at the times. Returns the number of the first one's instant."""
        end = ENDS + len(times)
        self.times[ENDS:end] = times[:, None]
        self.times[end - 1, INNER] = last
        return ENDS

    def _entries(self):
        """{number of an entry: method} of the table, with MIDDLE for the middle of a step."""
        return super()._entries() | {MIDDLE: self._middle}


class PythonOwn(MiddleTable, PythonTable):
    """The table of a user's model in Python that is large or solves its systems itself."""

    def _middle(self, instant, states, lam, r, phi, *_):
        """Write r in the middle of a step, with the discrete derivative of the potential, and phi at its end."""
        model, (t, _), (end, _) = self.model, self._at(instant - 1), self._at(instant)
        x0, x1, q, v, a = self._array(states, 5 * model.n).copy().reshape(5, -1)
        residual, constraints = self._array(r, model.n), self._array(phi, model.m)
        residual[:], constraints[:] = model.residual(t, q, v, a, self._array(lam, model.m).copy()), model.phi(end, x1)
        residual += discrete_derivative(model.potential, x0, x1, model.mass(q) @ model.without_states(x1 - x0))
        return DONE if np.isfinite(residual).all() and np.isfinite(constraints).all() else NOT_FINITE


class DenseOwn(MiddleTable, DenseTable):
    """The table of a user's small model. If numba compiles it and nothing is driven, the table makes v, a and lam of frames."""

    names, entries = OF_ENERGY, (MIDDLE, FACTOR, SOLVE, RATE, PROJECT, ACCEPT)

    def __init__(self, model):
        """Make the table of a user's model and choose its entries; compiled models without drives get the entry ACCELERATION too."""
        super().__init__(model)
        self.complete = model.by_numba and not model.needs.driven
        if self.complete:
            self.entries = (*self.entries, ACCELERATION)
        self.serve()

    def _functions(self, work):
        """The functions of a small model, and its potential at work.q."""

        def potential(*_):
            """Write the potential at work.q, J, to work.x[0]."""
            work.x[0] = self.model.potential(work.q.copy())

        return super()._functions(work) | {"potential": self._protected(potential)}


@part
def states_of(work, at):
    """Displacements at both ends, and displacements, velocities and accelerations of the middle at an address, (5, nodes, 2)."""
    return carray(pointer(at), (5, *work.still.shape))


@part
def middle(work, instant, states, lam, residual, phi):
    """Fill the residual of a scene at the middle of a step, whose instant is the one before that of its end, and phi at the end."""
    links, points, drives, h = work.scene.links, work.points, work.drives[instant - 1], work.h[0]
    dz, rotation = work.dz[AT_END], work.rotation[AT_END]
    least = equilibrium(work.scene, drives, h, states, lam, phi, points[DX], work.forces, residual, rotation)
    if not least > 0.0:
        return INVERTED if least <= 0.0 else NOT_FINITE
    if work.optional[RELAXING_MIDDLE] != 0:
        call(work.optional[RELAXING_MIDDLE], (work.optional[PARTS], states[0], states[1], states[2], states[3], residual))
    joints.point_values(links, states[1], dz)
    status = add_elements(work, drives, h, states, dz, residual)
    work.cosine[0] = joints.joint_forces(links, work.drives[instant], dz, work.level, phi, points[DV])
    return status


@part
def add_elements(work, drives, h, states, dz, residual):
    """Add force elements to the residual, and renew their slopes. Returns a status.

    1. START and VX: places at the begin, velocities of the middle. 2. DX: h/2 a. 3. Forces. 4. DX: places of the middle, for the slopes. So points[DX]
    first holds h/2 times the accelerations, then the places of the middle; dz holds those of the end.
    """
    links, optional, points, status = work.scene.links, work.optional, work.points, DONE
    if optional[LAW_MIDDLE] != 0:
        joints.point_values(links, states[0], points[START])
        joints.point_values(links, states[3], points[VX])
        joints.point_values(links, states[4], points[DX])
        half = points[DX]
        for p in range(half.shape[0]):
            for k in range(2):
                half[p, k] *= 0.5 * h
        clear(work.forces)
        status = call(optional[LAW_MIDDLE], (optional[PARTS], drives, points[START], dz, points[VX], half, work.forces))
        joints.spread(links, work.forces, residual)
        joints.point_values(links, states[2], points[DX])
        renew_slopes(work, drives, points[DX], points[VX])
    return status


@entry
def equilibrium(scene, drives, h, states, lam, phi, dz, forces, residual, rotation):
    """Fill the residual (nodes, 2) except for force elements and relaxation. Returns the least det F at the end.

    states (5, nodes, 2): displacements at both ends, and at the middle with their velocities and accelerations. phi (m,), dz and forces
    (points, 2) are workspace; rotation (nodes, 2) as of the equilibrium of a state.
    """
    plates, um, a = scene.plates, states[2], states[4]
    for i in range(residual.shape[0]):
        residual[i, 0], residual[i, 1] = -plates.weight[i, 0], -plates.weight[i, 1]
    clear(rotation)
    least_of_reduced = reduced_kernels.forces_middle(scene.reduced, h, states, residual, rotation)
    kernels.hold_strains(scene.relaxation, a, residual, rotation)
    least = reduced_kernels.lesser(plates_middle(plates, h, states, residual, rotation), least_of_reduced)
    kernels.add_loads_and_joints(plates, scene.links, drives, um, a, lam, phi, dz, forces, residual)
    return least


@part
def plates_middle(plates, h, states, residual, rotation):
    """Add inner, inertia and damping forces of all plates to the residual. Returns the least det F. states: as of `equilibrium`."""
    u0, u1, um, vm, a, least = states[0], states[1], states[2], states[3], states[4], 1e300
    for b in range(plates.body_operator.shape[0]):
        o, n0, density = plates.body_operator[b], plates.body_node[b], plates.body_density[b]
        material = Material(plates.membrane_stiffness[b], plates.body_nu[b], plates.body_viscosity[b] / h)
        least = reduced_kernels.lesser(
            least, viscous_midpoint.internal_force_midpoint(kernels.cells_of(plates, b), material, u0, u1, residual, rotation)
        )
        elements.mass_product(*kernels.on_pattern(plates, o, plates.mass), density, n0, a, residual)
        if plates.body_drag[b] != 0.0:
            elements.mass_product(*kernels.on_pattern(plates, o, plates.mass), plates.body_drag[b] * density, n0, vm, residual)
        if plates.body_stabilisation[b] != 0.0:
            elements.stabilisation_force(
                *kernels.on_pattern(plates, o, plates.stabilisation), plates.body_stabilisation[b], n0, um, residual
            )
    return least


SCENE_MIDDLE = served(middle, states_of, rows, pairs, rows)


class EnergyTable(OneFactorScene):
    """The table of a scene without Python; it makes v, a and lam of frames if no body is a plate and none is viscoelastic."""

    def __init__(self, model):
        """Choose the kernels and entries that the scene needs."""
        reduced_kernels.provide(model.arrays.reduced, reduced_kernels.MIDDLE)
        self.complete, options = not (model.bodies or model.strains or model.slipping), {}
        if self.complete:
            options["inverse"] = model.once(inverse_masses)
        middle_and_end, instants = np.array([0.5, 1.0]), np.arange(3 * INSTANTS)  # instants 2k and 2k + 1: middle and end of step k
        kernels = LAW_FORCES, LAW_SLOPES, LAW_MIDDLE, RELAXING_MIDDLE, DAMPING
        super().__init__(model, middle_and_end, instants % 2, np.zeros_like(instants), kernels, **options)
        self.entries = entries(SOLVE, ACCEPT) | {MIDDLE: SCENE_MIDDLE}
        if model.m > 0 and (not model.bodies or model.needs.driven or model.velocity_rows.size > 0):
            self.entries |= entries(RATE, PROJECT)
        else:
            self.entries |= {RATE: idle, PROJECT: idle}
        if self.complete:
            self.entries |= entries(ACCELERATION)

    def prepare(self, times, last, h):
        """Prepare steps between the times; last: the last time, or one beside it at a kink."""
        at = np.repeat(times[1:], 2)
        at[::2] = times[1:] - 0.5 * h
        self.w["drives"][: len(at)], self.w["h"][0] = drive_table(self.model, at, (at[0], last)), h

    def prepare_ends(self, times, last):
        """Prepare frames at the times. Returns the number of the first one's instant."""
        ends = (last if len(times) == 1 else times[0]), last
        self.w["drives"][ENDS : ENDS + len(times)] = drive_table(self.model, times, ends)
        return ENDS


class PythonScene(MiddleTable, PythonTable):
    """The table of a scene whose bodies have masses that differ in x and y, or lack some. Each force is that of the compiled table."""

    def __init__(self, model):
        """Make the arrays of the middle of a step."""
        super().__init__(model)
        reduced_kernels.provide(model.arrays.reduced, reduced_kernels.MIDDLE)
        self.rotation, self.points = np.zeros((model.n_nodes, 2)), np.zeros((2, model.n_points, 2))

    def _middle(self, instant, states, lam, r, phi, *_):
        """Write r of the scene in the middle of a step and phi at its end, by the compiled functions of its parts."""
        model, (t, _), (end, _) = self.model, self._at(instant - 1), self._at(instant)
        vectors, constraints = self._array(states, 5 * model.n).copy().reshape(5, -1), self._array(phi, model.m)
        out, lam = self._array(r, model.n).copy().reshape(-1, 2), self._array(lam, model.m).copy()
        fields, scratch = vectors.reshape(5, -1, 2), constraints.copy()
        det = equilibrium(model.arrays, model.drives(t), self.h, fields, lam, scratch, *self.points, out, self.rotation)
        if not det > 0.0:
            return INVERTED if det <= 0.0 else NOT_FINITE
        if model.strains:
            add_relaxation_middle(model.arrays, *fields[:4], out)
        if model.own_forces:
            add_midpoint_forces(model.laws, model.arrays.links, model.drives(t), self.h, fields, out)
            model.raise_error()
        (_, u1, _, vm, a), residual = vectors, out.ravel()
        if model.uneven_mass is not None:
            residual += model.uneven_mass @ a
        if model.uneven_drag is not None:
            residual += model.uneven_drag @ vm
        self._array(r, model.n)[:], constraints[:] = residual, model.phi(end, u1)
        return DONE if np.isfinite(residual).all() and np.isfinite(constraints).all() else NOT_FINITE
