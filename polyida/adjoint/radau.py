"""Backward sweep over a run of Radau IIA: compiled for stretches of equal steps (radau_sweep.py), on a tape between them and at the
start.
"""

from dataclasses import replace
from functools import lru_cache

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


class RadauAdjoint(RunAdjoint):
    """Backward sweep over a run."""

    history_of = staticmethod(step_history)

    def __init__(self, run, objective, names, memory_limit):
        """Make the engine that solves the stages again, and the table of the sweep."""
        super().__init__(run, objective, names, memory_limit)
        model, settings = self.model, self.settings
        self.first = self._states(0, 1).state(0)
        self.engine = engine = exact_steps(model, settings, self.first, float(run.t[-1]), self.counts)
        self.tableau, self.tied = engine.tableau, engine.tied  # tied: True if there is mu
        # each step is swept alone if v is projected at its end
        self.single_steps = settings.form == "index3" and model.m > 0 and (model.needs.phi_q_varies or model.needs.driven)
        self.moves_v = self.single_steps and settings.project
        self.lift_varies = engine.table.lifts and self.tied and not model.uniform_units
        self.lift = lift(model, engine.shares) if self.lift_varies else np.ones(model.n)  # (n,) diagonal of D^-1
        self.table = self._table()
        self.stages = lru_cache(maxsize=1)(self._stages)
        self._begin_sums()

    def _begin_sums(self):
        """Set all that belongs to one objective to zero."""
        self.sweep = self._empty_sweep()
        self.lift_adjoint = np.zeros(self.model.n)
        self.pending = [], [], [], []  # multipliers that are not yet added to the totals
        self.entries = []  # (time, entry) of single states that are not

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
        """Sweep over one stretch after the other and yield its time; return the adjoints of q, v, a and lam of the run's first state for
        each objective.
        """
        together = int(max(1, min(self.engine.most, CHUNK // (8 * self.model.n * self.settings.stages))))
        longest = 1 if self.single_steps else together
        for segment in reversed(self.history.segments):
            for end in range(segment.first + segment.count, segment.first, -longest):
                for sweep in sweeps:
                    t = sweep._steps(segment, max(segment.first, end - longest), end)
                    if sum(len(x.t) for x in sweep.pending[0]) >= together:
                        sweep._flush()
                yield t
        for sweep in sweeps:
            sweep._flush()
        return [(*sweep.sweep.adjoints, np.zeros(self.model.n), np.zeros(self.model.m)) for sweep in sweeps]

    def _steps(self, segment, first, end):
        """Sweep backward over the steps from state number `first` to `end`. Returns the time of the first."""
        model, h, adjoints = self.model, segment.h, self.sweep.adjoints
        begin, kink, b, x = self.stages(segment, first, end)
        slopes = self._objective_slopes(b, first, end, h)
        q, v = b.q[:-1, None] + self.tableau.c[:, None] * h * b.v[:-1, None] + x.e, b.v[:-1, None] + x.dv
        if self.moves_v:  # in form "index3" the last stage's v is moved onto its constraint
            adjoints[:] = adjoints[0] + slopes.q.sum(axis=0), adjoints[1] + slopes.v.sum(axis=0)
            slopes = Slopes(*np.zeros((2, 0, model.n)))
            last = State(float(b.t[-1]), q[-1, -1], v[-1, -1], x.a[-1, -1], x.lam[-1, -1])
            adjoints[:] = self._projection_adjoints(last, float(x.t[-1, -1]), adjoints)
        out = self._swept(h, slopes, b, x, q, v)
        self._store_multipliers(b, x, q, v, h, out)
        if self.events.speeds:
            self.events.add_step_slope(segment, float(out.slopes.sum()))
        if kink:
            adjoints[:] = self._projection_adjoints(begin, beside(begin.t, 1), adjoints)
        return begin.t

    def _stages(self, segment, first, end):
        """(first State, True if it is at a kink, States, Stages) of the steps of a segment from state number `first` to number `end`.

        The first State is the stored one. If the segment begins at a kink, States has in its place that of the far side of the kink, from
        which the steps go; States has end - first + 1 states, and Stages those of the end - first steps, solved again.
        """
        b = self._states(first, end + 1)
        begin = b.state(0)
        kink = first == segment.first and at_kink(self.model, begin.t)
        if kink:  # the first step begins from the state of the far side
            b = States(*(x.copy() for x in b))
            far = step_start_state(self.model, begin)
            b.q[0], b.v[0], b.a[0], b.lam[0] = far.q, far.v, far.a, far.lam
        return begin, kink, b, self._solved(b, segment.h)

    def _objective_slopes(self, b, first, end, h):
        """The objective's Slopes at the ends of steps; those in a and lam are converted to q and v."""
        own = self.objective_slopes.at_states(first + 1, end + 1)
        if self.events.speeds and (by_time := own.by_time()) is not None:
            self.events.add_at(b.t[1:], by_time)
        q, v = (np.zeros((0, self.model.n)) if x is None else np.array(x, float) for x in (own.q, own.v))
        if own.a is not None or own.lam is not None or self.moves_v:
            q, v = (x if len(x) else np.zeros((end - first, self.model.n)) for x in (q, v))
        for k in range(end - first):
            adjoints = [None if x is None or not x[k].any() else x[k] for x in (own.a, own.lam)]
            if any(adjoint is not None for adjoint in adjoints):
                state, t = b.state(k + 1), inner_side(self.model, float(b.t[k + 1]), h)
                function = lambda model, q, v, t=t: consistent_acceleration(model, t, q, v)  # noqa: E731
                q[k], v[k] = self._reverse(state, function, adjoints, (q[k], v[k]))
        return Slopes(q, v)

    def _solved(self, b, h):
        """The Stages of steps of h between states. Raises StepFailure."""
        engine, count, s, n, m = self.engine, len(b.t) - 1, self.settings.stages, self.model.n, self.model.m
        engine.limits = time_limits(self.model, float(b.t[0]), float(b.t[-1]))
        control, first = Control(False, h, h, np.inf, np.inf, np.inf, new_control(float(b.t[0]))), b.state(0)
        engine.start_from(first)
        method = engine.method()._replace(moves_v=False, has_guess=True)
        number, done, fresh = engine.table.begin(engine, first, control, b.t[1:]), 0, False
        sizes = (), (n,), (n,), (n,), (m,), (m if self.tied else 0,)
        out = Stages(*(np.empty((count, s, *size)) for size in sizes))
        while done < count:
            engine.done[:], before = 0, replace(self.counts)
            at_work = engine.table.functions, engine.table.workspace, number, method, engine.arrays, control.now
            done, ended = solve_stages(*at_work, h, fresh, b, done, out)
            engine.table.raise_error()
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
        """Solve the stages of step k by Newton's full method, if the simplified one does not converge from this initial guess. Raises
        `failure`.
        """
        x, full, W = self.engine.trial, self._exact(), self.tableau.W
        full.scale(h)
        initial_stages(self.tableau.c, h, b, k, x)
        out.t[k] = [self.engine.clamp(float(b.t[k]) + c * h) for c in self.tableau.c]
        changes = None
        for _ in range(MAX_ITERATIONS):
            q, dv = b.q[k] + self.tableau.c[:, None] * h * b.v[k] + x.e, W @ x.e / h
            if self.tied:
                dv += [self.lift * (dense(self.model.phi_q(*state)).T @ mu) for *state, mu in zip(out.t[k].tolist(), q, x.mu)]
            for part, value in zip(out[1:], (x.e, dv, W @ dv / h, x.lam, x.mu)):
                part[k] = value
            if changes is not None and np.abs(changes[0]).max() <= CONVERGED * extent(self.model, b.q[k]):
                return
            changes = full.newton(out.t[k], q, b.v[k] + dv, out.a[k], x.lam, x.mu)
            for part, change in zip((x.e, x.lam, x.mu), changes):
                part -= change
        raise failure

    def _swept(self, h, slopes, b, x, q, v):
        """The SweepOutput of the steps; the adjoints become those of the first state."""
        count, s, _ = q.shape
        out = SweepOutput(np.zeros(q.shape), np.empty(q.shape), np.zeros((count, 1 + self.tied, s, self.model.m)), np.empty(count))
        states, steps = (x.t, q, v, x.a, x.lam, x.mu), Steps(h, self.tableau.c, self.tableau.W, b, x, slopes)

        def exact_table():
            """A table with a factor of each step, at the same stages."""
            exact = self._exact()
            exact.scale(h)
            exact.set_states(*states)
            return exact

        self.table.scale(h)
        self.table.set_states(*states)
        sweep_with_fallback(self.table, exact_table, count, lambda *at: sweep_back(*at, steps, self.sweep, out))
        return out

    def _store_multipliers(self, b, x, q, v, h, out):
        """Store the multipliers of the steps, and add their part of the adjoint of D^-1."""
        flat = lambda *arrays: [each.reshape(x.t.size, each.shape[-1]) for each in arrays]  # noqa: E731
        mu, *kappa = np.moveaxis(out.multipliers, 1, 0)
        at = x.t.ravel(), *flat(q, v, x.a, x.lam)
        still, none, of_d = np.zeros_like(at[1]), np.zeros_like(at[4]), out.v
        if (rows := self.model.velocity_rows).size:
            of_psi = np.zeros_like(mu)
            of_psi[..., rows] = mu[..., rows]
            (u,), (factors,), mu = flat(b.v[:-1, None] + self.tableau.W @ x.e / h), flat(of_psi), mu - of_psi
            self.pending[3].append(AdjointMultipliers(*at[:2], u, still, none, still, None, factors))
            pulls = [dense(self.model.phi_q(t, q)).T @ kappa for t, q, kappa in zip(at[0].tolist(), at[1], factors)]
            of_d = of_d - np.reshape(pulls, of_d.shape)
        self.pending[0].append(AdjointMultipliers(*at, *flat(out.w, mu, *kappa)))
        if self.tied:
            pushed, factors = flat(self.lift * of_d, x.mu)
            self.pending[1].append(AdjointMultipliers(*at[:2], pushed, still, none, still, None, factors))
            if self.model.needs.driven:
                self.pending[2].append(AdjointMultipliers(*at[:2], still, still, none, still, None, -factors))
            self.lift_adjoint += np.sum((x.dv - self.tableau.W @ x.e / h) / self.lift * of_d, axis=(0, 1))

    def _projection_adjoints(self, state, t, adjoints):
        """Adjoints of q and v of a state, from those after v is projected onto the constraint at time t."""
        return self._reverse(state, lambda model, q, v: (on_velocity(model, t, q, v),), adjoints[1:], (adjoints[0], np.zeros(self.model.n)))

    def _reverse(self, state, function, adjoints, more):
        """(b_q, b_v) at a state: `more` plus the adjoints that come back through `function(model, q, v)`."""
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
        for parts in self.pending:
            if parts:
                self.add(AdjointMultipliers(*(None if x[0] is None else np.concatenate(x) for x in zip(*parts))))
        self.add(stacked([entry for _, entry in self.entries]), np.array([t for t, _ in self.entries]))
        self.pending = ([], [], [], [])
        self.entries = []


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
