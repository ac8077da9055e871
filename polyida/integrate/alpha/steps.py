"""Steps of generalized-alpha on one model: stretches of the compiled loop, factors, fixed and adaptive steps of a smooth piece."""

import math
from dataclasses import replace

import numpy as np

from polyida.environment import allocate
from polyida.errors import DONE, ERROR_LARGE, ERROR_SMALL, HALF_TURN, INVERTED, NOT_FINITE, REASONS, REFACTOR, SINGULAR, StepFailure
from polyida.integrate.alpha import step
from polyida.integrate.alpha.step_size import CUT, LOWEST, StepSizeController
from polyida.integrate.discontinuities import Grid, at_kink, grid_of, inner_side, number_of_steps
from polyida.integrate.sizes import extent, states_at_rest, weights
from polyida.integrate.start import start_values, started
from polyida.integrate.state import State, States, Stretch, first_of
from polyida.linear.lu import FactorCache, SingularSystem
from polyida.system import INSTANTS
from polyida.system.own import PythonTable, small_table

ADAPTIVE = 128  # steps of a stretch if h may change
NEAR = 0.03  # of the model's extent: from the start of a step that goes farther Newton's method may find another motion
SAME_H = 1e-9  # relative difference of steps that is round-off
DIVERGED = 0.03  # of the model's extent: distance of the runs with h and h/2 beyond which they are different motions


class Steps:
    """Steps on one model: `begin` sets state and h, `run` goes on from there.

    factored_for: h of the factor. control: the ErrorControl of adaptive steps, or None. recorder: its `begun(state, h)` is called at every
    beginning and `stepped(state)` for every state, of attempts that fail too; stretches then have one state. resize: "shorter" or "longer"
    if adaptive steps should be, else None. rows: a function of a count that returns arrays for so many frames, [q, v, a (count, n), lam
    (count, m)], or None.
    """

    chunk_bytes = 16_000_000  # of frames that one compiled stretch fills

    def __init__(self, settings, model, counts, control=None):
        self.settings, self.model, self.counts, self.control = settings, model, counts, control
        self.memory, self.trial = step.empty(model.n, model.m)
        self.stabilised = settings.form == "stabilised" and model.m > 0
        self.table = table_of(settings, model, settings.incremental_phi and model.has_constraint_increments, True)
        self.caution, self.unknowns = self.table.system(settings).caution, self.table.unknowns
        self.system = self.spare = self.resize = self.recorder = self.factored_for = self.method = None
        self.weighed = False
        self.factors, self.longest, self.pause, self.rows = FactorCache(), INSTANTS, 0, _no_rows

    def begin(self, state, h, same_factor=False):
        """Go on with steps of h from a state that `started` returned, with the present factor or one for this h.

        memory["pause"]: the number of counted steps after which a stretch ends. memory["stretch"]: length of the next stretch of a model
        with switches; who takes the states writes it into the last one of a stretch.
        """
        self._limit_stretch(state.memory)
        self.pause = state.memory.get("pause", self.pause)
        s, c, y, model, control = self.settings, self.settings.coefficients, self.memory, self.model, self.control
        if not (same_factor and self.method and self.method.h == h):
            to_a, to_v = c.rates(h)
            least, most, share = s.newton_tolerance(to_a * h * h)
            numbers = h, c.alpha_m, c.alpha_f, c.beta, c.gamma, to_a, to_v, least, most, self.caution * share, extent(model, state.q)
            held_to = (abs(c.error) * h * h, *control.allowed(h), control.before) if control else np.zeros(5).tolist()
            incremental = s.incremental_phi and model.has_constraint_increments
            self.method = step.Method(*numbers, incremental, s.max_iterations, *held_to, model.velocity_rows, self.unknowns)
            self.numbers = _numbers(self.method)
        y.q[:], y.v[:], y.a[:], y.a_alg[:] = state.q, state.v, state.a, state.memory["a_alg"]
        y.change[:] = y.earlier[:] = 0.0
        if control and control.before and not at_kink(model, state.t):  # for the error of the first step
            y.change[:] = state.memory.get("change", 0.0)
        y.lam[:], (y.phi[:], y.rate[:]) = state.lam, start_values(model, state)
        if model.needs.mass_varies or not self.weighed:
            self._weigh(weights(model, state.q))
        y.marks[:] = 0.0
        self.resize, self.ended, self.last, self.first, self.count, self.waiting = None, None, None, 0, 0, []
        if not same_factor:
            self._set_system(self.factors.get(h))
        if self.recorder is not None:
            self.recorder.begun(state, h)

    def _limit_stretch(self, memory):
        if self.model.switching:
            self.longest = min(int(memory.get("stretch", 1)), INSTANTS)

    def _weigh(self, masses):
        y, self.weighed = self.memory, True
        y.masses[:] = y.places[:] = masses
        y.shares[:] = 1.0 / len(masses) if self.model.uniform_units else masses
        if self.unknowns < self.model.n:
            y.shares[:] /= y.shares[: self.unknowns].sum()
        y.places[self.model.hidden] = 0.0

    def _set_system(self, system):
        """Use a factor, of which Newton's contraction is not known."""
        self.system = system
        self.memory.marks[step.CONTRACTION], self.memory.marks[step.AGE] = 1.0, step.FRESHEN

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
        self.memory.change[:], self.memory.earlier[:] = memory["change"], memory["earlier"]
        if "weights" in memory:
            self._weigh(memory["weights"])
        self.memory.marks[:] = memory["marks"]
        if "switched" in memory:  # the equations are others than those whose contraction was measured
            self.memory.marks[step.CONTRACTION], self.memory.marks[step.AGE] = 1.0, step.FRESHEN
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
            stretch = None if self.resize else self._stretch(grid, done)
            if stretch is None or self.recorder is None:
                return stretch
            self.waiting = [stretch.part(k, k + 1) for k in reversed(range(len(stretch)))]
        part = self.waiting.pop()
        self.recorder.stepped(part.last)
        return part

    def last_of(self, grid):
        """The State at the end of the grid, in arrays of its own. Raises StepFailure."""
        rows, self.rows = self.rows, _no_rows
        try:
            return list(self.run(grid))[-1].last
        finally:
            self.rows = rows

    def _prepare(self, grid, done):
        """Prepare as many steps of a grid as the model's table takes at once, or as may be taken before the next pause."""
        if self.last is not None:
            self._limit_stretch(self.last.memory)
        most = min(ADAPTIVE if self.control else np.inf, self.chunk_bytes // (48 * max(1, self.model.n)))
        most = int(max(1, min(most, self.longest, self.table.longest)))
        to_pause, h, n, m = self.pause - self.counts.steps, self.method.h, self.model.n, self.model.m
        self.times = times = grid.times(done, min(done + (to_pause if 0 < to_pause < most else most), grid.count))
        self.first, self.count = 0, len(times) - 1
        self.frames = self.rows(self.count) or allocate([(n,), (n,), (n,), (m,)], [np.dtype(float)] * 4, 8 * self.count * (3 * n + m))
        self.table.prepare(times, (inner_side(self.model, times[0], -h), inner_side(self.model, times[-1], h)), h)

    def _stretch(self, grid, done):
        """The same, as far as one call of the compiled loop goes."""
        if self.ended:
            self._refactor_or_fail(*self.ended)
        if self.first == self.count:
            self._prepare(grid, done)
        steps = 0
        while not steps and self.resize is None:
            first, fresh = self.first, self.system is None
            if fresh:
                step.predict(self.method._replace(unknowns=self.model.n), self.memory, self.trial)
                self._factor_here(first)
            steps, ended, moved = self._steps(self.method, first, self.count, self.frames)
            if not steps:
                self.table.raise_error()
            if not steps and fresh and ended in (REFACTOR, INVERTED, NOT_FINITE):
                steps, ended, moved = self._full_newton(first, self.frames)
            self.first += steps
            if ended in (ERROR_LARGE, ERROR_SMALL):
                self.resize = "shorter" if ended == ERROR_LARGE else "longer"
            elif ended != DONE:
                self.ended = ended, fresh and not steps, self.times[self.first + 1], moved
                if not steps:
                    self._refactor_or_fail(*self.ended)
        if not steps:
            return None
        part = slice(first, self.first)
        stretch = Stretch(self.times[1:][part], *(frame[part] for frame in self.frames))
        if self.first == self.count or ended == ERROR_SMALL:
            last = stretch.last
            last = State(last.t, last.q, last.v, last.a, last.lam, self._memory(grid.after(done + steps)))
            stretch = Stretch(stretch.t, stretch.q, stretch.v, stretch.a, stretch.lam, last)
        self.last = stretch.last
        return stretch

    def _steps(self, method, first, end, frames):
        """Take the steps from `first` to before `end` with the present factor: (steps, how it ended, last |dq|)."""
        counts, c, frames = np.zeros(3, np.int64), self.numbers, tuple(frame[first:end] for frame in frames)
        with self.table.at_work(self.system) as (functions, workspace):
            result = step.take_steps(functions, workspace, first, method, c, self.stabilised, self.memory, self.trial, counts, frames)
        self.counts.add(*counts)
        if counts[2]:
            self.system.read()
            self.factored_for = method.h
        return result

    def _refactor_or_fail(self, ended, fresh, t, moved):
        self.ended = None
        self.table.raise_error()
        if not fresh and ended not in (HALF_TURN, SINGULAR):
            self.system = None
            self.memory.marks[step.AHEAD] = self.memory.marks[step.BEHIND] = 0.0
            return
        phi = float(np.abs(self.trial.phi).max(initial=0))
        raise StepFailure(*REASONS[ended], t, **{"last |dq|": float(moved), "|phi|": phi})

    def _full_newton(self, first, frames):
        """One step with a matrix made anew in every iteration, from the places at its start if it does not go far: no jump of a has distorted them."""
        y, method = self.memory, self.method._replace(max_iterations=1)
        y.marks[step.MOVED] = y.marks[step.AHEAD] = y.marks[step.BEHIND] = 0.0
        step.predict(method._replace(unknowns=self.model.n), y, self.trial)
        x, back = self.trial, y.q - self.trial.q
        back[self.model.hidden] = 0.0
        if np.abs(back).max() <= NEAR * method.extent:
            for values, rate in ((x.q, 1.0), (x.moved, 1.0), (x.v, method.to_v), (x.a, method.to_a)):
                values += rate * back
            x.slip[:], y.marks[step.MOVED] = 0.0, np.nan
        for _ in range(self.settings.max_iterations):
            self._factor_here(first)
            steps, ended, moved = self._steps(method, first, first + 1, frames)
            self.table.raise_error()
            if ended != REFACTOR or steps or not np.isfinite(moved):
                break
            y.marks[step.MOVED] = moved
        y.marks[step.MOVED] = 0.0
        return steps, ended, moved

    def _factor_here(self, first):
        t, (q, v, a), lam = self.times[first + 1], self.trial.now[:3].copy(), self.trial.lam.copy()
        p = self.method
        self._factor(t, lambda system: self.table.factor(system, t, q, v, a, lam, p.to_a, p.to_v), p.h)

    def _factor(self, t, make, h):
        """A new factor for steps of h by make(system), which returns the number of residuals it took, or None."""
        system = self.spare or self.table.system(self.settings)
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
            self.spare = system  # the next factor overwrites it

    @property
    def error(self):
        """The largest local error over the allowed one, since h or `marks` changed."""
        return float(self.memory.marks[step.ERROR])

    def state(self, t):
        """The last accepted state with the memory from which a run goes on."""
        y = self.memory
        return State(float(t), y.q.copy(), y.v.copy(), y.a.copy(), y.lam.copy(), self._memory(None), restart=False)

    def _memory(self, grid):
        y, p = self.memory, self.method
        made_at = np.zeros(0) if self.system is None else self.system.made_at
        memory = {"a_alg": y.a_alg.copy(), "change": y.change.copy(), "earlier": y.earlier.copy()}
        memory |= {"sizes": np.array(self.control.sizes)} if self.control and self.control.sizes else {}
        memory |= {"h": p.h, "marks": y.marks.copy(), "factored_at": made_at, "extent": p.extent}
        memory |= {"factored_for": self.factored_for} if self.factored_for not in (None, p.h) else {}
        if self.model.needs.mass_varies:
            memory["weights"] = y.masses.copy()
        if p.incremental:
            memory |= {"phi": y.phi.copy(), "rate": y.rate.copy()}
        return memory if grid is None else memory | {"grid": grid}


def table_of(settings, model, incremental, condensed=False):
    """The table of a model for steps with these settings; condensed: without relaxed strains among the unknowns, if it has such."""
    if settings.linear == "kkt":
        return PythonTable(model, incremental)
    if not model.compiled:
        return small_table(model, incremental) or PythonTable(model, incremental)
    from polyida.system.scene import SceneTable

    return SceneTable(model, (settings.form == "stabilised" and model.m > 0) or model.velocity_rows.size > 0, incremental, condensed)


def _numbers(p):
    """Numbers of a step: dq''/dq, dv/dq, h, then factors.

    They are those of q'' and a_alg at its beginning in v, q - h v and a_alg at its end if q'' is zero there, and that of q'' in a_alg.
    """
    of_a, of_alg, of_end = np.array([p.alpha_f, -p.alpha_m, 1.0 - p.alpha_f]) / (1 - p.alpha_m)
    v = p.h * p.gamma * of_a, p.h * (1 - p.gamma + p.gamma * of_alg)
    return np.array([p.to_a, p.to_v, p.h, *v, p.h**2 * p.beta * of_a, p.h**2 * (0.5 - p.beta + p.beta * of_alg), of_a, of_alg, of_end])


def _no_rows(count):
    return None


def fixed_steps(engine, state, begin, end, count):
    """Yield stretches of the states at the ends of `count` equal steps; a step that fails is taken in 2, 4, ... parts. Raises StepFailure."""
    settings, model, counts, grid = engine.settings, engine.model, engine.counts, grid_of(state, begin, end, count)
    for state in states_at_rest(model, state, grid, counts):
        grid = grid._replace(done=grid.done + 1)
        state.memory["grid"] = grid.after(grid.done)
        counts.steps += 1
        yield Stretch.of(state)
    level, done = min(int(state.memory.get("cut", 0)), settings.max_halvings), grid.done
    while done < grid.count:
        failures = []
        if level == 0:
            try:
                near, same_h = (1e-12 * max(abs(state.t), abs(grid.end)), math.isclose(state.memory.get("h", 0.0), grid.h, rel_tol=SAME_H))
                goes_on = "factored_at" in state.memory and same_h and not model.kinks(state.t - near, state.t + near)
                if goes_on:
                    engine.restore_factor(state.memory)
                engine.begin(started(settings, model, state, grid.h, engine.system if goes_on else None), grid.h, goes_on)
                if goes_on:
                    engine.recall(state.memory)
                while done < grid.count:
                    stretch = engine.stretch(grid, done)
                    state, done = stretch.last, done + len(stretch)
                    counts.steps += len(stretch)
                    yield stretch
                return
            except StepFailure as failure:
                failures.append(failure)
                counts.rejected += 1
        for level in range(max(1, level), settings.max_halvings + 1):
            parts = Grid(grid.time(done), grid.time(done + 1), 2**level)
            try:
                engine.begin(started(settings, model, _cut(state, level), parts.h), parts.h)
                state = engine.last_of(parts)
                break
            except StepFailure as failure:
                failures.append(failure)
                counts.rejected += 1
        else:
            raise first_of(failures, f"the step in 2 to {2**settings.max_halvings} parts fails too")
        done, level = done + 1, level - 1
        counts.steps += 1
        state = _cut(state, level, grid=grid.after(done))
        yield Stretch.of(state)


def _cut(state, level, **memory):
    """A state from which the method starts with a_alg = q''."""
    return State(state.t, state.q, state.v, state.a, state.lam, {"cut": float(level), "h": 0.0} | memory)


def adaptive_steps(engine, state, begin, end, longest, most_steps):
    """Yield stretches of states from begin to end, with h as the local error allows, but no step above `longest`.

    Raises StepFailure below the lowest level, if h is round-off of t, and if the steps counted and rejected would be more than most_steps.
    """
    settings, model, counts, control = engine.settings, engine.model, engine.counts, engine.control
    most, t, failures = (end - begin) / number_of_steps(model, state, begin, end, longest), begin, []
    controller = StepSizeController(control, float(state.memory.get("h", control.first)) or np.inf, most, longest)

    def require_progress(h):
        if counts.steps + counts.rejected >= most_steps:
            raise StepFailure("too many steps", f"more than {settings.max_num_steps} steps (max_num_steps)", t, step=h)
        if h < 16 * np.spacing(abs(t)):
            raise StepFailure("step too small", "the step has shrunk to the round-off of t", t, step=h)

    def require_level(down, failures):
        if controller.level + down > LOWEST:
            raise first_of(failures, f"down to steps of {controller.h:.3g} s")

    for state in states_at_rest(model, state, Grid(t, end, max(1, int(np.ceil((end - t) / most * (1 - 1e-12))))), counts):
        require_progress(state.t - t)
        t = state.t
        counts.steps += 1
        state.memory.update({"sizes": np.array(control.sizes)} if control.sizes else {})
        yield Stretch.of(state)
    while t < end:
        remaining, moved = (end - t) / controller.h, False
        if remaining <= 3:  # the last few steps are equal
            grid = Grid(t, end, max(1, int(np.ceil(remaining - 1e-9))))
        else:
            grid = Grid(t, t + (int(remaining) - 1) * controller.h, int(remaining) - 1)
        require_progress(grid.h)
        try:
            engine.begin(started(settings, model, state, grid.h), grid.h)
            done = 0
            while done < grid.count and counts.steps + counts.rejected < most_steps and (stretch := engine.stretch(grid, done)):
                stretch = stretch.part(0, most_steps - counts.steps - counts.rejected)
                t, moved, done = stretch.last.t, True, done + len(stretch)
                counts.steps += len(stretch)
                yield stretch
            failures = []
        except StepFailure as failure:
            failures.append(failure)
            require_level(CUT, failures)
            controller.level += CUT
        if failures or engine.resize == "shorter":
            counts.rejected += 1
        if engine.resize == "shorter":
            controller.reduce(engine.error)
            require_level(0, [StepFailure("step size", "the local error stays above rtol and atol", t)])
        elif engine.resize == "longer":
            controller.raise_step(engine.error)
        state = engine.state(t) if moved else state  # not the state that `started` returned: that is behind a kink already


def extrapolated(settings, model, state, t_end, counts):
    """Yield `x = (4 x(h/2) - x(h)) / 3` at the ends of steps of h (Richardson), of order 3 to 4. Raises StepFailure, also if the runs diverge.

    The runs with h and h/2 are independent. phi = 0 and energy hold to the order of the result only. A kink at the end of a step does no harm;
    mesh modes that no step resolves gain nothing. Once the runs are different motions there is nothing to extrapolate, and the run stops.
    """
    plain = replace(settings, extrapolate=False)
    coarse, fine = (States(plain.in_pieces(model, state, t_end, counts, split), counts) for split in (1, 2))
    for one in coarse:
        next(fine)
        two = next(fine)
        counts.steps -= 2
        distance = float(np.abs(two.q - one.q).max())
        if distance > DIVERGED * extent(model, two.q):
            reason = f"the runs with h and h/2 are {distance:.3g} apart in q; there is nothing to extrapolate: take a shorter h"
            raise StepFailure("extrapolation", reason, one.t, **{"|q(h) - q(h/2)|": distance})
        x = [(4 * b - a) / 3 for a, b in ((one.q, two.q), (one.v, two.v), (one.a, two.a), (one.lam, two.lam))]
        yield State(one.t, *x, restart=False)
