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
        weights = through(self.c, s)
        weights_from_zero = s / self.c * weights  # q - q_0 and v - v_0 are zero at the start
        e, dv, a, lam = self.stages
        q = self.q + ((t - self.t) * self.v + weights_from_zero @ e)
        return State(float(t), q, self.v + weights_from_zero @ dv, weights @ a, weights @ lam, restart=False)


class StretchData(NamedTuple):
    """Data that the States of a stretch share; s: number of stages."""

    record: Record  # results of its steps
    begin: tuple  # (t, q, v) at its start
    misses_before: dict  # {"miss_e", "miss_lam", "mu": (TERMS, s, .)}: prediction errors of the steps before it, newest first
    c: np.ndarray  # (s,) nodes
    factor_states: np.ndarray  # (slots, 1 + 3 n + m): t, q, v, a, lam where the factors were made that it began with
    by_increments: bool  # True if constraints are computed by increments
    memory: dict  # what the memory of all its states has
    position_memory: Any  # function (number of a step, level) -> further memory
    motion: Any  # (model, function that clamps t): a and lam of a state are computed when they are read; None: the record has them
    counts_at: Any  # function (number of a step) -> {name: count}
    states: WeakValueDictionary  # {number of a step: the State of its end} of those in use


class StretchStates(Stretch):
    """The States at the ends of the steps whose numbers are in the range `which`."""

    def __init__(self, stretch, which):
        """Take the StretchData; which: range of the numbers of its steps."""
        self._stretch, self._which = stretch, which

    def __len__(self):
        """Number of steps whose ends are in the stretch."""
        return len(self._which)

    def __getattr__(self, name):
        """An array over the ends. a and lam are computed state by state if the driver did not compute them."""
        stretch, at = self._stretch, self._which
        if name not in ("t", "q", "v", "a", "lam"):
            raise AttributeError(name)
        if name in ("a", "lam") and stretch.motion is not None:
            return np.array([getattr(state, name) for state in self])
        return getattr(stretch.record, name)[at.start : at.stop : at.step]

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
        states, number = self._stretch.states, self._which[k]
        return states.get(number) or states.setdefault(
            number, StepState(self._stretch, number)
        )  # each holds the stretch, which so must not hold it

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
    """The State at the end of a step of a stretch. Its memory and polynomial are assembled on first use."""

    def __init__(self, stretch, number):
        """Take t, q and v, and a and lam if the driver computed them, of a step from the record of the StretchData."""
        record = stretch.record
        vars(self).update(t=float(record.t[number]), q=record.q[number], v=record.v[number], _stretch=stretch, _number=number)
        if stretch.motion is None:
            vars(self).update(a=record.a[number], lam=record.lam[number])

    @cached_property
    def _motion(self):
        """a and lam of `[[M, B^T], [B, 0]] (a, lam) = (-g, -phi_bias)`; if that is singular those of the last stage, of order s only."""
        model, at = self._stretch.motion
        try:
            return consistent_acceleration(model, at(self.t), self.q, self.v)
        except (InputError, np.linalg.LinAlgError):  # constraints that have become dependent, where the run is about to end
            return self._stretch.record.stages_a[self._number, -1], self._stretch.record.stages_lam[self._number, -1]

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
        """The memory from which a run continues, with that of the stretch.

        stages_e, stages_v (s, n), stages_lam (s, m) and a_end (n,): the step's polynomial. miss_e, miss_lam, mu (TERMS, s, .) and misses: the
        prediction errors and their weights. step: h, s. error: local error over the allowed one. newton (2,): contraction, age. factored
        (slots, 2 + 3 n + m): h, t, q, v, a, lam of each factor, the one used last at the end. prices (slots, 3): h, EXTRA, LEAST.
        """
        stretch, number, record = self._stretch, self._number, self._stretch.record
        marks, slots = record.marks[number], record.slots[number]
        order = [slot for slot in np.argsort(slots[USED], kind="stable") if slots[H, slot]]
        factor_states = {slot: stretch.factor_states[slot] for slot in order}
        factor_states |= {int(row[1]): row[2:] for row in record.made if row[0] <= number}
        memory = {
            "stages_e": record.e[number],
            "stages_v": record.dv[number],
            "a_end": record.stages_a[number, -1],
            "stages_lam": record.stages_lam[number],
            "misses": marks[MISSES:],
            "step": float(marks[LAST]),
            "error": float(marks[ERROR]),
            "newton": marks[[CONTRACTION, AGE]],
            "factored": np.array([np.concatenate([[slots[H, slot]], factor_states[slot]]) for slot in order]),
            "prices": slots[[H, EXTRA, LEAST]][:, order].T.copy(),
        }
        for name, before in stretch.misses_before.items():
            steps = getattr(record, name)[number::-1]
            memory[name] = np.concatenate([steps, before])[: len(before)]
        if stretch.by_increments:
            memory |= {"phi": record.phi_start[number, 0], "rate": record.phi_start[number, 1]}
        return memory | stretch.memory | stretch.position_memory(number, record.level[number])

    @cached_property
    def within(self):
        """The collocation polynomial of the step."""
        stretch, number, record = self._stretch, self._number, self._stretch.record
        if number:
            t, q, v = float(record.t[number - 1]), record.q[number - 1], record.v[number - 1]
        else:  # the first step begins at the start of the stretch
            t, q, v = stretch.begin
        stages = record.e[number], record.dv[number], record.stages_a[number], record.stages_lam[number]
        return Collocation(t, float(record.marks[number, LAST]), q, v, stretch.c, stages)

    def finite(self):
        """True: the driver has checked q and v, and the check of State would compute lam."""
        return True

    def __reduce__(self):
        """What pickle needs: a plain State with all that is computed on first use."""
        return State, (self.t, self.q, self.v, self.a, self.lam, self.memory, self.restart, self.within)
