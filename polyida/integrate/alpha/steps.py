"""Steps of generalized-alpha on one model: stretches of the compiled loop, and factors.

`Steps` calls the compiled loop (alpha/step.py). `begin` sets the state and h; then each `stretch` of states takes these steps:

1. `_prepare`: times, arrays of the frames, and what the model's table computes before, for as many steps as it takes at once.
2. `_factor_here`: the step matrix at the predicted end of the next step, if there is none.
3. `_steps`: the compiled loop, until these steps are done, h is to change, or it needs a factor that it cannot make.
4. `_refactor_or_fail`: a new factor for a step that failed with an old one. With a new one `_full_newton` makes a matrix in each iteration;
   if that fails too, StepFailure.

alpha/pieces.py takes fixed and adaptive steps of a smooth piece by it.
"""

from typing import NamedTuple

import numpy as np

from polyida.clock import loading
from polyida.environment import allocate
from polyida.errors import DONE, ERROR_LARGE, ERROR_SMALL, HALF_TURN, INVERTED, NOT_FINITE, REASONS, REFACTOR, SINGULAR, StepFailure
from polyida.integrate.alpha import step
from polyida.integrate.discontinuities import at_kink, inner_side
from polyida.integrate.engine import end_of_stretch
from polyida.integrate.sizes import extent, weights
from polyida.integrate.start import start_values
from polyida.integrate.state import State, Stretch
from polyida.linear.lu import FactorCache, SingularSystem
from polyida.system import INSTANTS
from polyida.system.own import PythonTable, small_table

ADAPTIVE = 128  # steps of a stretch if h may change
NEAR = 0.03  # of the model's extent: from the start of a step that goes farther Newton's method may find another motion
SHORTER, LONGER = "shorter", "longer"  # values of Steps.wanted_step


class Ended(NamedTuple):
    """How a call of the compiled loop ended that did not take all steps."""

    status: int  # a status of errors.py, not DONE
    new_factor: bool  # True if the factor was made for the step that failed
    t: float  # s: end of that step
    moved: float  # |dq| of its last iteration


class Steps:
    """Steps on one model.

    Order of calls: `begin`; `stretch` again and again, or `run`, until the grid ends or `wanted_step` is set; then `error` and `state`. A run that
    is resumed from a memory calls `restore_factor` before `begin`, and `recall` after it.

    recorder: its `begun(state, h)` is called at every beginning and `stepped(state)` for every state, of attempts that fail too; stretches then
    have one state. rows: a function of a count that returns arrays for so many frames, [q, v, a (count, n), lam (count, m)], or None.
    """

    chunk_bytes = 16_000_000  # of frames that one compiled stretch fills

    def __init__(self, settings, model, counts, control=None):
        """Make the arrays and the table of a model; control: the ErrorControl of adaptive steps, or None."""
        self.settings = settings
        self.model = model
        self.counts = counts
        self.control = control
        self.start, self.trial = step.empty(model.n, model.m)
        self.stabilised = settings.form == "stabilised" and model.m > 0
        self.incremental = settings.incremental_phi and model.has_constraint_increments
        self.table = table_of(settings, model, self.incremental, True)
        self.caution = self.table.system(settings).caution
        self.unknowns = self.table.unknowns
        self.system = None  # the factor in use
        self.factored_for = None  # its h
        self.reusable_factor = None  # a factor that the next one may overwrite
        self.factors = FactorCache()  # of adaptive steps
        self.method = None  # step.Method for the present h
        self.numbers = None  # (10,) numbers of a step for the model, see _numbers
        self.weighed = False  # True if the weights of norms are set
        self.wanted_step = None  # SHORTER or LONGER if adaptive steps should be
        self.ended = None  # Ended of the last step, to be handled before the next stretch; None if it was taken
        self.last = None  # the last State of the last stretch
        self.times = None  # (count + 1,) s: ends of the prepared steps, and the begin of the first one
        self.frames = None  # [q, v, a (count, n), lam (count, m)] that the prepared steps fill
        self.first = 0  # number of prepared steps that are taken
        self.count = 0  # number of prepared steps
        self.waiting = []  # stretches of one state that the recorder has not seen, last first
        self.recorder = None
        self.rows = _no_rows
        self.longest = INSTANTS  # steps of the next stretch of a model with switches
        self.pause = 0  # number of counted steps after which a stretch ends

    def begin(self, state, h, same_factor=False):
        """Go on with steps of h from a state that `started` returned, with the present factor or one for this h.

        memory["pause"]: the number of counted steps after which a stretch ends. memory["stretch"]: length of the next stretch of a model
        with switches; who takes the states writes it into the last one of a stretch.
        """
        self._limit_stretch(state.memory)
        self.pause = state.memory.get("pause", self.pause)
        model, control, start = self.model, self.control, self.start
        if not (same_factor and self.method and self.method.h == h):
            self.method = self._method_of(state, h)
            self.numbers = _numbers(self.method)
        start.q[:], start.v[:], start.a[:], start.a_alg[:] = state.q, state.v, state.a, state.memory["a_alg"]
        start.change[:] = start.earlier[:] = 0.0
        if control and control.before and not at_kink(model, state.t):  # for the error of the first step
            start.change[:] = state.memory.get("change", 0.0)
        start.lam[:] = state.lam
        start.phi[:], start.rate[:] = start_values(model, state)
        if model.needs.mass_varies or not self.weighed:
            self._weigh(weights(model, state.q))
        start.marks[:] = 0.0
        self.wanted_step = self.ended = self.last = None
        self.first = self.count = 0
        self.waiting = []
        if not same_factor:
            self._set_system(self.factors.get(h))
        if self.recorder is not None:
            self.recorder.begun(state, h)

    def _method_of(self, state, h):
        """The numbers of the method for steps of h."""
        settings, c, control = self.settings, self.settings.coefficients, self.control
        to_a, to_v = c.rates(h)
        least, most, share = settings.newton_tolerance(to_a * h * h)
        rtol, atol, grow = control.allowed(h) if control else (0.0, 0.0, 0.0)
        family = {"alpha_m": c.alpha_m, "alpha_f": c.alpha_f, "beta": c.beta, "gamma": c.gamma, "to_a": to_a, "to_v": to_v}
        newton = {"least": least, "most": most, "share": self.caution * share, "max_iterations": settings.max_iterations}
        errors = {"control": abs(c.error) * h * h if control else 0.0, "rtol": rtol, "atol": atol, "grow": grow}
        errors["before"] = control.before if control else 0.0
        model = {"extent": extent(self.model, state.q), "velocity_rows": self.model.velocity_rows, "unknowns": self.unknowns}
        return step.Method(h=h, incremental=self.incremental, **family, **newton, **errors, **model)

    def _limit_stretch(self, memory):
        """Set `longest`, the most steps of the next stretch, from the entry "stretch" of a State's memory.

        It is 1 without this entry. A model without switches keeps what it has.
        """
        if self.model.switching:
            self.longest = min(int(memory.get("stretch", 1)), INSTANTS)

    def _weigh(self, masses):
        """Set the weights of the mean squares: of the local error, of |q|, and of Newton's method."""
        start, self.weighed = self.start, True
        start.masses[:] = start.places[:] = masses
        start.shares[:] = 1.0 / len(masses) if self.model.uniform_units else masses
        if self.unknowns < self.model.n:
            start.shares[:] /= start.shares[: self.unknowns].sum()
        start.places[self.model.hidden] = 0.0

    def _set_system(self, system):
        """Use a factor, of which Newton's contraction is not known."""
        self.system = system
        self.start.marks[step.CONTRACTION], self.start.marks[step.AGE] = 1.0, step.FRESHEN

    def restore_factor(self, memory):
        """Make the factor of a memory again, unless it is the present one."""
        made_at = memory["factored_at"]
        if self.system is None or not np.array_equal(made_at, self.system.made_at):
            self.system = None
            if len(made_at):
                h = float(memory.get("factored_for", memory["h"]))
                self._factor(float("nan"), lambda system: system.again(made_at, *self.settings.coefficients.rates(h)), h)

    def recall(self, memory):
        """Take up Newton's memory, so that a resumed run is the same to the last bit."""
        self.start.change[:], self.start.earlier[:] = memory["change"], memory["earlier"]
        if "weights" in memory:
            self._weigh(memory["weights"])
        self.start.marks[:] = memory["marks"]
        if "switched" in memory:  # the equations are others than those whose contraction was measured
            self.start.marks[step.CONTRACTION], self.start.marks[step.AGE] = 1.0, step.FRESHEN
        if self.method.extent != memory["extent"]:
            self.method = self.method._replace(extent=float(memory["extent"]))

    def run(self, grid):
        """Yield stretches of the states at the ends of the grid's steps, as long as h is to stay. Raises StepFailure."""
        done = grid.done
        while done < grid.count and (stretch := self.stretch(grid, done)):
            done += len(stretch)
            yield stretch

    def stretch(self, grid, done):
        """The states at the ends of the next steps of a grid, of which `done` are taken; None if h is to change first. Raises StepFailure."""
        if not self.waiting:
            stretch = None if self.wanted_step else self._stretch(grid, done)
            if stretch is None or self.recorder is None:
                return stretch
            self.waiting = [stretch.part(k, k + 1) for k in reversed(range(len(stretch)))]
        part = self.waiting.pop()
        self.recorder.stepped(part.last)
        return part

    def last_of(self, grid):
        """Take all steps of a Grid and return the State at its end, in arrays of its own; no frames are kept. Raises StepFailure."""
        rows, self.rows = self.rows, _no_rows
        try:
            return list(self.run(grid))[-1].last
        finally:
            self.rows = rows

    def _prepare(self, grid, done):
        """Prepare as many steps of a grid as the model's table takes at once, or as may be taken before the next pause."""
        if self.last is not None:
            self._limit_stretch(self.last.memory)
        fits_in_memory = self.chunk_bytes // (48 * max(1, self.model.n))
        most = min(ADAPTIVE if self.control else np.inf, fits_in_memory, self.longest, self.table.longest, self.model.longest_stretch)
        most = int(max(1, most))
        to_pause = self.pause - self.counts.steps
        h, n, m = self.method.h, self.model.n, self.model.m
        self.times = times = grid.times(done, end_of_stretch(grid, done, most, to_pause))
        self.first, self.count = 0, len(times) - 1
        self.frames = self.rows(self.count) or allocate([(n,), (n,), (n,), (m,)], [np.dtype(float)] * 4, 8 * self.count * (3 * n + m))
        self.table.prepare(times, (inner_side(self.model, times[0], -h), inner_side(self.model, times[-1], h)), h)

    def _stretch(self, grid, done):
        """The states of the next steps that one call of the compiled loop takes; None if h is to change first. Raises StepFailure."""
        if self.ended:
            self._refactor_or_fail()
        if self.first == self.count:
            self._prepare(grid, done)
        first = self.first
        while self.first == first and self.wanted_step is None:
            self._take_one_call()
            if self.ended and self.first == first:
                self._refactor_or_fail()
        return self._as_stretch(first, grid, done) if self.first > first else None

    def _take_one_call(self):
        """Take prepared steps by one call of the compiled loop, and set `first`, and `wanted_step` or `ended` if it did not take all."""
        first, new_factor = self.first, self.system is None
        if new_factor:
            step.predict(self.method._replace(unknowns=self.model.n), self.start, self.trial)
            self._factor_here(first)
        steps, status, moved = self._steps(self.method, first, self.count, self.frames)
        if not steps:
            self.table.raise_error()
        if not steps and new_factor and status in (REFACTOR, INVERTED, NOT_FINITE):
            steps, status, moved = self._full_newton(first, self.frames)
        self.first += steps
        if status == ERROR_LARGE:
            self.wanted_step = SHORTER
        elif status == ERROR_SMALL:
            self.wanted_step = LONGER
        elif status != DONE:
            self.ended = Ended(status, new_factor and not steps, self.times[self.first + 1], moved)

    def _as_stretch(self, first, grid, done):
        """The Stretch of the prepared steps from number `first` on; its last state has a memory where a run can go on.

        done: steps of the grid taken before these.
        """
        taken = slice(first, self.first)
        stretch = Stretch(self.times[1:][taken], *(frame[taken] for frame in self.frames))
        if self.first == self.count or self.wanted_step == LONGER:
            last = stretch.last
            last = State(last.t, last.q, last.v, last.a, last.lam, self._memory(grid.after(done + self.first - first)))
            stretch = Stretch(stretch.t, stretch.q, stretch.v, stretch.a, stretch.lam, last)
        self.last = stretch.last
        return stretch

    def _steps(self, method, first, end, frames):
        """Take the steps from `first` to before `end` with the present factor: (steps, how it ended, last |dq|)."""
        counts, numbers = np.zeros(3, np.int64), self.numbers
        frames = tuple(frame[first:end] for frame in frames)
        with self.table.at_work(self.system) as (functions, workspace):
            result = step.take_steps(functions, workspace, first, method, numbers, self.stabilised, self.start, self.trial, counts, frames)
        self.counts.add(*counts)
        if counts[2]:
            self.system.read()
            self.factored_for = method.h
        return result

    def _refactor_or_fail(self):
        """Ask for a new factor after a step that `ended` with an old one. Raises StepFailure if its factor was new."""
        ended, self.ended = self.ended, None
        self.table.raise_error()
        if not ended.new_factor and ended.status not in (HALF_TURN, SINGULAR):
            self.system = None
            self.start.marks[step.AHEAD] = self.start.marks[step.BEHIND] = 0.0
            return
        phi = float(np.abs(self.trial.phi).max(initial=0))
        raise StepFailure(*REASONS[ended.status], ended.t, **{"last |dq|": float(ended.moved), "|phi|": phi})

    def _full_newton(self, first, frames):
        """One step with a matrix made anew in every iteration, from the places at its start if it does not go far: no jump of a has distorted them."""
        start, trial, marks = self.start, self.trial, self.start.marks
        method = self.method._replace(max_iterations=1)
        marks[step.MOVED], marks[step.AHEAD], marks[step.BEHIND] = step.NEW_STEP, 0.0, 0.0
        step.predict(method._replace(unknowns=self.model.n), start, trial)
        back = start.q - trial.q
        back[self.model.hidden] = 0.0
        if np.abs(back).max() <= NEAR * method.extent:
            for values, rate in ((trial.q, 1.0), (trial.moved, 1.0), (trial.v, method.to_v), (trial.a, method.to_a)):
                values += rate * back
            trial.slip[:] = 0.0
            marks[step.MOVED] = step.GIVEN
        for _ in range(self.settings.max_iterations):
            self._factor_here(first)
            steps, ended, moved = self._steps(method, first, first + 1, frames)
            self.table.raise_error()
            if ended != REFACTOR or steps or not np.isfinite(moved):
                break
            marks[step.MOVED] = moved
        marks[step.MOVED] = step.NEW_STEP
        return steps, ended, moved

    def _factor_here(self, first):
        """A new factor at the trial state of step `first`."""
        t, method, trial = self.times[first + 1], self.method, self.trial
        q, v, a, lam = trial.q.copy(), trial.v.copy(), trial.a.copy(), trial.lam.copy()
        self._factor(t, lambda system: self.table.factor(system, t, q, v, a, lam, method.to_a, method.to_v), method.h)

    def _factor(self, t, make, h):
        """A new factor for steps of h by make(system), which returns the number of residuals it took, or None."""
        system = self.reusable_factor or self.table.system(self.settings)
        self.counts.add(factors=1)
        try:
            self.counts.add(residuals=make(system) or 0)
        except SingularSystem as error:
            raise StepFailure("singular", str(error), t) from None
        self.counts.add(system=system)
        self._set_system(system)
        self.factored_for = h
        if self.control:
            self.factors.keep(h, system)
        else:
            self.reusable_factor = system  # the next factor overwrites it

    @property
    def error(self):
        """The largest local error over the allowed one, since h or `marks` changed."""
        return float(self.start.marks[step.ERROR])

    def state(self, t):
        """The last accepted state with the memory from which a run goes on."""
        start = self.start
        return State(float(t), start.q.copy(), start.v.copy(), start.a.copy(), start.lam.copy(), self._memory(None), restart=False)

    def _memory(self, grid):
        """What a run needs to go on from the last accepted state; grid: as a memory has it, or None."""
        start, method = self.start, self.method
        made_at = np.zeros(0) if self.system is None else self.system.made_at
        memory = {"a_alg": start.a_alg.copy(), "change": start.change.copy(), "earlier": start.earlier.copy()}
        memory |= {"sizes": np.array(self.control.sizes)} if self.control and self.control.sizes else {}
        memory |= {"h": method.h, "marks": start.marks.copy(), "factored_at": made_at, "extent": method.extent}
        memory |= {"factored_for": self.factored_for} if self.factored_for not in (None, method.h) else {}
        if self.model.needs.mass_varies:
            memory["weights"] = start.masses.copy()
        if method.incremental:
            memory |= {"phi": start.phi.copy(), "rate": start.rate.copy()}
        return memory if grid is None else memory | {"grid": grid}


def table_of(settings, model, incremental, condensed=False):
    """The table of a model for steps with these settings; condensed: without relaxed strains among the unknowns, if it has such."""
    if settings.linear == "kkt":
        return PythonTable(model, incremental)
    if not model.compiled:
        return small_table(model, incremental) or PythonTable(model, incremental)
    with loading:
        from polyida.system.scene import SceneTable
    return SceneTable(model, (settings.form == "stabilised" and model.m > 0) or model.velocity_rows.size > 0, incremental, condensed)


def _numbers(method):
    """Numbers of a step (10,), for the model: dq''/dq, dv/dq, h, and factors of the q'' and a_alg at its beginning.

    Those of both in v, and in q - h v, and in a_alg at its end if q'' is zero there; last that of q'' at its end in a_alg.
    """
    h, beta, gamma = method.h, method.beta, method.gamma
    of_a, of_alg, of_end = np.array([method.alpha_f, -method.alpha_m, 1.0 - method.alpha_f]) / (1 - method.alpha_m)
    in_v = [h * gamma * of_a, h * (1 - gamma + gamma * of_alg)]
    in_q = [h**2 * beta * of_a, h**2 * (0.5 - beta + beta * of_alg)]
    return np.array([method.to_a, method.to_v, h] + in_v + in_q + [of_a, of_alg, of_end])


def _no_rows(count):
    """None: no array of the caller takes the next states."""
    return None
