"""The table by which kernels call the force elements and elastic bodies of a scene, if all of them are compiled."""

import numpy as np

from polyida.assembly.arrays import starts
from polyida.assembly.own.laws import NO_ENERGY, Laws
from polyida.body.body import writes
from polyida.errors import InputError
from polyida.force.force_element import ForceElement, Side, profiles_of, sides_of
from polyida.given import pairs_of
from polyida.jit.own_data import OwnData
from polyida.profile import polynomial


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
