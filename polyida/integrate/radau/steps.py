"""Steps of Radau IIA on one model: factors by step size, a step tried, its end made a state on the constraints."""

import math
from functools import cached_property, partial

import numpy as np

from polyida.errors import InputError
from polyida.integrate.radau.dense import Collocation
from polyida.integrate.radau.matrices import Matrices
from polyida.integrate.radau.newton import UNKNOWN, Failed, Newton
from polyida.integrate.radau.plain import PlainSystem
from polyida.integrate.radau.tableau import radau
from polyida.integrate.radau.whole import WholeModes
from polyida.integrate.sizes import ROUND_OFF, weights
from polyida.integrate.start import consistent_acceleration, start_values
from polyida.integrate.state import State, StepFailure
from polyida.integrate.stepping.kept import Kept
from polyida.linear.lu import SingularSystem

PAIR = 20.0  # iterations that cost as much as new factors: so many beyond the least a step, and they are made anew
NEVER = 1e9  # iterations, the least a step of factors that solved none: files take finite numbers only


class Steps:
    """`begin` takes a state up, `step` tries one from it; `limits`: the model's times are held to them, beside a kink.

    sizes: the model's (length, speed), of which tolerances are a share.
    """

    def __init__(self, settings, model, counts, sizes):
        self.settings, self.model, self.counts, self.sizes = settings, model, counts, sizes
        self.tableau, self.limits = radau(settings.stages), (-np.inf, np.inf)
        tied = settings.form == "ggl"
        self.system = _system(settings, model)(model, self.tableau, tied, tied or settings.project, counts)
        self.newton = Newton(self.system, self.tableau, settings.max_iterations)
        self.looks = settings.adaptive or settings.tolerance is None
        self.kept, self.shares, self.stacked = Kept(), None, None

    def begin(self, state):
        """Take up what a state of this method holds, and nothing else: the norm's weights, Newton's contraction, the factors."""
        self.kept, self.stacked, self.newton.marks = Kept(), None, UNKNOWN.copy()
        memory, model = state.memory, self.model
        given = memory.get("radau_shares")
        self.shares = weights(model, state.q) if given is None else np.array(given, float)
        self.system.weigh(self.shares)
        if "newton" not in memory:
            return
        self.newton.marks, self.stacked = np.array(memory["newton"], float), np.array(memory["factored"], float)
        for row in self.stacked:
            self.kept.keep(float(row[0]), self.system.matrices(float(row[0]), row[1:]))
        for h, price, least in np.reshape(memory["prices"], (-1, 3)):
            self.kept.factors[float(h)].price, self.kept.factors[float(h)].least = float(price), float(least)

    def clamp(self, t):
        """t held to `limits`."""
        return float(min(max(t, self.limits[0]), self.limits[1]))

    def expect(self, grid):
        """Be told that the rest of a grid's steps comes next."""
        self.system.expect(grid, lambda times: np.clip(times, *self.limits))

    def step(self, state, h, t, allowed=np.inf):
        """(the State at t = state.t + h, or None where the local error is not `allowed`; local error). Raises StepFailure."""
        closed = start_values(self.model, state, self.clamp(state.t)) if self.model.carries else None
        self.system.begin(state, h, [self.clamp(state.t + c * h) for c in self.tableau.c], closed)
        try:
            matrices = self._solved(state, h)
            closed = self.system.close()
            error = self.system.error(matrices, _last_a(state)) if self.looks else 0.0
        except Failed as failed:
            raise StepFailure(failed.status, failed.reason, t, **failed.seen) from None
        return self._state(state, h, t, closed, error) if error <= allowed else None, error

    def _solved(self, state, h):
        """The Matrices that the stages were solved with: those kept for this h, unless their price has grown beyond that of new ones."""
        matrices = self.kept.take(h)
        if matrices is not None and matrices.price <= PAIR:
            try:
                self._charge(matrices, self._iterate(matrices, state, h))
                return matrices
            except Failed as failed:
                if failed.status == "not finite":
                    raise
        matrices = self._factored(state, h)
        self._charge(matrices, self._iterate(matrices, state, h))
        return matrices

    @staticmethod
    def _charge(matrices, iterations):
        """Note what a step with the matrices took."""
        matrices.least = min(matrices.least, iterations)
        matrices.price += max(0, iterations - matrices.least)

    def _iterate(self, matrices, state, h):
        try:
            matrices.make()
        except SingularSystem as error:
            raise Failed("singular", str(error)) from None
        self.counts.backend = matrices.backend
        left = self.settings.left(state, self.shares, self.sizes)
        return self.newton.solve(matrices, state, h, left, self.shares, ROUND_OFF * float(self.sizes[0]))

    def _factored(self, state, h):
        """New Matrices at a state, with what its last stage was rather than a and lam that ring."""
        lam = state.memory["stages_lam"][-1] if "stages_lam" in state.memory else state.lam
        made = self.system.matrices(h, np.concatenate([[self.clamp(state.t)], state.q, state.v, _last_a(state), lam]))
        self.counts.tangents += 1
        self.counts.factorizations += len(made.modes) if self.settings.linear != "kkt" else 0  # whole ones are with their rows
        self.kept.keep(h, made)
        self.stacked, self.newton.marks = None, UNKNOWN.copy()
        return made

    def _state(self, state, h, t, closed, error):
        """The accepted State: q and v on their constraints to round-off."""
        at, model, (e, dv, a, lam, _) = self.clamp(t), self.model, map(np.copy, self.system.trial)
        q, v = state.q + (h * state.v + e[-1]), state.v + dv[-1]
        if not math.isfinite(q.dot(v)):
            raise StepFailure("not finite", "the motion is not finite", t)
        memory = {"stages_e": e, "stages_v": dv, "a_end": a[-1], "stages_lam": lam, "step": h, "error": error}
        if closed is not None:
            memory |= dict(zip(("phi", "rate"), closed))
        within = Collocation(state.t, h, state.q, state.v, self.tableau.c, (e, dv, a, lam))
        accepted = Accepted(model, at, State(t, q, v, a[-1], lam[-1], memory | self._memory(), within=within))
        if self.system.asks:
            _require_good(model, at, accepted)
        return accepted

    def _memory(self):
        kept = self.kept.factors
        if self.stacked is None or [row[0] for row in self.stacked] != list(kept):
            self.stacked = np.array([np.concatenate([[h], matrices.made_at]) for h, matrices in kept.items()])
        prices = np.array([(h, matrices.price, min(matrices.least, NEVER)) for h, matrices in kept.items()])
        memory = {"newton": self.newton.marks, "factored": self.stacked, "prices": prices}
        return memory | {"radau_shares": self.shares} if self.model.needs.mass_varies else memory


def _require_good(model, at, state):
    """Raise StepFailure where a or lam is not finite, or the model objects: a shorter step may be taken then."""
    if not (np.isfinite(state.a).all() and np.isfinite(state.lam).all()):
        raise StepFailure("not finite", "the motion is not finite", state.t)
    if objection := model.objection(at, state.q):
        raise StepFailure("objection", objection, state.t)


class Accepted(State):
    """A State whose a and lam, `[[M, B^T], [B, 0]] (a, lam) = (-g, -phi_bias)` at its q and v, are made when they are first asked for.

    They have the order of q and v; those of the last stage, which it is given and which stand where that is singular, have one of s only.
    """

    def __init__(self, model, at, stage):
        hidden = {"_model": model, "_at": at, "_stage": stage}
        vars(self).update({name: value for name, value in vars(stage).items() if name not in ("a", "lam")} | hidden)

    @cached_property
    def _rest(self):
        try:
            return consistent_acceleration(self._model, self._at, self.q, self.v)
        except (InputError, np.linalg.LinAlgError):  # constraints that have become dependent, where the run is about to end
            return self._stage.a, self._stage.lam

    @property
    def a(self):
        """q'', (n,)."""
        return self._rest[0]

    @property
    def lam(self):
        """The multipliers, (m,)."""
        return self._rest[1]

    def finite(self):
        """Whether q and v, and what the last stage had, are finite."""
        return self._stage.finite()

    def __reduce__(self):
        return State, (self.t, self.q, self.v, self.a, self.lam, self.memory, self.restart, self.within)


def _last_a(state):
    """v' of the last stage, or the state's own, which may not be made yet."""
    found = state.memory.get("a_end")
    return state.a if found is None else found


def _system(settings, model):
    """The system of a scene, or of any model, by the settings' linear algebra."""
    if settings.linear == "kkt":
        return partial(PlainSystem, kind=partial(WholeModes, scaling=settings.scaling))
    if model.compiled:
        from polyida.integrate.radau.scene.system import SceneSystem

        return partial(SceneSystem, linear=settings.linear)
    return partial(PlainSystem, kind=partial(Matrices, linear=settings.linear))
