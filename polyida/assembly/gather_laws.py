"""From the force elements of a scene, and the bodies with an elastic force of their own, to the Laws that kernels read (own_laws.py).

Each gives the addresses of its C functions: of functions that numba compiles, or of callbacks into Python (python_functions.py).
"""

from typing import NamedTuple

import numpy as np

from polyida.assembly.arrays import starts
from polyida.assembly.own_laws import ENERGIES, STATIC, TIMELESS, Laws
from polyida.assembly.python_functions import Callbacks, Calls, PythonFunctions
from polyida.body.body import writes
from polyida.errors import InputError
from polyida.force.force_element import ForceElement, Side, profiles_of, sides_of
from polyida.jit.owner_data import OwnData
from polyida.profile import polynomial
from polyida.validation import pairs_of

NO_NUMBERS = np.zeros((0, 2))


class PlacedLaw(NamedTuple):
    """A force element, or the elastic force of a body, as `laws_of` gathers them."""

    sides: tuple  # Side each; behind them those of its states
    data: OwnData
    addresses: tuple  # of forces, energy and rates; 0 without
    callbacks: Callbacks
    rated: int  # number of its states, algebraic ones included
    units: np.ndarray = NO_NUMBERS  # (states, 2) units and scales of its states
    guesses: np.ndarray = NO_NUMBERS  # (algebraic states, 2) start and size


def _law_of_element(name, element, placed, calls):
    """The PlacedLaw of a force element; placed: PlacedStates or None. States are arguments s, outputs of controllers u."""
    sides, names = sides_of(name, element), element.states + element.algebraic
    shape = len(sides), 2
    arguments = {"t": ("t",), "x": ("b", shape), "v": ("c", shape)}
    if names:
        arguments["s"] = ("d", (len(names),))
    of_energy = {"x": arguments["x"]}
    if placed:
        arguments["s"] = ("d", (len(names),))
        if placed.controls:
            arguments["u"] = of_energy["u"] = ("e", (len(placed.units) - placed.own,))
        of_energy["s"] = ("d", (placed.own,))
    written = {"forces"} | {key for key in ("energy", "rates") if writes(element, ForceElement, key)}
    functions = _functions(PythonFunctions(name, element), calls, written, arguments, of_energy, shape)
    guesses = np.column_stack([element.start(), element.sizes()])[len(element.states) :]
    if placed is None:
        return PlacedLaw(sides, *functions, len(names), guesses=guesses)
    return PlacedLaw(sides + placed.sides(), *functions, len(names), np.column_stack([placed.units, placed.scale]), guesses)


def _law_of_body(placed, calls):
    """The PlacedLaw of a body's elastic force, which acts on its coordinates with the opposite sign."""
    count = len(placed.rest)
    sides = [Side(placed.user.point_of(f"z_{k}", np.eye(count)[k]), "point", rest) for k, rest in enumerate(pairs_of(placed.rest))]
    functions, arguments = PythonFunctions(placed.name, placed.body), {"z": ("b", (count,), True)}
    return PlacedLaw(sides, *_functions(functions, calls, {"elastic", "energy"}, arguments, arguments, (count,)), 0)


def laws_of(elements, states, elastic, points, drives, size):
    """(the Laws, [Callbacks of each]) of {name: force element} and of PlacedBody with an elastic force.

    states: {name: PlacedStates} of the elements that have states.

    Sides of elements and coordinates of bodies become points. Profiles of elements become drives in any case, so that steps end at their
    kinks. Raises InputError, naming the part, for a function that numba does not compile.
    """
    for name, element in elements.items():
        for profile in profiles_of(element):
            drives.add(profile, name)
    calls = Calls()
    laws = [_law_of_element(name, element, states.get(name), calls) for name, element in elements.items()]
    laws += [_law_of_body(placed, calls) for placed in elastic]
    numbers = [np.zeros(1), *(law.data.words for law in laws)]  # the time comes first
    first, each = starts(numbers)[1:], [side for law in laws for side in law.sides]
    driven = [(begin + k, drives.add(profile, "")) for begin, law in zip(first, laws) for k, profile in law.data.profiles]
    forces, energies, rates = (np.array([law.addresses[k] for law in laws], np.int64) for k in range(3))
    units, guesses = [law.units for law in laws], [law.guesses for law in laws]
    behind, rated = np.zeros(1, np.int64), [law.rated for law in laws]
    of_parts = [
        np.append(forces, behind), starts([law.sides for law in laws]), first, np.append(rates, behind), starts(units), [*rated, 0], starts(guesses),
    ]  # fmt: skip
    result = Laws(
        parts=np.stack(of_parts, axis=1),
        states=np.concatenate([NO_NUMBERS, *units]),
        guesses=np.concatenate([NO_NUMBERS, *guesses]),
        points=np.array([-1 if side.at is None else points.add(side.at, side.part) for side in each], np.int64),
        rest=np.array([side.rest for side in each], float).reshape(-1, 2),
        sizes=np.array([side.size(size) for side in each], float),
        energies=energies,
        slopes=np.array([slope_of(law.callbacks) for law in laws], np.int64),
        elements=len(elements),
        numbers=np.concatenate(numbers),
        driven=np.array(driven, np.int64).reshape(-1, 2),
        clock=drives.add(polynomial([0.0, 1.0]), "") if laws else -1,
    )
    return result, [law.callbacks for law in laws]


def _functions(python, calls, written, arguments, of_energy, shape):
    """(OwnData, (addresses of forces, energy and rates, 0 without), Callbacks) of a part: compiled functions, and in Python those beside them.

    written: names of the functions that the part writes.
    """
    part = python.part
    functions = {name: function for name, function in part.compiled_functions().items() if name in written}
    data, elastic = OwnData(part, functions.values()), "elastic" in written
    forms = {"rates": (arguments, arguments["s"][1])} if "s" in arguments else {}
    forms |= {"elastic": (arguments, shape, -1.0, True), "forces": (arguments, shape), "energy": (of_energy, ())}
    try:
        compiled = {name: data.c_function(function, *forms[name]) for name, function in functions.items()}
    except InputError as error:
        raise InputError(f"{python.name}: {error}") from None
    callbacks = Callbacks(python, calls, arguments, of_energy, shape, frozenset(written - {*functions}))
    addresses = compiled | callbacks.addresses
    return data, tuple(addresses.get(name, 0) for name in ("elastic" if elastic else "forces", "energy", "rates")), callbacks


def slope_of(callbacks):
    """From what the discrete gradient of a law takes the slope of its energy: STATIC, TIMELESS or ENERGIES (own_laws.py)."""
    part, in_python = callbacks.functions.part, "forces" in callbacks.addresses
    if isinstance(part, ForceElement) and (part.works or in_python and "s" in callbacks.arguments):
        return ENERGIES
    return TIMELESS if in_python else STATIC


def with_callbacks(laws, callbacks):
    """The laws with the functions of other Callbacks [of each law]."""
    parts, energies = laws.parts.copy(), laws.energies.copy()
    for k, addresses in enumerate(one.addresses for one in callbacks):
        parts[k, 0] = addresses.get("forces", addresses.get("elastic", parts[k, 0]))
        parts[k, 3], energies[k] = addresses.get("rates", parts[k, 3]), addresses.get("energy", energies[k])
    return laws._replace(parts=parts, energies=energies)
