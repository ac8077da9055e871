"""Two or more plates in a row, linked by revolute joints, a mass at the tip: flexible, in the limit of a large modulus, and rigid.

Each plate is 1 m x 0.1 m and 10 mm thick, E = 50 MPa, nu = 0.3, rho = 1100 kg/m3, St. Venant-Kirchhoff without damping.
All start along +x, at rest and undeformed; joint k is at (k - 1, 0). Tip mass 0.5 kg, gravity 9.81 m/s2 along -y. These
dimensions are this project's own.

The digits of the flexible plates at t = 1 s are those of the semi-discrete equations on the default meshes: space is not converged.
`python studies/digits.py` computes them by DOP853 on the index-1 equations, rtol 1e-11, projected onto the constraints 31 times;
without that the motors drift by 2e-10 rad. `known_to` is the distance of Radau IIA on the stabilised form, rtol 1e-13, in the worst
component; of all of q it is 4e-10 to 7e-10 m. From rtol 1e-9 to 1e-11 DOP853 changes by 4e-14 m, 1e-11 m/s and 3e-5 N on the double plate.
Gravity acts at once and nothing is damped, so the fast modes of the mesh (up to 5e4 rad/s) remain in lam, of which fewer digits are known.
At 1 s a change of the start has not grown yet (two rigid plates: by a factor below 1 at 1 s, 12 at 3 s, 3600 at 10 s).

Two rigid plates have the angles a_k from +x; each plate has mass m, half-length L/2 and central inertia m (L^2 + H^2)/12, and the tip mass
M is at the end:

    (4m/3 + M + b) L^2 a1'' + (m/2 + M) L^2 (cos(a1 - a2) a2'' + sin(a1 - a2) a2'^2) + (3m/2 + M) g L cos a1 = 0
    (m/3 + M + b) L^2 a2'' + (m/2 + M) L^2 (cos(a1 - a2) a1'' - sin(a1 - a2) a1'^2) + (m/2 + M) g L cos a2 = 0

with b = m H^2 / (12 L^2).
"""

import numpy as np

from polyida import profile
from polyida.body.plate import Material, Plate
from polyida.body.rigid_body import PointMass, Rigid, RigidBody
from polyida.errors import InputError
from polyida.joint.attachment import ground
from polyida.joint.joints import AngleMotor, Revolute
from polyida.problems import ABOUT, Problem, point_measures
from polyida.scene import Scene
from polyida.validation import is_whole, positive

DIGITS = {  # problem: part: (digits, their accuracy)
    "double-plate": {
        "tip": ([-1.4546960373169, -1.3101982612916], 4e-12),
        "tip_velocity": ([-2.87673076564, 3.98176292721], 5e-10),
        "lam": ([32.0723136, 18.7649031, 18.0803054, 15.5459359], 6e-4),
    },
    "double-plate-motors": {
        "tip": ([1.1825322573838, 1.5121250379134], 4e-12),
        "tip_velocity": ([-7.4281243842, 4.8504249465], 3e-10),
        "lam": ([-43.022152, -19.11606951, -35.24576613, -30.26215823, -16.85528362, -12.91556675], 4e-5),
    },
    "plate-chain": {
        "tip": ([-1.226865174502, -2.6124422463977], 5e-12),
        "tip_velocity": ([-7.29448283477, 2.86735053338], 4e-10),
        "lam": ([-0.8392994, 62.5331388, 12.3811241, 41.711436, 20.5484352, 21.8000377], 4e-4),
    },
}
MESH_SUMS = {"double-plate": 548.2559718086329, "double-plate-motors": 548.2559718086329, "plate-chain": 586.7452475191253}
"""Sum of |X| + |Y| of the nodes, m, of the default mesh: another mesh has no digits."""

LENGTH, HEIGHT, THICKNESS, TIP_MASS, GRAVITY = 1.0, 0.1, 0.01, 0.5, (0.0, -9.81)
RUBBER = Material(E=50e6, nu=0.3, rho=1100.0)


def double_plate(cells=160, seed=1, material=RUBBER, tip_mass=TIP_MASS, order=1):
    """Two plates that swing freely from rest.

    Parameters
    ----------
    cells : int, polygons of a plate
    seed : int, of the mesh
    material : Material
    tip_mass : float, kg
    order : 1 or 2, of the cells

    Returns
    -------
    Scene
        Plates "upper", "lower"; joints "shoulder", "elbow"; mass "tip".
    """
    return _row(("upper", "lower"), ("shoulder", "elbow"), cells, seed, material, tip_mass, order)


def double_plate_motors(cells=160, seed=1, material=RUBBER, tip_mass=TIP_MASS, angle=None, order=1):
    """The double plate with motors "shoulder motor" and "elbow motor", which impose the same angle.

    Parameters
    ----------
    cells, seed, material, tip_mass, order
        As of `double_plate`.
    angle : profile or function of t, rad, optional
        By default the quintic `(pi/4)(10 s^3 - 15 s^4 + 6 s^5)`, s = min(t / 1 s, 1).

    Returns
    -------
    Scene
    """
    scene = double_plate(cells, seed, material, tip_mass, order)
    angle = profile.quintic(0.0, np.pi / 4, duration=1.0) if angle is None else angle
    for name in ("shoulder", "elbow"):
        joint = scene.parts[name]
        scene.add(AngleMotor(joint.a, joint.b, angle=angle, name=f"{name} motor"))
    return scene


def plate_chain(links=3, cells=80, seed=1, material=RUBBER, tip_mass=TIP_MASS, order=1):
    """A chain of plates that swings freely from rest.

    Parameters
    ----------
    links : int, number of plates
    cells, seed, material, tip_mass, order
        As of `double_plate`.

    Returns
    -------
    Scene
        Plates "plate 1", "plate 2", ...; joints "joint 1", ...; mass "tip".
    """
    if not is_whole(links, 1, 10**6):
        raise InputError(f"plate_chain: links = {links!r} must be a whole number of at least 1")
    numbers = range(1, links + 1)
    return _row([f"plate {k}" for k in numbers], [f"joint {k}" for k in numbers], cells, seed, material, tip_mass, order)


def _row(plates, joints, cells, seed, material, tip_mass, order):
    """Plates along +x, each held by a revolute joint to the one before, the first to ground; all on one mesh."""
    from polyida.mesh import rectangle

    mesh, scene = rectangle(LENGTH, HEIGHT, cells=cells, seed=seed), Scene(gravity=GRAVITY)
    end = ground
    for k, (name, joint) in enumerate(zip(plates, joints)):
        plate = scene.add(Plate(mesh, material, thickness=THICKNESS, origin=(k * LENGTH, 0.0), name=name, order=order))
        scene.add(Revolute(end, plate.section("left"), name=joint))
        end = plate.section("right")
    scene.add(PointMass(end, tip_mass, name="tip"))
    return scene


def double_plate_problem(cells=160, seed=1, order=1):
    """Two flexible plates in a row, swinging freely from rest for 1 s.

    The reference belongs to the default mesh; there is none for another.
    """
    return _problem("double-plate", double_plate(cells, seed, order=order))


def double_plate_motors_problem(cells=160, seed=1, order=1):
    """The two plates with a motor in each joint that turns it by 45 degrees within 1 s.

    The reference belongs to the default mesh; there is none for another.
    """
    return _problem("double-plate-motors", double_plate_motors(cells, seed, order=order))


def plate_chain_problem(links=3, cells=80, seed=1, order=1):
    """Three flexible plates in a row, swinging freely from rest for 1 s.

    The reference belongs to three links on the default mesh; there is none for others.
    """
    return _problem("plate-chain", plate_chain(links, cells, seed, order=order))


def _problem(name, scene):
    """The Problem of a scene, with digits if the model has the default mesh."""
    model, about = scene.build(), ABOUT[name]
    digits = DIGITS[name] if abs(np.abs(model.reference).sum() - MESH_SUMS[name]) <= 1e-9 * MESH_SUMS[name] else {}
    if not digits:
        about = about | {"source": "no reference for this mesh; measure against a refined run"}
    reference, known_to = (
        {part: np.array(value) for part, (value, _) in digits.items()},
        {part: known for part, (_, known) in digits.items()},
    )
    measures = {"tip": lambda run: run.position("tip")[-1], "tip_velocity": tip_velocity}
    return Problem(name, model, None, None, 1.0, reference, known_to=known_to, measures=measures, **about)


def tip_velocity(run):
    """Velocity of "tip" at the end of a run, (2,), m/s."""
    return run.model.displacement("tip", run.v[-1])


PLATE_MASS = RUBBER.rho * LENGTH * HEIGHT * THICKNESS
APART = {"q": 5e5, "v": 4e6, "lam": 5e7}  # times 1 / E: from rigid plates to flexible ones at 1 s, as measured


def accelerations(a1, a2, w1, w2):
    """Angular accelerations (a1'', a2''), rad/s^2, of the two rigid plates at angles a1, a2 and rates w1, w2."""
    m, M, L, H = PLATE_MASS, TIP_MASS, LENGTH, HEIGHT
    coupling, apart = (m / 2 + M) * L * L, a1 - a2
    matrix = np.array(
        [
            [(4 * m / 3 + M) * L * L + m * H * H / 12, coupling * np.cos(apart)],
            [coupling * np.cos(apart), (m / 3 + M) * L * L + m * H * H / 12],
        ]
    )
    right = [
        -coupling * np.sin(apart) * w2**2 + (1.5 * m + M) * GRAVITY[1] * L * np.cos(a1),
        coupling * np.sin(apart) * w1**2 + (m / 2 + M) * GRAVITY[1] * L * np.cos(a2),
    ]
    return np.linalg.solve(matrix, right)


def rigid_motion(t_end):
    """(a1, a2, w1, w2) at t_end, from rest along +x; DOP853 at a relative tolerance of 1e-13."""
    from scipy.integrate import solve_ivp

    run = solve_ivp(
        lambda t, y: np.concatenate([y[2:], accelerations(*y)]), (0.0, t_end), np.zeros(4), method="DOP853", rtol=1e-13, atol=1e-14
    )
    return run.y[:, -1]


def rigid_limit_problem(modulus=1e13, cells=40, seed=1, t_end=1.0):
    """The double plate of modulus `modulus`, Pa, swinging freely from rest.

    The reference is that of rigid plates, itself known to 1e-11; `known_to` is how far flexible ones are from it at 1 s
    once their vibration is damped away (generalized-alpha with rho_inf = 0.5 does that), 1e11 Pa and more.
    """
    modulus = positive("rigid limit", "modulus", modulus, "Pa")
    t_end = positive("rigid limit", "t_end", t_end, "seconds")
    model = double_plate(cells, seed, Material(E=modulus, nu=RUBBER.nu, rho=RUBBER.rho)).build()
    # q, v and lam of the model with both plates rigid; lam are the forces of the joints on their sides b, N
    motion = rigid_motion(t_end)
    (a1, a2, w1, w2), (b1, b2) = motion, accelerations(*motion)
    along, across = (np.array([[np.cos(a), np.sin(a)] for a in (a1, a2)]), np.array([[-np.sin(a), np.cos(a)] for a in (a1, a2)]))
    q, v, root, drift, pull = [], [], np.zeros(2), np.zeros(2), np.zeros(2)
    centres = []
    for k, (body, w, b) in enumerate(zip(model.bodies, (w1, w2), (b1, b2))):
        arm = body.points - [k * LENGTH, 0.0]
        q.append(root + arm[:, :1] * along[k] + arm[:, 1:] * across[k] - body.points)
        v.append(drift + w * (arm[:, :1] * across[k] - arm[:, 1:] * along[k]))
        grows = b * across[k] - w * w * along[k]
        centres.append(pull + LENGTH / 2 * grows)
        root, drift, pull = root + LENGTH * along[k], drift + LENGTH * w * across[k], pull + LENGTH * grows
    gravity = np.array(GRAVITY)
    elbow = PLATE_MASS * (centres[1] - gravity) + TIP_MASS * (pull - gravity)
    shoulder = PLATE_MASS * (centres[0] - gravity) + elbow
    return Problem(
        name="rigid-limit",
        model=model,
        q0=None,
        v0=None,
        t_end=t_end,
        reference={"q": np.concatenate(q).ravel(), "v": np.concatenate(v).ravel(), "lam": np.concatenate([shoulder, elbow])},
        known_to={part: max(apart / modulus, 1e-11) for part, apart in APART.items()} if t_end == 1.0 else {},
        **ABOUT["rigid-limit"],
    )


def rigid_pendulum(meshed=True):
    """Two rigid plates that swing freely from rest.

    Parameters
    ----------
    meshed : bool, True: rigid plates with meshes; False: rigid bodies of their mass and inertia

    Returns
    -------
    Scene
        Bodies "upper", "lower"; joints "shoulder", "elbow"; mass "tip".
    """
    from polyida.mesh import rectangle

    scene, names = Scene(gravity=GRAVITY), ("upper", "lower")
    if meshed:
        mesh = rectangle(LENGTH, HEIGHT, cells=8, seed=1)
        bodies = [Rigid(Plate(mesh, RUBBER, THICKNESS, origin=(k * LENGTH, 0.0), name=name)) for k, name in enumerate(names)]
        sides = [(body.section("left"), body.section("right")) for body in bodies]
    else:
        inertia, points = PLATE_MASS * (LENGTH**2 + HEIGHT**2) / 12, {"left": (-LENGTH / 2, 0.0), "right": (LENGTH / 2, 0.0)}
        bodies = [RigidBody(PLATE_MASS, inertia, points, origin=(k + 0.5, 0.0), name=name) for k, name in enumerate(names)]
        sides = [(body.at("left"), body.at("right")) for body in bodies]
    for body in bodies:
        scene.add(body)
    scene.add(Revolute(ground, sides[0][0], name="shoulder"))
    scene.add(Revolute(sides[0][1], sides[1][0], name="elbow"))
    scene.add(PointMass(sides[1][1], TIP_MASS, name="tip"))
    return scene


def rigid_pendulum_problem(meshed=True):
    """Two rigid plates in a row, swinging freely from rest for 1 s.

    meshed: True: rigid plates with meshes; False: rigid bodies of the same mass and inertia.
    """
    a1, a2, w1, w2 = rigid_motion(1.0)
    arms = LENGTH * np.exp(1j * np.array([a1, a2]))
    place, velocity = arms.sum(), 1j * arms @ [w1, w2]
    return Problem(
        name="rigid-pendulum",
        model=rigid_pendulum(meshed).build(),
        q0=None,
        v0=None,
        t_end=1.0,
        reference={"point": np.array([place.real, place.imag]), "velocity": np.array([velocity.real, velocity.imag])},
        known_to={"point": 1e-11, "velocity": 1e-10},
        measures=point_measures("tip"),
        **ABOUT["rigid-pendulum"],
    )
