"""
A flexible arm whose controller is designed by gradients
========================================================

A PID controller turns a flexible arm by 0.5 rad. Its three gains are found by ``pi.gradient``: one backward sweep gives the slopes of the
tip's deviation in all of them.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.optimize import minimize

import polyida as pi

TURN, END = 0.5, 1.5  # rad, s


def build(kp, ki, kd):
    scene = pi.Scene()
    arm = scene.add(pi.Plate(pi.mesh.rectangle(1.0, 0.06, cells=60, seed=1), pi.Material(E=1e9, nu=0.3, rho=1100.0), 0.01, name="arm"))
    hub = scene.add(pi.RigidBody(mass=1.0, inertia=0.02, points={"c": (0.0, 0.0)}, name="hub"))
    scene.add(pi.Revolute(pi.ground, hub.at("c"), name="axle"))
    scene.add(pi.Weld(hub.at("c"), arm.section("left"), name="root"))
    scene.add(pi.PointMass(arm.section("right"), 0.1, name="tip"))
    scene.add(pi.PID(hub.at("c"), kp=kp, ki=ki, kd=kd, target=pi.profile.quintic(0.0, TURN, 0.5), filter=5e-3, name="pid"))
    return scene.build()


NAMES = ["pid.kp", "pid.ki", "pid.kd"]
START = np.array([20.0, 5.0, 2.0])
goal = pi.profile.quintic(0.0, TURN, 0.5)
missed = pi.objective.Deviation("tip", lambda t: np.array([np.cos(goal(t)), np.sin(goal(t))]))


def run(gains):
    return pi.solve(build(*gains), END, pi.GeneralizedAlpha(h=2e-3, tolerance=1e-9))


# %%
# The gains are scaled by their start values. Bounds keep the controller where sampling and sensors of a real arm could follow.


def cost(scale):
    gradient = pi.gradient(run(START * scale), missed, parameters=NAMES)
    return 1e4 * gradient.value, 1e4 * np.array([gradient[name] for name in NAMES]) * START


best = minimize(cost, np.ones(3), jac=True, method="L-BFGS-B", bounds=[(0.2, 5.0)] * 3, options={"maxiter": 12})
gains = START * best.x
print(f"kp, ki, kd = {gains.round(2)}; mean square deviation {1e-4 * cost(np.ones(3))[0]:.3g} -> {1e-4 * best.fun:.3g} m2")

# %%
# The tip's angle with the first and the last gains.

figure, axes = plt.subplots(figsize=(6, 3.2), layout="constrained")
for label, one in (("first gains", START), ("designed gains", gains)):
    result = run(one)
    axes.plot(result.t, np.arctan2(*result.position("tip").T[::-1]), label=label)
axes.plot(result.t, [goal(t) for t in result.t], "k--", lw=1, label="wanted")
axes.set(xlabel="t, s", ylabel="angle of the tip, rad")
axes.legend()
plt.show()
