"""Sampling of a run: frames at accepted steps or given times, sensors at every step, the zero of `until`."""

import numpy as np

from polyida.errors import InputError
from polyida.integrate.state import Stretch, between
from polyida.jit.user_functions import over
from polyida.sensor import Sensor
from polyida.validation import is_number, read_only, reals

FEW = 64  # rows of sensors at first


class Sampler:
    """Stores every `every`-th accepted state, the first and the last; or the times `output`.

    rows: `FrameStore.rows` if each state becomes a frame, or None.
    """

    def __init__(self, store, counts, every=1, output=None, done=0):
        self.store, self.counts, self.every = store, counts, every
        self.output, self.next, self.last_frame = output, done, None
        self.rows = store.rows if every == 1 and output is None else None

    def start(self, state):
        """Store the first state."""
        if self.output is None:
            self.keep(state)
        elif self.next < len(self.output) and self.output[self.next] == state.t:
            self.next += 1
            self.keep(state)

    def step(self, before, stretch):
        """Store frames of the steps from an accepted state to those of a stretch, the last of which is number `counts.steps`."""
        if self.output is None:
            self._keep_every(stretch, self.counts.steps - len(stretch))
            return
        while self.next < len(self.output) and self.output[self.next] <= stretch.t[-1]:
            t = self.output[self.next]
            k = int(np.searchsorted(stretch.t, t))
            self.keep(between(stretch.state(k - 1) if k else before, stretch.state(k), t))
            self.next += 1

    def _keep_every(self, stretch, done):
        first = -(done + 1) % self.every
        if first < len(stretch):
            self.store.extend(stretch.part(first, len(stretch), self.every))
            self.last_frame = None if (done + len(stretch)) % self.every else stretch.last

    def keep(self, state):
        """Store a state as the next frame, unless it is the last one already."""
        if state is not self.last_frame:
            self.store.extend(Stretch.of(state))
            self.last_frame = state


def leading(good):
    """Number of True entries before the first False."""
    return int(np.append(good, False).argmin())


class Until:
    """Detects a change of sign of f(t, q, v) from step to step. Raises InputError if f returns no finite number."""

    def __init__(self, function, state):
        self.function = function
        self.sign = np.sign(self._value(state))
        self.quiet(Stretch.of(state))  # raises InputError if numba cannot compile it

    def quiet(self, stretch):
        """Number of states at the start of a stretch without a change of sign, of a compiled function; 0 for one in Python."""
        values = over("until:", self.function, stretch.t, stretch.q, stretch.v)
        return 0 if values is None or not self.sign else leading(np.sign(values[:, 0]) == self.sign)

    def crossing(self, before, after):
        """The state between two accepted ones at which f is zero, or None. A zero at the start is ignored."""
        value = self._value(after)
        if self.sign == 0 or (value != 0 and np.sign(value) == self.sign):
            self.sign = self.sign or np.sign(value)
            return None
        if value == 0:
            return after
        from scipy.optimize import brentq

        at = brentq(lambda t: self._value(between(before, after, t)), before.t, after.t, xtol=1e-300, rtol=4 * np.finfo(float).eps)
        return between(before, after, at)

    def _value(self, state):
        value = self.function(state.t, read_only(state.q), read_only(state.v))
        value = value.item() if isinstance(value, np.ndarray) and value.size == 1 else value
        if is_number(value):
            return float(value)
        shown = f"an array of shape {np.shape(value)}" if np.ndim(value) else repr(value)
        wanted = "a finite number that changes sign where the run is to stop, like t - 0.02"
        raise InputError(f"until: the function gave {shown} at t = {state.t:.9g} s; it must give {wanted}")


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
    """Calls sensors of a model, {name: f(t, q, v) or a Sensor}, and records their values.

    shapes: {name: shape of a value}, known after the first step; rows (steps, 1 + numbers): time and values. before: Sensors of the run so
    far, for `resume`.
    """

    def __init__(self, model, functions, before=None):
        self.model, self.functions, self.count = model, functions, 0
        self.shapes, self._rows = {}, np.empty((0, 1))
        if before:
            self.shapes, self._rows, self.count = dict(before.shapes), before.rows, len(before.rows)

    def step(self, state):
        """Record an accepted state. Raises InputError if a sensor does not return finite numbers of its first shape."""
        if not self.functions:
            return
        values = {name: self._value(name, state) for name in self.functions}
        self.shapes = self.shapes or {name: value.shape for name, value in values.items()}
        if not self.count:
            self.quiet(Stretch.of(state))  # raises InputError if numba cannot compile it
        self._add(np.concatenate([[state.t], *(value.ravel() for value in values.values())])[None])

    def quiet(self, stretch):
        """Number of states at the start of a stretch with finite values of compiled sensors, for `take`; 0 if a sensor is Python."""
        if not self.functions:
            return len(stretch)
        found, given = [], (stretch.t, stretch.q, stretch.v)
        for name, shape in self.shapes.items():
            if (values := over(f"sensors: {name!r}:", self.functions[name], *given, shape=shape)) is None:
                return 0
            found.append(values)
        self.ahead = np.column_stack([stretch.t, *found])
        return leading(np.isfinite(self.ahead).all(axis=1))

    def take(self, first, end):
        """Record the states `first` to `end` of the last stretch of `quiet`."""
        if self.functions:
            self._add(self.ahead[first:end])

    def _add(self, rows):
        count = self.count + len(rows)
        if count > len(self._rows):
            more = np.empty((max(FEW, count), rows.shape[1]))
            self._rows = np.concatenate([self._rows[: self.count], more]) if self.count else more
        self._rows[self.count : count] = rows
        self.count = count

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
        """The recorded rows."""
        return self._rows[: self.count]
