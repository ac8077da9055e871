"""
How fine must this be?
======================

A number of a run has errors of its steps, its mesh and its modes. ``pi.error_of`` estimates them without a reference run, and says which step a
wanted error needs. Here a plate is turned by a motor, and the quantity is the mean square distance of its tip from a point.
"""

import numpy as np

import polyida as pi

WANTED = 1e-6  # m2: wanted error of J


def arm(cells, modes=0):
    """A full plate, or a plate in a few modes."""
    scene, material = pi.Scene(gravity=(0.0, -9.81)), pi.Material(E=50e6, nu=0.3, rho=1100.0, viscosity=1e-3)
    plate = pi.Plate(pi.mesh.rectangle(1.0, 0.25, cells=cells, seed=1), material, thickness=0.01, name="arm")
    body = scene.add(pi.Reduced(plate, modes=modes) if modes else plate)
    scene.add(pi.Revolute(pi.ground, body.section("left"), name="shoulder"))
    scene.add(pi.AngleMotor(pi.ground, body.section("left"), pi.profile.quintic(0.0, np.pi / 2, duration=0.5), name="motor"))
    scene.add(pi.PointMass(body.section("right"), 0.05, name="tip"))
    return scene.build()


J = pi.objective.Deviation("tip", (0.3, -0.1))
run = pi.solve(arm(60), 0.5, pi.GeneralizedAlpha(h=5e-3))
bars = pi.error_of(run, J)
print(bars)

# %%
# The error of time falls with h squared, that of the mesh with the number of cells.

h = bars.h_for(WANTED / 2)
cells = int(np.ceil(60 * max(1.0, abs(bars.mesh) / (WANTED / 2))))
print(f"h = {h:.1e} s, {cells} cells")

# %%
# Where the errors arise: the steps, and the polygons of the plate.

bars.plot_steps()
bars.plot_cells("arm", run.model.bodies[0].mesh)

# %%
# A plate in few modes. The error of the modes comes from a second run, in which the plate has three more fields.

for modes in (3, 5, 8, 12):
    coarse = pi.solve(arm(60, modes), 0.5, pi.GeneralizedAlpha(h=h))
    of_modes = pi.error_of(coarse, J, again=True).modes
    print(f"{modes} modes: error {of_modes:+.1e}")
    if abs(of_modes) < WANTED / 2:
        break

# %%
# The wanted error needs this step, mesh and number of modes.

print(f"h = {h:.1e} s, {cells} cells, {modes} modes")
