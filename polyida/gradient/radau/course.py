"""The states that a run of Radau IIA accepted: its frames where these are all of them, taken by running it again otherwise."""

import numpy as np

from polyida.gradient.course import Course, Piece, of_states
from polyida.gradient.radau.stages import begun, within
from polyida.integrate.radau.steps import Steps
from polyida.integrate.state import Counts, State
from polyida.integrate.stepping.grid import Grid

PARTED = 0.75  # of a step: one that ended with a shorter one was taken in parts


def course_of(run, model):
    """The Course of a run, each step a Piece of its own. Raises InputError where frames are no states."""
    return _of_frames(run) if _whole(run) else _again(run, model)


def _whole(run):
    """Whether the frames are the ends of all steps."""
    plan = run.plan
    every = plan.get("every", 1) == 1 and not plan.get("output") and plan.get("precision", "double") == "double"
    return every and (run.integrator.adaptive or not run.counts.rejected) and run.status != "stopped"


def _of_frames(run):
    arrays = run.t, run.q, run.v, run.a, run.lam
    read = lambda first, end: tuple(np.asarray(x[first:end], float) for x in arrays)  # noqa: E731
    return Course(_pieces(np.asarray(run.t, float)), read, np.arange(len(run)))


def _pieces(t):
    return [Piece("on", 0.0, float(h), k, 1) for k, h in enumerate(np.diff(t))]


def _again(run, model):
    begin, t_end = State(float(run.t[0]), *(np.array(x[0], float) for x in (run.q, run.v, run.a, run.lam))), run.plan["t_end"]
    states, before = [begin], begin
    for state in run.integrator.steps(model, begin, t_end, Counts()):
        states += map(_bare, (*_parts(run.integrator, model, before, state), state))
        before = state
        if state.t >= run.t[-1]:
            break
    return of_states(run, states, _pieces(np.array([state.t for state in states])))


def _bare(state):
    """A State without its memory, which is larger than itself."""
    return State(state.t, state.q, state.v, state.a, state.lam)


def _parts(settings, model, state, end):
    """The states at the ends of the parts in which a fixed step was taken that failed as a whole, without its end."""
    last = end.within.h if end.within else np.inf
    if last > PARTED * (end.t - state.t):
        return
    state = begun(model, state)
    engine, parts = Steps(settings, model, Counts(), end.memory["sizes"]), Grid(state.t, end.t, round((end.t - state.t) / last))
    engine.begin(state)
    engine.limits = within(model, state.t, end.t)
    for k in range(1, parts.count):
        state, _ = engine.step(state, parts.h, parts.time(k))
        yield state
