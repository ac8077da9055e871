"""The events of users in a run: what `then` of each asks for, and the state after it.

event_search.py finds the time. Then parts change, the model is that of the parts that act, and velocities jump (reset.py). After an event the
side of its function is that to which it moves, if it moves. The run goes on from a consistent state.
"""

import math
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass, field, replace

import numpy as np

from polyida.errors import InputError, StepFailure
from polyida.event import ADDABLE, Events, Happened, Impact, Impulse, Moment, Remove
from polyida.integrate.start import consistent_acceleration
from polyida.integrate.state import State
from polyida.linear.lu import SingularSystem
from polyida.model import Model
from polyida.model.guarded import guard
from polyida.results.motion import reaction_of
from polyida.run.event_search import OFFSET, EventSearch
from polyida.run.reset import Push, Reset, pull_of, rate_of, require_free
from polyida.validation import floats, is_number

STILL = 1e-9  # of the rate before an event: a smaller one is round-off


@dataclass
class Asked:
    """What `then` of an event asks for at a state."""

    q: np.ndarray  # (n,) as the user's functions set them
    v: np.ndarray
    model: int  # number of the user's model after the event
    absent: set  # names of the parts that do not act after it
    added: list = field(default_factory=list)  # parts that act from now on
    pushes: list = field(default_factory=list)  # Push of each impulse and impact, in their order
    functions: list = field(default_factory=list)  # of the user
    stops: str = ""  # why the run ends here, or ""


class EventHandler(EventSearch):
    """The events of users in a run: changes the model and the velocities at each of them."""

    def __init__(self, model, events, method, happened=None):
        """Take the model of all parts, the events with names, the integrator, and the Events so far of a run that is resumed."""
        whole = guard(model)
        models = [] if whole.is_scene else [model, *(action for event in events for action in event.then if isinstance(action, Model))]
        if happened is None:
            late = (whole.late or ()) if whole.is_scene else ()
            happened = Events((), late, given=True)
        happened.causes = events
        super().__init__(whole, events, method, happened, max([whole.m, *(guard(one).m for one in models)]))
        self.happened.models = [self._own(one) for one in models]
        if max((one.model for one in self.happened), default=0) >= max(1, len(models)):
            raise InputError("events: a function of an event made the model that acts, which no file holds; name it in `then`")
        self.mode = guard(self.happened.modes(self.whole)[-1])

    def of_model(self, whole, mode):
        """A handler of the same events that evaluates their functions with another model `whole` and its mode."""
        other = copy(self)
        other.whole, other.mode = whole, mode
        return other

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

    def _change(self, state, fired):
        """(State after, what happened, why the run stops) of the events with the numbers `fired` at a state. Raises StepFailure.

        An event may make others happen at once: those whose functions it moves to the other side.
        """
        happened, stops = [], ""
        waiting, done = list(fired), []  # numbers of the events that are still to happen, and of those that have
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
            crossed = self._set_sides(values, behind, rates, self._rates(state))
            waiting += self._caused(crossed, number, waiting, done, state.t)
            values = self.values = behind
        after = self.whole_state(State(state.t, state.q, state.v, state.a, state.lam))
        self.happened.happened += happened
        return after, happened, stops

    def _caused(self, crossed, number, waiting, done, t):
        """Numbers of the events that event `number` makes happen: those whose functions it has moved, `crossed`, and that do not wait.

        Raises StepFailure if one of them has happened at this time already.
        """
        caused = []
        for k in crossed:
            if k in waiting or k == number:
                continue
            if k in done:
                names = ", ".join(repr(self.events[i].name) for i in dict.fromkeys(done[done.index(k) :]))
                raise StepFailure("events", f"the events {names} undo each other", t)
            caused.append(k)
        return caused

    def _require_fewer(self, event, happened, t):
        """Raise StepFailure if an event has happened as often as its `most` says; happened: what did at this time."""
        if sum(one.name == event.name for one in (*self.happened, *happened)) >= event.most:
            advice = "if their times accumulate, give pi.Impact a least_speed, or the event a larger `most`"
            raise StepFailure(
                "events", f"event {event.name!r} happened {event.most} times, which is its `most`; {advice}; the run stops", t
            )

    def _set_sides(self, values, behind, rates, rates_behind):
        """Set the sides of the functions after an event. Returns the numbers of the events whose functions it moved to the other side.

        values, behind: of the functions before and after it. rates, rates_behind: their d/dt. The side is the sign of the function; of one that
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

    def _apply(self, event, state):
        """(the consistent state after an event, Happened, why the run stops, or ""). Sets the mode."""
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
        function = self.function_of_position(event, state)
        slow = abs(rate_of(self.mode, function, state.t, state.q, state.v)) < impact.least_speed
        if slow and impact.rest:  # their rows stop it
            asked.added += impact.rest
            return
        asked.pushes.append(Push("impact", function=function, factor=1.0 + (0.0 if slow else impact.restitution)))
        if slow:
            asked.stops = f"event {event.name!r} came to rest at t = {state.t:.9g} s, slower than {impact.least_speed:g}: give pi.Impact `rest` to go on"

    def _state_behind(self, event, state, asked, happened):
        """(the consistent State after an event, impulses (m,) of the rows, {kind of push: its size}). Sets the mode."""
        t, old = state.t, self.mode
        self.mode = mode = guard(Events([*self.happened, happened], self.happened.first, self.happened.models).modes(self.whole)[-1])
        laws = [law.row for law in mode.row_laws]  # contacts take part in the next step
        equations = mode.with_rows(np.setdiff1d(np.arange(mode.m), laws)) if laws else mode
        functions = self.functions_of(event, asked.functions, old, state) if asked.functions else None
        reset = Reset(old, functions, tuple(happened.held), equations, asked.pushes)
        self.observer.applied(event, state, reset)
        require_free(equations, asked.pushes, t, asked.q)
        q, v, jump, sizes = reset(equations, t, asked.q, asked.v)
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

    def function_of_position(self, event, state):
        """The function of (t, q) of an event with an Impact; velocities are those of a state."""
        return lambda t, q: self.value(event, State(t, q, state.v, state.a, np.zeros(self.mode.m)))

    def functions_of(self, event, functions, mode, state):
        """The function (t, q, v, a, lam) -> (q, v) of the functions in `then` of an event at a state of a mode."""

        def given(t, q, v, a, lam):
            """(q, v) after the functions, which see the state in the mode before the event."""
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
