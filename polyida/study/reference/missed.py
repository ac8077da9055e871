"""What the steps of a run did not see of forces that no kink of the model announces, looked for between the steps.

A method sees a force at the stages of its steps alone. Here the forces are taken at many times of each step, on the quintic through q, v
and a of its ends. Where they leave the cubic through the values at the stages of Radau IIA, the impulse that a step missed is `J = int g dt
- h sum b_i g_i`, which changes v by that of `M dv + B^T mu = -J`, `B dv = 0`.
"""

import numpy as np

from polyida.linear.kkt import KKT
from polyida.linear.lu import SingularSystem
from polyida.model.guarded import guard

TIMES = 4000  # of a run at which forces are looked at, or more
LEAST = 2  # of a step
AWAY = 1e-3  # of the largest force: what it leaves the cubic by in a step that did not see all of it
FINE = 400  # times of such a step at which the impulse is integrated
STAGES = np.array([0.0, 0.4 - np.sqrt(0.06), 0.4 + np.sqrt(0.06), 1.0])
WEIGHTS = np.array([0.0, (16 - np.sqrt(6)) / 36, (16 + np.sqrt(6)) / 36, 1 / 9])
CUBIC = np.linalg.inv(np.vander(STAGES, increasing=True))


def announces(model):
    """Whether all forces of a model are smooth between its kinks and switches, as far as is known: where all force elements give gaps, or an own
    model does."""
    return all(own.switches for own in model.own_forces.each) if model.is_scene else model.switching


def missed(run):
    """{"q", "v", "lam": by how much the end of a run, all of whose steps are frames, may be off by what its steps did not see}."""
    model, found = guard(run.model), {"q": 0.0, "v": 0.0, "lam": 0.0}
    steps = [_Step(model, run, k) for k in range(len(run) - 1) if run.t[k + 1] > run.t[k]]
    seen = [(step, *step.look(max(LEAST, int(np.ceil(TIMES * step.h / (run.t[-1] - run.t[0])))))) for step in steps]
    largest = max((size for _, size, _ in seen), default=0.0)
    fastest = max(np.abs(run.v).max(initial=0.0), 1e-300)
    for step, _, away in seen:
        if away > AWAY * largest:
            dv, mu = step.blow()
            found["v"] += dv
            found["q"] += dv * max(step.h, run.t[-1] - step.t)
            found["lam"] += max(mu / step.h, np.abs(run.lam[-1]).max(initial=0.0) * dv / fastest)
    return found


class _Step:
    """Step k of a run: its forces over s in [0, 1]."""

    def __init__(self, model, run, k):
        self.model, self.t, self.h = model, float(run.t[k]), float(run.t[k + 1] - run.t[k])
        self.ends = [np.array([x[k], x[k + 1]], float) for x in (run.q, run.v, run.a)]
        self.seed = k

    def look(self, count):
        """(size of the force, by how much it leaves the cubic), at a random time in each of `count` parts."""
        at = (np.arange(count) + np.random.default_rng(self.seed).random(count)) / count
        stages = CUBIC @ self.forces(STAGES)
        values = self.forces(at)
        away = np.abs(values - np.vander(at, 4, increasing=True) @ stages)
        return max(float(np.abs(x).max(initial=0.0)) for x in (values, stages)), float(away.max(initial=0.0))

    def blow(self):
        """(largest |dv|, largest |mu|) of the impulse that the step missed."""
        at = np.linspace(0.0, 1.0, FINE + 1)
        J = self.h * (np.trapezoid(self.forces(at), at, axis=0) - WEIGHTS @ self.forces(STAGES))
        q = self.ends[0][1]
        try:
            dv, mu = KKT(self.model.mass(q), self.model.phi_q(self.t + self.h, q)).solve(J, np.zeros(self.model.m))
        except SingularSystem:
            return np.inf, np.inf
        return float(np.abs(dv).max(initial=0.0)), float(np.abs(mu).max(initial=0.0))

    def forces(self, at):
        """g of what no kink announces at s = at (k,), (k, n)."""
        found = np.empty((len(at), self.model.n))
        for row, s in zip(found, at.tolist()):
            t, (q, v) = self.t + s * self.h, self._state(s)
            if self.model.is_scene:
                row[:] = 0.0
                self.model.own_forces.take_from(row, t, q, v)
            else:
                row[:] = self.model.force(t, q, v)
        return found

    def _state(self, s):
        """q and v of the quintic through q, v and a of both ends."""
        (q0, q1), (v0, v1), (a0, a1) = self.ends
        h = self.h
        c0, c1, c2 = (q1 - q0) / h**2 - v0 / h - a0 / 2, (v1 - v0) / h - a0, a1 - a0
        b3, b4, b5 = 10 * c0 - 4 * c1 + c2 / 2, -15 * c0 + 7 * c1 - c2, 6 * c0 - 3 * c1 + c2 / 2
        gain = s**2 * (a0 / 2 + s * (b3 + s * (b4 + s * b5)))
        rate = s * (a0 + s * (3 * b3 + s * (4 * b4 + s * 5 * b5)))
        return q0 + h * (s * v0 + h * gain), v0 + h * rate
