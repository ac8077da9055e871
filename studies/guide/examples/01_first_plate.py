"""
A plate on a hinge
==================

One flexible plate, meshed with polygons, falls from rest about a hinge at its left edge. The picture shows it at six times, coloured by von Mises stress.
"""

import matplotlib.pyplot as plt

import polyida as pi
from polyida.show import plots

mesh = pi.mesh.rectangle(1.0, 0.1, cells=80, seed=1)
rubber = pi.Material(E=20e6, nu=0.3, rho=1100.0)
scene = pi.Scene(gravity=(0.0, -9.81))
bar = scene.add(pi.Plate(mesh, rubber, thickness=0.01, name="bar"))
scene.add(pi.Revolute(pi.ground, bar.section("left"), name="hinge"))
scene.add(pi.PointMass(bar.section("right"), 0.5, name="tip"))
run = pi.solve(scene.build(), 0.6, pi.GeneralizedAlpha(h=1e-3))
print(run.summary())

figure = plots.deformed(run)

# %%
# What the hinge does to the plate, over time: it carries the weight and what turns the plate.

fig, axes = plt.subplots(figsize=(6.4, 3.0), layout="constrained")
axes.plot(run.t, run.reaction("hinge"), label=["x", "y"])
axes.set(xlabel="t, s", ylabel="force on the plate, N")
axes.legend()
