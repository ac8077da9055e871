"""The double plate with rigid plates, against the ordinary differential equation of its two angles."""

import numpy as np

from polyida.body.plate import Plate
from polyida.body.rigid_body import PointMass, Rigid, RigidBody
from polyida.joint.attachment import ground
from polyida.joint.joints import Revolute
from polyida.problems import Problem
from polyida.problems.about import ABOUT
from polyida.problems.levels import measures
from polyida.problems.plates import GRAVITY, HEIGHT, LENGTH, RUBBER, THICKNESS, TIP_MASS
from polyida.problems.rigid_limit import PLATE_MASS, rigid_motion
from polyida.scene import Scene


def bars():
    """Two pi.RigidBody of the plates' mass and inertia, and their sides "left" and "right"."""
    inertia, points = PLATE_MASS * (LENGTH**2 + HEIGHT**2) / 12, {"left": (-LENGTH / 2, 0.0), "right": (LENGTH / 2, 0.0)}
    made = [RigidBody(PLATE_MASS, inertia, points, origin=(x, 0.0), name=name) for name, x in (("upper", 0.5), ("lower", 1.5))]
    return made, [(body.at("left"), body.at("right")) for body in made]


def plates():
    """The two plates taken as rigid, and their sections "left" and "right"."""
    from polyida.mesh import rectangle

    mesh = rectangle(LENGTH, HEIGHT, cells=8, seed=1)
    made = [Rigid(Plate(mesh, RUBBER, THICKNESS, origin=(x, 0.0), name=name)) for name, x in (("upper", 0.0), ("lower", LENGTH))]
    return made, [(body.section("left"), body.section("right")) for body in made]


def rigid_pendulum(meshed=True):
    """Bodies "upper" and "lower", joints "shoulder" and "elbow", mass "tip". meshed: plates taken as rigid, or bodies of their mass."""
    scene = Scene(gravity=GRAVITY)
    made, ((left, right), (near, far)) = plates() if meshed else bars()
    for body in made:
        scene.add(body)
    scene.add(Revolute(ground, left, name="shoulder"))
    scene.add(Revolute(right, near, name="elbow"))
    scene.add(PointMass(far, TIP_MASS, name="tip"))
    return scene


def state(t):
    """{"point", "velocity"} of the tip at t, m and m/s."""
    a1, a2, w1, w2 = rigid_motion(t)
    arms = LENGTH * np.exp(1j * np.array([a1, a2]))
    return {part: np.array([z.real, z.imag]) for part, z in (("point", arms.sum()), ("velocity", 1j * arms @ [w1, w2]))}


def problem(meshed=True):
    """Two rigid plates in a row, swinging freely from rest for 1 s.

    meshed: whether they are plates taken as rigid, or rigid bodies of the same mass and inertia.
    """
    return Problem(
        name="rigid-pendulum",
        model=rigid_pendulum(meshed).build(),
        q0=None,
        v0=None,
        t_end=1.0,
        reference=state(1.0),
        known_to={"point": 1e-11, "velocity": 1e-10},
        measures=measures("tip"),
        **ABOUT["rigid-pendulum"],
    )
