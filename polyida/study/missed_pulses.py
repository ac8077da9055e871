"""The impulse of short pulses that a reference run may have missed.

A method sees a force only at the stages of its steps, so that both methods of a reference may miss a short pulse. For forces without announced
discontinuities, `missed_impulse` samples the force at many times of each step, on the quintic through q, v and a of its ends, and compares
it with the cubic through the stages of Radau IIA. The missed impulse `J = int g dt - h sum b_i g_i` changes v by dv from `M dv + B^T mu =
-J`, `B dv = 0`.
"""

import numpy as np

from polyida.assembly.own_forces import take_from
from polyida.linear.lu import SingularSystem
from polyida.linear.saddle import KKT
from polyida.model.guarded import guard
from polyida.study.ivp import values_of

SAMPLES = 4000  # times of a run at which forces are sampled
SAMPLES_PER_STEP = 2  # at least
DEVIATION = 1e-3  # of the largest force: deviation from the cubic of a step that missed a pulse
IMPULSE_SAMPLES = 400  # times of such a step at which the impulse is integrated
STAGES = np.array([0.0, 0.4 - np.sqrt(0.06), 0.4 + np.sqrt(0.06), 1.0])
WEIGHTS = np.array([0.0, (16 - np.sqrt(6)) / 36, (16 + np.sqrt(6)) / 36, 1 / 9])  # b of Radau IIA at STAGES, s in [0, 1]
CUBIC = np.linalg.inv(np.vander(STAGES, increasing=True))  # coefficients of the cubic from values at STAGES


def has_known_discontinuities(model):
    """True if all discontinuities of the forces are announced: all own force elements give gaps, or an own model does."""
    return all(force.switches for force in model.own_forces) if model.is_scene else model.switching


def missed_impulse(run):
    """{part: possible error at the end from pulses between the stages}; all steps of the run must be frames."""
    model = guard(run.model)
    error = dict.fromkeys(values_of(model, run.q[-1], run.v[-1], run.lam[-1]), 0.0)
    steps = [_StepForces(model, run, k) for k in range(len(run) - 1) if run.t[k + 1] > run.t[k]]
    sampled = [(step, *step.deviation(max(SAMPLES_PER_STEP, int(np.ceil(SAMPLES * step.h / (run.t[-1] - run.t[0])))))) for step in steps]
    largest_force = max((size for _, size, _ in sampled), default=0.0)
    fastest = max(np.abs(run.v).max(initial=0.0), 1e-300)
    for step, _, deviation in sampled:
        if deviation > DEVIATION * largest_force:
            change, mu = step.impulse()
            values = values_of(model, change, change, mu)
            dv = float(np.abs(values["v"]).max(initial=0.0))
            error["v"] += dv
            error["q"] += dv * max(step.h, run.t[-1] - step.t)
            error["lam"] += max(float(np.abs(mu).max(initial=0.0)) / step.h, np.abs(run.lam[-1]).max(initial=0.0) * dv / fastest)
            if model.k:
                error["x"] += float(np.abs(values["x"]).max())
    return error


class _StepForces:
    """The forces of step k of a run as a function of s in [0, 1], on the quintic through q, v and a of both ends."""

    def __init__(self, model, run, k):
        """Take the states at both ends of step k of a run."""
        self.model = model
        self.t = float(run.t[k])
        self.h = float(run.t[k + 1] - run.t[k])
        self.ends = np.array([[x[i] for x in (run.q, run.v, run.a)] for i in (k, k + 1)], float)  # q, v and a at both ends
        self.seed = k

    def deviation(self, count):
        """(largest force, largest deviation from the cubic), at a random time in each of `count` parts."""
        s = (np.arange(count) + np.random.default_rng(self.seed).random(count)) / count
        coefficients = CUBIC @ self.forces(STAGES)
        values = self.forces(s)
        deviation = np.abs(values - np.vander(s, 4, increasing=True) @ coefficients)
        return max(float(np.abs(x).max(initial=0.0)) for x in (values, coefficients)), float(deviation.max(initial=0.0))

    def impulse(self):
        """(dv (n,), mu (m,)) of the missed impulse."""
        s = np.linspace(0.0, 1.0, IMPULSE_SAMPLES + 1)
        J = self.h * (np.trapezoid(self.forces(s), s, axis=0) - WEIGHTS @ self.forces(STAGES))
        q = self.ends[1, 0]
        try:
            return KKT(self.model.mass(q), self.model.phi_q(self.t + self.h, q), 1.0).solve(J, np.zeros(self.model.m))
        except SingularSystem:
            return np.full(self.model.n, np.inf), np.full(self.model.m, np.inf)

    def forces(self, points):
        """g of the forces without announced discontinuities at s = points (k,), (k, n)."""
        from scipy.interpolate import BPoly

        quintic = BPoly.from_derivatives([0.0, self.h], self.ends)
        forces, states = np.zeros((len(points), self.model.n)), (quintic(points * self.h), quintic.derivative()(points * self.h))
        for row, s, q, v in zip(forces, points.tolist(), *states):
            if self.model.is_scene:
                take_from(row, self.model.own_forces, self.t + s * self.h, q, v)
            else:
                row[:] = self.model.force(self.t + s * self.h, q, v)
        return forces
