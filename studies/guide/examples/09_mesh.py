"""
A mesh from an outline with holes
=================================

A bell crank by the corners of its outline and of its holes, meshed by polygons: it turns about one pin, a rod holds the
second, the third is pulled. Rims of holes are held like sections.
"""

import matplotlib.pyplot as plt
import numpy as np

import polyida as pi


def ring(x, y, radius, start=0.0, end=2 * np.pi, count=24):
    angles = np.linspace(start, end, count, endpoint=end - start < 6.0)
    return np.column_stack([x + radius * np.cos(angles), y + radius * np.sin(angles)])


pins = [(-0.03, 0.15), (0.0, 0.0), (0.2, 0.0)]
corners = np.concatenate(
    [
        ring(0.0, 0.0, 0.03, np.pi, 1.5 * np.pi),
        ring(0.2, 0.0, 0.03, -0.5 * np.pi, 0.5 * np.pi),
        [(0.06, 0.03), (0.03, 0.06)],
        ring(-0.03, 0.15, 0.03, 0.0, np.pi),
    ]
)
outline = pi.mesh.Outline(corners, holes=[ring(x, y, 0.012)[:-1] for x, y in pins])
mesh = pi.mesh.polygonize(outline, cells=500, seed=2)
print(mesh.n_cells, "polygons, sections", list(mesh.sections))

fig, axes = plt.subplots(figsize=(5.2, 4.4), layout="constrained")
for a, b in mesh.edges:
    axes.plot(*mesh.points[[a, b]].T, color="C0", linewidth=0.6)
axes.set(xlabel="x, m", ylabel="y, m", aspect="equal")

# %%
# The equilibrium and its stress.

scene = pi.Scene()
crank = scene.add(pi.Plate(mesh, pi.Material(E=1e9, nu=0.35, rho=1200.0), thickness=0.01, name="crank"))
pull, pivot, rod = (crank.rim(k) for k in range(3))  # holes are counted from the left
scene.add(pi.Revolute(pi.ground, pivot, name="pivot"))
scene.add(pi.Distance(pi.ground.at((0.2, -0.1)), rod, name="rod"))
scene.add(pi.PointLoad(pull, force=(200.0, 0.0), name="pull"))
model = scene.build()
run = pi.solve(model, 1e-3, pi.GeneralizedAlpha(h=1e-4), state=pi.static(model))
print("force of the rod on the crank:", run.reaction("rod")[0].round(1), "N, by the lever 150 N")
run.plot.deformed(times=[0.0])
