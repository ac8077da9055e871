"""The collocation equations of a scene, in compiled code (`stages.py`, `corrections.py`): what `plain.py` does for any model."""

import math
from weakref import WeakKeyDictionary

import numpy as np

from polyida.assembly.bodies.damping import symmetric_parts
from polyida.assembly.rows.tie import tie
from polyida.assembly.stabilised_border import massive, stabilised_room
from polyida.integrate.radau.newton import Failed, trial
from polyida.integrate.radau.scene.corrections import Solver, error, iterate
from polyida.integrate.radau.scene.loads import Loads
from polyida.integrate.radau.scene.stages import SHARES, A, begin, close, room, way
from polyida.integrate.sizes import ROUND_OFF, extent
from polyida.integrate.stepping.ended import DONE, HALF_TURN, INVERTED, REASONS, SINGULAR

KERNELS: WeakKeyDictionary = (
    WeakKeyDictionary()
)  # {model: {settings that types follow from: {kernel: the same for arguments of known types}}}


class SceneSystem:
    """Of a scene, for the stages of a tableau; the same protocol as PlainSystem's."""

    asks = False  # its residuals have looked

    def __init__(self, model, tableau, tied, moves_v, counts, linear):
        needs, self.model, self.tableau, self.counts, self.linear = model.needs, model, tableau, counts, linear
        self.tied = tied and model.m > 0 and (needs.phi_q_varies or needs.driven)
        self.way, self.room, self.loads = way(tableau), room(model, tableau.stages), Loads(model, tableau.c)
        self.expect = self.loads.expect
        self.trial = trial(tableau.stages, model.n, model.m, self.tied)
        self.damp = np.zeros((model.n_nodes, 2)) if model.damped else None
        self.moves_v, self.tie = moves_v, tie(model) if model.m else None
        alike = KERNELS.setdefault(model, {})  # a run that ends steps at switches makes many systems
        key = tableau.stages, self.tied, linear, moves_v
        self.kernels = alike.setdefault(key, {kernel: kernel.typed() for kernel in (begin, iterate, close, error)})

    def _call(self, kernel, *args):
        """kernel(scene's arrays, *args), whose types are the same in every call."""
        return self.kernels[kernel](self.model.arrays, *args)

    def weigh(self, shares):
        """Take the coordinates' shares in the mass."""
        self.room.past[SHARES] = shares

    def matrices(self, h, made_at):
        """Those of steps of h at made_at, not made yet."""
        return SceneMatrices(self.model, self.tableau.modes, h, made_at, self.tied, self.linear)

    def begin(self, state, h, times, closed):
        """Go on from a state: h, the times of the stages, and (phi, rate) there as they are carried."""
        self.state, self.h, self.times, self.enough = state, h, times, ROUND_OFF * extent(self.model, state.q)
        self._call(begin, np.ascontiguousarray(state.q), np.ascontiguousarray(state.v), *closed, self.room)
        self.drives, self.gains = self.loads.of(state.t, h, times)

    def take(self, matrices):
        """Nothing: the rows of the constraints are made in each iteration."""

    def iterate(self, matrices):
        """One iteration; returns |dq|, |dv| h with it, root mean square by mass. Raises Failed."""
        counts = self.counts
        counts.residuals += self.tableau.stages
        counts.newton_iterations += 1
        counts.solves += len(matrices.modes)
        given = *matrices.compiled, self.damp, self.model.laws, self.drives, self.gains, self.trial, self.room
        ended, moved = self._call(iterate, self.way, self.h, *given)
        if ended != DONE:
            status, reason = REASONS[ended]
            raise Failed(status, (self._objection() if ended in (INVERTED, HALF_TURN) else None) or reason)
        return moved

    def _objection(self):
        """What the model objects to at the first stage that it objects to, with the names of what is there."""
        state, steps = self.state, self.tableau.c * self.h
        stages = ((t, state.q + (step * state.v + e)) for t, step, e in zip(self.times, steps, self.trial.e))
        return next(filter(None, (self.model.objection(t, q) for t, q in stages)), None)

    def close(self):
        """Bring v and v' up to the last correction, and the step's end onto its constraints: (phi, rate) there as they are carried."""
        given = self.drives, self.gains, self.enough, self.moves_v, self.tie, self.trial, self.room
        if not self._call(close, self.way, self.h, *given):
            raise Failed(*REASONS[SINGULAR])
        return self.room.rows[0, -1].copy(), self.room.rows[1, -1].copy()

    def error(self, matrices, a):
        """|q_ - q| of the step's end against a method of order s; a (n,): v' at the last step's end."""
        self.counts.solves += 1
        self.room.past[A] = a
        good, found = self._call(error, self.way, self.h, *matrices.compiled, self.damp, self.drives, self.trial, self.room)
        if not good:
            raise Failed(*REASONS[SINGULAR])
        return found


class SceneMatrices:
    """The co-rotated factors of both modes for steps of h, made when first used from `made_at`; compiled: what kernels take of them.

    price: iterations that they cost beyond their best ones, `least` a step.
    """

    def __init__(self, model, modes, h, made_at, tied, linear):
        self.linear = linear
        self.model, self.modes, self.made_at, self.price, self.least, self.tied = model, modes, made_at, 0.0, math.inf, tied
        self.c, self.compiled, self.backend = [mode.value / h for mode in modes], None, ""

    def make(self):
        """Factor, where it is not done. Raises SingularSystem."""
        if self.compiled is not None:
            return
        at = (float(self.made_at[0]), *np.split(self.made_at[1:], np.cumsum([self.model.n] * 3)))
        parts, found = symmetric_parts(self.model, at[1].reshape(-1, 2)), {}
        for mode, c in zip(self.modes, self.c):
            step = self.model.step_matrix(self.linear)
            step.factor(*at, c * c, c, parts)
            found[mode.paired], self.backend = Solver(np.array([c]), step.corotated, step.room, *self._border(step, c, at)), step.backend
        self.compiled = found.get(False), found[True]

    def _border(self, step, c, at):
        if not self.tied:
            return None, None
        t, q, v = at[:3]
        damping = self.model.force_v(t, q, np.zeros_like(v)) / c if self.model.damped else None
        return massive(self.model, step.corotated, damping), stabilised_room(self.model, type(c))
