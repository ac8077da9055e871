"""
An objective of your own
========================

An objective is a function of a run together with its slopes in q, v, a and lam of each frame. Here it is the final height of a bar's end
above a wanted height, squared. ``pi.gradient`` returns its slopes in the parameters that you name.
"""

import numpy as np

import polyida as pi

scene = pi.Scene(gravity=(0.0, -9.81))
bar = scene.add(pi.RigidBody.bar(1.0, 1.0, name="bar"))
scene.add(pi.Revolute(pi.ground, bar.at("left"), name="hinge"))
scene.add(pi.PointMass(bar.at("right"), 0.5, name="tip"))
scene.add(pi.TorsionSpring(pi.ground.at((0.0, 0.0), direction=(1.0, 0.0)), bar.at("left"), stiffness=20.0, name="spring"))
model = scene.build()
run = pi.solve(model, 0.5, pi.GeneralizedAlpha(h=1e-3, tolerance=1e-8))

# %%
# The height of the tip is linear in q. Its row of weights follows from one unit change of each coordinate.

WANTED = -0.4  # m


def height(q):
    """Height of the bar's right end: q holds the displacements of the centre and of z = s exp(i theta)."""
    s = np.sqrt(bar.inertia / bar.mass)
    return q[1] + 0.5 * q[3] / s


row = np.array([height(unit) for unit in np.eye(model.n)])
assert np.isclose(height(run.q[-1]), run.position("tip")[-1, 1])


def value(run):
    return (height(run.q[-1]) - WANTED) ** 2


def slopes(run):
    in_q = np.zeros_like(run.q)
    in_q[-1] = 2.0 * (height(run.q[-1]) - WANTED) * row
    return {"q": in_q}


missed = pi.objective.UserObjective(value, slopes)
gradient = pi.gradient(run, missed, parameters=["spring.stiffness", "tip.mass"])
print(f"missed by {abs(height(run.q[-1]) - WANTED):.3f} m; dJ/dstiffness = {gradient['spring.stiffness']:.4g} m2 rad / (N m)")
print(pi.check_gradient(run, missed, parameters=["spring.stiffness", "tip.mass"]))

# %%
# The bar at five times, and the height that its right end should have.

axes = run.plot.deformed(snapshots=5)
axes.axhline(WANTED, color="#D55E00", linestyle="--")
