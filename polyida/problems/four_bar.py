"""Four-bar: a motor turns the crank once; the coupler swings a rocker.

Links with rounded ends and pin holes of 6 mm radius, pin to pin 0.1 m (crank), 0.3 m (coupler), 0.25 m (rocker), 0.03 m high, 10 mm
thick, E = 500 MPa, nu = 0.3, rho = 1200 kg/m3, viscosity 2e-6 s; bearings at (0, 0) and (0.3, 0). A mass of 0.2 kg sits on the pin of
coupler and rocker. Gravity 9.81 m/s2 along -y. The motor turns the crank by a quintic from 60 degrees through a whole turn within 0.5
s. The dimensions are this project's own.

With rigid links Freudenstein's equation gives the rocker's angle, `positions` solves it.
"""

import numpy as np

from polyida import profile
from polyida.body.plate import Material, Plate
from polyida.body.rigid_body import PointMass
from polyida.joint.attachment import ground
from polyida.joint.joints import AngleMotor, Revolute
from polyida.problems.levels import body_at, problem_of
from polyida.scene import Scene

CRANK, COUPLER, ROCKER, FRAME = 0.1, 0.3, 0.25, 0.3
HEIGHT, PIN, THICKNESS, PIN_MASS, START = 0.03, 0.006, 0.01, 0.2, np.pi / 3
PLASTIC = Material(E=500e6, nu=0.3, rho=1200.0, viscosity=2e-6)
DEFAULT = (5, 70, 1)  # modes, cells, seed
T_END = 0.5


def turn():
    """How far the motor turns, rad."""
    return profile.quintic(0.0, 2 * np.pi, duration=T_END)


def positions(angle):
    """(crank pin, rocker pin), complex, m, of rigid links with the crank at an angle, rad."""
    crank = CRANK * np.exp(1j * np.asarray(angle, float))
    across = FRAME - crank
    along = (abs(across) ** 2 + COUPLER**2 - ROCKER**2) / (2 * abs(across))
    return crank, crank + (along + 1j * np.sqrt(COUPLER**2 - along**2)) * across / abs(across)


def four_bar(level="full", modes=5, cells=70, seed=1, material=PLASTIC):
    """Bodies "crank", "coupler" and "rocker", joints "bearing", "crank pin", "rocker pin", "support", motor "drive", mass "pin".

    level: "full", "reduced" to so many modes a body, or "rigid". cells: polygons of the coupler; the others have as fine ones. The links
    are drawn by hand and assembled.
    """
    from polyida.mesh import Link, polygonize

    body, scene = body_at(level, modes), Scene(gravity=(0.0, -9.81))

    def link(name, length, share, origin, angle):
        mesh = polygonize(Link(length, HEIGHT, PIN), cells=round(share * cells), seed=seed)
        return scene.add(body(Plate(mesh, material, THICKNESS, origin=origin, angle=angle, name=name)))

    crank = link("crank", CRANK, 0.5, (0.0, 0.0), START)
    coupler = link("coupler", COUPLER, 1.0, (0.05, 0.09), 0.56)
    rocker = link("rocker", ROCKER, 0.9, (FRAME, 0.0), 1.57)
    scene.add(Revolute(ground.at((0.0, 0.0)), crank.rim(0), name="bearing"))
    scene.add(AngleMotor(ground, crank.rim(0), turn(), name="drive"))
    scene.add(Revolute(crank.rim(1), coupler.rim(0), name="crank pin"))
    scene.add(Revolute(coupler.rim(1), rocker.rim(1), name="rocker pin"))
    scene.add(Revolute(ground.at((FRAME, 0.0)), rocker.rim(0), name="support"))
    scene.add(PointMass(coupler.rim(1), PIN_MASS, name="pin"))
    scene.assemble()
    return scene


def problem(level="full", modes=5, cells=70, seed=1):
    """Four-bar of flexible links with pin holes, its crank turned once within 0.5 s.

    level: "full", "reduced" or "rigid". The reference belongs to the default mesh and number of modes; there is none for others.
    """
    default = (modes, cells, seed) == DEFAULT
    return problem_of("four-bar", four_bar(level, modes, cells, seed), T_END, "pin", level, default)
