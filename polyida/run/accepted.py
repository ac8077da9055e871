"""The accepted states of a run: what an integrator yields, checked.

In: an integrator, a model, a first state and t_end. Out: step batches of valid states on the way to t_end, or a StepFailure.
"""

import math
from copy import deepcopy
from dataclasses import fields
from functools import partial

import numpy as np

from polyida.errors import StepFailure
from polyida.force.springs import LARGEST, TorsionSpring, rotation
from polyida.integrate.state import Counts, State, States, Stretch, parted, promises, written_by_user
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
    """States of an integrator to t_end, checked and one at a time, in place of stretches."""
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
        """Start the integrator at a state. rows: function of the FrameStore that an integrator writes its frames with, or None."""
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
        """Return the iterator itself, as iterators do."""
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
        """Raise StepFailure with this status, the time of the last accepted state, and a message with the method's name and the reason."""
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
        """A copy of an array of a state as floats of that shape. Raises StepFailure if it is none."""
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
