"""
A flexible bar that bounces
===========================

An elastic bar falls on the floor. While a wave runs up the bar and back, the floor carries the force `rho c A g t` (Doyen, Ern, Piperno, SIAM
J. Sci. Comput. 33 (2011) 223-249). An impact annuls the kinetic energy of the nodes that touch; `contact_mass=0.1` makes them light.
"""

import matplotlib.pyplot as plt
import numpy as np

import polyida as pi

length, height, E, rho, g, cells = 1.0, 0.1, 30e6, 1000.0, 10.0, 40
fall, thickness, wave = 1.5e-3, 0.01, np.sqrt(30e6 / 1000.0)
hit = np.sqrt(2.0 * fall / g)


def bounce(contact_mass):
    """The run up to the second impact, in steps in which a wave passes half a cell."""
    scene = pi.Scene(gravity=(-g, 0.0))
    mesh = pi.mesh.rectangle(length, height, cells=4 * cells, seed=1)
    bar = scene.add(pi.Plate(mesh, pi.Material(E=E, nu=0.0, rho=rho), thickness, origin=(fall, 0.0), name="bar"))
    floor = pi.ground.at((0.0, 0.0), direction=(0.0, -1.0))
    scene.add(pi.Contact(bar.section("left"), floor, contact_mass=contact_mass, name="floor"))
    run = pi.solve(scene.build(), 11 / 3 * hit, pi.NonsmoothAlpha(h=0.5 * length / cells / wave, rho_inf=0.5))
    return run, run.position(bar.section("left"))[:, 0]


def exact_bottom(t):
    """The lower end: the jump of its velocity by -4/3 g hit repeats each time the wave returns."""
    s = t / hit
    k, part = np.divmod(np.maximum(s - 5 / 3, 0.0), 2 / 3)
    behind = (4 * k - 2 * k * (k - 1)) / 9 + (1 - 2 * k) / 3 * part + part * part / 2
    return np.where(s < 1, fall - 0.5 * g * t**2, np.where(s < 5 / 3, 0.0, g * hit**2 * behind))


fig, (place, force, energy) = plt.subplots(1, 3, figsize=(8.4, 4.4), layout="constrained")
scale = 0.5 * rho * length * height * thickness * 2 * g * fall
for share, color in ((1.0, "tab:orange"), (0.1, "tab:blue")):
    run, bottom = bounce(share)
    place.plot(run.t / hit, 1e3 * bottom, color=color, label=f"contact_mass = {share}")
    force.plot(run.t / hit, np.abs(run.reaction("floor")[:, 0]), color=color)
    energy.plot(run.t / hit, 100 * (run.energy.total - run.energy.total[0]) / scale, color=color)
    print(f"contact_mass = {share}: energy changes by {100 * (run.energy.total[-1] - run.energy.total[0]) / scale:.2f} %")
t = np.linspace(0.0, 11 / 3, 1000) * hit
place.plot(t / hit, 1e3 * exact_bottom(t), "k--", lw=1, label="exact")
inside = (t > hit) & (t < 5 / 3 * hit)
force.plot(t / hit, np.where(inside, rho * wave * height * thickness * g * t, 0.0), "k--", lw=1)
place.set(xlabel="t / time of the fall", ylabel="lower end, mm")
force.set(xlabel="t / time of the fall", ylabel="force of the floor, N")
energy.set(xlabel="t / time of the fall", ylabel="energy, % of the fall's")
place.legend()
