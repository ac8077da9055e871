"""Runs with events: a sequence of motions of models with equal coordinates and different rows of phi.

An event's function g is evaluated at nodes of each step on the integrator's own motion, and at the extrema of the polynomial through these
values, so that two roots within a step are seen. g has changed its sign if it is beyond OFFSET of its largest value so far on the other side.
Behind an event its side is that to which g moves, if it moves. The state between two steps is projected onto the rows that act; then parts
change and velocities jump, and the integrator starts anew from a consistent state.
"""

import math
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from polyida.errors import InputError, StepFailure
from polyida.event import ADDABLE, Events, Happened, Impact, Impulse, Moment, Remove
from polyida.integrate.singular import Watch
from polyida.integrate.start import consistent_acceleration, restarted
from polyida.integrate.state import State, Stretch, between, parted
from polyida.linear.lu import SingularSystem
from polyida.model import Model
from polyida.model.differences import along, reach_along
from polyida.model.guarded import guard
from polyida.results.motion import reaction_of
from polyida.run.accepted import accepted
from polyida.run.recording import leading
from polyida.run.reset import Push, Reset, pull_of, rate_of, require_free
from polyida.validation import floats, is_number

NODES = 0.5 - 0.5 * np.cos(np.pi * np.arange(5) / 4)  # of a step, where functions of events are evaluated
COEFFICIENTS = np.linalg.inv(np.vander(NODES, increasing=True))
OFFSET, ZERO = 1e-10, 1e-14  # of the largest |g| so far: g is on a side; |g| at the start of a run that is round-off
STILL = 1e-9  # of the rate before an event: a smaller one is round-off
AHEAD = 1e-2  # of the time in which a state changes by its size: differences for rates of events
TOGETHER = 1e-9  # of a step: events that are not farther apart happen at one time
SETTLING = 4  # corrections of the time of an event
LEAST = 1e-12  # of a run's length: what is left behind an event if it is at the end


class Change(NamedTuple):
    """The states before (None if it was the last step's) and behind events at one time, what happened, and why the run ends there, or ""."""

    before: State | None
    after: State
    happened: list
    stops: str


class WholeStepBatch(Stretch):
    """A step batch of a mode with the columns of lam of all rows, which are computed when they are read.

    handler: the EventHandler. part: the Stretch of the mode.
    """

    def __init__(self, handler, part):
        """Take the EventHandler and the step batch of the present mode; t, q and v are its own."""
        self.handler, self.source = handler, part
        self.t, self.q, self.v = part.t, part.q, part.v

    a = property(lambda self: self.source.a)
    spent = property(lambda self: self.source.spent)

    @cached_property
    def lam(self):
        """The multipliers of all rows in every state, (states, width)."""
        return self.last.lam[None] if len(self) == 1 else self.handler.mode.spread(self.source.lam, self.handler.width)

    @cached_property
    def last(self):
        """The last State of the batch; lam has one entry for every row of the whole model, also for parts that do not act."""
        return self.handler.whole_state(self.source.last)

    def state(self, k):
        """The State number k of the batch, counted from 0, with the columns of lam of all rows."""
        return self.last if k == len(self) - 1 else self.handler.whole_state(self.source.state(k))

    def part(self, first, end, every=1):
        """The Stretch of the states from number `first` to before `end`, or of each `every`-th of them."""
        if first == 0 and end >= len(self) and every == 1:
            return self
        return WholeStepBatch(self.handler, self.source.part(first, end, every))


@dataclass
class Asked:
    """What `then` of an event asks for at a state."""

    q: np.ndarray  # (n,) as the user's functions set them
    v: np.ndarray
    model: int  # number of the user's model behind the event
    absent: set  # names of the parts that do not act behind it
    added: list = field(default_factory=list)  # parts that act from now on
    pushes: list = field(default_factory=list)  # Push of each impulse and impact, in their order
    functions: list = field(default_factory=list)  # of the user
    stops: str = ""  # why the run ends here, or ""


class EventHandler:
    """The events of a run: finds them in each step of a motion, changes the model and the velocities, and starts the next motion.

    States of the run have the columns of lam of all rows; integrators get those of the mode.
    """

    of_forces: Any = frozenset()  # names of the events whose functions read accelerations or multipliers

    def __init__(self, model, events, method, happened=None):
        """Take the model of all parts, the events with names, the integrator, and the Events so far of a run that is resumed."""
        self.whole = guard(model)  # the model with the rows of all parts
        self.events, self.method = events, method
        models = [] if self.whole.is_scene else [model, *(one for event in events for one in event.then if isinstance(one, Model))]
        late = (self.whole.late or ()) if self.whole.is_scene else ()
        self.happened = Events((), late, given=True) if happened is None else happened
        self.happened.causes = events
        self.width = max([self.whole.m, *(guard(one).m for one in models)])  # number of columns of lam
        self.happened.models = [self._own(one) for one in models]
        if max((one.model for one in self.happened), default=0) >= max(1, len(models)):
            raise InputError("events: a function of an event made the model that acts, which no file holds; name it in `then`")
        self.mode = guard(self.happened.modes(self.whole)[-1])  # the model of the parts that act
        self.sides = np.zeros(len(events))  # sign of each function behind the last step; 0: on neither side yet
        self.sizes = np.zeros(len(events))  # its largest absolute value so far
        self.of_forces = set()

    def _own(self, model):
        """Return a user's model, guarded, with its columns of lam. Raises InputError unless its sizes fit."""
        own, whole = guard(model), self.whole
        if (own.n, own.k) != (whole.n, whole.k) or own.m > self.width:
            sizes = f"n = {whole.n}, k = {whole.k} and m <= {self.width}, of the run and the models named in `then`"
            raise InputError(f"events: the model {model!r:.60} has n = {own.n}, k = {own.k}, m = {own.m}; it must have {sizes}")
        own.columns = slice(0, own.m)
        return own

    def start(self, state):
        """The first State of a run with the columns of lam of all rows; its integrator starts anew."""
        memory = {name: value for name, value in state.memory.items() if name != "events"}
        return replace(self.spread(state), memory=memory, restart=True)

    def whole_state(self, state):
        """A State of the mode with the columns of lam of all rows, 0 for rows that do not act."""
        within = state.within
        memory = state.memory | {"events": np.array([self.sides, self.sizes])} if state.restart else {}
        inner = within and (lambda t: (state := within(t)) and self.spread(state))
        return replace(self.spread(state), memory=memory, restart=state.restart, within=inner)

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
        if known is None:
            self.sides, self.sizes = np.where(np.abs(self.values) > ZERO, np.sign(self.values), 0.0), np.zeros(len(self.events))
            self.started = True
        else:
            self.sides, self.sizes = np.array(known)
            self.started = False
        while True:
            change = None
            for change in self._motion(state, t_end, counts):
                if not isinstance(change, Change) or change.happened:
                    yield change
            if not isinstance(change, Change) or change.stops or t_end - change.after.t <= max(LEAST * span, 64 * math.ulp(t_end)):
                return
            after = change.after
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

    def _at_events(self, before, after, t, fired, counts):
        """Yield the state at time t of a step, unless that is its begin, and the Change by the events with the numbers `fired`."""
        at = self._between(before, after, t)
        start = self._consistent(self.mode, at, "the state")
        if at is before:
            counts.steps -= 1
            yield Change(None, *self._change(start, fired))
            return
        start = self._on_root(before, after, start, fired[0])
        first = self.spread(start)
        yield Stretch.of(first)
        yield Change(first, *self._change(start, fired))

    def _between(self, before, after, t):
        """The State at t of a step, with the outputs that controllers hold in it: they jump at its start if that is a sample."""
        state = between(before, after, t)
        held = [own.placed.columns[own.placed.own :] for own in self.whole.controllers] if self.whole.is_scene else []
        if not held or state is before or state is after:
            return state
        v, columns = state.v.copy(), np.concatenate(held)
        v[columns] = after.v[columns]
        return State(state.t, state.q, v, state.a, state.lam, restart=False)

    def _quiet(self, before, stretch):
        """True for the steps of a stretch in which certainly nothing happens, (steps,), so that `_first` need not look into them."""
        return np.zeros(len(stretch), bool)

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

    def value(self, event, state):
        """The value of an event's function. Raises InputError unless it is a finite number."""
        moment = self._moment(state)
        try:
            value = event.when(moment)
        except InputError as error:  # such as an unknown name
            raise InputError(f"{event.name}: when: {error}") from error
        if moment._reads_forces:
            self.of_forces.add(event.name)
        value = value.item() if isinstance(value, np.ndarray) and value.size == 1 else value
        if not is_number(value):
            raise InputError(f"{event.name}: when gave {value!r:.60} at t = {state.t:.9g} s; it must give a finite number")
        return float(value)

    def _moment(self, state):
        """The Moment of a state of the present mode, as functions of events see it."""
        return Moment(self.whole, self.spread(state), self.mode)

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
        """(time of the first change of sign that counts in a step, or None; the side at its end)."""
        if (side * values > offset).all() and 2 * np.abs(values).min() > np.ptp(values):
            return None, side

        def at(s):
            """Value of the event's function at the share s of the step, 0 to 1, between the two states."""
            return self.value(event, between(before, after, before.t + s * (after.t - before.t)))

        slopes = (COEFFICIENTS @ values)[1:] * np.arange(1, len(values))
        extrema = [float(s.real) for s in np.roots(slopes[::-1]) if abs(s.imag) < 1e-6 and 0.0 < s.real < 1.0] if slopes.any() else []
        points = sorted([*zip(NODES, values), *((s, at(s)) for s in extrema)])
        for (s0, g0), (s1, g1) in zip([points[0], *points], points):
            if abs(g1) <= offset or np.sign(g1) == side:
                continue
            rising, side, from_side = g1 > 0, np.sign(g1), side
            if from_side and event.direction != ("falling" if rising else "rising"):
                if g0 * from_side <= 0.0:  # round-off at the start of a step
                    return before.t + s0 * (after.t - before.t), side
                from scipy.optimize import brentq

                s = brentq(at, s0, s1, xtol=1e-300, rtol=4 * np.finfo(float).eps, maxiter=1000) if s1 < 1.0 or g1 else 1.0
                return min(before.t + s * (after.t - before.t), after.t), side
        return None, side

    def _change(self, state, fired):
        """(state behind, what happened, why the run stops) of the events with the numbers `fired` at a state. Raises StepFailure.

        An event may make others happen at once: those whose functions it moves to the other side.
        """
        happened, waiting, done, stops = [], list(fired), [], ""
        values = np.array([self.value(event, state) for event in self.events])
        while waiting:
            number = waiting.pop(0)
            event = self.events[number]
            done.append(number)
            self._require_fewer(event, happened, state.t)
            rates = self._rates(state)
            state, one, stop = self._apply(event, state)
            happened.append(one)
            stops = stops or stop
            behind = np.array([self.value(event, state) for event in self.events])
            for k in self._set_sides(values, behind, rates, self._rates(state)):
                if k in waiting or k == number:
                    continue
                if k in done:
                    names = ", ".join(repr(self.events[i].name) for i in dict.fromkeys(done[done.index(k) :]))
                    raise StepFailure("events", f"the events {names} undo each other", state.t)
                waiting.append(k)
            values = self.values = behind
        after = self.whole_state(State(state.t, state.q, state.v, state.a, state.lam))
        self.happened.happened += happened
        return after, happened, stops

    def _require_fewer(self, event, happened, t):
        """Raise StepFailure if an event has happened as often as its `most` says; happened: what did at this time."""
        if sum(one.name == event.name for one in (*self.happened, *happened)) >= event.most:
            advice = "if their times accumulate, give pi.Impact a least_speed, or the event a larger `most`"
            raise StepFailure(
                "events", f"event {event.name!r} happened {event.most} times, which is its `most`; {advice}; the run stops", t
            )

    def _set_sides(self, values, behind, rates, rates_behind):
        """Set the sides of the functions behind an event. Returns the numbers of the events whose functions it moved to the other side.

        values, behind: of the functions before and behind it. rates, rates_behind: their d/dt. The side is the sign of the function; of one that
        is zero within round-off the sign of its rate, or none if it does not move.
        """
        jumped = []
        for k, event in enumerate(self.events):
            beyond = OFFSET * max(self.sizes[k], abs(values[k]), abs(behind[k]))
            crosses = values[k] * behind[k] < 0 and min(abs(values[k]), abs(behind[k])) > beyond
            if crosses and event.direction != ("falling" if behind[k] > 0 else "rising"):
                jumped.append(k)
            side = np.sign(behind[k]) if abs(behind[k]) > beyond else 0.0
            moving = abs(rates_behind[k]) > STILL * abs(rates[k])
            self.sides[k] = side or (np.sign(rates_behind[k]) if moving else 0.0)
        return jumped

    def _rates(self, state):
        """d/dt of the events' functions along a state's velocities and accelerations, ahead and behind it."""

        def moved(s):
            """The functions' values at s seconds behind the state, by its velocities and accelerations."""
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

    def _apply(self, event, state):
        """(the consistent state behind an event, Happened, why the run stops, or ""). Sets the mode."""
        energy, asked = self._energy(state), self._asked(event, state)
        names = [self._name(part) for part in asked.added]
        held = {name: np.array([state.t, *asked.q]) for name in names if name in self.whole.rows and name in asked.absent}
        absent = tuple(sorted(asked.absent - set(names)))
        happened = Happened(state.t, event.name, 0.0, np.nan, 0, {}, absent, held, asked.model)
        try:
            after, jump, impulses = self._state_behind(event, state, asked, happened)
        except (InputError, SingularSystem, np.linalg.LinAlgError) as error:
            raise StepFailure("events", f"event {event.name!r}: {error}", state.t) from None
        if self.whole.is_scene:
            times, frames = np.array([state.t]), after.q[None]
            pulled = {name: reaction_of(self.mode, name, times, frames, jump[None], True)[0] for name in held}
            impulses |= {name: tuple(map(float, values)) for name, values in pulled.items()}
            largest = max((math.hypot(*values[:2]) for values in impulses.values()), default=0.0)
        else:
            largest = max(np.abs(jump).max(initial=0.0), *(abs(x) for values in impulses.values() for x in values), 0.0)
        lost = energy - self._energy(after)
        return after, replace(happened, impulse=float(largest), energy_lost=float(lost), impulses=impulses), asked.stops

    def _asked(self, event, state):
        """The Asked of an event at a state: what `then` names, and what the user's functions in it give."""
        label, moment = f"event {event.name!r}", self._moment(state)
        model = self.happened[-1].model if len(self.happened) else 0
        asked = Asked(state.q, state.v, model, set(self.mode.absent))
        if any(isinstance(action, str) for action in event.then):
            asked.stops = f"{label} stopped the run at t = {state.t:.9g} s"
        for action in event.then:
            if isinstance(action, ADDABLE):
                asked.added.append(action)
            elif isinstance(action, Remove):
                asked.absent |= {self._name(part) for part in action.parts}
            elif isinstance(action, Model):
                asked.model = next(k for k, known in enumerate(self.happened.models) if known.user is action or known is action)
            elif isinstance(action, Impact):
                self._ask_impact(asked, event, action, state)
            elif isinstance(action, Impulse):
                force = pull_of(self.whole, action.at, action.impulse)
                asked.pushes.append(Push("impulse", tuple(map(float, action.impulse)), action.at, force))
            elif callable(action):
                asked.functions.append(action)
                asked.q, asked.v, asked.model = self._given(label, action(moment), asked.q, asked.v, asked.model)
        return asked

    def _ask_impact(self, asked, event, impact, state):
        """Add an Impact to what is asked: a push, or the parts `rest` that hold what is slower than its least speed."""
        function = self._of_position(event, state)
        slow = abs(rate_of(self.mode, function, state.t, state.q, state.v)) < impact.least_speed
        if slow and impact.rest:  # their rows stop it
            asked.added += impact.rest
            return
        asked.pushes.append(Push("impact", function=function, factor=1.0 + (0.0 if slow else impact.restitution)))
        if slow:
            asked.stops = f"event {event.name!r} came to rest at t = {state.t:.9g} s, slower than {impact.least_speed:g}: give pi.Impact `rest` to go on"

    def _state_behind(self, event, state, asked, happened):
        """(the consistent State behind an event, impulses (m,) of the rows, {kind of push: its size}). Sets the mode and `reset`."""
        t, old = state.t, self.mode
        self.mode = mode = guard(Events([*self.happened, happened], self.happened.first, self.happened.models).modes(self.whole)[-1])
        laws = [law.row for law in mode.row_laws]  # contacts take part in the next step
        equations = mode.with_rows(np.setdiff1d(np.arange(mode.m), laws)) if laws else mode
        functions = self._functions(event, asked.functions, old, state) if asked.functions else None
        self.reset = Reset(old, functions, tuple(happened.held), equations, asked.pushes)
        require_free(equations, asked.pushes, t, asked.q)
        q, v, jump, sizes = self.reset(equations, t, asked.q, asked.v)
        impulses = {}
        for push, size in zip(asked.pushes, sizes):
            impulses[push.kind] = push.impulse or (float(size),)
        if not laws:
            return State(t, q, v, *consistent_acceleration(mode, t, q, v)), jump, impulses
        after = self._consistent(mode, State(t, q, v, v, np.zeros(mode.m)), f"event {event.name!r}")
        return after, equations.spread(jump, mode.m), impulses

    def _name(self, part):
        """Name of a part in the scene of this run; part: its name, which is returned, or itself."""
        return part if isinstance(part, str) else next(name for name, known in self.whole.parts.items() if known is part)

    def _given(self, label, value, q, v, model):
        """(q, v, number of the model) after an event, from the value that a user's function returned. Raises InputError for a wrong one.

        value: velocities, a State, a model, or None. What it does not give is kept: q, v and the number `model` before the event. A model
        that is new is added to those of the run. label: begins the message.
        """
        if value is None:
            return q, v, model
        if isinstance(value, Model):
            for k, known in enumerate(self.happened.models):
                if known is value or known.user is value:
                    return q, v, k
            self.happened.models.append(self._own(value))
            return q, v, len(self.happened.models) - 1
        given, own = [], len(q) - len(self.whole.hidden)
        for before, array in zip((q, v), (value.q, value.v) if isinstance(value, State) else (q, value)):
            array = floats(array)
            if array is None or array.shape not in ((len(before),), (own,)):
                raise InputError(
                    f"{label}: its function must give {own} finite velocities, a pi.State, a model, or None, not {value!r:.80}"
                )
            given.append(np.append(array, before[len(array) :]))
        if not isinstance(value, State):
            given[1][self.whole.state_columns] = v[self.whole.state_columns]
        return *given, model

    def _of_position(self, event, state):
        """The function of (t, q) of an event with an Impact; velocities are those of a state."""
        return lambda t, q: self.value(event, State(t, q, state.v, state.a, np.zeros(self.mode.m)))

    def _functions(self, event, functions, mode, state):
        """The function (t, q, v, a, lam) -> (q, v) of the functions in `then` of an event at a state of a mode."""

        def given(t, q, v, a, lam):
            """(q, v) behind the functions, which see the state in the mode before the event."""
            with self.in_mode(mode):
                moment = self._moment(State(t, q, v, a, lam))
                for function in functions:
                    q, v, _ = self._given(f"event {event.name!r}", function(moment), q, v, 0)
            return q, v

        return given

    @contextmanager
    def in_mode(self, mode):
        """Context in which functions of events are evaluated in another mode."""
        now, self.mode = self.mode, mode
        try:
            yield
        finally:
            self.mode = now

    def _energy(self, state):
        """Sum of kinetic and potential energy of a state of the mode, J."""
        model, moving = self.mode, self.mode.without_states(state.v)
        potentials = model.potentials(state.q, state.v) if model.k and model.is_scene else model.potentials(state.q)
        return 0.5 * moving @ (model.mass(state.q) @ moving) + sum(potentials)
