"""A run of Radau IIA backward: stretches of equal steps by a compiled sweep (radau_sweep.py), what is between and before them on a tape."""

from dataclasses import replace

import numpy as np

from polyida.adjoint.history import SAME, StepHistory, StepSegment, every_step, frame_reader, replayed_history
from polyida.adjoint.parameter import AdjointMultipliers, stacked
from polyida.adjoint.radau_equations import StageEquations
from polyida.adjoint.radau_sweep import Found, Slopes, Stages, States, Sweep, again, between, stretch
from polyida.adjoint.run import RunAdjoint
from polyida.adjoint.tables import DenseAdjoint, swept
from polyida.adjoint.taped import Tape, TapedModel, add_to
from polyida.errors import DONE, REASONS, StepFailure
from polyida.integrate.discontinuities import Grid, at_kink, edges, inner_side
from polyida.integrate.radau import loop
from polyida.integrate.radau.loop import EXACT, Control
from polyida.integrate.radau.matrices import NOTHING, lift
from polyida.integrate.radau.radau_iia import restarted
from polyida.integrate.radau.steps import Steps, new_control
from polyida.integrate.radau.tables.python import DenseStages
from polyida.integrate.radau.tables.scene import SceneMatrices
from polyida.integrate.sizes import extent, typical_sizes
from polyida.integrate.start import consistent_acceleration, far_side, on_velocity
from polyida.integrate.state import Counts, State
from polyida.integrate.switches import steps_of
from polyida.io.layout import MEMORY_LIMIT
from polyida.linear.lu import dense
from polyida.model.differences import beside, jacobian

CHUNK = 4_000_000  # bytes of one vector of all stages that are held at once
MOST = 30  # Newton iterations
NEAR = 1e-9  # of the model's size: a full Newton's correction behind which as good as nothing is left
PARTED = 0.75  # of a step: one that ended with a shorter one was taken in parts
LARGER = 4  # times as much as another's holds a State of this method, with its stages


def exact_steps(model, settings, first, t_end, counts):
    """Steps of a run from its first state, of any size, solved to round-off."""
    sizes = typical_sizes(model, first, t_end - first.t)
    engine = Steps(replace(settings, tolerance=EXACT * float(sizes[0]), max_iterations=MOST), model, counts, sizes)
    engine.begin(first)
    engine.estimates_error = False
    return engine


def within(model, begin, end):
    """The limits of times in a step: beside its ends where they are kinks."""
    return inner_side(model, begin, begin - end) if at_kink(model, begin) else -np.inf, inner_side(model, end, end - begin)


def begun(model, state):
    """The State that the step behind a state began from: behind a kink that of the far side."""
    return restarted(far_side(model, state, beside(state.t, 1))) if at_kink(model, state.t) else state


def step_history(run, model, memory_limit=MEMORY_LIMIT):
    """The StepHistory of a run, its segments between kinks. Raises InputError where frames are no states, or memory is short."""
    if every_step(run) and (run.integrator.adaptive or not run.counts.rejected):
        found = StepHistory([], frame_reader(run), np.arange(len(run)))
        steps = np.diff(run.t)
    else:
        found = replayed_history(run, model, memory_limit / LARGER, _accepted, True)
        steps = np.repeat([segment.h for segment in found.segments], [segment.count for segment in found.segments])
    kinks, t, segments = np.array(edges(model, float(run.t[0]), float(run.t[-1]))), float(run.t[0]), []
    for k, h in enumerate(steps.tolist()):
        last = segments[-1] if segments else None
        if last and abs(last.h - h) <= SAME * h and np.abs(kinks - t).min() > 0.5 * h:
            segments[-1] = last._replace(count=last.count + 1)
        else:
            segments.append(StepSegment("on" if k else "begin", 0.0, h, k, 1))
        t += h
    return found._replace(segments=segments)


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
    """A run backward. noted, entries: multipliers and entries at times that are not added up yet; lifted (n,): the bar of D^-1.

    lift (n,): the diagonal of D^-1, lifts: True if that is made of M; tied: True if there is mu; alone: True if each step is taken by itself, for v
    leaves its constraint within it; moves_v: True if the end's v is moved onto it.
    """

    history_of = staticmethod(step_history)

    def __init__(self, run, objective, names, memory_limit):
        super().__init__(run, objective, names, memory_limit)
        model, settings = self.model, self.settings
        self.first = self._states(0, 1).state(0)
        self.engine = engine = exact_steps(model, settings, self.first, float(run.t[-1]), self.counts)
        self.tableau, self.tied = engine.tableau, engine.tied
        self.alone = settings.form == "index3" and model.m > 0 and (model.needs.phi_q_varies or model.needs.driven)
        self.moves_v = self.alone and settings.project
        self.lifts = engine.table.lifts and self.tied and not model.uniform_units
        self.lift = lift(model, engine.shares) if self.lifts else np.ones(model.n)
        self.table, self.noted, self.entries, self.lifted = self._table(), ([], [], []), [], np.zeros(model.n)
        n, m, s = model.n, model.m, settings.stages
        self.sweep = Sweep(np.zeros((2, n)), np.zeros((2, n)), np.zeros((s, n)), np.zeros((s, m)), np.zeros((3, s, n)))

    def _table(self):
        model, W, tied = self.model, self.tableau.W.T, self.tied
        if isinstance(self.engine.table, DenseStages):
            return DenseAdjoint(self.engine.table, W, W @ W, self.counts, self.lift, tied)
        if not model.compiled or self.settings.linear == "kkt":
            return self._exact()
        from polyida.adjoint.scene_table import EXACT, SceneAdjoint

        def factor(t, q, v, a, lam, modes):
            h = self.tableau.modes[0].value / modes[0][1]
            made = SceneMatrices(model, self.tableau.modes, h.real, np.concatenate([[t], q, v, a, lam]), tied)
            self.counts.backend = made.backend
            return [x[1:] for x in (made.real, made.pair) if x]

        modes = [(mode.value**2, mode.value, mode.row.copy(), mode.column.copy()) for mode in self.tableau.modes]
        return SceneAdjoint(model, W, W @ W, modes, factor, EXACT, self.counts, tied)

    def _exact(self):
        """The table that factors the whole equations of each step."""
        return StageEquations(self.model, self.tableau, self.lift, self.tied, self.counts)

    def _states(self, first, end):
        """States of the history, from number `first` to before `end`."""
        return States(*(np.ascontiguousarray(x, float) for x in self.history.states(first, end)))

    def through(self, progress):
        """The bars of q, v, a and lam of the run's first state."""
        together = int(max(1, min(self.engine.most, CHUNK // (8 * self.model.n * self.settings.stages))))
        longest = 1 if self.alone else together
        for segment in reversed(self.history.segments):
            for end in range(segment.first + segment.count, segment.first, -longest):
                progress(self._steps(segment, max(segment.first, end - longest), end))
                if sum(len(x.t) for x in self.noted[0]) >= together:
                    self._add_up()
        self._add_up()
        return *self.sweep.bars, np.zeros(self.model.n), np.zeros(self.model.m)

    def _steps(self, segment, first, end):
        """Take the steps from state number `first` to number `end` backward. Returns the time of the first."""
        model, h, bars, b = self.model, segment.h, self.sweep.bars, self._states(first, end + 1)
        kink = first == segment.first and at_kink(model, float(b.t[0]))
        begin = b.state(0)
        if kink:  # the first step begins from the state of the far side
            b = States(*(x.copy() for x in b))
            far = begun(model, begin)
            b.q[0], b.v[0], b.a[0], b.lam[0] = far.q, far.v, far.a, far.lam
        x, slopes = self._solved(b, h), self._own_slopes(b, first, end, h)
        q, v = b.q[:-1, None] + self.tableau.c[:, None] * h * b.v[:-1, None] + x.e, b.v[:-1, None] + x.dv
        if self.moves_v:  # in form "index3" the last stage's v is moved onto its constraint
            bars[:] = bars[0] + slopes.q.sum(axis=0), bars[1] + slopes.v.sum(axis=0)
            slopes = Slopes(*np.zeros((2, 0, model.n)))
            last = State(float(b.t[-1]), q[-1, -1], v[-1, -1], x.a[-1, -1], x.lam[-1, -1])
            bars[:] = self._on_velocity(last, float(x.t[-1, -1]), bars)
        out = self._swept(h, slopes, b, x, q, v)
        self._note(b, x, q, v, h, out)
        if self.events.speeds:
            self.events.stretch(segment, float(out.slopes.sum()))
        if kink:
            bars[:] = self._on_velocity(begin, beside(begin.t, 1), bars)
        return begin.t

    def _own_slopes(self, b, first, end, h):
        """The objective's own Slopes at the ends of steps, those in a and lam taken to q and v, from which these follow."""
        own = self.own.of(first + 1, end + 1)
        if self.events.speeds and (by_time := own.by_time()) is not None:
            self.events.at(b.t[1:], by_time)
        q, v = (np.zeros((0, self.model.n)) if x is None else np.array(x, float) for x in (own.q, own.v))
        if own.a is not None or own.lam is not None or self.moves_v:
            q, v = (x if len(x) else np.zeros((end - first, self.model.n)) for x in (q, v))
        for k in range(end - first):
            bars = [None if x is None or not x[k].any() else x[k] for x in (own.a, own.lam)]
            if any(bar is not None for bar in bars):
                state, t = b.state(k + 1), inner_side(self.model, float(b.t[k + 1]), h)
                made = lambda model, q, v, t=t: consistent_acceleration(model, t, q, v)  # noqa: E731
                q[k], v[k] = self._taped(state, made, bars, (q[k], v[k]))
        return Slopes(q, v)

    def _solved(self, b, h):
        """The Stages of steps of h between states. Raises StepFailure."""
        engine, count, s, n, m = self.engine, len(b.t) - 1, self.settings.stages, self.model.n, self.model.m
        engine.limits = within(self.model, float(b.t[0]), float(b.t[-1]))
        control, first = Control(False, h, h, np.inf, np.inf, np.inf, new_control(float(b.t[0]))), b.state(0)
        engine.start_from(first)
        method = engine.method()._replace(moves_v=False, has_guess=True)
        number, done, fresh = engine.table.begin(engine, first, control, b.t[1:]), 0, False
        sizes = (), (n,), (n,), (n,), (m,), (m if self.tied else 0,)
        out, held = Stages(*(np.empty((count, s, *size)) for size in sizes)), (engine.memory, engine.trial, engine.scratch, engine.done)
        while done < count:
            engine.done[:], before = 0, replace(self.counts)
            at_work = engine.table.functions, engine.table.workspace, number, method, engine.compiled_tableau, h, control.now, engine.slots
            done, ended = again(*at_work, fresh, b, done, *held, out)
            engine.table.raise_left()
            vars(self.counts).update(engine.counts_at(before, engine.done[None], 0))
            fresh, failure = ended == loop.MAKE, None
            try:
                if ended in (loop.MAKE, loop.RESTORE):
                    engine.make(control, fresh)
                elif ended != DONE:
                    failure = StepFailure(*REASONS[ended], float(b.t[done + 1]))
            except StepFailure as singular:
                failure = singular
            if failure:
                self._solve_fully(b, done, h, out, failure)
                done += 1
        return out

    def _solve_fully(self, b, k, h, out, failure):
        """The stages of step k by Newton's full method, where the simplified one, from between the step's ends, does not get there as the run did."""
        x, full, W = self.engine.trial, self._exact(), self.tableau.W
        full.scale(h)
        between(self.tableau.c, h, b, k, x)
        out.t[k] = [self.engine.clamp(float(b.t[k]) + c * h) for c in self.tableau.c]
        changes = None
        for _ in range(MOST):
            q, dv = b.q[k] + self.tableau.c[:, None] * h * b.v[k] + x.e, W @ x.e / h
            if self.tied:
                dv += [self.lift * (dense(self.model.phi_q(*state)).T @ mu) for *state, mu in zip(out.t[k].tolist(), q, x.mu)]
            for part, value in zip(out[1:], (x.e, dv, W @ dv / h, x.lam, x.mu)):
                part[k] = value
            if changes is not None and np.abs(changes[0]).max() <= NEAR * extent(self.model, b.q[k]):
                return
            changes = full.newton(out.t[k], q, b.v[k] + dv, out.a[k], x.lam, x.mu)
            for part, change in zip((x.e, x.lam, x.mu), changes):
                part -= change
        raise failure

    def _swept(self, h, slopes, b, x, q, v):
        """What the sweep over the steps leaves; the bars go to the first state."""
        count, s, _ = q.shape
        out = Found(np.zeros(q.shape), np.empty(q.shape), np.zeros((count, 1 + self.tied, s, self.model.m)), np.empty(count))
        states, given = (x.t, q, v, x.a, x.lam, x.mu), (self.tableau.c, self.tableau.W, h, slopes, b, x, self.sweep, out)

        def exact():
            made = self._exact()
            made.scale(h)
            made.take(*states)
            return made

        self.table.scale(h)
        self.table.take(*states)
        swept(self.table, exact, count, lambda f, w, first, last: stretch(f, w, first, last, *given))
        return out

    def _note(self, b, x, q, v, h, out):
        """Note what the steps' multipliers say of parameters, and of D^-1."""
        flat = lambda *arrays: [each.reshape(x.t.size, each.shape[-1]) for each in arrays]  # noqa: E731
        mu, *kappa = np.moveaxis(out.multipliers, 1, 0)
        at = x.t.ravel(), *flat(q, v, x.a, x.lam)
        self.noted[0].append(AdjointMultipliers(*at, *flat(out.w, mu, *kappa)))
        if self.tied:
            still, none, (pushed, factors) = np.zeros_like(at[1]), np.zeros_like(at[4]), flat(self.lift * out.v, x.mu)
            self.noted[1].append(AdjointMultipliers(*at[:2], pushed, still, none, still, None, factors))
            if self.model.needs.driven:
                self.noted[2].append(AdjointMultipliers(*at[:2], still, still, none, still, None, -factors))
            self.lifted += np.sum((x.dv - self.tableau.W @ x.e / h) / self.lift * out.v, axis=(0, 1))

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
        if not self.lifts or not self.lifted.any():
            return 0.0
        bar, entries = lift_bars(self.model, self.first, self.lift, self.lifted)
        self.entries += [(entry.t, entry) for entry in entries]
        self._add_up()
        return bar

    def _add_up(self):
        """Add what was noted to the sums."""
        for parts in self.noted:
            if parts:
                self.add(AdjointMultipliers(*(None if x[0] is None else np.concatenate(x) for x in zip(*parts))))
        self.add(stacked([entry for _, entry in self.entries]), np.array([t for t, _ in self.entries]))
        self.noted, self.entries = ([], [], []), []


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
