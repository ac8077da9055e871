"""The table by which kernels call those force elements of a scene that are compiled."""

import numpy as np
from numba.core.errors import NumbaError

from polyida.assembly.arrays import starts
from polyida.assembly.own.laws import NO_ENERGY, Laws, callback_of, energy_callback
from polyida.body.own_part import writes
from polyida.errors import InputError
from polyida.force.force_element import ForceElement, numbers_of, sides_of
from polyida.profile import Profile, polynomial


def laws_of(elements, points, drives, size):
    """The Laws of {name: force element}, or None where there are none or one is Python. Their sides become points of links.

    Profiles among the numbers of elements become drives in any case, so that steps end at their kinks.
    Raises InputError, naming the element, for a law that numba does not compile.
    """
    given = {name: numbers_of(e) if e.compiled_law else ForceElement.numbers(e) for name, e in elements.items()}
    numbers = [[_number(value, drives, name) for value in values] for name, values in given.items()]
    if not elements or not all(element.compiled_law for element in elements.values()):
        return None
    sides = [sides_of(name, element) for name, element in elements.items()]
    addresses = [_address(name, callback_of, element.compiled_law, "law(t, x, v, data, f)") for name, element in elements.items()]
    each = [side for group in sides for side in group]
    values = np.array([value for group in numbers for value in group], float).reshape(-1, 2)
    driven = np.flatnonzero(values[:, 1] >= 0)
    return Laws(
        parts=np.stack([np.array([*addresses, 0], np.int64), starts(sides), starts(numbers)], axis=1),
        points=np.array([-1 if side.at is None else points.add(side.at, side.part) for side in each], np.int64),
        rest=np.array([side.rest for side in each], float),
        sizes=np.array([side.size(size) for side in each], float),
        energies=np.array([_energy(name, element) for name, element in elements.items()], np.int64),
        numbers=np.ascontiguousarray(values[:, 0]),
        driven=np.stack([driven, values[driven, 1].astype(np.int64)], axis=1),
        clock=drives.add(polynomial([0.0, 1.0]), ""),  # nobody's
    )


def _number(value, drives, name):
    """(value, -1) of a number, (0, its drive) of a profile."""
    return (0.0, drives.add(value, name)) if isinstance(value, Profile) else (float(value), -1)


def _energy(name, element):
    """The address of its energy, 0 where it has none, NO_ENERGY where that is Python."""
    if element.compiled_energy:
        return _address(name, energy_callback, element.compiled_energy, "compiled_energy, energy(x, data)")
    return NO_ENERGY if writes(element, ForceElement, "energy") else 0


def _address(name, callback, law, what):
    try:
        return callback(law).address
    except NumbaError as error:
        raise InputError(f"{name}: numba does not compile its {what}: {' '.join(str(error).split())[:300]}") from None
