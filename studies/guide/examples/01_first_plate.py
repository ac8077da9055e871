"""
A plate on a hinge
==================

One flexible plate, meshed with polygons, falls from rest about a hinge at its left edge. The picture shows it at six times, coloured by von Mises stress.
"""

import polyida as pi

mesh = pi.mesh.rectangle(1.0, 0.1, cells=80, seed=1)
rubber = pi.Material(E=20e6, nu=0.3, rho=1100.0)
scene = pi.Scene(gravity=(0.0, -9.81))
bar = scene.add(pi.Plate(mesh, rubber, thickness=0.01, name="bar"))
scene.add(pi.Revolute(pi.ground, bar.section("left"), name="hinge"))
scene.add(pi.PointMass(bar.section("right"), 0.5, name="tip"))
run = pi.solve(scene.build(), 0.6, pi.GeneralizedAlpha(h=1e-3))
print(run.summary())

run.plot.deformed()

# %%
# What the hinge does to the plate, over time: it carries the weight and what turns the plate.

run.plot.reactions("hinge")
