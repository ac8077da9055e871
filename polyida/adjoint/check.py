"""Comparison of gradients with differences: the run, equilibrium or modes are computed again with each parameter changed."""

import warnings
from collections.abc import Sequence
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np

from polyida.adjoint.gradient import gradient
from polyida.adjoint.history import step_history, stored_state
from polyida.adjoint.other_places import with_parts_of
from polyida.adjoint.parameters import parameters_of
from polyida.adjoint.radau_history import exact_steps, step_start_state
from polyida.adjoint.radau_history import step_history as radau_history
from polyida.adjoint.run import given_velocity
from polyida.errors import InputError
from polyida.integrate.alpha.start import started
from polyida.integrate.alpha.steps import Steps
from polyida.integrate.discontinuities import Grid, edges, time_limits
from polyida.integrate.radau.radau_iia import RadauIIA
from polyida.integrate.start import VIOLATION, on_velocity, restarted
from polyida.integrate.state import Counts, State
from polyida.integrate.static import Equilibrium, static
from polyida.modal.modes import Modes, modes
from polyida.model.differences import EVERYWHERE, along, central
from polyida.model.guarded import guard
from polyida.run.solve import solve
from polyida.trajectory import Trajectory
from polyida.validation import is_whole, named_keywords

MIN_CHANGE = 1e-3  # of J over the parameter: smaller slopes do not serve as scale of errors
CHANGE = 1e-3  # relative change of a parameter
STEP = CHANGE / 7e-4  # about the same in units of the step of `along`
HELD = 1e-2  # of these changes: where times of switches are held, differences have an error of their square root
# (s, weight) of differences J(s) - J(0): their sum is dJ/ds, without errors of s^2 and s^3
ONE_SIDED = (0.5, 16 / 3), (1.0, -2.0), (2.0, 1 / 6)
TIGHT = 1e-11  # Newton's tolerance of repeated runs
TOLERANCE = 1e-13  # of repeated equilibria
ITERATIONS = 25  # least limit of Newton iterations with this tolerance


@named_keywords
def check_gradient(run: Any, objective: Any, parameters: Sequence[str] | None = None, seed: int = 0) -> dict[str, float]:
    """Return the relative error of `pi.gradient(run, objective)` against differences of fourth order.

    Each parameter is changed by about one and two thousandths of it, up and down, and the run, equilibrium or modes are computed again; an
    array is changed along one random direction. If the parameter moves a kink, J may have a kink too, and the slope is the mean of both
    sides.

    Parameters
    ----------
    run : Trajectory, Equilibrium or Modes
        As for `pi.gradient`.
    objective : Objective
        As for `pi.gradient`.
    parameters : list of str, optional
        As for `pi.gradient`.
    seed : int
        Seed of the random directions.

    Returns
    -------
    errors : dict of str to float
        {name: error}, relative to the difference, or to J over a thousand times the parameter if that is larger.

    Raises
    ------
    InputError
        As `pi.gradient`, and for a seed that is no whole number.

    Notes
    -----
    A run repeats the same steps with a Newton tolerance of 1e-11 or less; its pieces between kinks stretch as the kinks move. Times of
    switches are held, so that parameters change by a hundredth of what they do elsewhere: behind a stiff contact the differences are less
    accurate than the gradient. The error therefore contains that of the run's own tolerance (with adaptive RadauIIA up to 70 rtol for
    PeakStress and PeakReaction), and that of the differences if the motion is strongly nonlinear (1e-4 in a soft plate with large motions).

    A run with located events is solved again as a whole, with its own steps: the error contains that of the method and, with `rtol`, that
    of the steps over 1e-3.

    A parameter that is zero and must not be negative is changed upwards only. Parameters are left out if they move a kink into or out of
    the run (a motor that ends with it), or if they change the constraints at the start.
    """
    if not is_whole(seed, 0):
        raise InputError(f"check_gradient: seed = {seed!r:.80} must be a whole number of at least 0")
    slopes, known = gradient(run, objective, parameters=parameters), parameters_of(run.model)
    of_run = ReplayedRadauRun if isinstance(run, Trajectory) and isinstance(run.integrator, RadauIIA) else ReplayedRun
    of_run = RunWithEvents if isinstance(run, Trajectory) and run.events.given else of_run
    replayed: Any
    objective, replayed = objective.named(run.model), of_run(run) if isinstance(run, Trajectory) else ReplayedState(run)
    random, errors = np.random.default_rng(seed), {}
    change = CHANGE * (HELD if isinstance(replayed, ReplayedRun) and replayed.model.switching else 1.0)
    for name in slopes:
        parameter = None if name == "v0" else known[name]
        direction = _direction(run.v[0] if parameter is None else parameter.value, random)
        if parameter is None or _can_change(replayed, parameter, direction, STEP * change / CHANGE):
            difference = _difference(run, objective, replayed, parameter, direction, change)
            slope = float(np.sum(slopes[name] * direction))
            errors[name] = abs(slope - difference) / max(abs(difference), MIN_CHANGE * abs(slopes.value), 1e-300)
    return errors


def _can_change(replayed, parameter, direction, step):
    """True if runs with all values of the parameter that a difference takes can start."""
    places = [s for s, _ in central(step) if s > parameter.bounds[0]]
    return all(replayed.can_start(parameter.replaced(parameter.value + s * direction)) for s in places)


def _difference(run, objective, replayed, parameter, direction, change):
    """dJ along a direction of a parameter, None for the initial velocities, by runs that are solved again.

    change: relative change of the parameter. If the parameter moves a kink, the mean of the slopes on both sides.
    """

    def value(s):
        """J with the parameter changed by s times the direction."""
        if parameter is None:
            return objective(replayed.frames(run.model, s * direction))
        return objective(replayed.frames(parameter.replaced(parameter.value + s * direction)))

    if parameter is not None and isinstance(run, Trajectory) and parameter.kinks(float(run.t[0]), float(run.t[-1])):
        return sum(weight * (value(s * change) - value(-s * change)) for s, weight in ONE_SIDED) / (2 * change)
    return float(along(value, STEP * change / CHANGE, EVERYWHERE if parameter is None else parameter.bounds))


def _direction(value, random):
    """The direction in which a parameter is changed, of its size: random for an array."""
    size = float(np.abs(value).max()) or 1.0
    return size * random.uniform(-1.0, 1.0, np.shape(value)) if np.ndim(value) else size


def _fits(model, state):
    """True if a state satisfies the constraints of a model."""
    return bool(np.abs(guard(model).phi(state.t, state.q)).max(initial=0.0) <= VIOLATION * max(1.0, np.abs(state.q).max()))


class ReplayedRun:
    """A run of generalized-alpha that is solved again with the steps of its history and a Newton tolerance of 1e-11."""

    history_of = staticmethod(step_history)

    def __init__(self, run):
        """Store the StepHistory of a run, its guarded model, its first State, and the velocity that was given for the start."""
        self.run = run
        self.model = guard(run.model)
        self.history = self.history_of(run, self.model)
        self.state = stored_state(self.history, 0)
        self.given_v, self.by_bodies = given_velocity(self.model, self.state)

    def frames(self, model, change=0.0):
        """The run of another model with frames at the same steps; change: added to its initial velocities."""
        guarded, state = guard(model), self.state
        if self.run.plan.get("began") != "state":
            given_v = self.given_v
            if self.by_bodies:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # that joints change what bodies were given, which the run has told
                    given_v = guarded.initial_velocity(state.t, state.q)
            state = restarted(guarded, replace(state, v=given_v + change))
        states = self._replay(guarded, state, self._times(guarded))
        of_frames = [states[k] for k in np.flatnonzero(self.history.frames >= 0)]
        vectors = {name: np.array([getattr(state, name) for state in of_frames]) for name in ("t", "q", "v", "a", "lam")}
        return replace(self.run, model=model, **vectors)

    def _replay(self, model, state, times):
        """The states of the history, of another model and initial state; times: function of their numbers."""
        settings = self.run.integrator
        tolerance, most = min(TIGHT, settings.tolerance or TIGHT), max(ITERATIONS, settings.max_iterations)
        settings = replace(settings, tolerance=tolerance, max_iterations=most)
        states, engine = [state], Steps(settings, model, Counts())
        for segment in self.history.segments:
            grid, state = Grid(times(segment.first), times(segment.first + segment.count), segment.count), states[-1]
            state = state if segment.kind == "on" else replace(state, memory=segment.memory(None))
            engine.begin(started(settings, model, state, grid.h), grid.h)
            states += chain.from_iterable(engine.run(grid))
        return states

    def can_start(self, model):
        """True if a run of another model can start from the same state and has as many kinks."""
        return _fits(model, self.state) and len(self._edges(model)) == len(self._edges(self.model))

    def _times(self, model):
        """A function of the number of a state: its time, which moves linearly with the kinks around it."""
        own, others = self._edges(self.model), self._edges(model)
        return lambda k: float(np.interp(self.history.states(k, k + 1)[0][0], own, others))

    def _edges(self, model):
        """Sorted times that bound the segments of the run: start, kinks and samples of `model`, end."""
        return list(edges(model, float(self.run.t[0]), float(self.run.t[-1])))


class RunWithEvents:
    """A run with located events that is solved again; its events take the parts of the other model."""

    def __init__(self, run):
        """Read the first state of the run and its initial velocities."""
        first = self._equations(run, run.model)
        self.run = run
        self.state = State(float(run.t[0]), run.q[0], run.v[0], run.a[0], run.lam[0])
        self.given_v, self.by_bodies = given_velocity(first, self.state)

    @staticmethod
    def _equations(run, model):
        """The equations of a model that hold at the start of the run."""
        first = guard(run.events.modes(guard(model), 0)[0])
        laws = [law.row for law in first.row_laws]
        return first.with_rows(np.setdiff1d(np.arange(first.m), laws)) if laws else first

    def frames(self, model, change=0.0):
        """The run of another model; change: added to its initial velocities."""
        run, state, first = self.run, self.state, self._equations(self.run, model)
        events = [with_parts_of(event, run.model, model) for event in run.events.causes or ()]
        if run.plan.get("began") == "state":
            return solve(model, run.plan["t_end"], run.integrator, events=events, state=state)
        v0 = first.initial_velocity(state.t, state.q) if self.by_bodies else self.given_v
        v0 = on_velocity(first, state.t, state.q, v0 + change)
        return solve(model, run.plan["t_end"], run.integrator, events=events, t0=state.t, q0=state.q, v0=v0)

    def can_start(self, model):
        """True if a run of another model can start from the same state."""
        return _fits(self._equations(self.run, model), self.state)


class ReplayedRadauRun(ReplayedRun):
    """A run of Radau IIA that is solved again, each step to round-off."""

    history_of = staticmethod(radau_history)

    def _replay(self, model, state, times):
        """The states of the run of another model and initial state; times: function of their numbers."""
        states, engine = [state], exact_steps(model, self.run.integrator, state, float(self.run.t[-1]), Counts())
        for k in range(1, len(self.history.frames)):
            state, t = step_start_state(model, states[-1]), times(k)
            engine.limits = time_limits(model, state.t, t)
            states.append(engine.step(state, t - state.t, t))
        return states


class ReplayedState:
    """An Equilibrium, or Modes, that is computed again; state: the equilibrium, or the state of the modes."""

    def __init__(self, subject):
        """Take the Equilibrium or the Modes that is computed again."""
        self.subject = subject
        self.state = subject.state if isinstance(subject, Modes) else subject

    def frames(self, model):
        """The result for another model: from the same initial guess, or modes about the same state if it is no equilibrium."""
        state = self.state
        if isinstance(state, Equilibrium):
            state = static(model, state.t, state.q, tolerance=TOLERANCE, linear=state.linear)
        return modes(model, state, count=len(self.subject.roots)) if isinstance(self.subject, Modes) else state

    def can_start(self, model):
        """True if the constraints of another model hold at a fixed state too."""
        return isinstance(self.state, Equilibrium) or _fits(model, self.state)
