"""
An own integrator against those of the package
==============================================

RATTLE (Andersen 1983), written outside the package, in a work-precision study of a pendulum beside generalized-alpha, IDA and Radau IIA. The reference is made by two
families of methods that agree; hollow points would lie below what is known of it.
"""

from dataclasses import dataclass

import matplotlib.pyplot as plt
import numpy as np

import polyida as pi


def dense(matrix):
    """The matrices of a scene are scipy.sparse, those of an own model are what it returns."""
    return matrix.toarray() if hasattr(matrix, "toarray") else matrix


@dataclass(frozen=True)
class Rattle:
    """Leapfrog with q and v on the constraints; constant mass, forces of q alone."""

    h: float

    def steps(self, model, state, t_end, counts):
        t, q, v = state.t, state.q, state.v
        count = max(1, round((t_end - t) / self.h))
        h, W = (t_end - t) / count, np.linalg.inv(dense(model.mass(q)))
        for k in range(count):
            B = dense(model.phi_q(t, q))
            pull, half = 0.5 * h * W @ B.T, v - 0.5 * h * W @ model.force(t, q, v)
            lam, t_next = np.zeros(model.m), t_end if k == count - 1 else t + h
            for _ in range(50):
                x = q + h * (half - pull @ lam)
                gap = model.phi(t_next, x)
                if np.abs(gap).max() < 1e-13:
                    break
                lam = lam + np.linalg.solve(h * dense(model.phi_q(t_next, x)) @ pull, gap)
            else:
                raise pi.StepFailure("newton", "the projection does not converge", t_next)
            half, B, q, t = (x - q) / h, dense(model.phi_q(t_next, x)), x, t_next
            free = half - 0.5 * h * W @ model.force(t, q, half)
            lam = np.linalg.solve(0.5 * h * B @ W @ B.T, B @ free)
            v = free - 0.5 * h * W @ B.T @ lam
            counts.steps += 1
            yield pi.State(t, q, v, -W @ (model.force(t, q, v) + B.T @ lam), lam)


class Pendulum(pi.Model):
    """A point of 1 kg at the end of a massless rod of 1 m."""

    n, m = 2, 1
    needs = pi.Needs(mass_varies=False, velocity_forces=False, driven=False)

    def mass(self, q):
        return np.eye(2)

    def force(self, t, q, v):
        return np.array([0.0, 9.81])

    def phi(self, t, q):
        return np.array([q @ q - 1.0])

    def phi_q(self, t, q):
        return 2.0 * q[None]

    def potential(self, q):
        return 9.81 * q[1]


study = pi.study.work_precision(
    Pendulum(),
    1.0,
    q0=[1.0, 0.0],
    integrators={
        "RATTLE": [Rattle(h) for h in (1.6e-2, 8e-3, 4e-3, 2e-3)],
        "generalized-alpha": [pi.GeneralizedAlpha(h=h) for h in (1.6e-2, 8e-3, 4e-3, 2e-3)],
        "IDA": [pi.IDA(rtol=r, atol=r) for r in (1e-4, 1e-6, 1e-8)],
        "Radau IIA": [pi.RadauIIA(rtol=r, atol=r) for r in (1e-4, 1e-6, 1e-8)],
    },
)
print(study)

fig, axes = plt.subplots(1, 2, figsize=(8.0, 4.4), layout="constrained")
study.plot("q", axes[0])
study.plot("lam", axes[1])
