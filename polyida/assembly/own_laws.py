"""Forces of force elements and bodies of one's own that are compiled: C functions, called by their addresses, so that no kernel is made anew."""

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
NOISE = 32 * 2.0**-52  # of an energy: a difference of less is none
STEP = 1e-7  # of the size of what is varied, in central differences: short, for forces of contact change within little


@pack
class Laws(NamedTuple):
    """A scene's force elements by number: address, first side and first of its `numbers`, (laws + 1, 3), the last row the ends.

    points: the point of links of each side, -1 where it stays with the ground; rest: places of the sides, (sides, 2), m; sizes: of what
    each says, (sides,). energies: address of each law's energy, (laws,), 0 where it has none, NO_ENERGY where it is not compiled. numbers:
    the time, and words of what the functions read as self. driven: which of the numbers are a drive's value, and which drive, (values, 2).
    clock: the drive that is the time.
    """

    parts: np.ndarray
    points: np.ndarray
    rest: np.ndarray
    sizes: np.ndarray
    energies: np.ndarray
    numbers: np.ndarray
    driven: np.ndarray
    clock: int


@part
def numbers_at(laws, drives):
    """The numbers of all laws at the time of drives."""
    numbers = laws.numbers.copy()
    numbers[0] = drives[laws.clock, 0]
    for i in range(laws.driven.shape[0]):
        numbers[laws.driven[i, 0]] = drives[laws.driven[i, 1], 0]
    return numbers


@part
def ask(laws, function, k, numbers, x, v, f):
    """Fill f by a C function of law k at places x and velocities v; nan where it raises or gives another shape."""
    data = address(numbers) + 8 * laws.parts[k, 2]
    if call(function, data, 0, address(numbers), address(x), address(v), 0, 0, address(f)) != DONE:
        f[:] = np.nan


@part
def evaluate(laws, k, numbers, x, v, f):
    """Fill f (sides, 2), N, with the forces of law k."""
    ask(laws, laws.parts[k, 0], k, numbers, x, v, f)


@part
def energy_at(laws, k, numbers, x, f):
    """The energy of law k at places x; f is scratch."""
    ask(laws, laws.energies[k], k, numbers, x, x, f)
    return f[0, 0]


@part
def place(laws, k, dz, vz):
    """x and v of the sides of law k at displacements dz and velocities vz of the points, and room for its forces."""
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
        take_sides(laws, k, f, forces)
    spread(links, forces, r)


@part
def take_midpoint_forces(laws, drives, dz0, dz1, vz, forces):
    """forces (points, 2) -= those of all laws at the middle of a step from displacements dz0 of the points to dz1, by the discrete derivative.

    With `[V_1 - V_0 - V'] dx / (dx^T dx)` taken off, the work of f from x0 to x1 is that of the law's energy V (Gonzalez 1996). V' is what
    the forces at the middle do where nothing moves. What is no more than round-off of V is none.
    """
    numbers = numbers_at(laws, drives)
    for k in range(laws.parts.shape[0] - 1):
        x0, v, f = place(laws, k, dz0, vz)
        x1, _, _ = place(laws, k, dz1, vz)
        middle = 0.5 * (x0 + x1)
        evaluate(laws, k, numbers, middle, v, f)
        if laws.energies[k] != 0:
            dx, held = x1 - x0, np.empty_like(f)
            first, last = energy_at(laws, k, numbers, x0, held), energy_at(laws, k, numbers, x1, held)
            evaluate(laws, k, numbers, middle, np.zeros_like(f), held)
            size, bracket = np.sum(dx * dx), last - first + np.sum(held * dx)
            if size > 0.0 and abs(bracket) > NOISE * max(abs(first), abs(last)):
                f -= bracket / size * dx
        take_sides(laws, k, f, forces)


@part
def take_sides(laws, k, f, forces):
    """forces -= f at the points of law k's sides."""
    for i in range(f.shape[0]):
        p = laws.points[laws.parts[k, 1] + i]
        if p >= 0:
            forces[p, 0] -= f[i, 0]
            forces[p, 1] -= f[i, 1]


@entry
def add_own_curvature(laws, coupling, drives, dz, vz, c_q, c_v, curvature):
    """Blocks of the coupling -= `c_q df/dx + c_v df/dv` of all laws; dz, vz (points, 2) move the points."""
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
    """curvature -= c times the derivative of the forces of law k in `varied`, which is x or v, by central differences."""
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
    """The Laws of {name: force element} and PlacedBody with an elastic force; None if there are none or one is Python.

    Sides of elements, and coordinates of bodies, become points of links. Profiles of elements become drives in any case, so that steps end at
    their kinks. Raises InputError, naming the part, for a function that numba does not compile.
    """
    for name, element in elements.items():
        for profile in profiles_of(element):
            drives.add(profile, name)
    functions = [part.compiled_functions() for part in (*elements.values(), *(placed.body for placed in elastic))]
    if not functions or not all(functions):
        return None
    laws = [_element(name, element) for name, element in elements.items()] + [_elastic(placed) for placed in elastic]
    sides, data, addresses = zip(*laws)
    numbers = [np.zeros(1), *(one.words for one in data)]  # the time before all
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
        clock=drives.add(polynomial([0.0, 1.0]), ""),  # nobody's
    )


def _element(name, element):
    """(sides, data, (address of its forces, of its energy)) of a force element."""
    sides = sides_of(name, element)
    shape = (len(sides), 2)
    given = {"t": ("t",), "x": ("b", shape), "v": ("c", shape)}
    none = NO_ENERGY if writes(element, ForceElement, "energy") else 0
    return sides, *_made(name, element, "forces", given, shape, none)


def _elastic(placed):
    """The same of a body, the forces minus the elastic ones."""
    body, count = placed.body, len(placed.rest)
    sides = [Side(placed.user.point_of(f"z_{k}", np.eye(count)[k]), "point", rest) for k, rest in enumerate(pairs_of(placed.rest))]
    given = {"z": ("b", (count,), True)}
    return sides, *_made(placed.name, body, "elastic", given, (count,), 0, "-found", True)


def _made(name, part, forces, given, shape, no_energy, *result):
    functions = part.compiled_functions()
    data = OwnData(part, functions.values())
    try:
        address = data.c_function(functions[forces], given, shape, *result)
        energy = functions.get("energy")
        return data, (address, data.c_function(energy, given, ()) if energy else no_energy)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None
