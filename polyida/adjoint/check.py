"""Comparison of gradients with differences: the run, equilibrium or modes are computed again with each parameter changed."""

import warnings
from collections.abc import Sequence
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np

from polyida.adjoint.gradient import gradient
from polyida.adjoint.history import replayed_state, step_history
from polyida.adjoint.parameters import parameters_of
from polyida.adjoint.radau import begun, exact_steps, within
from polyida.adjoint.radau import step_history as radau_history
from polyida.adjoint.run import given_velocity
from polyida.errors import InputError
from polyida.integrate.alpha.start import started
from polyida.integrate.alpha.steps import Steps
from polyida.integrate.discontinuities import Grid, edges
from polyida.integrate.radau.radau_iia import RadauIIA
from polyida.integrate.start import VIOLATION, restarted
from polyida.integrate.state import Counts
from polyida.integrate.static import Equilibrium, static
from polyida.modal.modes import Modes, modes
from polyida.model.differences import EVERYWHERE, along, central
from polyida.model.guarded import guard
from polyida.trajectory import Trajectory
from polyida.validation import is_whole, named_keywords

LITTLE = 1e-3  # of J: what J changes by with a whole parameter, below which that is no measure of errors
STEP = 1e-3 / 7e-4  # of a parameter: about a thousandth between the runs, in units of what `along` takes
TIGHT = 1e-11  # Newton's tolerance in runs that are taken again
TOLERANCE = 1e-13  # of that of equilibria
ITERATIONS = 25  # of Newton's method, at least, that so tight a tolerance may take


@named_keywords
def check_gradient(run: Any, objective: Any, parameters: Sequence[str] | None = None, seed: int = 0) -> dict[str, float]:
    """Return the relative error of `pi.gradient(run, objective)` against differences of fourth order.

    Each parameter is changed by about one and two thousandths of it, up and down, and the run, equilibrium or modes are computed again; an
    array is changed along one random direction.

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
    A run repeats the same steps with a Newton tolerance of 1e-11 or less; its pieces between kinks stretch as the kinks move. Times of switches
    are held: behind a stiff contact the differences are less accurate than the gradient. The error therefore contains that of the run's own
    tolerance (with adaptive RadauIIA up to 70 rtol for PeakStress and PeakReaction), and that of the differences if the motion is strongly
    nonlinear (1e-4 in a soft plate with large motions).

    A parameter that is zero and must not be negative is changed upwards only. Parameters are left out if they move a kink into or out of the
    run (a motor that ends with it), or if they change the constraints at the start.
    """
    if not is_whole(seed, 0):
        raise InputError(f"check_gradient: seed = {seed!r:.80} must be a whole number of at least 0")
    found, known = gradient(run, objective, parameters=parameters), parameters_of(run.model)
    of_run = ReplayedRadauRun if isinstance(run, Trajectory) and isinstance(run.integrator, RadauIIA) else ReplayedRun
    again: Any
    objective, again = objective.named(run.model), of_run(run) if isinstance(run, Trajectory) else ReplayedState(run)
    random, errors = np.random.default_rng(seed), {}
    for name in found:
        if name == "v0":
            way, made, room = _way(run.v[0], random), lambda change: again.frames(run.model, change), EVERYWHERE
        else:
            parameter, way = known[name], _way(known[name].value, random)
            made = lambda change, p=parameter: again.frames(p.replaced(p.value + change))  # noqa: E731
            room = parameter.room
            if not all(again.begins(parameter.replaced(parameter.value + s * way)) for s, _ in central(STEP) if s > room[0]):
                continue
        errors[name] = _error(found, name, way, lambda s, way=way, made=made: objective(made(s * way)), room)
    return errors


def _way(value, random):
    """A direction in which a parameter is changed, of its size."""
    size = float(np.abs(value).max()) or 1.0
    return size * random.uniform(-1.0, 1.0, np.shape(value)) if np.ndim(value) else size


def _error(found, name, way, objective, room):
    slope = float(np.sum(found[name] * way))
    difference = float(along(objective, STEP, room))
    return abs(slope - difference) / max(abs(difference), LITTLE * abs(found.value), 1e-300)


class ReplayedRun:
    """A run of generalized-alpha, to be taken again by the steps of its history, at a Newton's tolerance of 1e-11."""

    history_of = staticmethod(step_history)

    def __init__(self, run):
        self.run, self.model = run, guard(run.model)
        self.history = self.history_of(run, self.model)
        self.state = replayed_state(self.history, 0)
        self.given, self.own = given_velocity(self.model, self.state)

    def frames(self, model, moved=0.0):
        """The run of another model, its frames at the same steps; moved: what is added to the velocities that it was given."""
        guarded, state = guard(model), self.state
        if self.run.plan.get("began") != "state":
            given = self.given
            if self.own:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # that joints change what bodies were given, which the run has told
                    given = guarded.initial_velocity(state.t, state.q)
            state = restarted(guarded, replace(state, v=given + moved))
        states = self._taken(guarded, state, self._times(guarded))
        kept = [states[k] for k in np.flatnonzero(self.history.frames >= 0)]
        vectors = {name: np.array([getattr(state, name) for state in kept]) for name in ("t", "q", "v", "a", "lam")}
        return replace(self.run, model=model, **vectors)

    def _taken(self, model, state, times):
        """The states of the history, of another model that begins with a state; times: a function of their numbers."""
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

    def begins(self, model):
        """Whether a run of another model can begin where this one did, and take its steps between as many kinks."""
        phi = guard(model).phi(self.state.t, self.state.q)
        near = np.abs(phi).max(initial=0.0) <= VIOLATION * max(1.0, np.abs(self.state.q).max())
        return bool(near) and len(self._edges(model)) == len(self._edges(self.model))

    def _times(self, model):
        """A function of the number of a state: its time, which moves evenly with the kinks about it."""
        own, others = self._edges(self.model), self._edges(model)
        return lambda k: float(np.interp(self.history.states(k, k + 1)[0][0], own, others))

    def _edges(self, model):
        """The times at which the segments of a run of a model between kinks begin and end."""
        return edges(model, float(self.run.t[0]), float(self.run.t[-1]))


class ReplayedRadauRun(ReplayedRun):
    """A run of Radau IIA, each step solved to round-off."""

    history_of = staticmethod(radau_history)

    def _taken(self, model, state, times):
        states, engine = [state], exact_steps(model, self.run.integrator, state, float(self.run.t[-1]), Counts())
        for k in range(1, len(self.history.frames)):
            state, t = begun(model, states[-1]), times(k)
            engine.limits = within(model, state.t, t)
            states.append(engine.step(state, t - state.t, t))
        return states


class ReplayedState:
    """An Equilibrium, or Modes, to be found again; state: the equilibrium itself, or what the modes are about."""

    def __init__(self, subject):
        self.subject, self.state = subject, subject.state if isinstance(subject, Modes) else subject

    def frames(self, model):
        """What is found of another model: from the same state, or about the same where that is no equilibrium."""
        state = self.state
        if isinstance(state, Equilibrium):
            state = static(model, state.t, state.q, tolerance=TOLERANCE, linear=state.linear)
        return modes(model, state, count=len(self.subject.roots)) if isinstance(self.subject, Modes) else state

    def begins(self, model):
        """Whether a state that is held is one of another model too."""
        if isinstance(self.state, Equilibrium):
            return True
        phi = guard(model).phi(self.state.t, self.state.q)
        return bool(np.abs(phi).max(initial=0.0) <= VIOLATION * max(1.0, np.abs(self.state.q).max()))
