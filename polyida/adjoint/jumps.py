"""Gradients of runs with located events: adjoints of the motions between them, and of the jumps of their slopes.

The run is solved once more to find its modes. Between two events it is a run of one mode, solved from the state behind the first to the
time of the second, whose adjoint is that of its integrator. With z = (q, v), z' = f, the reset `z+ = R(z-)` and the function g of the
event, whose zero is its time, `dz+ = (R_z + (f+ - R_z f-) g_z / (g_z . f-)) dz-` (saltation matrix). Backward, b being the adjoint of z+
and T the objective's slope in the time of the event:

    c = -(b . (R_z f- - f+) + T) / g',    adjoint of z- = R_z^T b + c g_z,    dJ/dp += b . R_p + c g_p

The states of a motion stretch evenly between two events, as those between kinks that a parameter moves.

Leine, Nijmeijer, Dynamics and Bifurcations of Non-Smooth Mechanical Systems (2004), chapter 7.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from polyida.adjoint.event_motions import Motions, solved_motions
from polyida.adjoint.history import stored_state
from polyida.adjoint.mode_totals import TotalsOfModes, wide
from polyida.adjoint.parameter import stacked
from polyida.adjoint.resets import pulled_through, rate_behind
from polyida.adjoint.run import Gradient, Totals, together
from polyida.adjoint.taped import pulled_back
from polyida.errors import InputError
from polyida.event import Events
from polyida.integrate.start import consistent_acceleration
from polyida.integrate.state import Counts
from polyida.objective.objective import Slopes, slopes_at

TIME_STEPPING = "time steps pass impacts without locating them, so that slopes of their states are wrong"


class _Part:
    """The slopes of an objective in the frames of one motion, with the adjoints of its last state from the motion behind.

    It is used like an objective.
    """

    value = 0.0

    def __init__(self, slopes, first, count, columns):
        """Take the Slopes of the run; first, count: of the motion's frames; columns: its multipliers among those of the run."""
        self.of_run, self.first, self.count, self.columns = slopes, first, count, columns
        self.end = None

    def slopes(self, run):
        """The part itself: it gives the Slopes of slices of frames."""
        return self

    def __call__(self, part):
        """The Slopes of a slice of the motion's frames, with the adjoints at its end."""
        begin, stop, _ = part.indices(self.count)
        own = self.of_run(slice(self.first + begin, self.first + stop))
        own = own if own.lam is None else replace(own, lam=own.lam[:, self.columns])
        if self.end is None or stop < self.count:
            return own
        adjoints = [np.zeros((stop - begin, len(x))) for x in self.end]
        for rows, x in zip(adjoints, self.end):
            rows[-1] = x
        return own.plus(Slopes(q=adjoints[0], v=adjoints[1]))

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
    motions = Motions(run)
    runs, m = solved_motions(run, motions), motions.happenings.width
    firsts = np.cumsum([0, *(len(one) for one in runs)])
    whole, with_v0, counts = _joined(run, runs, motions, firsts, m), run.plan.get("began") != "state", Counts()
    totals = Totals(run.model, names, with_v0)
    for name, parameter in list(totals.parameters.items()):
        if parameter.kinks(float(run.t[0]), float(run.t[-1])):
            totals.leave_out(name, "it moves kinks of a run with events, for which there is no adjoint")
    modes = TotalsOfModes(totals, motions, m)
    modes.exclude_at_start(motions.modes[0], motions.starts[0], not with_v0)
    each = [_Backward(objective, totals.empty(), whole, runs, firsts, motions.modes) for objective in objectives]
    for k in reversed(range(len(runs))):
        mode, parts = motions.modes[k], [backward.part(k) for backward in each]
        of_motion = replace(runs[k], plan=runs[k].plan | {"began": "start"})
        sweeps = kind(of_motion, parts[0], [], memory_limit).with_others(of_motion, parts[1:])
        for backward, sweep in zip(each, sweeps):
            sweep.counts = counts
            sweep.totals = sweep.objective_slopes.totals = modes.of(mode, backward.totals, backward.held)
        state = stored_state(sweeps[0].history, 0)
        for backward, sweep, adjoints in zip(each, sweeps, together(sweeps, progress)):
            adjoints = sweep.start_adjoints(adjoints)
            if k:
                before, by_time = _start_adjoints(mode, state, adjoints, sweep.totals), _time_slope(backward.by_times, runs, k)
                backward.adjoints = _through(motions.jumps[k - 1], before, by_time, backward, modes)
            elif with_v0:
                v0, entries = sweep._start(state, adjoints)
                if entries:
                    sweep.totals.add(stacked(entries))
                backward.totals.add_start(state, v0, mode)
    return [Gradient(backward.value, backward.totals.slopes(), counts, totals.left_out) for backward in each]


class _Backward:
    """An objective on its way back through the motions.

    adjoints: of the last state of the motion that is next, None for the last motion. held: of TotalsOfModes.
    """

    def __init__(self, objective, totals, whole, runs, firsts, modes):
        """Divide the slopes of the objective into those of the motions."""
        slopes = objective.slopes(whole)
        self.value = float(slopes.value if hasattr(slopes, "value") else objective(whole))
        self.totals = totals
        self.adjoints = None
        self.held = {}
        checked = partial(slopes_at, objective, slopes, whole)
        self.parts = [_Part(checked, first, len(one), mode.columns) for first, one, mode in zip(firsts, runs, modes)]
        self.by_times = [part.by_time(one) for part, one in zip(self.parts, runs)]

    def part(self, k):
        """The _Part of motion k with these adjoints."""
        self.parts[k].end = self.adjoints
        return self.parts[k]


def _joined(run, runs, motions, firsts, m):
    """The run with the frames of its motions."""
    lam = np.concatenate([[mode.spread(x, m) for x in one.lam] for mode, one in zip(motions.modes, runs)])
    arrays = {name: np.concatenate([getattr(one, name) for one in runs]) for name in ("t", "q", "v", "a")}
    old, frames = run.events, {jump.before.t: int(first) for jump, first in zip(motions.jumps, firsts[1:])}
    happened = [replace(one, frame=frames[one.t]) for one in motions.happenings.happened if one.t in frames]
    events = Events(happened, old.first, motions.happenings.happened.models, True)
    return replace(run, **arrays, lam=lam, events=events)


def _start_adjoints(mode, state, adjoints, totals):
    """Adjoints of q and v of the first state of a motion, whose a and lam are consistent."""
    results = lambda model, q, v: (q, v, *consistent_acceleration(model, state.t, q, v))  # noqa: E731
    of_q, of_v, entries = pulled_back(mode, state, results, adjoints)
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


def _through(jump, adjoints, by_time, backward, modes):
    """Adjoints of q and v before a jump from those behind it."""
    before, after = jump.before, jump.after
    state = replace(before, a=consistent_acceleration(jump.modes[0], before.t, before.q, before.v)[0])
    rates, all_adjoints, entries = np.concatenate([state.v, state.a]), list(adjoints), []
    q_adjoint, v_adjoint = adjoints
    if jump.resets:
        rates = rate_behind(jump.resets, state)
        all_adjoints, q_adjoint, v_adjoint, entries = _through_resets(jump.resets, state, adjoints, backward, modes)
    rate = jump.function.rate(state)
    if not abs(rate) > 0.0:
        raise InputError(f"gradient: the function of the event at t = {before.t:.9g} s is at rest there, so that its time has no slope")
    c = -(np.concatenate(all_adjoints) @ rates - adjoints[0] @ after.v - adjoints[1] @ after.a + by_time) / rate
    of_q, of_v, model, of_function = jump.function.back(before, c)
    if jump.seen:
        modes.add_seen(jump.modes[0], backward.totals, lambda model: jump.seen.weighed(model, state, all_adjoints, c))
    for mode, of_mode in (*entries, (model, of_function)):
        if of_mode:
            modes.of(mode, backward.totals, backward.held).add(stacked(of_mode))
    for key in [key for key in backward.held if key[1] == before.t]:  # in the adjoints of q and v now
        del backward.held[key]
    return q_adjoint + of_q, v_adjoint + of_v


def _through_resets(resets, state, adjoints, backward, modes):
    """(adjoints of all that the resets give, adjoint of q, adjoint of v, entries for parameters) before resets, from the adjoints of (q, v)
    behind them.

    A reset that adds a joint also gives the position that this holds on to. The resets depend on the positions of those before, so that
    their adjoints are found one after the other.
    """
    holding, none, entries = [[(name, state.t) for name in reset.held] for reset in resets if reset.held], np.zeros(len(state.q)), []
    for _ in range(len(holding) + 1):
        held = {key: backward.held.get(key, none) + slope for key, slope in modes.in_places(entries, backward.held).items()}
        of_places = [sum((held[key] for key in keys if key in held), none) for keys in holding]
        q_adjoint, v_adjoint, entries = pulled_through(resets, state, [*adjoints, *of_places])
    return [*adjoints, *of_places], q_adjoint, v_adjoint, entries
