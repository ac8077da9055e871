"""Checks of the states that an integrator yields, so that all frames of a run are valid states on the way to its end."""

import math
from copy import deepcopy
from dataclasses import fields
from functools import partial

import numpy as np

from polyida.errors import StepFailure
from polyida.integrate.state import Counts, State, States, Stretch, parted
from polyida.integrate.switches import Switches
from polyida.model.guarded import blame
from polyida.validation import is_number, is_whole

SLACK = 1e-9  # of a run's length: a state that is nearer to the end is at the end
STANDSTILL = 20  # a run ends after so many states in a row that hardly advance t
FIELDS = ("q", "v", "a", "lam")
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
    names the user's function that returned what is not finite. An integrator that is not `trusted` starts from a copy, and its states are
    copied with their memory: it may fill one array again and again. States of a trusted one are only checked to be finite.
    """

    def __init__(self, integrator, model, state, t_end, counts, rows=None):
        self.model, self.counts, self.known, self.before = model, counts, vars(counts).copy(), state
        self.name, self.trusted, self.t_end, self.standing = integrator.class_name(), integrator.trusted, t_end, 0
        self.slack, self.parts = max(SLACK * (t_end - state.t), 64 * math.ulp(t_end)), iter(())  # parts: of a stretch that is not finite
        if not self.trusted:
            state = State(state.t, *(getattr(state, name).copy() for name in FIELDS), deepcopy(state.memory), state.restart)
        places = {"rows": rows} if rows and self.trusted and integrator.writes_rows else {}
        states = integrator.steps(model, state, t_end, counts, **places)
        if not hasattr(states, "__iter__"):
            self.stop(f"its steps gave {type(states).__name__}, no states")
        self.states = iter(states.stretches if self.trusted and isinstance(states, States) else states)

    def __iter__(self):
        return self

    def __next__(self):
        try:
            stretch = next(self.parts, None)
            if stretch is None:
                stretch = self._next_of_trusted() if self.trusted else self._next_copied()
            elif not stretch.finite():
                self._require_finite(stretch.last)
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
            if not isinstance(yielded, State):
                self.stop(f"its steps yielded {type(yielded).__name__}, a polyida.State is needed")
            if not is_number(yielded.t):
                self.stop(f"its steps yielded a State at t = {yielded.t!r}")
            arrays = [self._floats(name, getattr(yielded, name), getattr(self.before, name).shape, yielded.t) for name in FIELDS]
            t = self.t_end if abs(yielded.t - self.t_end) <= self.slack else float(yielded.t)
            if not isinstance(yielded.memory or {}, dict):
                self.stop(f"memory at t = {yielded.t:.9g} s must be a dictionary, not {type(yielded.memory).__name__}")
            try:
                memory = deepcopy(yielded.memory or {})
            except Exception as error:  # noqa: BLE001 what a copy of anything may raise
                self.stop(f"memory at t = {yielded.t:.9g} s cannot be copied ({error}); keep numbers, texts and arrays in it")
            state = State(t, *arrays, memory, bool(yielded.restart))
            self._require_finite(state)
            if not t > self.before.t:
                self.stop(f"t = {t:.9g} s after {self.before.t:.9g} s does not advance")
            if t > self.t_end:
                self.stop(f"t = {t:.9g} s overruns the end, {self.t_end:.9g} s")
            self.standing = self.standing + 1 if t - self.before.t < 16 * math.ulp(self.t_end) else 0
            if self.standing >= STANDSTILL:
                self.stop("the step has shrunk to the round-off of t", "step too small")
        except BaseException:
            self._wrong_count()
            raise
        return Stretch.of(state)

    def stop(self, reason, status="integrator"):
        """Raise StepFailure at the last valid state."""
        raise StepFailure(status, f"{self.name}: {reason}; the last good state is", self.before.t)

    def _wrong_count(self):
        """What is wrong with the counts, or None. Wrong counts get their last valid values; whole numbers of numpy become int."""
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
        wanted = "must be a text" if wrong == "backend" else "must be a whole number"
        return f"counts.{wrong} = {value!r:.80} {wanted if wrong in names else 'is none of ' + ', '.join(names)}"

    def _floats(self, name, value, shape, t):
        """A copy of an array as floats."""
        kind = getattr(getattr(value, "dtype", None), "kind", "O")
        if kind not in "fiu" or value.shape != shape:
            found = f"{value.shape} of {value.dtype}" if hasattr(value, "dtype") else type(value).__name__
            self.stop(f"{name} at t = {t:.9g} s must be real numbers of shape {shape}, not {found}")
        return np.array(value, float)

    def _require_finite(self, state):
        for name in FIELDS:
            bad = np.flatnonzero(~np.isfinite(getattr(state, name)))
            if bad.size:
                worst = getattr(state, name)[bad[0]]
                self.stop(f"{name}[{bad[0]}] = {worst} at t = {state.t:.9g} s is not finite", "not finite")


def _naming_function(failure, model, state):
    """The failure with the user's function that may have caused it."""
    t = failure.t if math.isfinite(failure.t) else state.t
    bad = blame(model, t, state)
    known = bad.partition(" gave ")[0] in failure.reason
    if known and t == failure.t:
        return failure
    return StepFailure(failure.status, failure.reason if known else f"{bad}; {failure.reason}", t, **failure.seen)
