"""What `pi.gradient` gives: the value of an objective and its slopes, by the names of the parameters."""

from collections.abc import ItemsView, Iterator, KeysView
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from polyida.brief import counted, short, table
from polyida.errors import InputError
from polyida.given import is_one_of
from polyida.integrate.state import Counts
from polyida.keywords import named_keywords


@named_keywords
@dataclass(frozen=True, eq=False)
class Gradient:
    """An objective's value and dJ/dp by the name of each parameter: `found["arm.stiffness"]`, (cells,).

    A slope has its parameter's shape, and the unit of J over that of the parameter. counts: of the backward sweep. left_out: {name: reason}
    of the parameters that the model has and that were not taken: `pi.gradient(run, J, parameters=[name])` gives their slopes.
    """

    value: float
    slopes: dict[str, float | NDArray]
    counts: Counts = field(default_factory=Counts)
    left_out: dict[str, str] = field(default_factory=dict)

    def __getitem__(self, name: str) -> float | NDArray:
        """dJ/dp of a parameter. Raises InputError where there is none of this name."""
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
