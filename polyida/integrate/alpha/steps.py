"""Steps of generalized-alpha on one model: stretches of a loop, factors where it asks for one."""

import numpy as np

from polyida.errors import StepFailure
from polyida.integrate.alpha import step
from polyida.integrate.alpha.loop import Loop
from polyida.integrate.alpha.step_control import calm_error
from polyida.integrate.kinks import at_kink
from polyida.integrate.sizes import extent, weights
from polyida.integrate.start import start_values
from polyida.integrate.state import State, Stretch
from polyida.linear.lu import Kept, SingularSystem
from polyida.memory import room
from polyida.system.table import DONE, HALF_TURN, INSTANTS, INVERTED, NOT_FINITE, REASONS, REFACTOR, SINGULAR, TOO_FAR, TOO_NEAR

ADAPTIVE = 32  # steps of a stretch whose step may change any time


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
        self.loop = Loop(settings, model, counts, self.memory, self.trial)
        self.caution = self.loop.system().caution
        self.system = self.verdict = None
        self.longest = INSTANTS
        self.kept, self.pause, self.rows, self.watch = Kept(), 0, _no_rows, None

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
        self.method = step.Method(
            h,
            c.alpha_m,
            c.alpha_f,
            c.beta,
            c.gamma,
            to_a,
            to_v,
            least,
            most,
            self.caution * share,
            extent(model, state.q),
            s.incremental_phi and model.carries,
            s.max_iterations,
            *(self._held_to(h) if self.control else (0.0, 0.0, 0.0, 0.0, 0.0)),
        )
        y.past[: step.CHANGE], y.past[step.CHANGE : step.MASSES] = (state.q, state.v, state.a, state.memory["a_alg"]), 0.0
        y.past[step.CHANGE] = self._change_before(state)
        y.closed[step.LAM], (y.closed[step.PHI], y.closed[step.RATE]) = state.lam, start_values(model, state)
        self._weigh(weights(model, state.q))
        y.marks[:] = 0.0
        self.verdict = None
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
        self.memory.past[step.MASSES], self.memory.past[step.SHARES] = masses, 1.0 / len(masses) if self.model.alike else masses

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
        done, self.verdict = grid.done, None
        most = min(ADAPTIVE if self.control else np.inf, self.chunk_bytes // (48 * max(1, self.model.n)))
        while done < grid.count and self.verdict is None:
            table = self.loop.table
            longest, left = (
                int(max(1, min(most, self.longest, table.steady if self.control else table.longest))),
                self.pause - self.counts.steps,
            )
            end = min(done + (left if 0 < left < longest else longest), grid.count)
            for stretch in self._stretches(grid.times(done, end), grid, done):
                done += len(stretch)
                if self.watch is None:
                    yield stretch
                else:
                    yield from self._watched(stretch)
                self._limit(stretch.last.memory)

    def _watched(self, stretch):
        for k in range(len(stretch)):
            part = stretch.part(k, k + 1)
            self.watch.stepped(part.last)
            yield part

    def aside(self, grid):
        """The State at the end of the grid, in arrays of its own. Raises StepFailure."""
        rows, self.rows = self.rows, _no_rows
        try:
            return list(self.run(grid))[-1].last
        finally:
            self.rows = rows

    def _stretches(self, times, grid, done):
        """The states at times[1:], as far as each call of the loop goes."""
        count = len(times) - 1
        frames = self.rows(count) or _fresh(count, self.model.n, self.model.m)
        self.times = times
        self.loop.prepare(times, self.method)
        first, fresh = 0, False
        while first < count:
            if self.system is None:
                step.predict(self.method, self.memory, self.trial)
                self._factor_here(first)
                fresh = True
            steps, ended, moved = self._steps(self.method, first, count, frames)
            if steps == 0 and fresh and ended in (REFACTOR, INVERTED, NOT_FINITE):
                steps, ended, moved = self._full_newton(first, frames)
            made, first = slice(first, first + steps), first + steps
            if steps:
                stretch = Stretch(times[1:][made], *(frame[made] for frame in frames))
                if first == count or ended == TOO_NEAR:
                    last = stretch.last
                    last = State(last.t, last.q, last.v, last.a, last.lam, self._memory(grid.after(done + first)))
                    stretch = Stretch(stretch.t, stretch.q, stretch.v, stretch.a, stretch.lam, last)
                yield stretch
                fresh = False
            if ended in (TOO_FAR, TOO_NEAR):
                self.verdict = "far" if ended == TOO_FAR else "near"
                return
            if ended != DONE:
                self._refactor_or_fail(ended, fresh, times[first + 1], moved)

    def _steps(self, method, first, last, frames):
        return self.loop.steps(method, self.system, first, last, *(frame[first:last] for frame in frames))

    def _refactor_or_fail(self, ended, fresh, t, moved):
        self.loop.table.raise_left()
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
            self.loop.table.raise_left()
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
        self._factor(lambda system, p: self.loop.factor(system, p, self.times[first + 1]), self.times[first + 1])

    def _factor(self, make, t):
        """A new factor, made by make(system, method)."""
        system = self.loop.system()
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


def _no_rows(count):
    return None


def _fresh(count, n, m):
    return room([(n,), (n,), (n,), (m,)], [np.dtype(float)] * 4, 8 * count * (3 * n + m))
