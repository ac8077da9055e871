"""Gradients of runs with located events: adjoints of the motions between them, and of the jumps of their slopes.

The run is solved once more to find its modes. Between two events it is a run of one mode, solved from the state behind the first to the time of the
second, whose adjoint is that of its integrator. With z = (q, v), z' = f, the reset `z+ = R(z-)` and the function g of the event, whose zero is its
time, `dz+ = (R_z + (f+ - R_z f-) g_z / (g_z . f-)) dz-` (saltation matrix). Backward, b being the bar of z+ and T the objective's slope in the time
of the event:

    c = -(b . (R_z f- - f+) + T) / g',    bar of z- = R_z^T b + c g_z,    dJ/dp += b . R_p + c g_p

The states of a motion stretch evenly between two events, as those between kinks that a parameter moves.

Leine, Nijmeijer, Dynamics and Bifurcations of Non-Smooth Mechanical Systems (2004), chapter 7.
"""

from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from polyida.adjoint.history import stored_state
from polyida.adjoint.mode_totals import TotalsOfModes, wide
from polyida.adjoint.parameter import stacked
from polyida.adjoint.resets import moved_along, pulled_through, rate_behind, span_of
from polyida.adjoint.run import Gradient, Totals, together
from polyida.adjoint.seen_places import SeenPlaces
from polyida.adjoint.taped import Tape, TapedModel, pulled_back
from polyida.errors import InputError
from polyida.event import Events
from polyida.integrate.nonsmooth.cone import CLOSED, SLIPS_UP, STICKS
from polyida.integrate.start import consistent_acceleration
from polyida.integrate.state import Counts, State, declared
from polyida.model.differences import along, jacobian
from polyida.model.guarded import guard, unguarded
from polyida.model.row_laws import Slips
from polyida.objective.objective import Slopes, slopes_at
from polyida.run.contact_events import LEAST_SPEED, ContactHandler
from polyida.run.events import Change, EventHandler
from polyida.run.solve import solve

TIME_STEPPING = "time steps pass impacts without locating them, so that slopes of their states are wrong"


class Jump(NamedTuple):
    """An event, with those that it causes at its time.

    modes: before it and behind it; before, after: State of each. function: what locates it (`_RowFunction`, `_UserFunction`). resets: Reset of
    each, in order. seen: SeenPlaces of functions of the user, or None.
    """

    modes: tuple
    before: State
    after: State
    function: Any
    resets: list
    seen: Any = None


class _Motions:
    """The modes, first states and jumps of a run with events, by solving it again. Raises InputError for what has no adjoint."""

    def __init__(self, run):
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
        if isinstance(mode, Slips) and any(law.mu for law, _ in mode.slips):
            name = next(law.name for law, _ in mode.slips if law.mu)
            raise InputError(
                f"gradient: {name!r} slips with friction that its pressure gives, for which there is no adjoint; use differences of runs"
            )
        self.modes.append(mode)
        self.starts.append(State(state.t, state.q, state.v, state.a, state.lam[mode.columns]))

    def _noted(self, impact, arguments):
        self.impact = impact(*arguments), arguments
        return self.impact[0]

    def _applied(self, event, state, result):
        self.resets.append(self.happenings.reset)
        self.causes.append((event, state))
        return result

    def _changed(self, change, state, fired):
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
        return q, v + model.mass_system(t, q).solve(np.zeros(model.n), model.phi_rate(t, q, v) * self.factors)[0]


class _RowFunction:
    """The function of a row with a law before its event: `back(c)` gives c g_q, c g_v, a model and its entries for parameters; rate: g'."""

    def __init__(self, whole, mode, number, status):
        self.whole, self.mode, self.law, self.status = whole, mode, whole.row_laws[number], status
        self.gap = self.law.is_contact and status != CLOSED
        self.of_rate = not self.law.is_contact and status >= SLIPS_UP

    def rate(self, state):
        whole, row, (t, q, v) = self.whole, self.law.row, (state.t, state.q, state.v)
        if self.gap:
            return float(whole.phi_rate(t, q, v)[row])
        if self.of_rate:
            return float((whole.phi_q(t, q) @ state.a + whole.phi_bias(t, q, v))[row])

        def force(s):
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
        t, unit = state.t, np.zeros(self.whole.m)
        unit[self.law.row] = c
        if self.gap:
            taped = TapedModel(self.whole, Tape())
            taped.add_entry(t, state.q, mu=unit)
            of_q, of_v, entries = unit @ self.whole.phi_q(t, state.q), np.zeros(len(state.q)), taped.entries
        elif self.of_rate:
            of_q, of_v, entries = pulled_back(self.whole, state, lambda model, q, v: (model.phi_rate(t, q, v),), (unit,))
        else:
            bars = None, c * self._weights(state)[self.mode.columns]
            of_q, of_v, entries = pulled_back(self.mode, state, lambda model, q, v: consistent_acceleration(model, t, q, v), bars)
        return of_q, of_v, self.whole if self.gap or self.of_rate else self.mode, entries


class _UserFunction:
    """The function of a user's event, by differences; it does not depend on parameters but by accelerations and multipliers."""

    def __init__(self, happenings, event, mode, state):
        self.happenings, self.event, self.mode = happenings, event, mode
        self.of_forces = event.name in happenings.of_forces
        now = state.q, state.v, state.a, state.lam
        with happenings.in_mode(mode):
            self.slopes = [
                jacobian(lambda x, k=k: self._at(state.t, *now[:k], x, *now[k + 1 :]), now[k], 1)[0] if k < 2 or self.of_forces else None
                for k in range(4)
            ]

    def _at(self, t, q, v, a, lam):
        return np.array([self.happenings.value(self.event, State(t, q, v, a, lam))])

    def rate(self, state):
        """dg/dt along the motion, whose accelerations are consistent."""

        def moved(s):
            now = moved_along(state, s)
            return self._at(*now, *(consistent_acceleration(self.mode, *now) if self.of_forces else (state.a, state.lam)))

        with self.happenings.in_mode(self.mode):
            return float(along(moved, span_of(state))[0])

    def back(self, state, c):
        of_q, of_v, entries = c * self.slopes[0], c * self.slopes[1], []
        if self.of_forces:
            bars = [c * slope for slope in self.slopes[2:]]
            q, v, entries = pulled_back(self.mode, state, lambda model, q, v: consistent_acceleration(model, state.t, q, v), bars)
            of_q, of_v = of_q + q, of_v + v
        return of_q, of_v, self.mode, entries


class _Part:
    """The slopes of an objective in the frames of one motion, with the bars of its last state from the motion behind. As an objective."""

    value = 0.0

    def __init__(self, slopes, first, count, columns):
        self.of_run, self.first, self.count, self.columns, self.end = slopes, first, count, columns, None

    def slopes(self, run):
        return self

    def __call__(self, part):
        begin, stop, _ = part.indices(self.count)
        own = self.of_run(slice(self.first + begin, self.first + stop))
        own = own if own.lam is None else replace(own, lam=own.lam[:, self.columns])
        if self.end is None or stop < self.count:
            return own
        bars = [np.zeros((stop - begin, len(x))) for x in self.end]
        for rows, x in zip(bars, self.end):
            rows[-1] = x
        return own.plus(Slopes(q=bars[0], v=bars[1]))

    def by_time(self, run):
        """Slopes of J in the times of the motion's frames, (count,), with the states that move along the motion."""
        own = self.of_run(slice(self.first, self.first + self.count))
        total, times = own.by_time(), run.t
        total = np.zeros(self.count) if total is None else np.array(total, float)
        change = [run.v, run.a, *(np.gradient(x, times, axis=0) if len(times) > 1 else np.zeros_like(x) for x in (run.a, run.lam))]
        for slope, rate in zip((own.q, own.v, own.a, own.lam), change):
            if slope is not None:
                rate = rate if slope is not own.lam else wide(rate, self.columns, slope.shape[1])
                total += np.sum(slope * rate, axis=1)
        return total


def gradients_of_events(kind, run, objectives, names, memory_limit, progress):
    """The Gradient of each objective of a run with located events. kind: the RunAdjoint of its integrator."""
    if run.status == "stopped":
        raise InputError("gradient: the run ended at an event or by `until`, whose time has no slope; solve to a time of its own")
    motions = _Motions(run)
    m, runs = motions.happenings.width, []
    for mode, start, end in zip(motions.modes, motions.starts, motions.ends):
        runs.append(solve(mode, end, run.integrator, state=start))
        if not runs[-1].success:
            raise InputError(f"gradient: the motion to t = {end:.9g} s cannot be solved again: {runs[-1].message}")
    firsts = np.cumsum([0, *(len(one) for one in runs)])
    whole = _joined(run, runs, motions, firsts, m)
    with_v0 = run.plan.get("began") != "state"
    totals, counts = Totals(run.model, names, with_v0), Counts()
    for name, parameter in list(totals.parameters.items()):
        if parameter.kinks(float(run.t[0]), float(run.t[-1])):
            totals.leave_out(name, "it moves kinks of a run with events, for which there is no adjoint")
    modes = TotalsOfModes(totals, motions, m)
    modes.exclude_at_start(motions.modes[0], motions.starts[0], not with_v0)
    each = [_Backward(objective, totals.empty(), whole, runs, firsts, motions.modes) for objective in objectives]
    for k in reversed(range(len(runs))):
        mode, one = motions.modes[k], replace(runs[k], plan=runs[k].plan | {"began": "start"})
        parts = [backward.part(k) for backward in each]
        sweeps = kind(one, parts[0], [], memory_limit).with_others(one, parts[1:])
        for backward, sweep in zip(each, sweeps):
            sweep.counts = counts
            sweep.totals = sweep.objective_slopes.totals = modes.of(mode, backward.totals, backward.held)
        state = stored_state(sweeps[0].history, 0)
        for backward, sweep, ends in zip(each, sweeps, together(sweeps, progress)):
            ends = sweep.start_bars(ends)
            if k:
                before, by_time = _start_bars(mode, state, ends, sweep.totals), _time_slope(backward.by_times, runs, k)
                backward.bars = _through(motions.jumps[k - 1], before, by_time, backward, modes)
            elif with_v0:
                v0, entries = sweep._start(state, ends)
                if entries:
                    sweep.totals.add(stacked(entries))
                backward.totals.add_start(state, v0, mode)
    return [Gradient(backward.value, backward.totals.slopes(), counts, totals.left_out) for backward in each]


class _Backward:
    """An objective on its way back through the motions.

    bars: of the last state of the motion that is next, None for the last motion. held: of TotalsOfModes.
    """

    def __init__(self, objective, totals, whole, runs, firsts, modes):
        slopes = objective.slopes(whole)
        self.value = float(slopes.value if hasattr(slopes, "value") else objective(whole))
        self.totals, self.bars, self.held = totals, None, {}
        checked = partial(slopes_at, objective, slopes, whole)
        self.parts = [_Part(checked, first, len(one), mode.columns) for first, one, mode in zip(firsts, runs, modes)]
        self.by_times = [part.by_time(one) for part, one in zip(self.parts, runs)]

    def part(self, k):
        """The _Part of motion k with these bars."""
        self.parts[k].end = self.bars
        return self.parts[k]


def _joined(run, runs, motions, firsts, m):
    """The run with the frames of its motions."""
    lam = np.concatenate([[mode.spread(x, m) for x in one.lam] for mode, one in zip(motions.modes, runs)])
    arrays = {name: np.concatenate([getattr(one, name) for one in runs]) for name in ("t", "q", "v", "a")}
    old, frames = run.events, {jump.before.t: int(first) for jump, first in zip(motions.jumps, firsts[1:])}
    happened = [replace(one, frame=frames[one.t]) for one in motions.happenings.happened if one.t in frames]
    events = Events(happened, old.first, motions.happenings.happened.models, True)
    return replace(run, **arrays, lam=lam, events=events)


def _start_bars(mode, state, bars, totals):
    """Bars of q and v of the first state of a motion, whose a and lam are consistent."""
    results = lambda model, q, v: (q, v, *consistent_acceleration(model, state.t, q, v))  # noqa: E731
    of_q, of_v, entries = pulled_back(mode, state, results, bars)
    if entries:
        totals.add(stacked(entries))
    return of_q, of_v


def _time_slope(by_times, runs, k):
    """The slope of J in the time of the event between motions k - 1 and k, whose frames stretch."""
    result = 0.0
    for number, towards_end in ((k - 1, True), (k, False)):
        t = runs[number].t
        share = (t - t[0]) / (t[-1] - t[0])
        result += float(by_times[number] @ (share if towards_end else 1.0 - share))
    return result


def _through(jump, bars, by_time, backward, modes):
    """Bars of q and v before a jump from those behind it."""
    before, after = jump.before, jump.after
    state = replace(before, a=consistent_acceleration(jump.modes[0], before.t, before.q, before.v)[0])
    rates, all_bars, (q_bar, v_bar), entries = np.concatenate([state.v, state.a]), list(bars), bars, []
    if jump.resets:
        holding = [[(name, before.t) for name in reset.held] for reset in jump.resets if reset.held]
        none, entries = np.zeros(len(state.q)), []
        for _ in range(len(holding) + 1):  # the resets depend on the places of those before
            held = {key: backward.held.get(key, none) + slope for key, slope in modes.in_places(entries, backward.held).items()}
            all_bars = [*bars, *(sum((held[key] for key in keys if key in held), none) for keys in holding)]
            q_bar, v_bar, entries = pulled_through(jump.resets, state, all_bars)
        rates = rate_behind(jump.resets, state)
    rate = jump.function.rate(state)
    if not abs(rate) > 0.0:
        raise InputError(f"gradient: the function of the event at t = {before.t:.9g} s is at rest there, so that its time has no slope")
    c = -(np.concatenate(all_bars) @ rates - bars[0] @ after.v - bars[1] @ after.a + by_time) / rate
    of_q, of_v, *more = jump.function.back(before, c)
    if jump.seen:
        modes.add_seen(jump.modes[0], backward.totals, lambda model: jump.seen.weighed(model, state, all_bars, c))
    for mode, of_mode in (*entries, more):
        if of_mode:
            modes.of(mode, backward.totals, backward.held).add(stacked(of_mode))
    for key in [key for key in backward.held if key[1] == before.t]:  # in the bars of q and v now
        del backward.held[key]
    return q_bar + of_q, v_bar + of_v
