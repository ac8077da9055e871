"""Gradient, the result of `pi.gradient`, and sums of an objective's slopes in the parameters during a backward sweep."""

from collections.abc import ItemsView, Iterator, KeysView
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from polyida.adjoint.parameter import AdjointMultipliers
from polyida.adjoint.parameters import parameters_of
from polyida.errors import InputError
from polyida.integrate.state import Counts
from polyida.objective.objective import Slopes
from polyida.reprs import counted, short, table
from polyida.validation import is_one_of, named_keywords


@named_keywords
@dataclass(frozen=True, eq=False)
class Gradient:
    """Value of an objective and its slopes dJ/dp: `gradient["arm.stiffness"]`, (cells,).

    Parameters
    ----------
    value : float
        J.
    slopes : dict of str to float or array
        {name: dJ/dp}, of the shape of the parameter, in the unit of J over that of the parameter.
    counts : Counts
        Work of the backward sweep.
    left_out : dict of str to str
        {name: reason} of parameters without a slope; `pi.gradient(run, J, parameters=[name])` gives it.
    """

    value: float
    slopes: dict[str, float | NDArray]
    counts: Counts = field(default_factory=Counts)
    left_out: dict[str, str] = field(default_factory=dict)

    def __getitem__(self, name: str) -> float | NDArray:
        """dJ/dp of a parameter. Raises InputError for an unknown name."""
        if name not in self.slopes:
            why = f" ({self.left_out[name]}); ask for it by `parameters`" if is_one_of(name, self.left_out) else ""
            raise InputError(f"gradient: {name!r} is no parameter it was taken for{why}; known: {', '.join(map(repr, self.slopes))}")
        return self.slopes[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.slopes)

    def __len__(self):
        return len(self.slopes)

    def __contains__(self, name):
        return name in self.slopes

    def keys(self) -> KeysView[str]:
        """The parameters' names."""
        return self.slopes.keys()

    def items(self) -> ItemsView[str, float | NDArray]:
        """(name, slope) of each parameter."""
        return self.slopes.items()

    def __repr__(self):
        more = f"; left out, to be asked for by name: {counted(self.left_out)}" if self.left_out else ""
        slopes = counted(name if np.ndim(slope) else f"{name}: {slope:.6g}" for name, slope in self.slopes.items())
        return f"Gradient(value={self.value:.9g}, {slopes}{more})"

    def _repr_html_(self):
        rows = [(name, np.shape(slope) or "", short(slope)) for name, slope in self.slopes.items()]
        rows += [(name, "", f"left out: {why}") for name, why in self.left_out.items()]
        return table(f"J = {self.value:.9g}", ("parameter", "shape", "dJ/dp"), rows)


class Totals:
    """Sums of slopes by the names of parameters.

    names: the requested ones, or None for all inexpensive ones; with_v0: True if v0, the initial velocities of the run, is a parameter too.
    left_out: {name: reason} of parameters that are taken by name only.
    """

    def __init__(self, model, names=None, with_v0=False):
        self.known = known = parameters_of(model)
        inexpensive = [name for name, parameter in known.items() if not parameter.only_by_name]
        wanted = inexpensive if names is None else [_find(name, known, with_v0).name for name in names if not (with_v0 and name == "v0")]
        self.parameters = {name: known[name] for name in wanted}
        self.with_v0 = with_v0 and (names is None or "v0" in names)
        self.sums = {name: np.zeros(np.shape(parameter.value)) for name, parameter in self.parameters.items()}
        self.left_out = {} if names is not None else {name: parameter.reason for name, parameter in known.items() if parameter.only_by_name}

    def add(self, multipliers):
        """Add the slopes of AdjointMultipliers."""
        for name, parameter in self.parameters.items():
            self.sums[name] = self.sums[name] + parameter.slope(multipliers)

    def add_own(self, slopes):
        """Add the parts of an objective's Slopes that belong to parameters."""
        for name, slope in slopes.direct.items():
            shape = np.shape(_find(name, self.known).value)
            if np.shape(slope) != shape:
                raise InputError(f"gradient: the objective's own slope in {name!r} has shape {np.shape(slope)}, the parameter {shape}")
            if name in self.sums:
                self.sums[name] = self.sums[name] + slope
        if slopes.of_model is not None:
            for name, parameter in self.parameters.items():
                self.sums[name] = self.sums[name] + parameter.of_model(slopes.of_model)
        if slopes.work is not None:
            self.add(AdjointMultipliers(*slopes.work))

    def add_start(self, state, v0):
        """Add the slopes of the initial velocities with bar v0."""
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
    """An objective's Slopes by the states of a history, some of which are frames of the run."""

    def __init__(self, objective, run, frames, totals):
        self.slopes, self.frames, self.totals = objective.slopes(run), frames, totals
        self.value = float(self.slopes.value if hasattr(self.slopes, "value") else objective(run))

    def at_states(self, first, end):
        """The Slopes at states first to end - 1, zero at states that are no frames; their parts in parameters are added to the totals."""
        frames = self.frames[first:end]
        numbers = frames[frames >= 0]
        if not len(numbers):
            return Slopes()
        own = self.slopes(slice(int(numbers[0]), int(numbers[-1]) + 1))
        self.totals.add_own(own)
        if len(numbers) == len(frames):
            return own
        found = {}
        each = {name: getattr(own, name) for name in ("q", "v", "a", "lam")} | {"t": own.by_time()}
        for name, slopes in each.items():
            if slopes is not None:
                found[name] = np.zeros((len(frames), *slopes.shape[1:]))
                found[name][frames >= 0] = slopes
        return Slopes(**found)


def _find(name, known, with_v0=False):
    """The parameter of a name. Raises InputError for an unknown one."""
    if not is_one_of(name, known):
        names = [*known, "v0"] if with_v0 else known
        raise InputError(f"gradient: {name!r} is no parameter of what it is taken for; known: {', '.join(map(repr, names)) or 'none'}")
    return known[name]
