"""Four mechanisms of plates, each with full, reduced or rigid bodies: slider crank, four-bar, two-link arm, Peaucellier's inversor.

Plates are 10 mm thick, nu = 0.3, rho = 1200 kg/m3, viscosity 2e-6 s; gravity 9.81 m/s2 along -y. The dimensions are this project's own.

The digits are those of the semi-discrete equations on the default mesh, or in the default modes: space is not converged. `python
studies/digits.py slider-crank four-bar two-link-arm peaucellier` computes them by DOP853 on the index-1 equations, rtol 1e-8 or 1e-9 (1e-12
with rigid bodies), projected onto the constraints 31 times. Their accuracy is the distance of Radau IIA on the stabilised form, rtol 1e-12.
"""

import numpy as np

from polyida import profile
from polyida.body.plate import Material, Plate
from polyida.body.reduced import Reduced
from polyida.body.rigid_body import PointMass, Rigid
from polyida.errors import InputError
from polyida.force.loads import Torque
from polyida.joint.attachment import ground
from polyida.joint.joints import AngleMotor, Revolute, Slot
from polyida.problems import ABOUT, Problem, point_measures
from polyida.scene import Scene
from polyida.validation import is_one_of

DIGITS = {  # problem: level: (place, its accuracy, velocity, its accuracy) of the named point at the end, m and m/s
    "slider-crank": {
        "full": ([0.1516796348989, 0.0], 3.3e-12, [1.494136572194, 0.0], 1.1e-09),
        "reduced": ([0.1516681306015, 0.0], 3.1e-12, [1.473735277772, 0.0], 8.5e-10),
        "rigid": ([0.1609723356128, 0.0], 1e-13, [3.530063026946, 0.0], 1.9e-12),
    },
    "four-bar": {
        "full": ([0.3012870667844, 0.2500202806983], 1.4e-13, [-0.01118864391707, -0.0007606081537401], 9.1e-11),
        "reduced": ([0.3012876011814, 0.250020917368], 1.6e-13, [-0.009154770620571, -0.002163486162461], 7e-10),
        "rigid": ([0.3016007650437, 0.24999487505], 1e-13, [0.0, 0.0], 1e-13),
    },
    "two-link-arm": {
        "full": ([0.4393735295091, 0.267900295898], 8.3e-13, [-0.009720147784984, 1.732987914593], 3.3e-10),
        "reduced": ([0.4393721180096, 0.2679038027252], 1.1e-12, [-0.009905561857127, 1.732883595664], 2.3e-09),
        "rigid": ([0.4330127018922, 0.25], 1e-13, [0.0, 0.0], 1e-13),
    },
    "peaucellier": {
        "full": ([0.3999788697042, 0.2295832772432], 2.8e-13, [0.001653718811887, 0.1074716582483], 5.1e-10),
        "reduced": ([0.3999789811125, 0.2295878727859], 2e-13, [0.001344262013922, 0.1073126543056], 4.7e-10),
        "rigid": ([0.4, 0.2309401076758], 1e-13, [0.0, 0.0], 1e-13),
    },
}
LEVELS = ("full", "reduced", "rigid")
THICKNESS, GRAVITY = 0.01, (0.0, -9.81)  # m, m/s2
STIFF, SOFT = (Material(E, nu=0.3, rho=1200.0, viscosity=2e-6) for E in (2e9, 500e6))


def body_at(level, modes=5):
    """The function that turns a plate into the body of a level: "full" the plate, "reduced" one with `modes` modes, "rigid" a rigid one."""
    if not is_one_of(level, LEVELS):
        raise InputError(f"level {level!r} is unknown; known: {', '.join(LEVELS)}")
    return {"full": lambda plate: plate, "reduced": lambda plate: Reduced(plate, modes=modes), "rigid": Rigid}[level]


def _problem(name, make, t_end, point, level, *options):
    """The Problem of a scene `make(level, *options)`, with digits if the options (modes, cells, seed) are its default ones."""
    model, about, reference, known_to = make(level, *options).build(), ABOUT[name], {}, {}
    if options == make.__defaults__[1:4]:
        place, place_known, velocity, velocity_known = DIGITS[name][level]
        reference = {"point": np.array(place), "velocity": np.array(velocity)}
        known_to = {"point": place_known, "velocity": velocity_known}
    else:
        about = about | {"source": "no reference for these options; measure against a refined run"}
    return Problem(name, model, None, None, t_end, reference, known_to=known_to, measures=point_measures(point), **about)


CRANK, ROD = 0.15, 0.3  # of the slider crank, m


def slider_crank(level="full", modes=5, cells=40, seed=1, material=STIFF):
    """Slider crank: a torque turns the crank, and the rod moves a mass along a rail.

    Crank 0.15 m x 0.03 m, upright and at rest at the start; rod 0.3 m x 0.02 m; slider 0.5 kg; E = 2 GPa. The torque grows to 0.8 N m within
    0.1 s. With rigid links and the crank at the angle a from the rail the slider is at `r cos a + sqrt(l^2 - r^2 sin(a)^2)`.

    Parameters
    ----------
    level : "full", "reduced" or "rigid"
    modes : int, of each body of level "reduced"
    cells : int, polygons of the rod; those of the crank have the same size
    seed : int, of the mesh
    material : Material

    Returns
    -------
    Scene
        Bodies "crank", "rod"; joints "bearing", "crank pin", "rail"; mass "slider"; torque "drive".
    """
    from polyida.mesh import rectangle

    body, scene = body_at(level, modes), Scene(gravity=GRAVITY)
    short, long = rectangle(CRANK, 0.03, cells=-(-3 * cells // 4), seed=seed), rectangle(ROD, 0.02, cells=cells, seed=seed)
    crank = scene.add(body(Plate(short, material, THICKNESS, angle=np.pi / 2, name="crank")))
    rod = scene.add(body(Plate(long, material, THICKNESS, origin=(0.0, CRANK), angle=-np.arcsin(CRANK / ROD), name="rod")))
    scene.add(Revolute(ground.at((0.0, 0.0)), crank.section("left"), name="bearing"))
    scene.add(Revolute(crank.section("right"), rod.section("left"), name="crank pin"))
    scene.add(Slot(ground.at((0.0, 0.0)), rod.section("right"), name="rail"))
    scene.add(PointMass(rod.section("right"), 0.5, name="slider"))
    scene.add(Torque(crank.section("left"), profile.quintic(0.0, 0.8, duration=0.1), name="drive"))
    return scene


def slider_crank_problem(level="full", modes=5, cells=40, seed=1):
    """Slider crank of two flexible links, driven by a torque for 0.4 s.

    level: "full", "reduced" or "rigid". Only the default mesh and number of modes have a reference.
    """
    return _problem("slider-crank", slider_crank, 0.4, "slider", level, modes, cells, seed)


FOUR_BAR = 0.1, 0.3, 0.25, 0.3  # crank, coupler, rocker, frame, m
FOUR_BAR_START = np.pi / 3  # angle of the crank, rad
FOUR_BAR_TURN = profile.quintic(0.0, 2 * np.pi, duration=0.5)  # of the motor, rad


def four_bar(level="full", modes=5, cells=70, seed=1, material=SOFT):
    """Four-bar: a motor turns the crank once within 0.5 s, by a quintic from 60 degrees; the coupler moves a rocker.

    Links with rounded ends and pin holes of 6 mm radius, pin to pin 0.1 m (crank), 0.3 m (coupler), 0.25 m (rocker), 0.03 m high, E = 500
    MPa; bearings at (0, 0) and (0.3, 0); a mass of 0.2 kg on the pin of coupler and rocker. The links are placed roughly, then assembled.

    Parameters
    ----------
    level, modes, seed, material
        As of `slider_crank`.
    cells : int, polygons of the coupler; those of the others have the same size

    Returns
    -------
    Scene
        Bodies "crank", "coupler", "rocker"; joints "bearing", "crank pin", "rocker pin", "support"; motor "drive"; mass "pin".
    """
    from polyida.mesh import Link, polygonize

    body, scene = body_at(level, modes), Scene(gravity=GRAVITY)
    crank_length, coupler_length, rocker_length, frame = FOUR_BAR

    def link(name, length, share, origin, angle):
        """Add one link of the four-bar to the scene: a plate of that length, m, at an origin, m, and angle, rad; share: of all cells."""
        mesh = polygonize(Link(length, 0.03, 0.006), cells=round(share * cells), seed=seed)
        return scene.add(body(Plate(mesh, material, THICKNESS, origin=origin, angle=angle, name=name)))

    crank = link("crank", crank_length, 0.5, (0.0, 0.0), FOUR_BAR_START)
    coupler = link("coupler", coupler_length, 1.0, (0.05, 0.09), 0.56)
    rocker = link("rocker", rocker_length, 0.9, (frame, 0.0), 1.57)
    scene.add(Revolute(ground.at((0.0, 0.0)), crank.rim(0), name="bearing"))
    scene.add(AngleMotor(ground, crank.rim(0), FOUR_BAR_TURN, name="drive"))
    scene.add(Revolute(crank.rim(1), coupler.rim(0), name="crank pin"))
    scene.add(Revolute(coupler.rim(1), rocker.rim(1), name="rocker pin"))
    scene.add(Revolute(ground.at((frame, 0.0)), rocker.rim(0), name="support"))
    scene.add(PointMass(coupler.rim(1), 0.2, name="pin"))
    scene.assemble()
    return scene


def four_bar_problem(level="full", modes=5, cells=70, seed=1):
    """Four-bar of flexible links with pin holes, its crank turned once within 0.5 s.

    level: "full", "reduced" or "rigid". Only the default mesh and number of modes have a reference.
    """
    return _problem("four-bar", four_bar, 0.5, "pin", level, modes, cells, seed)


ARM_LENGTH = 0.5  # of each link of the two-link arm, m
ARM_TURNS = {  # of the motors, rad
    "shoulder": profile.quintic(0.0, np.pi / 2, duration=0.4),
    "elbow": profile.quintic(0.0, -2 * np.pi / 3, duration=0.4),
}


def two_link_arm(level="full", modes=5, cells=40, seed=1, material=STIFF):
    """Two-link arm: motors fold it within 0.4 s, the shoulder by +90 and the elbow by -120 degrees; then it vibrates.

    Links 0.5 m x 0.04 m, E = 2 GPa, straight along +x and at rest at the start; payload 0.3 kg.

    Parameters
    ----------
    level, modes, seed, material
        As of `slider_crank`.
    cells : int, polygons of a link

    Returns
    -------
    Scene
        Bodies "upper arm", "forearm"; joints "shoulder", "elbow"; motors "shoulder motor", "elbow motor"; mass "tip".
    """
    from polyida.mesh import rectangle

    body, mesh, scene = body_at(level, modes), rectangle(ARM_LENGTH, 0.04, cells=cells, seed=seed), Scene(gravity=GRAVITY)
    upper = scene.add(body(Plate(mesh, material, THICKNESS, name="upper arm")))
    fore = scene.add(body(Plate(mesh, material, THICKNESS, origin=(ARM_LENGTH, 0.0), name="forearm")))
    for name, a, b in (("shoulder", ground, upper.section("left")), ("elbow", upper.section("right"), fore.section("left"))):
        scene.add(Revolute(a, b, name=name))
        scene.add(AngleMotor(a, b, ARM_TURNS[name], name=f"{name} motor"))
    scene.add(PointMass(fore.section("right"), 0.3, name="tip"))
    return scene


def two_link_arm_problem(level="full", modes=5, cells=40, seed=1):
    """Arm of two flexible links, folded by motors within 0.4 s; 0.5 s.

    level: "full", "reduced" or "rigid". Only the default mesh and number of modes have a reference.
    """
    return _problem("two-link-arm", two_link_arm, 0.5, "tip", level, modes, cells, seed)


INVERSOR = 0.4, 0.2, 0.15  # arm, bar of the rhombus, crank, m
INVERSOR_START = -np.pi / 3  # angle of the crank, rad
INVERSOR_TURN = profile.quintic(0.0, -2 * INVERSOR_START, duration=0.5)  # of the motor, rad


def peaucellier_positions(angle):
    """(crank pin, upper and lower corner of the rhombus, pen), complex, m, of rigid links with the crank at an angle, rad."""
    arm, bar, crank = INVERSOR
    pin = crank * (1 + np.exp(1j * angle))
    pen = (arm**2 - bar**2) / pin.conjugate()
    middle = (pin + pen) / 2
    side = 1j * np.sqrt(bar**2 - abs(pen - pin) ** 2 / 4) * middle / abs(middle)
    return pin, middle + side, middle - side, pen


def peaucellier(level="full", modes=5, cells=40, seed=1, material=SOFT):
    """Peaucellier's inversor: seven links and ten pins that draw a straight line.

    Two arms from the origin, 0.4 m, a rhombus of four bars, 0.2 m, and a crank of 0.15 m about (0.15, 0), whose circle passes through the
    origin. With rigid links the product of the distances of crank pin and pen from the origin is `0.4^2 - 0.2^2` m2, so that the pen stays
    on the line x = 0.4 m. Bars 0.05 m high with rounded ends and pin holes of 12 mm radius, E = 500 MPa; the pen 0.2 kg. A motor turns the
    crank from -60 to 60 degrees within 0.5 s.

    Parameters
    ----------
    level, modes, seed, material
        As of `slider_crank`.
    cells : int, polygons of a bar; an arm has twice as many

    Returns
    -------
    Scene
        Bodies "crank", "upper arm", "lower arm", "inner upper", "inner lower", "outer upper", "outer lower"; joints "crank bearing", "pen
        pin" and, of "upper" and "lower", "upper bearing", "upper crank pin", "upper inner pin", "upper outer pin"; motor "drive"; mass "pen".
    """
    from polyida.mesh import Link, polygonize

    body, scene, (arm, bar, crank_length) = body_at(level, modes), Scene(gravity=GRAVITY), INVERSOR
    counts = {crank_length: cells, bar: cells, arm: 2 * cells}
    meshes = {length: polygonize(Link(length, 0.05, 0.012), cells=count, seed=seed) for length, count in counts.items()}

    def link(name, length, start, end):
        """Add one link of the inversor to the scene: a plate of that length, m, from start to end, complex numbers, m."""
        plate = Plate(meshes[length], material, THICKNESS, origin=(start.real, start.imag), angle=np.angle(end - start), name=name)
        return scene.add(body(plate))

    pin, upper, lower, pen = peaucellier_positions(INVERSOR_START)
    crank = link("crank", crank_length, crank_length + 0j, pin)
    arms = link("upper arm", arm, 0j, upper), link("lower arm", arm, 0j, lower)
    inner = link("inner upper", bar, pin, upper), link("inner lower", bar, pin, lower)
    outer = link("outer upper", bar, upper, pen), link("outer lower", bar, lower, pen)
    scene.add(Revolute(ground.at((crank_length, 0.0)), crank.rim(0), name="crank bearing"))
    scene.add(AngleMotor(ground, crank.rim(0), INVERSOR_TURN, name="drive"))
    for side, long, near, far in zip(("upper", "lower"), arms, inner, outer):
        scene.add(Revolute(ground.at((0.0, 0.0)), long.rim(0), name=f"{side} bearing"))
        scene.add(Revolute(crank.rim(1), near.rim(0), name=f"{side} crank pin"))
        scene.add(Revolute(long.rim(1), near.rim(1), name=f"{side} inner pin"))
        scene.add(Revolute(long.rim(1), far.rim(0), name=f"{side} outer pin"))
    scene.add(Revolute(outer[0].rim(1), outer[1].rim(1), name="pen pin"))
    scene.add(PointMass(outer[0].rim(1), 0.2, name="pen"))
    return scene


def peaucellier_problem(level="full", modes=5, cells=40, seed=1):
    """Peaucellier's inversor of seven flexible links, which draws a line; 0.5 s.

    level: "full", "reduced" or "rigid". Only the default mesh and number of modes have a reference.
    """
    return _problem("peaucellier", peaucellier, 0.5, "pen", level, modes, cells, seed)
