"""The accepted states of a run: checks of what an integrator yields, and what is recorded of it.

All frames of a run are valid states on the way to its end. Frames are taken at accepted steps or given times, sensors at every step, and the
zero of `until` between two steps.
"""

import math
from copy import deepcopy
from dataclasses import fields
from functools import partial

import numpy as np

from polyida.errors import InputError, StepFailure
from polyida.force.springs import LARGEST, TorsionSpring, rotation
from polyida.integrate.start import on_drives
from polyida.integrate.state import Counts, State, States, Stretch, between, parted, promises, written_by_user
from polyida.integrate.switches import Switches
from polyida.jit.user_functions import over
from polyida.model.guarded import blame
from polyida.sensor import Sensor
from polyida.validation import is_number, is_whole, read_only, reals, takes

SLACK = 1e-9  # of a run's length: a state that is nearer to the end is at the end
STANDSTILL = 20  # a run ends after so many states in a row that hardly advance t
FIELDS = ("q", "v", "a", "lam")
FEW = 64  # rows of sensors at first
END = object()


def accepted(integrator, model, state, t_end, counts, rows=None):
    """An iterator over the integrator's states from `state` to t_end, in stretches; steps end at the switches of the model.

    rows: `FrameStore.rows`, for an integrator that `writes_rows`. Raises StepFailure, as `AcceptedStates` does.
    """
    if not model.switching:
        return AcceptedStates(integrator, model, state, t_end, counts, rows)
    taken = partial(_one_by_one, model=model, counts=counts)
    return map(Stretch.of, Switches(taken, integrator, model, state, t_end, counts).run())


def _one_by_one(integrator, state, t_end, model, counts):
    return States(AcceptedStates(integrator, model, state, t_end, counts), counts)


class AcceptedStates:
    """An iterator over the integrator's own steps, in stretches.

    Raises StepFailure, which names integrator and time, if a state is not a State, has a wrong shape, is not real or not finite, goes back
    in time, repeats it, passes t_end or hardly advances, if the last one is before t_end, and if counts are not whole numbers. The message
    names the user's function that returned what is not finite. A user's integrator starts from a copy. States of one that is not `trusted`
    are copied with their memory: it may fill one array again and again. States of a trusted one are only checked to be finite. A step that turns a
    torsion spring past the half-turn, where its angle would jump, fails too.
    """

    def __init__(self, integrator, model, state, t_end, counts, rows=None):
        """Start the integrator at a state; rows: see `accepted`."""
        self.model, self.t_end = model, t_end
        self.counts = counts
        self.known = vars(counts).copy()  # the last valid counts
        self.before = state  # the last accepted State
        self.name, self.trusted = integrator.class_name(), promises(integrator, "trusted")
        self.standing = 0  # number of the last states that hardly advanced
        self.slack = max(SLACK * (t_end - state.t), 64 * math.ulp(t_end))  # s: a state that near the end is at the end
        self.parts = iter(())  # states of a stretch that is looked at one by one
        self.coils = [own for own in model.own_forces if isinstance(own.element, TorsionSpring)]
        if type(written_by_user(integrator)).__module__.partition(".")[0] != "polyida":
            state = State(state.t, *(getattr(state, name).copy() for name in FIELDS), deepcopy(state.memory), state.restart).of(model)
        places = {"rows": rows} if rows and self.trusted and promises(integrator, "writes_rows") else {}
        states = integrator.steps(model, state, t_end, counts, **places)
        if not hasattr(states, "__iter__"):
            self.stop(f"its steps gave {type(states).__name__}, no states")
        self.states = iter(states.stretches if self.trusted and isinstance(states, States) else states)

    def __iter__(self):
        return self

    def __next__(self):
        """The next checked stretch. Raises StepFailure, and StopIteration at t_end."""
        try:
            stretch = next(self.parts, None)
            if stretch is None:
                stretch = self._next_of_trusted() if self.trusted else self._next_copied()
            elif not stretch.finite():
                self._require_finite(stretch.last)
            if self.coils and stretch is not None and self._turned_over(stretch):
                self.parts = parted(stretch, self.counts) if len(stretch) > 1 else self.parts
                stretch = next(self.parts) if len(stretch) > 1 else stretch
                self._require_turned_less(stretch)
        except StepFailure as failure:
            raise _naming_function(failure, self.model, self.before) from None
        if stretch is None:
            self._require_finite(self.before)
            if self.before.t < self.t_end - self.slack:
                self.stop(f"it ended short of t_end = {self.t_end:.9g} s")
            raise StopIteration
        self.before = stretch.last
        return stretch

    def _next_of_trusted(self):
        """The next stretch, the first part of one that is not finite, or None after the last."""
        one = next(self.states, None)
        stretch = one if one is None or isinstance(one, Stretch) else Stretch.of(one)
        if stretch is None or stretch.finite():
            return stretch
        self.parts = parted(stretch, self.counts)
        stretch = next(self.parts)
        if not stretch.finite():
            self._require_finite(stretch.last)
        return stretch

    def _next_copied(self):
        """A copy of the next state, checked, or None after the last."""
        try:
            yielded = next(self.states, END)
            if wrong := self._wrong_count():
                self.stop(wrong)
            if yielded is END:
                return None
            state = self._copy(yielded)
            self._require_finite(state)
            self._require_advance(state.t)
        except BaseException:
            self._wrong_count()
            raise
        return Stretch.of(state)

    def _copy(self, yielded):
        """A copy of what the integrator yielded, at t_end if it is nearly there. Raises StepFailure unless it is a State of numbers."""
        if not isinstance(yielded, State):
            self.stop(f"its steps yielded {type(yielded).__name__}, a polyida.State is needed")
        if not is_number(yielded.t):
            self.stop(f"its steps yielded a State at t = {yielded.t!r}")
        arrays = [self._floats(name, getattr(yielded, name), getattr(self.before, name).shape, yielded.t) for name in FIELDS]
        memory = yielded.memory or {}
        if not isinstance(memory, dict):
            self.stop(f"memory at t = {yielded.t:.9g} s must be a dictionary, not {type(memory).__name__}")
        for key, value in memory.items():
            if not (isinstance(key, str) and _holds_numbers(value)):
                self.stop(f"memory[{key!r}] at t = {yielded.t:.9g} s must be a number or an array of numbers, as files store it")
        t = self.t_end if abs(yielded.t - self.t_end) <= self.slack else float(yielded.t)
        return State(t, *arrays, deepcopy(memory), bool(yielded.restart))

    def _require_advance(self, t):
        """Raise StepFailure unless t is behind the last state and not behind t_end, or if the last states hardly advance."""
        if not t > self.before.t:
            self.stop(f"t = {t:.9g} s after {self.before.t:.9g} s does not advance")
        if t > self.t_end:
            self.stop(f"t = {t:.9g} s overruns the end, {self.t_end:.9g} s")
        self.standing = self.standing + 1 if t - self.before.t < 16 * math.ulp(self.t_end) else 0
        if self.standing >= STANDSTILL:
            self.stop("the step has shrunk to the round-off of t", "step too small")

    def _turns(self, coil, stretch):
        """Angles of a torsion spring in the accepted state before a stretch and in its states, rad."""
        q = np.concatenate([self.before.q[None], stretch.q])[:, coil.columns]
        return rotation(coil.element, coil.rest[:, :, None] + (coil.near @ q.T).reshape(*coil.rest.shape, len(q)))

    def _turned_over(self, stretch):
        """The first torsion spring that a step of a stretch turns past the half-turn, or None."""
        return next((coil for coil in self.coils if (np.abs(np.diff(self._turns(coil, stretch))) > np.pi).any()), None)

    def _require_turned_less(self, stretch):
        """Raise StepFailure if the step of a stretch of one turns a torsion spring past the half-turn."""
        if coil := self._turned_over(stretch):
            before, after = self._turns(coil, stretch)
            told = f"a step turns {coil.name!r} past the half-turn, from {before:.3g} to {after:.3g} rad, of which it holds {LARGEST:.3g}"
            self.stop(told, "half-turn")

    def stop(self, reason, status="integrator"):
        """Raise StepFailure at the last valid state."""
        raise StepFailure(status, f"{self.name}: {reason}; the last good state is", self.before.t)

    def _wrong_count(self):
        """What is wrong with the counts, or None. Wrong counts get their last valid values; whole numbers of numpy become int."""
        counts, names = vars(self.counts), [field.name for field in fields(Counts)]
        wrong = next((name for name in counts if name not in names), None)
        good = {name: isinstance(counts.get(name), str) if name == "backend" else is_whole(counts.get(name), 0) for name in names}
        wrong = wrong or next((name for name in names if not good[name]), None)
        if wrong is None:
            self.known = {name: value if name == "backend" else int(value) for name, value in self.counts.as_dict().items()}
            counts.update(self.known)
            return None
        value = counts.get(wrong)
        counts.clear()
        counts.update(self.known)
        expected = "must be a text" if wrong == "backend" else "must be a whole number"
        return f"counts.{wrong} = {value!r:.80} {expected if wrong in names else 'is none of ' + ', '.join(names)}"

    def _floats(self, name, value, shape, t):
        """A copy of an array as floats."""
        kind = getattr(getattr(value, "dtype", None), "kind", "O")
        if kind not in "fiu" or value.shape != shape:
            shown = f"{value.shape} of {value.dtype}" if hasattr(value, "dtype") else type(value).__name__
            self.stop(f"{name} at t = {t:.9g} s must be real numbers of shape {shape}, not {shown}")
        return np.array(value, float)

    def _require_finite(self, state):
        """Raise StepFailure, which names the first number of a state that is not finite."""
        for name in FIELDS:
            bad = np.flatnonzero(~np.isfinite(getattr(state, name)))
            if bad.size:
                worst = getattr(state, name)[bad[0]]
                self.stop(f"{name}[{bad[0]}] = {worst} at t = {state.t:.9g} s is not finite", "not finite")


def _holds_numbers(value):
    """True if a value of a memory converts to an array of floats."""
    try:
        np.asarray(value, float)
    except (TypeError, ValueError):
        return False
    return True


def _naming_function(failure, model, state):
    """The failure with the user's function that may have caused it."""
    t = failure.t if math.isfinite(failure.t) else state.t
    bad = blame(model, t, state)
    known = bad.partition(" gave ")[0] in failure.reason
    if known and t == failure.t:
        return failure
    return StepFailure(failure.status, failure.reason if known else f"{bad}; {failure.reason}", t, **failure.seen)


class Sampler:
    """Stores every `every`-th accepted state, the first and the last; or the times `output`.

    rows: `FrameStore.rows` if each state becomes a frame, or None. model: the one whose constraints frames at `output` satisfy if they are
    driven; None in runs with events.
    """

    def __init__(self, store, counts, every=1, output=None, done=0, model=None):
        """Take the FrameStore, the Counts of the run, and `done`: how many times of `output` are stored already."""
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
        """The recorded rows."""
        return self._rows[: self.count]
