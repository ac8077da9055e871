"""Flexible plates in a row, linked by revolute joints, a mass at the tip; swinging freely or driven by motors.

Each plate is 1 m x 0.1 m and 10 mm thick, E = 50 MPa, nu = 0.3, rho = 1100 kg/m3, St. Venant-Kirchhoff without damping.
All start along +x, at rest and undeformed; joint k is at (k - 1, 0). Tip mass 0.5 kg, gravity 9.81 m/s2 along -y. These
dimensions are this project's own.

Digits of the plates' motion at t = 1 s, on the default meshes, by two methods of different form and time stepping.

`python studies/digits.py` makes and prints them. The digits come from DOP853 on the index-1 equations, rtol 1e-11, put
back on the constraints 31 times; without that the motors drift by 2e-10 rad. `known_to` is how far Radau IIA on the
stabilised form, rtol 1e-13, is from them, in the worst component; of all of q it is 4e-10 to 7e-10 m. The former has settled
farther: from rtol 1e-9 to 1e-11 it moves by 4e-14 m, 1e-11 m/s and 3e-5 N on the double plate. A run of the former takes 1
to 3 CPU minutes, one of the latter up to one and a half.

Gravity sets in at once and nothing is damped, so that the fast modes of the mesh (up to 5e4 rad/s) ring on in lam, of
which fewer digits are known. At 1 s a change of the start has not grown yet (two rigid plates: by a factor below 1 at
1 s, 12 at 3 s, 3600 at 10 s). Space is not converged: these are digits of the semi-discrete equations on that mesh.
"""

import numpy as np

from polyida import profile
from polyida.body.plate import Material, Plate
from polyida.body.rigid_body import PointMass
from polyida.errors import InputError
from polyida.joint.attachment import ground
from polyida.joint.joints import AngleMotor, Revolute
from polyida.problems import Problem
from polyida.problems.about import ABOUT
from polyida.scene import Scene
from polyida.validation import is_whole

REACH = {"double-plate": 548.2559718086329, "double-plate-motors": 548.2559718086329, "plate-chain": 586.7452475191253}
"""Sum of |X| + |Y| of the nodes, m: tells the default mesh from any other."""

DIGITS = {
    "double-plate": {
        "tip": [-1.4546960373169, -1.3101982612916],
        "tip_velocity": [-2.87673076564, 3.98176292721],
        "lam": [32.0723136, 18.7649031, 18.0803054, 15.5459359],
    },
    "double-plate-motors": {
        "tip": [1.1850190924543, 1.5105537995671],
        "tip_velocity": [-7.41936130587, 4.86208503633],
        "lam": [-43.1060413, -19.0901966, -35.4282787, -30.1391681, -16.9466201, -12.9581547],
    },
    "plate-chain": {
        "tip": [-1.226865174502, -2.6124422463977],
        "tip_velocity": [-7.29448283477, 2.86735053338],
        "lam": [-0.8392994, 62.5331388, 12.3811241, 41.711436, 20.5484352, 21.8000377],
    },
}

KNOWN_TO = {
    "double-plate": {"tip": 4e-12, "tip_velocity": 5e-10, "lam": 0.0006},
    "double-plate-motors": {"tip": 5e-12, "tip_velocity": 2e-10, "lam": 0.0006},
    "plate-chain": {"tip": 5e-12, "tip_velocity": 4e-10, "lam": 0.0004},
}


def digits_of(name, model):
    """(reference, known_to) of a problem where the model has its default mesh, else two empty dictionaries."""
    reach = np.abs(model.reference).sum()
    if abs(reach - REACH[name]) > 1e-9 * REACH[name]:
        return {}, {}
    return {part: np.array(value) for part, value in DIGITS[name].items()}, dict(KNOWN_TO[name])


LENGTH, HEIGHT, THICKNESS, TIP_MASS, GRAVITY = 1.0, 0.1, 0.01, 0.5, (0.0, -9.81)
RUBBER = Material(E=50e6, nu=0.3, rho=1100.0)


def double_plate(cells=160, seed=1, material=RUBBER, tip_mass=TIP_MASS):
    """Two plates "upper" and "lower", joints "shoulder" and "elbow", mass "tip"; they swing freely from rest.

    cells: polygons a plate. seed: of the mesh. tip_mass: kg.
    """
    return _row(("upper", "lower"), ("shoulder", "elbow"), cells, seed, material, tip_mass)


def double_plate_motors(cells=160, seed=1, material=RUBBER, tip_mass=TIP_MASS, angle=None):
    """The double plate with an angle motor in each joint, which impose the same angle.

    They are called "shoulder motor" and "elbow motor". angle: theta(t) in rad; by default the quintic
    `(pi/4)(10 s^3 - 15 s^4 + 6 s^5)`, s = min(t / 1 s, 1).
    """
    scene = double_plate(cells, seed, material, tip_mass)
    angle = profile.quintic(0.0, np.pi / 4, duration=1.0) if angle is None else angle
    for name in ("shoulder", "elbow"):
        joint = scene.parts[name]
        scene.add(AngleMotor(joint.a, joint.b, angle=angle, name=f"{name} motor"))
    return scene


def plate_chain(links=3, cells=80, seed=1, material=RUBBER, tip_mass=TIP_MASS):
    """A chain of `links` plates "plate 1", "plate 2", ... with joints "joint 1", ..., swinging freely from rest."""
    if not is_whole(links, 1, 10**6):
        raise InputError(f"plate_chain: links = {links!r} must be a whole number of at least 1")
    numbers = range(1, links + 1)
    return _row([f"plate {k}" for k in numbers], [f"joint {k}" for k in numbers], cells, seed, material, tip_mass)


def _row(plates, joints, cells, seed, material, tip_mass):
    """Plates along +x, each held by a revolute joint to the one before, the first to ground; all on one mesh."""
    from polyida.mesh import rectangle

    mesh, scene = rectangle(LENGTH, HEIGHT, cells=cells, seed=seed), Scene(gravity=GRAVITY)
    end = ground
    for k, (name, joint) in enumerate(zip(plates, joints)):
        plate = scene.add(Plate(mesh, material, thickness=THICKNESS, origin=(k * LENGTH, 0.0), name=name))
        scene.add(Revolute(end, plate.section("left"), name=joint))
        end = plate.section("right")
    scene.add(PointMass(end, tip_mass, name="tip"))
    return scene


def double_plate_problem(cells=160, seed=1):
    """Two flexible plates in a row, swinging freely from rest for 1 s.

    The reference belongs to the default mesh; there is none for another.
    """
    return _problem("double-plate", double_plate(cells, seed))


def double_plate_motors_problem(cells=160, seed=1):
    """The two plates with a motor in each joint that turns it by 45 degrees within 1 s.

    The reference belongs to the default mesh; there is none for another.
    """
    return _problem("double-plate-motors", double_plate_motors(cells, seed))


def plate_chain_problem(links=3, cells=80, seed=1):
    """Three flexible plates in a row, swinging freely from rest for 1 s.

    The reference belongs to three links on the default mesh; there is none for others.
    """
    return _problem("plate-chain", plate_chain(links, cells, seed))


def _problem(name, scene):
    """A Problem with the digits of its default mesh, where the model has that mesh."""
    model, about = scene.build(), ABOUT[name]
    digits, known_to = digits_of(name, model)
    if not digits:
        about = about | {"source": "no reference for this mesh; measure against a refined run"}
    measures = {"tip": lambda run: run.position("tip")[-1], "tip_velocity": tip_velocity}
    return Problem(name=name, model=model, q0=None, v0=None, t_end=1.0, reference=digits, known_to=known_to, measures=measures, **about)


def tip_velocity(run):
    """Velocity of "tip" at the end of a run, (2,), m/s."""
    return run.model.displacement("tip", run.v[-1])
