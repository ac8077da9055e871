"""Two-link arm: motors in shoulder and elbow fold it within 0.4 s; then it rings.

Links 0.5 m x 0.04 m, 10 mm thick, E = 2 GPa, nu = 0.3, rho = 1200 kg/m3, viscosity 2e-6 s; payload 0.3 kg. It starts stretched along
+x, at rest; quintics turn the shoulder by +90 and the elbow by -120 degrees. Gravity 9.81 m/s2 along -y. The dimensions are this
project's own.
"""

import numpy as np

from polyida import profile
from polyida.body.plate import Material, Plate
from polyida.body.rigid_body import PointMass
from polyida.joint.attachment import ground
from polyida.joint.joints import AngleMotor, Revolute
from polyida.problems.levels import body_at, problem_of
from polyida.scene import Scene

LENGTH, HEIGHT, THICKNESS, PAYLOAD, FOLDED = 0.5, 0.04, 0.01, 0.3, 0.4
TURNS = {"shoulder": np.pi / 2, "elbow": -2 * np.pi / 3}
PLASTIC = Material(E=2e9, nu=0.3, rho=1200.0, viscosity=2e-6)
DEFAULT = (5, 40, 1)  # modes, cells, seed
T_END = 0.5


def turn(joint):
    """The angle of a joint's motor, rad, a profile."""
    return profile.quintic(0.0, TURNS[joint], duration=FOLDED)


def two_link_arm(level="full", modes=5, cells=40, seed=1, material=PLASTIC):
    """Bodies "upper arm" and "forearm", joints "shoulder" and "elbow" with motors "shoulder motor" and "elbow motor", mass "tip".

    level: "full", "reduced" to so many modes a body, or "rigid". cells: polygons a link.
    """
    from polyida.mesh import rectangle

    body, mesh, scene = body_at(level, modes), rectangle(LENGTH, HEIGHT, cells=cells, seed=seed), Scene(gravity=(0.0, -9.81))
    upper = scene.add(body(Plate(mesh, material, THICKNESS, name="upper arm")))
    fore = scene.add(body(Plate(mesh, material, THICKNESS, origin=(LENGTH, 0.0), name="forearm")))
    for name, a, b in (("shoulder", ground, upper.section("left")), ("elbow", upper.section("right"), fore.section("left"))):
        scene.add(Revolute(a, b, name=name))
        scene.add(AngleMotor(a, b, turn(name), name=f"{name} motor"))
    scene.add(PointMass(fore.section("right"), PAYLOAD, name="tip"))
    return scene


def problem(level="full", modes=5, cells=40, seed=1):
    """Arm of two flexible links, folded by motors within 0.4 s; 0.5 s.

    level: "full", "reduced" or "rigid". The reference belongs to the default mesh and number of modes; there is none for others.
    """
    default = (modes, cells, seed) == DEFAULT
    return problem_of("two-link-arm", two_link_arm(level, modes, cells, seed), T_END, "tip", level, default)
