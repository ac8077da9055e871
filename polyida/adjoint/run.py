"""A run backward: what the adjoints of all integrators share, its consistent start, and event times that move with parameters."""

import numpy as np

from polyida.adjoint.history import replayed_state
from polyida.adjoint.parameter import AdjointMultipliers, stacked
from polyida.adjoint.profile_parameters import in_time
from polyida.adjoint.taped import Tape, TapedModel, add_to
from polyida.adjoint.totals import Gradient, OwnSlopes, Totals
from polyida.errors import InputError
from polyida.integrate.discontinuities import edges
from polyida.integrate.sizes import extent
from polyida.integrate.start import consistent_acceleration, on_velocity
from polyida.integrate.state import Counts
from polyida.model.guarded import guard

MOVES = 1e-8  # of the size of the model: by so much a parameter of twice its value moves constraints that it does not change
NEAR = 1e-9  # of |v|: a start's velocity that far from the bodies' own was given


class RunAdjoint:
    """A run backward; a class for each integrator has `history_of(run, model, memory_limit)` and `through(progress)`.

    `through` adds the slopes of all steps to `totals` and returns the bars of q, v, a and lam of the run's first state.
    """

    def __init__(self, run, objective, names, memory_limit):
        self.model, self.settings, self.counts = guard(run.model), run.integrator, Counts()
        self.held = run.plan.get("began") == "state"
        self.history = self.history_of(run, self.model, memory_limit)
        self.totals = Totals(run.model, names, not self.held)
        self.own = OwnSlopes(objective, run, self.history.frames, self.totals)
        self.events = EventTimeSensitivity(self.model, run, self.totals.parameters)
        self._leave_out_of_start(names)

    @staticmethod
    def require_settings(settings):
        """Raise InputError where an integrator of these settings has no adjoint."""

    def gradient(self, progress):
        """The Gradient; progress is called with t."""
        bars, own = self.through(progress), self.own.of(0, 1)
        bars = [bar if slope is None else bar + slope[0] for bar, slope in zip(bars, (own.q, own.v, own.a, own.lam))]
        bars[0] = bars[0] + self.of_first_state()
        if self.events.speeds:
            self.events.add_to(self.totals.sums, self.history)
        if not self.held:
            state = replayed_state(self.history, 0)
            v0, entries = self._start(state, bars)
            self.add(stacked(entries), [], False)
            self.totals.start(state, v0)
        return Gradient(self.own.value, self.totals.slopes(), self.counts, self.totals.left_out)

    def of_first_state(self):
        """The bar of the first q by what the method makes of it for all steps."""
        return 0.0

    def add(self, multipliers, times=None, moving=True):
        """Add up AdjointMultipliers, or None; times: those at which they are, where theirs are just beside."""
        if multipliers is not None:
            self.totals.add(multipliers)
            if moving and self.events.speeds:
                self.events.add(multipliers, times)

    def _start(self, state, bars):
        """(bar of the velocities that the run was given, entries for parameters) of its consistent start (integrate/start.py)."""
        tape = Tape()
        taped = TapedModel(self.model, tape)
        q, v0 = tape.var(state.q), tape.var(given_velocity(self.model, state)[0])
        v = on_velocity(taped, state.t, q, v0)
        for var, bar in zip((q, v, *consistent_acceleration(taped, state.t, q, v)), bars):
            add_to(var, bar)
        tape.back()
        if self.model.m and q.bar.any():
            _, nu = self.model.mass_system(state.t, state.q).solve(q.bar, np.zeros(self.model.m))
            taped.note(state.t, state.q, mu=nu)
        return v0.bar, taped.entries

    def _leave_out_of_start(self, names):
        """Leave out parameters that move the constraints of the state that a run begins with where that is held, or where they change what
        coordinates mean: no run of another value begins there. Raises InputError where they were asked for by name.
        """
        totals, model, state = self.totals, self.model, replayed_state(self.history, 0)
        if not model.m:
            return
        zero, none = np.zeros((1, model.n)), np.zeros((1, model.m))
        mu = np.random.default_rng(0).uniform(1.0, 2.0, none.shape)
        phi = AdjointMultipliers(np.array([state.t]), state.q[None], zero, zero, none, zero, mu)
        for name, parameter in list(totals.parameters.items()):
            if not (self.held or parameter.changes_coordinates):
                continue
            size = float(np.abs(parameter.value).max(initial=0.0)) or 1.0
            if size * np.abs(parameter.slope(phi)).max(initial=0.0) > MOVES * extent(model, state.q):
                why = "it moves the constraints of the state that the run begins with, so that no run of another value begins there"
                if names is not None:
                    raise InputError(f"gradient: {name!r} has no slope: {why}; draw the scene where the run begins")
                del totals.parameters[name], totals.sums[name]
                self.events.speeds.pop(name, None)
                totals.left_out[name] = why


def given_velocity(model, state):
    """(velocities that a run which began with a state was given, whether they are the bodies' own)."""
    given = model.initial_velocity(state.t, state.q)
    consistent = on_velocity(model, state.t, state.q, given)
    own = np.abs(consistent - state.v).max() <= NEAR * max(np.abs(state.v).max(), 1e-300)
    return (given if own else state.v), own


class EventTimeSensitivity:
    """Slopes in parameters that move the kinks of loads and motors, and with them the steps of a run: each segment between kinks is stretched.

    A state's time moves by dt/dp, evenly between the kinks, and steps of a segment by `dh/dp = (dt_end/dp - dt_begin/dp) / count`. The slope at
    fixed times gets `sum dt/dp d/dt (w . r + mu . phi + J)` and what h does in the formulas of the steps. speeds: {name: dt/dp at the ends of
    the segments between kinks}, empty where no parameter moves a kink.
    """

    def __init__(self, model, run, parameters):
        begin, end = float(run.t[0]), float(run.t[-1])
        moving = {name: parameter.kinks(begin, end) for name, parameter in parameters.items()}
        self.model, self.edges = model, np.array(edges(model, begin, end))
        self.speeds = {name: self._speeds(kinks) for name, kinks in moving.items() if kinks}
        self.times, self.slopes, self.stretched = [], [], []

    def _speeds(self, kinks):
        speeds, times = np.zeros(len(self.edges)), np.array(list(kinks))
        for k in range(1, len(self.edges) - 1):
            near = np.abs(times - self.edges[k]) <= 1e-12 * max(1.0, abs(self.edges[k]))
            speeds[k] = sum(np.array(list(kinks.values()))[near])
        return speeds

    def add(self, multipliers, t=None):
        """Entries of AdjointMultipliers, at times t (k,) where theirs are just beside those."""
        self.at(multipliers.t if t is None else t, in_time(self.model, multipliers))

    def at(self, t, slopes):
        """Slopes in times t, (k,) each."""
        self.times.append(t)
        self.slopes.append(slopes)

    def stretch(self, segment, slope, before=0.0):
        """Slopes in h of a segment of the run's history, and of the segment before."""
        self.stretched.append((segment, slope, before))

    def add_to(self, sums, history):
        """Add it all to the sums of the parameters that move kinks."""
        t, slopes = (np.concatenate(parts) if parts else np.zeros(0) for parts in (self.times, self.slopes))
        for name, speeds in self.speeds.items():
            moved = {segment.first: self._change(segment, history, speeds) for segment in history.segments}
            before = dict(zip([segment.first for segment in history.segments[1:]], moved.values()))
            total = slopes @ np.interp(t, self.edges, speeds)
            sums[name] = sums[name] + total + sum(by_h * moved[s.first] + by * before.get(s.first, 0.0) for s, by_h, by in self.stretched)

    def _change(self, segment, history, speeds):
        """dh/dp."""
        ends = [float(history.states(k, k + 1)[0][0]) for k in (segment.first, segment.first + segment.count)]
        return float(np.diff(np.interp(ends, self.edges, speeds))[0]) / segment.count
