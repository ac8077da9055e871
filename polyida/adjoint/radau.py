"""Backward sweep over a run of Radau IIA.

Stretches of equal steps are swept in compiled code (radau_sweep.py, which has the equations and the letters); what lies between them, such as
a kink or a projection of v, goes back on a tape (taped.py). In: a run and the objective's slopes at its states. Out: the adjoints of the
run's first state; on the way the multipliers of all stages are added to the totals of the parameters, in chunks.
"""

from dataclasses import dataclass, field, replace
from functools import lru_cache, partial

import numpy as np

from polyida.adjoint.dense_steps import DenseAdjoint
from polyida.adjoint.exact_steps import ExactSteps
from polyida.adjoint.parameter import AdjointMultipliers, stacked
from polyida.adjoint.radau_history import MAX_ITERATIONS, exact_steps, step_history, step_start_state
from polyida.adjoint.radau_sweep import Slopes, Stages, States, Steps, Sweep, SweepOutput, initial_stages, solve_stages, sweep_back
from polyida.adjoint.run import RunAdjoint
from polyida.adjoint.tables import sweep_with_fallback
from polyida.adjoint.taped import pulled_back
from polyida.errors import DONE, REASONS, StepFailure
from polyida.integrate.discontinuities import at_kink, inner_side, time_limits
from polyida.integrate.radau import loop
from polyida.integrate.radau.loop import Control
from polyida.integrate.radau.matrices import NOTHING, lift
from polyida.integrate.radau.steps import new_control
from polyida.integrate.radau.tables.python import DenseStages
from polyida.integrate.sizes import extent
from polyida.integrate.start import consistent_acceleration, on_velocity
from polyida.integrate.state import State
from polyida.linear.lu import dense
from polyida.model.differences import beside, jacobian
from polyida.system.scene_factors import factors_of_modes

CHUNK = 4_000_000  # bytes of one vector of all stages that are held at once
CONVERGED = 1e-9  # of the model's size: the last correction of the full Newton method


@dataclass
class Pending:
    """AdjointMultipliers of stages that are not yet added to the totals."""

    equations: list = field(default_factory=list)  # of the equations of the stages: w, mu*, kappa
    lifted: list = field(default_factory=list)  # of B^T mu in v_i = ... + D^-1 B^T mu
    driven: list = field(default_factory=list)  # the part of the rate phi_t that `lifted` has too much, for driven rows
    velocity_rows: list = field(default_factory=list)  # of the velocity rows, which are equations of v

    def add_to_totals(self, add):
        """Call `add` with one AdjointMultipliers of each list, in the order of the fields, and empty the lists."""
        for parts in (self.equations, self.lifted, self.driven, self.velocity_rows):
            if parts:
                add(AdjointMultipliers(*(None if x[0] is None else np.concatenate(x) for x in zip(*parts))))
            parts.clear()


class RadauAdjoint(RunAdjoint):
    """Backward sweep over a run."""

    history_of = staticmethod(step_history)

    def __init__(self, run, objective, names, memory_limit):
        """Make the engine that solves the stages again, and the table of the sweep."""
        super().__init__(run, objective, names, memory_limit)
        model, settings = self.model, self.settings
        self.first = self._states(0, 1).state(0)
        self.engine = engine = exact_steps(model, settings, self.first, float(run.t[-1]), self.counts)
        self.tableau = engine.tableau
        self.tied = engine.tied  # True if there is mu
        # each step is swept alone if v is projected at its end
        self.single_steps = settings.form == "index3" and model.m > 0 and (model.needs.phi_q_varies or model.needs.driven)
        self.moves_v = self.single_steps and settings.project
        self.lift_varies = engine.table.lifts and self.tied and not model.uniform_units
        self.lift = lift(model, engine.shares) if self.lift_varies else np.ones(model.n)  # (n,) diagonal of D^-1
        self.table = self._table()
        self.stages_of = lru_cache(maxsize=1)(self._stages)
        self._begin_sums()

    def _begin_sums(self):
        """Set all that belongs to one objective to zero."""
        self.sweep = self._empty_sweep()
        self.lift_adjoint = np.zeros(self.model.n)
        self.pending = Pending()  # multipliers of stages that are not yet added to the totals
        self.entries = []  # (time, AdjointMultipliers) of single states that are not

    def _empty_sweep(self):
        """A Sweep whose adjoints are zero."""
        n, m, s = self.model.n, self.model.m, self.settings.stages
        products = np.zeros((3, s, n)) if self.table.products is None else self.table.products.reshape(3, s, n)
        return Sweep(np.zeros((2, n)), np.zeros((2, n)), np.zeros((s, n)), np.zeros((s, m)), products)

    def beside(self, run, objective):
        """The sweep for another objective, which shares the stages and the factors with this one."""
        other = super().beside(run, objective)
        other.table = self.table.beside()
        other._begin_sums()
        return other

    def _table(self):
        """The table of the model: with stored factors or compiled if it can be, else an exact one."""
        model, W, tied = self.model, self.tableau.W.T, self.tied
        if model.velocity_rows.size:
            return self._exact()
        if isinstance(self.engine.table, DenseStages):
            return DenseAdjoint(self.engine.table, W, W @ W, self.counts, self.lift, tied)
        if not model.compiled or self.settings.linear == "kkt":
            return self._exact()
        from polyida.adjoint.scene_table import EXACT, SceneAdjoint

        def factor(t, q, v, a, lam, h):
            """The factors of all modes of the tableau for steps of h, made at one state."""
            factors, self.counts.backend = factors_of_modes(model, self.tableau.modes, h, np.concatenate([[t], q, v, a, lam]))
            return [x for x in factors.values() if x]

        modes = [(mode.row.copy(), mode.column.copy()) for mode in self.tableau.modes]
        return SceneAdjoint(model, W, W @ W, modes, factor, EXACT, self.counts, tied)

    def _exact(self):
        """The table that factors the whole equations of each step."""
        W = self.tableau.W.T
        return ExactSteps(self.model, W, W @ W, self.counts, self.lift, self.tied)

    def _states(self, first, end):
        """The States with numbers first to end - 1."""
        return States(*(np.ascontiguousarray(x, float) for x in self.history.states(first, end)))

    def stretches_backward(self, sweeps):
        """Sweep backward over one stretch after the other; yield the time at the beginning of each.

        The generator's value (StopIteration.value) is a list with the adjoints of q, v, a and lam of the run's first state for each objective.
        """
        together = int(max(1, min(self.engine.most, CHUNK // (8 * self.model.n * self.settings.stages))))
        longest = 1 if self.single_steps else together
        for segment in reversed(self.history.segments):
            for end in range(segment.first + segment.count, segment.first, -longest):
                for sweep in sweeps:
                    t = sweep._steps(segment, max(segment.first, end - longest), end)
                    if sum(len(part.t) for part in sweep.pending.equations) >= together:
                        sweep._flush()
                yield t
        for sweep in sweeps:
            sweep._flush()
        return [(*sweep.sweep.adjoints, np.zeros(self.model.n), np.zeros(self.model.m)) for sweep in sweeps]

    def _steps(self, segment, first, end):
        """Sweep backward over the steps from state number `first` to `end`. Returns the time of the first.

        1. Solve the stages again. 2. The objective's slopes at the ends of steps. 3. Sweep. 4. Store the multipliers. 5. Beside a kink: go
        back through the projection of the state from which the first step begins.
        """
        model, h, adjoints = self.model, segment.h, self.sweep.adjoints
        begin, kink, states, stages = self.stages_of(segment, first, end)
        slopes = self._objective_slopes(states, first, end, h)
        stage_q = states.q[:-1, None] + self.tableau.c[:, None] * h * states.v[:-1, None] + stages.e
        stage_v = states.v[:-1, None] + stages.dv
        if self.moves_v:
            self._project_end(states, stages, slopes, stage_q, stage_v)
            slopes = Slopes(*np.zeros((2, 0, model.n)))
        out = self._swept(h, slopes, states, stages, stage_q, stage_v)
        self._store_multipliers(states, stages, stage_q, stage_v, h, out)
        if self.events.speeds:
            self.events.add_step_slope(segment, float(out.slopes.sum()))
        if kink:
            adjoints[:] = self._projection_adjoints(begin, beside(begin.t, 1), adjoints)
        return begin.t

    def _project_end(self, states, stages, slopes, stage_q, stage_v):
        """Form "index3": add the slopes at a step's end to its adjoints, and go back through the projection of the last stage's v."""
        adjoints = self.sweep.adjoints
        adjoints[:] = adjoints[0] + slopes.q.sum(axis=0), adjoints[1] + slopes.v.sum(axis=0)
        last = State(float(states.t[-1]), stage_q[-1, -1], stage_v[-1, -1], stages.a[-1, -1], stages.lam[-1, -1])
        adjoints[:] = self._projection_adjoints(last, float(stages.t[-1, -1]), adjoints)

    def _stages(self, segment, first, end):
        """(first State, True if it is at a kink, States, Stages) of the steps from state number `first` to `end`."""
        states = self._states(first, end + 1)
        begin = states.state(0)
        kink = first == segment.first and at_kink(self.model, begin.t)
        if kink:  # the first step begins from the state after the kink
            states = States(*(x.copy() for x in states))
            start = step_start_state(self.model, begin)
            states.q[0] = start.q
            states.v[0] = start.v
            states.a[0] = start.a
            states.lam[0] = start.lam
        return begin, kink, states, self._solved(states, segment.h)

    def _objective_slopes(self, states, first, end, h):
        """The objective's Slopes at the ends of steps, (steps, n) each; those in a and lam are converted to q and v."""
        own = self.objective_slopes.at_states(first + 1, end + 1)
        if self.events.speeds and (by_time := own.by_time()) is not None:
            self.events.add_at(states.t[1:], by_time)
        q, v = (np.zeros((0, self.model.n)) if x is None else np.array(x, float) for x in (own.q, own.v))
        if own.a is not None or own.lam is not None or self.moves_v:
            q, v = (x if len(x) else np.zeros((end - first, self.model.n)) for x in (q, v))
        for k in range(end - first):
            adjoints = [None if x is None or not x[k].any() else x[k] for x in (own.a, own.lam)]
            if any(adjoint is not None for adjoint in adjoints):
                t = inner_side(self.model, float(states.t[k + 1]), h)
                q[k], v[k] = self._reverse(states.state(k + 1), partial(_accelerations, t), adjoints, (q[k], v[k]))
        return Slopes(q, v)

    def _solved(self, states, h):
        """The Stages of steps of h between states. Raises StepFailure."""
        engine, count, s, n, m = self.engine, len(states.t) - 1, self.settings.stages, self.model.n, self.model.m
        engine.limits = time_limits(self.model, float(states.t[0]), float(states.t[-1]))
        first = states.state(0)
        control = Control(False, h, h, np.inf, np.inf, np.inf, new_control(float(states.t[0])))
        engine.start_from(first)
        method = engine.method()._replace(moves_v=False, has_guess=True)
        number = engine.table.begin(engine, first, control, states.t[1:])
        sizes = (), (n,), (n,), (n,), (m,), (m if self.tied else 0,)  # of the fields of Stages
        out = Stages(*(np.empty((count, s, *size)) for size in sizes))
        done, fresh = 0, False
        while done < count:
            engine.done[:] = 0
            before = replace(self.counts)
            at_work = engine.table.functions, engine.table.workspace, number, method, engine.arrays, control.now
            done, ended = solve_stages(*at_work, h, fresh, states, done, out)
            engine.table.raise_error()
            vars(self.counts).update(engine.counts_at(before, engine.done[None], 0))
            fresh = ended == loop.MAKE
            failure = None
            try:
                if ended in (loop.MAKE, loop.RESTORE):
                    engine.make(control, fresh)
                elif ended != DONE:
                    failure = StepFailure(*REASONS[ended], float(states.t[done + 1]))
            except StepFailure as singular:
                failure = singular
            if failure:
                self._solve_fully(states, done, h, out, failure)
                done += 1
        return out

    def _solve_fully(self, states, k, h, out, failure):
        """Solve the stages of step k by Newton's full method, for steps where the simplified one does not converge. Raises `failure`.

        The initial guess is that of `initial_stages`; the results are the entries k of the Stages `out`.
        """
        x, full, W = self.engine.trial, self._exact(), self.tableau.W
        full.scale(h)
        initial_stages(self.tableau.c, h, states, k, x)
        out.t[k] = [self.engine.clamp(float(states.t[k]) + c * h) for c in self.tableau.c]
        changes = None
        for _ in range(MAX_ITERATIONS):
            q = states.q[k] + self.tableau.c[:, None] * h * states.v[k] + x.e
            dv = W @ x.e / h
            if self.tied:
                dv += [self.lift * (dense(self.model.phi_q(*at)).T @ mu) for *at, mu in zip(out.t[k].tolist(), q, x.mu)]
            out.e[k] = x.e
            out.dv[k] = dv
            out.a[k] = W @ dv / h
            out.lam[k] = x.lam
            out.mu[k] = x.mu
            if changes is not None and np.abs(changes[0]).max() <= CONVERGED * extent(self.model, states.q[k]):
                return
            changes = full.newton(out.t[k], q, states.v[k] + dv, out.a[k], x.lam, x.mu)
            for part, change in zip((x.e, x.lam, x.mu), changes):
                part -= change
        raise failure

    def _swept(self, h, slopes, states, stages, stage_q, stage_v):
        """The SweepOutput of the steps; the adjoints become those of the first state."""
        count, s, _ = stage_q.shape
        multipliers = np.zeros((count, 1 + self.tied, s, self.model.m))
        out = SweepOutput(np.zeros(stage_q.shape), np.empty(stage_q.shape), multipliers, np.empty(count))
        at_stages = stages.t, stage_q, stage_v, stages.a, stages.lam, stages.mu
        steps = Steps(h, self.tableau.c, self.tableau.W, states, stages, slopes)

        def exact_table():
            """A table with a factor of each step, at the same stages."""
            exact = self._exact()
            exact.scale(h)
            exact.set_states(*at_stages)
            return exact

        self.table.scale(h)
        self.table.set_states(*at_stages)
        sweep_with_fallback(self.table, exact_table, count, lambda *at: sweep_back(*at, steps, self.sweep, out))
        return out

    def _store_multipliers(self, states, stages, stage_q, stage_v, h, out):
        """Store the multipliers of the steps, and add their part of the adjoint of D^-1."""
        stage_count = stages.t.size
        at = stages.t.ravel(), *(_flat(x, stage_count) for x in (stage_q, stage_v, stages.a, stages.lam))  # t, q, v, a, lam of all stages
        mu, *kappa = np.moveaxis(out.multipliers, 1, 0)
        of_d = out.v
        if self.model.velocity_rows.size:
            rates = _flat(states.v[:-1, None] + self.tableau.W @ stages.e / h, stage_count)
            mu, of_d = self._store_velocity_rows(at, rates, mu, of_d)
        self.pending.equations.append(AdjointMultipliers(*at, *(_flat(x, stage_count) for x in (out.w, mu, *kappa))))
        if self.tied:
            self._store_lift(at, _flat(self.lift * of_d, stage_count), _flat(stages.mu, stage_count))
            self.lift_adjoint += np.sum((stages.dv - self.tableau.W @ stages.e / h) / self.lift * of_d, axis=(0, 1))

    def _store_velocity_rows(self, at, rates, mu, of_d):
        """Store the multipliers of the velocity rows psi. Returns mu without them, and the adjoint of v without B^T of them.

        psi is a function of q and the rates `v_0 + W e / h` (stages, n), not of v. at: t, q, v, a, lam of all stages; mu (count, s, m), of_d
        (count, s, n): mu* and v*.
        """
        t, q, _, _, lam = at
        rows = self.model.velocity_rows
        of_psi = np.zeros_like(mu)
        of_psi[..., rows] = mu[..., rows]
        factors = _flat(of_psi, len(t))
        zero, no_lam = np.zeros_like(q), np.zeros_like(lam)
        self.pending.velocity_rows.append(AdjointMultipliers(t, q, rates, zero, no_lam, w=zero, kappa=factors))
        pulls = [dense(self.model.phi_q(time, place)).T @ factor for time, place, factor in zip(t.tolist(), q, factors)]
        return mu - of_psi, of_d - np.reshape(pulls, of_d.shape)

    def _store_lift(self, at, pushed, mu):
        """Store the multipliers of the terms D^-1 B^T mu of v, as a rate of phi.

        at: t, q, v, a, lam of all stages. pushed (stages, n): D^-1 v*, in place of the velocities; mu (stages, m): in place of kappa.
        """
        t, q, _, _, lam = at
        zero, no_lam = np.zeros_like(q), np.zeros_like(lam)
        self.pending.lifted.append(AdjointMultipliers(t, q, pushed, zero, no_lam, w=zero, kappa=mu))
        if self.model.needs.driven:  # the rate is phi_q v + phi_t: without phi_t
            self.pending.driven.append(AdjointMultipliers(t, q, zero, zero, no_lam, w=zero, kappa=-mu))

    def _projection_adjoints(self, state, t, adjoints):
        """Adjoints of q and v of a state, from those after v is projected onto the constraint at time t."""
        return self._reverse(state, lambda model, q, v: (on_velocity(model, t, q, v),), adjoints[1:], (adjoints[0], np.zeros(self.model.n)))

    def _reverse(self, state, function, adjoints, more):
        """Adjoints (of q, of v) of a state: `more` plus those that come back from `adjoints` of the results of `function(model, q, v)`."""
        of_q, of_v, entries = pulled_back(self.model, state, function, adjoints)
        self.entries += [(state.t, entry) for entry in entries]
        return of_q + more[0], of_v + more[1]

    def first_state_adjoint(self):
        """The adjoint of the first q by D, which is evaluated there; its entries are added to the totals."""
        if not self.lift_varies or not self.lift_adjoint.any():
            return 0.0
        adjoint, entries = inverse_mass_adjoints(self.model, self.first, self.lift, self.lift_adjoint)
        self.entries += [(entry.t, entry) for entry in entries]
        self._flush()
        return adjoint

    def _flush(self):
        """Add the stored multipliers to the totals."""
        self.pending.add_to_totals(self.add)
        self.add(stacked([entry for _, entry in self.entries]), np.array([t for t, _ in self.entries]))
        self.entries = []


def _accelerations(t, model, q, v):
    """(a, lam) of a state at time t."""
    return consistent_acceleration(model, t, q, v)


def _flat(array, count):
    """An array (steps, s, .) as (count, .), one row for each stage; count = steps s."""
    return array.reshape(count, array.shape[-1])


def inverse_mass_adjoints(model, state, lift, adjoint):
    """(adjoint of q (n,), entries for parameters) of the state at which D^-1, `lift`, is evaluated, from the adjoint (n,) of its diagonal.

    D is the diagonal of M over its mean at the start of the run: `D^-1_k = sum_j M_jj / (n M_kk)`, and 1 if M_kk is negligible.
    """
    masses = np.abs(model.mass(state.q).diagonal())
    heavy = masses > NOTHING * masses.max()
    over = np.where(heavy, adjoint / np.where(heavy, masses, 1.0), 0.0)
    slopes = over.sum() / model.n - over * lift
    zero, rows, entries = np.zeros(model.n), np.zeros(model.m), []
    for unit, slope in zip(np.eye(model.n), slopes):
        for a, w in ((unit, slope * unit), (zero, -slope * unit)):
            entries.append(AdjointMultipliers(state.t, state.q, zero, a, rows, w, rows, rows, rows))
    if not model.needs.mass_varies:
        return zero, entries
    return jacobian(lambda q: np.array([slopes @ model.mass(q).diagonal()]), state.q, 1)[0], entries
