"""From the force elements of a scene, and the bodies with an elastic force of their own, to the Laws that kernels read (own_laws.py).

Each gives the addresses of its C functions: of functions that numba compiles, or of callbacks into Python (python_functions.py).
"""

from typing import NamedTuple

import numpy as np

from polyida.assembly.arrays import starts
from polyida.assembly.own_laws import (
    ENERGIES,
    FIRST_ALGEBRAIC,
    FIRST_NUMBER,
    FIRST_SIDE,
    FIRST_STATE,
    FORCES,
    RATED,
    RATES,
    STATIC,
    TIMELESS,
    Laws,
)
from polyida.assembly.python_functions import Callbacks, Calls, PythonFunctions
from polyida.body.body import writes
from polyida.errors import InputError
from polyida.force.force_element import ForceElement, Side, profiles_of, sides_of
from polyida.jit.owner_data import OwnData
from polyida.profile import polynomial
from polyida.validation import pairs_of

NO_NUMBERS = np.zeros((0, 2))


class Addresses(NamedTuple):
    """Addresses of the C functions of a law; 0 without."""

    forces: int = 0
    energy: int = 0
    rates: int = 0


class PlacedLaw(NamedTuple):
    """A force element, or the elastic force of a body, as `laws_of` gathers them."""

    sides: tuple  # Side each; behind them those of its states
    data: OwnData
    addresses: Addresses
    callbacks: Callbacks
    rated: int  # number of its states, algebraic ones included
    units: np.ndarray = NO_NUMBERS  # (states, 2) units and scales of its states
    guesses: np.ndarray = NO_NUMBERS  # (algebraic states, 2) start and size


def _law_of_element(name, element, placed, calls):
    """The PlacedLaw of a force element; placed: PlacedStates or None. States are arguments s, outputs of controllers u."""
    sides, names = sides_of(name, element), element.states + element.algebraic
    shape = len(sides), 2
    arguments = {"t": ("t",), "x": ("b", shape), "v": ("c", shape)}
    if names or placed:
        arguments["s"] = ("d", (len(names),))  # of length 0 for controllers without states
    of_energy = {"x": arguments["x"]}
    if placed:
        if placed.controls:
            arguments["u"] = of_energy["u"] = ("e", (len(placed.units) - placed.own,))
        of_energy["s"] = ("d", (placed.own,))
    written = {"forces"} | {key for key in ("energy", "rates") if writes(element, ForceElement, key)}
    functions = _functions_of_part(PythonFunctions(name, element), calls, written, arguments, of_energy, shape)
    guesses = np.column_stack([element.start(), element.sizes()])[len(element.states) :]
    if placed is None:
        return PlacedLaw(sides, *functions, rated=len(names), guesses=guesses)
    units = np.column_stack([placed.units, placed.scale])
    return PlacedLaw(sides + placed.sides(), *functions, rated=len(names), units=units, guesses=guesses)


def _law_of_body(placed, calls):
    """The PlacedLaw of a body's elastic force, which acts on its coordinates with the opposite sign."""
    count = len(placed.rest)
    sides = [Side(placed.user.point_of(f"z_{k}", np.eye(count)[k]), "point", rest) for k, rest in enumerate(pairs_of(placed.rest))]
    functions, arguments = PythonFunctions(placed.name, placed.body), {"z": ("b", (count,), True)}
    return PlacedLaw(sides, *_functions_of_part(functions, calls, {"elastic", "energy"}, arguments, arguments, (count,)), rated=0)


def laws_of(elements, states, elastic, points, drives, size):
    """Return (Laws, [Callbacks of each law]) of the force elements {name: element} and of the PlacedBody with elastic forces.

    states: {name: PlacedStates} of the elements that have states. Sides of elements and coordinates of bodies become points. Profiles of
    elements become drives in any case, so that steps end at their kinks. Raises InputError, naming the part, for a function that numba does
    not compile.
    """
    for name, element in elements.items():
        for profile in profiles_of(element):
            drives.add(profile, name)
    calls = Calls()
    laws = [_law_of_element(name, element, states.get(name), calls) for name, element in elements.items()]
    laws += [_law_of_body(placed, calls) for placed in elastic]
    numbers = [np.zeros(1), *(law.data.words for law in laws)]  # the time comes first
    first = starts(numbers)[1:]
    driven = [(begin + k, drives.add(profile, "")) for begin, law in zip(first, laws) for k, profile in law.data.profiles]
    sides = [side for law in laws for side in law.sides]
    units, guesses = [law.units for law in laws], [law.guesses for law in laws]
    parts = np.zeros((len(laws) + 1, FIRST_ALGEBRAIC + 1), np.int64)  # the last row holds the ends of the columns FIRST_...
    parts[:-1, FORCES] = [law.addresses.forces for law in laws]
    parts[:, FIRST_SIDE] = starts([law.sides for law in laws])
    parts[:, FIRST_NUMBER] = first
    parts[:-1, RATES] = [law.addresses.rates for law in laws]
    parts[:, FIRST_STATE] = starts(units)
    parts[:-1, RATED] = [law.rated for law in laws]
    parts[:, FIRST_ALGEBRAIC] = starts(guesses)
    result = Laws(
        parts=parts,
        states=np.concatenate([NO_NUMBERS, *units]),
        guesses=np.concatenate([NO_NUMBERS, *guesses]),
        points=np.array([-1 if side.at is None else points.add(side.at, side.part) for side in sides], np.int64),
        rest=np.array([side.rest for side in sides], float).reshape(-1, 2),
        sizes=np.array([side.size(size) for side in sides], float),
        energies=np.array([law.addresses.energy for law in laws], np.int64),
        slopes=np.array([energy_slope_of(law.callbacks) for law in laws], np.int64),
        elements=len(elements),
        numbers=np.concatenate(numbers),
        driven=np.array(driven, np.int64).reshape(-1, 2),
        clock=drives.add(polynomial([0.0, 1.0]), "") if laws else -1,
    )
    return result, [law.callbacks for law in laws]


def _functions_of_part(python, calls, written, arguments, of_energy, shape):
    """Return (OwnData, Addresses, Callbacks) of a part. Functions that numba compiles get a C function, the others a callback into Python.

    python: PythonFunctions of the part. written: names of the functions that it writes. arguments, of_energy: arguments of its functions,
    and of its energy, {name: (its place, its shape)} as of `OwnData.c_function`. shape: of its forces.
    """
    functions = {name: function for name, function in python.part.compiled_functions().items() if name in written}
    data = OwnData(python.part, functions.values())
    options = {"forces": {"arguments": arguments, "shape": shape}, "energy": {"arguments": of_energy, "shape": ()}}
    # the force on the coordinates is minus the elastic force
    options["elastic"] = {"arguments": arguments, "shape": shape, "factor": -1.0, "of_complex": True}
    if "s" in arguments:
        _, shape_of_states = arguments["s"]
        options["rates"] = {"arguments": arguments, "shape": shape_of_states}
    try:
        addresses = {name: data.c_function(function, **options[name]) for name, function in functions.items()}
    except InputError as error:
        raise InputError(f"{python.name}: {error}") from None
    callbacks = Callbacks(python, calls, arguments, of_energy, shape, frozenset(written - {*functions}))
    addresses |= callbacks.addresses
    if "elastic" in written:
        addresses["forces"] = addresses.pop("elastic", 0)
    return data, Addresses(**addresses), callbacks


def energy_slope_of(callbacks):
    """Return from what the discrete gradient of a law takes the slope of its energy.

    ENERGIES if static forces are not minus this slope: the element `works`, or its forces in Python depend on states. TIMELESS for other
    forces in Python, which may depend on time, and STATIC for compiled ones.
    """
    part, in_python = callbacks.functions.part, "forces" in callbacks.addresses
    if isinstance(part, ForceElement) and (part.works or in_python and "s" in callbacks.arguments):
        return ENERGIES
    return TIMELESS if in_python else STATIC


def with_callbacks(laws, callbacks):
    """Return a copy of the laws that calls the functions of other callbacks, [Callbacks of each law]."""
    parts, energies = laws.parts.copy(), laws.energies.copy()
    for k, addresses in enumerate(one.addresses for one in callbacks):
        parts[k, FORCES] = addresses.get("forces", addresses.get("elastic", parts[k, FORCES]))
        parts[k, RATES] = addresses.get("rates", parts[k, RATES])
        energies[k] = addresses.get("energy", energies[k])
    return laws._replace(parts=parts, energies=energies)
