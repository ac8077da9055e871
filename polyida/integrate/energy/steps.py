"""Steps of the energy-momentum method on one model: stretches of the compiled loop, factors where it asks for one, halves where a step fails.

`phi = 0` at both ends leaves `v_1 = 2 (q_1 - q_0)/h - v_0` off `phi_q v + phi_t = 0` by as much as v_0 was, the other way round: what a
motor's jerk once put there would alternate for ever, and show in lam divided by h. So where phi is driven v_1 is moved onto it, along
M^-1 phi_q^T, where lam takes up what a step misses; of a motor's energy 4e-13 a step were measured so at 20 rad/s and 4 ms.
Where nothing drives there is an energy to keep, and v_1 off its constraint by O(h^2) has it. So the next step begins from that v_1
(memory "v_free"), which keeps energy and momenta, and the frame has v_1 put on the constraint and made as fast as it was.
"""

import math
from functools import cached_property

import numpy as np

from polyida.assembly.own_laws import NO_ENERGY
from polyida.errors import DONE, HALF_TURN, REASONS, SINGULAR, StepFailure
from polyida.integrate.energy import loop
from polyida.integrate.energy.dense import own_table
from polyida.integrate.energy.scene import EnergyTable, PythonScene
from polyida.integrate.kinks import Grid, inner_side
from polyida.integrate.start import consistent_acceleration, on_velocity
from polyida.integrate.state import State, Stretch
from polyida.linear.lu import SingularSystem

FAR_SHORTER = 10.0  # a step as many times shorter than the next tells nothing of its accelerations
HALVINGS = 6  # of a step that fails
CHUNK_BYTES = 4_000_000  # of frames that one compiled stretch fills


class Steps:
    """Steps at one h; holds the matrix between them. halvings: how often a step that fails may be halved."""

    def __init__(self, settings, model, h, counts, halvings=HALVINGS):
        self.settings, self.model, self.h, self.counts, self.halvings = settings, model, h, counts, halvings
        self.c, self.system, self.table = np.array([4.0 / h**2, 2.0 / h]), None, table_of(model)
        self.extent = float(np.ptp(model.reference, axis=0).max()) if model.is_scene else 0.0
        self.now, self.rows, self.marks = np.zeros((loop.NOW, model.n)), np.zeros((loop.ROWS, model.m)), np.zeros(loop.MARKS)
        turning = model.m and model.needs.phi_q_varies
        self.kind = loop.DRIVEN if model.needs.driven else loop.TURNING if turning else loop.FREE

    def run(self, state, grid):
        """Yield stretches of the states at the ends of the grid's steps. Raises StepFailure."""
        self._begin(state)
        self.end = grid.end, inner_side(self.model, grid.end, self.h)
        pause, done = state.memory.get("pause", 0), grid.done
        most = 1 if self.model.switching else max(1, CHUNK_BYTES // (48 * self.model.n))
        while done < grid.count:
            longest, left = min(most, self.table.longest), pause - self.counts.steps
            end = min(done + (left if 0 < left < longest else longest), grid.count)
            for ends in self._stretches(grid.times(done, end)):
                done += len(ends)
                yield ends

    def _begin(self, state):
        now, memory = self.now, state.memory
        a, lam = memory.get("a_middle", state.a), memory.get("lam_middle", state.lam)
        if self.h > FAR_SHORTER * memory.get("h_middle", self.h):  # behind a far shorter step, which may have been a blow, none
            a = lam = 0.0
        now[loop.A :], self.rows[loop.KNOWN :], self.marks[:] = 0.0, 0.0, 0.0
        now[loop.Q0], now[loop.V0], now[loop.A], self.rows[loop.KNOWN] = state.q, memory.get("v_free", state.v), a, lam
        self._forget()

    def _forget(self):
        """Let Newton begin as with a new matrix."""
        self.marks[[loop.ORDER, loop.ORDER_LAM, loop.CONTRACTION, loop.AGE]] = 0.0, 0.0, 1.0, loop.FRESHEN

    def _stretches(self, times):
        """The states at times[1:], as far as each call of the loop goes."""
        count, first, fresh = len(times) - 1, 0, False
        qs, vs = np.empty((2, count, self.model.n))
        self.table.prepare(times, self._side(times[-1]), self.h)
        while first < count:
            if self.system is None:
                self._factor(times[first + 1])
                fresh = True
            steps, ended, moved = self._steps(first, qs[first:], vs[first:])
            if steps:
                part, first, fresh = slice(first, first + steps), first + steps, False
                yield Ends(self, times[1:][part], qs[part], vs[part], self._memory() if first == count else None)
            if ended == DONE:
                continue
            if not fresh and ended != HALF_TURN:
                self.system = None
                continue
            last = self._halved(self._here(times[first]), times[first + 1], ended, moved).last
            self._begin(last)
            first, fresh = first + 1, False
            yield Stretch.of(last)

    def _steps(self, first, qs, vs):
        """(steps, how it ended, last |dq|) of the compiled loop."""
        counts, s = np.zeros(3, np.int64), self.settings
        settings = self.c, self.h, s.tolerance, s.max_iterations, self.extent, self.kind
        with self.table.at_work(self.system) as (functions, workspace):
            ended = loop.stretch(functions, workspace, first, *settings, self.now, self.rows, self.marks, counts, qs, vs)
        self.counts.residuals += int(counts[0])
        self.counts.solves += int(counts[1])
        self.counts.newton_iterations += int(counts[1])
        self.table.raise_left()
        if counts[2]:
            self.system.read()
            self.counts.tangents += int(counts[2])
            self.counts.factorizations += int(counts[2])
        return ended

    def _memory(self):
        """What the next step begins from, beside q."""
        now = self.now
        memory = {"a_middle": now[loop.A].copy(), "lam_middle": self.rows[loop.KNOWN].copy(), "h_middle": self.h}
        return memory | ({"v_free": now[loop.V0].copy()} if self.kind == loop.TURNING else {})

    def _here(self, t):
        """The state that the next step begins from."""
        now = self.now.copy()
        return State(float(t), now[loop.Q0], now[loop.V0], now[loop.A], self.rows[loop.KNOWN].copy(), self._memory())

    def _factor(self, t):
        """A new factor for the step that ends at t."""
        h, now, counts = self.h, self.now, self.counts
        q = now[loop.Q0] + 0.5 * h * now[loop.V0] + 0.25 * h * h * now[loop.A]
        self._forget()
        self.system, lam = self.table.system(self), self.rows[loop.KNOWN].copy()
        counts.tangents += 1
        counts.factorizations += 1
        counts.residuals += 1
        try:
            self.system.factor(t - 0.5 * h, q, now[loop.V0].copy(), now[loop.A].copy(), lam, *self.c)
        except SingularSystem as error:
            raise StepFailure("singular", str(error), t) from None
        counts.backend = self.system.backend
        counts.solves += self.system.solves

    def step_matrix(self, model):
        """The model's own."""
        return model.step_matrix()

    def _halved(self, state, t, ended, moved):
        """The end at t by two steps of half the size, each keeping energy by itself."""
        if not self.halvings:
            status, reason = REASONS[ended]
            seen = {"last |dq|": float(moved), "|phi|": float(np.abs(self.rows[loop.PHI]).max(initial=0.0)), "step": self.h}
            raise StepFailure(status, f"{reason}; the step in 2 to 64 parts fails too", t, **seen)
        self.system = None
        self.counts.rejected += 1
        half = Steps(self.settings, self.model, self.h / 2, self.counts, self.halvings - 1)
        for begin, end in ((t - self.h, t - self.h / 2), (t - self.h / 2, t)):
            *_, ends = half.run(state, Grid(begin, end, 1))
            state = ends.last
        return ends

    def on_constraint(self, t, q, free):
        """[v] at ends on their constraints, each with the kinetic energy that it had, (k, n)."""
        if self.table.complete:
            v = free.copy()
            self._make(loop.put_as_fast, t, q, v, np.zeros(self.model.m))
            return [v]
        return [np.array([self._as_fast(*each) for each in zip(map(self._side, t), q, free)])]

    def _as_fast(self, t, q, free):
        on, M = on_velocity(self.model, t, q, free), self.model.mass(q)
        has = on @ (M @ on)
        return on * np.sqrt(free @ (M @ free) / has) if has > 0.0 else on

    def forces(self, t, q, v):
        """(a, lam) at ends: `[[M, B^T], [B, 0]] (a, lam) = (-g, -bias)`."""
        if self.table.complete:
            found = np.empty(q.shape), np.empty((len(q), self.model.m))
            self._make(loop.forces, t, q, v, *found)
            return found
        try:
            found = [consistent_acceleration(self.model, *each) for each in zip(map(self._side, t), q, v)]
        except np.linalg.LinAlgError:
            raise StepFailure("singular", REASONS[SINGULAR][1], t[0]) from None
        return tuple(map(np.array, zip(*found)))

    def _side(self, t):
        """The time of an end, to the side of a kink that the step is on: only the last of the grid may be at one."""
        return self.end[1] if t == self.end[0] else float(t)

    def _make(self, function, t, *arrays):
        """Call a function of the loop for ends at times t."""
        first = self.table.prepare_ends(t, self._side(t[-1]))
        ended = function(self.table.functions, self.table.workspace, first, *map(np.ascontiguousarray, arrays))
        self.table.raise_left()
        if ended != DONE:
            raise StepFailure(*REASONS[ended], t[0])


def table_of(model):
    """The table of a model with what the method needs of it."""
    if not model.is_scene:
        return own_table(model)
    return EnergyTable(model) if model.compiled and (model.laws is None or NO_ENERGY not in model.laws.energies) else PythonScene(model)


class Ends(Stretch):
    """Ends of steps: v, a and lam are made of q and the v that the next step begins with, for those ends that are asked for them.

    a and lam so are of the order of q and v, need no step before or after, and the forces of a frame are in balance. memory: what the step
    behind the last starts from, where a run may go on from there.
    """

    def __init__(self, steps, t, q, free, memory=None, part=None):
        self.steps, self.t, self.q, self.free, self.memory = steps, t, q, free, memory
        self._known, self._at, self._size = part or ({}, np.arange(len(t)), len(t))

    def _made(self, name, make, v):
        """Arrays of these ends, made of t, q and v of those for which nobody asked the whole stretch before."""
        known, at, size = self._known, self._at, self._size
        has, arrays = known.get(name) or (np.zeros(size, bool), None)
        if not has[at].all():
            new = ~has[at]
            made = make(self.t[new], self.q[new], v[new])
            has, arrays = known.setdefault(name, (has, [np.empty((size, *values.shape[1:])) for values in made]))
            has[at[new]] = True
            for values, of_new in zip(arrays, made):
                values[at[new]] = of_new
        return [values[at] for values in arrays]

    @property
    def v(self):
        """Velocities on their constraints, (k, n)."""
        return self._made("v", self.steps.on_constraint, self.free)[0] if self.steps.kind == loop.TURNING else self.free

    a = property(lambda self: self._made("forces", self.steps.forces, self.v)[0])
    lam = property(lambda self: self._made("forces", self.steps.forces, self.v)[1])

    @cached_property
    def last(self):
        """The last State."""
        return self.state(len(self) - 1)

    def state(self, k):
        """The State number k, counted from 0; it holds an Ends of its own, not this one, which may hold it."""
        return End(self._at_steps(slice(k, k + 1)))

    def part(self, first, end, every=1):
        """The ends from number `first` to before `end`, or each `every`-th of them."""
        if first == 0 and end >= len(self) and every == 1:
            return self
        return self._at_steps(slice(first, end, every))

    def _at_steps(self, at):
        """The ends in a slice; what is made for one part of a stretch is shared by all parts of it, none of which holds another."""
        whole = range(len(self))[at][-1:] == range(len(self))[-1:]
        shared = self._known, self._at[at], self._size
        return Ends(self.steps, self.t[at], self.q[at], self.free[at], self.memory if whole else None, shared)

    def finite(self):
        """Whether q and v are finite; what follows from them is looked at by those who ask for it."""
        return math.isfinite(np.vdot(self.q, self.free))


class End(State):
    """A State whose v, a and lam are made when they are first asked for: most steps of a run need not have them. ends: it alone."""

    def __init__(self, ends):
        vars(self).update(t=float(ends.t[0]), q=ends.q[0], memory=ends.memory or {}, restart=ends.memory is not None, ends=ends)

    v = property(lambda self: self.ends.v[0])
    a = property(lambda self: self.ends.a[0])
    lam = property(lambda self: self.ends.lam[0])

    def finite(self):
        """Whether q and v are finite."""
        return self.ends.finite()
