"""Steps of the energy-momentum method without Python: stretches of a compiled loop, factors where it asks for one."""

import numpy as np

from polyida.errors import StepFailure
from polyida.integrate.energy import loop
from polyida.integrate.energy.at_end import AtEnd
from polyida.integrate.energy.dense import EnergyOfOwn
from polyida.integrate.energy.scene import EnergyTable
from polyida.integrate.energy.steps import Steps
from polyida.integrate.kinks import Grid, inner_side
from polyida.integrate.state import State
from polyida.linear.lu import SingularSystem
from polyida.memory import room
from polyida.system.table import DONE, HALF_TURN

CHUNK_BYTES = 4_000_000  # of frames that one compiled stretch fills


class Midpoint(Steps):
    """Steps of a scene whose forces are all compiled, or of a small model of one's own that is."""

    def _room(self):
        model = self.model
        self.pause, self.c = 0, np.array([4.0 / self.h**2, 2.0 / self.h])
        if model.is_scene:
            self.table, self.extent = EnergyTable(model), float(np.ptp(model.reference, axis=0).max())
        else:
            self.table, self.extent = EnergyOfOwn(model), 0.0
        self.now, self.lams = np.zeros((loop.NOW, model.n)), np.zeros((loop.ROWS, model.m))
        turning = model.m and model.needs.phi_q_varies
        self.kind = loop.DRIVEN if model.needs.driven else loop.TURNING if turning else loop.FREE
        self.longest = 1 if model.switching else max(1, min(self.table.longest, CHUNK_BYTES // (48 * model.n)))

    def step_matrix(self, model):
        """The model's own."""
        return model.step_matrix()

    def run(self, state, grid):
        """Yield the states at the ends of the grid's steps. Raises StepFailure."""
        self._begin(state)
        self.pause, done = state.memory.get("pause", self.pause), grid.done
        while done < grid.count:
            left = self.pause - self.counts.steps
            end = min(done + (left if 0 < left < self.longest else self.longest), grid.count)
            for state in self._stretch(np.array([grid.time(k) for k in range(done, end + 1)])):
                done += 1
                yield state

    def step(self, state, t):
        """The accepted state at t."""
        return list(self.run(state, Grid(t - self.h, t, 1)))[-1]

    def _begin(self, state):
        now, (a, lam), v = self.now, self._guess(state), state.memory.get("v_free")
        now[loop.Q0], now[loop.V0], now[loop.GUESS] = state.q, state.v if v is None else v, a
        self.lams[loop.KNOWN] = lam

    def _stretch(self, times):
        """The states at times[1:]."""
        count, first, fresh = len(times) - 1, 0, False
        frames = self._frames(count)
        self.table.prepare(times, self.h)
        while first < count:
            if self.system is None:
                self._factor(times[first + 1])
                fresh = True
            steps, ended, moved = self._steps(first, frames)
            for k in range(first, first + steps):
                yield self._state(times[k + 1], [values[k] for values in frames if len(values) == count], k == count - 1)
            first, fresh = first + steps, fresh and not steps
            if ended == DONE:
                continue
            if not fresh and ended != HALF_TURN:
                self.system = None
                continue
            state = self._halved(self._here(times[first]), times[first + 1], ended, moved)
            self._begin(state)
            first, fresh = first + 1, False
            yield state

    def _frames(self, count):
        n, m = self.model.n, self.model.m
        if not self.table.complete:
            return [*np.empty((2, count, n)), np.empty((1, n)), np.empty((1, m))]
        return self.rows(count) or room([(n,), (n,), (n,), (m,)], [np.dtype(float)] * 4, 8 * count * (3 * n + m))

    def _steps(self, first, frames):
        """(steps, how it ended, last |dq|) of the compiled loop."""
        counts, s = np.zeros(3, np.int64), self.settings
        settings = self.c, self.h, s.tolerance, s.max_iterations, self.extent, self.kind
        left = [values[first:] if len(values) > first else values for values in frames]
        with self.table.at_work(self.system) as (functions, workspace):
            ended = loop.stretch(functions, workspace, first, *settings, self.now, self.lams, counts, *left)
        self.counts.residuals += int(counts[0])
        self.counts.solves += int(counts[1])
        self.counts.newton_iterations += int(counts[1])
        self.table.raise_left()
        if counts[2]:
            self.system.read()
            self.counts.tangents += int(counts[2])
            self.counts.factorizations += int(counts[2])
        return ended

    def _state(self, t, frame, whole):
        """A State; at the end of a stretch with what the next step starts from."""
        memory, (q, v) = self._memory() if whole else {}, frame[:2]
        if self.table.complete:
            return State(float(t), *frame, memory, restart=whole)
        v, free = (None, v) if self.kind == loop.TURNING else (v, None)
        return AtEnd(self.model, float(t), q, v, free, memory, inner_side(self.model, t, self.h), whole)

    def _memory(self):
        now = self.now
        memory = {"a_middle": now[loop.GUESS].copy(), "lam_middle": self.lams[loop.KNOWN].copy(), "h_middle": self.h}
        return memory | ({"v_free": now[loop.V0].copy()} if self.kind == loop.TURNING else {})

    def _here(self, t):
        """What the next step begins from."""
        now = self.now.copy()
        return State(float(t), now[loop.Q0], now[loop.V0], now[loop.GUESS], self.lams[loop.KNOWN].copy(), self._memory())

    def _factor(self, t):
        """A new factor for the step that ends at t."""
        h, now, counts = self.h, self.now, self.counts
        q = now[loop.Q0] + 0.5 * h * now[loop.V0] + 0.25 * h * h * now[loop.GUESS]
        self.system, lam = self.table.system(self), self.lams[loop.KNOWN].copy()
        counts.tangents += 1
        counts.factorizations += 1
        counts.residuals += 1
        try:
            self.system.factor(t - 0.5 * h, q, now[loop.V0].copy(), now[loop.GUESS].copy(), lam, *self.c)
        except SingularSystem as error:
            raise StepFailure("singular", str(error), t) from None
        counts.backend = self.system.backend
        counts.solves += self.system.solves

    @property
    def phi(self):
        """phi where the last step ended."""
        return self.lams[loop.PHI]
