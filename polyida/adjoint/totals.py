"""What `pi.gradient` gives, and the slopes of an objective in the parameters of a model, added up as a sweep goes back."""

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
        return f"Gradient(value={self.value:.9g}, {counted(self.slopes)}{more})"

    def _repr_html_(self):
        rows = [(name, np.shape(slope) or "", short(slope)) for name, slope in self.slopes.items()]
        rows += [(name, "", f"left out: {why}") for name, why in self.left_out.items()]
        return table(f"J = {self.value:.9g}", ("parameter", "shape", "dJ/dp"), rows)


class Totals:
    """Sums by the names of parameters. names: those that are wanted, or None for all that a model offers by itself; given: whether v0, the
    velocities that a run was given, is one too. left_out: {name: reason} of those that the model has and that are not taken without their
    names.
    """

    def __init__(self, model, names=None, given=False):
        self.known = known = parameters_of(model)
        unasked = [name for name, parameter in known.items() if not parameter.asked]
        wanted = unasked if names is None else [_known(name, known, given).name for name in names if not (given and name == "v0")]
        self.parameters = {name: known[name] for name in wanted}
        self.with_v0 = given and (names is None or "v0" in names)
        self.sums = {name: np.zeros(np.shape(parameter.value)) for name, parameter in self.parameters.items()}
        self.left_out = {} if names is not None else {name: parameter.why for name, parameter in known.items() if parameter.asked}

    def add(self, multipliers):
        """Add what multiplies the equations of some states."""
        for name, parameter in self.parameters.items():
            self.sums[name] = self.sums[name] + parameter.slope(multipliers)

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
            self.add(AdjointMultipliers(*slopes.work))

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
        if len(kept) == len(frames):
            return own
        found = {}
        each = {name: getattr(own, name) for name in ("q", "v", "a", "lam")} | {"t": own.by_time()}
        for name, slopes in each.items():
            if slopes is not None:
                found[name] = np.zeros((len(frames), *slopes.shape[1:]))
                found[name][frames >= 0] = slopes
        return Slopes(**found)


def _known(name, known, given=False):
    """The parameter of a name. Raises InputError where there is none."""
    if not is_one_of(name, known):
        names = [*known, "v0"] if given else known
        raise InputError(f"gradient: {name!r} is no parameter of what it is taken for; known: {', '.join(map(repr, names)) or 'none'}")
    return known[name]
