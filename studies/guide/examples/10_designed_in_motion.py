"""
A plate designed in motion
==========================

An arm slews by 90 degrees in 0.3 s with a mass at its tip, which is to follow the path of a rigid arm. Where its material goes is found by gradients: first, with the motor held, for
the least compliance, then of the run, for the least deviation in motion. The page on plates designed in motion explains the method.
"""

import matplotlib.pyplot as plt
import nlopt
import numpy as np

import polyida as pi

VOLUME, H = 0.45, 2.5e-3
mesh = pi.mesh.rectangle(1.0, 0.25, cells=400, seed=1)
turn = pi.profile.ramp(0.0, np.pi / 2, duration=0.3)
plastic = pi.Material(E=300e6, nu=0.3, rho=1100.0)


def machine(mesh, thickness=0.01, load=None):
    """The model of the arm."""
    scene = pi.Scene()
    arm = scene.add(pi.Plate(mesh, plastic, thickness=thickness, name="arm"))
    end = arm.section(lambda p: (p[:, 0] == 1.0) & (abs(p[:, 1]) < 0.031))
    scene.add(pi.Revolute(pi.ground, arm.section("left"), name="hub"))
    scene.add(pi.AngleMotor(pi.ground, arm.section("left"), angle=turn, name="motor"))
    scene.add(pi.PointMass(end, 0.05, name="tip"))
    if load:
        scene.add(pi.PointLoad(end, load, name="load"))
    return scene.build()


# %%
# Variables become densities by a filter and a projection, and stay 1 where the hub and the mass are; densities become factors of stiffness and mass.

blur, share = pi.mesh.density_filter(mesh, radius=0.03), mesh.cell_areas / mesh.area
x, y = mesh.cell_centroids.T
free = (x > 0.03) & ((x < 0.97) | (abs(y) > 0.045))


def densities(x, beta):
    rho, rate = pi.design.project(blur @ x, beta)
    return np.where(free, rho, 1.0), np.where(free, rate, 0.0)


def least(x, model, judge, beta, q, evaluations):
    """Variables after so many evaluations by MMA, and the values on the way; judge(model): a gradient."""
    history = []

    def objective(x, slope):
        rho, rate = densities(x, beta)
        (stiffness, hardening), (mass, growing) = pi.design.ramp(rho, q), pi.design.mass(rho)
        found = judge(model.with_factors(arm=(stiffness, mass)))
        history.append(found.value)
        slope[:] = blur.T @ (rate * (found["arm.stiffness"] * hardening + found["arm.mass"] * growing)) / found.value
        return np.log(found.value)

    def volume(x, slope):
        rho, rate = densities(x, beta)
        slope[:] = blur.T @ (share * rate)
        return share @ rho - VOLUME

    mma = nlopt.opt(nlopt.LD_MMA, len(x))
    mma.set_lower_bounds(0.0), mma.set_upper_bounds(1.0), mma.set_maxeval(evaluations)
    mma.set_min_objective(objective), mma.add_inequality_constraint(volume, 1e-6)
    return mma.optimize(x), history


# %%
# At rest, the motor held, under a load on the tip: what compliance wants.

held, names = machine(mesh, load=(0.0, -1.0)), ["arm.stiffness", "arm.mass"]


def at_rest(model):
    return pi.gradient(pi.static(model, linear=True), pi.objective.Compliance(), names)


x = np.full(mesh.n_cells, VOLUME)
for q, beta in ((5, 1), (10, 4), (20, 8)):
    x, compliance = least(x, held, at_rest, beta, q, evaluations=14)
print(f"compliance: {compliance[-1]:.3g} J")

# %%
# In motion, from there.

path = pi.objective.Deviation("tip", lambda t: np.array([np.cos(turn.at(t)[0]), np.sin(turn.at(t)[0])]))


def in_motion(model):
    return pi.gradient(pi.solve(model, 0.5, pi.GeneralizedAlpha(h=H, tolerance=1e-6)), path, names)


x, deviation = least(x, machine(mesh), in_motion, 16, 20, evaluations=20)
print(f"mean square deviation on densities: {deviation[0]:.3g} -> {deviation[-1]:.3g} m2")

# %%
# What is solid, moved again beside the whole plate, both of the same mass.

solid = pi.design.threshold(mesh, densities(x, 16)[0], at=0.25, keep=["left"], hanging="leave out")
fig, (shape, motion) = plt.subplots(2, 1, figsize=(6.4, 4.6), layout="constrained")
solid.plot(axes=shape).set_title("designed in motion", loc="right")
for name, plate in (("the whole plate, thinner", mesh), ("designed in motion", solid)):
    run = pi.solve(machine(plate, thickness=0.01 * VOLUME * mesh.area / plate.area), 0.5, pi.GeneralizedAlpha(h=1e-3))
    off = run.position("tip") - np.array([[np.cos(turn.at(t)[0]), np.sin(turn.at(t)[0])] for t in run.t])
    motion.plot(run.t, 1e3 * np.hypot(*off.T), label=f"{name}: {path(run):.3g} m²")
motion.set(xlabel="t, s", ylabel="deviation of the tip, mm")
motion.legend(loc="center right")
