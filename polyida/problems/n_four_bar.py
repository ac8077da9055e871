"""The N-four-bar of the IFToMM library of benchmark problems, A02: N + 1 upright bars on the ground, N bars across that couple them.

Each bar is 1 m long and weighs 1 kg, uniform; gravity 9.81 m/s2 along -y; B0, the top of the first bar, starts at 1 m/s along +x. All
windows stay parallelograms, so that the angle a of the bars from +x is one degree of freedom:

    ((N + 1) / 3 + N) a'' = -((N + 1) / 2 + N) 9.81 cos(a)

With the bars level (a = 0) all pins are in line: phi_q loses rank, and each window could fold on its own from there.

Source: Gonzalez, Dopico, Lugris, Cuadrado, A benchmarking system for MBS simulation software, Multibody System Dynamics 16 (2006) 179;
two windows: Bayo, Avello, Nonlinear Dynamics 5 (1994) 209.
"""

import numpy as np

from polyida.body.rigid_body import RigidBody
from polyida.errors import InputError
from polyida.joint.attachment import ground
from polyida.joint.joints import Revolute
from polyida.problems import ABOUT, Problem, point_measures
from polyida.scene import Scene
from polyida.validation import is_whole, positive

WEIGHT, SPEED = 9.81, 1.0


def n_four_bar(windows=2):
    """Bars "bar 0" .. "bar N", "across 1" .. "across N"; joints "A0" .. "AN" on the ground, "B0" on the first bar, then "C1" and "B1" ...

    Raises InputError for another number of windows than 1 to 1000.
    """
    if not is_whole(windows, 1, 1000):
        raise InputError(f"n_four_bar: windows = {windows!r} must be a whole number from 1 to 1000")
    scene, before = Scene(gravity=(0.0, -WEIGHT)), None
    for k in range(windows + 1):
        bar = RigidBody.bar(1.0, 1.0, (k, 0.0), np.pi / 2, velocity=(SPEED / 2, 0.0), spin=-SPEED, name=f"bar {k}")
        scene.add(bar)
        scene.add(Revolute(ground.at((k, 0.0)), bar.at("left"), name=f"A{k}"))
        if before is not None:
            across = scene.add(RigidBody.bar(1.0, 1.0, (k - 1, 1.0), velocity=(SPEED, 0.0), name=f"across {k}"))
            scene.add(Revolute(before.at("right"), across.at("left"), name=f"B{k - 1}"))
            scene.add(Revolute(across.at("right"), bar.at("right"), name=f"C{k}"))
        before = bar
    return scene


def turning(t, windows=2):
    """(a, a') of the bars at t, rad and rad/s, from upright; DOP853 at a relative tolerance of 1e-13."""
    from scipy.integrate import solve_ivp

    pull = WEIGHT * ((windows + 1) / 2 + windows) / ((windows + 1) / 3 + windows)
    start = [np.pi / 2, -SPEED]
    return solve_ivp(lambda _, y: [y[1], -pull * np.cos(y[0])], (0.0, t), start, method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1]


def problem(windows=2, t_end=0.7):
    """Windows of four bars that fall together, to just before they are level, which is a singular position.

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
