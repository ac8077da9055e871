"""
An own joint
============

A joint is its formula. Here the left edge of a plate runs along a rail, 45 degrees down; the same class goes into every integrator.
"""

import matplotlib.pyplot as plt

import polyida as pi


class Rail(pi.Joint):
    """`phi = d_A x (x_B - x_A)`: the point of b stays on the line through the point of a along the direction of a."""

    def rows(self):
        return [pi.cross(self.a.d, self.b.x - self.a.x)]


scene = pi.Scene(gravity=(0.0, -9.81))
rubber = pi.Material(E=50e6, nu=0.3, rho=1100.0)
bar = scene.add(pi.Plate(pi.mesh.rectangle(1.0, 0.1, cells=60, seed=1), rubber, thickness=0.01, name="bar"))
scene.add(Rail(pi.ground.at((0.0, 0.0), direction=(1.0, -1.0)), bar.section("left"), name="rail"))
scene.add(pi.PointMass(bar.section("right"), 0.2, name="tip"))
model = scene.build()

integrators = {
    "generalized-alpha": pi.GeneralizedAlpha(h=1e-3),
    "energy-momentum": pi.EnergyMomentum(h=1e-3),
    "Radau IIA": pi.RadauIIA(rtol=1e-6),
}
fig, (path, force) = plt.subplots(1, 2, figsize=(8.0, 3.6), layout="constrained")
for (name, integrator), style in zip(integrators.items(), ("-", "--", ":")):
    run = pi.solve(model, 0.5, integrator)
    for point in ("rail", "tip"):
        path.plot(*run.position(point).T, style, label=f"{point}, {name}")
    force.plot(run.t, run.reaction("rail")[:, 0], style, label=name)
path.set(xlabel="x, m", ylabel="y, m", aspect="equal", title="paths of both ends")
force.set(xlabel="t, s", ylabel="force, N", title="what the rail does")
force.legend(fontsize="small")
