"""Steps of generalized-alpha on any model: Newton on dq with the whole saddle-point matrix, kept while it contracts."""

import numpy as np

from polyida.integrate.alpha.arrays import PATIENCE
from polyida.integrate.alpha.increment import Carried, extent, inner_side, start_values
from polyida.integrate.alpha.step_control import Kept, calm_error, weights
from polyida.integrate.state import State, StepFailure
from polyida.linear.kkt import KKT, SingularSystem, scaling_factors

SLOW = 0.3  # contraction above which the matrix is made anew
CAUTION = 0.5  # of the local error's share: a matrix that does not turn with the plates contracts ever slower in a step
EPS = np.finfo(float).eps
STALE, FRESH, FULL = range(3)


class Steps:
    """Steps on one model: `begin` sets state and h, `run` goes on from there.

    verdict: "far" or "near" where adaptive steps should be shorter or longer.
    """

    efforts = STALE, FRESH, FULL  # one after the other, where Newton fails

    def __init__(self, settings, model, counts):
        self.settings, self.model, self.counts, self.c = settings, model, counts, settings.coefficients
        self.kept, self.verdict, self.kkt = Kept(), None, None
        self.carries = settings.incremental_phi and model.compiled

    def begin(self, state, h):
        """Go on from a state that `started` has made ready for steps of h."""
        c = self.c
        self.h, self.last, self.place = h, state, None
        self.weights = weights(self.model, state.q)
        self.to_a = (1 - c.alpha_m) / (c.beta * h * h * (1 - c.alpha_f))
        self.to_v = c.gamma / (c.beta * h)
        self.extent, (self.phi, self.rate) = extent(self.model, state.q), start_values(self.model, state)
        self.least, self.most, self.share = self.settings.newton_tolerance(self.to_a * h * h)
        self.size, self.change, self.error, self.since, self.verdict = 0.0, 0.0, 0.0, 0, None
        self.kkt, self.factored_at = self.kept.take(h) or (None, None)

    def recall(self, memory):
        """Take up Newton's memory at a restart, with the factor that it had, so that the run is the same bit by bit."""
        self.size, self.change = float(memory["size"]), float(memory["change"])
        self.weights, self.extent = np.array(memory["weights"], float), float(memory["extent"])
        if len(memory["factored_at"]):
            n = self.model.n
            t, q, v, a, lam = np.split(memory["factored_at"], [1, 1 + n, 1 + 2 * n, 1 + 3 * n])
            self._factor(float(t[0]), q, v, a, lam)

    def run(self, grid):
        """Yield the states at the ends of the grid's steps, until the verdict says otherwise. Raises StepFailure."""
        self.verdict = None
        for k in range(grid.done + 1, grid.count + 1):
            t, self.place = grid.time(k), grid.after(k)
            state = self._step(grid.time(k - 1), t)
            if self.settings.adaptive and self._error(state) > 1:
                self.verdict = "far"
                return
            self.last = state
            if self.carries:
                self.phi, self.rate = state.memory["phi"], state.memory["rate"]
            if self.settings.adaptive and self._calm():
                self.verdict = "near"
            yield state
            if self.verdict:
                return

    def state(self, t):
        """The last accepted state."""
        return self.last

    def _error(self, state):
        """Local error of q over what is allowed."""
        s, size = self.settings, self._size
        error = abs(self.c.error) * self.h**2 * size(state.a - self.last.a) / max(s.atol + s.rtol * size(state.q), 1e-300)
        self.error = max(self.error, error) if np.isfinite(error) else np.inf
        return error if np.isfinite(error) else np.inf

    def _size(self, x):
        """Root mean square of coordinates, weighted with their masses."""
        return float(np.sqrt(self.weights @ (x * x)))

    def _calm(self):
        self.since += 1
        if self.since < PATIENCE:
            return False
        calm, self.since = self.error < calm_error(self.h, self.settings.h), 0
        self.error = self.error if calm else 0.0
        return calm

    def _step(self, before, t):
        """The state at t: with the matrix at hand, a fresh one, or one in every iteration. Raises StepFailure."""
        for effort in self.efforts:
            if effort != STALE:
                self.kkt = None
            try:
                return self._solve(before, t, effort)
            except Divergence as divergence:
                failed = divergence
        raise StepFailure("newton", str(failed), t, **failed.seen)

    def _predict(self):
        c, h, state = self.c, self.h, self.last
        a0, a1 = state.memory["a_alg"], self._algorithmic(state.a)
        dd = h * h * ((0.5 - c.beta) * a0 + c.beta * a1)
        return dd, state.v + h * ((1 - c.gamma) * a0 + c.gamma * a1), state.a.copy(), state.lam.copy()

    def _solve(self, before, t, effort):
        dd, v, a, lam = self._predict()
        model, last, inner = self.model, 0.0, inner_side(self.model, t, self.h)
        phi_at = self._constraints(before, t)
        self.size, self.change, self.mass = max(0.9 * self.size, self._size(a)), 0.9 * self.change, None
        for iteration in range(self.settings.max_iterations):
            q = self._at(dd)
            r, phi = model.residual(inner, q, v, a, lam), phi_at(dd, a)[0]
            self.counts.residuals += 1
            if not (np.isfinite(r).all() and np.isfinite(phi).all()):
                raise Divergence("r or phi is not finite", iteration, last, phi)
            if self.kkt is None or effort == FULL:
                self._factor(inner, q, v, a, lam)
            x, dlam, slip = self._correction(inner, q, v, r, phi)
            dd, v, a, lam = dd + x + slip, v + self.to_v * x, a + self.to_a * x, lam + dlam
            moved = self._size(x)
            rate = moved / last if last > 0 else 1.0
            if self._settled(moved, rate, dd, q, a, iteration, phi_at):
                return self._accepted(t, dd, v, a, lam, phi_at)
            if iteration and rate > SLOW and effort != FULL:
                raise Divergence("Newton does not contract", iteration, moved, phi)
            last = moved
        raise Divergence("Newton does not converge with fresh matrices", iteration + 1, moved, phi)

    def _at(self, dd):
        return self.last.q + (self.h * self.last.v + dd)

    def _algorithmic(self, a):
        c, last = self.c, self.last
        return ((1 - c.alpha_f) * a + c.alpha_f * last.a - c.alpha_m * last.memory["a_alg"]) / (1 - c.alpha_m)

    def _constraints(self, before, t):
        """(phi, rate) at t as a function of the step's dd and a: carried, or phi from the positions."""
        if not self.carries:
            return lambda dd, a: (self.model.phi(t, self._at(dd)), self.rate)
        carried = Carried(self.model, before, t, self.h, self.last, self.phi, self.rate)
        gamma, a0 = self.c.gamma, self.last.memory["a_alg"]
        return lambda dd, a: carried(dd, self.h * ((1 - gamma) * a0 + gamma * self._algorithmic(a)))

    def _correction(self, t, q, v, r, phi):
        """(x, dlam, slip) of one iteration; see the stabilised form for the slip of q against v."""
        self.counts.solves += 1
        self.counts.newton_iterations += 1
        if self.settings.form == "index3" or not self.model.m:
            return *self.kkt.solve(r, phi), 0.0
        rate = (self.model.phi_q(t, q) @ v + self.model.phi_t(t, q)) / self.to_v
        if self.mass is None:
            self.mass = self.model.mass_system(t, q)
        return *self.kkt.solve(r, rate), self.mass.solve(np.zeros(self.model.n), phi - rate)[0]

    def _settled(self, moved, rate, dd, q, a, iteration, phi_at):
        """Whether the error to be expected, and phi, are below the tolerance, or dq is round-off and no longer
        falls.
        """
        size, change = max(self.size, self._size(a)), max(self.change, self._size(a - self.last.a))
        tolerance = min(max(self.least * size, CAUTION * self.share * change), self.most * size) / self.to_a
        coarse = 16 * EPS * (self._size(q) + self.extent)
        fine = 16 * EPS * self._size(dd) if self.carries else 0.25 * EPS * self._size(q)
        stalled = iteration and rate > SLOW and moved <= coarse
        small = moved <= 1e-3 * tolerance or (iteration and rate < 1 and moved * rate / (1 - rate) <= tolerance)
        if not (small or stalled or moved <= fine):
            return False
        floor = 16 * fine if self.carries and not stalled else coarse
        return np.abs(phi_at(dd, a)[0]).max(initial=0) <= max(1e-2 * tolerance, floor)

    def _accepted(self, t, dd, v, a, lam, phi_at):
        q, model = self._at(dd), self.model
        if objection := model.objection(t, q):
            raise StepFailure("objection", objection, t)
        if self.settings.form == "stabilised" and model.m:
            off = model.phi_q(t, q) @ v + model.phi_t(inner_side(model, t, self.h), q)
            v = v + model.mass_system(t, q).solve(np.zeros(model.n), off)[0]
        self.size, self.change = max(self.size, self._size(a)), max(self.change, self._size(a - self.last.a))
        made = np.zeros(0) if self.kkt is None else self.factored_at
        memory = {"a_alg": self._algorithmic(a), "h": self.h, "size": self.size, "change": self.change}
        memory |= {"weights": self.weights, "extent": self.extent, "factored_at": made, "grid": self.place}
        if self.carries:
            phi, rate = phi_at(dd, a)
            memory |= {"phi": phi, "rate": np.zeros(model.m) if self.settings.form == "stabilised" else rate}
        return State(float(t), q, v, a, lam, memory)

    def _factor(self, t, q, v, a, lam):
        matrix = self.model.tangent(t, q, v, a, lam, self.to_a, self.to_v, 1.0)
        self.factored_at = np.concatenate([[t], q, v, a, lam])
        scaling = scaling_factors(self.settings.scaling, self.c.beta * self.h**2, matrix)
        self.counts.tangents += 1
        self.counts.factorizations += 1
        try:
            self.kkt = KKT(matrix, self.model.phi_q(t, q), scaling)
        except SingularSystem as error:
            raise StepFailure("singular", str(error), t) from None
        if self.settings.adaptive:
            self.kept.keep(self.h, (self.kkt, self.factored_at))


class Divergence(Exception):
    """Newton's iteration did not settle."""

    def __init__(self, reason, iterations, moved, phi):
        super().__init__(reason)
        self.seen = {"iterations": iterations, "last |dq|": float(moved), "|phi|": float(np.abs(phi).max(initial=0.0))}
