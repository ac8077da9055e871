"""
A flexible arm from its noisy tip
=================================

An arm on a motor is turned by a quarter of a right angle and vibrates. Its modulus and the viscosity of its material follow from the measured
tip, here a run with noise of 1 mm, by `pi.fit`.
"""

import matplotlib.pyplot as plt
import numpy as np

import polyida as pi

times = np.linspace(0.0, 1.0, 101)
mesh = pi.mesh.quads(1.0, 0.03, 6, 1, order=2)


def tip(modulus, viscosity):
    """Height of the tip at the times, m; modulus in GPa."""
    scene = pi.Scene()
    material = pi.Material(E=1e9 * modulus, nu=0.3, rho=1200.0, viscosity=viscosity)
    arm = scene.add(pi.Plate(mesh, material, thickness=0.02, name="arm"))
    root = arm.section("left")
    scene.add(pi.Revolute(pi.ground, root))
    scene.add(pi.AngleMotor(pi.ground, root, pi.profile.quintic(0.0, np.pi / 8, duration=0.2)))
    scene.add(pi.PointMass(arm.section("right"), 0.2, name="tip"))
    return pi.solve(scene.build(), 1.0, pi.GeneralizedAlpha(h=5e-3), output=times).position("tip")[:, 1]


measured = tip(1.3, 2e-3) + 1e-3 * np.random.default_rng(0).standard_normal(len(times))
found = pi.fit(tip, measured, {"modulus": 1.0, "viscosity": 1e-3}, bounds={"modulus": (0.1, 10.0), "viscosity": (0.0, 0.1)})
print(found.summary())
print("correlation", found.correlation.round(3).tolist())
assert abs(found.values["modulus"] - 1.3) < 4.0 * found.errors["modulus"]
found.plot()
plt.show()
