"""The stages of a run's steps, which its frames do not hold: solved again from each step's beginning by the method's own code, to round-off."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from polyida.adjoint.history import StepHistory, StepSegment, every_step, frame_reader, replayed_history
from polyida.adjoint.radau.equations import StageEquations
from polyida.errors import StepFailure
from polyida.integrate.kinks import Grid, at_kink, beside, inner_side
from polyida.integrate.radau.loop import EXACT
from polyida.integrate.radau.matrices import lift
from polyida.integrate.radau.radau_iia import restarted
from polyida.integrate.radau.steps import Steps
from polyida.integrate.sizes import extent, typical_sizes
from polyida.integrate.start import far_side
from polyida.integrate.state import Counts, State
from polyida.integrate.switches import steps_of
from polyida.io.frames import MEMORY_LIMIT
from polyida.linear.lu import dense

MOST = 30  # Newton iterations
NEAR = 1e-9  # of the model's size: a full Newton's correction behind which as good as nothing is left
PARTED = 0.75  # of a step: one that ended with a shorter one was taken in parts
LARGER = 4  # times as much as another's holds a State of this method, with its stages


class Stages(NamedTuple):
    """A step of h, s, and its stages: t (s,), e = q_i - q_0 - c_i h v_0, q, v, v' (s, n), lam (s, m), mu (s, m) or (s, 0) without."""

    h: float
    t: np.ndarray
    e: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    lam: np.ndarray
    mu: np.ndarray


class SolvedStages:
    """Of a model and the settings of its run, which began with a state.

    lift (n,): the diagonal of D^-1, lifts: whether that is made of M; tied: whether there is mu; moves_v: whether the end's v is
    moved onto its constraint.
    """

    def __init__(self, model, settings, first, t_end, counts):
        self.model, self.engine = model, exact_steps(model, settings, first, t_end, counts)
        self.tableau, self.tied, self.engine.guess = self.engine.tableau, self.engine.tied, self._between
        bent = model.m > 0 and (model.needs.phi_q_varies or model.needs.driven)
        self.moves_v = bent and settings.form == "index3" and settings.project
        self.lifts = self.engine.table.lifts and self.tied and not model.alike
        self.lift = lift(model, self.engine.shares) if self.lifts else np.ones(model.n)

    def of(self, state, end):
        """The Stages of the step from a state to another. Raises StepFailure."""
        h = end.t - state.t
        self.engine.limits = within(self.model, state.t, end.t)
        self.end = end
        try:
            self.engine.step(state, h, end.t)
        except StepFailure as failure:
            return self._fully(state, h, failure)
        return self._stages(state, h)

    def _fully(self, state, h, failure):
        """The same by Newton's full method, where the simplified one, from between the step's ends, does not get there as the run did."""
        self._between(state, h)
        x, full = self.engine.trial, StageEquations(self.model, self.tableau, self.lift, self.tied, self.engine.counts)
        for _ in range(MOST):
            full.at(self._stages(state, h))
            changes = full.newton()
            for part, change in zip((x.e, x.lam, x.mu), changes):
                part -= change[:, : part.shape[1]]
            if np.abs(changes[0]).max() <= NEAR * extent(self.model, state.q):
                return self._stages(state, h)
        raise failure

    def _between(self, state, h):
        """Stages to begin with, between the two ends of a step, both of which are known: on the cubic through q and v of both, lam on lines."""
        x, end, c = self.engine.trial, self.end, self.tableau.c[:, None]
        way, turn = end.q - state.q - h * state.v, h * (end.v - state.v)
        x.e[:] = c**2 * (3 * way - turn) + c**3 * (turn - 2 * way)
        x.lam[:] = (1 - c) * state.lam + c * end.lam
        x.mu[:] = 0.0

    def _stages(self, state, h):
        """Those of the unknowns that are on trial."""
        x, W, model = self.engine.trial, self.tableau.W, self.model
        e, lam, mu = x.e.copy(), x.lam.copy(), x.mu.copy()
        t = np.array([self.engine.clamp(state.t + c * h) for c in self.tableau.c])
        q = state.q + self.tableau.c[:, None] * h * state.v + e
        dv = W @ e / h
        if self.tied:
            dv += [self.lift * (dense(model.phi_q(*at)).T @ more) for *at, more in zip(t, q, mu)]
        return Stages(h, t, e, q, state.v + dv, W @ dv / h, lam, mu)


def exact_steps(model, settings, first, t_end, counts):
    """Steps of a run from its first state, of any size, solved to round-off."""
    sizes = typical_sizes(model, first, t_end - first.t)
    engine = Steps(replace(settings, tolerance=EXACT * float(sizes[0]), max_iterations=MOST), model, counts, sizes)
    engine.begin(first)
    engine.looks = False
    return engine


def within(model, begin, end):
    """The limits of times in a step: beside its ends where they are kinks."""
    return inner_side(model, begin, begin - end) if at_kink(model, begin) else -np.inf, inner_side(model, end, end - begin)


def begun(model, state):
    """The State that the step behind a state began from: behind a kink that of the far side."""
    return restarted(far_side(model, state, beside(state.t, 1))) if at_kink(model, state.t) else state


def step_history(run, model, memory_limit=MEMORY_LIMIT):
    """The StepHistory of a run, each step a StepSegment of its own. Raises InputError where frames are no states, or memory is short."""
    if every_step(run) and (run.integrator.adaptive or not run.counts.rejected):
        segments = [StepSegment("on" if k else "begin", 0.0, h, k, 1) for k, h in enumerate(np.diff(run.t).tolist())]
        return StepHistory(segments, frame_reader(run), np.arange(len(run)))
    found = replayed_history(run, model, memory_limit / LARGER, _accepted, True)
    return found._replace(
        segments=[segment._replace(first=segment.first + k, count=1) for segment in found.segments for k in range(segment.count)]
    )


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
        state = engine.step(state, parts.h, parts.time(k))
        yield state
