"""
A bar that falls on the floor
=============================

A rigid bar, thrown with a spin, hits the ground with its ends: contacts after Hunt and Crossley, which take energy at each blow.
"""

import matplotlib.pyplot as plt
import numpy as np

import polyida as pi

scene = pi.Scene(gravity=(0.0, -9.81))
bar = scene.add(pi.RigidBody.bar(0.4, 0.5, origin=(0.0, 0.5), angle=0.5, velocity=(0.6, 0.0), spin=3.0, name="bar"))
floor = pi.ground.at((0.0, 0.0))
for end in ("left", "right"):
    scene.add(pi.PenaltyContact(bar.at(end), floor, stiffness=2e5, damping=0.2, name=f"{end} end"))
run = pi.solve(scene.build(), 1.2, pi.RadauIIA(rtol=1e-6), output=np.linspace(0.0, 1.2, 601))
print(run.summary())

fig, (motion, energy) = plt.subplots(1, 2, figsize=(8.0, 4.4), layout="constrained", width_ratios=[1.4, 1.0])
left, right = (run.position(bar.at(end)) for end in ("left", "right"))
for k in range(0, len(run.t), 20):
    motion.plot(*np.stack([left[k], right[k]]).T, color=plt.cm.viridis(run.t[k] / run.t[-1]))
motion.axhline(0.0, color="grey")
motion.set(xlabel="x, m", ylabel="y, m", aspect="equal", title="every 0.04 s")
energy.plot(run.t, run.energy.total, label="total energy")
energy.plot(run.t, sum(run.energy.dissipated.values()), label="taken by the blows")
energy.set(xlabel="t, s", ylabel="J")
energy.legend()
