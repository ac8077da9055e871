"""Steps of generalized-alpha on one model: stretches of compiled steps, factors where these ask for one."""

import numpy as np

from polyida.errors import DONE, HALF_TURN, INVERTED, NOT_FINITE, REASONS, REFACTOR, SINGULAR, TOO_FAR, TOO_NEAR, StepFailure
from polyida.integrate.alpha import step
from polyida.integrate.alpha.march import calm_error
from polyida.integrate.kinks import at_kink, inner_side
from polyida.integrate.sizes import extent, weights
from polyida.integrate.start import start_values
from polyida.integrate.state import State, Stretch
from polyida.linear.lu import FactorCache, SingularSystem
from polyida.memory import room
from polyida.system import INSTANTS
from polyida.system.python import table_of

ADAPTIVE = 128  # steps of a stretch whose step may change any time


class Steps:
    """Steps on one model: `begin` sets state and h, `run` goes on from there.

    control: what adaptive steps are held to (a Control), None where they are equal.
    watch: what is told of every beginning, `begun(state, h)`, and every state, `stepped(state)`, of attempts that fail too; None: nobody.
    With it, stretches are of one state.
    verdict: "far" or "near" where adaptive steps should be shorter or longer. rows: a function of a count that gives the
    places of so many states, [q, v, a (count, n), lam (count, m)], or None where they are to be made.
    """

    chunk_bytes = 4_000_000  # of frames that one compiled stretch fills

    def __init__(self, settings, model, counts, control=None):
        self.settings, self.model, self.counts, self.control = settings, model, counts, control
        self.memory, self.trial = step.empty(model.n, model.m)
        self.tied = settings.form == "stabilised" and model.m > 0
        self.table = table_of(model, settings.linear, self.tied, settings.incremental_phi and model.has_constraint_increments)
        self.caution = self.table.system(settings).caution
        self.system = self.spare = self.verdict = None
        self.longest = INSTANTS
        self.kept, self.pause, self.rows, self.watch = FactorCache(), 0, _no_rows, None

    def begin(self, state, h):
        """Go on from a state that `started` has made ready for steps of h.

        memory["pause"]: the number of steps (of counts) after which a stretch ends, for what it leaves in memory there. memory["stretch"]:
        how many the next stretch of a model with switches may have; whoever takes the states puts it into the last of a stretch.
        """
        self._limit(state.memory)
        self.pause = state.memory.get("pause", self.pause)
        s, c, y, model = self.settings, self.settings.coefficients, self.memory, self.model
        to_a, to_v = c.rates(h)
        least, most, share = s.newton_tolerance(to_a * h * h)
        numbers = h, c.alpha_m, c.alpha_f, c.beta, c.gamma, to_a, to_v, least, most, self.caution * share, extent(model, state.q)
        control = self._held_to(h) if self.control else (0.0, 0.0, 0.0, 0.0, 0.0)
        self.method = step.Method(*numbers, s.incremental_phi and model.has_constraint_increments, s.max_iterations, *control)
        y.past[: step.CHANGE], y.past[step.CHANGE : step.MASSES] = (state.q, state.v, state.a, state.memory["a_alg"]), 0.0
        y.past[step.CHANGE] = self._change_before(state)
        y.closed[step.LAM], (y.closed[step.PHI], y.closed[step.RATE]) = state.lam, start_values(model, state)
        self._weigh(weights(model, state.q))
        y.marks[:] = 0.0
        self.verdict, self.ended, self.taken, self.first, self.count, self.waiting = None, None, None, 0, 0, []
        self._take(self.kept.take(h))
        if self.watch is not None:
            self.watch.begun(state, h)

    def _limit(self, memory):
        """Heed what is said of the next stretch."""
        if self.model.switching:
            self.longest = min(int(memory.get("stretch", 1)), INSTANTS)

    def _held_to(self, h):
        """(|C| h^2, rtol, atol, the error below which h may grow, the weight of the step before) of steps of h."""
        control = self.control
        calm = calm_error(h, control.largest, order=control.order)
        return abs(self.settings.coefficients.error) * h * h, *control.allowed(h), calm, control.before

    def _change_before(self, state):
        """The change of q'' in the step before, at another h, where the error of the first one asks for it; 0 behind a kink."""
        asked = self.control and self.control.before and not at_kink(self.model, state.t)
        return state.memory.get("change", 0.0) if asked else 0.0

    def _weigh(self, masses):
        self.memory.past[step.MASSES], self.memory.past[step.SHARES] = masses, 1.0 / len(masses) if self.model.uniform_units else masses

    def _take(self, system):
        self.system = system
        self.memory.marks[step.CONTRACTION], self.memory.marks[step.AGE] = 1.0, step.FRESHEN

    def recall(self, memory):
        """Take up Newton's memory at a restart, with the factor that it had, so that the run is the same bit by bit."""
        self.memory.past[step.CHANGE], self.memory.past[step.EARLIER] = memory["change"], memory["earlier"]
        self._weigh(memory.get("weights", self.memory.past[step.MASSES].copy()))
        if len(memory["factored_at"]):
            self._factor(lambda system, p: system.again(memory["factored_at"], p.to_a, p.to_v), float("nan"))
        self.memory.marks[:] = memory["marks"]
        self.method = self.method._replace(extent=float(memory["extent"]))

    def run(self, grid):
        """Yield stretches of the states at the ends of the grid's steps, until the verdict says otherwise. Raises StepFailure."""
        done = grid.done
        while done < grid.count and (stretch := self.stretch(grid, done)):
            done += len(stretch)
            yield stretch

    def stretch(self, grid, done):
        """The states at the ends of the next steps of a grid, of which `done` are taken; None where the verdict says otherwise first.

        Raises StepFailure.
        """
        if not self.waiting:
            found = None if self.verdict else self._stretch(grid, done)
            if found is None or self.watch is None:
                return found
            self.waiting = [found.part(k, k + 1) for k in reversed(range(len(found)))]
        part = self.waiting.pop()
        self.watch.stepped(part.last)
        return part

    def aside(self, grid):
        """The State at the end of the grid, in arrays of its own. Raises StepFailure."""
        rows, self.rows = self.rows, _no_rows
        try:
            return list(self.run(grid))[-1].last
        finally:
            self.rows = rows

    def _prepare(self, grid, done):
        """Get ready for as many steps of a grid as the model's table takes at once, or as may be taken before the next pause."""
        if self.taken is not None:
            self._limit(self.taken.memory)
        most = min(ADAPTIVE if self.control else np.inf, self.chunk_bytes // (48 * max(1, self.model.n)))
        most = int(max(1, min(most, self.longest, self.table.longest)))
        left, h = self.pause - self.counts.steps, self.method.h
        self.times = times = grid.times(done, min(done + (left if 0 < left < most else most), grid.count))
        self.first, self.count = 0, len(times) - 1
        self.frames = self.rows(self.count) or _fresh(self.count, self.model.n, self.model.m)
        self.table.prepare(times, (inner_side(self.model, times[0], -h), inner_side(self.model, times[-1], h)), h)

    def _stretch(self, grid, done):
        """The same, as far as one call of compiled steps goes."""
        if self.ended:
            self._refactor_or_fail(*self.ended)
        if self.first == self.count:
            self._prepare(grid, done)
        steps = 0
        while not steps and self.verdict is None:
            first, fresh = self.first, self.system is None
            if fresh:
                step.predict(self.method, self.memory, self.trial)
                self._factor_here(first)
            steps, ended, moved = self._steps(self.method, first, self.count, self.frames)
            if steps == 0 and fresh and ended in (REFACTOR, INVERTED, NOT_FINITE):
                steps, ended, moved = self._full_newton(first, self.frames)
            self.first += steps
            if ended in (TOO_FAR, TOO_NEAR):
                self.verdict = "far" if ended == TOO_FAR else "near"
            elif ended != DONE:
                self.ended = ended, fresh and not steps, self.times[self.first + 1], moved
                if not steps:
                    self._refactor_or_fail(*self.ended)
        if not steps:
            return None
        made = slice(first, self.first)
        stretch = Stretch(self.times[1:][made], *(frame[made] for frame in self.frames))
        if self.first == self.count or ended == TOO_NEAR:
            last = stretch.last
            last = State(last.t, last.q, last.v, last.a, last.lam, self._memory(grid.after(done + steps)))
            stretch = Stretch(stretch.t, stretch.q, stretch.v, stretch.a, stretch.lam, last)
        self.taken = stretch.last
        return stretch

    def _steps(self, method, first, last, frames):
        """Take the steps from `first` to `last` with the factor at hand: (steps, how it ended, last |dq|)."""
        counts, c, frames = np.zeros(3, np.int64), np.array([method.to_a, method.to_v]), [frame[first:last] for frame in frames]
        with self.table.at_work(self.system) as (functions, workspace):
            result = step.stretch(functions, workspace, first, method, c, self.tied, self.memory, self.trial, counts, *frames)
        residuals, solves, made = map(int, counts)
        self.counts.residuals += residuals
        self.counts.solves += solves
        self.counts.newton_iterations += solves
        if made:
            self.system.read()
            self.counts.tangents += made
            self.counts.factorizations += made
        return result

    def _refactor_or_fail(self, ended, fresh, t, moved):
        self.ended = None
        self.table.raise_left()
        if not fresh and ended not in (HALF_TURN, SINGULAR):
            self.system = None
            self.memory.marks[step.AHEAD] = self.memory.marks[step.BEHIND] = 0.0
            return
        status, reason = REASONS[ended]
        phi = float(np.abs(self.trial.rows[step.PHI]).max(initial=0))
        raise StepFailure(status, reason, t, **{"last |dq|": float(moved), "|phi|": phi})

    def _full_newton(self, first, frames):
        """One step with a matrix made anew in every iteration."""
        y, method = self.memory, self.method._replace(max_iterations=1)
        y.marks[step.MOVED] = y.marks[step.AHEAD] = y.marks[step.BEHIND] = 0.0
        step.predict(method, y, self.trial)
        for _ in range(self.settings.max_iterations):
            self._factor_here(first)
            steps, ended, moved = self._steps(method, first, first + 1, frames)
            self.table.raise_left()
            if ended != REFACTOR or steps or not np.isfinite(moved):
                break
            y.marks[step.MOVED] = moved
        y.marks[step.MOVED] = 0.0
        return steps, ended, moved

    @property
    def error(self):
        """The largest local error seen since the last change of h or look at it, over what is allowed."""
        return float(self.memory.marks[step.ERROR])

    def state(self, t):
        """The last accepted state with all that a run goes on from."""
        y = self.memory
        return State(float(t), *y.past[: step.A + 1].copy(), y.closed[step.LAM].copy(), self._memory(None), restart=False)

    def _memory(self, place):
        y, p = self.memory, self.method
        made = np.zeros(0) if self.system is None else self.system.made_at
        memory = dict(zip(("a_alg", "change", "earlier"), y.past[step.A + 1 : step.MASSES].copy()))
        memory |= self.control.memory if self.control else {}
        memory |= {"h": p.h, "marks": y.marks.copy(), "factored_at": made, "extent": p.extent}
        if self.model.needs.mass_varies:
            memory["weights"] = y.past[step.MASSES].copy()
        if p.incremental:
            memory |= {"phi": y.closed[step.PHI].copy(), "rate": y.closed[step.RATE].copy()}
        return memory if place is None else memory | {"grid": place}

    def _factor_here(self, first):
        t, (q, v, a), lam = self.times[first + 1], self.trial.now[:3].copy(), self.trial.rows[step.LAM].copy()

        def make(system, p):
            self.counts.residuals += self.table.factor(system, t, q, v, a, lam, p.to_a, p.to_v)

        self._factor(make, t)

    def _factor(self, make, t):
        """A new factor, made by make(system, method)."""
        system = self.spare or self.table.system(self.settings)
        self.counts.tangents += 1
        self.counts.factorizations += 1
        try:
            make(system, self.method)
        except SingularSystem as error:
            raise StepFailure("singular", str(error), t) from None
        self.counts.backend = system.backend
        self.counts.solves += system.solves
        self._take(system)
        if self.control:
            self.kept.keep(self.method.h, system)
        else:
            self.spare = system  # the next factor takes its place


def _no_rows(count):
    return None


def _fresh(count, n, m):
    return room([(n,), (n,), (n,), (m,)], [np.dtype(float)] * 4, 8 * count * (3 * n + m))
