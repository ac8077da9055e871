"""The motions of a run with located events: the run is solved once more, and each Jump between two of them is noted with its function and resets.

A JumpObserver is told of the changes while the run is solved (run/event_search.py). What has no slope is refused there.
"""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from polyida.adjoint.event_functions import UserFunction, row_function
from polyida.adjoint.other_places import OtherPlaces
from polyida.errors import InputError
from polyida.integrate.nonsmooth.cone import SLIPS_UP, STICKS
from polyida.integrate.state import Counts, State, declared
from polyida.model.guarded import guard, unguarded
from polyida.model.row_laws import Slips
from polyida.run.contact_events import LEAST_SPEED, ContactHandler
from polyida.run.event_search import Change, Observer
from polyida.run.events import EventHandler
from polyida.run.solve import solve


class Jump(NamedTuple):
    """An event, with those that it causes at its time."""

    modes: tuple  # (before, after): the Model of each
    before: State
    after: State
    function: Any  # what locates the event: GapFunction, SlipRateFunction, ForceFunction or UserFunction
    resets: list  # Reset or _RowReset of each event, in order
    places: OtherPlaces | None = None  # of functions of the user


class _Impact(NamedTuple):
    """An impact of contacts; each array is (rows with laws,)."""

    rates_before: np.ndarray
    impulses: np.ndarray
    status: np.ndarray


class JumpObserver(Observer):
    """Notes the modes, first states and jumps of a run while its handler solves it. Raises InputError for what has no adjoint."""

    def __init__(self, handler):
        """Take the EventHandler or ContactHandler, and become its observer."""
        self.handler = handler
        self.modes = []  # the model of each motion
        self.starts = []  # State with which each motion begins, with the columns of lam of its mode
        self.jumps = []  # Jump between each motion and the next
        # of the events that happen now
        self.mode = None  # the model before them
        self.status = None  # of the rows with laws before them, if the model has such rows
        self.impact = None  # _Impact of contacts, if there is one
        self.resets = []  # Reset of each event of the user
        self.causes = []  # (Event, the State before it) of each
        handler.observer = self

    def begin(self, mode, state):
        """Note a motion that begins in a mode at a state with all columns. Raises InputError for slip with friction by pressure."""
        if isinstance(mode, Slips) and any(law.mu for law, _ in mode.slips):
            name = next(law.name for law, _ in mode.slips if law.mu)
            raise InputError(
                f"gradient: {name!r} slips with friction that its pressure gives, for which there is no adjoint; use differences of runs"
            )
        self.modes.append(mode)
        self.starts.append(State(state.t, state.q, state.v, state.a, state.lam[mode.columns]))

    def before_change(self, state, fired):
        """Begin the notes of events. Raises InputError for an impact at the start of the run, which no event locates."""
        if not fired:
            why = f"a contact is hit at the start of the run, t = {state.t:.9g} s, for which there is no adjoint"
            raise InputError(f"gradient: {why}; begin with the velocities behind the impact")
        self.mode = self.handler.mode
        self.status = self.handler.status if isinstance(self.handler, ContactHandler) else None
        self.impact = None
        self.resets = []
        self.causes = []

    def applied(self, event, state, reset):
        """Note the Reset of an event of the user, and its cause."""
        self.resets.append(reset)
        self.causes.append((event, state))

    def hit(self, rates, impulses, status):
        """Note an impact of contacts."""
        self.impact = _Impact(rates, impulses, status)

    def after_change(self, state, fired, after, happened):
        """Note the Jump of events that happened at a state. Raises InputError if several events happen at one time, but of one impact."""
        if not happened:
            return
        handler = self.handler
        event = handler.events[fired[0]]
        if len(fired) > 1 and self.impact is None:
            names = ", ".join(dict.fromkeys(handler.events[k].name for k in fired))
            raise InputError(f"gradient: {names} happen at one time, t = {state.t:.9g} s, where the motion has no slopes")
        if isinstance(handler, ContactHandler):
            function = row_function(handler.whole, self.mode, event.law, self.status[event.law])
            resets, places = [self._impact_reset()] if self.impact else [], None
        else:
            function, resets = UserFunction(handler, event, self.mode, state), self.resets
            places = OtherPlaces(handler, event, self.mode, resets, self.causes)
        self.begin(handler.mode, after)
        self.jumps.append(Jump((self.mode, handler.mode), state, self.starts[-1], function, resets, places))

    def _impact_reset(self):
        """The reset of an impact of contacts: rates of the rows that carry impulses become -e times those before."""
        rates, P, status = self.impact
        contacts = self.handler.contacts
        hit = contacts.contact & (P > 0.0)
        slipping = np.flatnonzero((status >= SLIPS_UP) & ~contacts.contact & (P != 0.0))
        if len(slipping):
            raise InputError(
                f"gradient: {contacts.names[slipping[0]]!r} slips in an impact, for which there is no adjoint; use differences of runs"
            )
        sticks = ~contacts.contact & (status == STICKS)
        back = np.where(hit & (rates < -LEAST_SPEED), contacts.restitution, 0.0)
        rows = np.sort(np.concatenate([contacts.equations, contacts.rows[hit | sticks]]))
        factors = np.zeros(self.handler.whole.m)
        factors[contacts.rows] = back
        return _RowReset(self.mode, self.handler.whole.with_rows(rows), 1.0 + factors[rows])


@dataclass(frozen=True, eq=False)
class _RowReset:
    """The Reset of an impact of rows, whose rates change by `-factors` of them. It has the fields of a Reset that an adjoint reads."""

    mode: Any  # the model before the impact
    equations: Any  # the model with the rows that take impulses alone
    factors: np.ndarray  # of its rows, 1 + e
    given: Any = None  # no functions of users
    held: tuple = ()  # no joints that hold on to a position

    def __call__(self, model, t, q, v):
        """(q, v) after the impact: v changes by dv, `M dv + B^T dlam = 0`, `B dv = -factors (B v + phi_t)`."""
        return q, v + model.mass_system(t, q).solve(np.zeros(model.n), model.phi_rate(t, q, v) * self.factors)[0]


class Motions:
    """The motions of a run with events, by solving it again. Raises InputError for what has no adjoint.

    modes, starts: model and first State of each. ends: its end time. jumps: Jump between each and the next. handler: of the run solved again.
    """

    def __init__(self, run):
        """Solve the run again, and note what its events change."""
        self.whole = guard(run.model)
        first = State(float(run.t[0]), *(np.array(x[0], float) for x in (run.q, run.v, run.a, run.lam)))
        if self.whole.row_laws:
            self.handler = ContactHandler(self.whole, declared(run.integrator), compiled=False)
        else:
            if run.events.causes is None:
                raise InputError(
                    "gradient: the run has events, whose functions no file holds; take the gradient of the run that solve gives"
                )
            self.handler = EventHandler(run.model, run.events.causes, declared(run.integrator))
            first = replace(first, lam=first.lam[self.handler.mode.columns])
        observer = JumpObserver(self.handler)
        state = self.handler.start(first)
        observer.begin(self.handler.mode, state)
        end = float(run.t[-1])
        for part in self.handler.stretches(state, end, Counts()):
            if isinstance(part, Change) and part.after.t >= end:
                raise InputError(
                    f"gradient: an event happens at the end of the run, t = {end:.9g} s, which has no slope; choose another end"
                )
        self.modes = observer.modes
        self.starts = observer.starts
        self.jumps = observer.jumps
        self.ends = [*(jump.before.t for jump in self.jumps), end]

    @property
    def changes_model(self):
        """True if events change the parts of the scene or the model of the user."""
        if self.whole.is_scene:
            return any(mode.absent or (mode.whole is not None and mode.since) for mode in self.modes)
        return len({id(unguarded(mode)) for mode in self.modes}) > 1


def solved_motions(run, motions):
    """The run of each motion, from the state after one event to the time of the next. Raises InputError if one cannot be solved again."""
    runs = []
    for mode, start, end in zip(motions.modes, motions.starts, motions.ends):
        runs.append(solve(mode, end, run.integrator, state=start))
        if not runs[-1].success:
            raise InputError(f"gradient: the motion to t = {end:.9g} s cannot be solved again: {runs[-1].message}")
    return runs
