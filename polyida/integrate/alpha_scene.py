"""Steps of generalized-alpha on a scene: whole stretches in compiled code, one stale factor in the frame of the nodal rotations."""

from typing import NamedTuple

import numpy as np

from polyida.assembly import equilibrium as kernels
from polyida.assembly import joints
from polyida.compiled import entry, part
from polyida.integrate.alpha_generic import started
from polyida.integrate.grid import goes_on, grid_of
from polyida.integrate.state import State, StepFailure
from polyida.linear import corotated
from polyida.linear.factor import NotFactorable

SLOW = 0.3  # contraction above which the matrix is made anew
FRESHEN = 10  # steps after which the contraction is measured again
CHUNK_BYTES = 4_000_000  # of frames that one compiled stretch fills
DONE, REFACTOR, INVERTED, NOT_FINITE, HALF_TURN, SINGULAR = range(6)


class Method(NamedTuple):
    """Numbers of the method at one h."""

    h: float
    alpha_m: float
    alpha_f: float
    beta: float
    gamma: float
    to_a: float
    to_v: float
    tolerance: float
    max_iterations: int


class Memory(NamedTuple):
    """What goes from step to step: states in place, and in `marks` contraction, its age in steps, size of q'', extrapolate or not."""

    u: np.ndarray
    v: np.ndarray
    a: np.ndarray
    a_alg: np.ndarray
    a_before: np.ndarray
    lam: np.ndarray
    marks: np.ndarray


class Trial(NamedTuple):
    """The state that Newton works on, and its scratch."""

    u: np.ndarray
    v: np.ndarray
    a: np.ndarray
    lam: np.ndarray
    r: np.ndarray
    phi: np.ndarray
    rotation: np.ndarray
    dz: np.ndarray
    forces: np.ndarray
    dq: np.ndarray
    dlam: np.ndarray


@entry
def predict(p, y, w):
    """Fill the trial state: q'' constant or extrapolated, whichever was nearer in the last step, lam constant."""
    forward = y.marks[3]
    for i in range(y.u.shape[0]):
        for k in range(2):
            a = y.a[i, k] + forward * (y.a[i, k] - y.a_before[i, k])
            a1 = ((1.0 - p.alpha_f) * a + p.alpha_f * y.a[i, k] - p.alpha_m * y.a_alg[i, k]) / (1.0 - p.alpha_m)
            w.a[i, k] = a
            w.v[i, k] = y.v[i, k] + p.h * ((1.0 - p.gamma) * y.a_alg[i, k] + p.gamma * a1)
            w.u[i, k] = y.u[i, k] + p.h * y.v[i, k] + p.h * p.h * ((0.5 - p.beta) * y.a_alg[i, k] + p.beta * a1)
    for k in range(w.lam.shape[0]):
        w.lam[k] = y.lam[k]


@part
def correct(p, w):
    """Add dq and dlam to the trial state; the sums of dq^2, q^2 and q''^2."""
    moved = size = pull = 0.0
    for i in range(w.u.shape[0]):
        for k in range(2):
            d = w.dq[i, k]
            w.u[i, k] += d
            w.v[i, k] += p.to_v * d
            w.a[i, k] += p.to_a * d
            moved += d * d
            size += w.u[i, k] * w.u[i, k]
            pull += w.a[i, k] * w.a[i, k]
    for k in range(w.lam.shape[0]):
        w.lam[k] += w.dlam[k]
    n = 2.0 * w.u.shape[0]
    return np.sqrt(moved / n), np.sqrt(size / n), np.sqrt(pull / n)


@part
def accept(p, y, w):
    """Move the trial state into memory; the better predictor for the next step; the algorithmic acceleration."""
    constant = extrapolated = 0.0
    for i in range(y.u.shape[0]):
        for k in range(2):
            a, a0 = w.a[i, k], y.a[i, k]
            constant += (a - a0) ** 2
            extrapolated += (a - 2.0 * a0 + y.a_before[i, k]) ** 2
            y.a_alg[i, k] = ((1.0 - p.alpha_f) * a + p.alpha_f * a0 - p.alpha_m * y.a_alg[i, k]) / (1.0 - p.alpha_m)
            y.a_before[i, k] = a0
            y.a[i, k] = a
            y.u[i, k] = w.u[i, k]
            y.v[i, k] = w.v[i, k]
    for k in range(w.lam.shape[0]):
        y.lam[k] = w.lam[k]
    y.marks[3] = 1.0 if extrapolated < constant else 0.0


@part
def closed(s, drives, w):
    """Largest |phi| at the trial state, and the least cosine of a motor's angle error."""
    joints.point_values(s, w.u, w.dz)
    cosine = joints.joint_forces(s, drives, w.dz, w.lam, w.phi, w.forces)
    worst = 0.0
    for k in range(w.phi.shape[0]):
        worst = max(worst, abs(w.phi[k]))
    return worst, cosine


@part
def newton(s, c, room, p, drives, y, w, counts):
    """Newton's iteration from the predicted state. Returns how it ended and the last |dq|."""
    predict(p, y, w)
    rate, before = y.marks[0], 0.0
    y.marks[2] *= 0.9
    for iteration in range(p.max_iterations):
        det, cosine = kernels.equilibrium(s, drives, w.u, w.a, w.lam, w.r, w.phi, w.rotation, w.dz, w.forces)
        counts[0] += 1
        if not det > 0.0:
            return (INVERTED if det <= 0.0 else NOT_FINITE), before
        if not corotated.solve(s.links, c, room, drives, w.rotation, w.dz, w.lam, w.r, w.phi, p.to_a, w.dq, w.dlam):
            return SINGULAR, before
        counts[1] += 1
        moved, size, pull = correct(p, w)
        y.marks[2] = max(y.marks[2], pull)
        if iteration == 0:
            rate = y.marks[0]
        else:
            rate = moved / before if before > 0.0 else 0.0
            y.marks[0], y.marks[1] = (max(rate, 0.5 * y.marks[0]) if iteration == 1 else max(rate, y.marks[0])), 0.0
        tolerance = p.tolerance * y.marks[2] / p.to_a
        floor = 16.0 * 2.2e-16 * size
        known = iteration > 0 or y.marks[1] < FRESHEN
        if moved <= floor or (known and rate < 1.0 and moved * rate / (1.0 - rate) <= tolerance):
            worst, cosine = closed(s.links, drives, w)
            if worst <= max(1e-2 * tolerance, floor):
                y.marks[1] += 1.0
                return (DONE if cosine > 0.0 else HALF_TURN), moved
        if iteration > 0 and rate > SLOW and moved > floor:
            return REFACTOR, moved
        before = moved
    return REFACTOR, before


@part
def record(y, q, v, a, lam):
    """Copy the accepted state into a frame."""
    for i in range(q.shape[0]):
        for k in range(2):
            q[i, k], v[i, k], a[i, k] = y.u[i, k], y.v[i, k], y.a[i, k]
    for k in range(lam.shape[0]):
        lam[k] = y.lam[k]


@entry
def stretch(s, c, room, p, drives, y, w, counts, qs, vs, accelerations, lams):
    """Steps until the drives' table or the factor's use ends; frames go to qs, vs, accelerations, lams. (steps, end, last |dq|)."""
    for k in range(qs.shape[0]):
        end, moved = newton(s, c, room, p, drives[k], y, w, counts)
        if end != DONE:
            return k, end, moved
        accept(p, y, w)
        record(y, qs[k], vs[k], accelerations[k], lams[k])
    return qs.shape[0], DONE, moved


def advance(settings, model, state, begin, end, count, counts):
    """Yield `count` equal steps from begin to end. Raises StepFailure."""
    grid = grid_of(state, begin, end, count)
    stretches = Stretches(settings, model, started(settings, model, state, grid.h), grid.h, counts)
    if goes_on(model, state, grid, "marks"):
        stretches.recall(state.memory)
    yield from stretches.run(grid)


class Stretches:
    """Runs compiled stretches at one h, and makes a factor where one asks for it."""

    def __init__(self, settings, model, state, h, counts):
        c = settings.coefficients
        self.model, self.counts, self.backend = model, counts, settings.linear
        self.method = Method(h, c.alpha_m, c.alpha_f, c.beta, c.gamma, (1 - c.alpha_m) / (c.beta * h * h * (1 - c.alpha_f)),
                             c.gamma / (c.beta * h), settings.tolerance, settings.max_iterations)
        nodal = [np.array(x, float).reshape(model.n_nodes, 2) for x in (state.q, state.v, state.a, state.memory["a_alg"], state.a)]
        self.memory = Memory(*nodal, np.array(state.lam, float), np.array([1.0, FRESHEN, 0.0, 0.0]))
        nodes, points = (model.n_nodes, 2), (model.n_points, 2)
        self.trial = Trial(np.empty(nodes), np.empty(nodes), np.empty(nodes), np.empty(model.m), np.empty(nodes), np.empty(model.m),
                           np.empty(nodes), np.empty(points), np.empty(points), np.empty(nodes), np.empty(model.m))
        self.system = self.room = self.factored_at = None

    def recall(self, memory):
        """Take up Newton's memory at a restart, with the factor that it had, so that the run is the same bit by bit."""
        self.memory.a_before[:] = memory["a_before"].reshape(-1, 2)
        if len(memory["factored_at"]):
            self.trial.u[:] = memory["factored_at"].reshape(-1, 2)
            self._factor_there(float("nan"), np.zeros((len(self.model.profiles), 3)))
        self.memory.marks[:] = memory["marks"]

    def run(self, grid):
        """Yield the states at the ends of the grid's steps."""
        done, count = grid.done, grid.count
        longest = int(max(1, min(256, CHUNK_BYTES // (48 * max(1, self.model.n)))))
        while done < count:
            end = min(done + longest, count)
            for state in self._stretch([grid.time(k) for k in range(done + 1, end + 1)], grid.after(end)):
                done += 1
                self.counts.steps += 1
                yield state

    def _stretch(self, times, place):
        frames = [np.empty((len(times), self.model.n_nodes, 2)) for _ in range(3)] + [np.empty((len(times), self.model.m))]
        drives = np.ascontiguousarray([self.model.drives(t) for t in times])
        first, fresh_at = 0, -1
        while first < len(times):
            if self.system is None:
                self._factor(times[first], drives[first])
                fresh_at = first
            seen = np.zeros(2, np.int64)
            steps, ended, moved = stretch(self.model.arrays, self.system, self.room, self.method, drives[first:], self.memory,
                                          self.trial, seen, *(frame[first:] for frame in frames))
            self._count(seen)
            for k in range(first, first + steps):
                last = k == len(times) - 1
                yield self._state(times[k], *(frame[k] for frame in frames), place if last else None)
            first += steps
            if ended == DONE:
                return
            if ended != REFACTOR or fresh_at == first:
                self._fail(ended, times[first], moved)
            self.system = None

    def _count(self, seen):
        self.counts.residuals += int(seen[0])
        self.counts.solves += int(seen[1])
        self.counts.newton_iterations += int(seen[1])

    def _state(self, t, q, v, a, lam, place):
        """A State; at the end of a stretch with all that the next one starts from."""
        y, memory = self.memory, {}
        if place is not None:
            made = np.zeros(0) if self.system is None else self.factored_at
            memory = {"a_alg": y.a_alg.ravel().copy(), "h": self.method.h, "a_before": y.a_before.ravel().copy(),
                      "marks": y.marks.copy(), "factored_at": made, "grid": place}
        return State(float(t), q.ravel(), v.ravel(), a.ravel(), lam, memory, restart=place is not None)

    def _factor(self, t, drives):
        predict(self.method, self.memory, self.trial)
        self._factor_there(t, drives)

    def _factor_there(self, t, drives):
        """The factor at the trial state's u, which decides it alone."""
        model, p, w = self.model, self.method, self.trial
        self.factored_at = w.u.ravel().copy()
        kernels.equilibrium(model.arrays, drives, w.u, w.a, w.lam, w.r, w.phi, w.rotation, w.dz, w.forces)
        blocks = np.empty((len(model.pattern[1]), 2, 2))
        kernels.tangent_blocks(model.arrays.plates, w.u, p.to_a, 1.0, blocks)
        self.counts.residuals += 1
        self.counts.tangents += 1
        self.counts.factorizations += 1
        try:
            self.system, name = corotated.corotated(model, blocks, w.rotation, self.backend)
        except NotFactorable as error:
            raise StepFailure("singular", str(error), t) from None
        self.counts.backend = name
        self.room = corotated.room(model, self.system)
        self.counts.solves += 2 * model.n_points
        self.memory.marks[0], self.memory.marks[1] = 1.0, FRESHEN

    def _fail(self, ended, t, moved):
        status, reason = {
            REFACTOR: ("newton", "Newton does not converge with a fresh matrix"),
            INVERTED: ("inverted", "an element is turned inside out; St. Venant-Kirchhoff has collapsed in compression"),
            NOT_FINITE: ("not finite", "the motion is not finite"),
            HALF_TURN: ("half-turn", "a motor stands on the wrong half-turn"),
            SINGULAR: ("singular", "the constraints' system is singular"),
        }[ended]
        raise StepFailure(status, reason, t, **{"last |dq|": float(moved), "|phi|": float(np.abs(self.trial.phi).max(initial=0))})
