"""The steps of a run of Radau IIA: its history, from its frames or by solving it again, and the engine that solves steps to round-off."""

from dataclasses import replace

import numpy as np

from polyida.adjoint.history import SAME, StepHistory, StepSegment, every_step, frame_reader, replayed_history
from polyida.integrate.discontinuities import Grid, at_kink, edges, time_limits
from polyida.integrate.radau.loop import EXACT
from polyida.integrate.radau.radau_iia import restarted
from polyida.integrate.radau.steps import Steps
from polyida.integrate.sizes import sizes_of_run
from polyida.integrate.start import far_side
from polyida.integrate.state import Counts, State
from polyida.integrate.switches import steps_of
from polyida.io.layout import MEMORY_LIMIT
from polyida.model.differences import beside

MAX_ITERATIONS = 30  # Newton iterations
PARTS_SHARE = 0.75  # a step whose last part is shorter than this share was taken in parts
STATE_SIZE = 4  # memory of a State of this method, with its stages, over that of another method


def exact_steps(model, settings, first, t_end, counts):
    """The Steps of a run from its first state, of any size, solved to round-off."""
    sizes = sizes_of_run(model, first, t_end)
    engine = Steps(replace(settings, tolerance=EXACT * float(sizes[0]), max_iterations=MAX_ITERATIONS), model, counts, sizes)
    engine.begin(first)
    engine.estimates_error = False
    return engine


def step_start_state(model, state):
    """The State from which the step after a state starts: behind a kink the consistent state of the far side."""
    return restarted(far_side(model, state, beside(state.t, 1))) if at_kink(model, state.t) else state


def step_history(run, model, memory_limit=MEMORY_LIMIT):
    """The StepHistory of a run, its segments between kinks. Raises InputError if frames are no states of steps, or memory is short."""
    if every_step(run) and (run.integrator.adaptive or not run.counts.rejected):
        history = StepHistory([], frame_reader(run), np.arange(len(run)))
        steps = np.diff(run.t)
    else:
        history = replayed_history(run, model, memory_limit / STATE_SIZE, _replayed_states, True)
        steps = np.repeat([segment.h for segment in history.segments], [segment.count for segment in history.segments])
    kinks, t, segments = np.array([*edges(model, float(run.t[0]), float(run.t[-1]))]), float(run.t[0]), []
    for k, h in enumerate(steps.tolist()):
        last = segments[-1] if segments else None
        if last and abs(last.h - h) <= SAME * h and np.abs(kinks - t).min() > 0.5 * h:
            segments[-1] = last._replace(count=last.count + 1)
        else:
            segments.append(StepSegment("on" if k else "begin", 0.0, h, k, 1))
        t += h
    return history._replace(segments=segments)


def _replayed_states(run, model, recorder):
    """Compute the run again; yield its accepted States behind (after) the first one of the recorder.

    The recorder gets these states, and the states at the ends of the parts of divided steps before them.
    """
    before = recorder.states[recorder.first]
    counts = Counts()
    own = lambda settings, state, t_end: settings.steps(model, state, t_end, counts)  # noqa: E731
    for state in steps_of(own, run.integrator, model, before, run.plan["t_end"], counts):
        for part in _parts(run.integrator, model, before, state):
            recorder.accepted(State(part.t, part.q, part.v, part.a, part.lam, restart=False))
        recorder.accepted(state)
        before = state
        yield state


def _parts(settings, model, state, end):
    """Yield the inner states of a fixed step that failed as a whole and was taken in parts."""
    last = end.within.h if end.within else np.inf
    if last > PARTS_SHARE * (end.t - state.t):
        return
    state = step_start_state(model, state)
    engine, parts = Steps(settings, model, Counts(), end.memory["sizes"]), Grid(state.t, end.t, round((end.t - state.t) / last))
    engine.begin(state)
    engine.limits = time_limits(model, state.t, end.t)
    for k in range(1, parts.count):
        state = engine.step(state, parts.h, parts.time(k))
        yield state
