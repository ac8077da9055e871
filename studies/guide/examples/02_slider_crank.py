"""
A slider crank with a flexible rod
==================================

A rigid crank, a rod reduced to five modes, a guided slider with a spring; a torque drives it. The drawing is not exact: ``assemble`` closes the loop.
"""

import matplotlib.pyplot as plt
import numpy as np

import polyida as pi

r, length = 0.15, 0.3
scene = pi.Scene(gravity=(0.0, -9.81))
crank = scene.add(
    pi.RigidBody(mass=0.4, inertia=1e-3, points={"O": (-r / 2, 0.0), "A": (r / 2, 0.0)}, origin=(0.0, r / 2), angle=np.pi / 2, name="crank")
)
steel = pi.Material(E=210e9, nu=0.3, rho=7850.0)
plate = pi.Plate(pi.mesh.rectangle(length, 0.02, cells=60, seed=1), steel, 0.01, origin=(0.0, r), angle=-0.5, name="rod")
rod = scene.add(pi.Reduced(plate, modes=5))
slider = scene.add(pi.RigidBody(mass=0.5, inertia=1e-3, points={"B": (0.0, 0.0)}, origin=(0.27, 0.0), name="slider"))
scene.add(pi.Revolute(pi.ground, crank.at("O"), name="bearing"))
scene.add(pi.Revolute(crank.at("A"), rod.section("left"), name="crank pin"))
scene.add(pi.Revolute(rod.section("right"), slider.at("B"), name="wrist pin"))
scene.add(pi.Prismatic(pi.ground.at((0.0, 0.0), direction=(1.0, 0.0)), slider.at("B"), name="guide"))
scene.add(pi.SpringDamper(pi.ground.at((0.8, 0.0)), slider.at("B"), stiffness=200.0, damping=2.0, name="spring"))
scene.add(pi.Torque(crank.at("O"), pi.profile.quintic(0.0, 0.8, 0.1), name="drive"))
print(scene.assemble().summary())

run = pi.solve(scene.build(), 0.6, pi.GeneralizedAlpha(h=5e-4))
print(run.summary())
run.plot.deformed(snapshots=4)

# %%
# Every joule is accounted for: what the torque puts in is kinetic, elastic and potential energy, and what the damper takes.

energy = run.energy
fig, axes = plt.subplots(figsize=(6.4, 3.2), layout="constrained")
axes.plot(run.t, energy.work["drive"], label="work of the torque")
axes.plot(run.t, energy.total - energy.total[0], label="gained")
axes.plot(run.t, energy.dissipated["spring"], label="taken by the damper")
axes.set(xlabel="t, s", ylabel="J")
axes.legend()
