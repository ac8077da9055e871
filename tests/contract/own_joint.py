"""A joint of one's own is its formula: a point that slides along a line, written outside the package, in every integrator."""

import numpy as np

import polyida as pi


class Slot(pi.Joint):
    """`phi = d_A x (x_B - x_A)` (1 row, m): the point of b stays on the line through the point of a along the direction of a."""

    def rows(self):
        return [pi.cross(self.a.d, self.b.x - self.a.x)]


mesh = pi.mesh.rectangle(1.0, 0.1, cells=60, seed=1)
rubber = pi.Material(E=50e6, nu=0.3, rho=1100.0)


def scene(rail):
    made = pi.Scene(gravity=(0.0, -9.81))
    bar = made.add(pi.Plate(mesh, rubber, thickness=0.01, name="bar"))
    made.add(pi.PointMass(bar.section("left"), 0.2, name="pin"))
    made.add(rail(bar))
    return made


# a rail fixed in the ground, 45 degrees down
model = scene(lambda bar: Slot(pi.ground.at((0.0, 0.0), direction=(1.0, -1.0)), bar.section("left"), name="rail")).build()
assert max(pi.check_derivatives(model).values()) < 1e-6
runs = {}
for integrator in (pi.GeneralizedAlpha(h=5e-4), pi.EnergyMomentum(h=5e-4), pi.IDA(rtol=1e-7, atol=1e-9)):
    run = pi.solve(model, 0.3, integrator)
    assert run.success, run.message
    x = run.position("pin")
    assert np.abs(x @ [1.0, 1.0]).max() < 1e-8, "the pin left its rail"
    assert np.ptp(x @ [1.0, -1.0]) > 0.1, "the pin did not slide"
    assert np.abs(run.energy.total - run.energy.total[0]).max() < 1e-2
    assert run.reaction("rail").shape == (len(run.t), 2)  # the force on b
    runs[type(integrator).__name__] = x[-1]
ends = np.array(list(runs.values()))
assert np.ptp(ends, axis=0).max() < 1e-4, runs

# the same joint between two bodies, both moving
two = scene(lambda bar: pi.Revolute(pi.ground, bar.section("left"), name="hinge"))
bar = two.parts["bar"]
sledge = two.add(pi.Plate(mesh, rubber, thickness=0.01, origin=(1.0, 0.0), name="sledge"))
two.add(Slot(bar.section("right"), sledge.section("left"), name="slide"))
run = pi.solve(two.build(), 0.1, pi.GeneralizedAlpha(h=5e-4))
assert run.success and np.abs(run.drift).max() < 1e-10

# saved by name, loaded as data: the class of the joint need not be importable to look at the run
run.save("slot.h5", overwrite=True)
assert np.array_equal(pi.load("slot.h5").q, run.q)
print("own joint: ends", ends)
