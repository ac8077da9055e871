"""Steps of generalized-alpha on any model: Newton on dq with the whole saddle-point matrix, kept while it contracts."""

import numpy as np

from polyida.integrate.grid import goes_on, grid_of
from polyida.integrate.start import jerk, mass_system
from polyida.integrate.state import State, StepFailure
from polyida.linear.kkt import KKT, SingularSystem, scaling_factors

SLOW = 0.3  # contraction above which the matrix is made anew
EPS = np.finfo(float).eps


def advance(settings, model, state, begin, end, count, counts):
    """Yield `count` equal steps from begin to end."""
    grid = grid_of(state, begin, end, count)
    state = started(settings, model, state, grid.h)
    newton = Newton(settings, model, grid, counts)
    if goes_on(model, state, grid, "size"):
        newton.recall(state.memory)
    for k in range(grid.done + 1, grid.count + 1):
        state = newton.step(state, k)
        counts.steps += 1
        yield state


def started(settings, model, state, h):
    """The state with the algorithmic acceleration of a run's first step; a state of the same method and step goes on as it is.

    `a_0 = q''_0 + (alpha_m - alpha_f) h q'''_0`, and v_0 moved by dv with `[[M, B^T], [B, 0]] (dv, .) = (0, B l / h)`,
    `l / h = (1 - 6 beta - 3 (alpha_m - alpha_f))/6 h^2 q'''_0`: lam is of second order from the first step (Arnold, Bruels 2007).
    """
    if np.isclose(state.memory.get("h", 0.0), h, rtol=1e-9, atol=0.0):
        return state
    if settings.start == "plain":
        return State(state.t, state.q, state.v, state.a, state.lam, {"a_alg": state.a, "h": h})
    c, third = settings.coefficients, jerk(model, state, h)
    a_alg, v = state.a + (c.alpha_m - c.alpha_f) * h * third, state.v
    if model.m:
        offset = (1 - 6 * c.beta - 3 * (c.alpha_m - c.alpha_f)) / 6 * h * h * third
        phi_q = model.phi_q(state.t, state.q)
        v = v + mass_system(model, state.t, state.q).solve(np.zeros(model.n), -(phi_q @ offset))[0]
    return State(state.t, state.q, v, state.a, state.lam, {"a_alg": a_alg, "h": h})


class Newton:
    """One step after the other at one h; holds the factorization between them."""

    def __init__(self, settings, model, grid, counts):
        self.settings, self.model, self.grid, self.counts = settings, model, grid, counts
        h = self.h = grid.h
        c = settings.coefficients
        self.c = c
        self.to_a = (1 - c.alpha_m) / (c.beta * h * h * (1 - c.alpha_f))
        self.to_v = c.gamma / (c.beta * h)
        self.kkt, self.size, self.factored_at = None, 0.0, None

    def recall(self, memory):
        """Take up Newton's memory at a restart, with the factor that it had, so that the run is the same bit by bit."""
        self.size = float(memory["size"])
        if len(memory["factored_at"]):
            n = self.model.n
            t, q, v, a, lam = np.split(memory["factored_at"], [1, 1 + n, 1 + 2 * n, 1 + 3 * n])
            self._factor(float(t[0]), q, v, a, lam)

    def step(self, state, k):
        """The accepted state after step k. Raises StepFailure where Newton does not converge even with fresh matrices."""
        t, self.place = self.grid.time(k), self.grid.after(k)
        try:
            return self._solve(state, t)
        except Divergence as first:
            if first.fresh:
                raise StepFailure("newton", str(first), t, **first.seen) from None
        self.kkt = None
        try:
            return self._solve(state, t, always_fresh=True)
        except Divergence as second:
            raise StepFailure("newton", str(second), t, **second.seen) from None

    def _predict(self, state):
        c, h, a0 = self.c, self.h, state.memory["a_alg"]
        a1 = ((1 - c.alpha_f) * state.a + c.alpha_f * state.a - c.alpha_m * a0) / (1 - c.alpha_m)
        q = state.q + h * state.v + h * h * ((0.5 - c.beta) * a0 + c.beta * a1)
        return q, state.v + h * ((1 - c.gamma) * a0 + c.gamma * a1), state.a.copy(), state.lam.copy()

    def _solve(self, state, t, always_fresh=False):
        q, v, a, lam = self._predict(state)
        model, before, fresh, worst = self.model, np.inf, self.kkt is None, 0.0
        self.size = max(0.9 * self.size, _rms(a))
        for iteration in range(self.settings.max_iterations):
            r, phi = model.residual(t, q, v, a, lam), model.phi(t, q)
            self.counts.residuals += 1
            if not (np.isfinite(r).all() and np.isfinite(phi).all()):
                raise Divergence("r or phi is not finite", fresh, iteration, before, phi)
            if self.kkt is None or always_fresh:
                self._factor(t, q, v, a, lam)
            dq, dlam = self.kkt.solve(r, phi)
            self.counts.solves += 1
            self.counts.newton_iterations += 1
            q, v, a, lam = q + dq, v + self.to_v * dq, a + self.to_a * dq, lam + dlam
            moved = _rms(dq)
            rate = moved / before if before > 0 else 0.0
            tolerance = self.settings.tolerance * max(self.size, _rms(a)) / self.to_a
            floor = 16 * EPS * (_rms(q) + self.h * _rms(v))
            settled = moved <= max(floor, 1e-3 * tolerance) or (iteration and rate < 1 and moved * rate / (1 - rate) <= tolerance)
            if settled and self._closed(t, q, max(floor, 1e-2 * tolerance)):
                return self._accepted(state, t, q, v, a, lam)
            if iteration and rate > SLOW and not always_fresh:
                if rate > 0.9 and fresh:
                    raise Divergence("Newton does not contract", fresh, iteration, moved, phi)
                self.kkt, fresh = None, True
            before = moved
        raise Divergence("Newton does not converge", fresh or always_fresh, iteration + 1, moved, phi)

    def _closed(self, t, q, tolerance):
        return self.model.m == 0 or np.abs(self.model.phi(t, q)).max() <= tolerance

    def _accepted(self, state, t, q, v, a, lam):
        objection = getattr(self.model, "objection", lambda t, q: None)(t, q)
        if objection:
            raise StepFailure("objection", objection, t)
        c, a0 = self.c, state.memory["a_alg"]
        a1 = ((1 - c.alpha_f) * a + c.alpha_f * state.a - c.alpha_m * a0) / (1 - c.alpha_m)
        self.size = max(self.size, _rms(a))
        made = np.zeros(0) if self.kkt is None else self.factored_at
        memory = {"a_alg": a1, "h": self.h, "size": self.size, "factored_at": made, "grid": self.place}
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


class Divergence(Exception):
    """Newton's iteration did not settle; `fresh` tells whether the matrix was new."""

    def __init__(self, reason, fresh, iterations, moved, phi):
        super().__init__(reason)
        self.fresh = fresh
        self.seen = {"iterations": iterations, "last |dq|": float(moved), "|phi|": float(np.abs(phi).max(initial=0.0))}


def _rms(x):
    return float(np.sqrt(x @ x / max(1, x.size)))
