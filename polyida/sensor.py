"""Ready sensors: what of every accepted state `solve(..., sensors={name: sensor})` records, and what they gave in a run."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polyida.errors import InputError
from polyida.integrate.state import State
from polyida.results.motion import reaction_of
from polyida.validation import is_one_of, named_keywords, read_only

__all__ = ["position", "reaction", "state"]


@dataclass(frozen=True)
class Sensor:
    """Something that reads numbers of a model's state."""

    read: Callable[[Any, State], ArrayLike]


@named_keywords
def position(of: object) -> Sensor:
    """The place of a mass, load or joint, by name or itself, or of an attachment, (2,), m."""
    return Sensor(lambda model, state: model.position(of, state.q[None])[0])


@named_keywords
def reaction(joint: str) -> Sensor:
    """What a joint, by name, does to its side b, as `run.reaction` tells it: (k,), N and N m."""

    def read(model, state):
        if not is_one_of(joint, model.rows):
            raise InputError(f"sensor.reaction: no joint is called {joint!r:.100}; known: {', '.join(map(repr, model.rows))}")
        return reaction_of(model, joint, np.array([state.t]), state.q[None], state.lam[None])[0]

    return Sensor(read)


@named_keywords
def state(function: Callable[[State], ArrayLike]) -> Sensor:
    """A function of the whole State: t, q, v, a, lam, to read only. Raises InputError where it is no function."""
    if not callable(function):
        raise InputError(f"sensor.state: {function!r:.100} must be a function of a State")
    return Sensor(lambda model, state: function(State(state.t, *(read_only(x) for x in (state.q, state.v, state.a, state.lam)))))


@dataclass(frozen=True, eq=False)
class Sensors(Mapping):
    """{name: what it gave, (steps, ...)} at the times t (steps,): the run's start and every accepted step, whatever became a frame.

    shapes: {name: shape of what it gives}; rows: (steps, 1 + numbers), the time and all of it.
    """

    shapes: dict = field(default_factory=dict)
    rows: NDArray = field(default_factory=lambda: np.zeros((0, 1)), repr=False)

    @property
    def t(self) -> NDArray:
        """Times, (steps,), s."""
        return self.rows[:, 0]

    def __getitem__(self, name: str) -> NDArray:
        first = 1
        for known, shape in self.shapes.items():
            end = first + int(np.prod(shape))
            if known == name:
                return self.rows[:, first:end].reshape(len(self.rows), *shape)
            first = end
        raise KeyError(f"no sensor is called {name!r}; known: {', '.join(map(repr, self.shapes)) or 'none'}")

    def __iter__(self) -> Iterator[str]:
        return iter(self.shapes)

    def __len__(self) -> int:
        return len(self.shapes)
