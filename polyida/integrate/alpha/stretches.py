"""Generalized-alpha on a scene: compiled stretches, factors where they ask for one, states from frames."""

import numpy as np

from polyida.assembly import equilibrium as kernels
from polyida.assembly.damping import symmetric_blocks
from polyida.integrate.alpha import scene as compiled
from polyida.integrate.alpha.arrays import AGE, AHEAD, BEHIND, ERROR, MARKS, MOVED, RATE, Memory, Method, trial
from polyida.integrate.alpha.increment import drive_table, extent, gain_table, start_values
from polyida.integrate.alpha.scene import FRESHEN
from polyida.integrate.alpha.step_control import Kept, calm_error, weights
from polyida.integrate.alpha.tie import tie
from polyida.integrate.state import State, StepFailure
from polyida.linear import corotated
from polyida.linear.factor import NotFactorable

LONGEST, ADAPTIVE = 256, 32  # steps of a stretch; of one whose step may change any time
REASONS = {
    compiled.REFACTOR: ("newton", "Newton does not converge with fresh matrices"),
    compiled.INVERTED: ("inverted",
                        "an element is turned inside out; St. Venant-Kirchhoff has collapsed in compression"),
    compiled.NOT_FINITE: ("not finite", "the motion is not finite"),
    compiled.HALF_TURN: ("half-turn", "a motor stands on the wrong half-turn"),
    compiled.SINGULAR: ("singular", "the constraints' system is singular"),
}


class Stretches:
    """Steps on one model: `begin` sets state and h, `run` goes on from there.

    verdict: "far" or "near" where adaptive steps should be shorter or longer.
    """

    chunk_bytes = 4_000_000  # of frames that one compiled stretch fills

    def __init__(self, settings, model, counts):
        self.settings, self.model, self.counts = settings, model, counts
        nodes = (model.n_nodes, 2)
        self.tie = tie(model) if settings.form == "stabilised" and model.m else None
        self.damp = np.zeros(nodes) if model.needs.velocity_forces else None
        self.memory = Memory(*map(np.zeros, (nodes,) * 7 + (model.m,) * 3 + (MARKS,)))
        self.trial = trial(model.n_nodes, model.n_points, model.m)
        self.system = self.room = self.factored_at = self.verdict = None
        self.kept, self.pause = Kept(), 0

    def begin(self, state, h):
        """Go on from a state that `started` has made ready for steps of h.

        memory["pause"]: the number of steps (of counts) after which a stretch ends, for what it leaves in memory there.
        """
        self.pause = state.memory.get("pause", self.pause)
        s, c, y = self.settings, self.settings.coefficients, self.memory
        to_a, to_v = (1 - c.alpha_m) / (c.beta * h * h * (1 - c.alpha_f)), c.gamma / (c.beta * h)
        self.method = Method(
            h, c.alpha_m, c.alpha_f, c.beta, c.gamma, to_a, to_v, *s.newton_tolerance(to_a * h * h), extent(self.model, state.q),
            bool(s.incremental_phi), s.max_iterations, abs(c.error) * h * h if s.adaptive else 0.0, s.rtol or 0.0,
            s.atol or 0.0, calm_error(h, s.h))
        for array, value in zip(y, (state.q, state.v, state.a, state.memory["a_alg"])):
            array[:] = np.reshape(value, array.shape)
        y.change[:] = y.earlier[:] = 0.0
        y.lam[:] = state.lam
        y.phi[:], y.rate[:] = start_values(self.model, state)
        y.weights[:] = weights(self.model, state.q).reshape(y.weights.shape)
        y.marks[:] = 0.0
        self.verdict = None
        self._take(h)

    def _take(self, h):
        """The factor made at this step before, where adaptive steps return to it."""
        self.system, self.room, self.factored_at = self.kept.take(h) or (None, None, None)
        self.memory.marks[RATE], self.memory.marks[AGE] = 1.0, FRESHEN

    def recall(self, memory):
        """Take up Newton's memory at a restart, with the factor that it had, so that the run is the same bit by bit."""
        for name in ("change", "earlier"):
            getattr(self.memory, name)[:] = memory[name].reshape(-1, 2)
        if len(memory["factored_at"]):
            self.trial.u[:] = memory["factored_at"].reshape(-1, 2)
            self._factor(float("nan"), np.zeros((len(self.model.profiles), 3)))
        self.memory.marks[:] = memory["marks"]
        self.method = self.method._replace(extent=float(memory["extent"]))

    def run(self, grid):
        """Yield the states at the ends of the grid's steps, until the verdict says otherwise. Raises StepFailure."""
        done, self.verdict = grid.done, None
        most = ADAPTIVE if self.settings.adaptive else LONGEST
        longest = int(max(1, min(most, self.chunk_bytes // (48 * max(1, self.model.n)))))
        while done < grid.count and self.verdict is None:
            left = self.pause - self.counts.steps
            end = min(done + (left if 0 < left < longest else longest), grid.count)
            for state in self._stretch(np.array([grid.time(k) for k in range(done, end + 1)]), grid, done):
                done += 1
                yield state

    def _stretch(self, times, grid, done):
        """The states at times[1:]."""
        model, count = self.model, len(times) - 1
        frames = [np.empty((count, model.n_nodes, 2)) for _ in range(3)] + [np.empty((count, model.m))]
        drives = drive_table(model, times, self.method.h)
        gains = gain_table(model, times, drives, self.method.h)
        first, stage = 0, 0
        while first < count:
            if self.system is None:
                self._predicted_factor(times[first + 1], drives[first + 1])
                stage = 1
            part = [drives[first:], gains[first:], *(frame[first:] for frame in frames)]
            steps, ended, moved = self._compiled(self.method, *part)
            if steps == 0 and stage == 1 and ended in (compiled.REFACTOR, compiled.INVERTED, compiled.NOT_FINITE):
                one = [part[0][:2], *(array[:1] for array in part[1:])]
                steps, ended, moved = self._full_newton(times[first + 1], *one)
            for k in range(first, first + steps):
                whole = k == count - 1 or (k == first + steps - 1 and ended == compiled.TOO_NEAR)
                place = grid.after(done + k + 1) if whole else None
                yield self._state(times[k + 1], *(frame[k] for frame in frames), place)
            first, stage = first + steps, 0 if steps else stage
            if ended in (compiled.TOO_FAR, compiled.TOO_NEAR):
                self.verdict = "far" if ended == compiled.TOO_FAR else "near"
                return
            if ended != compiled.DONE:
                self._refactor_or_fail(ended, stage, times[first + 1], moved)

    def _refactor_or_fail(self, ended, stage, t, moved):
        if stage == 0 and ended not in (compiled.HALF_TURN, compiled.SINGULAR):
            self.system = None
            self.memory.marks[AHEAD] = self.memory.marks[BEHIND] = 0.0
            return
        status, reason = REASONS[ended]
        phi = float(np.abs(self.trial.phi).max(initial=0))
        raise StepFailure(status, reason, t, **{"last |dq|": float(moved), "|phi|": phi})

    def _compiled(self, method, drives, gains, *frames):
        seen = np.zeros(2, np.int64)
        result = compiled.stretch(self.model.arrays, self.system, self.room, method, self.tie, self.damp, drives, gains,
                                  self.memory, self.trial, seen, *frames)
        self.counts.residuals += int(seen[0])
        self.counts.solves += int(seen[1])
        self.counts.newton_iterations += int(seen[1])
        return result

    def _full_newton(self, t, drives, gains, *frames):
        """One step with a matrix made anew in every iteration."""
        y, method = self.memory, self.method._replace(max_iterations=1)
        y.marks[MOVED] = y.marks[AHEAD] = y.marks[BEHIND] = 0.0
        compiled.predict(method, y, self.trial)
        for _ in range(self.settings.max_iterations):
            self._factor(t, drives[1])
            steps, ended, moved = self._compiled(method, drives, gains, *frames)
            if ended != compiled.REFACTOR or steps or not np.isfinite(moved):
                break
            y.marks[MOVED] = moved
        y.marks[MOVED] = 0.0
        return steps, ended, moved

    @property
    def error(self):
        """The largest local error seen since the last change of h or look at it, over what is allowed."""
        return float(self.memory.marks[ERROR])

    def state(self, t):
        """The last accepted state with all that a run goes on from."""
        y = self.memory
        return self._state(t, y.u.copy(), y.v.copy(), y.a.copy(), y.lam.copy(), None, True)

    def _state(self, t, q, v, a, lam, place, whole=False):
        """A State; at the end of a stretch with all that the next one starts from."""
        y, memory = self.memory, {}
        if place is not None or whole:
            made = np.zeros(0) if self.system is None else self.factored_at
            memory = {"a_alg": y.a_alg.ravel().copy(), "h": self.method.h, "change": y.change.ravel().copy(),
                      "earlier": y.earlier.ravel().copy(), "marks": y.marks.copy(), "factored_at": made,
                      "extent": self.method.extent}
            if self.method.incremental:
                memory |= {"phi": y.phi.copy(), "rate": y.rate.copy()}
            if place is not None:
                memory["grid"] = place
        return State(float(t), q.ravel(), v.ravel(), a.ravel(), lam, memory, restart=place is not None)

    def _predicted_factor(self, t, drives):
        compiled.predict(self.method, self.memory, self.trial)
        self._factor(t, drives)

    def _factor(self, t, drives):
        """The factor at the trial state's u, which decides it alone: damping is that at rest, which is symmetric."""
        model, p, w = self.model, self.method, self.trial
        self.factored_at = w.u.ravel().copy()
        kernels.equilibrium(model.arrays, drives, w.u, w.a, w.lam, w.r, w.phi, w.rotation, w.dz, w.forces)
        blocks = symmetric_blocks(model, w.u, p.to_a, p.to_v)
        self.counts.residuals += 1
        self.counts.tangents += 1
        self.counts.factorizations += 1
        try:
            self.system, name = corotated.corotated(model, blocks, w.rotation, self.settings.linear)
        except NotFactorable as error:
            raise StepFailure("singular", str(error), t) from None
        self.counts.backend = name
        self.room = corotated.room(model, self.system)
        self.counts.solves += 2 * model.n_points
        self.memory.marks[RATE], self.memory.marks[AGE] = 1.0, FRESHEN
        if self.settings.adaptive:
            self.kept.keep(p.h, (self.system, self.room, self.factored_at))
