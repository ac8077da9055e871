"""A wheelset on a straight track, of the IVP test set: creep forces that depend on normal forces, and contact points as coordinates without mass.

Source: Simeon, Fuehrer and Rentrop, Surveys Math. Indust. 1 (1991) 1-37, with creep forces by Jaschinski; IVP test set (index 2).
The published digits are by DASSL, tolerance 1e-9; KNOWN_TO is their distance from Radau IIA with 64 000 steps.
"""

import numpy as np

from polyida.jit.user_functions import compiled
from polyida.model import Model, Needs
from polyida.problems import ABOUT, Problem

MASS, GRAVITY, SPEED, RADIUS = 16.08, 9.81, 30.0, 0.1  # kg, m/s^2, m/s and m
SPIN_INERTIA, YAW_INERTIA = 0.0605, 0.366  # kg m^2
ARM, STIFFNESS, FRICTION = 0.19, 6400.0, 0.12  # m, N/m: springs to the bogie, in x and z
CONE, HALF_GAUGE, RAIL = 0.0262, 0.1506, 0.06  # rad, m, m
SHEAR, POISSON, ELLIPSE, ROOT = 7.92e10, 0.28, 1.3537956, 0.7115218  # of the contact ellipses, by Hertz
KALKER = 4.72772197, 4.27526987, 1.97203505  # C11, C22, C23
KNOWN_TO = {"place": 6.4e-9, "speed": 1.8e-7, "contact": 7.2e-10, "normal": 1.2e-5}
PI = 3.1415926  # as in the test set
MASSES = np.array([MASS, MASS, MASS, YAW_INERTIA, YAW_INERTIA, SPIN_INERTIA])
LEFT, RIGHT = 6, 8  # places of a contact's (psi, xi) in q
RATE_STEP = 1e-3  # s, of the differences of phi_q along the motion
ROUNDS, EXACT = 50, 1e-14  # of the consistent normal forces

Q0 = np.array(
    [0.14941e-2, 0.40089e-6, 0.11241e-5, -0.28573e-3, 0.26459e-3, 0.0]
    + [7.5634406395172940e-6, 0.1490635714733819, -7.4122380357667139e-6, -0.1521364296121248]
)


def contact(q, side):
    """(R, R', rail's height, slope and curvature, x of the point, its derivatives in theta, phi, psi and xi) of a contact point."""
    st, ct, sp, cp = np.sin(q[3]), np.cos(q[3]), np.sin(q[4]), np.cos(q[4])
    ss, cs, xi = np.sin(q[side]), np.cos(q[side]), q[side + 1]
    slope = -np.sign(xi) * np.tan(CONE)
    r = RADIUS + np.tan(CONE) * (HALF_GAUGE - abs(xi))
    x = q[0] + xi * ct * cp + r * (ct * sp * cs - st * ss)
    off = abs(x) - HALF_GAUGE - np.sin(CONE) * RAIL
    root = np.sqrt(RAIL**2 - off**2)
    rail = root - RADIUS - np.cos(CONE) * RAIL, -np.sign(x) * off / root, -(RAIL**2) / root**3
    x_theta, x_phi = -xi * st * cp - r * (st * sp * cs + ct * ss), ct * (-xi * sp + r * cp * cs)
    return r, slope, *rail, x_theta, x_phi, -r * (ct * sp * ss + st * cs), ct * cp + slope * (ct * sp * cs - st * ss)


def rows(q):
    """The six constraints: of each contact that it touches, and that the normal vectors of wheel and rail are parallel, two numbers."""
    st, ct, sp, cp = np.sin(q[3]), np.cos(q[3]), np.sin(q[4]), np.cos(q[4])
    result = np.zeros(6)
    for k in range(2):
        side = LEFT + 2 * k
        ss, cs = np.sin(q[side]), np.cos(q[side])
        r, slope, height, rail, _, _, _, _, _ = contact(q, side)
        result[k] = height - q[1] - q[side + 1] * sp + r * cp * cs
        result[2 + 2 * k] = rail * (slope * sp + cp * cs) + slope * ct * cp - ct * sp * cs + st * ss
        result[3 + 2 * k] = slope * st * cp - st * sp * cs - ct * ss
    return result


def slopes(q):
    """Jacobian of the constraints `rows` in q, (6, 10)."""
    st, ct, sp, cp = np.sin(q[3]), np.cos(q[3]), np.sin(q[4]), np.cos(q[4])
    B = np.zeros((6, 10))
    for k in range(2):
        side, touch, a, b = LEFT + 2 * k, k, 2 + 2 * k, 3 + 2 * k
        ss, cs, xi = np.sin(q[side]), np.cos(q[side]), q[side + 1]
        r, slope, _, rail, curvature, x_theta, x_phi, x_psi, x_xi = contact(q, side)
        normal = slope * sp + cp * cs
        for column, x in ((0, 1.0), (3, x_theta), (4, x_phi), (side, x_psi), (side + 1, x_xi)):
            B[touch, column], B[a, column] = rail * x, curvature * normal * x
        B[touch, 1] = -1.0
        B[touch, 4] -= xi * cp + r * sp * cs
        B[touch, side] -= r * cp * ss
        B[touch, side + 1] += slope * cp * cs - sp
        B[a, 3] += st * (sp * cs - slope * cp) + ct * ss
        B[a, 4] += rail * (slope * cp - sp * cs) - ct * (slope * sp + cp * cs)
        B[a, side] += (ct * sp - rail * cp) * ss + st * cs
        B[b, 3] = ct * (slope * cp - sp * cs) + st * ss
        B[b, 4] = -st * normal
        B[b, side] = st * sp * ss - ct * cs
    return B


def creep(q, v, side, s, c, normal):
    """The creep force, (3,), of a contact with the normal force; s, c: sine and cosine of the angle of its plane."""
    st, ct, sp, cp = np.sin(q[3] / c), np.cos(q[3] / c), np.sin(q[4]), np.cos(q[4])
    ss, cs, xi, spin = np.sin(q[side]), np.cos(q[side]), q[side + 1], SPEED / RADIUS + v[5]
    r, slope, _, rail, curvature, _, _, _, _ = contact(q, side)
    up = xi * sp - r * cp * cs
    x = -spin * r * (st * cs + ct * sp * ss) - v[3] * (r * (st * sp * cs + ct * ss) + xi * st * cp) - v[4] * ct * up
    y = spin * r * cp * ss + v[4] * (xi * cp + r * sp * cs)
    z = -spin * r * (ct * cs - st * sp * ss) - v[3] * (xi * ct * cp + r * (ct * sp * cs - st * ss)) + v[4] * st * up
    rolling = 0.5 * np.sqrt((x - v[0]) ** 2 + (y - v[1]) ** 2 + (z - v[2] - SPEED) ** 2)
    x, y, z = x + v[0], y + v[1], z + v[2] + SPEED
    along, across = (st * x + ct * z) / rolling, (c * (ct * x - st * z) + s * y) / rolling
    turn = (c * v[3] - s * spin) / rolling
    curvatures = 0.5 / (r * np.sqrt(1.0 + slope**2)) - 0.5 * curvature / (1.0 + rail**2) ** 1.5
    size = (3.0 * abs(normal) * (1.0 - POISSON) * ELLIPSE / (2.0 * PI * curvatures * SHEAR * np.sqrt(ROOT))) ** (1.0 / 3.0)
    most, stiffness = FRICTION * normal, SHEAR * size**2
    force = -most * np.tanh(stiffness * KALKER[0] * along / most)
    lateral = -most * np.tanh(stiffness * (KALKER[1] * across + size * KALKER[2] * turn) / most)
    share = min(1.0, abs(most) / np.hypot(force, lateral))
    force, lateral = share * force, share * lateral
    return np.array([st * force + ct * c * lateral, s * lateral, ct * force - st * c * lateral])


def forces(q, v, B, lam):
    """g of `M a + g + phi_q^T lam = 0` with the normal forces of the multipliers, (10,), without the term of theta'' in the spin."""
    st, ct, sp, cp = np.sin(q[3]), np.cos(q[3]), np.sin(q[4]), np.cos(q[4])
    spin, angles = SPEED / RADIUS + v[5], np.zeros((2, 2))
    for k in range(2):
        side = LEFT + 2 * k
        ss, cs, slope = np.sin(q[side]), np.cos(q[side]), contact(q, side)[1]
        angle = np.arctan(-((slope * cp - sp * cs) * ct + ss * st) / (slope * sp + cs * cp))
        angles[k] = np.sin(angle), np.cos(angle)
    (sl, cl), (sr, cr) = angles
    across, down = -B[0, 0] * lam[0] - B[1, 0] * lam[1], lam[0] + lam[1]
    determinant = sr * cl - sl * cr
    normals = (cr * across + sr * down) / determinant, (-cl * across - sl * down) / determinant
    g = np.zeros(10)
    g[0], g[1], g[2] = 2.0 * STIFFNESS * q[0], MASS * GRAVITY, 2.0 * STIFFNESS * q[2]
    moment, more = -2.0 * ARM**2 * STIFFNESS * q[3], SPIN_INERTIA - YAW_INERTIA
    g[3] = SPIN_INERTIA * spin * v[4] + (more - YAW_INERTIA) * v[3] * v[4] * sp - cp * moment
    g[4] = -SPIN_INERTIA * spin * v[3] * cp - more * v[3] ** 2 * sp * cp
    g[5] = SPIN_INERTIA * v[3] * v[4] * cp - sp * moment
    for k in range(2):
        side = LEFT + 2 * k
        ss, cs, xi, r = np.sin(q[side]), np.cos(q[side]), q[side + 1], contact(q, side)[0]
        f = creep(q, v, side, angles[k, 0], angles[k, 1], normals[k])
        g[:3] -= f
        g[3] += (xi * st + r * ss * ct * cp) * f[0] + r * ss * sp * f[1] + (xi * ct - r * ss * st * cp) * f[2]
        g[4] += (xi * sp - r * cs * cp) * (ct * f[0] - st * f[2]) - (xi * cp + r * cs * sp) * f[1]
        g[5] += r * ((cs * st + ss * ct * sp) * f[0] - ss * cp * f[1] + (cs * ct - ss * st * sp) * f[2])
    return g


def consistent_forces(q, v):
    """g with the multipliers and theta'' that are consistent with q and v."""
    B, masses, cp = slopes(q), MASSES.copy(), np.cos(q[4])
    masses[3] *= cp
    bias = np.zeros(2)
    for k in range(4):
        s, weight = ((1.0, 8.0), (-1.0, -8.0), (2.0, -1.0), (-2.0, 1.0))[k]
        bias += weight / (12.0 * RATE_STEP) * (np.ascontiguousarray(slopes(q + s * RATE_STEP * v)[:2]) @ v)
    touch = np.ascontiguousarray(B[:2, :6])
    flexibility = (touch / masses) @ touch.T
    lam, yaw, g = np.full(2, 0.5 * MASS * GRAVITY), 0.0, np.zeros(10)
    for _ in range(ROUNDS):
        before = lam
        g = forces(q, v, B, lam)
        g[5] += SPIN_INERTIA * np.sin(q[4]) * yaw
        lam = np.linalg.solve(flexibility, bias - touch @ (g[:6] / masses))
        yaw = -(g[3] + touch[0, 3] * lam[0] + touch[1, 3] * lam[1]) / masses[3]
        if np.abs(lam - before).max() <= EXACT * np.abs(lam).max():
            break
    return g


@compiled
class Wheelset(Model):
    """q = (x, y, z, theta, phi, spin, psi and xi of the left and of the right contact).

    x is across, y upward and z along the track; theta is the yaw, phi the roll, and the spin is relative to rolling at constant speed. The
    contacts' psi and xi have no mass, and the multipliers of the rows of phi that determine them are zero. Creep forces depend on normal forces,
    so that `residual` has those of lam, and `force`, for the start, those that are consistent with q and v. `offset` (6,): phi at the start of
    the test set, which solves the constraints in velocities only.
    """

    n, m = 10, 6
    needs = Needs(driven=False)
    offset = rows(Q0)

    def mass(self, q):
        """Mass matrix M(q), (10, 10), zero for psi and xi of the contacts."""
        M = np.zeros((10, 10))
        for k in range(6):
            M[k, k] = MASSES[k]
        M[3, 3] *= np.cos(q[4])
        return M

    def force(self, t, q, v):
        """Vector g of `M a + g + phi_q^T lam = 0`, (10,), with creep forces of normal forces that are consistent with q and v."""
        return consistent_forces(q, v)

    def phi(self, t, q):
        """The six constraints, (6,), shifted to be zero at the start of the test set."""
        return rows(q) - self.offset

    def phi_q(self, t, q):
        """Jacobian of the constraints in q, (6, 10)."""
        return slopes(q)

    def residual(self, t, q, v, a, lam):
        """Residual r (10,) with the creep forces of the normal forces in lam."""
        B = slopes(q)
        r = forces(q, v, B, lam) + B.T @ lam
        r[:6] += MASSES * a[:6]
        r[3] += (np.cos(q[4]) - 1.0) * YAW_INERTIA * a[3]
        r[5] += SPIN_INERTIA * np.sin(q[4]) * a[3]
        return r


def problem():
    """A wheelset on a straight track, of the IVP test set: creep forces depend on normal forces.

    10 s of hunting at 30 m/s from a small displacement; the multipliers of the two contacts are in N.
    """
    return Problem(
        name="wheelset",
        model=Wheelset(),
        t_end=10.0,
        q0=Q0,
        v0=np.zeros(10),
        reference={
            "place": np.array([0.86355386965811e-2, 0.13038281022727e-4, -0.93635784016818e-4, -0.13642299804033e-1, 0.15292895005422e-2]),
            "speed": np.array(
                [
                    -0.76985374142666e-1,
                    -0.25151106429207e-3,
                    0.20541188079539e-2,
                    -0.23904837703692,
                    -0.13633468454173e-1,
                    -0.24421377661131,
                ]
            ),
            "contact": np.array([0.37839614386969e-3, 0.14173214964613, -0.33666751972196e-3, -0.15949425684022]),
            "normal": np.array([101.24044903201, 56.285630573753]),
        },
        known_to=KNOWN_TO,
        measures={
            "place": lambda run: run.q[-1, :5],
            "speed": lambda run: run.v[-1, :6],
            "contact": lambda run: run.q[-1, 6:],
            "normal": lambda run: run.lam[-1, :2],
        },
        **ABOUT["wheelset"],
    )
