"""The energy-momentum method of Simo and Tarnow (1992), with the discrete derivative of Gonzalez (1996) for users' models.

`phi = 0` at both ends leaves the deviation of `v_1 = 2 (q_1 - q_0)/h - v_0` from `phi_q v + phi_t = 0` as large as that of v_0, with the
opposite sign: the effect of a motor's jerk would alternate for ever, and appear in lam divided by h. So if phi is driven, v_1 is projected
along M^-1 phi_q^T; lam takes up what a step misses; a motor's energy was measured to be off by 4e-13 a step at 20 rad/s and 4 ms.
If nothing is driven, there is an energy to conserve, and v_1, off its constraint by O(h^2), has it. So the next step begins from that v_1
(memory "v_free"), which conserves energy and momenta; in the frame v_1 is projected and scaled to its kinetic energy, without the motion of
a free scene as a whole, whose momenta stay.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from scipy.sparse import csc_array

from polyida.assembly.motion import motions_as_a_whole, moves_as_a_whole
from polyida.errors import DONE, HALF_TURN, REASONS, SINGULAR, InputError, StepFailure
from polyida.fields import above_zero, check_fields, must_be
from polyida.integrate.discontinuities import Grid, at_kink, inner_side, number_of_steps, pieces
from polyida.integrate.energy import loop
from polyida.integrate.energy.tables import OF_ENERGY, table_of
from polyida.integrate.sizes import states_at_rest
from polyida.integrate.start import consistent_acceleration, on_velocity
from polyida.integrate.state import Counts, Integrator, State, States, Stretch
from polyida.linear.lu import SingularSystem
from polyida.model import Model
from polyida.model.check import require_energies
from polyida.model.compiled import Compiled
from polyida.model.differences import beside
from polyida.model.guarded import guard, require_written
from polyida.validation import is_number, is_whole, named_keywords

SAME = 1e-9  # relative difference of what should be equal
MUCH_SHORTER = 10.0  # the accelerations of a step shorter by that factor are not used
SCALED = 0.1  # of a kinetic energy without the motion as a whole: more is not taken from it, or added
HALVINGS = 6  # of a step that fails
CHUNK_BYTES = 4_000_000  # of frames that one compiled stretch fills


@named_keywords
@dataclass(frozen=True)
class EnergyMomentum(Integrator):
    """Constant steps that conserve energy and momenta in the discrete sense.

    `M (v_1 - v_0)/h + f_int + B^T lam = f_ext(t_m)`, `q_1 - q_0 = h (v_0 + v_1)/2`, `phi(q_1, t_1) = 0`.

    Parameters
    ----------
    h : float, s
        Step. A run takes the largest step not above h that divides its time evenly, and at least four steps behind a kink of loads that are
        not straight lines.
    tolerance : float
        Newton's tolerance, of h^2 times the size of the acceleration.
    max_iterations : int
        Largest number of iterations of one Newton solve.

    Raises
    ------
    InputError
        For a setting out of range; a run raises it for a model that the method does not take.

    Notes
    -----
    The stress is that of the mean of the strains at both ends on the mean F; B is phi_q at the mean q and t. Without motors and damping the
    energy changes by what Newton's method leaves, since `f_int . (q_1 - q_0) = W_1 - W_0` and `B (q_1 - q_0) = 0`. Damping acts at the middle
    of the step and only takes energy. q, v, a and lam are of second order; velocities of frames satisfy their constraint. a and lam are
    computed for the frames that are kept; on plates that costs half to two thirds of a step.

    Models: every scene, with users' force elements and bodies by the discrete derivative of their energy, and every user's model with a
    `potential`, constant mass and phi at most quadratic in q. Other forces act at the middle. If phi_q varies, energy is conserved with
    `Needs(driven=False)` only. The discrete derivative of a potential is along `M (q_1 - q_0)`: momenta of a user's model change by the error of
    the method. Its slope along a step is a central difference of sixth order over a quarter of the step, whose error goes into the energy.

    Simo, Tarnow, ZAMP 43 (1992) 757-792; Gonzalez, CMAME 190 (2000) 1763-1783 for the stress; J. Nonlinear Sci. 6 (1996) 449-467 for the
    discrete derivative.
    """

    h: float = field(metadata=must_be("a positive step in s", above_zero))
    tolerance: float = field(default=1e-10, metadata=must_be("between 0 and 1", lambda x: is_number(x) and 0 < x < 1))
    max_iterations: int = field(default=40, metadata=must_be("a positive whole number", is_whole))
    trusted, order = True, 2

    def __post_init__(self):
        check_fields(self, self.class_name())

    def require(self, model: Model) -> None:
        """Raise InputError unless the method takes the model: any scene; a user's with a potential, constant mass, phi at most quadratic.

        Elements and models that declare conservative forces must give the energies of these. Functions are tested at random places.
        """
        if not model.is_scene:
            own, random = guard(model, "EnergyMomentum"), np.random.default_rng(0)
            require_written(own)
            q, d = random.standard_normal((2, own.n))
            part, other = f"EnergyMomentum: {own.name}", "; use GeneralizedAlpha or IDA"
            if own.potential(q) is None:
                raise InputError(f"{part} gives no potential(q), so there is no energy to keep{other}")
            if own.needs.mass_varies and not _equal(own.mass(q), own.mass(q + d)):
                raise InputError(f"{part}: its mass varies with q; it must be constant{other}")
            move = np.delete(2.0 * own.phi_q(0.0, q) @ d, own.velocity_rows)  # the force of a velocity row does no work in any case
            gain = np.delete(own.phi(0.0, q + d) - own.phi(0.0, q - d), own.velocity_rows)
            if move.size and not _equal(gain, move):
                wanted = "which its constraints must be to do no work"
                raise InputError(f"{part}: its phi(t, q) is not quadratic in q, at most, {wanted}{other}")
            if own.by_numba:
                Compiled(own, OF_ENERGY)
        own = guard(model)
        require_energies(own, 0.0, np.zeros(own.n))

    def steps(self, model: Model, state: State, t_end: float, counts: Counts) -> Iterator[State]:
        """Accepted states after `state` up to t_end, one for each step. Raises StepFailure."""
        return States(self._stretches(model, state, t_end, counts), counts)

    def _stretches(self, model, state, t_end, counts):
        for begin, end, most in pieces(model, state.t, t_end, self.h):
            t = beside(begin, 1) if at_kink(model, begin) else begin  # behind a jump of a motor's speed
            v, memory = model.sampled(begin, state.q, state.v), state.memory
            if "v_free" in memory and v is not state.v:
                memory = memory | {"v_free": memory["v_free"] + (v - state.v)}
            state = State(state.t, state.q, on_velocity(model, t, state.q, v), state.a, state.lam, memory)
            grid = Grid(begin, end, number_of_steps(model, state, begin, end, min(self.h, most)))
            for state in states_at_rest(model, state, grid, counts):
                grid = grid._replace(done=grid.done + 1)
                counts.steps += 1
                yield Stretch.of(state)
            if grid.done == grid.count:
                continue
            for ends in Steps(self, model, grid.h, counts, 0 if model.switching else HALVINGS).run(state, grid):
                counts.steps += len(ends)
                yield ends
            state = ends.last


def _equal(one, other):
    return abs(one - other).max() <= SAME * (abs(one).max() + abs(other).max())


def products(M, v):
    """`M v` of velocities (k, n), M sparse; each is the same to the last bit whatever the others are."""
    return np.ascontiguousarray((M @ v.T).T)


def doubled_energies(M, v):
    """`v^T M v` of velocities (k, n), as `products` has it."""
    return (v[:, None, :] @ products(M, v)[:, :, None])[:, 0, 0]


class Steps:
    """Steps of one h on one model; halvings: how often a step that fails is halved."""

    def __init__(self, settings, model, h, counts, halvings=HALVINGS):
        self.settings, self.model, self.h, self.counts, self.halvings = settings, model, h, counts, halvings
        self.c, self.system, self.table = np.array([4.0 / h**2, 2.0 / h]), None, table_of(model)
        self.extent = float(np.ptp(model.reference, axis=0).max()) if model.is_scene else 0.0
        self.free = None  # True if no constraint prevents motions of the scene as a whole, as soon as it is asked
        self.now, self.rows, self.marks = np.zeros((loop.NOW, model.n)), np.zeros((loop.ROWS, model.m)), np.zeros(loop.MARKS)
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
            end = min(done + (to_pause if 0 < to_pause < longest else longest), grid.count)
            for ends in self._stretches(grid.times(done, end)):
                done += len(ends)
                yield ends

    def _begin(self, state):
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
        """The states at times[1:], as far as each call of the loop goes."""
        count, first, fresh = len(times) - 1, 0, False
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
        """The model's own."""
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
        vars(self).update(t=float(ends.t[0]), q=ends.q[0], memory=ends.memory or {}, restart=ends.memory is not None, ends=ends)

    v = property(lambda self: self.ends.v[0])
    a = property(lambda self: self.ends.a[0])
    lam = property(lambda self: self.ends.lam[0])

    def finite(self):
        """True if q and v are finite."""
        return self.ends.finite()
