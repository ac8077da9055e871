"""A user's own DAE: the car axis of the IVP test set (index 3, driven constraint), four functions in plain numpy.
Runs in every integrator."""

import numpy as np

import polyida as pi

L, L0, MASS, RADIUS, OMEGA = 1.0, 0.5, 10 * 0.01**2 / 2, 0.1, 10.0


def road(t):
    y = RADIUS * np.sin(OMEGA * t)
    return np.sqrt(L**2 - y**2), y


class CarAxis(pi.Model):
    n, m = 4, 2

    def mass(self, q):
        return MASS * np.eye(4)

    def force(self, t, q, v):
        (xl, yl, xr, yr), (xb, yb) = q, road(t)
        left, right = np.hypot(xl, yl), np.hypot(xr - xb, yr - yb)
        return -np.array(
            [
                (L0 - left) * xl / left,
                (L0 - left) * yl / left - MASS,
                (L0 - right) * (xr - xb) / right,
                (L0 - right) * (yr - yb) / right - MASS,
            ]
        )

    def phi(self, t, q):
        (xl, yl, xr, yr), (xb, yb) = q, road(t)
        return np.array([xl * xb + yl * yb, (xl - xr) ** 2 + (yl - yr) ** 2 - L**2])

    def phi_q(self, t, q):
        (xl, yl, xr, yr), (xb, yb) = q, road(t)
        return np.array([[xb, yb, 0, 0], [2 * (xl - xr), 2 * (yl - yr), 2 * (xr - xl), 2 * (yr - yl)]])


reference = np.array([0.04934557842754, 0.49698946023017, 1.04174252488542, 0.37391102726536])
q0, v0 = np.array([0.0, 0.5, 1.0, 0.5]), np.array([-0.5, 0.0, -0.5, 0.0])
for integrator in (pi.GeneralizedAlpha(h=1e-4, rho_inf=0.9), pi.IDA(rtol=1e-8, atol=1e-8, max_order=5)):
    run = pi.solve(CarAxis(), 3.0, integrator, q0=q0, v0=v0)
    assert run.success, run.message
    error = np.abs(run.q[-1] - reference).max()
    print(f"{integrator}: error {error:.1e}, {run.summary()}")
    assert error < 2e-5
