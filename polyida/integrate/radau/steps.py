"""Steps of Radau IIA on one model: calls of the compiled driver, new factors when it needs them, and States from its results.

radau/pieces.py takes fixed and adaptive steps of a smooth piece of a run by `Steps`: `begin` restores the factors and the norm of a state's
memory, `start_from` the stages of its last step, and `_stretches` repeats

1. the compiled loop (radau/loop.py), until its record is full or it asks for a factor;
2. the accepted steps as States (radau/accepted.py), and the counts;
3. the factor that it asked for (`make`), or StepFailure.
"""

from dataclasses import replace
from functools import partial
from weakref import WeakValueDictionary

import numpy as np

from polyida.clock import loading
from polyida.errors import DONE, REFACTOR, StepFailure
from polyida.integrate.radau import loop, step_arrays
from polyida.integrate.radau.accepted import StretchData, StretchStates
from polyida.integrate.radau.matrices import Matrices, WholeModes, lift
from polyida.integrate.radau.tableau import radau
from polyida.integrate.radau.tables.python import table_of
from polyida.integrate.sizes import ROUND_OFF, weights
from polyida.integrate.start import start_values
from polyida.linear.lu import SingularSystem
from polyida.system import ACCELERATION, STEPS

COUNTED = "residuals", "newton_iterations", "solves", "rejected", "tangents", "factorizations"
CHUNK = 4_000_000  # largest size of the record of a stretch, bytes


def new_control(t, level=0.0):
    """The array Control.now, (6,), before the first step from time t, s; level: of the step size."""
    return np.array([level, t, 0.0, 0.0, 0.0, 0.0])


class Steps:
    """The method on one model. `begin` starts from a state; `step`, `take_fixed` and `take_adaptive` continue.

    sizes: the model's (length, speed, time, lengths) for tolerances; run: [begin, end] of the run, stored in the memory of states. limits: set by
    the caller for each piece. state and factor_states change with each call of the compiled loop.
    """

    def __init__(self, settings, model, counts, sizes, run=None):
        """Make the arrays and the table of a model."""
        self.settings = settings
        self.model = model
        self.counts = counts
        self.sizes = sizes
        self.run = run
        self.tableau = radau(settings.stages)
        self.limits = -np.inf, np.inf  # bounds of the model's times, beside kinks
        rows_vary = model.m > 0 and (model.needs.phi_q_varies or model.needs.driven)
        self.tied = settings.form == "ggl" and rows_vary
        self.moves_v = (settings.form == "ggl" or settings.project) and (rows_vary or (model.compiled and model.m > 0))
        self.estimates_error = settings.adaptive or settings.tolerance is None  # the local error is computed
        self.table = _table(settings, model, self.tableau, self.tied)
        self.memory, self.trial, self.scratch = step_arrays.empty(settings.stages, model.n, model.m, self.tied)
        self.slots = loop.FactorSlots(np.zeros((5, loop.SLOTS)), np.zeros((loop.SLOTS, 1 + 3 * model.n + model.m)))
        self.state = None  # the State that `memory` holds, None while it may hold another
        self.factor_states = None  # copy of slots.states that the States of a stretch share; None if it must be copied again
        self.done = np.zeros(loop.COUNTS, np.int64)  # work of the last call of the loop: residuals, ...
        tableau = step_arrays.compiled_tableau(self.tableau)
        self.arrays = step_arrays.Arrays(tableau, self.memory, self.trial, self.scratch, self.slots, self.done)
        most = CHUNK // (8 * max(1, (4 * settings.stages + 5) * model.n))
        self.most = max(1, min(STEPS, most, 1 if model.switching else STEPS))

    @property
    def longest(self):
        """Largest number of steps of a stretch."""
        return min(self.most, self.table.longest, self.model.longest_stretch)

    @property
    def shares(self):
        """Shares of the coordinates in the mass, (n,)."""
        return self.memory.shares

    def begin(self, state):
        """Restore the memory of a state and nothing else: the norm's weights, Newton's contraction, the factors."""
        memory, model, table = state.memory, self.model, self.slots.table
        shares = memory.get("radau_shares")
        self.memory.shares[:] = self.memory.places[:] = weights(model, state.q) if shares is None else shares
        self.memory.places[model.hidden] = 0.0
        if self.tied and self.table.lifts:
            self.table.set_lift(lift(model, self.shares))
        self.table.evaluate_constants(state.t, state.q)
        table[:] = 0.0
        self.state = self.factor_states = None
        measured = "newton" in memory and "switched" not in memory  # behind a switch the equations are others
        self.memory.marks[[step_arrays.CONTRACTION, step_arrays.AGE]] = memory["newton"] if measured else step_arrays.UNKNOWN
        if "newton" in memory:
            for slot, (row, price) in enumerate(zip(memory["factored"], np.reshape(memory["prices"], (-1, 3)))):
                table[[loop.H, loop.EXTRA, loop.LEAST, loop.USED], slot] = [*price, slot + 1.0]
                self.slots.states[slot] = row[1:]

    def clamp(self, t):
        """The time t, or the nearest of `limits` if it is outside."""
        return float(min(max(t, self.limits[0]), self.limits[1]))

    def start_from(self, state):
        """Start from a state, unless it is the state reached last."""
        if state is self.state:
            return
        start, memory, model = self.memory, state.memory, self.model
        known = "stages_e" in memory
        a_end = memory.get("a_end")
        start.q[:], start.v[:] = state.q, state.v
        start.a[:] = state.a if a_end is None else a_end  # state.a may not be computed yet
        start.lam[:] = memory["stages_lam"][-1] if "stages_lam" in memory else state.lam
        if known:
            start.stages_v[:], start.stages_lam[:] = memory["stages_v"], memory["stages_lam"]
        start.marks[step_arrays.LAST], start.marks[step_arrays.ERROR] = memory["step"] if known else 0.0, memory.get("error", -1.0)
        start.marks[step_arrays.MISSES :] = memory.get("misses", 0.0) if known else 0.0
        if start.marks[step_arrays.MISSES]:
            start.miss_e[:], start.miss_lam[:], start.mu[:] = memory["miss_e"], memory["miss_lam"], memory["mu"]
        if model.has_constraint_increments:
            start.phi_start[:] = start_values(model, state, self.clamp(state.t))
        self.state = state

    def method(self):
        """The numbers of the method for the compiled loop."""
        settings, model, sizes = self.settings, self.model, self.sizes
        rtol, atol = (settings.relative(sizes), settings.absolute(sizes)) if settings.adaptive else (0.0, 0.0)
        form = {"tied": self.tied, "by_increments": bool(model.has_constraint_increments), "moves_v": self.moves_v, "has_guess": False}
        errors = {"estimates_error": self.estimates_error, "rtol": rtol, "atol": atol, "length": float(sizes[0])}
        newton = {"tolerance": float(settings.tolerance or 0.0), "max_iterations": settings.max_iterations, "renewal": self.table.renewal}
        newton["share"] = min(loop.SHARE, rtol**loop.ERROR_POWER) if settings.adaptive else 0.0
        of_model = {"extent": float(model.extent or 1.0), "least": ROUND_OFF * float(sizes[0]), "velocity_rows": model.velocity_rows}
        return step_arrays.Method(low=float(self.limits[0]), high=float(self.limits[1]), **form, **errors, **newton, **of_model)

    def step(self, state, h, t):
        """The State at t after one step of h. Raises StepFailure."""
        control = loop.Control(False, h, h, np.inf, np.inf, np.inf, new_control(state.t))
        end = next(self._stretches(state, control, np.array([t])))
        vars(self.counts).update(end.spent)
        return end.last

    def take_fixed(self, state, grid):
        """Yield stretches of the states at the remaining ends of a grid. Raises StepFailure."""
        while grid.done < grid.count:
            ends = grid.times(grid.done, min(grid.done + self.longest, grid.count))[1:]
            control = loop.Control(False, grid.h, grid.h, np.inf, np.inf, np.inf, new_control(state.t))
            for states in self._stretches(state, control, ends, _memory_of_grid(grid)):
                self.counts.steps += len(states)
                yield states
                state = states.last
            grid = grid._replace(done=grid.done + len(ends))

    def take_adaptive(self, state, control, position_memory):
        """Yield stretches of states up to control.end. Raises StepFailure.

        position_memory: function (steps before the stretch, number k in it, level) -> further memory of state k.
        """
        while state.t < control.end:
            for states in self._stretches(state, control, np.zeros(0), position_memory):
                self.counts.steps += len(states)
                yield states
                state = states.last

    def _stretches(self, state, control, ends, position_memory=lambda taken, k, level: {}):
        """Yield one stretch, or several between which factors are made. Raises StepFailure.

        self.state is the last State while the caller has the stretch; the counts are set when the caller asks for the next one. ends: times of
        the ends of fixed steps, empty for adaptive ones. position_memory: function (steps taken before a stretch, number in it, level) -> memory.
        """
        table, method = self.table, self.method()
        self.start_from(state)
        count = len(ends) or self.longest  # steps to take
        taken = 0  # steps taken
        fresh = False  # True if the factor is made for the next step
        first = table.begin(self, state, control, ends)
        while True:
            log = self._empty_record(count, control, ends[taken:])
            begin = state.t, state.q, state.v
            misses = {name: getattr(self.memory, name).copy() for name in ("miss_e", "miss_lam", "mu")}
            accepted, ended = self._one_call(first, method, control, fresh, log)
            self.state = None
            before = replace(self.counts)
            if accepted:
                states = StretchStates(self._data(log, begin, misses, before, partial(position_memory, taken)), range(accepted))
                self.state = state = states.last
                yield states
            vars(self.counts).update(self.counts_at(before, self.done[None], 0))
            self.state = self.state or state
            if self.done[step_arrays.FACTORS]:
                self.factor_states = None
            taken += accepted
            count -= accepted
            first += accepted * (self.settings.stages + 1) * table.prepared
            table.raise_error()
            if ended == DONE and (not count or control.adaptive):
                return
            if ended != DONE:
                fresh = self._prepare_next(ended, control)

    def _empty_record(self, count, control, ends):
        """The Record that the next call fills, for `count` steps, and a copy of the states of the factors; ends: times of fixed steps."""
        log = loop.record(count, self.settings.stages, self.model.n, self.model.m, self.tied)
        if self.factor_states is None:
            self.factor_states = self.slots.states.copy()
        if not control.adaptive:
            log.t[:] = ends
        return log

    def _one_call(self, first, method, control, fresh, log):
        """(steps accepted, how it ended) of one call of the compiled loop, from the instant `first`, which fills the record `log`."""
        self.done[:] = 0
        control.now[loop.REMAINING] = control.most_steps - self.counts.steps - self.counts.rejected
        with self.table.timed():
            return loop.take_steps(self.table.functions, self.table.workspace, first, method, self.arrays, control, fresh, log)

    def _prepare_next(self, ended, control):
        """Make the factors that a call asked for when it ended. Returns True if they are new ones for the next step. Raises StepFailure."""
        if ended in (loop.MAKE, loop.RESTORE):
            self.make(control, ended == loop.MAKE)
        elif ended != loop.PAUSE:
            raise self._failure(ended, control)
        return ended == loop.MAKE

    def _data(self, log, begin, misses, before, position_memory):
        """The StretchData of a stretch; before: the counts at its start."""
        model = self.model
        return StretchData(
            record=log,
            begin=begin,
            misses_before=misses,
            c=self.tableau.c,
            factor_states=self.factor_states,
            by_increments=bool(model.has_constraint_increments),
            memory=self.run_memory | ({"radau_shares": self.shares.copy()} if model.needs.mass_varies else {}),
            position_memory=position_memory,
            motion=None if self.table.functions[ACCELERATION] else (model, self.clamp),
            counts_at=partial(self.counts_at, before, log.counts),
            states=WeakValueDictionary(),
        )

    def counts_at(self, before, done, k):
        """{name: count} at step k, without steps: `before`, and the work of the stretch up to k."""
        residuals, iterations, solves, factors, rejected = map(int, done[k])
        more = residuals, iterations, solves, rejected, factors, factors * len(self.tableau.modes)
        return {name: getattr(before, name) + count for name, count in zip(COUNTED, more)}

    @property
    def run_memory(self):
        """The part of the memory that all states of a run share."""
        return {"sizes": self.sizes} | ({} if self.run is None else {"run": self.run})

    def make(self, control, new):
        """Make the factors of the attempted step: new ones, or the stored ones of this step again."""
        h, t, table = float(control.now[loop.STEP]), self.clamp(control.now[loop.TIME]), self.slots.table
        slot = int(np.argmax(table[loop.H] == h))
        if new:
            slot, self.factor_states = loop.reserve_slot(self.slots, h, t, self.memory), None
            self.counts.tangents += 1
            self.counts.factorizations += len(self.tableau.modes) if self.settings.linear != "kkt" else 0  # whole ones are with their rows
        try:
            self.table.make(slot, h, self.slots.states[slot].copy(), self.counts)
        except SingularSystem as error:
            table[loop.H, slot] = table[loop.USED, slot] = 0.0
            raise StepFailure("singular", str(error), float(control.now[loop.TARGET])) from None
        if self.table.single:
            table[loop.READY] = 0.0
        table[loop.READY, slot] = 1.0

    def _failure(self, ended, control):
        """The StepFailure of the attempted step."""
        t, seen = float(control.now[loop.TARGET]), {}
        if ended in (loop.STEP_TOO_SHORT, loop.TOO_MANY_STEPS):
            return StepFailure("stuck" if ended == loop.STEP_TOO_SHORT else "too many steps", "", float(control.now[loop.TIME]))
        if ended == REFACTOR:
            seen = {
                "last |dq|": float(self.scratch.progress[step_arrays.MOVED]),
                "contraction": float(self.scratch.progress[step_arrays.SPEED]),
            }
        return StepFailure(*self.table.end_reason(ended, self, control), t, **seen)


def _memory_of_grid(grid):
    """The function (steps taken, number k in the stretch, level) -> memory of the fixed steps of a grid, as of `_stretches`."""

    def grid_memory(taken, k, level):
        """{"radau_grid": what is left of the grid behind step k}."""
        return {"radau_grid": grid.after(grid.done + taken + k + 1)}

    return grid_memory


def _table(settings, model, tableau, tied):
    """The table of a model for the settings' linear algebra."""
    if model.compiled and settings.linear != "kkt":
        with loading:
            from polyida.integrate.radau.tables.scene import SceneStages

        return SceneStages(model, tableau, tied)
    kind = partial(WholeModes, scaling=settings.scaling) if settings.linear == "kkt" else Matrices
    return table_of(model, settings.linear, tableau, tied, kind)
