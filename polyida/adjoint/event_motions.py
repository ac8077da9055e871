"""The motions of a run with located events: the run is solved once more, and each Jump between two of them is noted with its function and resets."""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from polyida.adjoint.resets import moved_along, span_of
from polyida.adjoint.seen_places import SeenPlaces
from polyida.adjoint.taped import Tape, TapedModel, pulled_back
from polyida.errors import InputError
from polyida.integrate.nonsmooth.cone import CLOSED, SLIPS_UP, STICKS
from polyida.integrate.start import consistent_acceleration
from polyida.integrate.state import Counts, State, declared
from polyida.model.differences import along, jacobian
from polyida.model.guarded import guard, unguarded
from polyida.model.row_laws import Slips
from polyida.run.contact_events import LEAST_SPEED, ContactHandler
from polyida.run.events import Change, EventHandler
from polyida.run.solve import solve


class Jump(NamedTuple):
    """An event, with those that it causes at its time.

    modes: before it and behind it; before, after: State of each. function: what locates it (`_RowFunction`, `_UserFunction`). resets: Reset
    of each, in order. seen: SeenPlaces of functions of the user, or None.
    """

    modes: tuple
    before: State
    after: State
    function: Any
    resets: list
    seen: Any = None


class Motions:
    """The modes, first states and jumps of a run with events, by solving it again. Raises InputError for what has no adjoint."""

    def __init__(self, run):
        """Solve the run again, and note what its events change."""
        model = self.whole = guard(run.model)
        first = State(float(run.t[0]), *(np.array(x[0], float) for x in (run.q, run.v, run.a, run.lam)))
        if model.row_laws:
            self.happenings = ContactHandler(model, declared(run.integrator), compiled=False)
            impact = self.happenings.contacts.impact
            self.happenings.contacts.impact = lambda *arguments: self._noted(impact, arguments)
        else:
            if run.events.causes is None:
                raise InputError(
                    "gradient: the run has events, whose functions no file holds; take the gradient of the run that solve gives"
                )
            self.happenings = EventHandler(run.model, run.events.causes, declared(run.integrator))
            first = replace(first, lam=first.lam[self.happenings.mode.columns])
        self.jumps, self.starts, self.modes, self.resets = [], [], [], []
        change, apply = self.happenings._change, self.happenings._apply
        self.happenings._change = lambda state, fired: self._changed(change, state, fired)
        self.happenings._apply = lambda event, state: self._applied(event, state, apply(event, state))
        state = self.happenings.start(first)
        self._begin(self.happenings.mode, state)
        counts, end = Counts(), float(run.t[-1])
        for part in self.happenings.stretches(state, end, counts):
            if isinstance(part, Change) and part.after.t >= end:
                raise InputError(
                    f"gradient: an event happens at the end of the run, t = {end:.9g} s, which has no slope; choose another end"
                )
        self.ends = [*(jump.before.t for jump in self.jumps), end]

    @property
    def changes_model(self):
        """True if events change the parts of the scene or the model of the user."""
        if self.whole.is_scene:
            return any(mode.absent or (mode.whole is not None and mode.since) for mode in self.modes)
        return len({id(unguarded(mode)) for mode in self.modes}) > 1

    def _begin(self, mode, state):
        """Note a motion that begins in a mode at a state. Raises InputError for slip with friction by pressure."""
        if isinstance(mode, Slips) and any(law.mu for law, _ in mode.slips):
            name = next(law.name for law, _ in mode.slips if law.mu)
            raise InputError(
                f"gradient: {name!r} slips with friction that its pressure gives, for which there is no adjoint; use differences of runs"
            )
        self.modes.append(mode)
        self.starts.append(State(state.t, state.q, state.v, state.a, state.lam[mode.columns]))

    def _noted(self, impact, arguments):
        """Note the results and arguments of an impact of contacts."""
        self.impact = impact(*arguments), arguments
        return self.impact[0]

    def _applied(self, event, state, result):
        """Note the Reset of an event and its cause."""
        self.resets.append(self.happenings.reset)
        self.causes.append((event, state))
        return result

    def _changed(self, change, state, fired):
        """Note the Jump of events that happen at a state, and return what `change` returns. Raises InputError for events without slopes."""
        one, self.impact, self.resets, self.causes = self.happenings, None, [], []
        before, status = one.mode, getattr(one, "status", None)
        if not fired:
            why = f"a contact is hit at the start of the run, t = {state.t:.9g} s, for which there is no adjoint"
            raise InputError(f"gradient: {why}; begin with the velocities behind the impact")
        law = one.events[fired[0]]
        after, happened, stops = change(state, fired)
        if not happened:
            return after, happened, stops
        if len(fired) > 1 and self.impact is None:
            names = ", ".join(dict.fromkeys(one.events[k].name for k in fired))
            raise InputError(f"gradient: {names} happen at one time, t = {state.t:.9g} s, where the motion has no slopes")
        if isinstance(one, ContactHandler):
            function = _RowFunction(self.whole, before, law.law, status[law.law])
            resets, seen = [self._impact_reset(before)] if self.impact else [], None
        else:
            function, resets = _UserFunction(one, law, before, state), self.resets
            seen = SeenPlaces(one, law, before, resets, self.causes)
        self._begin(one.mode, after)
        behind = State(after.t, after.q, after.v, after.a, after.lam[one.mode.columns])
        self.jumps.append(Jump((before, one.mode), state, behind, function, resets, seen))
        return after, happened, stops

    def _impact_reset(self, mode):
        """The reset of an impact of contacts: rates of the rows that carry impulses become -e times those before."""
        (_, P, _, status), (_, _, _, rates, *_) = self.impact
        contacts = self.happenings.contacts
        hit = contacts.contact & (P > 0.0)
        slipping = np.flatnonzero((status >= SLIPS_UP) & ~contacts.contact & (P != 0.0))
        if len(slipping):
            raise InputError(
                f"gradient: {contacts.names[slipping[0]]!r} slips in an impact, for which there is no adjoint; use differences of runs"
            )
        sticks = ~contacts.contact & (status == STICKS)
        back = np.where(hit & (rates < -LEAST_SPEED), contacts.restitution, 0.0)
        rows = np.sort(np.concatenate([contacts.equations, contacts.rows[hit | sticks]]))
        factors = np.zeros(self.whole.m)
        factors[contacts.rows] = back
        return _RowReset(mode, self.whole.with_rows(rows), 1.0 + factors[rows])


@dataclass(frozen=True, eq=False)
class _RowReset:
    """The Reset of an impact of rows, whose rates change by `-factors` of them."""

    mode: Any
    equations: Any
    factors: Any
    given: Any = None
    held: tuple = ()

    def __call__(self, model, t, q, v):
        """(q, v) behind the impact: v changes by dv, `M dv + B^T dlam = 0`, `B dv = -factors (B v + phi_t)`."""
        return q, v + model.mass_system(t, q).solve(np.zeros(model.n), model.phi_rate(t, q, v) * self.factors)[0]


class _RowFunction:
    """The function of a row with a law before its event: `back(c)` gives c g_q, c g_v, a model and its entries for parameters; rate: g'."""

    def __init__(self, whole, mode, number, status):
        """Take the row's law with this number, and its status before the event."""
        self.whole, self.mode, self.status = whole, mode, status
        self.law = whole.row_laws[number]
        self.gap = self.law.is_contact and status != CLOSED
        self.of_rate = not self.law.is_contact and status >= SLIPS_UP

    def rate(self, state):
        """The derivative g' of the function in time, along the motion before the event."""
        whole, row, (t, q, v) = self.whole, self.law.row, (state.t, state.q, state.v)
        if self.gap:
            return float(whole.phi_rate(t, q, v)[row])
        if self.of_rate:
            return float((whole.phi_q(t, q) @ state.a + whole.phi_bias(t, q, v))[row])

        def force(s):
            """The derivative of the force function in lam times the consistent lam at the time s later along the motion, (1,)."""
            now = t + s, q + s * v + 0.5 * s * s * state.a, v + s * state.a
            lam = self.mode.spread(consistent_acceleration(self.mode, *now)[1], whole.m)
            return np.array([self._weights(state) @ lam])

        return float(along(force)[0])

    def _weights(self, state):
        """The derivative of the function of a force in lam of all rows."""
        lam, weights = self.mode.spread(state.lam, self.whole.m), np.zeros(self.whole.m)
        weights[self.law.row] = -1.0 if self.law.is_contact else -np.sign(lam[self.law.row])
        size = np.linalg.norm(lam[list(self.law.on)])
        if not self.law.is_contact and size:
            weights[list(self.law.on)] += self.law.mu * lam[list(self.law.on)] / size
        return weights

    def back(self, state, c):
        """(c g_q, c g_v, model, entries) at a state, g the row's gap, rate of slip or force that makes its event.

        model: the whole one, or the mode's if g is a force; entries: its AdjointMultipliers, which give c g_p.
        """
        t, unit = state.t, np.zeros(self.whole.m)
        unit[self.law.row] = c
        if self.gap:
            taped = TapedModel(self.whole, Tape())
            taped.add_entry(t, state.q, mu=unit)
            of_q, of_v, entries = unit @ self.whole.phi_q(t, state.q), np.zeros(len(state.q)), taped.entries
        elif self.of_rate:
            of_q, of_v, entries = pulled_back(self.whole, state, lambda model, q, v: (model.phi_rate(t, q, v),), (unit,))
        else:
            adjoints = None, c * self._weights(state)[self.mode.columns]
            of_q, of_v, entries = pulled_back(self.mode, state, lambda model, q, v: consistent_acceleration(model, t, q, v), adjoints)
        return of_q, of_v, self.whole if self.gap or self.of_rate else self.mode, entries


class _UserFunction:
    """The function of a user's event, by differences; it does not depend on parameters but by accelerations and multipliers."""

    def __init__(self, happenings, event, mode, state):
        """Take the slopes of the function in q and v, and in a and lam if it reads these, at the event."""
        self.happenings, self.event, self.mode = happenings, event, mode
        self.of_forces = event.name in happenings.of_forces
        now = state.q, state.v, state.a, state.lam
        with happenings.in_mode(mode):
            self.slopes = [
                jacobian(lambda x, k=k: self._at(state.t, *now[:k], x, *now[k + 1 :]), now[k], 1)[0] if k < 2 or self.of_forces else None
                for k in range(4)
            ]

    def _at(self, t, q, v, a, lam):
        """The function of the event at a state, (1,)."""
        return np.array([self.happenings.value(self.event, State(t, q, v, a, lam))])

    def rate(self, state):
        """dg/dt along the motion, whose accelerations are consistent."""

        def moved(s):
            """The function of the event, (1,), at the time s later along the motion; with consistent a and lam if it reads these."""
            now = moved_along(state, s)
            return self._at(*now, *(consistent_acceleration(self.mode, *now) if self.of_forces else (state.a, state.lam)))

        with self.happenings.in_mode(self.mode):
            return float(along(moved, span_of(state))[0])

    def back(self, state, c):
        """(c g_q, c g_v, model, its entries for parameters) of the function g at a state."""
        of_q, of_v, entries = c * self.slopes[0], c * self.slopes[1], []
        if self.of_forces:
            adjoints = [c * slope for slope in self.slopes[2:]]
            q, v, entries = pulled_back(self.mode, state, lambda model, q, v: consistent_acceleration(model, state.t, q, v), adjoints)
            of_q, of_v = of_q + q, of_v + v
        return of_q, of_v, self.mode, entries


def solved_motions(run, motions):
    """The run of each motion, from the state behind one event to the time of the next. Raises InputError if one cannot be solved again."""
    runs = []
    for mode, start, end in zip(motions.modes, motions.starts, motions.ends):
        runs.append(solve(mode, end, run.integrator, state=start))
        if not runs[-1].success:
            raise InputError(f"gradient: the motion to t = {end:.9g} s cannot be solved again: {runs[-1].message}")
    return runs
