"""The part of the backward sweep that all integrators share: consistent start, and event times that depend on parameters."""

import numpy as np

from polyida.adjoint.history import stored_state
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

MOVES = 1e-8  # of the model's size: a parameter moves constraints if doubling it moves them by more
NEAR = 1e-9  # of |v|: an initial velocity farther from the bodies' own was given by the user


class RunAdjoint:
    """Base of the backward sweep over a run; the class of an integrator has `history_of(run, model, memory_limit)` and `sweep_backward(progress)`.

    `sweep_backward` adds the slopes of all steps to `totals` and returns the bars of q, v, a and lam of the run's first state. start_is_given:
    True if the run starts from a given state, which is held constant.
    """

    def __init__(self, run, objective, names, memory_limit):
        self.model, self.settings, self.counts = guard(run.model), run.integrator, Counts()
        self.start_is_given = run.plan.get("began") == "state"
        self.history = self.history_of(run, self.model, memory_limit)
        self.totals = Totals(run.model, names, not self.start_is_given)
        self.objective_slopes = OwnSlopes(objective, run, self.history.frames, self.totals)
        self.events = EventTimeSensitivity(self.model, run, self.totals.parameters)
        self._exclude_start_parameters(names)

    @staticmethod
    def require_settings(settings):
        """Raise InputError if the integrator has no adjoint with these settings."""

    def gradient(self, progress):
        """The Gradient; progress is called with t."""
        bars, own = self.sweep_backward(progress), self.objective_slopes.at_states(0, 1)
        bars = [bar if slope is None else bar + slope[0] for bar, slope in zip(bars, (own.q, own.v, own.a, own.lam))]
        bars[0] = bars[0] + self.first_state_bar()
        if self.events.speeds:
            self.events.add_to(self.totals.sums, self.history)
        if not self.start_is_given:
            state = stored_state(self.history, 0)
            v0, entries = self._start(state, bars)
            self.add(stacked(entries), [], False)
            self.totals.add_start(state, v0)
        return Gradient(self.objective_slopes.value, self.totals.slopes(), self.counts, self.totals.left_out)

    def first_state_bar(self):
        """The bar of the first q by quantities that the method evaluates once at the start."""
        return 0.0

    def add(self, multipliers, times=None, moving=True):
        """Add AdjointMultipliers, or None; times: the states' times if those of the multipliers lie just beside them."""
        if multipliers is not None:
            self.totals.add(multipliers)
            if moving and self.events.speeds:
                self.events.add(multipliers, times)

    def _start(self, state, bars):
        """(bar of the given initial velocities, entries for parameters) of the consistent start (integrate/start.py)."""
        tape = Tape()
        taped = TapedModel(self.model, tape)
        q, v0 = tape.var(state.q), tape.var(given_velocity(self.model, state)[0])
        v = on_velocity(taped, state.t, q, v0)
        for var, bar in zip((q, v, *consistent_acceleration(taped, state.t, q, v)), bars):
            add_to(var, bar)
        tape.back()
        if self.model.m and q.bar.any():
            _, nu = self.model.mass_system(state.t, state.q).solve(q.bar, np.zeros(self.model.m))
            taped.add_entry(state.t, state.q, mu=nu)
        return v0.bar, taped.entries

    def _exclude_start_parameters(self, names):
        """Exclude parameters that move the constraints at a given initial state or change the meaning of coordinates: no run of another value
        starts there. Raises InputError if they were requested by name.
        """
        totals, model, state = self.totals, self.model, stored_state(self.history, 0)
        if not model.m:
            return
        zero, none = np.zeros((1, model.n)), np.zeros((1, model.m))
        mu = np.random.default_rng(0).uniform(1.0, 2.0, none.shape)
        phi = AdjointMultipliers(np.array([state.t]), state.q[None], zero, zero, none, zero, mu)
        for name, parameter in list(totals.parameters.items()):
            if not (self.start_is_given or parameter.changes_coordinates):
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
    """(initial velocities that the run was given, True if they are the bodies' own)."""
    given = model.initial_velocity(state.t, state.q)
    consistent = on_velocity(model, state.t, state.q, given)
    own = np.abs(consistent - state.v).max() <= NEAR * max(np.abs(state.v).max(), 1e-300)
    return (given if own else state.v), own


class EventTimeSensitivity:
    """Slopes in parameters that move kinks of loads and motors, and with them the steps: each segment between two kinks stretches.

    The time of a state moves by dt/dp, linearly between kinks, and the steps of a segment change by `dh/dp = (dt_end/dp - dt_begin/dp) / count`.
    To the slope at fixed times is added `sum dt/dp d/dt (w . r + mu . phi + J)` and the effect of h in the formulas of the steps. speeds: {name:
    dt/dp at the ends of the segments between kinks}, empty if no parameter moves a kink.
    """

    def __init__(self, model, run, parameters):
        begin, end = float(run.t[0]), float(run.t[-1])
        moving = {name: parameter.kinks(begin, end) for name, parameter in parameters.items()}
        self.model, self.edges = model, np.array(edges(model, begin, end))
        self.speeds = {name: self._speeds(kinks) for name, kinks in moving.items() if kinks}
        self.times, self.slopes, self.step_slopes = [], [], []

    def _speeds(self, kinks):
        speeds, times = np.zeros(len(self.edges)), np.array(list(kinks))
        for k in range(1, len(self.edges) - 1):
            near = np.abs(times - self.edges[k]) <= 1e-12 * max(1.0, abs(self.edges[k]))
            speeds[k] = sum(np.array(list(kinks.values()))[near])
        return speeds

    def add(self, multipliers, t=None):
        """Add the slopes of AdjointMultipliers in their times; t (k,): the states' times if those lie just beside them."""
        self.add_at(multipliers.t if t is None else t, in_time(self.model, multipliers))

    def add_at(self, t, slopes):
        """Add slopes in the times t, (k,) each."""
        self.times.append(t)
        self.slopes.append(slopes)

    def add_step_slope(self, segment, slope, before=0.0):
        """Add the slope in h of a segment of the history, and in h of the segment before."""
        self.step_slopes.append((segment, slope, before))

    def add_to(self, sums, history):
        """Add all slopes to the sums of the parameters that move kinks."""
        t, slopes = (np.concatenate(parts) if parts else np.zeros(0) for parts in (self.times, self.slopes))
        for name, speeds in self.speeds.items():
            moved = {segment.first: self._change(segment, history, speeds) for segment in history.segments}
            before = dict(zip([segment.first for segment in history.segments[1:]], moved.values()))
            total = slopes @ np.interp(t, self.edges, speeds)
            sums[name] = sums[name] + total + sum(by_h * moved[s.first] + by * before.get(s.first, 0.0) for s, by_h, by in self.step_slopes)

    def _change(self, segment, history, speeds):
        """dh/dp of a segment."""
        ends = [float(history.states(k, k + 1)[0][0]) for k in (segment.first, segment.first + segment.count)]
        return float(np.diff(np.interp(ends, self.edges, speeds))[0]) / segment.count
