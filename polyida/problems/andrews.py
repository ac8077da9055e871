"""Andrews' squeezing mechanism of the IVP test set: seven bodies, three closed loops; M depends on q, forces on v."""

import numpy as np

from polyida.model import Model, Needs
from polyida.problems import Problem
from polyida.problems.about import ABOUT
from polyida.problems.andrews_digits import DIGITS, KNOWN_TO

BETA, THETA, GAMMA, PHI, DELTA, OMEGA, EPSILON = range(7)
m1, m2, m3, m4, m5, m6, m7 = 0.04325, 0.00365, 0.02373, 0.00706, 0.0705, 0.00706, 0.05498
I1, I2, I3, I4, I5, I6, I7 = 2.194e-6, 4.41e-7, 5.255e-6, 5.667e-7, 1.169e-5, 5.667e-7, 1.912e-5
xa, ya, xb, yb, xc, yc = -0.06934, -0.00227, -0.03635, 0.03273, 0.014, 0.072
c0, l0, mom = 4530.0, 0.07785, 0.033
d, da, e, ea, rr, ra = 0.028, 0.0115, 0.02, 0.01421, 0.007, 0.00092
ss, sa, sb, sc, sd = 0.035, 0.01874, 0.01043, 0.018, 0.02
zf, zt, fa, ta, tb, u, ua, ub = 0.02, 0.04, 0.01421, 0.02308, 0.00916, 0.04, 0.01228, 0.00449
h, k = e - ea, zf - fa

# Each loop is a closed chain of arms in the complex plane: sum over arms of ARMS[loop, arm] exp(i angle) = ENDS[loop],
# with the arms' angles TURNS q: beta, beta + Theta, gamma, Phi + delta, delta, Omega + epsilon, epsilon.
TURNS = np.array(
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
TURNED = TURNS.astype(complex)
ARMS = np.array([[rr, -d, 1j * ss, 0, 0, 0, 0], [rr, -d, 0, 1j * e, -zt, 0, 0], [rr, -d, 0, 0, 0, -zf, 1j * u]])
Q0 = np.array(
    [-0.06171389001427645, 0, 0.45527981916307037, 0.22266839016588588, 0.48736497954384256, -0.22266839016588588, 1.2305474445498212]
)
ENDS = np.array([xb + 1j * yb, xa + 1j * ya, xa + 1j * ya])


def _arms(q):
    """The arms of every loop as they stand, complex (3, 7)."""
    return ARMS * np.exp(1j * (TURNS @ q))


def _couplings(masses):
    """What couples beta and Theta, Phi and delta, Omega and epsilon."""
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
        p2, p4, p6 = _couplings(self.masses)
        theta, phi, omega = p2 * np.sin(q[THETA]), p4 * np.cos(q[PHI]), -p6 * np.cos(q[OMEGA])
        result = np.zeros((7, 7))
        result[:2, THETA] = theta * np.array([2 * a[0] + a[1], a[0]])
        result[3:5, PHI] = phi * np.array([a[4], a[3] + 2 * a[4]])
        result[5:, OMEGA] = omega * np.array([a[6], a[5] + 2 * a[6]])
        return result

    def force(self, t, q, v):
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
        p2, p4, p6 = _couplings(self.masses)
        theta, phi, omega = p2 * np.sin(q[THETA]), p4 * np.cos(q[PHI]), p6 * np.cos(q[OMEGA])
        result = np.zeros((7, 7))
        result[:2, :2] = 2 * theta * np.array([[v[1], v[0] + v[1]], [-v[0], 0]])
        result[3:5, 3:5] = 2 * phi * np.array([[0, -v[4]], [v[3] + v[4], v[3]]])
        result[5:, 5:] = 2 * omega * np.array([[0, v[6]], [-v[5] - v[6], -v[5]]])
        return result

    def phi(self, t, q):
        return (_arms(q).sum(axis=1) - ENDS).view(np.float64)

    def phi_q(self, t, q):
        loops = (1j * _arms(q)) @ TURNED
        return np.stack((loops.real, loops.imag), axis=1).reshape(6, 7)

    def phi_bias(self, t, q, v):
        return -(_arms(q) @ ((TURNS @ v) ** 2).astype(np.complex128)).view(np.float64)

    def reaction_q(self, t, q, lam):
        pull = ((lam[::2] - 1j * lam[1::2]) @ _arms(q)).real
        return -(TURNS.T * pull) @ TURNS

    def potential(self, q):
        return self.stiffness / 2 * (_spring(q[GAMMA])[2] - self.rest) ** 2 - self.torque * q[BETA]


def problem():
    """0.03 s from rest; the crank beta turns two and a half times."""
    return Problem(
        name="andrews",
        model=Andrews(),
        v0=np.zeros(7),
        t_end=0.03,
        q0=Q0.copy(),
        reference={part: np.array(value) for part, value in DIGITS.items()},
        known_to=dict(KNOWN_TO),
        **ABOUT["andrews"],
    )
