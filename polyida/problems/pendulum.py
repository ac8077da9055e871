"""The planar pendulum in Cartesian coordinates: the smallest index-3 problem with a closed solution."""

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
        return self.weight * np.eye(2)

    def force(self, t, q, v):
        return np.array([0.0, self.weight * self.gravity])

    def phi(self, t, q):
        return np.array([(q @ q - self.length**2) / (2 * self.length)])

    def phi_q(self, t, q):
        return q[None] / self.length

    def force_q(self, t, q, v):
        return np.zeros((2, 2))

    def reaction_q(self, t, q, lam):
        return lam[0] / self.length * np.eye(2)

    def phi_bias(self, t, q, v):
        return np.array([v @ v / self.length])

    def residual_p(self, name, t, q, v, a, lam):
        up = np.array([0.0, 1.0])
        slopes = {"weight": a + self.gravity * up, "length": -lam[0] / self.length**2 * q, "gravity": self.weight * up}
        return slopes[name]

    def phi_p(self, name, t, q):
        return np.array([-(q @ q + self.length**2) / (2 * self.length**2) if name == "length" else 0.0])

    def potential(self, q):
        return self.weight * self.gravity * q[1]


def problem():
    """From rest at (-1, 0) for 10 s, a little over four periods; v and lam follow from the energy, which is 0 J."""
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
