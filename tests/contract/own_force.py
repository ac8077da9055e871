"""A force and a body of one's own, outside the package: drag on a tip, and a point-like body on a spring, in every integrator."""

from dataclasses import dataclass

import numpy as np

import polyida as pi


@dataclass(frozen=True, eq=False)
class Drag(pi.ForceElement):
    """Drag of a point in air at rest, `f = -c |v| v`, N; c in N s2/m2."""

    at: object
    c: float
    name: str | None = None

    def sides(self):
        return (self.at,)

    def forces(self, t, x, v):
        """Forces on the sides, (sides, 2), N, from their places and velocities, (sides, 2) each."""
        return -self.c * np.linalg.norm(v, axis=1, keepdims=True) * v


@dataclass(frozen=True, eq=False)
class Magnet(pi.ForceElement):
    """Two points attract with the potential `-k / (d + d0)`, J, d their distance, m."""

    a: object
    b: object
    k: float
    d0: float
    name: str | None = None

    def sides(self):
        return (self.a, self.b)

    def forces(self, t, x, v):
        w = x[1] - x[0]
        d = np.linalg.norm(w)
        pull = self.k / (d + self.d0) ** 2 * w / d
        return np.stack([pull, -pull])

    def energy(self, x):
        return -self.k / (np.linalg.norm(x[1] - x[0]) + self.d0)


def scene(*forces):
    made = pi.Scene(gravity=(0.0, -9.81))
    bar = made.add(
        pi.Plate(pi.mesh.rectangle(1.0, 0.1, cells=60, seed=1), pi.Material(E=50e6, nu=0.3, rho=1100.0), thickness=0.01, name="bar")
    )
    made.add(pi.Revolute(pi.ground, bar.section("left"), name="hinge"))
    made.add(pi.PointMass(bar.section("right"), 0.1, name="tip"))
    for force in forces:
        made.add(force(bar))
    return made.build()


magnet = lambda bar: Magnet(pi.ground.at((0.0, -2.0)), bar.section("right"), k=3.0, d0=0.5, name="magnet")  # noqa: E731
drag = lambda bar: Drag(bar.section("right"), c=0.4, name="drag")  # noqa: E731

model = scene(magnet, drag)
assert max(pi.check_derivatives(model).values()) < 1e-6
ends = [pi.solve(model, 0.1, integrator).position("tip")[-1] for integrator in (pi.GeneralizedAlpha(h=5e-4), pi.IDA(rtol=1e-6, atol=1e-8))]
assert np.abs(ends[0] - ends[1]).max() < 5e-5, ends

# a force with an energy conserves; the energy of the whole counts it
run = pi.solve(scene(magnet), 0.2, pi.EnergyMomentum(h=5e-4))
assert run.success and np.abs(run.energy.total - run.energy.total[0]).max() < 1e-7 * np.abs(run.energy.total).max()

# one without loses what its work takes; the work is counted under its name
run = pi.solve(scene(drag), 0.4, pi.GeneralizedAlpha(h=5e-4))
lost = run.energy.total - run.energy.total[0] - run.energy.work["drag"]
assert run.energy.work["drag"][-1] < -1e-2 and np.abs(lost).max() < 2e-3 * np.abs(run.energy.work["drag"]).max() + 1e-3
run.save("drag.h5", overwrite=True)
assert np.array_equal(pi.load("drag.h5").q, run.q)
print("own force: ends", ends)
