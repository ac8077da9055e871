"""The states that a run of Radau IIA accepted: its frames where these are all of them, taken by running it again otherwise."""

import numpy as np

from polyida.adjoint.alpha.again import Again
from polyida.adjoint.radau.stages import begun, exact_steps, within
from polyida.adjoint.steps.course import Course, Piece, every_step, reader, taken_again
from polyida.integrate.radau.steps import Steps
from polyida.integrate.state import Counts, State
from polyida.integrate.stepping.grid import Grid
from polyida.integrate.switches import steps_of
from polyida.io.frames import MEMORY_LIMIT

PARTED = 0.75  # of a step: one that ended with a shorter one was taken in parts
LARGER = 4  # times as much as another's holds a State of this method, with its stages


def course_of(run, model, memory_limit=MEMORY_LIMIT):
    """The Course of a run, each step a Piece of its own. Raises InputError where frames are no states, or memory is short."""
    if every_step(run) and (run.integrator.adaptive or not run.counts.rejected):
        pieces = [Piece("on" if k else "begin", 0.0, h, k, 1) for k, h in enumerate(np.diff(run.t).tolist())]
        return Course(pieces, reader(run), np.arange(len(run)))
    found = taken_again(run, model, memory_limit / LARGER, _accepted, True)
    return found._replace(pieces=[piece._replace(first=piece.first + k, count=1) for piece in found.pieces for k in range(piece.count)])


def _accepted(run, model, seen):
    """The accepted states of the run behind the first that `seen` has; told are the parts of cut steps too, from which no run goes on."""
    before = seen.states[seen.first]
    counts = Counts()
    own = lambda settings, state, t_end: settings.steps(model, state, t_end, counts)  # noqa: E731
    for state in steps_of(own, run.integrator, model, before, run.plan["t_end"], counts):
        for part in _parts(run.integrator, model, before, state):
            seen.accepted(State(part.t, part.q, part.v, part.a, part.lam, restart=False))
        seen.accepted(state)
        before = state
        yield state


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


class RadauAgain(Again):
    """As Again, each step solved to round-off."""

    course_of = staticmethod(course_of)

    def _exact(self, settings):
        return settings

    def _taken(self, model, state, times):
        states, engine = [state], exact_steps(model, self.settings, state, float(self.run.t[-1]), Counts())
        for piece in self.course.pieces:
            state, t = begun(model, states[-1]), times(piece.first + 1)
            engine.limits = within(model, state.t, t)
            states.append(engine.step(state, t - state.t, t)[0])
        return states
