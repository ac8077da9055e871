"""Steps of Radau IIA on one model: factors by step size, a step tried, its end made a state on the constraints."""

import numpy as np

from polyida.errors import InputError
from polyida.integrate.alpha.start import EPS, extent
from polyida.integrate.alpha.step_control import Kept, weights
from polyida.integrate.radau.control import local_error
from polyida.integrate.radau.dense import Collocation
from polyida.integrate.radau.matrices import Matrices
from polyida.integrate.radau.newton import Failed, Newton
from polyida.integrate.radau.tableau import radau
from polyida.integrate.state import State, StepFailure
from polyida.linear.lu import SingularSystem

FEW = 2  # iterations of a step that nothing could spare
PAIR = 24.0  # iterations that cost as much as new factors: so many beyond FEW a step, and they are made anew
CLOSED = 64 * EPS  # of the model's size: |phi| that is round-off
MOVES = 3  # of q onto phi = 0, at most
AGAIN = 1e-9  # of that size: |phi| beyond which the constraints' system is made anew where q has moved to


class Steps:
    """`begin` takes a state up, `step` tries one from it; `limits`: the model's times are held to them, beside a kink.

    sizes: the model's (length, speed), of which tolerances are a share.
    """

    def __init__(self, settings, model, counts, sizes):
        self.settings, self.model, self.counts, self.sizes = settings, model, counts, sizes
        self.tableau = radau(settings.stages)
        tied, self.limits = settings.form == "ggl", (-np.inf, np.inf)
        self.moves_v = tied or settings.project
        self.newton = Newton(model, self.tableau, tied, settings.max_iterations, counts)
        self.kept, self.shares, self.stacked = Kept(), None, None

    def begin(self, state):
        """Take up what a state of this method holds: the norm's weights, Newton's contraction, the factors."""
        memory, model = state.memory, self.model
        given = memory.get("radau_shares")
        self.shares = weights(model, state.q) if given is None else np.array(given, float)
        self.newton.weigh(self.shares)
        if "newton" not in memory:
            return
        self.newton.marks, self.stacked = np.array(memory["newton"], float), np.array(memory["factored"], float)
        for row in self.stacked:
            self.kept.keep(float(row[0]), Matrices(model, self.tableau.modes, float(row[0]), row[1:]))
        for h, price in np.reshape(memory["prices"], (-1, 2)):
            self.kept.factors[float(h)].price = float(price)

    def clamp(self, t):
        """t held to `limits`."""
        return float(min(max(t, self.limits[0]), self.limits[1]))

    def step(self, state, h, t, allowed=np.inf):
        """(the State at t = state.t + h, or None where the local error is not `allowed`; local error). Raises StepFailure."""
        try:
            matrices, stages = self._solved(state, h)
        except Failed as failed:
            raise StepFailure(failed.status, failed.reason, t, **failed.seen) from None
        self.counts.solves += 1
        error = local_error(matrices, self.tableau, state, stages, h, self.shares)
        return self._state(state, stages, h, t) if error <= allowed else None, error

    def _solved(self, state, h):
        """(Matrices, Stages): with those kept for this h, unless their price has grown beyond that of new ones, or they do not serve."""
        matrices = self.kept.take(h)
        if matrices is not None and matrices.price <= PAIR:
            try:
                stages = self._stages(matrices, state, h)
                matrices.price += max(0, stages.iterations - FEW)
                return matrices, stages
            except Failed as failed:
                if failed.status == "not finite":
                    raise
        matrices = self._factored(state, h)
        return matrices, self._stages(matrices, state, h)

    def _stages(self, matrices, state, h):
        try:
            matrices.make()
        except SingularSystem as error:
            raise Failed("singular", str(error)) from None
        left = self.settings.left(state.q, self.shares, self.sizes)
        return self.newton.solve(matrices, state, h, self.clamp, left, self.shares)

    def _factored(self, state, h):
        """New Matrices at a state, with what its last stage was rather than a and lam that ring."""
        a, lam = state.memory.get("a_end", state.a), state.memory.get("lam_end", state.lam)
        made = Matrices(self.model, self.tableau.modes, h, np.concatenate([[self.clamp(state.t)], state.q, state.v, a, lam]))
        self.counts.tangents += 1
        self.counts.factorizations += len(made.modes)
        self.kept.keep(h, made)
        self.stacked, self.newton.marks = None, np.array([1.0, np.inf])
        return made

    def _state(self, state, stages, h, t):
        """The accepted State: q and v on their constraints to round-off, a and lam of the equations of motion there."""
        at, model = self.clamp(t), self.model
        q, v, a, lam = self._settled(at, state.q + stages.q[-1], state.v + stages.v[-1])
        if not all(np.isfinite(x).all() for x in (q, v, a, lam)):
            raise StepFailure("not finite", "the motion is not finite", t)
        if objection := model.objection(at, q):
            raise StepFailure("objection", objection, t)
        stages.q[-1], stages.v[-1] = q - state.q, v - state.v
        memory = {"stages_q": stages.q, "stages_v": stages.v, "a_end": stages.a[-1], "lam_end": stages.lam[-1], "step": h}
        within = Collocation(state.t, h, state.q, state.v, self.tableau.c, (stages.q, stages.v, stages.a, stages.lam))
        return State(t, q, v, a, lam, memory | self._memory(), within=within)

    def _memory(self):
        kept = self.kept.factors
        if self.stacked is None or [row[0] for row in self.stacked] != list(kept):
            self.stacked = np.array([np.concatenate([[h], matrices.made_at]) for h, matrices in kept.items()])
        prices = np.array([(h, matrices.price) for h, matrices in kept.items()])
        memory = {"newton": self.newton.marks, "factored": self.stacked, "prices": prices}
        return memory | {"radau_shares": self.shares} if self.model.needs.mass_varies else memory

    def _settled(self, t, q, v):
        """(q, v, a, lam) from q and v that are off their constraints by what Newton left, and v by the error of index 3."""
        model, none = self.model, np.zeros(self.model.n)
        try:
            q, system = self._closed(t, q, none) if model.m else (q, self._mass_system(t, q))
            if model.m and self.moves_v:
                v = v + system.solve(none, model.phi_rate(t, q, v))[0]
            return q, v, *system.solve(model.force(t, q, v), model.phi_bias(t, q, v) if model.m else np.zeros(0))
        except np.linalg.LinAlgError as error:
            raise StepFailure("singular", str(error), t) from None

    def _closed(self, t, q, none):
        """q moved along M^-1 B^T onto phi = 0, and the system of M and B there."""
        system, size = self._mass_system(t, q), extent(self.model, q)
        for _ in range(MOVES):
            phi = self.model.phi(t, q)
            if np.abs(phi).max() <= CLOSED * size:
                break
            q = q + system.solve(none, phi)[0]
            system = self._mass_system(t, q) if np.abs(phi).max() > AGAIN * size else system
        return q, system

    def _mass_system(self, t, q):
        try:
            return self.model.mass_system(t, q)
        except InputError as error:
            raise StepFailure("singular", str(error), t) from None
