"""An elastic bar of polygons falls on the floor and bounces, against the exact solution of the wave equation.

Doyen, Ern, Piperno, SIAM J. Sci. Comput. 33 (2011) 223-249, with a fall of 1.5 mm instead of half the length: strains are small.
"""

from time import process_time

import numpy as np

import polyida as pi

LENGTH, G, E, RHO, THICK = 1.0, 10.0, 30e6, 1000.0, 0.01  # m, m/s^2, Pa, kg/m^3, m
SPEED = np.sqrt(E / RHO)
FALL = 1.5e-3 * LENGTH  # m; the contact then lasts 2/3 of the time of the fall
HIT = np.sqrt(2.0 * FALL / G)  # s
LEAVES, RETURNS = HIT * 5.0 / 3.0, HIT * 11.0 / 3.0  # s
END = HIT * (1.0 + 4.0 * 8.0 / 3.0)  # s, four periods
BESIDE = 0.05 * HIT  # s: on both sides of the jumps of the force, where the mesh cannot follow; its error leaves that out


def exact_force(t, width):
    """Force of the floor, N: `rho c A g t` while the wave runs up and back."""
    t = np.asarray(t, float)
    return np.where((t > HIT) & (t < LEAVES), RHO * SPEED * width * THICK * G * t, 0.0)


def exact_bottom(t):
    """Height of the bar's lower end up to RETURNS, m."""
    s = np.asarray(t, float) / HIT
    k, part = np.divmod(np.maximum(s - 5.0 / 3.0, 0.0), 2.0 / 3.0)  # the velocity jumps by -4/3 g HIT each time the wave returns
    behind = (4.0 * k - 2.0 * k * (k - 1.0)) / 9.0 + (1.0 - 2.0 * k) / 3.0 * part + part * part / 2.0
    return np.where(s < 1.0, FALL - 0.5 * G * (s * HIT) ** 2, np.where(s < 5.0 / 3.0, 0.0, G * HIT**2 * behind))


def bouncing_bar(cells=40, across=2, contact_mass=1.0):
    """(Scene, width): a plate of polygons along x, `cells` along its length and some across, falls along -x; its contact is "floor", its lower
    end "bottom".
    """
    width = across * LENGTH / cells
    scene = pi.Scene(gravity=(-G, 0.0))
    mesh = pi.mesh.rectangle(LENGTH, width, across * cells, seed=1)
    bar = scene.add(pi.Plate(mesh, pi.Material(E=E, nu=0.0, rho=RHO), THICK, origin=(FALL, 0.0), name="bar"))
    floor = pi.ground.at((0.0, 0.0), direction=(0.0, -1.0))
    scene.add(pi.Contact(bar.section("left"), floor, contact_mass=contact_mass, name="floor"))
    scene.add(pi.PointMass(bar.section("left"), 1e-12, name="bottom"))
    return scene, width


def measure(cells, courant, rho_inf, across=2, contact_mass=1.0):
    """Errors of bottom, force and contact times in the first period, and the energy behind it and behind four."""
    scene, width = bouncing_bar(cells, across, contact_mass)
    model, h = scene.build(), courant * LENGTH / cells / SPEED
    begin = process_time()
    run = pi.solve(model, END, pi.NonsmoothAlpha(h=h, rho_inf=rho_inf))
    row = {"cpu_s": process_time() - begin, "steps": run.counts.steps, "n": model.n, "h": h}
    if not run.success:
        return row | {"outcome": run.message}
    scale, total = 0.5 * RHO * LENGTH * width * THICK * 2.0 * G * FALL, run.energy.total
    energy, behind = (total - total[0]) / scale, run.t > LEAVES
    first = run.t <= RETURNS
    force, bottom, t = np.abs(run.reaction("floor")[first, 0]), run.position("bottom")[first, 0], run.t[first]
    right = exact_force(t - h / 2, width)
    inside = (t > HIT + BESIDE) & (t < LEAVES - BESIDE)
    pressed = t[force > 0.05 * right.max()]
    return row | {
        "outcome": "done",
        "touches_off": float(pressed[0] / HIT - 1.0),
        "leaves_off": float(pressed[pressed < 0.5 * (LEAVES + RETURNS)][-1] / LEAVES - 1.0),
        "force_rms": float(np.sqrt(np.mean((force - right)[inside] ** 2) / np.mean(right[inside] ** 2))),
        "bottom_off": float(np.abs(bottom - exact_bottom(t)).max() / FALL),
        "energy_change": float(energy[behind][0]),
        "energy_of_four": float(energy[-1]),
        "energy_gain": float(energy.max()),
        "t": t,
        "force": force / right.max(),
        "bottom": bottom / FALL,
    }
