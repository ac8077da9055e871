"""Two problems of the literature, as scenes: the N-four-bar and the spin-up beam.

N-four-bar, of the IFToMM library of benchmark problems, A02: N + 1 upright bars on the ground, N bars across that couple them.

Each bar is 1 m long and weighs 1 kg, uniform; gravity 9.81 m/s2 along -y; B0, the top of the first bar, starts at 1 m/s along +x. All
windows stay parallelograms, so that the angle a of the bars from +x is one degree of freedom:

    ((N + 1) / 3 + N) a'' = -((N + 1) / 2 + N) 9.81 cos(a)

With the bars level (a = 0) all pins are in line: phi_q loses rank, and each window could fold on its own from there.

Source: Gonzalez, Dopico, Lugris, Cuadrado, A benchmarking system for MBS simulation software, Multibody System Dynamics 16 (2006) 179;
two windows: Bayo, Avello, Nonlinear Dynamics 5 (1994) 209.

Spin-up beam, of Simo and Vu-Quoc: a slender beam brought to a steady turn by an angle motor, free of gravity.

L = 10 m, EA = 2.8e7 N, EI = 1.4e4 N m2, 1.2 kg/m. As a continuum of 1 m width: height sqrt(12 EI / EA) = 0.0775 m, E =
EA / height, rho = 1.2 / height, nu = 0. The beam's own shear stiffness 1e7 N belongs to no such continuum (5/12 E
height = 1.17e7 N); at a slenderness of 129 that hardly matters.
"""

import numpy as np

from polyida import profile
from polyida.body.plate import Material, Plate
from polyida.body.rigid_body import RigidBody
from polyida.errors import InputError
from polyida.force.loads import PointLoad
from polyida.joint.attachment import ground
from polyida.joint.joints import AngleMotor, Revolute
from polyida.problems import ABOUT, Problem, point_measures
from polyida.scene import Scene
from polyida.validation import is_whole, positive

GRAVITY, START = 9.81, 1.0  # m/s2, and the start of B0, m/s


def n_four_bar(windows=2):
    """Bars "bar 0" .. "bar N", "across 1" .. "across N"; joints "A0" .. "AN" on the ground, "B0" on the first bar, then "C1" and "B1" ...

    Raises InputError for another number of windows than 1 to 1000.
    """
    if not is_whole(windows, 1, 1000):
        raise InputError(f"n_four_bar: windows = {windows!r} must be a whole number from 1 to 1000")
    scene, before = Scene(gravity=(0.0, -GRAVITY)), None
    for k in range(windows + 1):
        bar = RigidBody.bar(1.0, 1.0, (k, 0.0), np.pi / 2, velocity=(START / 2, 0.0), spin=-START, name=f"bar {k}")
        scene.add(bar)
        scene.add(Revolute(ground.at((k, 0.0)), bar.at("left"), name=f"A{k}"))
        if before is not None:
            across = scene.add(RigidBody.bar(1.0, 1.0, (k - 1, 1.0), velocity=(START, 0.0), name=f"across {k}"))
            scene.add(Revolute(before.at("right"), across.at("left"), name=f"B{k - 1}"))
            scene.add(Revolute(across.at("right"), bar.at("right"), name=f"C{k}"))
        before = bar
    return scene


def turning(t, windows=2):
    """(a, a') of the bars at t, rad and rad/s, from upright; DOP853 at a relative tolerance of 1e-13."""
    from scipy.integrate import solve_ivp

    pull = GRAVITY * ((windows + 1) / 2 + windows) / ((windows + 1) / 3 + windows)
    start = [np.pi / 2, -START]
    return solve_ivp(lambda _, y: [y[1], -pull * np.cos(y[0])], (0.0, t), start, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]


def n_four_bar_problem(windows=2, t_end=0.7):
    """The N-four-bar of the IFToMM library: N windows of rigid bars that fall together.

    The run ends just before they are level, which is a singular position.

    windows: how many; two are level at 0.714 s. t_end: s; beyond that a run keeps to the parallelograms, or stops and says what can branch.
    """
    scene, t_end = n_four_bar(windows), positive("n-four-bar", "t_end", t_end, "seconds")
    angle, rate = turning(t_end, windows)
    point = np.array([np.cos(angle), np.sin(angle)])
    return Problem(
        name="n-four-bar",
        model=scene.build(),
        q0=None,
        v0=None,
        t_end=t_end,
        reference={"point": point, "velocity": rate * np.array([-point[1], point[0]])},
        known_to={"point": 1e-12, "velocity": 1e-11},
        measures=point_measures("B0"),
        **ABOUT["n-four-bar"],
    )


LENGTH, EA, EI, LINE_MASS = 10.0, 2.8e7, 1.4e4, 1.2
HEIGHT = float(np.sqrt(12 * EI / EA))
SPEED, DURATION = 6.0, 15.0  # rad/s, reached after so many s
EXTENSION = LINE_MASS * SPEED**2 * LENGTH**3 / (3 * EA)


def turn():
    """psi(t) = 6/15 (t^2/2 + (15 / 2 pi)^2 (cos(2 pi t / 15) - 1)) up to 15 s, 6 t - 45 beyond, rad."""
    w, rate = 2 * np.pi / DURATION, SPEED / DURATION

    def value(t):
        """Angle of the hub at time t, rad."""
        return rate * (t * t / 2 + (np.cos(w * t) - 1) / w**2) if t < DURATION else SPEED * (t - DURATION / 2)

    return profile.from_function(
        value,
        lambda t: rate * (t - np.sin(w * t) / w) if t < DURATION else SPEED,
        lambda t: rate * (1 - np.cos(w * t)) if t < DURATION else 0.0,
        kinks=(DURATION,),
    )


def spin_up_beam(nx=130, ny=1, element="wachspress", order=1):
    """The beam on nx by ny quadrilaterals, turned by "motor" at its left edge; "tip" is the mean of the right one."""
    from polyida.mesh import quads

    material = Material(EA / HEIGHT, 0.0, LINE_MASS / HEIGHT)
    beam = Plate(quads(LENGTH, HEIGHT, nx, ny), material, 1.0, name="beam", element=element, order=order)
    scene = Scene()
    scene.add(beam)
    scene.add(Revolute(ground, beam.section("left"), name="hub"))
    scene.add(AngleMotor(ground, beam.section("left"), turn(), name="motor"))
    scene.add(PointLoad(beam.section("right"), (0.0, 0.0), name="tip"))
    return scene


def in_the_turning_frame(t, position):
    """(extension, deflection) of the tip along and across the motor's direction, m, each (frames,)."""
    (x, y), angle = position.T, np.array([turn()(time) for time in t])
    return x * np.cos(angle) + y * np.sin(angle) - LENGTH, y * np.cos(angle) - x * np.sin(angle)


def steady_extension(run, since=16.0):
    """Mean distance of the tip from the hub less L, m, over the frames from `since` on: what is left of the bending
    vibration averages out.
    """
    place = run.position("tip")[np.asarray(run.t) >= since]
    return float(np.mean(np.hypot(*place.T)) - LENGTH)


def spin_up_beam_problem(nx=130, ny=1, element="wachspress", order=1):
    """The spin-up beam of Simo and Vu-Quoc: 15 s of spin-up and 5 s of steady turning."""
    return Problem(
        name="spin-up-beam",
        model=spin_up_beam(nx, ny, element, order).build(),
        q0=None,
        v0=None,
        t_end=20.0,
        reference={"extension": EXTENSION},
        known_to={"extension": 1e-7},  # a linear bar leaves out the order of its strain, 8e-5, times that
        measures={"extension": steady_extension},
        **ABOUT["spin-up-beam"],
    )
