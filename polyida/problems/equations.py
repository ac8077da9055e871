"""Two problems of the literature, as equations: the pendulum in Cartesian coordinates and the car axis; both have index 3."""

import numpy as np

from polyida.model import Model, Needs
from polyida.problems import ABOUT, Problem

TABLE = (  # t, x, y
    (1.0, 0.9862917511318754, -0.165010853125541),
    (2.0, -0.793566195343323, -0.60848393044379),
    (5.0, -0.9423054350437567, -0.3347543384140022),
    (9.99, -0.31643646991303187, -0.9486137045757767),
    (10.0, -0.275087462576117, -0.961419205099125),
)


class Pendulum(Model):
    """Point mass m = 1 kg on a rod L = 1 m under g = 9.81 m/s^2; q = (x, y), `phi = (x^2 + y^2 - L^2) / (2 L)` in m.

    lam is the tension of the rod in N.
    """

    n, m = 2, 1
    needs = Needs(mass_varies=False, velocity_forces=False, driven=False)
    parameters = "weight", "length", "gravity"
    weight, length, gravity = 1.0, 1.0, 9.81

    def mass(self, q):
        """Mass matrix, (2, 2), kg, constant."""
        return self.weight * np.eye(2)

    def force(self, t, q, v):
        """Vector g of `M a + g + phi_q^T lam = 0`, (2,), N: the weight with the opposite sign."""
        return np.array([0.0, self.weight * self.gravity])

    def phi(self, t, q):
        """Constraint `(|q|^2 - L^2) / (2 L)`, (1,), m."""
        return np.array([(q @ q - self.length**2) / (2 * self.length)])

    def phi_q(self, t, q):
        """Jacobian of phi, `q^T / L`, (1, 2)."""
        return q[None] / self.length

    def force_q(self, t, q, v):
        """Derivative of g in q, (2, 2), which is zero."""
        return np.zeros((2, 2))

    def reaction_q(self, t, q, lam):
        """Derivative of phi_q^T lam in q, `lam / L` times the identity, (2, 2), N/m."""
        return lam[0] / self.length * np.eye(2)

    def phi_bias(self, t, q, v):
        """Part of phi'' that does not depend on accelerations, `|v|^2 / L`, (1,), m/s^2."""
        return np.array([v @ v / self.length])

    def residual_p(self, name, t, q, v, a, lam):
        """Derivative of the residual `M a + g + phi_q^T lam` in the parameter of that name, (2,)."""
        up = np.array([0.0, 1.0])
        slopes = {"weight": a + self.gravity * up, "length": -lam[0] / self.length**2 * q, "gravity": self.weight * up}
        return slopes[name]

    def phi_p(self, name, t, q):
        """Derivative of phi at q in the parameter of that name, (1,); zero for every parameter but "length"."""
        return np.array([-(q @ q + self.length**2) / (2 * self.length**2) if name == "length" else 0.0])

    def potential(self, q):
        """Potential energy of the weight, J, zero at y = 0."""
        return self.weight * self.gravity * q[1]


def pendulum_problem():
    """Return the Problem of the planar pendulum in Cartesian coordinates: the smallest index-3 problem with a closed solution.

    From rest at (-1, 0) for 10 s, a little over four periods; v and lam follow from the energy, which is 0 J.
    """
    x, y = TABLE[-1][1:]
    speed, tension = np.sqrt(-2 * Pendulum.gravity * y), -3 * Pendulum.weight * Pendulum.gravity * y / Pendulum.length
    return Problem(
        name="pendulum",
        model=Pendulum(),
        q0=np.array([-1.0, 0.0]),
        v0=np.zeros(2),
        t_end=10.0,
        reference={"q": np.array([x, y]), "v": speed * np.array([-y, x]), "lam": np.array([tension])},
        known_to={"q": 4e-12, "v": 2e-11, "lam": 6e-11},  # how near both DOP853, rtol 2.3e-14, and Radau IIA, rtol 1e-12, come
        **ABOUT["pendulum"],
    )


L, L0, RADIUS, OMEGA = 1.0, 0.5, 0.1, 10.0
MASS = 10 * 0.01**2 / 2
PAIR = np.kron([[1.0, -1.0], [-1.0, 1.0]], np.eye(2))  # |left - right|^2 = q^T PAIR q


def road(t, radius=RADIUS):
    """Position, velocity and acceleration of the driven wheel (xb, yb), each (2,)."""
    y, dy = radius * np.sin(OMEGA * t), radius * OMEGA * np.cos(OMEGA * t)
    ddy = -(OMEGA**2) * y
    x = np.sqrt(L**2 - y**2)
    dx = -y * dy / x
    return np.array([x, y]), np.array([dx, dy]), np.array([-(dy**2 + y * ddy + dx**2) / x, ddy])


def _spring(arm):
    """Force (2,) and stiffness (2, 2) of a spring of length L0 and stiffness 1 along `arm`."""
    length = np.hypot(arm[0], arm[1])
    along = np.outer(arm, arm) / length**2
    return (length - L0) * arm / length, along + (1 - L0 / length) * (np.eye(2) - along)


class CarAxis(Model):
    """q = (xl, yl, xr, yr); `phi = (xl xb + yl yb, |left - right|^2 - L^2)`, with the road (xb, yb) prescribed.

    Parameters: mass of a wheel, kg, and radius of the road's waves, m.
    """

    n, m = 4, 2
    needs = Needs(mass_varies=False, velocity_forces=False)
    parameters = "weight", "radius"
    weight, radius = MASS, RADIUS

    def mass(self, q):
        """Mass matrix, (4, 4), kg, constant."""
        return self.weight * np.eye(4)

    def force(self, t, q, v):
        """Vector g of `M a + g + phi_q^T lam = 0`, (4,): springs and weight with the opposite sign."""
        wheel = road(t, self.radius)[0]
        return np.concatenate((_spring(q[:2])[0], _spring(q[2:] - wheel)[0])) + self.weight * np.array([0.0, 1.0, 0.0, 1.0])

    def phi(self, t, q):
        """The two constraints: (xl xb + yl yb, |left - right|^2 - L^2), (2,), m^2."""
        apart = q[:2] - q[2:]
        return np.array([q[:2] @ road(t, self.radius)[0], apart @ apart - L**2])

    def phi_q(self, t, q):
        """Jacobian of phi in q, (2, 4), m."""
        return np.vstack((np.append(road(t, self.radius)[0], np.zeros(2)), 2 * PAIR @ q))

    def force_q(self, t, q, v):
        """Derivative of g in q, (4, 4): the stiffness of both springs."""
        result = np.zeros((4, 4))
        result[:2, :2], result[2:, 2:] = _spring(q[:2])[1], _spring(q[2:] - road(t, self.radius)[0])[1]
        return result

    def reaction_q(self, t, q, lam):
        """Derivative of phi_q^T lam in q, (4, 4), constant but for lam[1]."""
        return 2 * lam[1] * PAIR

    def phi_t(self, t, q):
        """Derivative of phi in t at constant q, (2,), m^2/s."""
        return np.array([q[:2] @ road(t, self.radius)[1], 0.0])

    def phi_bias(self, t, q, v):
        """The terms of the second time derivative phi'' without accelerations, (2,), m^2/s^2: `phi'' = phi_q a + phi_bias`."""
        _, velocity, acceleration = road(t, self.radius)
        return np.array([2 * v[:2] @ velocity + q[:2] @ acceleration, 2 * v @ PAIR @ v])


def car_axis_problem():
    """The car axis of the IVP test set: two wheels on stiff springs, one of them driven over a bumpy road; index 3.

    3 s of the road, nearly five periods; multipliers in the sign of `M a + g + phi_q^T lam = 0`.
    """
    return Problem(
        name="car-axis",
        model=CarAxis(),
        t_end=3.0,
        q0=np.array([0.0, 0.5, 1.0, 0.5]),
        v0=np.array([-0.5, 0.0, -0.5, 0.0]),
        reference={
            "q": np.array([0.04934557842754028, 0.49698946023017115, 1.0417425248854215, 0.37391102726536124]),
            "v": np.array([-0.07705836840409723, 0.007446866587237785, 0.017556815753723223, 0.7703410437792519]),
            "lam": np.array([0.004736886590848933, 0.0011046803312573436]),
        },
        known_to={"q": 6e-13, "v": 2e-11, "lam": 5e-14},  # how near both DOP853, rtol 2.3e-14, and Radau IIA, rtol 1e-12, come
        **ABOUT["car-axis"],
    )
