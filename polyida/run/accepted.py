"""The states that an integrator yields, looked at: whatever it does, a run's frames are states on the way to its end."""

import math
from copy import deepcopy
from dataclasses import fields
from functools import partial

import numpy as np

from polyida.errors import StepFailure
from polyida.integrate.state import Counts, State, States, Stretch, asked, parted
from polyida.integrate.switches import Switches
from polyida.model.guarded import blame
from polyida.validation import is_number, is_whole

SLACK = 1e-9  # of a run's length: as near to its end as that is at its end
STANDSTILL = 20  # so many states in a row that hardly move t end the run
FIELDS = ("q", "v", "a", "lam")


def accepted(integrator, model, state, t_end, counts, rows=None):
    """Yield the integrator's states from `state` to t_end, in stretches.

    Raises StepFailure, which names integrator and time, at one that is no State, has the wrong shape, is not real or not
    finite, goes back in time, repeats it, overruns t_end or hardly moves, where the last is short of t_end, and at counts that are no
    whole numbers. A user's own integrator begins with a copy, and its states are copied with their memory, for it may fill one array
    again and again; polyida's own are only looked at, in less than a microsecond. A failure says which of a user's functions gave what is not finite. rows: of a
    FrameStore, for an integrator that `writes_rows`.
    """
    if model.switching:
        return map(Stretch.of, Switches(partial(_one_by_one, model=model, counts=counts), integrator, model, state, t_end, counts).run())
    return _accepted(integrator, state, t_end, model, counts, rows)


def _one_by_one(integrator, state, t_end, model, counts):
    return States(_accepted(integrator, state, t_end, model, counts, None), counts)


def _accepted(integrator, state, t_end, model, counts, rows):
    """The same of the integrator's own steps, whatever switches."""
    own = type(integrator).__module__.startswith("polyida.")
    places = {"rows": rows} if rows and own and asked(integrator, "writes_rows") else {}
    watch = _Watch(integrator, state, t_end, counts)
    begin = state if own else State(state.t, *(getattr(state, name).copy() for name in FIELDS), deepcopy(state.memory), state.restart)
    made = integrator.steps(model, begin, t_end, counts, **places)
    if not hasattr(made, "__iter__"):
        watch.stop(f"its steps gave {type(made).__name__}, no states")
    try:
        if own:
            for one in made.stretches if isinstance(made, States) else made:
                stretch = one if isinstance(one, Stretch) else Stretch.of(one)
                sound = stretch.finite()
                for part in (stretch,) if sound else parted(stretch, counts):
                    if not (sound or part.finite()):
                        watch.require_finite(part.last)
                    watch.before = part.last
                    yield part
        else:
            yield from _foreign(watch, made)
    except StepFailure as failure:
        raise _naming_function(failure, model, watch.before) from None
    watch.at_end()


def _foreign(watch, states):
    """States of a user's integrator, whole and their own."""
    try:
        for given in states:
            watch.require_counts()
            state = watch.taken(given)
            watch.require_finite(state)
            watch.require_ahead(state.t)
            watch.require_moving(state.t)
            watch.before = state
            yield Stretch.of(state)
    except BaseException:
        watch.wrong_count()
        raise
    watch.require_counts()


class _Watch:
    """The last good state of a run, and what stops it there."""

    def __init__(self, integrator, state, t_end, counts):
        self.counts, self.known = counts, vars(counts).copy()
        self.name, self.before, self.t_end, self.standing = type(integrator).__name__, state, t_end, 0
        self.slack = max(SLACK * (t_end - state.t), 64 * math.ulp(t_end))

    def stop(self, reason, status="integrator"):
        """Raise StepFailure after the last good state."""
        raise StepFailure(status, f"{self.name}: {reason}; the last good state is", self.before.t)

    def taken(self, given):
        """The state as a copy of floats, its time the run's end where it is that to round-off."""
        if not isinstance(given, State):
            self.stop(f"its steps yielded {type(given).__name__}, a polyida.State is needed")
        if not is_number(given.t):
            self.stop(f"its steps yielded a State at t = {given.t!r}")
        arrays = [self._floats(name, getattr(given, name), getattr(self.before, name).shape, given.t) for name in FIELDS]
        t = self.t_end if abs(given.t - self.t_end) <= self.slack else float(given.t)
        return State(t, *arrays, self._memory(given), bool(given.restart))

    def _memory(self, given):
        """A copy of the memory, which may hold arrays that are filled again."""
        if not isinstance(given.memory or {}, dict):
            self.stop(f"memory at t = {given.t:.9g} s must be a dictionary, not {type(given.memory).__name__}")
        try:
            return deepcopy(given.memory or {})
        except Exception as error:  # noqa: BLE001 what a copy of anything may raise
            self.stop(f"memory at t = {given.t:.9g} s cannot be copied ({error}); keep numbers, texts and arrays in it")

    def require_counts(self):
        """Stop at counts that are no whole numbers, or that there are not."""
        if wrong := self.wrong_count():
            self.stop(wrong)

    def wrong_count(self):
        """What is wrong with the counts, whose last right values it puts back, or None; whole numbers of numpy become int."""
        found, names = vars(self.counts), [field.name for field in fields(Counts)]
        wrong = next((name for name in found if name not in names), None)
        good = {name: isinstance(found.get(name), str) if name == "backend" else is_whole(found.get(name), 0) for name in names}
        wrong = wrong or next((name for name in names if not good[name]), None)
        if wrong is None:
            self.known = {name: value if name == "backend" else int(value) for name, value in self.counts.as_dict().items()}
            found.update(self.known)
            return None
        value = found.get(wrong)
        found.clear()
        found.update(self.known)
        wanted = (
            "must be a text" if wrong == "backend" else "must be a whole number" if wrong in names else f"is none of {', '.join(names)}"
        )
        return f"counts.{wrong} = {value!r:.80} {wanted}"

    def _floats(self, name, value, shape, t):
        kind = getattr(getattr(value, "dtype", None), "kind", "O")
        if kind not in "fiu" or value.shape != shape:
            found = f"{value.shape} of {value.dtype}" if hasattr(value, "dtype") else type(value).__name__
            self.stop(f"{name} at t = {t:.9g} s must be real numbers of shape {shape}, not {found}")
        return np.array(value, float)

    def require_finite(self, state):
        """Stop at numbers that are not finite."""
        for name in FIELDS:
            bad = np.flatnonzero(~np.isfinite(getattr(state, name)))
            if bad.size:
                worst = getattr(state, name)[bad[0]]
                self.stop(f"{name}[{bad[0]}] = {worst} at t = {state.t:.9g} s is not finite", "not finite")

    def require_ahead(self, t):
        """Stop at a time that is not behind the last one, or behind the run's end."""
        if not t > self.before.t:
            self.stop(f"t = {t:.9g} s after {self.before.t:.9g} s does not advance")
        if t > self.t_end:
            self.stop(f"t = {t:.9g} s overruns the end, {self.t_end:.9g} s")

    def require_moving(self, t):
        """Stop where t hardly moves, step after step."""
        self.standing = self.standing + 1 if t - self.before.t < 16 * math.ulp(self.t_end) else 0
        if self.standing >= STANDSTILL:
            self.stop("the step has shrunk to the round-off of t", "step too small")

    def at_end(self):
        """Stop where the integrator ended too early."""
        self.require_finite(self.before)
        if self.before.t < self.t_end - self.slack:
            self.stop(f"it ended short of t_end = {self.t_end:.9g} s")


def _naming_function(failure, model, state):
    """The failure, with the user's function that may have caused it."""
    t = failure.t if math.isfinite(failure.t) else state.t
    bad = blame(model, t, state)
    known = bad.partition(" gave ")[0] in failure.reason
    if known and t == failure.t:
        return failure
    return StepFailure(failure.status, failure.reason if known else f"{bad}; {failure.reason}", t, **failure.seen)
