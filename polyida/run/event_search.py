"""The search for events in a run: a sequence of motions of models with equal coordinates and different rows of phi.

An event's function g is evaluated at nodes of each step on the integrator's own motion, and at the extrema of the polynomial through these
values (sign_changes.py), so that two roots within a step are seen. g has changed its sign if it is beyond OFFSET of its largest value so far on
the other side. The state between two steps is projected onto the rows that act. Then a subclass changes it: EventHandler (events.py) for the
events of users, ContactHandler (contact_events.py) for the changes of contact and friction. After that the integrator starts anew.
"""

import math
from dataclasses import replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from polyida.errors import InputError, StepFailure
from polyida.integrate.singular import Watch
from polyida.integrate.start import consistent_acceleration, restarted
from polyida.integrate.state import State, Stretch, between, parted
from polyida.linear.lu import SingularSystem
from polyida.model.differences import along, reach_along
from polyida.run.accepted import accepted
from polyida.run.recording import leading
from polyida.run.sign_changes import NODES, first_sign_change

OFFSET = 1e-10  # of the largest |g| so far: beyond it g is on a side
ZERO = 1e-14  # |g| at the start of a run that is round-off
AHEAD = 1e-2  # of the time in which a state changes by its size: differences for rates of events
TOGETHER = 1e-9  # of a step: events that are not farther apart happen at one time
SETTLING = 4  # corrections of the time of an event
LEAST = 1e-12  # of a run's length: what is left after an event if it is at the end


class Change(NamedTuple):
    """The states before (None if it was the last step's) and after events at one time, what happened, and why the run ends there, or ""."""

    before: State | None
    after: State
    happened: list
    stops: str


class Observer:
    """What an event search tells of its events. The methods here do nothing; the adjoint of a run with events has its own."""

    def before_change(self, state, fired):
        """Called before the events with the numbers `fired` change a State of the mode."""

    def applied(self, event, state, reset):
        """Called when an event of the user changes a State, by a Reset; also for events that another one causes."""

    def hit(self, rates, impulses, status):
        """Called at an impact of contacts; rates before it, impulses and statuses of the rows with laws, each (rows with laws,)."""

    def after_change(self, state, fired, after, happened):
        """Called after the change of a State of the mode; after: the State then, with all columns of lam; happened: list of Happened."""


class WholeStepBatch(Stretch):
    """A step batch of a mode with the columns of lam of all rows, which are computed when they are read.

    search: the EventSearch. part: the Stretch of the mode.
    """

    def __init__(self, search, part):
        """Take the EventSearch and the step batch of the present mode; t, q and v are its own."""
        self.search, self.source = search, part
        self.t, self.q, self.v = part.t, part.q, part.v

    a = property(lambda self: self.source.a)
    spent = property(lambda self: self.source.spent)

    @cached_property
    def lam(self):
        """The multipliers of all rows in every state, (states, width)."""
        return self.last.lam[None] if len(self) == 1 else self.search.mode.spread(self.source.lam, self.search.width)

    @cached_property
    def last(self):
        """The last State of the batch, with the columns of lam of all rows."""
        return self.search.whole_state(self.source.last)

    def state(self, k):
        """The State number k of the batch, counted from 0, with the columns of lam of all rows."""
        return self.last if k == len(self) - 1 else self.search.whole_state(self.source.state(k))

    def part(self, first, end, every=1):
        """The Stretch of the states from number `first` to before `end`, or of each `every`-th of them."""
        if first == 0 and end >= len(self) and every == 1:
            return self
        return WholeStepBatch(self.search, self.source.part(first, end, every))


class EventSearch:
    """Finds the events of a run in each step of a motion, lets a subclass change the state, and starts the next motion.

    States of the run have the columns of lam of all rows; integrators get those of the mode. A subclass defines `start`, `value` and `_change`.
    """

    def __init__(self, whole, events, method, happened, width):
        """Take the guarded model of all parts, the events, the integrator, the Events so far, and the number of columns of lam."""
        self.whole = whole  # the model with the rows of all parts
        self.mode = whole  # the model of the parts or rows that act; a subclass sets it
        self.events = events  # each has a name and a direction
        self.method = method  # the integrator
        self.happened = happened  # Events so far
        self.width = width
        self.values = np.zeros(len(events))  # of the events' functions at the last state
        self.sides = np.zeros(len(events))  # sign of each function after the last step; 0: on neither side yet
        self.sizes = np.zeros(len(events))  # largest absolute value of each so far
        self.started = True  # True in the first step of a run that begins
        self.of_forces = set()  # names of the events whose functions read accelerations or multipliers
        self.observer = Observer()  # is told of each change

    def start(self, state):
        """The first State of a run with the columns of lam of all rows; its integrator starts anew."""
        raise NotImplementedError

    def value(self, event, state):
        """The value of an event's function at a State of the mode, a float."""
        raise NotImplementedError

    def _change(self, state, fired):
        """(State after, list of Happened, why the run stops or "") of the events with the numbers `fired`. Raises StepFailure."""
        raise NotImplementedError

    def _memory(self):
        """What a run goes on with from a state: {"events": sides and sizes of the functions, (2, events)}."""
        return {"events": np.array([self.sides, self.sizes])}

    def whole_state(self, state):
        """A State of the mode with the columns of lam of all rows, and what a run goes on with in its memory if it can go on from it."""
        within = state.within

        def inner(t):
            """The State at time t within the step before the state, with all columns of lam; None if there is none."""
            of_mode = within(t)
            return of_mode and self.spread(of_mode)

        memory = state.memory | self._memory() if state.restart else {}
        return replace(self.spread(state), memory=memory, restart=state.restart, within=within and inner)

    def spread(self, state):
        """The vectors of a state of the mode, with the columns of lam of all rows; no run can go on from it."""
        return State(state.t, state.q, state.v, state.a, self.mode.spread(state.lam, self.width), restart=False)

    def stretches(self, state, t_end, counts):
        """Yield Stretches of the run's states, and Changes. The first state has all columns. Raises StepFailure."""
        memory, span = dict(state.memory), t_end - state.t
        known = memory.pop("events", None)
        memory["polynomials"] = 1.0  # each step is looked into before the next
        state = State(state.t, state.q, state.v, state.a, state.lam[self.mode.columns], memory, state.restart)
        self.values = np.array([self.value(event, state) for event in self.events])
        self.started = known is None
        if known is None:
            self.sides = np.where(np.abs(self.values) > ZERO, np.sign(self.values), 0.0)
            self.sizes = np.zeros(len(self.events))
        else:
            self.sides, self.sizes = np.array(known)
        while True:
            part = None
            for part in self._motion(state, t_end, counts):
                if not isinstance(part, Change) or part.happened:
                    yield part
            if not isinstance(part, Change) or part.stops or t_end - part.after.t <= max(LEAST * span, 64 * math.ulp(t_end)):
                return
            after = part.after
            state = State(after.t, after.q, after.v, after.a, after.lam[self.mode.columns], {"polynomials": 1.0})

    def _motion(self, before, t_end, counts):
        """Yield the Stretches of one mode, and the Change at its end if there is one."""
        needs = self.mode.needs
        watch = Watch(self.mode, before) if self.mode.m and not self.mode.row_laws and (needs.phi_q_varies or needs.driven) else None
        for stretch in accepted(self.method, self.mode, before, t_end, counts):
            sound, failure = watch.look(stretch) if watch else (len(stretch), None)
            counts.steps -= len(stretch) - sound
            stretch = stretch.part(0, sound)
            quiet, done = self._quiet(before, stretch), 0
            for part in parted(stretch, counts, lambda: max(1, leading(quiet[done:]))):  # noqa: B023, called within the loop
                after, first, done = part.last, done, done + len(part)
                if quiet[first]:
                    self._pass(part, done)
                    before = after
                    yield WholeStepBatch(self, part)
                    continue
                hit = self._first(before, after)
                if hit is None:
                    before = after
                    yield Stretch.of(self.whole_state(after))
                    continue
                yield from self._at_events(before, after, *hit, counts)
                return
            if failure:
                counts.steps += 1
                raise failure

    def _quiet(self, before, stretch):
        """True for the steps of a stretch in which certainly nothing happens, (steps,); `_first` does not look into them."""
        return np.zeros(len(stretch), bool)

    def _pass(self, part, done):
        """Go on after quiet steps, the first `done` ones of a stretch; `part`: the last of them. A subclass with a `_quiet` defines it."""

    def _at_events(self, before, after, t, fired, counts):
        """Yield the state at time t of a step, unless that is its begin, and the Change by the events with the numbers `fired`."""
        at = self._between(before, after, t)
        start = self._consistent(self.mode, at, "the state")
        if at is before:
            counts.steps -= 1
            yield Change(None, *self._observed_change(start, fired))
            return
        start = self._on_root(before, after, start, fired[0])
        first = self.spread(start)
        yield Stretch.of(first)
        yield Change(first, *self._observed_change(start, fired))

    def _observed_change(self, state, fired):
        """(State after, list of Happened, why the run stops or "") as of `_change`; the observer is told before and after."""
        self.observer.before_change(state, fired)
        after, happened, stops = self._change(state, fired)
        self.observer.after_change(state, fired, after, happened)
        return after, happened, stops

    def _between(self, before, after, t):
        """The State at t of a step, with the outputs that controllers hold in it: they jump at its start if that is a sample."""
        state = between(before, after, t)
        held = [own.placed.columns[own.placed.own :] for own in self.whole.controllers] if self.whole.is_scene else []
        if not held or state is before or state is after:
            return state
        v, columns = state.v.copy(), np.concatenate(held)
        v[columns] = after.v[columns]
        return State(state.t, state.q, v, state.a, state.lam, restart=False)

    def _on_root(self, before, after, start, k):
        """A consistent state of a step at which the function of event k is zero; `start` is one near it.

        The state of the polynomial satisfies the constraints only to the order of the step, and so do its accelerations and multipliers. Its
        projection is beside the root; if the function has its old sign there, the event would happen again.
        """
        if self.events[k].name in self.of_forces and self.mode.row_laws:  # whose forces have no slope
            return start
        for _ in range(SETTLING):
            g, rate = self.value(self.events[k], start), self._rates(start)[k]
            t = start.t - g / rate if rate else before.t
            if abs(g) <= 0.1 * OFFSET * self.sizes[k] or not before.t < t < after.t:
                break
            nearer = self._consistent(self.mode, self._between(before, after, t), "the state")
            if abs(self.value(self.events[k], nearer)) >= abs(g):
                break
            start = nearer
        return start

    def _first(self, before, after):
        """(time, numbers of the events) of the first change of sign in a step, or None."""
        inner = [between(before, after, before.t + s * (after.t - before.t)) for s in NODES[1:-1]] + [after]
        values = np.array([[self.value(event, state) for event in self.events] for state in inner])
        values = np.vstack([self.values, values])
        sizes, sides, times = np.maximum(self.sizes, np.abs(values).max(axis=0)), self.sides.copy(), {}
        if self.started:
            sides[np.abs(self.values) <= OFFSET * sizes] = 0.0
        for k, event in enumerate(self.events):
            t, sides[k] = self._crossing(event, sides[k], values[:, k], OFFSET * sizes[k], before, after)
            if t is not None:
                times[k] = t
        self.started, self.sizes = False, sizes
        if not times:
            self.values, self.sides = values[-1], sides
            return None
        first = min(times.values())
        near = TOGETHER * (after.t - before.t)
        return first, [k for k, t in times.items() if t <= first + near]

    def _crossing(self, event, side, values, offset, before, after):
        """(time of the first change of sign that counts in a step, or None; the side at its end).

        side: the sign of the function before the step. values: at NODES of the step. offset: beyond it the function is on a side.
        """

        def at(s):
            """Value of the event's function at the share s of the step, 0 to 1, between the two states."""
            return self.value(event, between(before, after, before.t + s * (after.t - before.t)))

        s, side = first_sign_change(at, values, side, offset, event.direction)
        return None if s is None else min(before.t + s * (after.t - before.t), after.t), side

    def _rates(self, state):
        """d/dt of the events' functions along a state's velocities and accelerations, by central differences, (events,)."""

        def moved(s):
            """The functions' values at s seconds after the state, by its velocities and accelerations."""
            t, q, v = state.t + s, state.q + s * state.v + 0.5 * s * s * state.a, state.v + s * state.a
            one = replace(state, t=t, q=q, v=v)
            if self.of_forces and not self.mode.row_laws:
                one = State(t, q, v, *consistent_acceleration(self.mode, t, q, v))
            return np.array([self.value(event, one) for event in self.events])

        return along(moved, AHEAD * min(reach_along(state.q, state.v), reach_along(state.v, state.a)))

    def _consistent(self, mode, state, what):
        """The consistent State of a mode nearest to a state. Raises StepFailure."""
        try:
            return restarted(mode, state)
        except (InputError, SingularSystem, np.linalg.LinAlgError) as error:
            raise StepFailure("events", f"{what} cannot go on: {error}", state.t) from None
