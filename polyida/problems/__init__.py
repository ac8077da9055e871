"""Ready problems with references: `get(name)` gives a Problem, `names()` what there is. A user's own enters `polyida.registry.problems`."""

import inspect
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from polyida import registry
from polyida.errors import InputError
from polyida.reprs import brief
from polyida.validation import is_one_of, named_keywords, reals

if TYPE_CHECKING:
    from polyida.trajectory import Trajectory


@named_keywords
@dataclass(frozen=True)
class Problem:
    """A model with its initial state and what is known of its solution.

    model: a Model. q0, v0 (n,): initial state at t = 0, or None where the model's own is meant. t_end: s.
    reference: {"q": (n,), "v": (n,), "lam": (m,), ...} at t_end, as far as known, in the model's signs and units.
    source: where the reference comes from. quantity: what is compared, in which measure and units.
    known_to: {part: how far the reference may be off}, in the reference's units; of computed ones, how far two
    independent methods are apart. measures: {part: function(run)} for parts that are no array of a run's frames.
    """

    name: str
    model: object
    q0: np.ndarray | None
    v0: np.ndarray | None
    t_end: float
    reference: dict = field(default_factory=dict)
    source: str = ""
    quantity: str = ""
    known_to: dict = field(default_factory=dict)
    measures: dict = field(default_factory=dict)

    __repr__ = brief

    def errors(self, **found: ArrayLike) -> dict[str, float]:
        """{name: largest absolute deviation from the reference} of every given value, of the reference's shape.

        Raises InputError for a name that the reference does not know, and for another shape.
        """
        return {name: self._error(name, value) for name, value in found.items()}

    def compare(self, run: "Trajectory") -> dict[str, float]:
        """`errors` of a run at its end, for all that the reference knows. Raises InputError where it ends elsewhere."""
        if not len(getattr(run, "t", ())):
            raise InputError(f"problem {self.name!r}: {type(run).__name__} is no run with frames; give what solve returns")
        if abs(run.t[-1] - self.t_end) > 1e-9 * self.t_end:
            raise InputError(f"problem {self.name!r}: the run ends at t = {run.t[-1]:g} s, the reference is known at t = {self.t_end:g} s")
        return self.errors(
            **{name: self.measures[name](run) if name in self.measures else getattr(run, name)[-1] for name in self.reference}
        )

    def _error(self, name, value):
        if name not in self.reference:
            known = ", ".join(self.reference) or "nothing for these options"
            raise InputError(f"problem {self.name!r}: {name!r} is not in the reference, which knows {known}")
        shape = np.shape(self.reference[name])
        value = reals(value)
        if value is None:
            raise InputError(f"problem {self.name!r}: {name} must be numbers of shape {shape}")
        if value.shape != shape:
            raise InputError(f"problem {self.name!r}: {name} has shape {value.shape}, the reference has {shape}")
        return float(np.abs(value - self.reference[name]).max())


def names() -> tuple[str, ...]:
    """Names of all problems."""
    return tuple(registry.problems)


def get(name: str, **options: object) -> Problem:
    """The Problem of this name, made with `options`.

    Raises InputError where there is none of that name, and for an option it does not take or cannot be made with,
    naming the options there are.
    """
    if not is_one_of(name, registry.problems):
        raise InputError(f"problem {name!r} is unknown; there are {', '.join(registry.problems)}")
    make = registry.find(registry.problems, name)
    known = tuple(inspect.signature(make).parameters)
    takes = f"its options are {', '.join(known)}" if known else "it has no options"
    for option in options:
        if option not in known:
            raise InputError(f"problem {name!r} has no option {option!r}; {takes}")
    try:
        return make(**options)
    except InputError as error:
        raise InputError(f"problem {name!r}: {error}; {takes}") from None
