"""The tables of scenes for the energy-momentum method: their forces at the middle of a step, constraints at the end."""

import numpy as np
from numba import carray

from polyida.assembly import compact, joints
from polyida.assembly import equilibrium as kernels
from polyida.assembly.increments import drive_table
from polyida.assembly.own_laws import take_midpoint_forces
from polyida.assembly.projection import constrain
from polyida.element import kernels as elements
from polyida.element import two_field
from polyida.errors import DONE, INVERTED, NOT_FINITE, SINGULAR
from polyida.integrate.energy.dense import ENDS, OfMiddles, missing
from polyida.jit import entry, part
from polyida.jit.intrinsics import pointer
from polyida.linear.dense import clear
from polyida.system import ACCELERATION, ACCEPT, INSTANTS, KINETIC, MIDDLE, PROJECT, RATE, SOLVE
from polyida.system.python import PythonTable
from polyida.system.scene import (
    COSINE,
    DV,
    DX,
    DZ,
    FORCES,
    FUNCTIONS,
    START,
    VX,
    H,
    SceneTable,
    Solid,
    add_forces,
    pairs,
    rows,
)  # fmt: skip


@entry
def middle(w, instant, states, lam, r, phi, e, f):
    """r at the middle of a step, whose time is that before the instant of its end, and phi there."""
    links, out, points, drives = w.scene.links, pairs(w, r), w.points, w.drives[instant]
    given = carray(pointer(states), (5, out.shape[0], 2))
    least = equilibrium(w.scene, drives, w.numbers[H], given, rows(w, lam), rows(w, phi), points[DX], points[FORCES], out, w.rotation)
    if not least > 0.0:
        return INVERTED if least <= 0.0 else NOT_FINITE
    joints.point_values(links, given[1], points[DZ])
    add_elements(links, w.laws, drives, given, points, out)
    w.numbers[COSINE] = joints.joint_forces(links, w.drives[instant + 1], points[DZ], w.level, rows(w, phi), points[DV])
    return DONE


@part
def add_elements(links, laws, drives, states, points, r):
    """Force elements into r; what is None is not compiled."""
    if laws is not None:
        joints.point_values(links, states[0], points[START])
        joints.point_values(links, states[3], points[VX])
        clear(points[FORCES])
        take_midpoint_forces(laws, drives, points[START], points[DZ], points[VX], points[FORCES])
        joints.spread(links, points[FORCES], r)


@entry
def equilibrium(scene, drives, h, states, lam, phi, dz, forces, r, rotation):
    """Fill r (nodes, 2) with all but force elements; returns the least det F at the end.

    states (5, nodes, 2): displacements at both ends, and at the middle with their velocities and accelerations. phi (m,), dz and forces
    (points, 2) are scratch; rotation (nodes, 2) as of the equilibrium of a state.
    """
    s, links, u0, u1, um, vm, a = scene.plates, scene.links, states[0], states[1], states[2], states[3], states[4]
    for i in range(r.shape[0]):
        r[i, 0], r[i, 1] = -s.weight[i, 0], -s.weight[i, 1]
    clear(rotation)
    few = compact.forces_middle(scene.compact, h, u0, u1, um, vm, a, r, rotation)
    least = compact.lesser(plates_middle(s, h, u0, u1, um, vm, a, r, rotation), few)
    for k in range(s.load_drive.shape[0]):
        factor = drives[s.load_drive[k], 0]
        for i in range(s.load_ptr[k], s.load_ptr[k + 1]):
            r[s.load_nodes[i], 0] -= factor * s.load_values[i, 0]
            r[s.load_nodes[i], 1] -= factor * s.load_values[i, 1]
    joints.point_values(links, a, dz)
    for p in range(dz.shape[0]):
        for k in range(2):
            forces[p, k] = links.point_mass[p] * (dz[p, k] - links.gravity[k])
    joints.point_values(links, um, dz)
    joints.joint_forces(links, drives, dz, lam, phi, forces)
    joints.spread(links, forces, r)
    return least


@part
def plates_middle(s, h, u0, u1, um, vm, a, r, rotation):
    """Inner, inertia and damping forces of all plates into r."""
    least = 1e300
    for b in range(s.body_operator.shape[0]):
        o, n0, density = s.body_operator[b], s.body_node[b], s.body_density[b]
        given = s.body_c1[b], s.body_nu[b], s.body_viscosity[b] / h, u0, u1, r, rotation
        least = compact.lesser(least, two_field.internal_force_midpoint(*kernels.cells(s, o), n0, *given))
        elements.mass_product(*kernels.on_pattern(s, o, s.mass), density, n0, a, r)
        if s.body_drag[b] != 0.0:
            elements.mass_product(*kernels.on_pattern(s, o, s.mass), s.body_drag[b] * density, n0, vm, r)
        if s.body_stabilisation[b] != 0.0:
            elements.stabilisation_force(*kernels.on_pattern(s, o, s.stabilisation), s.body_stabilisation[b], n0, um, r)
    return least


@entry
def kinetic(w, instant, v, energy, c, d, e, f):
    """v^T M v."""
    s, given, total = w.solid, pairs(w, v), 0.0
    clear(s.r)
    compact.momentum(s.mass, given, s.r)
    for i in range(given.shape[0]):
        total += given[i, 0] * s.r[i, 0] + given[i, 1] * s.r[i, 1]
    carray(pointer(energy), (1,))[0] = total
    return DONE


@entry
def acceleration(w, instant, q, v, a, lam, e, f):
    """`[[M, B^T], [B, 0]] (a, lam) = (-g, -phi_bias)`."""
    s, links, drives, out, found = w.solid, w.scene.links, w.drives[instant + 1], pairs(w, a), rows(w, lam)
    u, speed = pairs(w, q), pairs(w, v)
    kernels.equilibrium(w.scene, drives, u, s.still, w.level, s.r, found, w.rotation, w.points[DZ], w.points[FORCES])
    add_forces(w.scene, w.damp, w.laws, drives, u, speed, s.r)
    for i in range(out.shape[0]):
        s.r[i, 0], s.r[i, 1] = -s.r[i, 0], -s.r[i, 1]
    clear(out)
    compact.momentum(s.inverse, s.r, out)
    return DONE if constrain(links, w.projection, drives, w.points[DZ], speed, out, found) else SINGULAR


class EnergyTable(SceneTable):
    """The table of a scene without Python in it; v, a and lam of frames where no body is a plate."""

    entries = {number: FUNCTIONS[number] for number in (SOLVE, RATE, PROJECT, ACCEPT)} | {MIDDLE: middle}

    def __init__(self, model):
        super().__init__(model, model.m > 0 and (not model.bodies or model.needs.driven), False)
        self.w["drives"], self.complete = np.zeros((3 * INSTANTS + 2, len(model.profiles), 3)), not model.bodies
        if self.complete:
            self.entries = self.entries | {KINETIC: kinetic, ACCELERATION: acceleration}
            self.w["solid"] = Solid(*model.once(masses), *np.zeros((2, model.n_nodes, 2)))

    @property
    def workspace(self):
        """Address of the workspace."""
        return self.work.address

    def prepare(self, times, last, h):
        """Get ready for steps between the times; last: the last one, beside it where there is a kink."""
        at = np.repeat(times, 2)[1:]
        at[1::2] = times[1:] - 0.5 * h
        self.w["drives"][1 : len(at)] = drive_table(self.model, at[1:], (at[1], last))
        self.w["numbers"][H] = h

    def prepare_ends(self, times, last):
        """Get ready for frames at the times; the number of the first one's instant."""
        ends = (last if len(times) == 1 else times[0]), last
        self.w["drives"][ENDS + 1 : ENDS + 1 + len(times)] = drive_table(self.model, times, ends)
        return ENDS


class PythonScene(OfMiddles, PythonTable):
    """The table of a scene with force elements or bodies of one's own in Python.

    Plates, loads, masses and joints by the exact form of `equilibrium`, each force element and elastic body by the discrete derivative of
    its own energy on its own places.
    """

    def __init__(self, model):
        super().__init__(model, False)
        self.rotation, self.points = np.zeros((model.n_nodes, 2)), np.zeros((2, model.n_points, 2))

    def _middle(self, instant, states, lam, r, phi, *_):
        model, (t, _), (end, _) = self.model, self._at(instant - 1), self._at(instant)
        given, out = (self._array(at, size * model.n).copy().reshape(-1, 2) for at, size in ((states, 5), (r, 1)))
        given, rows = given.reshape(5, -1, 2), self._array(phi, model.m)
        lam = self._array(lam, model.m).copy()
        det = equilibrium(model.arrays, model.drives(t), self.h, given, lam, rows.copy(), *self.points, out, self.rotation)
        if not det > 0.0:
            return INVERTED if det <= 0.0 else NOT_FINITE
        u0, u1, um, vm, a = given.reshape(5, -1)
        found = out.ravel()
        if model.uneven_mass is not None:
            found += model.uneven_mass @ a
        if model.uneven_drag is not None:
            found += model.uneven_drag @ vm
        for own in model.own_forces.each:
            found -= own.A.T @ self._own(own, t, u0, u1, vm).ravel()
        self._array(r, model.n)[:], rows[:] = found, model.phi(end, u1)
        return DONE if np.isfinite(found).all() and np.isfinite(rows).all() else NOT_FINITE

    def _own(self, own, t, u0, u1, vm):
        """Forces of one of them, (sides, 2)."""
        x0, x1 = own.places(u0), own.places(u1)
        middle = 0.5 * (x0 + x1)
        force = own.forces(t, middle, own.velocities(vm))
        if not np.isfinite(force).all():
            return force
        held = own.conservative(t, middle)
        return force - missing(own.energy, x0, x1, x1 - x0, None if held is None else -held)


def masses(model):
    """Masses of the bodies of a scene without plates, and their inverses."""
    each = [model._even_mass[placed.pairs, placed.pairs].toarray() for placed in model.few]
    return _compact(model, each), _compact(model, [np.linalg.inv(mass) for mass in each])


def _compact(model, each):
    flat = np.concatenate([mass.ravel() for mass in each])
    return model.arrays.compact._replace(mass=np.stack([flat.real, flat.imag], axis=1))
