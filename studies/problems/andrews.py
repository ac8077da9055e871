"""Andrews' squeezing mechanism: seven bodies, three closed loops; as a model in angles, and as a scene of rigid bodies.

DIGITS, the solution at 0.03 s, are by 500 extrapolated midpoint steps of order 16 on the index-1 equations in long double, projected onto
the constraints 25 times; 400 steps agree to 6e-16 rad, 2e-13 rad/s, 7e-10 rad/s2 and 4e-14 N. Runs in double precision come to within
KNOWN_TO: DOP853, rtol 1e-13 (`python studies/digits.py andrews`), to 1e-13 rad. Below that the error estimates are round-off: DOP853 with
rtol 2.3e-14 scatters by 4e-12 rad, Radau IIA with rtol 1e-13 by 2e-12 to 3e-11 rad. PRINTED, the digits of the IVP test set (PSIDE), are
1.4e-9 rad, 5.4e-7 rad/s, 0.06 rad/s2 and 1.5e-5 N away.

Source: Schiehlen (ed.), Multibody Systems Handbook (1990); Hairer and Wanner, Solving Ordinary Differential Equations II, VII.7; IVP test
set.
"""

import numpy as np

from polyida.body.rigid_body import RigidBody
from polyida.force.loads import Torque
from polyida.force.springs import SpringDamper
from polyida.joint.attachment import ground
from polyida.joint.joints import Revolute
from polyida.model import Model, Needs
from polyida.problems import ABOUT, Problem
from polyida.scene import Scene


def _numbers(texts):
    """{part: (k,) floats} of texts {part: numbers separated by blanks}."""
    return {part: np.array(text.split(), float) for part, text in texts.items()}


DIGITS = _numbers(
    {
        "q": "15.810771195153706 -15.756371058411837 0.04082224011964577 -0.5347301163420798 "
        "0.524409965879954 0.5347301163420798 1.048080741041938",
        "v": "1139.9203022591062 -1424.3792951775404 11.032911910617946 19.29337410503091 "
        "0.5735699148294708 -19.29337410503091 0.3231791492491102",
        "a": "-24631.763122872388 51850.31963646078 324102.60070757876 566749.4220009956 "
        "16743.635418345522 -566749.4220009956 9826.507801544078",
        "lam": "199.1753481045387 -29.755309974971638 23.06654361162217 31.45272527577128 22.64249478639439 11.617392352611164",
    }
)
PRINTED = _numbers(
    {
        "q": "15.81077119629904 -15.75637105984298 0.04082224013073101 -0.5347301163226948 "
        "0.5244099658805303 0.5347301163226948 1.048080741042263",
        "v": "1139.920302151208 -1424.379294994111 11.03291221937134 19.29337464421385 "
        "0.5735699284790808 -19.29337464421385 0.3231791658026955",
        "a": "-24631.76316946196 51850.37701610329 324102.5686413781 566749.3645176213 "
        "16743.62929479361 -566749.3645176222 9826.520791458423",
        "lam": "199.175333373191 -29.75531228015052 23.06654119098399 31.45271365475927 22.64249232082739 11.61740700019673",
    }
)
KNOWN_TO = {"q": 2.6e-12, "v": 1e-9, "a": 3.1e-6, "lam": 1.7e-10}

BETA, THETA, GAMMA, PHI, DELTA, OMEGA, EPSILON = range(7)
m1, m2, m3, m4, m5, m6, m7 = 0.04325, 0.00365, 0.02373, 0.00706, 0.0705, 0.00706, 0.05498
I1, I2, I3, I4, I5, I6, I7 = 2.194e-6, 4.41e-7, 5.255e-6, 5.667e-7, 1.169e-5, 5.667e-7, 1.912e-5
xa, ya, xb, yb, xc, yc = -0.06934, -0.00227, -0.03635, 0.03273, 0.014, 0.072
c0, l0, mom = 4530.0, 0.07785, 0.033
d, da, e, ea, rr, ra = 0.028, 0.0115, 0.02, 0.01421, 0.007, 0.00092
ss, sa, sb, sc, sd = 0.035, 0.01874, 0.01043, 0.018, 0.02
zf, zt, fa, ta, tb, u, ua, ub = 0.02, 0.04, 0.01421, 0.02308, 0.00916, 0.04, 0.01228, 0.00449
h, k = e - ea, zf - fa

TURNS = np.array(  # the angles of the bodies' arms are TURNS q: beta, beta + Theta, gamma, Phi + delta, delta, Omega + epsilon, epsilon
    [
        [1, 0, 0, 0, 0, 0, 0],
        [1, 1, 0, 0, 0, 0, 0],
        [0, 0, 1, 0, 0, 0, 0],
        [0, 0, 0, 1, 1, 0, 0],
        [0, 0, 0, 0, 1, 0, 0],
        [0, 0, 0, 0, 0, 1, 1],
        [0, 0, 0, 0, 0, 0, 1],
    ],
    float,
)
Q0 = np.array(
    [-0.06171389001427645, 0, 0.45527981916307037, 0.22266839016588588, 0.48736497954384256, -0.22266839016588588, 1.2305474445498212]
)


def _arms(q):
    """Cosines and sines of the angles of the arms, (7,) each."""
    angles = np.array([q[0], q[0] + q[1], q[2], q[3] + q[4], q[4], q[5] + q[6], q[6]])
    return np.cos(angles), np.sin(angles)


def _couplings(masses):
    """Factors of the mass matrix, kg m^2, that couple beta and Theta, Phi and delta, Omega and epsilon."""
    return masses[1] * da * rr, masses[3] * zt * h, masses[5] * u * k


def _spring(gamma):
    """Arm of the spring from (xc, yc), its derivative by gamma and its length."""
    turn = np.exp(1j * gamma)
    arm = (sd - 1j * sc) * turn + xb - xc + 1j * (yb - yc)
    return arm, (sc + 1j * sd) * turn, abs(arm)


class Andrews(Model):
    """q = (beta, Theta, gamma, Phi, delta, Omega, epsilon) in rad; phi in m; lam in N.

    Parameters: torque on the crank, N m, stiffness of the spring, N/m, and its length at rest, m, masses of the bodies (7,), kg.
    """

    n, m = 7, 6
    needs = Needs(driven=False)
    parameters = "torque", "stiffness", "rest", "masses"
    torque, stiffness, rest, masses = mom, c0, l0, np.array([m1, m2, m3, m4, m5, m6, m7])

    def mass(self, q):
        """Mass matrix M(q), (7, 7)."""
        m, cos_theta, sin_phi, sin_omega = self.masses, np.cos(q[THETA]), np.sin(q[PHI]), np.sin(q[OMEGA])
        M = np.zeros((7, 7))
        M[0, 0] = m[0] * ra**2 + m[1] * (rr**2 - 2 * da * rr * cos_theta + da**2) + I1 + I2
        M[0, 1] = M[1, 0] = m[1] * (da**2 - da * rr * cos_theta) + I2
        M[1, 1] = m[1] * da**2 + I2
        M[2, 2] = m[2] * (sa**2 + sb**2) + I3
        M[3, 3] = m[3] * h**2 + I4
        M[3, 4] = M[4, 3] = m[3] * (h**2 + zt * h * sin_phi) + I4
        M[4, 4] = m[3] * (zt**2 + 2 * zt * h * sin_phi + h**2) + m[4] * (ta**2 + tb**2) + I4 + I5
        M[5, 5] = m[5] * k**2 + I6
        M[5, 6] = M[6, 5] = m[5] * (k**2 - u * k * sin_omega) + I6
        M[6, 6] = m[5] * (k**2 - 2 * u * k * sin_omega + u**2) + m[6] * (ua**2 + ub**2) + I6 + I7
        return M

    def mass_a_q(self, q, a):
        """Derivative of M(q) a in q, (7, 7)."""
        p2, p4, p6 = _couplings(self.masses)
        theta, phi, omega = p2 * np.sin(q[THETA]), p4 * np.cos(q[PHI]), -p6 * np.cos(q[OMEGA])
        result = np.zeros((7, 7))
        result[:2, THETA] = theta * np.array([2 * a[0] + a[1], a[0]])
        result[3:5, PHI] = phi * np.array([a[4], a[3] + 2 * a[4]])
        result[5:, OMEGA] = omega * np.array([a[6], a[5] + 2 * a[6]])
        return result

    def force(self, t, q, v):
        """Forces g(q, v), (7,): centrifugal terms, spring and torque."""
        p2, p4, p6 = _couplings(self.masses)
        arm, turn, length = _spring(q[GAMMA])
        theta, phi, omega = p2 * np.sin(q[THETA]), p4 * np.cos(q[PHI]), p6 * np.cos(q[OMEGA])
        return np.array(
            [
                theta * v[1] * (v[1] + 2 * v[0]) - self.torque,
                -theta * v[0] ** 2,
                self.stiffness * (1 - self.rest / length) * (arm.conjugate() * turn).real,
                -phi * v[4] ** 2,
                phi * v[3] * (v[3] + 2 * v[4]),
                omega * v[6] ** 2,
                -omega * v[5] * (v[5] + 2 * v[6]),
            ]
        )

    def force_q(self, t, q, v):
        """Derivative of g in q, (7, 7)."""
        p2, p4, p6 = _couplings(self.masses)
        arm, turn, length = _spring(q[GAMMA])
        along, bend = (arm.conjugate() * turn).real, (arm.conjugate() * 1j * turn).real
        theta, phi, omega = p2 * np.cos(q[THETA]), -p4 * np.sin(q[PHI]), -p6 * np.sin(q[OMEGA])
        result = np.zeros((7, 7))
        result[:2, THETA] = theta * np.array([v[1] * (v[1] + 2 * v[0]), -(v[0] ** 2)])
        result[GAMMA, GAMMA] = self.stiffness * (self.rest * along**2 / length**3 + (1 - self.rest / length) * (abs(turn) ** 2 + bend))
        result[3:5, PHI] = phi * np.array([-(v[4] ** 2), v[3] * (v[3] + 2 * v[4])])
        result[5:, OMEGA] = omega * np.array([v[6] ** 2, -v[5] * (v[5] + 2 * v[6])])
        return result

    def force_v(self, t, q, v):
        """Derivative of g in v, (7, 7)."""
        p2, p4, p6 = _couplings(self.masses)
        theta, phi, omega = p2 * np.sin(q[THETA]), p4 * np.cos(q[PHI]), p6 * np.cos(q[OMEGA])
        result = np.zeros((7, 7))
        result[:2, :2] = 2 * theta * np.array([[v[1], v[0] + v[1]], [-v[0], 0]])
        result[3:5, 3:5] = 2 * phi * np.array([[0, -v[4]], [v[3] + v[4], v[3]]])
        result[5:, 5:] = 2 * omega * np.array([[0, v[6]], [-v[5] - v[6], -v[5]]])
        return result

    def phi(self, t, q):
        """Constraints phi(q), (6,), m: the three loops close at E, at A and at A."""
        c, s = _arms(q)
        x, y = rr * c[0] - d * c[1], rr * s[0] - d * s[1]  # E, where the three loops meet
        return np.array(
            [
                x - ss * s[2] - xb,
                y + ss * c[2] - yb,
                x - e * s[3] - zt * c[4] - xa,
                y + e * c[3] - zt * s[4] - ya,
                x - zf * c[5] - u * s[6] - xa,
                y - zf * s[5] + u * c[6] - ya,
            ]
        )

    def phi_q(self, t, q):
        """Jacobian of the constraints, (6, 7)."""
        c, s = _arms(q)
        result = np.zeros((6, 7))
        result[::2, BETA], result[1::2, BETA] = d * s[1] - rr * s[0], rr * c[0] - d * c[1]
        result[::2, THETA], result[1::2, THETA] = d * s[1], -d * c[1]
        result[0, GAMMA], result[1, GAMMA] = -ss * c[2], -ss * s[2]
        result[2, PHI], result[3, PHI] = -e * c[3], -e * s[3]
        result[2, DELTA], result[3, DELTA] = zt * s[4] - e * c[3], -zt * c[4] - e * s[3]
        result[4, OMEGA], result[5, OMEGA] = zf * s[5], -zf * c[5]
        result[4, EPSILON], result[5, EPSILON] = zf * s[5] - u * c[6], -zf * c[5] - u * s[6]
        return result

    def phi_bias(self, t, q, v):
        """Second derivative of phi in time for a = 0, (6,)."""
        c, s = _arms(q)
        beta, theta, gamma, phi = v[0] ** 2, (v[0] + v[1]) ** 2, v[2] ** 2, (v[3] + v[4]) ** 2
        delta, omega, epsilon = v[4] ** 2, (v[5] + v[6]) ** 2, v[6] ** 2
        x, y = d * c[1] * theta - rr * c[0] * beta, d * s[1] * theta - rr * s[0] * beta
        return np.array(
            [
                x + ss * s[2] * gamma,
                y - ss * c[2] * gamma,
                x + e * s[3] * phi + zt * c[4] * delta,
                y - e * c[3] * phi + zt * s[4] * delta,
                x + zf * c[5] * omega + u * s[6] * epsilon,
                y + zf * s[5] * omega - u * c[6] * epsilon,
            ]
        )

    def reaction_q(self, t, q, lam):
        """Derivative of phi_q^T lam in q, (7, 7)."""
        c, s = _arms(q)
        x, y = lam[0] + lam[2] + lam[4], lam[1] + lam[3] + lam[5]
        result = np.zeros((7, 7))
        result[:2, :2] = d * (c[1] * x + s[1] * y)
        result[BETA, BETA] -= rr * (c[0] * x + s[0] * y)
        result[GAMMA, GAMMA] = ss * (s[2] * lam[0] - c[2] * lam[1])
        result[3:5, 3:5] = e * (s[3] * lam[2] - c[3] * lam[3])
        result[DELTA, DELTA] += zt * (c[4] * lam[2] + s[4] * lam[3])
        result[5:, 5:] = zf * (c[5] * lam[4] + s[5] * lam[5])
        result[EPSILON, EPSILON] += u * (s[6] * lam[4] - c[6] * lam[5])
        return result

    def potential(self, q):
        """Potential energy of the spring and of the constant motor torque, `k (l - l0)^2 / 2 - M beta`, J."""
        return self.stiffness / 2 * (_spring(q[GAMMA])[2] - self.rest) ** 2 - self.torque * q[BETA]


def problem():
    """Andrews' squeezing mechanism in angles: seven bodies, three closed loops.

    0.03 s from rest; the crank beta turns two and a half times.
    """
    return Problem(
        name="andrews",
        model=Andrews(),
        v0=np.zeros(7),
        t_end=0.03,
        q0=Q0.copy(),
        reference=dict(DIGITS),
        known_to=dict(KNOWN_TO),
        **ABOUT["andrews"],
    )


BODIES = {  # mass, inertia, centre of mass, pins and other points, in own axes from the first of them, m; E joins K2, K3, K4 and K6
    "K1": (m1, I1, (ra, 0.0), {"O": (0.0, 0.0), "P": (rr, 0.0)}),
    "K2": (m2, I2, (-da, 0.0), {"P": (0.0, 0.0), "E": (-d, 0.0)}),
    "K3": (m3, I3, (sb, -sa), {"B": (0.0, 0.0), "E": (0.0, -ss), "D": (sd, -sc)}),
    "K4": (m4, I4, (0.0, -h), {"G": (0.0, 0.0), "E": (0.0, -e)}),
    "K5": (m5, I5, (ta, -tb), {"A": (0.0, 0.0), "G": (zt, 0.0)}),
    "K6": (m6, I6, (k, 0.0), {"H": (0.0, 0.0), "E": (zf, 0.0)}),
    "K7": (m7, I7, (ub, -ua), {"A": (0.0, 0.0), "H": (0.0, -u)}),
}
GROUND = {"K1": "O", "K3": "B", "K5": "A", "K7": "A"}
PINS = (("K1", "K2", "P"), ("K2", "K3", "E"), ("K2", "K4", "E"), ("K2", "K6", "E"), ("K4", "K5", "G"), ("K6", "K7", "H"))
GYRATION = np.array([np.sqrt(inertia / mass) for mass, inertia, *_ in BODIES.values()])  # m, the unit of their turn in q
ANGLES = TURNS @ Q0  # of the bodies at the start, rad


def places():
    """{name of a pin: its place at the start, complex, m}, of those at which the bodies' axes begin."""
    z, A = np.exp(1j * ANGLES), complex(xa, ya)
    return {"O": 0j, "A": A, "B": complex(xb, yb), "P": rr * z[0], "G": A + zt * z[4], "H": A - 1j * u * z[6]}


def andrews():
    """The mechanism as a scene of rigid bodies at the published start.

    Bodies K1 to K7 have pins at (0, 0), A and B on the ground; all but K1 and K3 form three loops. The axes of each body are turned by the
    angle of its first direction in the equations: beta (K1), beta + Theta (K2), gamma (K3), Phi + delta (K4), delta (K5), Omega + epsilon
    (K6), epsilon (K7).

    Returns
    -------
    Scene
        Bodies "K1" to "K7"; torque "drive" on K1; "spring" from the ground to the point D of K3.
    """
    scene, at, bodies = Scene(), {pin: (place.real, place.imag) for pin, place in places().items()}, {}
    for (name, (mass, inertia, center, points)), angle in zip(BODIES.items(), ANGLES):
        body = RigidBody(mass, inertia, points, origin=at[next(iter(points))], angle=angle, center=center, name=name)
        bodies[name] = scene.add(body)
    for name, pin in GROUND.items():
        scene.add(Revolute(ground.at(at[pin]), bodies[name].at(pin), name=f"{pin} of {name}"))
    for one, other, pin in PINS:
        scene.add(Revolute(bodies[one].at(pin), bodies[other].at(pin), name=f"{pin} of {one} and {other}"))
    scene.add(SpringDamper(ground.at((xc, yc)), bodies["K3"].at("D"), stiffness=c0, length=l0, name="spring"))
    scene.add(Torque(bodies["K1"].at("O"), mom, name="drive"))
    return scene


def directions(q):
    """What q (..., 28), or v, adds to the directions, of length one, of the seven bodies, complex, (..., 7)."""
    return q.reshape(*q.shape[:-1], 7, 2, 2)[..., 1, :] @ (1, 1j) / GYRATION


def angles(run):
    """(beta, Theta, gamma, Phi, delta, Omega, epsilon) in every frame, (frames, 7), rad; frames must be less than half a turn apart."""
    z = np.exp(1j * ANGLES) + directions(run.q[:])
    return np.linalg.solve(TURNS, np.unwrap(np.angle(z), axis=0).T).T


def rates(run):
    """Rates of the seven angles in every frame of a run of the scene, (frames, 7), rad/s."""
    z = np.exp(1j * ANGLES) + directions(run.q[:])
    return np.linalg.solve(TURNS, (z.conj() * directions(run.v[:])).imag.T).T


def at_end(run):
    """The angles at the end of a run, whose frames may be few: whole turns are those of the reference."""
    angle, known = angles(run)[-1], DIGITS["q"]
    return angle + 2 * np.pi * np.round((known - angle) / (2 * np.pi))


def parts_problem():
    """Andrews' mechanism made of seven rigid bodies, 0.03 s from rest."""
    return Problem(
        name="andrews-parts",
        model=andrews().build(),
        q0=None,
        v0=None,
        t_end=0.03,
        reference={"angles": DIGITS["q"], "rates": DIGITS["v"]},
        known_to={"angles": KNOWN_TO["q"], "rates": KNOWN_TO["v"]},
        measures={"angles": at_end, "rates": lambda run: rates(run)[-1]},
        **ABOUT["andrews-parts"],
    )
