"""Gradients of runs with located events: adjoints of the motions between them, and of the jumps of their slopes.

The run is solved once more to find its modes. Between two events it is a run of one mode, solved from the state behind the first to the
time of the second, whose adjoint is that of its integrator. With z = (q, v), z' = f, the reset `z+ = R(z-)` and the function g of the
event, whose zero is its time, `dz+ = (R_z + (f+ - R_z f-) g_z / (g_z . f-)) dz-` (saltation matrix). Backward, b (in the code: `adjoints`)
being the adjoint of z+, T (`by_time`) the objective's slope in the time of the event, and g' (`rate`) the derivative of g in time:

    c = -(b . (R_z f- - f+) + T) / g',    adjoint of z- = R_z^T b + c g_z,    dJ/dp += b . R_p + c g_p

The states of a motion stretch evenly between two events, as those between kinks that a parameter moves.

Leine, Nijmeijer, Dynamics and Bifurcations of Non-Smooth Mechanical Systems (2004), chapter 7.
"""

from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from polyida.adjoint.event_motions import Jump, Motions, solved_motions
from polyida.adjoint.history import stored_state
from polyida.adjoint.mode_totals import TotalsOfModes, of_all_rows
from polyida.adjoint.parameter import stacked
from polyida.adjoint.resets import pulled_through, rate_behind
from polyida.adjoint.run import Gradient, Totals, together
from polyida.adjoint.taped import pulled_back
from polyida.errors import InputError
from polyida.event import Events
from polyida.integrate.start import consistent_acceleration
from polyida.integrate.state import Counts, State
from polyida.objective.objective import Slopes, slopes_at

TIME_STEPPING = "time steps pass impacts without locating them, so that slopes of their states are wrong"


class _Motion(NamedTuple):
    """A motion between two events, as a run of one mode."""

    mode: Any  # its model
    run: Any  # its Trajectory
    first: int  # number of its first frame among those of all motions
    start: State  # its first State
    jump_before: Jump | None  # the event with which it begins; None: the start of the run


class _SlopesOfMotion:
    """The slopes of an objective J in the frames of one motion, which is used like an objective.

    end: adjoints (q, v) of the last state of the motion, from the motion after it; None for the last motion.
    """

    value = 0.0

    def __init__(self, slopes, motion):
        """Take the function of a slice of the run's frames that gives their Slopes, and the _Motion."""
        self.of_run = slopes
        self.first = motion.first
        self.count = len(motion.run)
        self.columns = motion.mode.columns  # its multipliers among those of the run
        self.end = None

    def slopes(self, run):
        """The object itself: when it is called, it gives the Slopes of slices of frames."""
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
                rate = rate if slope is not own.lam else of_all_rows(rate, self.columns, slope.shape[1])
                total += np.sum(slope * rate, axis=1)
        return total


def gradients_of_events(kind, run, objectives, names, memory_limit, progress):
    """The Gradient of each objective of a run with located events. kind: the RunAdjoint of its integrator."""
    if run.status == "stopped":
        raise InputError("gradient: the run ended at an event or by `until`, whose time has no slope; solve to a time of its own")
    solved = Motions(run)
    width = solved.handler.width
    motions = _motions(run, solved)
    whole = _joined(run, motions, width, solved.handler.happened)
    with_v0, counts = run.plan.get("began") != "state", Counts()
    totals = Totals(run.model, names, with_v0)
    for name, parameter in list(totals.parameters.items()):
        if parameter.kinks(float(run.t[0]), float(run.t[-1])):
            totals.leave_out(name, "it moves kinks of a run with events, for which there is no adjoint")
    modes = TotalsOfModes(totals, solved, width)
    modes.exclude_at_start(motions[0].mode, motions[0].start, not with_v0)
    each = [_Backward(objective, totals.empty(), whole, motions) for objective in objectives]
    for k in reversed(range(len(motions))):
        motion = motions[k]
        for backward, sweep, state, adjoints in _swept(kind, motion, k, each, modes, counts, memory_limit, progress):
            if k:
                before = _start_adjoints(motion.mode, state, adjoints, sweep.totals)
                backward.adjoints = _through(motion.jump_before, before, _time_slope(backward.by_times, motions, k), backward, modes)
            elif with_v0:
                v0, entries = sweep._start(state, adjoints)
                if entries:
                    sweep.totals.add(stacked(entries))
                backward.totals.add_start(state, v0, motion.mode)
    return [Gradient(backward.value, backward.totals.slopes(), counts, totals.left_out) for backward in each]


def _motions(run, solved):
    """[_Motion] of a run, each solved again. solved: its Motions."""
    runs = solved_motions(run, solved)
    firsts = np.cumsum([0, *(len(one) for one in runs)])[:-1]
    return [_Motion(*each) for each in zip(solved.modes, runs, firsts, solved.starts, [None, *solved.jumps])]


def _swept(kind, motion, k, each, modes, counts, memory_limit, progress):
    """Sweep back through motion k for all objectives: [(its _Backward, its sweep, first State, adjoints of q, v, a and lam there)]."""
    slopes = [backward.slopes_of(k) for backward in each]
    of_motion = replace(motion.run, plan=motion.run.plan | {"began": "start"})
    sweeps = kind(of_motion, slopes[0], [], memory_limit).with_others(of_motion, slopes[1:])
    for backward, sweep in zip(each, sweeps):
        sweep.counts = counts
        sweep.totals = sweep.objective_slopes.totals = modes.of(motion.mode, backward.totals, backward.held)
    state = stored_state(sweeps[0].history, 0)
    for backward, sweep, adjoints in zip(each, sweeps, together(sweeps, progress)):
        yield backward, sweep, state, sweep.start_adjoints(adjoints)


class _Backward:
    """An objective on its way back through the motions."""

    def __init__(self, objective, totals, whole, motions):
        """Divide the slopes of the objective in the run `whole` into those of its motions."""
        slopes = objective.slopes(whole)
        self.value = float(slopes.value if hasattr(slopes, "value") else objective(whole))
        self.totals = totals  # its sums of slopes in the parameters
        self.adjoints = None  # (q, v) of the last state of the motion that is next; None for the last motion
        self.held = {}  # {(joint, time): adjoint of the position that it holds on to}, see TotalsOfModes
        checked = partial(slopes_at, objective, slopes, whole)
        self.slopes = [_SlopesOfMotion(checked, motion) for motion in motions]
        self.by_times = [slopes.by_time(motion.run) for slopes, motion in zip(self.slopes, motions)]

    def slopes_of(self, k):
        """The _SlopesOfMotion of motion k with these adjoints."""
        self.slopes[k].end = self.adjoints
        return self.slopes[k]


def _joined(run, motions, width, again):
    """The run with the frames of its motions, and lam of all rows, (frames, width). again: Events of the run solved again."""
    lam = np.concatenate([[motion.mode.spread(x, width) for x in motion.run.lam] for motion in motions])
    arrays = {name: np.concatenate([getattr(motion.run, name) for motion in motions]) for name in ("t", "q", "v", "a")}
    frames = {motion.jump_before.before.t: int(motion.first) for motion in motions if motion.jump_before}
    happened = [replace(one, frame=frames[one.t]) for one in again if one.t in frames]
    return replace(run, **arrays, lam=lam, events=Events(happened, run.events.first, again.models, True))


def _start_adjoints(mode, state, adjoints, totals):
    """Adjoints of q and v of the first state of a motion, whose a and lam are consistent."""

    def results(model, q, v):
        """(q, v, a, lam) of the state, as they follow from q and v."""
        return q, v, *consistent_acceleration(model, state.t, q, v)

    of_q, of_v, entries = pulled_back(mode, state, results, adjoints)
    if entries:
        totals.add(stacked(entries))
    return of_q, of_v


def _time_slope(by_times, motions, k):
    """The slope of J in the time of the event between motions k - 1 and k, whose frames stretch; by_times: of each motion, (frames,)."""
    result = 0.0
    for number, towards_end in ((k - 1, True), (k, False)):
        t = motions[number].run.t
        share = (t - t[0]) / (t[-1] - t[0])
        result += float(by_times[number] @ (share if towards_end else 1.0 - share))
    return result


def _through(jump, adjoints, by_time, backward, modes):
    """Adjoints of q and v before a jump from those after it; adds the slopes of the jump in the parameters."""
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
    if jump.places:
        modes.add_of_places(jump.modes[0], backward.totals, lambda model: jump.places.weighted_sum(model, state, all_adjoints, c))
    for mode, of_mode in (*entries, (model, of_function)):
        if of_mode:
            modes.of(mode, backward.totals, backward.held).add(stacked(of_mode))
    for key in [key for key in backward.held if key[1] == before.t]:  # in the adjoints of q and v now
        del backward.held[key]
    return q_adjoint + of_q, v_adjoint + of_v


def _through_resets(resets, state, adjoints, backward, modes):
    """(adjoints of all that the resets give, adjoint of q, adjoint of v, entries for parameters) before resets.

    adjoints: of q and v after them.

    A reset that adds a joint also gives the position that this holds on to. The resets depend on the positions of those before, so that
    their adjoints are found one after the other.
    """
    holding = [[(name, state.t) for name in reset.held] for reset in resets if reset.held]
    none = np.zeros(len(state.q))
    entries = []
    of_places = []
    for _ in range(1 + len(holding)):  # a position may depend on those held before it: one pass for each
        held = {key: backward.held.get(key, none) + slope for key, slope in modes.in_places(entries, backward.held).items()}
        of_places = [sum((held[key] for key in keys if key in held), none) for keys in holding]
        q_adjoint, v_adjoint, entries = pulled_through(resets, state, [*adjoints, *of_places])
    return [*adjoints, *of_places], q_adjoint, v_adjoint, entries
