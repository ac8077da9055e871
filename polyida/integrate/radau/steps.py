"""Steps of Radau IIA on one model: stretches of the compiled loop, factors where it asks for some, states from what it leaves.

`march` and `adapt` go through a smooth piece of a run, by equal steps or by the local error.
"""

from dataclasses import replace
from functools import partial
from weakref import WeakValueDictionary

import numpy as np

from polyida.errors import DONE, REFACTOR, StepFailure
from polyida.integrate.discontinuities import PULSE, Grid, grid_of, number_of_steps
from polyida.integrate.radau import loop
from polyida.integrate.radau.accepted import Common, Ends
from polyida.integrate.radau.loop import (
    FAILED,
    GOES,
    LEAST,
    LEFT,
    PRICE,
    READY,
    RUNG,
    STEP,
    TIME,
    USED,
    Control,
    H,
    cut,
    keep,
    record,
    stretch,
)
from polyida.integrate.radau.matrices import Matrices, WholeModes, lift
from polyida.integrate.radau.step import (
    AGE,
    AHEAD,
    CONTRACTION,
    ERROR,
    FACTORS,
    LAST,
    MOVED,
    SHARES,
    SPEED,
    UNKNOWN,
    UNKNOWN_MISS,
    A,
    Method,
    Q,
    V,
    empty,
    way,
)
from polyida.integrate.radau.tableau import radau
from polyida.integrate.radau.tables.python import table_of
from polyida.integrate.sizes import ROUND_OFF, states_at_rest, weights
from polyida.integrate.start import start_values
from polyida.integrate.state import State, Stretch
from polyida.linear.lu import SingularSystem
from polyida.system import ACCELERATION, STEPS

WORK = "residuals", "newton_iterations", "solves", "rejected", "tangents", "factorizations"
CHUNK = 4_000_000  # bytes that the steps of a stretch leave


def _nowhere(taken, k, rung):
    return {}


def _on_grid(grid, taken, k, rung):
    return {"radau_grid": grid.after(grid.done + taken + k + 1)}


def at(t, rung=0.0):
    """Control.now at a time."""
    return np.array([rung, t, 0.0, 0.0, 0.0, 0.0])


class Steps:
    """`begin` takes a state up, `step`, `equal` and `adaptive` go on from one; `limits`: the model's times are held to them, beside a kink.

    sizes: the model's (length, speed), of which tolerances are a share; run: as the memory of states has it. looks: whether the local error is
    asked for.
    """

    def __init__(self, settings, model, counts, sizes, run=None):
        self.settings, self.model, self.counts, self.sizes, self.run = settings, model, counts, sizes, run
        self.tableau, self.limits = radau(settings.stages), (-np.inf, np.inf)
        needs, form = model.needs, settings.form
        bent = model.m > 0 and (needs.phi_q_varies or needs.driven)
        self.tied = form == "ggl" and bent
        self.moves_v = (form == "ggl" or settings.project) and (bent or (model.compiled and model.m > 0))
        self.looks = settings.adaptive or settings.tolerance is None
        self.table = _table(settings, model, self.tableau, self.tied)
        self.way = way(self.tableau)
        self.memory, self.trial, self.room = empty(settings.stages, model.n, model.m, self.tied)
        self.kept, self.at = loop.kept(model.n, model.m), None
        self.done = np.zeros(loop.COUNTS, np.int64)
        most = CHUNK // (8 * max(1, (4 * settings.stages + 5) * model.n))
        self.most = max(1, min(STEPS, most, 1 if model.switching else STEPS))

    @property
    def longest(self):
        """Steps of a stretch."""
        return min(self.most, self.table.longest)

    @property
    def shares(self):
        """(n,), of the coordinates in the mass."""
        return self.memory.past[SHARES]

    def begin(self, state):
        """Take up what a state of this method holds, and nothing else: the norm's weights, Newton's contraction, the factors."""
        memory, model, table = state.memory, self.model, self.kept.table
        given = memory.get("radau_shares")
        self.memory.past[SHARES] = weights(model, state.q) if given is None else given
        if self.tied:
            self.table.weigh(lift(model, self.shares))
        self.table.hold_constant(state.t, state.q)
        table[:], self.at, self.made = 0.0, None, None
        self.memory.marks[[CONTRACTION, AGE]] = memory.get("newton", UNKNOWN)
        if "newton" in memory:
            for slot, (row, price) in enumerate(zip(memory["factored"], np.reshape(memory["prices"], (-1, 3)))):
                table[[H, PRICE, LEAST, USED], slot] = [*price, slot + 1.0]
                self.kept.made[slot] = row[1:]

    def clamp(self, t):
        """t held to `limits`."""
        return float(min(max(t, self.limits[0]), self.limits[1]))

    def take(self, state):
        """Go on from a state, where it is not the one that was reached last."""
        if state is self.at:
            return
        y, memory, model = self.memory, state.memory, self.model
        known = "stages_e" in memory
        y.past[Q], y.past[V] = state.q, state.v
        last = memory.get("a_end")
        y.past[A] = state.a if last is None else last  # which may not be made yet
        y.lam[:] = memory["stages_lam"][-1] if "stages_lam" in memory else state.lam
        if known:
            y.stages_v[:], y.stages_lam[:] = memory["stages_v"], memory["stages_lam"]
        y.marks[LAST], y.marks[ERROR] = memory["step"] if known else 0.0, memory.get("error", -1.0)
        y.marks[AHEAD] = memory.get("ahead", UNKNOWN_MISS) if known else UNKNOWN_MISS
        if y.marks[AHEAD] != UNKNOWN_MISS:
            y.miss_e[:], y.miss_lam[:], y.mu[:] = memory["miss_e"], memory["miss_lam"], memory["mu"]
        if model.has_constraint_increments:
            y.closed[:] = start_values(model, state, self.clamp(state.t))
        self.at = state

    def method(self):
        s, model, sizes = self.settings, self.model, self.sizes
        rtol, atol = (s.relative(sizes), s.absolute(sizes)) if s.adaptive else (0.0, 0.0)
        return Method(
            tied=self.tied,
            carries=bool(model.has_constraint_increments),
            moves_v=self.moves_v,
            looks=self.looks,
            guessed=False,
            max_iterations=s.max_iterations,
            low=float(self.limits[0]),
            high=float(self.limits[1]),
            renewal=self.table.renewal,
            extent=float(model.extent or 1.0),
            least=ROUND_OFF * float(sizes[0]),
            tolerance=float(s.tolerance or 0.0),
            share=min(loop.SHARE, rtol**loop.BELOW) if s.adaptive else 0.0,
            rtol=rtol,
            atol=atol,
            length=float(sizes[0]),
        )

    def step(self, state, h, t):
        """The State at t, a step of h on. Raises StepFailure."""
        control = Control(False, h, h, np.inf, np.inf, np.inf, at(state.t))
        end = next(self._stretches(state, control, np.array([t])))
        vars(self.counts).update(end.spent)
        return end.last

    def equal(self, state, grid):
        """Yield stretches of the states at the ends of the rest of a grid's steps. Raises StepFailure."""
        while grid.done < grid.count:
            ends = grid.times(grid.done, min(grid.done + self.longest, grid.count))[1:]
            control = Control(False, grid.h, grid.h, np.inf, np.inf, np.inf, at(state.t))
            for made in self._stretches(state, control, ends, partial(_on_grid, grid)):
                self.counts.steps += len(made)
                yield made
                state = made.last
            grid = grid._replace(done=grid.done + len(ends))

    def adaptive(self, state, control, place):
        """Yield stretches of states as the control has them; place(taken, k, rung): what their memory has besides, `taken` steps and k on.

        Raises StepFailure.
        """
        while state.t < control.end:
            for made in self._stretches(state, control, np.zeros(0), place):
                self.counts.steps += len(made)
                yield made
                state = made.last

    def _stretches(self, state, control, ends, place=_nowhere):
        """The states that the table takes at once, in one stretch or in several between which factors are made. Raises StepFailure."""
        p, y, fresh, taken = self.method(), self.memory, False, 0
        self.take(state)
        count = len(ends) or self.longest
        first = self.table.begin(self, state, control, ends)
        while True:
            o = record(count, self.settings.stages, self.model.n, self.model.m, self.tied)
            self.done[:], begin = 0, (state.t, state.q, state.v)
            control.now[LEFT] = control.most_steps - self.counts.steps - self.counts.rejected
            called, held = (self.table.functions, self.table.workspace, first), (control, self.kept, fresh)
            with self.table.timed():
                found, ended = stretch(*called, p, self.way, *held, y, self.trial, self.room, self.done, ends[taken:], o)
            if self.done[FACTORS]:
                self.made = None
            self.at, before = None, replace(self.counts)
            if found:
                self.made = self.kept.made.copy() if self.made is None else self.made
                memory = self._shared(), partial(place, taken), self._motion()
                work = partial(self.work, before, o.counts)
                made = Ends(
                    Common(
                        o,
                        begin,
                        self.tableau.c,
                        self.made,
                        bool(self.model.has_constraint_increments),
                        *memory,
                        work,
                        WeakValueDictionary(),
                    ),
                    range(found),
                )
                self.at = state = made.last
                yield made
            vars(self.counts).update(self.work(before, self.done[None], 0))
            self.at = self.at or state
            taken, count, first = taken + found, count - found, first + found * (self.settings.stages + 1) * self.table.prepared
            self.table.raise_left()
            if ended in (loop.MAKE, loop.AGAIN):
                fresh = ended == loop.MAKE
                self.make(control, fresh)
            elif ended == loop.PAUSE:
                fresh = False
            elif ended != DONE:
                raise self._failure(ended, control)
            elif not count or control.adaptive:
                return

    def work(self, before, done, k):
        """The counts at step k but for the steps, of those of the work done since a stretch began."""
        residuals, iterations, solves, factors, rejected = map(int, done[k])
        more = residuals, iterations, solves, rejected, factors, factors * len(self.tableau.modes)
        return {name: getattr(before, name) + count for name, count in zip(WORK, more)}

    @property
    def of_run(self):
        """What all states of a run have in memory."""
        return {"sizes": self.sizes} | ({} if self.run is None else {"run": self.run})

    def _shared(self):
        return self.of_run | ({"radau_shares": self.shares.copy()} if self.model.needs.mass_varies else {})

    def _motion(self):
        """What makes a and lam of the states, or None where the loop has."""
        return None if self.table.functions[ACCELERATION] else (self.model, self.clamp)

    def make(self, control, new):
        """Make factors for the step that is tried: new ones, or those that are kept of it again."""
        h, t, table, y = float(control.now[STEP]), self.clamp(control.now[TIME]), self.kept.table, self.memory
        slot = int(np.argmax(table[H] == h))
        if new:
            slot, self.made = keep(self.kept, h, t, y), None
            self.counts.tangents += 1
            self.counts.factorizations += len(self.tableau.modes) if self.settings.linear != "kkt" else 0  # whole ones are with their rows
        try:
            self.table.make(slot, h, self.kept.made[slot].copy(), self.counts)
        except SingularSystem as error:
            table[H, slot] = table[USED, slot] = 0.0
            raise StepFailure("singular", str(error), float(control.now[GOES])) from None
        if self.table.single:
            table[READY] = 0.0
        table[READY, slot] = 1.0

    def _failure(self, ended, control):
        """The StepFailure of the step that was tried."""
        t, seen = float(control.now[GOES]), {}
        if ended in (loop.STUCK, loop.MANY):
            return StepFailure({loop.STUCK: "stuck", loop.MANY: "too many steps"}[ended], "", float(control.now[TIME]))
        if ended == REFACTOR:
            seen = {"last |dq|": float(self.room.seen[MOVED]), "contraction": float(self.room.seen[SPEED])}
        return StepFailure(*self.table.told(ended, self, control), t, **seen)


def _table(settings, model, tableau, tied):
    """The table of a model, by the settings' linear algebra."""
    if model.compiled and settings.linear != "kkt":
        from polyida.integrate.radau.tables.scene import SceneStages

        return SceneStages(model, tableau, tied)
    kind = partial(WholeModes, scaling=settings.scaling) if settings.linear == "kkt" else Matrices
    return table_of(model, settings.linear, tableau, tied, kind)


def march(engine, settings, model, state, begin, end, most, counts):
    """Yield stretches of the states at the ends of equal steps; a step that fails is taken in 2, 4, ... parts. Raises StepFailure."""
    grid = _grid(model, state, begin, end, most)
    for state in states_at_rest(model, state, grid, counts):
        grid = grid._replace(done=grid.done + 1)
        state.memory.update(radau_grid=grid.after(grid.done), **engine.of_run)
        counts.steps += 1
        yield Stretch.of(state)
    if "rest" in state.memory:  # what is known of steps before is not in it
        engine.begin(state)
    while grid.done < grid.count:
        done = grid.done
        try:
            for made in engine.equal(state, grid):
                done, state = done + len(made), made.last
                yield made
            return
        except StepFailure as failure:
            counts.rejected, grid = counts.rejected + 1, grid._replace(done=done)
            state = _in_parts(engine, settings, state, grid, failure, counts)
            counts.steps += 1
            grid = grid._replace(done=grid.done + 1)
            state.memory.update(radau_grid=grid.after(grid.done))
            yield Stretch.of(state)


def _grid(model, state, begin, end, most):
    """The Grid that the state is on, where it is one for steps of `most`; a new one otherwise."""
    stored = State(state.t, state.q, state.v, state.a, state.lam, {"grid": state.memory.get("radau_grid")})
    known = grid_of(stored, begin, end, 0)
    if known.count and known.h <= most * (1 + 1e-9) and (known.h > 0.5 * most or known.count <= PULSE):
        return known
    return Grid(begin, end, number_of_steps(model, state, begin, end, most))


def _in_parts(engine, settings, state, grid, first, counts):
    """The state after the next step of the grid, in parts."""
    last = first
    for level in range(1, settings.max_halvings + 1):
        parts, found = Grid(grid.time(grid.done), grid.time(grid.done + 1), 2**level), state
        try:
            for k in range(parts.count):
                found = engine.step(found, parts.h, parts.time(k + 1))
            return found
        except StepFailure as failure:
            counts.rejected += 1
            last = failure
    parts = f"; the step in 2 to {2**settings.max_halvings} parts fails too, at last: {last.reason}" if settings.max_halvings else ""
    raise StepFailure(first.status, first.reason + parts, first.t, **last.seen)


def adapt(engine, settings, model, state, begin, end, most, counts, ladder, most_steps):
    """Yield stretches of states from begin to end, the step as the local error allows and not above `most`. Raises StepFailure.

    ladder: [first step, rung].
    """
    first, most, failures = float(ladder[0]), _most(model, state, begin, end, most), []
    control = Control(True, 0.0, first, most, end, float(most_steps), at(begin, ladder[1]))
    now = control.now
    place = lambda taken, k, rung: {"ladder": np.array([first, rung]), "radau_piece": np.array([end, most])}  # noqa: E731
    while state.t < end:
        try:
            for made in engine.adaptive(state, control, place):
                failures, ladder[1], state = [], now[RUNG], made.last
                yield made
        except StepFailure as failure:
            rejected = int(now[FAILED]) - len(failures)
            failures += [StepFailure("step size", "the local error stays above rtol and atol", state.t)] * rejected
            if failure.status == "stuck":
                raise _with_history(failures, now[STEP]) from None
            if failure.status == "too many steps":
                reason = f"more than {settings.max_num_steps} steps (max_num_steps)"
                raise StepFailure(failure.status, reason, state.t, step=float(now[STEP])) from None
            failures.append(failure)
            counts.rejected += 1
            now[FAILED] += 1
            now[RUNG] = cut(first, now[RUNG], now[STEP])


def _with_history(failures, h):
    """The first failure, and what came of it."""
    first, last = failures[0], failures[-1]
    reason = first.reason if last is first else f"{first.reason}; down to steps of {h:.3g} s, at last: {last.reason}"
    return StepFailure(first.status, reason, first.t, **last.seen)


def _most(model, state, begin, end, most):
    """The largest step of the piece, by which loads are seen behind a kink too; of one that is gone on with as it was."""
    piece = state.memory.get("radau_piece")
    if piece is not None and piece[0] == end and "stages_e" in state.memory and piece[1] <= most * (1 + 1e-9):
        return float(piece[1])
    return (end - begin) / number_of_steps(model, state, begin, end, min(most, end - begin))


def ladder_of(state, first):
    """[first step, rung] that the state was on, or one that begins with `first`, s."""
    stored = state.memory.get("ladder")
    return [float(first), 0.0] if stored is None else [float(stored[0]), float(stored[1])]
