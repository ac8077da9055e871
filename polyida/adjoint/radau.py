"""A run of Radau IIA backward: step by step, each by the transposed equations of its stages, with what comes before and behind on a tape."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from polyida.adjoint import radau_equations
from polyida.adjoint.history import StepHistory, StepSegment, every_step, frame_reader, replayed_history
from polyida.adjoint.parameter import AdjointMultipliers, stacked
from polyida.adjoint.radau_equations import SceneStageEquations, StageEquations
from polyida.adjoint.run import RunAdjoint
from polyida.adjoint.taped import Tape, TapedModel, add_to
from polyida.errors import StepFailure
from polyida.integrate.discontinuities import Grid, at_kink, inner_side
from polyida.integrate.radau.loop import EXACT
from polyida.integrate.radau.matrices import NOTHING, lift
from polyida.integrate.radau.radau_iia import restarted
from polyida.integrate.radau.steps import Steps
from polyida.integrate.sizes import extent, typical_sizes
from polyida.integrate.start import consistent_acceleration, far_side, on_velocity
from polyida.integrate.state import Counts, State
from polyida.integrate.switches import steps_of
from polyida.io.layout import MEMORY_LIMIT
from polyida.linear.lu import dense
from polyida.model.differences import beside, jacobian

TOGETHER = 64  # steps whose multipliers are summed up at once, at most
CHUNK = 4_000_000  # bytes of stages that are held at once
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
        self.lifts = self.engine.table.lifts and self.tied and not model.uniform_units
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


class RadauAdjoint(RunAdjoint):
    """A run backward. multipliers, entries: of the steps that are not added up yet; lifted (n,): the bar of D^-1."""

    history_of = staticmethod(step_history)

    def __init__(self, run, objective, names, memory_limit):
        super().__init__(run, objective, names, memory_limit)
        self.first = self._states(0, 1)[0]
        self.stages = stages = SolvedStages(self.model, self.settings, self.first, float(run.t[-1]), self.counts)
        given = self.model, stages.tableau, stages.lift, stages.tied, self.counts
        unknowns = self.settings.stages * (self.model.n + self.model.m * (1 + stages.tied))
        dense_steps = self.model.compiled and self.model.small and unknowns <= radau_equations.DENSE
        refined = self.model.compiled and self.settings.linear != "kkt" and not dense_steps  # with a scene's products
        self.equations = SceneStageEquations(*given) if refined else StageEquations(*given)
        self.multipliers, self.entries, self.lifted = [], [], np.zeros(self.model.n)

    def _states(self, first, end):
        """States of the history, from number `first` to before `end`."""
        return [State(float(t), *vectors) for t, *vectors in zip(*self.history.states(first, end))]

    def through(self, progress):
        """The bars of q, v, a and lam of the run's first state."""
        bars = np.zeros((2, self.model.n))
        together = int(max(1, min(TOGETHER, CHUNK // (8 * self.model.n * self.settings.stages))))
        for end in range(len(self.history.segments), 0, -together):
            first = max(0, end - together)
            bars = self._steps(first, self._states(first, end + 1), bars)
            self._add_up()
            progress(float(self.history.states(first, first + 1)[0][0]))
        return *bars, np.zeros(self.model.n), np.zeros(self.model.m)

    def _steps(self, first, states, bars):
        """Bars of q and v of the first of some states, number `first` of the history, from those of the last without the objective's own."""
        ready = [begun(self.model, state) for state in states[:-1]]
        steps = [self.stages.of(*ends) for ends in zip(ready, states[1:])]
        own = self.own.of(first + 1, first + len(states))
        if self.events.speeds and (by_time := own.by_time()) is not None:
            self.events.at(np.array([state.t for state in states[1:]]), by_time)
        for k in reversed(range(len(steps))):
            slopes = [None if x is None else x[k] for x in (own.q, own.v, own.a, own.lam)]
            bars = [bar if slope is None else bar + slope for bar, slope in zip(bars, slopes)]
            if slopes[2] is not None or slopes[3] is not None:  # a and lam of a frame follow from its q and v
                at = inner_side(self.model, states[k + 1].t, steps[k].h)
                bars = self._taped(states[k + 1], lambda model, q, v, at=at: consistent_acceleration(model, at, q, v), slopes[2:], bars)
            if self.stages.moves_v:  # in form "index3" the last stage's v is moved onto its constraint
                x = steps[k]
                last = State(states[k + 1].t, x.q[-1], x.v[-1], x.a[-1], x.lam[-1])
                bars = self._on_velocity(last, x.t[-1], bars)
            bars = self._step(self.history.segments[first + k], ready[k], steps[k], bars)
            if at_kink(self.model, states[k].t):
                bars = self._on_velocity(states[k], beside(states[k].t, 1), bars)
        return bars

    def _step(self, segment, state, x, bars):
        """Bars of what a step with stages x began with, from those of its end."""
        W, c, h, tied = self.stages.tableau.W, self.stages.tableau.c, x.h, self.stages.tied
        self.equations.at(x)
        found = self.equations.back(*bars)
        self.multipliers.append(AdjointMultipliers(x.t, x.q, x.v, x.a, x.lam, found.w, found.mu, found.kappa if tied else None))
        if tied:
            still, none, pushed = np.zeros_like(x.q), np.zeros_like(x.lam), self.stages.lift * found.v
            for v, mu in ((pushed, x.mu), (still, -x.mu)):
                self.multipliers.append(AdjointMultipliers(x.t, x.q, v, still, none, still, none, mu))
            self.lifted += self.equations.pushed(x.mu, found.v)
        if self.events.speeds:
            slope = (c @ found.q) @ state.v - np.sum((W @ x.e) * found.v) / h**2 - np.sum(x.a * found.a) / h
            self.events.stretch(segment, slope)
        return found.q.sum(axis=0), (c * h) @ found.q + found.v.sum(axis=0) - W.sum(axis=1) @ found.a / h

    def _on_velocity(self, state, t, bars):
        """Bars of q and v of a state, from those of the same with v moved onto the constraint of time t."""
        return self._taped(state, lambda model, q, v: (on_velocity(model, t, q, v),), bars[1:], (bars[0], np.zeros(self.model.n)))

    def _taped(self, state, made, bars, more):
        """(b_q, b_v) at a state: more, and what the bars of `made(model, q, v)` send there."""
        tape = Tape()
        taped, q, v = TapedModel(self.model, tape), tape.var(state.q), tape.var(state.v)
        for found, bar in zip(made(taped, q, v), bars):
            if bar is not None:
                add_to(found, bar)
        tape.back()
        self.entries += [(state.t, entry) for entry in taped.entries]
        return q.bar + more[0], v.bar + more[1]

    def of_first_state(self):
        """The bar of the first q by D, which is made there; its entries are added up."""
        if not self.stages.lifts or not self.lifted.any():
            return 0.0
        bar, entries = lift_bars(self.model, self.first, self.stages.lift, self.lifted)
        self.entries += [(entry.t, entry) for entry in entries]
        self._add_up()
        return bar

    def _add_up(self):
        """Add what is left for parameters to the sums."""
        if self.multipliers:
            self.add(AdjointMultipliers(*(None if parts[0] is None else np.concatenate(parts) for parts in zip(*self.multipliers))))
        self.add(stacked([entry for _, entry in self.entries]), np.array([t for t, _ in self.entries]))
        self.multipliers, self.entries = [], []


def lift_bars(model, state, lift, bar):
    """(the bar of q, (n,), entries for parameters) of a state where D^-1, `lift`, was made, from the bar of that, (n,).

    D is the diagonal of M over its mean at the run's start, by which the multipliers mu move v:
    `D^-1_k = sum_j M_jj / (n M_kk)`, and 1 where M_kk is nothing.
    """
    masses = np.abs(model.mass(state.q).diagonal())
    heavy = masses > NOTHING * masses.max()
    over = np.where(heavy, bar / np.where(heavy, masses, 1.0), 0.0)
    slopes = over.sum() / model.n - over * lift
    zero, rows, entries = np.zeros(model.n), np.zeros(model.m), []
    for unit, slope in zip(np.eye(model.n), slopes):
        for a, w in ((unit, slope * unit), (zero, -slope * unit)):
            entries.append(AdjointMultipliers(state.t, state.q, zero, a, rows, w, rows, rows, rows))
    if not model.needs.mass_varies:
        return zero, entries
    return jacobian(lambda q: np.array([slopes @ model.mass(q).diagonal()]), state.q, 1)[0], entries
