"""Sensors for `solve(..., sensors={name: sensor})`, which records their values at every accepted state, and the recorded values."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from polyida.errors import InputError
from polyida.integrate.state import State
from polyida.results.motion import names_of_joints, reaction_of
from polyida.validation import is_one_of, named_keywords, read_only

__all__ = ["position", "reaction", "state"]


def __dir__():
    """Return the public names of the module, `__all__`, for `dir()`."""
    return __all__


@dataclass(frozen=True)
class Sensor:
    """A function of a model and a state.

    Parameters
    ----------
    read : function f(model, state) -> array_like
    name, unit : str
        Of its values, in headings of studies. unit: empty if they have several, or an unknown one.
    """

    read: Callable[[Any, State], ArrayLike]
    name: str = "sensor"
    unit: str = ""


@named_keywords
def position(of: object) -> Sensor:
    """Make a sensor of the place of a point, (2,), m.

    Parameters
    ----------
    of : str, part or attachment
        A mass, load or joint, by name or itself, or an attachment.

    Returns
    -------
    Sensor
        For `solve(..., sensors={name: sensor})`.
    """
    return Sensor(lambda model, state: model.position(of, state.q[None])[0], f"position of {getattr(of, 'label', of)}", "m")


@named_keywords
def reaction(joint: str) -> Sensor:
    """Make a sensor of the reaction of a joint on its side b, (k,), N and N m, as `run.reaction`.

    Parameters
    ----------
    joint : str

    Returns
    -------
    Sensor
        For `solve(..., sensors={name: sensor})`.
    """

    def read(model, state):
        """The reaction of the joint, (k,), N and N m, at a state of a model. Raises InputError for an unknown joint."""
        if not is_one_of(joint, model.rows):
            raise InputError(f"sensor.reaction: no joint is called {joint!r:.100}; known: {names_of_joints(model)}")
        return reaction_of(model, joint, np.array([state.t]), state.q[None], state.lam[None][:, model.columns])[0]

    return Sensor(read, f"reaction of {joint}")


@named_keywords
def state(function: Callable[[State], ArrayLike]) -> Sensor:
    """Make a sensor of a function of the whole state.

    Parameters
    ----------
    function : function f(state) -> array_like
        Of a read-only State: t, q, v, a, lam, x.

    Returns
    -------
    Sensor
        For `solve(..., sensors={name: sensor})`.
    """
    if not callable(function):
        raise InputError(f"sensor.state: {function!r:.100} must be a function of a State")
    return Sensor(lambda model, state: function(State(state.t, *map(read_only, (state.q, state.v, state.a, state.lam))).of(model)))


@dataclass(frozen=True, eq=False)
class Sensors(Mapping):
    """The recorded values of a run's sensors: a mapping {name: (steps, ...)}, at the start and at every accepted step.

    Parameters
    ----------
    shapes : dict, {name: shape of a value}
    rows : (steps, 1 + numbers) float
        The time, s, and the values of all sensors.
    """

    shapes: dict = field(default_factory=dict)
    rows: NDArray = field(default_factory=lambda: np.zeros((0, 1)), repr=False)

    @property
    def t(self) -> NDArray:
        """Times of the recorded values, (steps,), s."""
        return self.rows[:, 0]

    def __getitem__(self, name: str) -> NDArray:
        """The values of a sensor, (steps, ...). Raises KeyError with the known names."""
        first = 1
        for known, shape in self.shapes.items():
            end = first + int(np.prod(shape))
            if known == name:
                return self.rows[:, first:end].reshape(len(self.rows), *shape)
            first = end
        raise KeyError(f"no sensor is called {name!r}; known: {', '.join(map(repr, self.shapes)) or 'none'}")

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names of the sensors."""
        return iter(self.shapes)

    def __len__(self) -> int:
        """The number of sensors with recorded values."""
        return len(self.shapes)
