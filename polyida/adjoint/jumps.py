"""Gradients of runs with located events: adjoints of the motions between them, and of the jumps of their slopes.

The run is solved once more to find its modes. Between two events it is a run of one mode, solved from the state behind the first to the time of the
second, whose adjoint is that of its integrator. With z = (q, v), z' = f, the reset `z+ = R(z-)` and the function g of the event, whose zero is its
time, `dz+ = (R_z + (f+ - R_z f-) g_z / (g_z . f-)) dz-` (saltation matrix). Backward, b being the bar of z+ and T the objective's slope in the time
of the event:

    c = -(b . (R_z f- - f+) + T) / g',    bar of z- = R_z^T b + c g_z,    dJ/dp += b . R_p + c g_p

The states of a motion stretch evenly between two events, as those between kinks that a parameter moves.

Leine, Nijmeijer, Dynamics and Bifurcations of Non-Smooth Mechanical Systems (2004), chapter 7.
"""

from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from polyida.adjoint.history import stored_state
from polyida.adjoint.parameter import stacked
from polyida.adjoint.run import Gradient, Totals, together
from polyida.adjoint.taped import Tape, TapedModel, add_to, pulled_back
from polyida.errors import InputError
from polyida.event import Events, Impact, Remove
from polyida.integrate.nonsmooth.cone import CLOSED, SLIPS_UP, STICKS
from polyida.integrate.start import consistent_acceleration
from polyida.integrate.state import Counts, State, declared
from polyida.joint.joint import Joint
from polyida.model.differences import along, jacobian
from polyida.model.guarded import guard
from polyida.model.row_laws import Slips
from polyida.objective.objective import Slopes, slopes_at
from polyida.run.events import Change, Happenings
from polyida.run.modes import LEAST_SPEED, Modes
from polyida.run.solve import solve

TIME_STEPPING = "time steps pass impacts without locating them, so that slopes of their states are wrong"


class Jump(NamedTuple):
    """An event: the mode before it and behind it, State of each, names, and what locates it and what it does.

    function: of (model, t, q, v), maybe on a tape, that gives the event's function and its weights (see `_Function`). reset: of (model,
    t, q, v) that gives v behind; model: that of the reset.
    """

    modes: tuple
    before: State
    after: State
    function: Any
    model: Any
    reset: Any


class _Motions:
    """The modes, first states and jumps of a run with events, by solving it again. Raises InputError for what has no adjoint."""

    def __init__(self, run):
        model = self.whole = guard(run.model)
        first = State(float(run.t[0]), *(np.array(x[0], float) for x in (run.q, run.v, run.a, run.lam)))
        if model.row_laws:
            self.happenings = Modes(model, declared(run.integrator))
            impact = self.happenings.contacts.impact
            self.happenings.contacts.impact = lambda *arguments: self._noted(impact, arguments)
        else:
            if run.events.causes is None:
                raise InputError(
                    "gradient: the run has events, whose functions no file holds; take the gradient of the run that solve gives"
                )
            self.happenings = Happenings(run.model, run.events.causes, declared(run.integrator))
            first = replace(first, lam=first.lam[self.happenings.mode.columns])
        self.jumps, self.starts, self.modes = [], [], []
        change = self.happenings._change
        self.happenings._change = lambda state, fired: self._changed(change, state, fired)
        state = self.happenings.start(first)
        self._begin(self.happenings.mode, state)
        counts, end = Counts(), float(run.t[-1])
        for part in self.happenings.stretches(state, end, counts):
            if isinstance(part, Change) and part.after.t >= end:
                raise InputError(
                    f"gradient: an event happens at the end of the run, t = {end:.9g} s, which has no slope; choose another end"
                )
        self.ends = [*(jump.before.t for jump in self.jumps), end]

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

    def _changed(self, change, state, fired):
        one, self.impact = self.happenings, None
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
        if isinstance(one, Modes):
            function = _RowFunction(self.whole, before, law.law, status[law.law])
            model, reset = self._impact_reset() if self.impact else (None, None)
        else:
            function = _UserFunction(one, law, before, state)
            model, reset = one.mode, self._event_reset(law, state, function)
        self._begin(one.mode, after)
        ends = before, one.mode
        behind = State(after.t, after.q, after.v, after.a, after.lam[one.mode.columns])
        self.jumps.append(Jump(ends, state, behind, function, model, reset))
        return after, happened, stops

    def _impact_reset(self):
        """(model, reset) of an impact of contacts: rates of the rows that carry impulses become -e times those before."""
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
        factors = 1.0 + factors[rows]
        return self.whole.with_rows(rows), lambda model, t, q, v: v + _solved(model, t, q, model.phi_rate(t, q, v) * factors)

    def _event_reset(self, event, state, function):
        """The reset of an event of the user: velocities on the rows behind it, and its impact."""
        for one in event.then:
            if not isinstance(one, (Remove, Impact, Joint)) and one != "stop" and not hasattr(one, "compiled_functions"):
                raise InputError(
                    f"gradient: event {event.name!r}: then = {one!r:.60} has no adjoint; joints, forces, Remove and Impact have"
                )
        impacts = [one for one in event.then if isinstance(one, Impact)]
        rate = float(function.q @ state.v)
        if any(abs(rate) < one.least_speed and one.rest for one in impacts):
            impacts = []

        def reset(model, t, q, v):
            v = v + _solved(model, t, q, model.phi_rate(t, q, v)) if model.m else v
            for one in impacts:
                e = 0.0 if abs(rate) < one.least_speed else one.restitution
                v = v + function.push(model, t, q, v, 1.0 + e)
            return v

        return reset


def _solved(model, t, q, rate):
    """The change of velocities by which the rates of a model change by -rate."""
    return model.mass_system(t, q).solve(np.zeros(model.n), rate)[0]


class _RowFunction:
    """The function of a row with a law before its event: `back(c)` gives (c g_q, c g_v) and entries for parameters; rate: g'."""

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
        t, unit, columns = state.t, np.zeros(self.whole.m), slice(None)
        unit[self.law.row] = c
        if self.gap:
            taped = TapedModel(self.whole, Tape())
            taped.add_entry(t, state.q, mu=unit)
            of_q, of_v, entries = unit @ self.whole.phi_q(t, state.q), np.zeros(len(state.q)), taped.entries
        elif self.of_rate:
            of_q, of_v, entries = pulled_back(self.whole, state, lambda model, q, v: (model.phi_rate(t, q, v),), (unit,))
        else:
            columns = self.mode.columns
            bars = None, c * self._weights(state)[columns]
            of_q, of_v, entries = pulled_back(self.mode, state, lambda model, q, v: consistent_acceleration(model, t, q, v), bars)
        return of_q, of_v, spread(entries, columns, self.whole.m)


class _UserFunction:
    """The function of a user's event, by differences; it does not depend on parameters."""

    def __init__(self, happenings, event, mode, state):
        self.happenings, self.event, self.mode, self.state = happenings, event, mode, state
        n, at = len(state.q), self._at
        after, happenings.mode = happenings.mode, mode
        self.q = jacobian(lambda q: at(state.t, q, state.v), state.q, 1)[0]
        self.v = jacobian(lambda v: at(state.t, state.q, v), state.v, 1)[0]
        self.of_time = float(along(lambda s: at(state.t + s, state.q, state.v))[0])
        slope = lambda q: jacobian(lambda x: at(state.t, x, state.v), q, 1)[0]  # noqa: E731
        self.q_q = jacobian(slope, state.q, n)
        happenings.mode = after

    def _at(self, t, q, v):
        return np.array([self.happenings.value(self.event, replace(self.state, t=t, q=q, v=v))])

    def rate(self, state):
        return float(self.q @ state.v + self.v @ state.a) + self.of_time

    def back(self, state, c):
        return c * self.q, c * self.v, []

    def push(self, model, t, q, v, factor):
        """The jump `-factor (g_q v + g_t)/(g_q y) y` of velocities, `y = M^-1 g_q^T` with the rows closed; maybe on a tape."""
        slope = self.q
        if isinstance(model, TapedModel):
            slope = model.tape.record([self.q], lambda bar: add_to(q, self.q_q.T @ bar))[0]
        y = model.mass_system(t, q).solve(-1.0 * slope, np.zeros(model.m))[0]
        if not isinstance(model, TapedModel):
            return -factor * (self.q @ v + self.of_time) / (self.q @ y) * y
        rate, size = float(self.q @ v.value) + self.of_time, float(self.q @ y.value)

        def back(bar):
            along_y = float(bar @ y.value)
            add_to(v, -factor * along_y / size * self.q)
            add_to(slope, -factor * along_y / size * (v.value - rate / size * y.value))
            add_to(y, -factor * rate / size * (bar - along_y / size * self.q))

        return model.tape.record([-factor * rate / size * y.value], back)[0]


def spread(entries, columns, m):
    """AdjointMultipliers with multipliers of all m rows, from those of some."""
    return [one._replace(**{name: _wide(getattr(one, name), columns, m) for name in ("lam", "mu", "kappa", "nu")}) for one in entries]


def _wide(x, columns, m):
    if x is None:
        return None
    wide = np.zeros((*np.shape(x)[:-1], m))
    wide[..., columns] = x
    return wide


class _ModeTotals:
    """The Totals of the whole model, for the sweep over one of its modes."""

    def __init__(self, totals, mode, m):
        self.totals, self.mode, self.m = totals, mode, m

    def prepare(self, works):
        """Nothing: `add` gives the whole model others."""

    def add(self, multipliers):
        wide = spread([multipliers], self.mode.columns, self.m)[0]
        if isinstance(self.mode, Slips):
            wide = wide._replace(lam=np.array([self.mode.spread(lam, self.m) for lam in multipliers.lam]))
        self.totals.add(wide)

    def add_own(self, own):
        self.totals.add_own(own)


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
                rate = rate if slope is not own.lam else _wide(rate, self.columns, slope.shape[1])
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
    each = [_Backward(objective, totals.empty(), whole, runs, firsts, motions.modes) for objective in objectives]
    for k in reversed(range(len(runs))):
        mode, one = motions.modes[k], replace(runs[k], plan=runs[k].plan | {"began": "start"})
        parts = [backward.part(k) for backward in each]
        sweeps = kind(one, parts[0], [], memory_limit).with_others(one, parts[1:])
        for backward, sweep in zip(each, sweeps):
            sweep.counts = counts
            sweep.totals = sweep.objective_slopes.totals = _ModeTotals(backward.totals, mode, m)
        state = stored_state(sweeps[0].history, 0)
        for backward, sweep, ends in zip(each, sweeps, together(sweeps, progress)):
            ends = sweep.start_bars(ends)
            if k:
                before, by_time = _start_bars(mode, state, ends, sweep.totals), _time_slope(backward.by_times, runs, k)
                backward.bars = _through(motions.jumps[k - 1], before, by_time, backward.totals, m)
            elif with_v0:
                v0, entries = sweep._start(state, ends)
                if entries:
                    sweep.totals.add(stacked(entries))
                backward.totals.add_start(state, v0, mode)
    return [Gradient(backward.value, backward.totals.slopes(), counts, totals.left_out) for backward in each]


class _Backward:
    """An objective on its way back through the motions. bars: of the last state of the motion that is next, None for the last motion."""

    def __init__(self, objective, totals, whole, runs, firsts, modes):
        slopes = objective.slopes(whole)
        self.value = float(slopes.value if hasattr(slopes, "value") else objective(whole))
        self.totals, self.bars = totals, None
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


def _through(jump, bars, by_time, totals, m):
    """Bars of q and v before a jump from those behind it."""
    before, after, (q_bar, v_bar), R_t = jump.before, jump.after, bars, 0.0
    if jump.reset is not None:
        results = lambda model, q, v: (q, jump.reset(model, before.t, q, v))  # noqa: E731
        q_bar, v_bar, entries = pulled_back(jump.model, before, results, bars)
        if entries:
            totals.add(stacked(spread(entries, jump.model.columns, m)))
        if jump.model.needs.driven:
            R_t = along(lambda s: jump.reset(jump.model, before.t + s, before.q, before.v)) @ bars[1]
    f = consistent_acceleration(jump.modes[0], before.t, before.q, before.v)[0]
    along_motion = q_bar @ before.v + v_bar @ f + R_t - bars[0] @ after.v - bars[1] @ after.a
    c = -(along_motion + by_time) / jump.function.rate(replace(before, a=f))
    of_q, of_v, entries = jump.function.back(before, c)
    if entries:
        totals.add(stacked(entries))
    return q_bar + of_q, v_bar + of_v
