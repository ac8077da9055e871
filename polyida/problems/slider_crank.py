"""Slider crank: a torque turns the crank, whose rod pushes a mass along a rail.

Crank 0.15 m x 0.03 m, rod 0.3 m x 0.02 m, both 10 mm thick, E = 2 GPa, nu = 0.3, rho = 1200 kg/m3, viscosity 2e-6 s; slider 0.5 kg. The
crank starts upright and at rest; its torque grows to 0.8 N m within 0.1 s. Gravity 9.81 m/s2 along -y. With rigid links and the crank
at an angle a from the rail the slider is at `r cos a + sqrt(l^2 - r^2 sin(a)^2)`. The dimensions are this project's own.
"""

import numpy as np

from polyida import profile
from polyida.body.plate import Material, Plate
from polyida.body.rigid_body import PointMass
from polyida.force.elements import Torque
from polyida.joint.attachment import ground
from polyida.joint.joints import Revolute, Slot
from polyida.problems.levels import body_at, problem_of
from polyida.scene import Scene

CRANK, ROD, THICKNESS, SLIDER_MASS = 0.15, 0.3, 0.01, 0.5
PLASTIC = Material(E=2e9, nu=0.3, rho=1200.0, viscosity=2e-6)
DEFAULT = (5, 40, 1)  # modes, cells, seed
T_END = 0.4


def slider_crank(level="full", modes=5, cells=40, seed=1, material=PLASTIC):
    """Bodies "crank" and "rod", joints "bearing", "crank pin" and "rail", mass "slider", torque "drive".

    level: "full", "reduced" to so many modes a body, or "rigid". cells: polygons of the rod; the crank has as fine ones.
    """
    from polyida.mesh import rectangle

    body, scene = body_at(level, modes), Scene(gravity=(0.0, -9.81))
    short, long = rectangle(CRANK, 0.03, cells=-(-3 * cells // 4), seed=seed), rectangle(ROD, 0.02, cells=cells, seed=seed)
    crank = scene.add(body(Plate(short, material, THICKNESS, angle=np.pi / 2, name="crank")))
    rod = scene.add(body(Plate(long, material, THICKNESS, origin=(0.0, CRANK), angle=-np.arcsin(CRANK / ROD), name="rod")))
    scene.add(Revolute(ground.at((0.0, 0.0)), crank.section("left"), name="bearing"))
    scene.add(Revolute(crank.section("right"), rod.section("left"), name="crank pin"))
    scene.add(Slot(ground.at((0.0, 0.0)), rod.section("right"), name="rail"))
    scene.add(PointMass(rod.section("right"), SLIDER_MASS, name="slider"))
    scene.add(Torque(crank.section("left"), profile.quintic(0.0, 0.8, duration=0.1), name="drive"))
    return scene


def problem(level="full", modes=5, cells=40, seed=1):
    """Slider crank of two flexible links, driven by a torque for 0.4 s.

    level: "full", "reduced" or "rigid". The reference belongs to the default mesh and number of modes; there is none for others.
    """
    default = (modes, cells, seed) == DEFAULT
    return problem_of("slider-crank", slider_crank(level, modes, cells, seed), T_END, "slider", level, default)
