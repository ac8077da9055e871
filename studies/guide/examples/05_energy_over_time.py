"""
Energy over a long run
======================

A rigid double pendulum over twenty seconds without damping. The energy-momentum method keeps the energy to round-off; the others lose or gain it at their own pace.
"""

import polyida as pi

scene = pi.Scene(gravity=(0.0, -9.81))
upper = scene.add(pi.RigidBody.bar(1.0, 1.0, name="upper"))
lower = scene.add(pi.RigidBody.bar(1.0, 1.0, origin=(1.0, 0.0), name="lower"))
scene.add(pi.Revolute(pi.ground, upper.at("left"), name="shoulder"))
scene.add(pi.Revolute(upper.at("right"), lower.at("left"), name="elbow"))

study = pi.study.energy(
    scene,
    20.0,
    integrators={
        "generalized-alpha": pi.GeneralizedAlpha(h=4e-3),
        "energy-momentum": pi.EnergyMomentum(h=4e-3),
        "IDA": pi.IDA(rtol=1e-6),
        "Radau IIA": pi.RadauIIA(rtol=1e-6),
    },
)
print(study)
axes = study.plot()
