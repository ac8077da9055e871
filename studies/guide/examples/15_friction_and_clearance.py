"""
A slider crank with friction and clearance
==========================================

The slider rubs in its guide, and the pin of the slider has a clearance of 0.5 mm: the pin flies, hits its hole and slides on it.
"""

import matplotlib.pyplot as plt
import numpy as np

import polyida as pi

crank_length, rod_length, angle, spin = 0.1, 0.3, 1.0, 20.0
tilt = -np.arcsin(crank_length / rod_length * np.sin(angle))
pin = crank_length * np.array([np.cos(angle), np.sin(angle)])
along = rod_length * np.array([np.cos(tilt), np.sin(tilt)])


def build(clearance, friction=0.2):
    """The scene; the crank turns with 20 rad/s, the rod and the slider move with it."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    velocity, turn = spin * np.array([-pin[1], pin[0]]), -spin * pin[0] / along[0]
    across = np.array([-along[1], along[0]])
    crank = scene.add(pi.RigidBody.bar(crank_length, 0.2, angle=angle, velocity=velocity / 2, spin=spin, name="crank"))
    rod = scene.add(pi.RigidBody.bar(rod_length, 0.3, pin, tilt, velocity=velocity + turn / 2 * across, spin=turn, name="rod"))
    speed, place = ((velocity + turn * across)[0], 0.0), ((pin + along)[0], 0.0)
    slider = scene.add(pi.RigidBody(mass=0.5, inertia=1e-3, points={"c": (0.0, 0.0)}, origin=place, velocity=speed, name="slider"))
    scene.add(pi.AngleMotor(pi.ground, crank.at("left"), pi.profile.polynomial([0.0, spin]), name="drive"))
    scene.add(pi.Revolute(pi.ground, crank.at("left"), name="bearing"))
    scene.add(pi.Revolute(crank.at("right"), rod.at("left"), name="crank pin"))
    if clearance:
        scene.add(pi.Clearance(slider.at("c"), rod.at("right"), gap=clearance, restitution=0.5, name="slider pin"))
    else:
        scene.add(pi.Revolute(rod.at("right"), slider.at("c"), name="slider pin"))
    scene.add(pi.Prismatic(pi.ground.at((0.0, 0.0)), slider.at("c"), friction=friction, name="guide"))
    return scene


fig, (force, orbit, guide) = plt.subplots(1, 3, figsize=(8.4, 4.4), layout="constrained", width_ratios=[1.4, 1.0, 1.4])
for clearance, color in ((5e-4, "tab:orange"), (0.0, "tab:blue")):
    scene = build(clearance)
    run = pi.solve(scene.build(), 0.35, pi.NonsmoothAlpha(h=2.5e-4))
    reaction = np.hypot(*run.reaction("slider pin").T)
    force.plot(run.t, reaction, color=color, lw=0.8, label=f"clearance of {1e3 * clearance:g} mm")
    if clearance:
        print(run.events)
        way = run.position(scene.parts["rod"].at("right")) - run.position(scene.parts["slider"].at("c"))
        pressed = reaction > 0.0
        orbit.plot(*1e3 * way[pressed].T, ".", ms=2, color="tab:red", label="in contact")
        orbit.plot(*1e3 * way[~pressed].T, ".", ms=2, color="tab:grey", label="flies")
    else:
        rubbing = run.lam[:, run.model.rows["guide"]]
        guide.plot(run.t, rubbing[:, 2], color=color, label="friction")
        guide.plot(run.t, 0.2 * np.abs(rubbing[:, 0]), "k--", lw=0.8, label="its bound, 0.2 times the pressure")
        guide.plot(run.t, -0.2 * np.abs(rubbing[:, 0]), "k--", lw=0.8)
force.set(xlabel="t, s", ylabel="force in the pin, N", yscale="symlog")
orbit.set(xlabel="pin in its hole, mm", ylabel="mm", aspect="equal")
guide.set(xlabel="t, s", ylabel="force in the guide, N")
for axes in (force, orbit, guide):
    axes.legend(fontsize="small")
