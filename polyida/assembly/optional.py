"""Kernels that only some scenes need, called by address: those of force elements, of damped bodies and of viscoelastic plates.

They are compiled for the scenes that have such parts, once for all integrators; scenes without them compile nothing of them.
"""

from typing import NamedTuple

import numpy as np
from numba import carray, typeof

from polyida.assembly.arrays import SceneArrays
from polyida.assembly.equilibrium import add_damping
from polyida.assembly.own_laws import Laws, add_own_curvature, add_own_forces, take_damping_forces, take_midpoint_forces
from polyida.assembly.relaxation import add_relaxation, add_relaxation_middle
from polyida.errors import DONE, NOT_FINITE
from polyida.jit import pack, part, served
from polyida.jit.intrinsics import pointer, real
from polyida.jit.user_functions import table_address

# constants of compiled code
PARTS, LAW_FORCES, LAW_SLOPES, LAW_DAMPING, LAW_MIDDLE, RELAXING, RELAXING_MIDDLE, DAMPING, RENEW = range(9)  # of the addresses of a scene


@pack
class Parts(NamedTuple):
    """What the kernels read: the scene, its laws and the number of its profiles."""

    scene: SceneArrays
    laws: Laws
    profiles: int


@part
def nodal(work, at):
    """The array (nodes, 2) at an address."""
    return carray(pointer(at), work.scene.plates.weight.shape)


@part
def at_points(work, at):
    """The array (points, 2) at an address."""
    return carray(pointer(at), (work.scene.links.point_mass.shape[0], 2))


@part
def values(work, at):
    """The values of the profiles at an address."""
    return carray(pointer(at), (work.profiles, 3))


@part
def number_at(work, at):
    """The number at an address."""
    return real(at)


@part
def on_coupling(work, at):
    """The blocks (., 2, 2) of the coupling at an address."""
    return carray(pointer(at), (work.scene.links.coupling.columns.shape[0], 2, 2))


@part
def law_forces(work, drives, moved, v, residual):
    """residual (nodes, 2) -= the forces of the compiled force elements at displacements of nodes `moved` and velocities v.

    Returns DONE, or NOT_FINITE.
    """
    return DONE if add_own_forces(work.laws, work.scene.links, drives, moved, v, residual) else NOT_FINITE


@part
def law_slopes(work, drives, dz, vz, c_v, blocks):
    """blocks (., 2, 2) of the coupling += K + c_v C of the compiled force elements, at displacements dz and velocities vz of the points.

    Returns DONE.
    """
    add_own_curvature(work.laws, work.scene.links.coupling, drives, dz, vz, 1.0, c_v, blocks)
    return DONE


@part
def law_damping(work, drives, dz, vz, moved, forces):
    """forces (points, 2) += C moved of the compiled force elements, at displacements dz, velocities vz; moved (points, 2) is the factor.

    Returns DONE.
    """
    take_damping_forces(work.laws, drives, dz, vz, moved, forces)
    return DONE


@part
def law_middle(work, drives, dz0, dz1, vz, half, forces):
    """forces (points, 2) -= those of the compiled force elements mid-step, dz0 to dz1, by a discrete gradient.

    Returns DONE, or NOT_FINITE.
    """
    return DONE if take_midpoint_forces(work.laws, drives, dz0, dz1, vz, half, forces) else NOT_FINITE


@part
def relaxing(work, still, moved, v, residual):
    """residual (nodes, 2) += the forces of relaxation at displacements of nodes `moved` and velocities v. Returns DONE.

    still, 0 or 1: factor of the strain in the equations of the relaxing strains.
    """
    add_relaxation(work.scene, moved, None, v, float(still), residual)
    return DONE


@part
def relaxing_middle(work, u0, u1, um, vm, residual):
    """residual (nodes, 2) += the forces of relaxation at the middle of a step from displacements u0 to u1; um, vm: of the middle.

    Returns DONE.
    """
    add_relaxation_middle(work.scene, u0, u1, um, vm, residual)
    return DONE


@part
def damping(work, moved, v, elastic, residual):
    """residual (nodes, 2) += the damping forces of bodies at displacements of nodes `moved` and velocities v. Returns DONE."""
    add_damping(work.scene, moved, v, elastic, residual)
    return DONE


OF_LAWS = {
    LAW_FORCES: served(law_forces, nodal, nodal, nodal, first=values),
    LAW_SLOPES: served(law_slopes, at_points, at_points, number_at, on_coupling, first=values),
    LAW_DAMPING: served(law_damping, at_points, at_points, at_points, at_points, first=values),
    LAW_MIDDLE: served(law_middle, at_points, at_points, at_points, at_points, at_points, first=values),
}
OF_RELAXATION = {
    RELAXING: served(relaxing, nodal, nodal, nodal),
    RELAXING_MIDDLE: served(relaxing_middle, nodal, nodal, nodal, nodal, first=nodal),
}
OF_DAMPING = {DAMPING: served(damping, nodal, nodal, nodal, first=nodal)}


def optional_kernels(model, *wanted):
    """The addresses of those kernels of a scene that are wanted, (9,); 0 where the scene does not need one."""
    addresses, parts = np.zeros(9, np.int64), model.once(_parts)
    kernels = (
        (OF_LAWS if len(model.laws.energies) else {}) | (OF_RELAXATION if model.strains else {}) | (OF_DAMPING if model.damped else {})
    )
    addresses[PARTS] = parts.address
    for number in kernels.keys() & set(wanted):
        addresses[number] = table_address(kernels[number], typeof(parts))
    return addresses


def _parts(model):
    """The Parts of a scene that the optional kernels read: arrays, force elements and the number of profiles."""
    return Parts(model.arrays, model.laws, len(model.profiles))
