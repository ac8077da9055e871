"""What sensors gave at every accepted step of a run."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray


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
