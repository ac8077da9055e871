"""
Sizes and gains together
========================

A controlled arm of least mass: its thickness, its heights at the hub and at the tip, and the three gains of its controller are found together. The tip
has to follow its path, and the moment at the root is limited.
"""

import matplotlib.pyplot as plt
import numpy as np

import polyida as pi

goal = pi.profile.quintic(0.0, 0.5, 0.5)
mesh = pi.mesh.rectangle(1.0, 0.06, cells=30, seed=1)


def build(root=1.0, tip=1.0):
    """The model; root, tip: heights over those of the first outline. The nodes of one mesh move, so that nothing jumps."""
    x, y = mesh.points.T
    outline = pi.mesh.moved(mesh, np.stack([x, y * (root + (tip - root) * x)], axis=1))
    scene = pi.Scene()
    arm = scene.add(pi.Plate(outline, pi.Material(E=1e9, nu=0.3, rho=1100.0), 0.01, name="arm"))
    hub = scene.add(pi.RigidBody(mass=1.0, inertia=0.02, points={"c": (0.0, 0.0)}, name="hub"))
    scene.add(pi.Revolute(pi.ground, hub.at("c"), name="axle"))
    scene.add(pi.Weld(hub.at("c"), arm.section("left"), name="root"))
    scene.add(pi.PointMass(arm.section("right"), 0.1, name="load"))
    scene.add(pi.PID(hub.at("c"), kp=150.0, ki=5.0, kd=8.0, target=goal, filter=5e-3, name="pid"))
    return scene.build()


def move(model):
    return pi.solve(model, 1.0, pi.GeneralizedAlpha(h=5e-3, tolerance=1e-8))


# %%
# Names with a dot are parameters of the model; `root` and `tip` are arguments of the function above. Sizes whose order of magnitude is searched are
# seen by the optimiser through their logarithm.

variables = [
    pi.design.Size("arm.thickness", 2e-3, 2e-2, start=1e-2, log=True),
    pi.design.Size("root", 0.4, 2.5, start=1.0, log=True),
    pi.design.Size("tip", 0.3, 2.5, start=1.0, log=True),
    pi.design.Size("pid.kp", 10.0, 400.0, start=150.0, log=True),
    pi.design.Size("pid.ki", 1.0, 100.0, start=5.0, log=True),
    pi.design.Size("pid.kd", 1.0, 40.0, start=8.0, log=True),
]
path = pi.objective.Deviation("load", lambda t: np.array([np.cos(goal(t)), np.sin(goal(t))]))
limits = [pi.objective.Limit(path, 2e-4), pi.objective.Limit(pi.objective.PeakTorque("root", p=12), 3.0)]
stages = [pi.design.Stage(10, move=0.3), pi.design.Stage(8, move=0.15)]
design = pi.design.minimise(pi.objective.Mass("arm"), limits, variables, pi.design.Case(build, move), stages)
print(design)
print({name: round(value, 4) for name, value in design.values.items()})

# %%
# The way of the search, and the tip's error before and after.

figure, (way, error) = plt.subplots(1, 2, figsize=(8, 3.2), layout="constrained")
way.semilogy(design.history["objective"], label="mass of the arm, kg")
way.semilogy(np.maximum(design.history["excess"], 1e-4), "--", label="largest excess of a limit")
way.set(xlabel="evaluation")
way.legend()
for label, run in (("first", move(build())), ("designed", design.run())):
    off = run.position("load") - [path.path(t) for t in run.t]
    error.plot(run.t, 1e3 * np.hypot(*off.T), label=label)
error.set(xlabel="t, s", ylabel="error of the tip, mm")
error.legend()
plt.show()
