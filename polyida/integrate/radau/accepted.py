"""The states at the ends of the steps of a stretch, and the collocation polynomial between them."""

from functools import cached_property
from typing import Any, NamedTuple
from weakref import WeakValueDictionary

import numpy as np

from polyida.errors import InputError
from polyida.integrate.radau.loop import EXTRA, LEAST, USED, H, Record
from polyida.integrate.radau.step_arrays import AGE, CONTRACTION, ERROR, LAST, MISSES
from polyida.integrate.radau.tableau import through
from polyida.integrate.start import consistent_acceleration
from polyida.integrate.state import State, Stretch


class Collocation(NamedTuple):
    """Function of t that returns the State there: q and v by polynomials of degree s (3rd or 4th order), a and lam of degree s - 1.

    stages: e, v - v_0, v' and lam at the nodes c, each (s, ...).
    """

    t: float
    h: float
    q: np.ndarray
    v: np.ndarray
    c: np.ndarray
    stages: tuple

    def __call__(self, t):
        """The State at a time t of the step."""
        s = (t - self.t) / self.h
        rest = through(self.c, s)
        moved = s / self.c * rest  # q - q_0 and v - v_0 are zero at the start
        e, dv, a, lam = self.stages
        q = self.q + ((t - self.t) * self.v + moved @ e)
        return State(float(t), q, self.v + moved @ dv, rest @ a, rest @ lam, restart=False)


class StretchData(NamedTuple):
    """Data that the States of a stretch share.

    record: results of its steps. begin: (t, q, v) at its start. misses_before: {name: prediction errors of the steps before, newest first}. c:
    nodes. factor_states: where the factors were made that it began with. memory: what the memory of all its states has. position_memory: function
    (number of a step, level) -> further memory. motion: (model, function that clamps t) to compute a and lam of a state when they are asked for;
    None if the record has them. counts_at: function (number of a step) -> {name: count}. states: the State objects in use, by number.
    """

    record: Record
    begin: tuple
    misses_before: dict
    c: np.ndarray
    factor_states: np.ndarray
    by_increments: bool
    memory: dict
    position_memory: Any
    motion: Any
    counts_at: Any
    states: WeakValueDictionary


class StretchStates(Stretch):
    """The States at the ends of the steps whose numbers are in the range `which`."""

    def __init__(self, s, which):
        """Take the stretch s; which: range of the numbers of its steps."""
        self._stretch, self._which = s, which

    def __len__(self):
        """Number of steps whose ends are in the stretch."""
        return len(self._which)

    def __getattr__(self, name):
        """An array over the ends. a and lam are computed state by state if the driver did not compute them."""
        s, at = self._stretch, self._which
        if name not in ("t", "q", "v", "a", "lam"):
            raise AttributeError(name)
        if name in ("a", "lam") and s.motion is not None:
            return np.array([getattr(state, name) for state in self])
        return getattr(s.record, name)[at.start : at.stop : at.step]

    @property
    def spent(self):
        """The counts at the last state."""
        return self._stretch.counts_at(self._which[-1])

    @property
    def last(self):
        """The State at the last of these ends."""
        return self.state(len(self) - 1)

    def state(self, k):
        """The State number k, counted from 0."""
        states, k = self._stretch.states, self._which[k]
        return states.get(k) or states.setdefault(k, StepState(self._stretch, k))  # each holds the stretch, which so must not hold it

    def part(self, first, end, every=1):
        """The StretchStates with the ends number `first` to before `end`, or each `every`-th of them; without copies."""
        return StretchStates(self._stretch, self._which[first:end:every])

    def computed(self):
        """The States, which keep their accelerations and forces."""
        return list(self)

    def finite(self):
        """True: the driver has checked q and v."""
        return True


class StepState(State):
    """The State at the end of step k. Its memory and polynomial are assembled on first use."""

    def __init__(self, s, k):
        """Take t, q and v, and a and lam if the driver computed them, from the record of the stretch s."""
        r = s.record
        vars(self).update(t=float(r.t[k]), q=r.q[k], v=r.v[k], _stretch=s, _k=k)
        if s.motion is None:
            vars(self).update(a=r.a[k], lam=r.lam[k])

    @cached_property
    def _motion(self):
        """a and lam of `[[M, B^T], [B, 0]] (a, lam) = (-g, -phi_bias)`; if that is singular those of the last stage, of order s only."""
        model, at = self._stretch.motion
        try:
            return consistent_acceleration(model, at(self.t), self.q, self.v)
        except (InputError, np.linalg.LinAlgError):  # constraints that have become dependent, where the run is about to end
            return self._stretch.record.stages_a[self._k, -1], self._stretch.record.stages_lam[self._k, -1]

    @cached_property
    def a(self):
        """q'' that is consistent with q and v, (n,)."""
        return self._motion[0]

    @cached_property
    def lam(self):
        """Multipliers that are consistent with q and v, (m,)."""
        return self._motion[1]

    @cached_property
    def memory(self):
        """The memory from which a run continues."""
        s, k = self._stretch, self._k
        r, marks, slots = s.record, s.record.marks[k], s.record.slots[k]
        order = [slot for slot in np.argsort(slots[USED], kind="stable") if slots[H, slot]]
        factor_states = {slot: s.factor_states[slot] for slot in order} | {int(row[1]): row[2:] for row in r.made if row[0] <= k}
        memory = {
            "stages_e": r.e[k],
            "stages_v": r.dv[k],
            "a_end": r.stages_a[k, -1],
            "stages_lam": r.stages_lam[k],
            "misses": marks[MISSES:],
            "step": float(marks[LAST]),
            "error": float(marks[ERROR]),
            "newton": marks[[CONTRACTION, AGE]],
            "factored": np.array([np.concatenate([[slots[H, slot]], factor_states[slot]]) for slot in order]),
            "prices": slots[[H, EXTRA, LEAST]][:, order].T.copy(),
        }
        for name, before in s.misses_before.items():
            steps = getattr(r, name)[k::-1]
            memory[name] = np.concatenate([steps, before])[: len(before)]
        if s.by_increments:
            memory |= {"phi": r.phi_start[k, 0], "rate": r.phi_start[k, 1]}
        return memory | s.memory | s.position_memory(k, r.level[k])

    @cached_property
    def within(self):
        """The collocation polynomial of the step."""
        s, k = self._stretch, self._k
        r = s.record
        t, q, v = (float(r.t[k - 1]), r.q[k - 1], r.v[k - 1]) if k else s.begin
        return Collocation(t, float(r.marks[k, LAST]), q, v, s.c, (r.e[k], r.dv[k], r.stages_a[k], r.stages_lam[k]))

    def computed(self):
        """The States, which keep their accelerations and forces."""
        return list(self)

    def finite(self):
        """True: the driver has checked q and v."""
        return True

    def __reduce__(self):
        """What pickle needs: a plain State with all that is computed on first use."""
        return State, (self.t, self.q, self.v, self.a, self.lam, self.memory, self.restart, self.within)
