"""A run taken again by the very steps that it took, of its model with a parameter changed: what differences of a run are made of."""

import warnings
from dataclasses import replace
from itertools import chain

import numpy as np

from polyida.adjoint.alpha.forward import given_velocity
from polyida.adjoint.steps.course import course_of
from polyida.integrate.alpha.start import started
from polyida.integrate.alpha.steps import Steps
from polyida.integrate.kinks import Grid, edges
from polyida.integrate.start import VIOLATION, restarted
from polyida.integrate.state import Counts, State
from polyida.model.guarded import guard

TIGHT = 1e-11  # Newton's tolerance
ITERATIONS = 25  # of Newton's method, at least, that so tight a tolerance may take


class Again:
    """A run, to be taken again by the steps of its course, at a Newton's tolerance of 1e-11."""

    course_of = staticmethod(course_of)

    def __init__(self, run):
        self.run, self.model = run, guard(run.model)
        self.course, self.settings = self.course_of(run, self.model), self._exact(run.integrator)
        t, *vectors = (x[0] for x in self.course.states(0, 1))
        self.state = State(float(t), *vectors)
        self.given, self.own = given_velocity(self.model, self.state)

    def _exact(self, settings):
        """Settings that leave as good as nothing of a step."""
        tolerance = min(TIGHT, settings.tolerance or TIGHT)
        return replace(settings, tolerance=tolerance, max_iterations=max(ITERATIONS, settings.max_iterations))

    def frames(self, model, moved=0.0):
        """The run of another model, its frames at the same steps; moved: what is added to the velocities that it was given."""
        guarded = guard(model)
        given = self._velocity(guarded) if self.own else self.given
        held = self.run.plan.get("began") == "state"
        state = self.state if held else restarted(guarded, replace(self.state, v=given + moved))
        states = self._taken(guarded, state, self._times(guarded))
        kept = [states[k] for k in np.flatnonzero(self.course.frames >= 0)]
        vectors = {name: np.array([getattr(state, name) for state in kept]) for name in ("t", "q", "v", "a", "lam")}
        return replace(self.run, model=model, **vectors)

    def _taken(self, model, state, times):
        """The states of the course, of another model that begins with a state; times: a function of their numbers."""
        states, engine = [state], Steps(self.settings, model, Counts())
        for piece in self.course.pieces:
            grid, state = Grid(times(piece.first), times(piece.first + piece.count), piece.count), states[-1]
            state = state if piece.kind == "on" else replace(state, memory=piece.memory(None))
            engine.begin(started(self.settings, model, state, grid.h), grid.h)
            states += chain.from_iterable(engine.run(grid))
        return states

    def _velocity(self, model):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # that joints change what bodies were given, which the run has told
            return model.initial_velocity(self.state.t, self.state.q)

    def begins(self, model):
        """Whether a run of another model can begin where this one did, and take its steps between as many kinks."""
        phi = guard(model).phi(self.state.t, self.state.q)
        near = np.abs(phi).max(initial=0.0) <= VIOLATION * max(1.0, np.abs(self.state.q).max())
        return bool(near) and len(self._edges(model)) == len(self._edges(self.model))

    def _times(self, model):
        """A function of the number of a state: its time, which moves evenly with the kinks about it."""
        own, others = self._edges(self.model), self._edges(model)
        return lambda k: float(np.interp(self.course.states(k, k + 1)[0][0], own, others))

    def _edges(self, model):
        """The times at which the segments of a run of a model begin and end."""
        return edges(model, float(self.run.t[0]), float(self.run.t[-1]))
