"""Steps of the energy-momentum method on one model: stretches of the compiled loop, factors, halved steps, and the states at their ends.

`Steps.run` takes the steps of a grid by stretches: the compiled loop (energy/loop.py) until it needs a factor (`_factor`) or fails with a new one
(`_halved`). `Ends` are the states of a stretch. Their velocities, accelerations and multipliers are computed by `projected` and `forces`, and only
for the ends that are asked for them.
"""

import math

import numpy as np
from scipy.sparse import csc_array

from polyida.assembly.motion import motions_as_a_whole, moves_as_a_whole
from polyida.errors import DONE, HALF_TURN, REASONS, SINGULAR, StepFailure
from polyida.integrate.discontinuities import Grid, inner_side
from polyida.integrate.energy import loop
from polyida.integrate.energy.tables import table_of
from polyida.integrate.engine import end_of_stretch
from polyida.integrate.start import consistent_acceleration, on_velocity
from polyida.integrate.state import State, Stretch
from polyida.linear.lu import SingularSystem

MUCH_SHORTER = 10.0  # the accelerations of a step shorter by that factor are not used
SCALED = 0.1  # of a kinetic energy without the motion as a whole: more is not taken from it, or added
HALVINGS = 6  # of a step that fails
CHUNK_BYTES = 4_000_000  # of frames that one compiled stretch fills


def products(M, v):
    """The products (k, n) of sparse M (n, n) with the k rows of v (k, n); each is the same to the last bit whatever the others are."""
    return np.ascontiguousarray((M @ v.T).T)


def doubled_energies(M, v):
    """`v_i^T M v_i` for each row of v (k, n), (k,): twice the kinetic energies.

    Each is the same to the last bit whatever the other rows are.
    """
    return (v[:, None, :] @ products(M, v)[:, :, None])[:, 0, 0]


class Steps:
    """Steps of one h on one model; halvings: how often a step that fails is halved."""

    def __init__(self, settings, model, h, counts, halvings=HALVINGS):
        """Make the arrays and the table of a model."""
        self.settings, self.model, self.h, self.counts, self.halvings = settings, model, h, counts, halvings
        self.c = np.array([4.0 / h**2, 2.0 / h])  # of the step matrix: c_m and c_v
        self.system = None  # the factor in use
        self.table = table_of(model)
        self.extent = float(np.ptp(model.reference, axis=0).max()) if model.is_scene else 0.0
        self.free = None  # True if no constraint prevents motions of the scene as a whole, as soon as it is asked
        self.now = np.zeros((loop.NOW, model.n))  # rows of energy/loop.py
        self.rows = np.zeros((loop.ROWS, model.m))
        self.marks = np.zeros(loop.MARKS)
        turning = model.m and model.needs.phi_q_varies
        self.kind = loop.PROJECTED if model.needs.driven else loop.FRAMES_PROJECTED if turning else loop.FREE

    def run(self, state, grid):
        """Yield stretches of the states at the ends of the grid's steps. Raises StepFailure."""
        self._begin(state)
        self.end = grid.end, inner_side(self.model, grid.end, self.h)
        pause, done = state.memory.get("pause", 0), grid.done
        most = 1 if self.model.switching else max(1, CHUNK_BYTES // (48 * self.model.n))
        while done < grid.count:
            longest, to_pause = min(most, self.table.longest, self.model.longest_stretch), pause - self.counts.steps
            for ends in self._stretches(grid.times(done, end_of_stretch(grid, done, longest, to_pause))):
                done += len(ends)
                yield ends

    def _begin(self, state):
        """Begin with a state: its q and v, and the acceleration and the multipliers in the middle of the step before."""
        now, memory = self.now, state.memory
        a, lam = memory.get("a_middle", state.a), memory.get("lam_middle", state.lam)
        if self.h > MUCH_SHORTER * memory.get("h_middle", self.h):  # the shorter step may have been a blow
            a = lam = 0.0
        now[loop.A :], self.rows[loop.LAMS :], self.marks[:] = 0.0, 0.0, 0.0
        now[loop.Q0], now[loop.V0], now[loop.A], self.rows[loop.LAMS] = state.q, memory.get("v_free", state.v), a, lam
        self._forget()

    def _forget(self):
        """Let Newton's method begin as with a new matrix."""
        self.marks[[loop.ORDER, loop.ORDER_LAM, loop.CONTRACTION, loop.AGE]] = 0.0, 0.0, 1.0, loop.FRESHEN

    def _stretches(self, times):
        """Yield the states at times[1:], as far as each call of the loop goes; a step that fails is halved. Raises StepFailure."""
        count, first = len(times) - 1, 0
        fresh = False  # the factor was made for the next step
        qs, vs = np.empty((2, count, self.model.n))
        self.table.prepare(times, self._side(times[-1]), self.h)
        while first < count:
            if self.system is None:
                self._factor(times[first + 1])
                fresh = True
            steps, ended, moved = self._steps(first, qs[first:], vs[first:])
            error = self.table.take_error()
            if steps:
                part, first, fresh = slice(first, first + steps), first + steps, False
                yield Ends(self, times[1:][part], qs[part], vs[part], self._memory() if first == count else None)
            if ended == DONE:
                continue
            if error is not None:
                raise error
            if not fresh and ended != HALF_TURN:
                self.system = None
                continue
            now = self.now.copy()
            here = State(float(times[first]), now[loop.Q0], now[loop.V0], now[loop.A], self.rows[loop.LAMS].copy(), self._memory())
            last = self._halved(here, times[first + 1], ended, moved).last
            self._begin(last)
            first, fresh = first + 1, False
            yield Stretch.of(last)

    def _steps(self, first, qs, vs):
        """(steps, how it ended, last |dq|) of the compiled loop."""
        counts, s = np.zeros(3, np.int64), self.settings
        method = loop.Method(self.h, self.c, s.tolerance, s.max_iterations, self.extent, self.kind, self.model.velocity_rows)
        with self.table.at_work(self.system) as (functions, workspace):
            ended = loop.take_steps(functions, workspace, first, method, self.now, self.rows, self.marks, counts, qs, vs)
        self.counts.add(counts[0], counts[1])
        if counts[2]:
            self.system.read()
            self.counts.add(factors=counts[2])
        return ended

    def _memory(self):
        """What the next step begins from, beside q."""
        now = self.now
        memory = {"a_middle": now[loop.A].copy(), "lam_middle": self.rows[loop.LAMS].copy(), "h_middle": self.h}
        return memory | ({"v_free": now[loop.V0].copy()} if self.kind == loop.FRAMES_PROJECTED else {})

    def _factor(self, t):
        """A new factor for the step that ends at t."""
        h, now = self.h, self.now
        q = now[loop.Q0] + 0.5 * h * now[loop.V0] + 0.25 * h * h * now[loop.A]
        self._forget()
        self.system, lam = self.table.system(self), self.rows[loop.LAMS].copy()
        self.counts.add(residuals=1, factors=1)
        try:
            self.system.factor(t - 0.5 * h, q, now[loop.V0].copy(), now[loop.A].copy(), lam, *self.c)
        except SingularSystem as error:
            raise StepFailure("singular", str(error), t) from None
        self.counts.add(system=self.system)

    def step_matrix(self, model):
        """The step matrix of the model, which the table factors."""
        return model.step_matrix()

    def _halved(self, state, t, ended, moved):
        """The end at t by two steps of half the size, each of which conserves energy."""
        if not self.halvings:
            status, reason = REASONS[ended]
            seen = {"last |dq|": float(moved), "|phi|": float(np.abs(self.rows[loop.PHI]).max(initial=0.0)), "step": self.h}
            tried = "" if self.model.switching else f"; the step in 2 to {2**HALVINGS} parts fails too"
            raise StepFailure(status, reason + tried, t, **seen)
        self.system = None
        self.counts.rejected += 1
        half = Steps(self.settings, self.model, self.h / 2, self.counts, self.halvings - 1)
        for begin, end in ((t - self.h, t - self.h / 2), (t - self.h / 2, t)):
            *_, ends = half.run(state, Grid(begin, end, 1))
            state = ends.last
        return ends

    def projected(self, t, q, v_free):
        """[v] at ends, projected onto their constraints and scaled to their kinetic energy, (k, n).

        The projection does not change the motion as a whole of a scene that no constraint holds; only the velocity beside it is scaled.
        """
        M, v = csc_array(self.model.mass(q[0])), v_free.copy()
        if self.table.complete:
            self._call(loop.project_frames, t, q, v, np.zeros(self.model.m))
        else:
            v[:] = [on_velocity(self.model, *end) for end in zip(map(self._side, t), q, v_free)]
        common = self._common(t, q, v_free, M)
        inner = doubled_energies(M, v - common)
        alone = abs(doubled_energies(M, v_free - common) - inner) < SCALED * inner
        common[~alone] = 0.0
        before, after = doubled_energies(M, v_free - common), doubled_energies(M, v - common)
        factors = np.sqrt(np.divide(before, after, out=np.ones(len(t)), where=after > 0.0))
        return [common + factors[:, None] * (v - common)]

    def _common(self, t, q, v, M):
        """The parts of velocities (k, n) in which a free scene moves as one rigid body; zero if constraints hold it, or of a user's model."""
        if self.free is None:
            self.free = self.model.is_scene and moves_as_a_whole(self.model, self._side(t[0]), q[0])
        if not self.free:
            return np.zeros_like(v)
        whole = motions_as_a_whole(self.model, q)
        momenta = np.stack([products(M, whole[:, :, k]) for k in range(3)], axis=1)
        rates = np.linalg.pinv(momenta @ whole, hermitian=True) @ (momenta @ v[:, :, None])
        return (whole @ rates)[:, :, 0]

    def forces(self, t, q, v):
        """(a, lam) at ends: `[[M, B^T], [B, 0]] (a, lam) = (-g, -bias)`."""
        if self.table.complete:
            arrays = np.empty(q.shape), np.empty((len(q), self.model.m))
            self._call(loop.forces, t, q, v, *arrays)
            return arrays
        try:
            each = [consistent_acceleration(self.model, *at) for at in zip(map(self._side, t), q, v)]
        except np.linalg.LinAlgError:
            raise StepFailure("singular", REASONS[SINGULAR][1], t[0]) from None
        return tuple(map(np.array, zip(*each)))

    def _side(self, t):
        """The time of an end, on the step's side of a kink, which may be at the grid's end only."""
        return self.end[1] if t == self.end[0] else float(t)

    def _call(self, function, t, *arrays):
        """Call a function of the loop for ends at times t."""
        first = self.table.prepare_ends(t, self._side(t[-1]))
        ended = function(self.table.functions, self.table.workspace, first, *map(np.ascontiguousarray, arrays))
        self.table.raise_error()
        if ended != DONE:
            raise StepFailure(*REASONS[ended], t[0])


class Ends(Stretch):
    """Ends of steps, whose v, a and lam are computed from q and the v of the next step, for the ends that are asked for them.

    a and lam have the order of q and v, need no step before or after, and balance the forces of a frame. memory: what the step behind the
    last end starts from, or None if a run cannot go on from there.
    """

    def __init__(self, steps, t, q, v_free, memory=None, shared=None):
        """Take arrays of k ends; shared: what parts of one stretch share."""
        self.steps, self.t, self.q, self.v_free, self.memory = steps, t, q, v_free, memory
        self._computed, self._at, self._size = shared or ({}, np.arange(len(t)), len(t))

    def _compute(self, name, function, v):
        """Arrays of these ends, function(t, q, v), called for those of the whole stretch that were not computed before."""
        computed, at, size = self._computed, self._at, self._size
        known, arrays = computed.get(name) or (np.zeros(size, bool), None)
        if not known[at].all():
            new = ~known[at]
            results = function(self.t[new], self.q[new], v[new])
            known, arrays = computed.setdefault(name, (known, [np.empty((size, *values.shape[1:])) for values in results]))
            known[at[new]] = True
            for values, of_new in zip(arrays, results):
                values[at[new]] = of_new
        return [values[at] for values in arrays]

    @property
    def v(self):
        """Velocities on their constraints, (k, n)."""
        projected = self.steps.kind == loop.FRAMES_PROJECTED
        return self._compute("v", self.steps.projected, self.v_free)[0] if projected else self.v_free

    a = property(lambda self: self._compute("forces", self.steps.forces, self.v)[0])
    lam = property(lambda self: self._compute("forces", self.steps.forces, self.v)[1])

    def _state(self, k):
        """State number k, from 0, with Ends of its own, not these, which may hold it."""
        return End(self._part(slice(k, k + 1)))

    def part(self, first, end, every=1):
        """The ends from number `first` to before `end`, or each `every`-th of them."""
        if first == 0 and end >= len(self) and every == 1:
            return self
        return self._part(slice(first, end, every))

    def _part(self, at):
        """The ends in a slice; all parts of a stretch share the computed arrays, and no part holds another."""
        has_last = range(len(self))[at][-1:] == range(len(self))[-1:]
        shared = self._computed, self._at[at], self._size
        return Ends(self.steps, self.t[at], self.q[at], self.v_free[at], self.memory if has_last else None, shared)

    def finite(self):
        """True if q and v are finite; a and lam are not computed for it."""
        return math.isfinite(np.vdot(self.q, self.v_free))


class End(State):
    """A State whose v, a and lam are computed when they are first asked for. ends: Ends of this state alone."""

    def __init__(self, ends):
        """Take t, q and memory from the Ends of one state, and leave v, a and lam for later."""
        vars(self).update(t=float(ends.t[0]), q=ends.q[0], memory=ends.memory or {}, restart=ends.memory is not None, ends=ends)

    v = property(lambda self: self.ends.v[0])
    a = property(lambda self: self.ends.a[0])
    lam = property(lambda self: self.ends.lam[0])

    def finite(self):
        """True if q and v are finite."""
        return self.ends.finite()
