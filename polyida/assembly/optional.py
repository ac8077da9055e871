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
from polyida.jit import entry, pack, part
from polyida.jit.intrinsics import pointer
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


@entry
def law_forces(work, drives, u, v, r, d, e, f):
    """Add the forces of the laws to r."""
    finite = add_own_forces(work.laws, work.scene.links, values(work, drives), nodal(work, u), nodal(work, v), nodal(work, r))
    return DONE if finite else NOT_FINITE


@entry
def law_slopes(work, drives, dz, vz, c_v, own, e, f):
    """Add K + c_v C of the laws to the blocks of the coupling; c_v: address of the number."""
    coupling = work.scene.links.coupling
    blocks, factor = carray(pointer(own), (coupling.columns.shape[0], 2, 2)), carray(pointer(c_v), (1,))[0]
    add_own_curvature(work.laws, coupling, values(work, drives), at_points(work, dz), at_points(work, vz), 1.0, factor, blocks)
    return DONE


@entry
def law_damping(work, drives, dz, vz, moved, forces, e, f):
    """Add C moved of the laws to the forces at the points."""
    take_damping_forces(
        work.laws, values(work, drives), at_points(work, dz), at_points(work, vz), at_points(work, moved), at_points(work, forces)
    )
    return DONE


@entry
def law_middle(work, drives, dz0, dz1, vz, half, forces, f):
    """Add the forces of the laws in the middle of a step to the forces at the points."""
    places = at_points(work, dz0), at_points(work, dz1)
    others = at_points(work, vz), at_points(work, half), at_points(work, forces)
    finite = take_midpoint_forces(work.laws, values(work, drives), places[0], places[1], others[0], others[1], others[2])
    return DONE if finite else NOT_FINITE


@entry
def relaxing(work, still, u, v, r, d, e, f):
    """Add the forces of relaxation to r; still: as of `add_relaxation`."""
    add_relaxation(work.scene, nodal(work, u), None, nodal(work, v), float(still), nodal(work, r))
    return DONE


@entry
def relaxing_middle(work, u0, u1, um, vm, r, e, f):
    """Add the forces of relaxation in the middle of a step to r."""
    add_relaxation_middle(work.scene, nodal(work, u0), nodal(work, u1), nodal(work, um), nodal(work, vm), nodal(work, r))
    return DONE


@entry
def damping(work, u, v, elastic, r, d, e, f):
    """Add the damping forces of bodies to r."""
    add_damping(work.scene, nodal(work, u), nodal(work, v), nodal(work, elastic), nodal(work, r))
    return DONE


OF_LAWS = {LAW_FORCES: law_forces, LAW_SLOPES: law_slopes, LAW_DAMPING: law_damping, LAW_MIDDLE: law_middle}
OF_RELAXATION = {RELAXING: relaxing, RELAXING_MIDDLE: relaxing_middle}
OF_DAMPING = {DAMPING: damping}


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
    return Parts(model.arrays, model.laws, len(model.profiles))
