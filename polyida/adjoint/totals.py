"""The slopes of an objective in the parameters of a model, added up as the sweep goes back."""

import numpy as np

from polyida.adjoint.parameters import parameters_of
from polyida.adjoint.parameters.parameter import Work
from polyida.errors import InputError
from polyida.given import is_one_of
from polyida.objective.slopes import Slopes


class Totals:
    """Sums by the names of parameters. names: those that are wanted, or None for all that a model offers by itself; given: whether v0, the
    velocities that a run was given, is one too. left_out: {name: reason} of those that the model has and that are not taken without their
    names.
    """

    def __init__(self, model, names=None, given=False):
        self.known = known = parameters_of(model)
        self.parameters = {name: known[name] for name in _wanted(known, names, given)}
        self.with_v0 = given and (names is None or "v0" in names)
        self.sums = {name: np.zeros(np.shape(parameter.value)) for name, parameter in self.parameters.items()}
        self.left_out = {} if names is not None else {name: parameter.why for name, parameter in known.items() if parameter.asked}

    def work(self, work):
        """Add what multiplies the equations of some states."""
        for name, parameter in self.parameters.items():
            self.sums[name] = self.sums[name] + parameter.work(work)

    def own(self, slopes):
        """Add what an objective's own Slopes say of parameters."""
        for name, slope in slopes.direct.items():
            shape = np.shape(_known(name, self.known).value)
            if np.shape(slope) != shape:
                raise InputError(f"gradient: the objective's own slope in {name!r} has shape {np.shape(slope)}, the parameter {shape}")
            if name in self.sums:
                self.sums[name] = self.sums[name] + slope
        if slopes.of_model is not None:
            for name, parameter in self.parameters.items():
                self.sums[name] = self.sums[name] + parameter.of_model(slopes.of_model)
        if slopes.work is not None:
            self.work(Work(*slopes.work))

    def start(self, state, v0):
        """Add what velocities that the run was given do."""
        for name, parameter in self.parameters.items():
            found = parameter.start(state.t, state.q, v0)
            if found is not None:
                self.sums[name] = self.sums[name] + found
        if self.with_v0:
            self.sums["v0"] = v0

    def slopes(self):
        """{name: slope}, numbers as floats."""
        return {name: float(total) if np.ndim(total) == 0 else total for name, total in self.sums.items()}


class OwnSlopes:
    """An objective's own Slopes, by the states of a course, of which some are frames of the run."""

    def __init__(self, objective, run, frames, totals):
        self.slopes, self.frames, self.totals = objective.slopes(run), frames, totals
        self.value = float(self.slopes.value if hasattr(self.slopes, "value") else objective(run))

    def of(self, first, end):
        """Those of states first to end, zero in those that are no frames; what they say of parameters is added to the totals."""
        frames = self.frames[first:end]
        kept = frames[frames >= 0]
        if not len(kept):
            return Slopes()
        own = self.slopes(slice(int(kept[0]), int(kept[-1]) + 1))
        self.totals.own(own)
        return own if len(kept) == len(frames) else _spread(own, frames)


def _spread(own, frames):
    """Slopes of frames as those of states, of which the others are no frames."""
    found = {}
    each = {name: getattr(own, name) for name in ("q", "v", "a", "lam")} | {"t": own.by_time()}
    for name, slopes in each.items():
        if slopes is not None:
            found[name] = np.zeros((len(frames), *slopes.shape[1:]))
            found[name][frames >= 0] = slopes
    return Slopes(**found)


def _wanted(known, names, given):
    """The names asked for, or all that are offered unasked."""
    if names is None:
        return [name for name, parameter in known.items() if not parameter.asked]
    return [_known(name, known, given).name for name in names if not (given and name == "v0")]


def _known(name, known, given=False):
    """The parameter of a name. Raises InputError where there is none."""
    if not is_one_of(name, known):
        names = [*known, "v0"] if given else known
        raise InputError(f"gradient: {name!r} is no parameter of what it is taken for; known: {', '.join(map(repr, names)) or 'none'}")
    return known[name]
