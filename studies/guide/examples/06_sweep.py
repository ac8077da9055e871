"""
A sweep over the stiffness
==========================

The same plate from soft to stiff: how far its tip is from that of a rigid one, at most, in three tenths of a second. A case is a dictionary, a row is what came of it.
"""

import matplotlib.pyplot as plt
import numpy as np

import polyida as pi


def case(stiffness):
    plate = pi.Plate(
        pi.mesh.rectangle(1.0, 0.1, cells=40, seed=1), pi.Material(E=stiffness, nu=0.3, rho=1100.0), thickness=0.01, name="bar"
    )
    paths = []
    for body in (plate, pi.Rigid(plate)):
        scene = pi.Scene(gravity=(0.0, -9.81))
        bar = scene.add(body)
        scene.add(pi.Revolute(pi.ground, bar.section("left")))
        scene.add(pi.PointMass(bar.section("right"), 0.1, name="tip"))
        paths.append(pi.solve(scene.build(), 0.3, pi.GeneralizedAlpha(h=5e-4)).position("tip"))
    return {"gap": float(np.linalg.norm(paths[0] - paths[1], axis=1).max())}


study = pi.study.sweep(case, [{"stiffness": float(E)} for E in np.geomspace(1e7, 1e11, 9)])
frame = study.to_dataframe()
print(frame[["stiffness", "gap", "cpu_s"]])

fig, axes = plt.subplots(figsize=(6.0, 3.6), layout="constrained")
axes.loglog(frame.stiffness, frame.gap, "o-")
axes.loglog(frame.stiffness, 0.6 * frame.gap[0] * frame.stiffness[0] / frame.stiffness, "--", color="grey", label="as 1 / E")
axes.set(xlabel="Young's modulus, Pa", ylabel="distance of the tips, m")
axes.legend()
