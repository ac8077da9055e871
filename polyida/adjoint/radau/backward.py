"""A run of Radau IIA backward: step by step, each by the transposed equations of its stages, with what comes before and behind on a tape."""

import numpy as np

from polyida.adjoint.parameters.parameter import AdjointMultipliers, stacked
from polyida.adjoint.radau import equations
from polyida.adjoint.radau.equations import SceneStageEquations, StageEquations
from polyida.adjoint.radau.stages import SolvedStages, begun, step_history
from polyida.adjoint.run import RunAdjoint
from polyida.adjoint.taped import Tape, TapedModel, add_to
from polyida.integrate.kinks import at_kink, beside, inner_side
from polyida.integrate.radau.matrices import NOTHING
from polyida.integrate.start import consistent_acceleration, on_velocity
from polyida.integrate.state import State
from polyida.model.differences import jacobian

TOGETHER = 64  # steps whose multipliers are summed up at once, at most
CHUNK = 4_000_000  # bytes of stages that are held at once


class RadauAdjoint(RunAdjoint):
    """A run backward. multipliers, entries: of the steps that are not added up yet; lifted (n,): the bar of D^-1."""

    history_of = staticmethod(step_history)

    def __init__(self, run, objective, names, memory_limit):
        super().__init__(run, objective, names, memory_limit)
        self.first = self._states(0, 1)[0]
        self.stages = stages = SolvedStages(self.model, self.settings, self.first, float(run.t[-1]), self.counts)
        given = self.model, stages.tableau, stages.lift, stages.tied, self.counts
        self.equations = SceneStageEquations(*given, self.settings.linear) if self._refines() else StageEquations(*given)
        self.multipliers, self.entries, self.lifted = [], [], np.zeros(self.model.n)

    def _refines(self):
        """Whether steps are refined with a scene's products."""
        model, unknowns = self.model, self.settings.stages * (self.model.n + self.model.m * (1 + self.stages.tied))
        return model.compiled and self.settings.linear != "kkt" and not (model.small and unknowns <= equations.DENSE)

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
            bars = self._at_end(states[k + 1], steps[k].h, [None if x is None else x[k] for x in (own.q, own.v, own.a, own.lam)], bars)
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

    def _at_end(self, state, before, own, bars):
        """Bars of q and v of a state, with the objective's own there; a and lam of a frame follow from its q and v."""
        bars = [bar if slope is None else bar + slope for bar, slope in zip(bars, own)]
        if own[2] is None and own[3] is None:
            return bars
        at = inner_side(self.model, state.t, before)
        return self._taped(state, lambda model, q, v: consistent_acceleration(model, at, q, v), own[2:], bars)

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
