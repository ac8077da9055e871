"""Compiled forces of force elements and of users' bodies: C functions that kernels call by address, so that no kernel is compiled again."""

from typing import NamedTuple

import numpy as np

from polyida.assembly.arrays import starts
from polyida.assembly.joints import point_values, spread
from polyida.body.body import writes
from polyida.errors import DONE, InputError
from polyida.force.force_element import ForceElement, Side, profiles_of, sides_of
from polyida.jit import entry, pack, part
from polyida.jit.intrinsics import address, call
from polyida.jit.user_functions import OwnData
from polyida.profile import polynomial
from polyida.validation import pairs_of

# constants of compiled code
NO_ENERGY = -1
NOISE = 32 * 2.0**-52  # relative difference of energies that is round-off
STEP = 1e-7  # relative step of central differences: small, because contact forces change over small distances


@pack
class Laws(NamedTuple):
    """The force laws of a scene: one for each force element, and for each elastic body of a user."""

    parts: np.ndarray  # (laws + 1, 3) address of the forces, first side, first of its numbers; the last row is the ends
    points: np.ndarray  # point of each side; -1 on the ground
    rest: np.ndarray  # (sides, 2) places of the sides at rest, m
    sizes: np.ndarray  # (sides,) typical size of each side's coordinates
    energies: np.ndarray  # (laws,) address of the energy; 0 without, NO_ENERGY if it is not compiled
    numbers: np.ndarray  # the time, then the words that the functions read as self
    driven: np.ndarray  # (values, 2) index among the numbers of a drive's value, and number of the drive
    clock: int  # number of the drive that is the time


@part
def numbers_at(laws, drives):
    """The numbers of all laws at the time of the drives."""
    numbers = laws.numbers.copy()
    numbers[0] = drives[laws.clock, 0]
    for i in range(laws.driven.shape[0]):
        numbers[laws.driven[i, 0]] = drives[laws.driven[i, 1], 0]
    return numbers


@part
def call_law(laws, function, k, numbers, x, v, f):
    """Fill f by a C function of law k at places x and velocities v; nan if it raises or returns another shape."""
    data = address(numbers) + 8 * laws.parts[k, 2]
    if call(function, data, 0, address(numbers), address(x), address(v), 0, 0, address(f)) != DONE:
        f[:] = np.nan


@part
def evaluate(laws, k, numbers, x, v, f):
    """Fill f (sides, 2), N, with the forces of law k."""
    call_law(laws, laws.parts[k, 0], k, numbers, x, v, f)


@part
def energy_at(laws, k, numbers, x, f):
    """The energy of law k at places x; f is workspace."""
    call_law(laws, laws.energies[k], k, numbers, x, x, f)
    return f[0, 0]


@part
def place(laws, k, dz, vz):
    """Places x and velocities v of the sides of law k at displacements dz and velocities vz of the points, and an array for its forces."""
    first, count = laws.parts[k, 1], laws.parts[k + 1, 1] - laws.parts[k, 1]
    x, v = laws.rest[first : first + count].copy(), np.zeros((count, 2))
    for i in range(count):
        p = laws.points[first + i]
        if p >= 0:
            for e in range(2):
                x[i, e] += dz[p, e]
                v[i, e] = vz[p, e]
    return x, v, np.empty((count, 2))


@entry
def add_own_forces(laws, links, drives, u, v, r):
    """r (nodes, 2) -= the forces of all laws at displacements u and velocities v, (nodes, 2)."""
    dz, vz, forces = np.zeros((3, links.point_mass.shape[0], 2))
    point_values(links, u, dz)
    point_values(links, v, vz)
    numbers = numbers_at(laws, drives)
    for k in range(laws.parts.shape[0] - 1):
        x, speeds, f = place(laws, k, dz, vz)
        evaluate(laws, k, numbers, x, speeds, f)
        subtract_sides(laws, k, f, forces)
    spread(links, forces, r)


@part
def take_midpoint_forces(laws, drives, dz0, dz1, vz, forces):
    """forces (points, 2) -= forces of all laws at the middle of a step of the points from dz0 to dz1, by the discrete gradient (Gonzalez 1996).

    With `[V_1 - V_0 - V'] dx / (dx^T dx)` subtracted, the work of f from x0 to x1 is that of the law's energy V. V' is the work of the
    forces at the middle at zero velocity. A bracket within round-off of V counts as zero.
    """
    numbers = numbers_at(laws, drives)
    for k in range(laws.parts.shape[0] - 1):
        x0, v, f = place(laws, k, dz0, vz)
        x1, _, _ = place(laws, k, dz1, vz)
        middle = 0.5 * (x0 + x1)
        evaluate(laws, k, numbers, middle, v, f)
        if laws.energies[k] != 0:
            dx, static = x1 - x0, np.empty_like(f)
            first, last = energy_at(laws, k, numbers, x0, static), energy_at(laws, k, numbers, x1, static)
            evaluate(laws, k, numbers, middle, np.zeros_like(f), static)
            size, bracket = np.sum(dx * dx), last - first + np.sum(static * dx)
            if size > 0.0 and abs(bracket) > NOISE * max(abs(first), abs(last)):
                f -= bracket / size * dx
        subtract_sides(laws, k, f, forces)


@part
def subtract_sides(laws, k, f, forces):
    """forces -= f at the points of law k's sides."""
    for i in range(f.shape[0]):
        p = laws.points[laws.parts[k, 1] + i]
        if p >= 0:
            forces[p, 0] -= f[i, 0]
            forces[p, 1] -= f[i, 1]


@entry
def add_own_curvature(laws, coupling, drives, dz, vz, c_q, c_v, curvature):
    """Blocks of the coupling -= `c_q df/dx + c_v df/dv` of all laws; dz, vz (points, 2): displacements and velocities of the points."""
    numbers = numbers_at(laws, drives)
    for k in range(laws.parts.shape[0] - 1):
        x, v, ahead = place(laws, k, dz, vz)
        behind, blocks = np.empty_like(ahead), coupling.laws[coupling.law_start[k] : coupling.law_start[k + 1]]
        if c_q != 0.0:
            add_slopes(laws, k, numbers, x, v, x, c_q, ahead, behind, blocks, curvature)
        if c_v != 0.0:
            add_slopes(laws, k, numbers, x, v, v, c_v, ahead, behind, blocks, curvature)


@part
def add_slopes(laws, k, numbers, x, v, varied, c, ahead, behind, blocks, curvature):
    """curvature -= c times the derivative of the forces of law k in `varied`, x or v, by central differences."""
    first, count = laws.parts[k, 1], x.shape[0]
    for j in range(count):
        step = STEP * laws.sizes[first + j]
        for e in range(2 if laws.points[first + j] >= 0 else 0):
            middle = varied[j, e]
            varied[j, e] = middle + step
            evaluate(laws, k, numbers, x, v, ahead)
            varied[j, e] = middle - step
            evaluate(laws, k, numbers, x, v, behind)
            varied[j, e] = middle
            for i in range(count):
                block = blocks[i * count + j]
                for a in range(2 if block >= 0 else 0):
                    curvature[block, a, e] -= c * (ahead[i, a] - behind[i, a]) / (2.0 * step)


def laws_of(elements, elastic, points, drives, size):
    """The Laws of {name: force element} and of PlacedBody with an elastic force; None if there are none, or one is not compiled.

    Sides of elements and coordinates of bodies become points. Profiles of elements become drives in any case, so that steps end at their
    kinks. Raises InputError, naming the part, for a function that numba does not compile.
    """
    for name, element in elements.items():
        for profile in profiles_of(element):
            drives.add(profile, name)
    functions = [part.compiled_functions() for part in (*elements.values(), *(placed.body for placed in elastic))]
    if not functions or not all(functions):
        return None
    laws = []
    for name, element in elements.items():
        sides = sides_of(name, element)
        shape, no_energy = (len(sides), 2), NO_ENERGY if writes(element, ForceElement, "energy") else 0
        arguments = {"t": ("t",), "x": ("b", shape), "v": ("c", shape)}
        laws.append((sides, *_addresses(name, element, "forces", arguments, shape, no_energy)))
    for placed in elastic:  # its elastic force acts on its coordinates, with the opposite sign
        count = len(placed.rest)
        sides = [Side(placed.user.point_of(f"z_{k}", np.eye(count)[k]), "point", rest) for k, rest in enumerate(pairs_of(placed.rest))]
        arguments = {"z": ("b", (count,), True)}
        laws.append((sides, *_addresses(placed.name, placed.body, "elastic", arguments, (count,), 0, "-found", True)))
    sides, data, addresses = zip(*laws)
    numbers = [np.zeros(1), *(one.words for one in data)]  # the time comes first
    first, each = starts(numbers)[1:], [side for group in sides for side in group]
    driven = [(begin + k, drives.add(profile, "")) for begin, one in zip(first, data) for k, profile in one.profiles]
    return Laws(
        parts=np.stack([np.array([*(forces for forces, _ in addresses), 0], np.int64), starts(sides), first], axis=1),
        points=np.array([-1 if side.at is None else points.add(side.at, side.part) for side in each], np.int64),
        rest=np.array([side.rest for side in each], float),
        sizes=np.array([side.size(size) for side in each], float),
        energies=np.array([energy for _, energy in addresses], np.int64),
        numbers=np.concatenate(numbers),
        driven=np.array(driven, np.int64).reshape(-1, 2),
        clock=drives.add(polynomial([0.0, 1.0]), ""),
    )


def _addresses(name, part, forces, arguments, shape, no_energy, *result):
    """(OwnData, (address of the forces, address of the energy or `no_energy`)) of a part."""
    functions = part.compiled_functions()
    data = OwnData(part, functions.values())
    try:
        address = data.c_function(functions[forces], arguments, shape, *result)
        energy = functions.get("energy")
        return data, (address, data.c_function(energy, arguments, ()) if energy else no_energy)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None
