"""Gradients held against differences of what they are of."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from polyida.adjoint.alpha.again import Again
from polyida.adjoint.gradient import gradient
from polyida.adjoint.parameters import parameters_of
from polyida.adjoint.radau.stages import RadauAgain
from polyida.adjoint.still import StillAgain
from polyida.errors import InputError
from polyida.given import is_whole
from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.integrate.radau.radau_iia import RadauIIA
from polyida.keywords import named_keywords
from polyida.model.differences import EVERYWHERE, along, central
from polyida.trajectory import Trajectory

AGAINS = {GeneralizedAlpha: Again, RadauIIA: RadauAgain}
LITTLE = 1e-3  # of J: what J changes by with a whole parameter, below which that is no measure of errors
STEP = 1e-3 / 7e-4  # of a parameter: about a thousandth between the runs, in units of what `along` takes


@named_keywords
def check_gradient(run: Any, objective: Any, parameters: Sequence[str] | None = None, seed: int = 0) -> dict[str, float]:
    """{name: relative error} of `pi.gradient(run, objective)` against differences of fourth order of the run, the equilibrium or the modes.

    That is found again with each parameter changed by a thousandth and two, up and down (what is zero and must not be negative up only);
    of an array along one direction drawn at random (seed). A run takes the same steps again, solved to a tolerance of 1e-11 or less, its
    pieces between kinks stretched as these move. So what is seen is the error of the gradient, that of the run's own tolerance with it (of
    adaptive RadauIIA up to 70 rtol for PeakStress and PeakReaction, unless its `tolerance` is smaller),
    and that of the differences where a motion bends over so small a change (1e-4 in a soft plate that is flung about). Relative to the
    difference, or to J over a thousand times the parameter where that is larger. Left out are parameters that move a kink into the run or
    out of it (a motor that ends with it), or what constraints ask of the start. Raises InputError as `pi.gradient`, and for a seed that is
    no whole number.
    """
    if not is_whole(seed, 0):
        raise InputError(f"check_gradient: seed = {seed!r:.80} must be a whole number of at least 0")
    found, known = gradient(run, objective, parameters=parameters), parameters_of(run.model)
    objective, again = objective.named(run.model), _again(run)
    random, errors = np.random.default_rng(seed), {}
    for name in found:
        if name == "v0":
            way, made, room = _way(run.v[0], random), lambda change: again.frames(run.model, change), EVERYWHERE
        else:
            parameter, way = known[name], _way(known[name].value, random)
            made = lambda change, p=parameter: again.frames(p.replaced(p.value + change))  # noqa: E731
            room = parameter.room
            if not all(again.begins(parameter.replaced(parameter.value + s * way)) for s, _ in central(STEP) if s > room[0]):
                continue
        errors[name] = _error(found, name, way, lambda s, way=way, made=made: objective(made(s * way)), room)
    return errors


def _again(run):
    """What finds it again."""
    if not isinstance(run, Trajectory):
        return StillAgain(run)
    return next(again for kind, again in AGAINS.items() if isinstance(run.integrator, kind))(run)


def _way(value, random):
    """A direction in which a parameter is changed, of its size."""
    size = float(np.abs(value).max()) or 1.0
    return size * random.uniform(-1.0, 1.0, np.shape(value)) if np.ndim(value) else size


def _error(found, name, way, objective, room):
    slope = float(np.sum(found[name] * way))
    difference = float(along(objective, STEP, room))
    return abs(slope - difference) / max(abs(difference), LITTLE * abs(found.value), 1e-300)
