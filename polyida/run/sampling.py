"""What of a run is kept, and where it stops: frames at accepted steps or given times, sensors at every step, the zero of a function."""

import numpy as np

from polyida.errors import InputError
from polyida.integrate.state import Stretch, between
from polyida.jit.user_functions import over
from polyida.sensor import Sensor
from polyida.validation import is_number, read_only, reals

FEW = 64  # rows of sensors to begin with


class Sampler:
    """Puts into a store every `every`-th accepted step, the first and the last; or the times `output`, where given.

    rows: the store's places of the next states, where each becomes a frame, or None.
    """

    def __init__(self, store, counts, every=1, output=None, done=0):
        self.store, self.counts, self.every = store, counts, every
        self.output, self.next, self.kept = output, done, None
        self.rows = store.rows if every == 1 and output is None else None

    def start(self, state):
        """Keep the first state."""
        if self.output is None:
            self.keep(state)
        elif self.next < len(self.output) and self.output[self.next] == state.t:
            self.next += 1
            self.keep(state)

    def step(self, before, stretch):
        """Keep what is wanted of the steps from one accepted state to those of a stretch, the last of which is number `counts.steps`."""
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
            self.kept = None if (done + len(stretch)) % self.every else stretch.last

    def keep(self, state):
        """Make a state the next frame, unless it is the last one already."""
        if state is not self.kept:
            self.store.extend(Stretch.of(state))
            self.kept = state


def leading(good):
    """How many entries are True before the first that is not."""
    return int(np.append(good, False).argmin())


class Until:
    """Watches f(t, q, v) for a change of sign from step to step. Raises InputError where it gives no finite number."""

    def __init__(self, function, state):
        self.function = function
        self.sign = np.sign(self._value(state))
        self.quiet(Stretch.of(state))  # what numba cannot compile is refused before the run

    def quiet(self, stretch):
        """How many states lead a stretch without a change of sign, of a compiled function; 0 of one in Python."""
        values = over("until:", self.function, stretch.t, stretch.q, stretch.v)
        return 0 if values is None or not self.sign else leading(np.sign(values[:, 0]) == self.sign)

    def crossing(self, before, after):
        """The state where f is zero between two accepted ones, or None. A zero at the start does not count."""
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
        given = f"an array of shape {np.shape(value)}" if np.ndim(value) else repr(value)
        wanted = "a finite number that changes sign where the run is to stop, like t - 0.02"
        raise InputError(f"until: the function gave {given} at t = {state.t:.9g} s; it must give {wanted}")


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
        if not self.count:
            self.quiet(Stretch.of(state))  # what numba cannot compile is refused before the run
        self._add(np.concatenate([[state.t], *(value.ravel() for value in values.values())])[None])

    def quiet(self, stretch):
        """How many states lead a stretch at which compiled sensors give finite numbers, for `take`; 0 where one is Python."""
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
        """The accepted states from number `first` to before `end` of the stretch that `quiet` looked at last."""
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
        """All that was recorded."""
        return self._rows[: self.count]
