"""The table by which kernels call those force elements of a scene that are compiled."""

import numpy as np
from numba.core.errors import NumbaError

from polyida.assembly.arrays import starts
from polyida.assembly.own.laws import Laws, callback_of
from polyida.body.force_element import numbers_of, sides_of
from polyida.errors import InputError
from polyida.profile import polynomial


def laws_of(elements, points, drives, size):
    """The Laws of {name: force element}, or None where there are none or one is Python. Their sides become points of links.

    Raises InputError, naming the element, for a law that numba does not compile.
    """
    if not elements or not all(type(element).law for element in elements.values()):
        return None
    sides = [sides_of(name, element) for name, element in elements.items()]
    numbers = [numbers_of(element) for element in elements.values()]
    addresses = [_address(name, type(element).law) for name, element in elements.items()]
    each = [side for group in sides for side in group]
    return Laws(
        parts=np.stack([np.array([*addresses, 0], np.int64), starts(sides), starts(numbers)], axis=1),
        points=np.array([-1 if side.body is None else points.add(side) for side in each], np.int64),
        rest=np.array([side.point for side in each], float),
        numbers=np.concatenate(numbers),
        clock=drives.add(polynomial([0.0, 1.0]), next(iter(elements))),
        size=size,
    )


def _address(name, law):
    try:
        return callback_of(law).address
    except NumbaError as error:
        raise InputError(f"{name}: numba does not compile its law(t, x, v, data, f): {' '.join(str(error).split())[:300]}") from None
