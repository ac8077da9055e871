"""Steps with the forces at the middle, whatever solves them: what one begins from, what becomes of its end, and halves where it fails.

`phi = 0` at both ends leaves `v_1 = 2 (q_1 - q_0)/h - v_0` off `phi_q v + phi_t = 0` by as much as v_0 was, the other way round: what a
motor's jerk once put there would alternate for ever, and show in lam divided by h. So where phi is driven v_1 is moved onto it, along
M^-1 phi_q^T, where lam takes up what a step misses; of a motor's energy 4e-13 a step were measured so at 20 rad/s and 4 ms.
Where nothing drives there is an energy to keep, and v_1 off its constraint by O(h^2) has it. So the next step begins from that v_1
(memory "v_free"), which keeps energy and momenta, and the frame has v_1 put on the constraint and made as fast as it was.
"""

import numpy as np

from polyida.errors import StepFailure
from polyida.integrate.energy.at_end import AtEnd
from polyida.integrate.start import on_velocity
from polyida.system.table import DONE, HALF_TURN, REASONS

# constants of compiled code, some of them
FAR_SHORTER = 10.0  # a step as many times shorter than the next tells nothing of its accelerations
SLOW = 0.3  # contraction above which the matrix is made anew
HALVINGS = 6  # of a step that fails


class Steps:
    """Steps at one h; holds the matrix between them. until: the time that motors and loads are held to, before a kink.

    A kind of them says what `_room()` they need and how to `_solve(t)`: (how it ended, last |dq|), the step being left in
    u0, v0, u1, lam and phi of the room, and `fresh`, whether the matrix was made in it; or how to `run` otherwise. rows: a function of a count that
    gives the places of so many frames, [q, v, a (count, n), lam (count, m)], or None; of use where a loop makes frames.
    """

    rows = staticmethod(lambda count: None)

    def __init__(self, settings, model, h, counts, until=np.inf, halvings=HALVINGS):
        self.until, self.halvings = until, halvings
        self.settings, self.model, self.h, self.counts = settings, model, h, counts
        self.room, self.system = self._room(), None

    def run(self, state, grid):
        """Yield the states at the ends of the grid's steps. Raises StepFailure."""
        for k in range(grid.done + 1, grid.count + 1):
            state = self.step(state, grid.time(k))
            yield state

    @property
    def phi(self):
        """phi where the last step ended."""
        return self.room.phi

    def step(self, state, t):
        """The accepted state at t. Raises StepFailure where Newton does not converge with a fresh matrix."""
        self._begin(state)
        ended, moved = self._solve(t)
        if ended not in (DONE, HALF_TURN) and not self.fresh:
            self.system = None
            self._begin(state)
            ended, moved = self._solve(t)
        w = self.room
        if ended != DONE:
            return self._halved(state, t, ended, moved)
        at, q, v = min(t, self.until), w.u1.ravel().copy(), (2.0 * (w.u1 - w.u0) / self.h - w.v0).ravel()
        memory = {"a_middle": (v - w.v0.ravel()) / self.h, "lam_middle": w.lam.copy(), "h_middle": self.h}
        if self.model.needs.driven:
            v = on_velocity(self.model, at, q, v)
        elif self.model.needs.phi_q_varies:  # else it is there: phi is linear, and its mean rate over the step is zero
            memory["v_free"] = v
            return AtEnd(self.model, float(t), q, None, v, memory, at)
        return AtEnd(self.model, float(t), q, v, None, memory, at)

    def _begin(self, state):
        """Put the state's q and v, and where they lead, into the room."""
        w, h = self.room, self.h
        a, lam = self._guess(state)
        v = state.memory.get("v_free")
        for target, values in ((w.u0, state.q), (w.v0, state.v if v is None else v)):
            target[:] = values.reshape(target.shape)
        w.u1[:] = w.u0 + h * w.v0 + 0.5 * h * h * a.reshape(w.u0.shape)
        w.lam[:] = lam

    def _guess(self, state):
        """Acceleration and multipliers to begin with: those of the last step; behind a far shorter one, which may have been a blow, none."""
        memory = state.memory
        if "a_middle" not in memory:
            return state.a, state.lam
        if self.h > FAR_SHORTER * memory["h_middle"]:
            return np.zeros_like(state.q), np.zeros(self.model.m)
        return memory["a_middle"], memory["lam_middle"]

    def _halved(self, state, t, ended, moved):
        """The state at t by two steps of half the size, each keeping energy by itself."""
        if not self.halvings:
            status, reason = REASONS[ended]
            seen = {"last |dq|": float(moved), "|phi|": float(np.abs(self.phi).max(initial=0.0)), "step": self.h}
            raise StepFailure(status, f"{reason}; the step in 2 to 64 parts fails too", t, **seen)
        self.system = None
        self.counts.rejected += 1
        half = type(self)(self.settings, self.model, self.h / 2, self.counts, self.until, self.halvings - 1)
        return half.step(half.step(state, t - self.h / 2), t)
