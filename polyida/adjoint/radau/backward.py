"""A run of Radau IIA backwards: step by step, each by the transposed equations of its stages, with what comes before and behind on a tape."""

import numpy as np

from polyida.adjoint.alpha.moving import Moving
from polyida.adjoint.alpha.plain import Sent
from polyida.adjoint.parameters.parameter import Work, stacked
from polyida.adjoint.radau.equations import Linearised
from polyida.adjoint.radau.stages import StagesAgain, begun, course_of
from polyida.adjoint.taped.model import TapedModel
from polyida.adjoint.taped.tape import Tape, add_to
from polyida.adjoint.totals import OwnSlopes, Totals
from polyida.integrate.kinks import at_kink, beside, inner_side
from polyida.integrate.radau.matrices import NOTHING
from polyida.integrate.start import consistent_acceleration, on_velocity
from polyida.integrate.state import Counts, State
from polyida.model.differences import jacobian
from polyida.model.guarded import guard

TOGETHER = 64  # steps whose multipliers are summed up at once, at most
CHUNK = 4_000_000  # bytes of stages that are held at once


def lift_bars(model, state, lift, bar):
    """(the bar of q, (n,), entries for parameters' slopes) of a state where D^-1, `lift`, was made, from the bar of that, (n,).

    D is the diagonal of M over its mean at the run's start, by which the multipliers mu move v:
    `D^-1_k = sum_j M_jj / (n M_kk)`, and 1 where M_kk is nothing.
    """
    masses = np.abs(model.mass(state.q).diagonal())
    heavy = masses > NOTHING * masses.max()
    over = np.where(heavy, bar / np.where(heavy, masses, 1.0), 0.0)
    slopes = over.sum() / model.n - over * lift
    at = lambda q: np.array([slopes @ model.mass(q).diagonal()])  # noqa: E731
    zero, rows, entries = np.zeros(model.n), np.zeros(model.m), []
    for unit, slope in zip(np.eye(model.n), slopes):
        for a, w in ((unit, slope * unit), (zero, -slope * unit)):
            entries.append(Work(state.t, state.q, zero, a, rows, w, rows, rows, rows))
    return jacobian(at, state.q, 1)[0] if model.needs.mass_varies else zero, entries


class RadauBackward:
    """Of a run; totals: the slopes so far."""

    def __init__(self, run, objective, names, memory_limit):
        self.model, self.settings = guard(run.model), run.integrator
        self.course, self.counts = course_of(run, self.model, memory_limit), Counts()
        self.totals = Totals(run.model, names, run.plan.get("began") != "state")
        self.own = OwnSlopes(objective, run, self.course.frames, self.totals)
        self.moving = Moving(self.model, self.settings, run, self.totals.parameters)
        self.first = self._states(0, 1)[0]
        self.again = StagesAgain(self.model, self.settings, self.first, float(run.t[-1]), self.counts)
        self.equations = self._equations()
        self.works, self.entries, self.lifted = [], [], np.zeros(self.model.n)

    def _equations(self):
        given = self.model, self.again.tableau, self.again.lift, self.again.tied, self.counts
        if not self.model.compiled or self.settings.linear == "kkt":
            return Linearised(*given)
        from polyida.adjoint.radau.scene import SceneLinearised

        return SceneLinearised(*given, self.settings.linear)

    def _states(self, first, end):
        """States of the course, from number `first` to before `end`."""
        return [State(float(t), *vectors) for t, *vectors in zip(*self.course.states(first, end))]

    def through(self, progress):
        """(Sent to the run's first state, the bar of its lam), all slopes of its frame with them."""
        zero, rows, bars = np.zeros(self.model.n), np.zeros(self.model.m), np.zeros((2, self.model.n))
        together = int(max(1, min(TOGETHER, CHUNK // (8 * self.model.n * self.settings.stages))))
        for end in range(len(self.course.pieces), 0, -together):
            first = max(0, end - together)
            bars = self._steps(first, self._states(first, end + 1), bars)
            self._add()
            progress(float(self.course.states(first, first + 1)[0][0]))
        own = self.own.of(0, 1)
        q, v, a, lam = (
            part if slope is None else part + slope[0] for part, slope in zip((*bars, zero, rows), (own.q, own.v, own.a, own.lam))
        )
        q = q + self._lift()
        if self.moving.speeds:
            self.moving.add_to(self.totals.sums, self.course)
        return Sent(q, v, a, zero), lam

    def _steps(self, first, states, bars):
        """Bars of q and v of the first of some states, number `first` of the course, from those of the last without the objective's own."""
        ready = [begun(self.model, state) for state in states[:-1]]
        steps = [self.again.of(*ends) for ends in zip(ready, states[1:])]
        own = self.own.of(first + 1, first + len(states))
        if self.moving.speeds and (by_time := own.by_time()) is not None:
            self.moving.at(np.array([state.t for state in states[1:]]), by_time)
        for k in reversed(range(len(steps))):
            bars = self._at_end(states[k + 1], steps[k].h, [None if x is None else x[k] for x in (own.q, own.v, own.a, own.lam)], bars)
            bars = self._step(self.course.pieces[first + k], ready[k], steps[k], self._projected(steps[k], states[k + 1].t, bars))
            bars = self._behind_kink(states[k], bars)
        return bars

    def _step(self, piece, state, stages, bars):
        """Bars of what a step began with, from those of its end."""
        W, c, h = self.again.tableau.W, self.again.tableau.c, stages.h
        self.equations.at(stages)
        found = self.equations.back(*bars)
        works = [Work(stages.t, stages.q, stages.v, stages.a, stages.lam, found.w, found.mu, found.kappa if self.again.tied else None)]
        if self.again.tied:
            still, none, pushed = np.zeros_like(stages.q), np.zeros_like(stages.lam), self.again.lift * found.v
            works += [Work(stages.t, stages.q, v, still, none, still, none, mu) for v, mu in ((pushed, stages.mu), (still, -stages.mu))]
            self.lifted += self.equations.pushed(stages.mu, found.v)
        self.works += works
        if self.moving.speeds:
            slope = (c @ found.q) @ state.v - np.sum((W @ stages.e) * found.v) / h**2 - np.sum(stages.a * found.a) / h
            self.moving.stretch(piece, slope)
        return found.q.sum(axis=0), (c * h) @ found.q + found.v.sum(axis=0) - W.sum(axis=1) @ found.a / h

    def _at_end(self, state, before, own, bars):
        """Bars of q and v of a state, with the objective's own there; a and lam of a frame follow from its q and v."""
        b_q, b_v = (bar if slope is None else bar + slope for bar, slope in zip(bars, own))
        if own[2] is None and own[3] is None:
            return b_q, b_v
        at = inner_side(self.model, state.t, before)
        made = lambda model, q, v: consistent_acceleration(model, at, q, v)  # noqa: E731
        return self._taped(state, made, own[2:], (b_q, b_v))

    def _projected(self, stages, t, bars):
        """Bars of q and v of the last stage, from those of the step's end: in form "index3" its v is moved onto its constraint."""
        if not self.again.moves_v:
            return bars
        last = State(t, stages.q[-1], stages.v[-1], stages.a[-1], stages.lam[-1])
        moved = lambda model, q, v: (on_velocity(model, stages.t[-1], q, v),)  # noqa: E731
        return self._taped(last, moved, bars[1:], (bars[0], np.zeros(self.model.n)))

    def _behind_kink(self, state, bars):
        """Bars of q and v of a state, from those of what the step behind it began with."""
        if not at_kink(self.model, state.t):
            return bars
        moved = lambda model, q, v: (on_velocity(model, beside(state.t, 1), q, v),)  # noqa: E731
        return self._taped(state, moved, bars[1:], (bars[0], np.zeros(self.model.n)))

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

    def _lift(self):
        """The bar of the first q by D, which is made there, and its entries."""
        if not self.again.lifts or not self.lifted.any():
            return 0.0
        bar, entries = lift_bars(self.model, self.first, self.again.lift, self.lifted)
        self.entries += [(entry.t, entry) for entry in entries]
        self._add()
        return bar

    def _add(self):
        """Add up what was left for parameters."""
        t = np.array([t for t, _ in self.entries])
        for times, work in ((None, _joined(self.works)), (t, stacked([entry for _, entry in self.entries]))):
            if work is not None:
                self.totals.work(work)
                if self.moving.speeds:
                    self.moving.works(work.t if times is None else times, work)
        self.works, self.entries = [], []


def _joined(works):
    """One Work of several, which have the same vectors."""
    return Work(*(None if parts[0] is None else np.concatenate(parts) for parts in zip(*works))) if works else None
