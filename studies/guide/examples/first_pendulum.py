"""
A plate on a hinge
==================

One flexible plate, meshed with polygons, falls from rest about a hinge at its left edge.
"""

import matplotlib.pyplot as plt

import polyida as pi

mesh = pi.mesh.rectangle(1.0, 0.1, cells=60, seed=1)
rubber = pi.Material(E=50e6, nu=0.3, rho=1100.0)
scene = pi.Scene(gravity=(0.0, -9.81))
bar = scene.add(pi.Plate(mesh, rubber, thickness=0.01, name="bar"))
scene.add(pi.Revolute(pi.ground, bar.section("left"), name="hinge"))
scene.add(pi.PointMass(bar.section("right"), 0.5, name="tip"))
run = pi.solve(scene.build(), 0.5, pi.GeneralizedAlpha(h=1e-3))

plt.plot(*run.position("tip").T)
plt.gca().set(xlabel="x in m", ylabel="y in m", aspect="equal", title="Path of the tip")
