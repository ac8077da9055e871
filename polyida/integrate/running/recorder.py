"""Sensors of a run: a user's functions, called at every accepted step."""

import numpy as np

from polyida.errors import InputError
from polyida.given import read_only, reals
from polyida.sensor import Sensor

FEW = 64  # rows to begin with


def require_sensors(part, sensors):
    """Raise InputError, in the name of `part`, unless it is {name: function} or None."""
    if sensors is None:
        return
    if not isinstance(sensors, dict):
        raise InputError(f"{part}: sensors = {sensors!r:.100} must be a dictionary, name -> function of t, q and v")
    for name, function in sensors.items():
        if not (isinstance(name, str) and name):
            raise InputError(f"{part}: sensors: the name {name!r:.100} must be a text")
        if not (callable(function) or isinstance(function, Sensor)):
            raise InputError(f"{part}: sensors: {name!r} is {function!r:.100}, it must be a function of t, q and v, or of polyida.sensor")


class Recorder:
    """Calls sensors of a model, {name: f(t, q, v) or a Sensor}, and keeps what they give, row after row.

    shapes: {name: shape of what it gives}; rows (steps, 1 + numbers): the time and all of it. `before`: Sensors of the run so far, to go
    on from; without it the first step tells the shapes.
    """

    def __init__(self, model, functions, before=None):
        self.model, self.functions, self.count = model, functions, 0
        self.shapes, self._rows = {}, np.empty((0, 1))
        if before:
            self.shapes, self._rows, self.count = dict(before.shapes), before.rows, len(before.rows)

    def step(self, state):
        """An accepted state. Raises InputError naming the sensor that gives anything but finite numbers of the shape that it gave first."""
        if not self.functions:
            return
        values = {name: self._value(name, state) for name in self.functions}
        self.shapes = self.shapes or {name: value.shape for name, value in values.items()}
        row = np.concatenate([[state.t], *(value.ravel() for value in values.values())])
        if self.count == len(self._rows):
            more = np.empty((max(FEW, self.count), len(row)))
            self._rows = np.concatenate([self._rows, more]) if self.count else more
        self._rows[self.count] = row
        self.count += 1

    def _value(self, name, state):
        sensor = self.functions[name]
        plain = not isinstance(sensor, Sensor)
        found = reals(sensor(state.t, read_only(state.q), read_only(state.v)) if plain else sensor.read(self.model, state))
        if found is None:
            wrong = "no real numbers"
        elif found.shape != self.shapes.get(name, found.shape):
            wrong = f"an array of shape {found.shape}"
        elif not np.isfinite(found).all():
            wrong = "numbers that are not finite"
        else:
            return found
        wanted = "a finite number or an array of them, of the same shape each time"
        raise InputError(f"sensors: {name!r} gave {wrong} at t = {state.t:.9g} s; it must give {wanted}")

    @property
    def rows(self):
        """All that was recorded."""
        return self._rows[: self.count]
