"""
Equilibrium and modes
=====================

A clamped plate hangs under its weight; small vibrations about that state, beside those of the plate as drawn.
"""

import matplotlib.pyplot as plt

import polyida as pi

mesh = pi.mesh.rectangle(1.0, 0.1, cells=160, seed=1)
scene = pi.Scene(gravity=(0.0, -9.81))
bar = scene.add(pi.Plate(mesh, pi.Material(E=20e6, nu=0.3, rho=1100.0), thickness=0.01, name="bar"))
scene.add(pi.Clamp(bar.section("left"), name="clamp"))
model = scene.build()

rest = pi.static(model)
modes = pi.modes(model, state=rest, count=3)
print(modes.summary())
print("as drawn:", pi.modes(model, count=3).frequencies.round(3), "Hz")

# %%
# Each shape, made larger, on the plate at rest under its weight.

fig, panels = plt.subplots(3, 1, figsize=(6.4, 5.4), sharex=True, sharey=True, layout="constrained")
hanging = mesh.points + rest.q.reshape(-1, 2)
for axes, shape, frequency in zip(panels, modes.shapes, modes.frequencies):
    moved = hanging + 0.15 * (shape / abs(shape).max()).real.reshape(-1, 2)
    for points, colour in ((hanging, "silver"), (moved, "C0")):
        for a, b in mesh.edges:
            axes.plot(*points[[a, b]].T, color=colour, linewidth=0.6)
    axes.set(title=f"{frequency:.2f} Hz", aspect="equal", ylabel="y, m")
panels[-1].set_xlabel("x, m")
