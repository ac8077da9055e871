"""The double plate in the limit of a large modulus, against the ordinary differential equation of two rigid bodies.

Angles a_k of the plates from +x; each has mass m, half-length L/2 and central inertia m (L^2 + H^2)/12, the tip mass M
sits at the end:

    (4m/3 + M + b) L^2 a1'' + (m/2 + M) L^2 (cos(a1 - a2) a2'' + sin(a1 - a2) a2'^2) + (3m/2 + M) g L cos a1 = 0
    (m/3 + M + b) L^2 a2'' + (m/2 + M) L^2 (cos(a1 - a2) a1'' - sin(a1 - a2) a1'^2) + (m/2 + M) g L cos a2 = 0

with b = m H^2 / (12 L^2).
"""

import numpy as np

from polyida.problems import Problem
from polyida.problems.about import ABOUT
from polyida.problems.plates import GRAVITY, HEIGHT, LENGTH, RUBBER, THICKNESS, TIP_MASS, Material, double_plate
from polyida.validation import positive

PLATE_MASS = RUBBER.rho * LENGTH * HEIGHT * THICKNESS
WEIGHT = -GRAVITY[1]
APART = {"q": 5e5, "v": 4e6, "lam": 5e7}  # times 1 / E: from rigid plates to flexible ones at 1 s, as measured


def accelerations(a1, a2, w1, w2):
    """(a1'', a2'') of the two rigid plates, rad/s2."""
    m, M, L, H = PLATE_MASS, TIP_MASS, LENGTH, HEIGHT
    coupling, apart = (m / 2 + M) * L * L, a1 - a2
    matrix = np.array(
        [
            [(4 * m / 3 + M) * L * L + m * H * H / 12, coupling * np.cos(apart)],
            [coupling * np.cos(apart), (m / 3 + M) * L * L + m * H * H / 12],
        ]
    )
    right = [
        -coupling * np.sin(apart) * w2**2 - (1.5 * m + M) * WEIGHT * L * np.cos(a1),
        coupling * np.sin(apart) * w1**2 - (m / 2 + M) * WEIGHT * L * np.cos(a2),
    ]
    return np.linalg.solve(matrix, right)


def rigid_motion(t_end):
    """(a1, a2, w1, w2) at t_end, from rest along +x; DOP853 at a relative tolerance of 1e-13."""
    from scipy.integrate import solve_ivp

    run = solve_ivp(
        lambda t, y: np.concatenate([y[2:], accelerations(*y)]), (0.0, t_end), np.zeros(4), method="DOP853", rtol=1e-13, atol=1e-14
    )
    return run.y[:, -1]


def problem(modulus=1e13, cells=40, seed=1, t_end=1.0):
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
