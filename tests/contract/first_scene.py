"""What a user writes first: the paper's double plate, solved by both integrators.

rectangle(1.0, 0.1) spans 0 <= x <= 1 and -0.05 <= y <= 0.05; its sections are left, right, top, bottom;
origin places it.
"""

import numpy as np

import polyida as pi

material = pi.Material(E=50e6, nu=0.3, rho=1100.0)
mesh = pi.mesh.rectangle(1.0, 0.1, cells=160, seed=1)

scene = pi.Scene(gravity=(0.0, -9.81))
upper = scene.add(pi.Plate(mesh, material, thickness=0.01, name="upper"))
lower = scene.add(pi.Plate(mesh, material, thickness=0.01, origin=(1.0, 0.0), name="lower"))
scene.add(pi.Revolute(pi.ground, upper.section("left"), name="shoulder"))
scene.add(pi.Revolute(upper.section("right"), lower.section("left"), name="elbow"))
scene.add(pi.PointMass(lower.section("right"), 0.5, name="tip"))
model = scene.build()

alpha = pi.solve(model, 0.5, pi.GeneralizedAlpha(h=1e-3, rho_inf=0.9))
ida = pi.solve(model, 0.5, pi.IDA(rtol=1e-6, atol=1e-8))
for run in (alpha, ida):
    assert run.success, run.message
    print(run.summary())

gap = np.linalg.norm(alpha.position("tip")[-1] - ida.position("tip")[-1])
print(f"tip gap between the integrators {gap:.2e} m, alpha {alpha.position('tip')[-1]}")
assert gap < 5e-4
assert alpha.drift.max() < 1e-9 and ida.drift.max() < 1e-7  # |phi|, m
assert abs(alpha.energy.total[-1] - alpha.energy.total[0]) < 0.05  # J

alpha.save("first_scene.h5", overwrite=True)
again = pi.load("first_scene.h5")
assert np.array_equal(again.q, alpha.q)

# the second scene: the same angle at each joint
turn = pi.profile.quintic(0.0, np.pi / 4, duration=1.0)
scene.add(pi.AngleMotor(pi.ground, upper.section("left"), angle=turn, name="shoulder motor"))
scene.add(pi.AngleMotor(upper.section("right"), lower.section("left"), angle=turn, name="elbow motor"))
driven = pi.solve(scene.build(), 1.0, pi.GeneralizedAlpha(h=1e-3, rho_inf=0.9))
assert driven.success, driven.message
print(driven.summary(), driven.position("tip")[-1], driven.reaction("elbow motor")[-1])
