"""The plain loop of generalized-alpha, for any model: what `scene.py` does in one compiled loop, by the same pieces."""

import numpy as np

from polyida.integrate.alpha import step
from polyida.integrate.kinks import inner_side
from polyida.integrate.state import StepFailure
from polyida.integrate.stepping.ended import DONE, NOT_FINITE, REFACTOR, SINGULAR, TOO_NEAR
from polyida.linear.lu import SingularSystem


class PlainLoop:
    """Steps one by one, so that each state is there before the model's functions are called again."""

    longest = 1

    def __init__(self, settings, model, counts, memory, trial):
        self.model, self.counts, self.memory, self.trial = model, counts, memory, trial
        self.tied = settings.form == "stabilised" and model.m > 0

    def prepare(self, times, method):
        """Get ready for steps between the times."""
        self.before, self.end = times
        self.inner = inner_side(self.model, self.end, method.h)
        self.increments = None
        if method.incremental:
            ends, past = (inner_side(self.model, self.before, -method.h), self.inner), self.memory.past
            self.increments = self.model.increments(self.before, self.end, ends, method.h, past[step.Q], past[step.V])

    def factor(self, system, p, t):
        """Factor the system at the trial state. Raises SingularSystem."""
        q, v, a = self.trial.now[:3].copy()
        system.factor(self.inner, q, v, a, self.trial.rows[step.LAM].copy(), p.to_a, p.to_v)

    def steps(self, p, system, first, last, *frame):
        """Take the step with a factored system: (steps, how it ended, last |dq|). Raises StepFailure where the model objects."""
        ended, moved = self._newton(p, system)
        if ended == DONE:
            ended = step.finish(p, self.memory, self.trial, *(part[0] for part in frame))
        return int(ended in (DONE, TOO_NEAR)), ended, moved

    def _newton(self, p, system):
        y, x, model = self.memory, self.trial, self.model
        last = step.begin(p, y, x)
        if last == 0.0:
            self.slip = np.zeros(model.n)
        for iteration in range(p.max_iterations):
            q, v, a = x.now[:3].copy()
            lam, phi = x.rows[step.LAM].copy(), self._closed(p)
            r = model.residual(self.inner, q, v, a, lam)
            self.counts.residuals += 1
            if not (np.isfinite(r).all() and np.isfinite(phi).all()):
                return NOT_FINITE, last
            try:
                slip = self._correct(p, system, q, v, lam, r, phi)
            except SingularSystem:
                return SINGULAR, last
            moved, settled, hopeless, allowed = step.correct(p, y, x, iteration == 1, last)
            if self.tied:
                x.now[step.DD] += slip
                x.now[step.Q] = y.past[step.Q] + (p.h * y.past[step.V] + x.now[step.DD])
            if settled and np.abs(self._closed(p)).max(initial=0.0) <= allowed:
                return self._settled(), moved
            if hopeless:
                return REFACTOR, moved
            last = moved
        return REFACTOR, last

    def _closed(self, p):
        """phi at the trial state, carried or from the positions."""
        x, y = self.trial, self.memory
        if self.increments is None:
            x.rows[step.PHI], x.rows[step.RATE] = self.model.phi(self.end, x.now[step.Q].copy()), y.closed[step.RATE]
            return x.rows[step.PHI]
        a_alg, dd = y.past[step.A_ALG], x.now[step.DD]
        dv = p.h * ((1.0 - p.gamma) * a_alg + p.gamma * (dd / p.h**2 - (0.5 - p.beta) * a_alg) / p.beta)
        x.rows[step.PHI], x.rows[step.RATE] = self.increments(dd, dv, y.closed[step.PHI], y.closed[step.RATE])
        return x.rows[step.PHI]

    def _correct(self, p, system, q, v, lam, r, phi):
        """Fill dq and dlam of one iteration; what it adds, in the stabilised form, to the slip of q against v."""
        self.counts.solves += 1
        self.counts.newton_iterations += 1
        rate = self._off(q, v) / p.to_v if self.tied else phi
        self.trial.now[step.DQ], self.trial.rows[step.DLAM] = system.saddle(self.inner, q, lam, r, rate)
        if not self.tied:
            return 0.0
        before, wanted = self.slip, phi - rate - self.model.phi_q(self.inner, q) @ self.slip
        self.slip = self.model.mass_system(self.inner, q).solve(np.zeros_like(r), wanted)[0]
        return self.slip - before

    def _off(self, q, v):
        return self.model.phi_q(self.inner, q) @ v + self.model.phi_t(self.inner, q)

    def _settled(self):
        """What is left of a settled step: the velocity's constraint in the stabilised form, and what the model says of the state."""
        x = self.trial
        q, v = x.now[step.Q].copy(), x.now[step.V].copy()
        if objection := self.model.objection(self.end, q):
            raise StepFailure("objection", objection, self.end)
        if self.tied:
            x.now[step.V] += self.model.mass_system(self.end, q).solve(np.zeros_like(v), self._off(q, v))[0]
            x.rows[step.RATE] = 0.0
        return DONE
