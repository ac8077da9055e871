"""Peaucellier's inversor: seven links and ten pins that draw a straight line.

Two arms from the origin, 0.4 m, a rhombus of four bars, 0.2 m, and a crank of 0.15 m about (0.15, 0), whose circle leads through the
origin. With rigid links the product of the distances of crank pin and pen from the origin is `0.4^2 - 0.2^2` m2, so that the pen stays
on the line x = 0.4 m. Bars 0.05 m high with rounded ends and pin holes of 12 mm radius, 10 mm thick, E = 500 MPa, nu = 0.3, rho = 1200
kg/m3, viscosity 2e-6 s; the pen 0.2 kg. Gravity 9.81 m/s2 along -y. A motor turns the crank from -60 to 60 degrees within 0.5 s. The
dimensions are this project's own.
"""

import numpy as np

from polyida import profile
from polyida.body.plate import Material, Plate
from polyida.body.rigid_body import PointMass
from polyida.joint.attachment import ground
from polyida.joint.joints import AngleMotor, Revolute
from polyida.problems.levels import body_at, problem_of
from polyida.scene import Scene

ARM, BAR, CRANK = 0.4, 0.2, 0.15
HEIGHT, PIN, THICKNESS, PEN_MASS, START = 0.05, 0.012, 0.01, 0.2, -np.pi / 3
LINE = (ARM**2 - BAR**2) / (2 * CRANK)  # x of the pen, m
PLASTIC = Material(E=500e6, nu=0.3, rho=1200.0, viscosity=2e-6)
DEFAULT = (5, 40, 1)  # modes, cells, seed
T_END = 0.5


def turn():
    """How far the motor turns, rad."""
    return profile.quintic(0.0, -2 * START, duration=T_END)


def positions(angle):
    """(crank pin, upper and lower corner of the rhombus, pen), complex, m, of rigid links with the crank at an angle, rad."""
    pin = CRANK * (1 + np.exp(1j * angle))
    pen = LINE * 2 * CRANK / pin.conjugate()
    middle = (pin + pen) / 2
    side = 1j * np.sqrt(BAR**2 - abs(pen - pin) ** 2 / 4) * middle / abs(middle)
    return pin, middle + side, middle - side, pen


def peaucellier(level="full", modes=5, cells=40, seed=1, material=PLASTIC):
    """Bodies "crank", "upper arm", "lower arm", "inner upper", "inner lower", "outer upper", "outer lower"; motor "drive", mass "pen".

    Joints: "crank bearing", of each side "bearing", "crank pin", "inner pin", "outer pin", and "pen pin". level: "full", "reduced" to so
    many modes a body, or "rigid". cells: polygons of a bar; arms have twice as many.
    """
    from polyida.mesh import Link, polygonize

    body, scene = body_at(level, modes), Scene(gravity=(0.0, -9.81))
    meshes = {
        length: polygonize(Link(length, HEIGHT, PIN), cells=count, seed=seed)
        for length, count in ((CRANK, cells), (BAR, cells), (ARM, 2 * cells))
    }

    def link(name, length, start, end):
        plate = Plate(meshes[length], material, THICKNESS, origin=(start.real, start.imag), angle=np.angle(end - start), name=name)
        return scene.add(body(plate))

    pin, upper, lower, pen = positions(START)
    crank = link("crank", CRANK, CRANK + 0j, pin)
    arms = link("upper arm", ARM, 0j, upper), link("lower arm", ARM, 0j, lower)
    inner = link("inner upper", BAR, pin, upper), link("inner lower", BAR, pin, lower)
    outer = link("outer upper", BAR, upper, pen), link("outer lower", BAR, lower, pen)
    scene.add(Revolute(ground.at((CRANK, 0.0)), crank.rim(0), name="crank bearing"))
    scene.add(AngleMotor(ground, crank.rim(0), turn(), name="drive"))
    for side, arm, near, far in zip(("upper", "lower"), arms, inner, outer):
        scene.add(Revolute(ground.at((0.0, 0.0)), arm.rim(0), name=f"{side} bearing"))
        scene.add(Revolute(crank.rim(1), near.rim(0), name=f"{side} crank pin"))
        scene.add(Revolute(arm.rim(1), near.rim(1), name=f"{side} inner pin"))
        scene.add(Revolute(arm.rim(1), far.rim(0), name=f"{side} outer pin"))
    scene.add(Revolute(outer[0].rim(1), outer[1].rim(1), name="pen pin"))
    scene.add(PointMass(outer[0].rim(1), PEN_MASS, name="pen"))
    return scene


def problem(level="full", modes=5, cells=40, seed=1):
    """Peaucellier's inversor of seven flexible links, which draws a line; 0.5 s.

    level: "full", "reduced" or "rigid". The reference belongs to the default mesh and number of modes; there is none for others.
    """
    default = (modes, cells, seed) == DEFAULT
    return problem_of("peaucellier", peaucellier(level, modes, cells, seed), T_END, "pen", level, default)
