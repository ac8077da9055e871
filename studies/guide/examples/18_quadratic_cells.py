"""
Thin plates in bending: quadratic cells
=======================================

Linear cells need many of them through the thickness of a plate that bends. Quadratic cells (``order=2``) have a middle node on each side, and a
tenth of the coordinates is enough. Sides can be curved: a mesh of ``order=2`` has its middle nodes on the true boundary.
"""

import warnings

import numpy as np

import polyida as pi

STEEL = pi.Material(E=50e6, nu=0.3, rho=1100.0)


def deflection(cells, order):
    """(deflection over that of Timoshenko's beam - 1, coordinates) of a clamped plate of 50:1 under a small load at its end."""
    scene = pi.Scene()
    plate = scene.add(pi.Plate(pi.mesh.rectangle(1.0, 0.02, cells=cells, seed=1), STEEL, thickness=0.01, order=order, name="plate"))
    scene.add(pi.Clamp(plate.section("left")))
    scene.add(pi.PointLoad(plate.section("right"), (0.0, -1e-4), name="load"))
    model = scene.build()
    moved = model.displacement("load", pi.static(model).q)[1]
    inertia, area = 0.01 * 0.02**3 / 12, 0.01 * 0.02
    beam = 1e-4 / (3 * STEEL.E * inertia) + 1e-4 / (5 / 6 * area * STEEL.E / (2 * (1 + STEEL.nu)))
    return -moved / beam - 1, model.n


with warnings.catch_warnings():
    warnings.simplefilter("ignore", pi.LockingWarning)  # which says before the run that linear cells are too stiff here
    for cells, order in ((40, 1), (160, 1), (10, 2), (40, 2)):
        error, n = deflection(cells, order)
        print(f"order {order}, {cells:3d} cells, n = {n:3d}: {error:+.2%}")

# %%
# A half ring of curved cells swings; its sides are drawn as the parabolas that they are.

flat = pi.mesh.quads(1.0, 1.0, 1, 12, order=2)
radius, angle = 0.9 + 0.1 * flat.points[:, 0], np.pi * (flat.points[:, 1] - 0.5)
mesh = pi.mesh.moved(flat, radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))
print(f"area: {mesh.area / (np.pi / 2 * 0.19) - 1:+.1e} relative to the half ring")
scene = pi.Scene(gravity=(0.0, -9.81))
ring = scene.add(pi.Plate(mesh, STEEL, thickness=0.01, name="ring"))
scene.add(pi.Revolute(pi.ground, ring.section("top"), name="hinge"))
run = pi.solve(scene.build(), 0.6, pi.GeneralizedAlpha(h=2e-3))
run.plot.deformed(snapshots=3)
