"""A model whose plates' cells are scaled, each by factors of its own: all that does not follow from them stays shared."""

from dataclasses import replace

import numpy as np

from polyida.assembly.arrays import concatenated
from polyida.assembly.factors.shares import Shares
from polyida.assembly.loads import dead_loads, steady
from polyida.errors import InputError
from polyida.given import read_only, reals

OF_FACTORS = ("_mass", "_even_mass", "_mass_factor", "drawn")  # what a model keeps that follows from them, its arrays and bodies apart
WHAT = ("stiffness", "mass")


def scaled(model, given):
    """A copy of the model with the factors `given`, {plate: (stiffness, mass)}; other plates keep theirs. Raises InputError."""
    shares, checked = model.once(Shares, of_shape=True), _checked(model, given)
    factors = [checked.get(body.name, body.factors) for body in model.bodies]
    plates = shares.scaled(*(concatenated(each, float) for each in zip(*factors))) if factors else shares.plates
    other = object.__new__(type(model))
    other.__dict__.update({name: value for name, value in model.__dict__.items() if name not in OF_FACTORS})
    other.bodies = [_scaled_plate(*each, plates) for each in zip(model.bodies, factors, plates.at, plates.at[1:])]
    other.places = model.places | {id(body.plate): body for body in other.bodies}
    other.arrays, other._kept = model.arrays._replace(plates=_weighed(other, plates)), {}
    return other


def factors_of(model):
    """{plate: (stiffness, mass)} of all its full plates."""
    return {body.name: body.factors for body in model.bodies}


def told(model):
    """{plate: (stiffness, mass)} of the plates that are not full."""
    return {name: factors for name, factors in factors_of(model).items() if not all((factor == 1.0).all() for factor in factors)}


def _scaled_plate(body, factors, first, last, plates):
    """The plate in its place, its operator's numbers taken from the arrays."""
    pattern = slice(first[6], last[6])
    stabilisation = None if body.operator.stabilisation is None else plates.stabilisation[pattern]
    operator = replace(body.operator, weights=plates.weights[first[3] : last[3]], mass=plates.mass[pattern], stabilisation=stabilisation)
    return replace(body, operator=operator, factors=factors)


def _weighed(model, plates):
    """The arrays with the weight of the model's bodies."""
    loads = dead_loads(model.parts, model.gravity, model.places)
    return plates._replace(
        weight=np.concatenate([placed.weight(steady(model.gravity)) for placed in (*model.bodies, *model.few)]),
        load_values=concatenated([load.forces for load in loads], float, (2,)),
    )


def _checked(model, given):
    """{plate: (stiffness, mass)}, each (cells,), of what was given. Raises InputError."""
    known, found = {body.name: body for body in model.bodies}, {}
    for name, pair in given.items():
        if name not in known:
            raise InputError(_unknown(model, name, known))
        if not isinstance(pair, (tuple, list)) or len(pair) != 2:
            raise InputError(f"with_factors: {name} = {pair!r:.100} must be a pair (stiffness, mass); None for a factor of 1")
        found[name] = tuple(_factor(name, what, one, known[name].mesh.n_cells) for what, one in zip(WHAT, pair))
    return found


def _unknown(model, name, known):
    part = model.parts.get(name)
    if any(placed.name == name for placed in model.few):
        return f"with_factors: {name!r} is a {type(part).__name__}: only the cells of full plates have factors, take its plate into the scene itself"
    what = "no part of the scene" if part is None else f"a {type(part).__name__}"
    return f"with_factors: {name!r} is {what}; plates: {', '.join(map(repr, known)) or 'none'}"


def _factor(name, what, given, cells):
    """A factor of every cell, (cells,), that nobody can write."""
    label = f"with_factors: the {what} of {name!r}"
    array = np.ones(()) if given is None else reals(given)
    if array is None or array.shape not in ((), (cells,)):
        shape = "" if array is None else f", of shape {array.shape},"
        raise InputError(f"{label} = {given!r:.100}{shape} must be a positive number, or one for each of its {cells} cells, ({cells},)")
    wrong = np.flatnonzero(~((array > 0) & (array < np.inf)))
    if wrong.size:
        raise InputError(f"{label} is {array.flat[wrong[0]]:g}{f' in cell {wrong[0]}' * array.ndim}: factors must be positive and finite")
    return read_only(np.array(np.broadcast_to(array, cells)))
