"""
A mesh with holes
=================

A link with two pins: a domain by its signed distance, meshed by polygons; the rims of the holes are held and loaded like sections.
"""

import matplotlib.pyplot as plt

import polyida as pi

mesh = pi.mesh.polygonize(pi.mesh.Link(length=0.3, height=0.08, pin_radius=0.02), cells=400, seed=3)
print(mesh.n_cells, "polygons, area", round(mesh.area, 6), "m2, sections", list(mesh.sections))

fig, axes = plt.subplots(figsize=(6.4, 2.2), layout="constrained")
for a, b in mesh.edges:
    axes.plot(*mesh.points[[a, b]].T, color="C0", linewidth=0.6)
axes.set(xlabel="x, m", ylabel="y, m", aspect="equal")

# %%
# One pin is clamped, the other loaded; the equilibrium and its stress.

scene = pi.Scene()
link = scene.add(pi.Plate(mesh, pi.Material(E=1e9, nu=0.35, rho=1200.0), thickness=0.01, name="link"))
scene.add(pi.Clamp(link.rim(0), name="left pin"))
scene.add(pi.PointLoad(link.rim(1), force=(0.0, -150.0), name="load"))
model = scene.build()
run = pi.solve(model, 1e-3, pi.GeneralizedAlpha(h=1e-4), state=pi.static(model))
run.plot.deformed(times=[0.0])
