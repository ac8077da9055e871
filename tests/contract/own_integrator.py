"""An integrator of one's own beside the package's: solved, saved, and put into a work-precision study of one's own model."""

from dataclasses import dataclass

import numpy as np

import polyida as pi


@dataclass(frozen=True)
class Rattle:
    """RATTLE (Andersen 1983): leapfrog with q and v on the constraints; constant mass, forces of q alone."""

    h: float

    def steps(self, model, state, t_end, counts):
        t, q, v = state.t, state.q, state.v
        count = max(1, round((t_end - t) / self.h))
        h = (t_end - t) / count
        for k in range(count):
            W, B = np.linalg.inv(model.mass(q)), model.phi_q(t, q)
            pull, half = 0.5 * h * W @ B.T, v - 0.5 * h * W @ model.force(t, q, v)
            lam = np.zeros(model.m)
            t_next = t_end if k == count - 1 else t + h
            for _ in range(50):
                x = q + h * (half - pull @ lam)
                gap = model.phi(t_next, x)
                if np.abs(gap).max() < 1e-14:
                    break
                lam = lam + np.linalg.solve(h * model.phi_q(t_next, x) @ pull, gap)
            half, B, q, t = (x - q) / h, model.phi_q(t_next, x), x, t_next
            free = half - 0.5 * h * W @ model.force(t, q, half)
            lam = np.linalg.solve(0.5 * h * B @ W @ B.T, B @ free)
            v = free - 0.5 * h * W @ B.T @ lam
            counts.steps += 1
            yield pi.State(t, q, v, -W @ (model.force(t, q, v) + B.T @ lam), lam)


class Pendulum(pi.Model):
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


model, q0 = Pendulum(), [1.0, 0.0]
run = pi.solve(model, 1.0, Rattle(h=1e-3), q0=q0)
assert run.success and np.abs(run.drift).max() < 1e-12
run.save("rattle.h5", overwrite=True)
assert np.array_equal(pi.load("rattle.h5").q, run.q)

study = pi.study.work_precision(
    model,
    1.0,
    q0=q0,
    integrators={
        "RATTLE": [Rattle(h) for h in (8e-3, 4e-3, 2e-3, 1e-3)],
        "generalized-alpha": [pi.GeneralizedAlpha(h=h) for h in (8e-3, 4e-3, 2e-3, 1e-3)],
        "IDA": [pi.IDA(rtol=r, atol=r) for r in (1e-4, 1e-6, 1e-8)],
    },
)
assert len(study.rows) == 11 and all(row["status"] == "done" for row in study.rows)
for row in study.rows:
    assert {"integrator", "setting", "cpu_s", "steps", "error_q", "error_v", "error_lam"} <= set(row)
assert abs(study.orders["RATTLE"]["q"] - 2.0) < 0.15 and abs(study.orders["generalized-alpha"]["q"] - 2.0) < 0.15
# the reference is made by two families that agree, or by what the user gives; how far it is known is said
assert study.known_to["q"] < 1e-9, study.known_to
assert len(study.reference["made_by"]) >= 2
assert list(study.to_dataframe().columns)[:2] == ["integrator", "setting"]
axes = study.plot("q")
assert len(axes.lines) >= 3
paths = study.report("rattle-study", overwrite=True)
assert (paths / "report.html").exists() and (paths / "figures.json").exists()
sizes = pi.study.step_sizes(
    model, 1.0, q0=q0, integrators={"RATTLE": Rattle, "generalized-alpha": pi.GeneralizedAlpha}, h=(4e-3, 2e-3, 1e-3)
)
assert abs(sizes.orders["RATTLE"]["v"] - 2.0) < 0.15
print(study)
