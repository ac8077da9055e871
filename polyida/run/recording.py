"""What is recorded of a run: frames at accepted steps or given times, sensors at every step, and the zero of `until` between two steps."""

import numpy as np

from polyida.errors import InputError
from polyida.integrate.start import on_drives
from polyida.integrate.state import Stretch, between
from polyida.jit.user_functions import over
from polyida.sensor import Sensor
from polyida.validation import is_number, read_only, reals, takes

FEW = 64  # rows of sensors at first


class Sampler:
    """Stores every `every`-th accepted state, the first and the last; or the times `output`.

    rows: `FrameStore.rows` if each state becomes a frame, or None. model: the one whose constraints frames at `output` satisfy if they are
    driven; None in runs with events.
    """

    def __init__(self, store, counts, every=1, output=None, done=0, model=None):
        """Take the FrameStore, the Counts of the run, and which states become frames: each `every`-th, or those at the times `output`.

        done: how many times of `output` are stored already, in a run that is resumed. model: as of the class.
        """
        self.store, self.counts, self.model = store, counts, model
        self.every, self.output = every, output
        self.next = done  # number of the next time of `output`
        self.last_frame = None  # the State of the last frame, if it was the last accepted one
        self.rows = store.rows if every == 1 and output is None else None

    def start(self, state):
        """Store the first state of a run, if frames are taken there."""
        if self.output is None:
            self.keep(state)
        elif self.next < len(self.output) and self.output[self.next] == state.t:
            self.next += 1
            self.keep(state)

    def step(self, before, stretch):
        """Store frames of the steps from an accepted state to those of a stretch, the last of which is number `counts.steps`."""
        if self.output is None:
            done = self.counts.steps - len(stretch)
            first = -(done + 1) % self.every
            if first < len(stretch):
                self.store.extend(stretch.part(first, len(stretch), self.every))
                self.last_frame = None if (done + len(stretch)) % self.every else stretch.last
            return
        while self.next < len(self.output) and self.output[self.next] <= stretch.t[-1]:
            t = self.output[self.next]
            k = int(np.searchsorted(stretch.t, t))
            self.keep(within(self.model, stretch.state(k - 1) if k else before, stretch.state(k), t))
            self.next += 1

    def keep(self, state):
        """Store a state as the next frame, unless it is the last one already."""
        if state is not self.last_frame:
            self.store.extend(Stretch.of(state))
            self.last_frame = state


def within(model, before, after, t):
    """The State at t between two accepted ones, or one of these, on driven constraints of a model that is not None."""
    state = between(before, after, t)
    return state if model is None or t in (before.t, after.t) else on_drives(model, state)


def leading(good):
    """Number of True entries before the first False."""
    return int(np.append(good, False).argmin())


def seen_by(function, model, states):
    """t, q and v of a State or Stretch as arguments of a user's function, and the model's first-order states if three are too few for it."""
    seen = states.t, states.q, states.v
    return (*seen, model.states_of(states.v)) if model.k and not takes(function, 3) else seen


def require_of_state(what, function, model):
    """Raise InputError, which names `what`, unless a function takes t, q and v, or t, q, v and x of a model with first-order states."""
    if not (takes(function, 3) or model.k and takes(function, 4)):
        states = ", or of t, q, v and x" * bool(model.k)
        raise InputError(f"{what} = {function!r:.100} must be a function of t, q and v{states}")


class Until:
    """Detects a change of sign of f(t, q, v) from step to step. Raises InputError if f returns no finite number.

    driven: the model whose driven constraints a state between two steps satisfies, as of Sampler.
    """

    def __init__(self, model, function, state, driven=None):
        """Take f and store its sign at the first state. driven: the model whose driven constraints states between steps satisfy."""
        self.model, self.function, self.driven = model, function, driven
        self.sign = np.sign(self._value(state))
        self.quiet(Stretch.of(state))  # raises InputError if numba cannot compile it

    def quiet(self, stretch):
        """Number of states at the start of a stretch without a change of sign, of a compiled function; 0 for one in Python."""
        values = over("until:", self.function, *seen_by(self.function, self.model, stretch))
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

        def at(t):
            """The state at time t between the two states, on the driven constraints."""
            return within(self.driven, before, after, t)

        return at(brentq(lambda t: self._value(at(t)), before.t, after.t, xtol=1e-300, rtol=4 * np.finfo(float).eps))

    def _value(self, state):
        """The function's value at a state, a float. Raises InputError unless it is finite."""
        t, *vectors = seen_by(self.function, self.model, state)
        value = self.function(t, *map(read_only, vectors))
        value = value.item() if isinstance(value, np.ndarray) and value.size == 1 else value
        if is_number(value):
            return float(value)
        shown = f"an array of shape {np.shape(value)}" if np.ndim(value) else repr(value)
        expected = "a finite number that changes sign where the run is to stop, like t - 0.02"
        raise InputError(f"until: the function gave {shown} at t = {state.t:.9g} s; it must give {expected}")


def require_sensors(part, sensors, model):
    """Raise InputError, in the name of `part`, unless it is {name: function} or None."""
    if sensors is None:
        return
    if not isinstance(sensors, dict):
        raise InputError(f"{part}: sensors = {sensors!r:.100} must be a dictionary, name -> function of t, q and v")
    for name, function in sensors.items():
        if not (isinstance(name, str) and name):
            raise InputError(f"{part}: sensors: the name {name!r:.100} must be a text")
        if not isinstance(function, Sensor):
            require_of_state(f"{part}: sensors[{name!r}]", function, model)


class Recorder:
    """Calls sensors of a model, {name: f(t, q, v) or a Sensor}, and records their values.

    shapes: {name: shape of a value}, known after the first step; rows (steps, 1 + numbers): time and values. before: Sensors of the run so
    far, for `resume`.
    """

    def __init__(self, model, functions, before=None):
        """Take a guarded model, the functions, and the Sensors so far of a run that is resumed."""
        self.model, self.functions = model, functions
        self.shapes = dict(before.shapes) if before else {}
        self._rows = before.rows if before else np.empty((0, 1))  # the first `count` ones are recorded
        self.count = len(self._rows)

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
        """Number of states at the start of a stretch with finite values of compiled sensors, for `record`; 0 if a sensor is Python."""
        if not self.functions:
            return len(stretch)
        columns = []
        for name, shape in self.shapes.items():
            sensor = self.functions[name]
            if isinstance(sensor, Sensor):
                return 0
            if (values := over(f"sensors: {name!r}:", sensor, *seen_by(sensor, self.model, stretch), shape=shape)) is None:
                return 0
            columns.append(values)
        self.ahead = np.column_stack([stretch.t, *columns])
        return leading(np.isfinite(self.ahead).all(axis=1))

    def record(self, first, end):
        """Record the states `first` to `end` of the last stretch of `quiet`."""
        if self.functions:
            self._add(self.ahead[first:end])

    def _add(self, rows):
        """Append rows (steps, 1 + numbers); memory at least doubles when it is full."""
        count = self.count + len(rows)
        if count > len(self._rows):
            more = np.empty((max(FEW, count), rows.shape[1]))
            self._rows = np.concatenate([self._rows[: self.count], more]) if self.count else more
        self._rows[self.count : count] = rows
        self.count = count

    def _value(self, name, state):
        """The values of a sensor at a state, an array. Raises InputError unless they are finite and of its first shape."""
        sensor = self.functions[name]
        if isinstance(sensor, Sensor):
            value = reals(sensor.read(self.model, state))
        else:
            t, *vectors = seen_by(sensor, self.model, state)
            value = reals(sensor(t, *map(read_only, vectors)))
        if value is None:
            wrong = "no real numbers"
        elif value.shape != self.shapes.get(name, value.shape):
            wrong = f"an array of shape {value.shape}"
        elif not np.isfinite(value).all():
            wrong = "numbers that are not finite"
        else:
            return value
        expected = "a finite number or an array of them, of the same shape each time"
        raise InputError(f"sensors: {name!r} gave {wrong} at t = {state.t:.9g} s; it must give {expected}")

    @property
    def rows(self):
        """The rows recorded so far, (steps, 1 + numbers): the time, s, and the values of all sensors."""
        return self._rows[: self.count]
