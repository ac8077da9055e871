"""
The woodpecker toy
==================

A sleeve with a loose fit slides down a pole; a bird on a spring swings on it, and its beak hits the pole. Impacts and dry friction, a model of
one's own, with the data of Glocker and Studer (Multibody Syst. Dyn. 13 (2005) 447-463).
"""

import matplotlib.pyplot as plt
import numpy as np

import polyida as pi

m, J, m_bird, J_bird, spring = 3e-4, 5e-9, 4.5e-3, 7e-7, 5.6e-3  # kg, kg m^2, kg, kg m^2, N m/rad
pole, hole, height, arm, neck, beak, high = 2.5e-3, 3.1e-3, 5.8e-3, 0.01, 0.015, 0.0201, 0.02  # m


class Woodpecker(pi.Model):
    """q = (height of the sleeve, its angle, angle of the bird). Contacts: beak, lower and upper edge of the sleeve, each with friction."""

    n, m, p = 3, 3, 3
    needs = pi.Needs(mass_varies=False, velocity_forces=False, driven=False, phi_q_varies=False)
    row_laws = (
        pi.RowLaw(0, "beak", restitution=0.5),
        pi.RowLaw(1, "lower edge", restitution=0.0),
        pi.RowLaw(2, "upper edge", restitution=0.0),
        *(pi.RowLaw(3 + k, f"friction {k}", mu=0.3, on=(k,)) for k in range(3)),
    )
    rooms = np.array([arm + neck - beak - pole, hole - pole, hole - pole])
    gap_slopes = np.array([[0.0, 0.0, -high], [0.0, height, 0.0], [0.0, -height, 0.0]])
    slips = np.array([[1.0, arm, neck - beak], [1.0, hole, 0.0], [1.0, hole, 0.0]])

    def mass(self, q):
        """The bird's centre moves with y' + arm angle' + neck angle_of_bird'."""
        w = np.array([1.0, arm, neck])
        return np.diag([m, J, J_bird]) + m_bird * np.outer(w, w)

    def force(self, t, q, v):
        """Weight and spring."""
        moment = spring * (q[1] - q[2])
        return 9.81 * np.array([m + m_bird, m_bird * arm, m_bird * neck]) + np.array([0.0, moment, -moment])

    def phi(self, t, q):
        """Gaps of the three contacts, m."""
        return self.rooms + self.gap_slopes @ q

    def phi_q(self, t, q):
        """Slopes of the gaps."""
        return self.gap_slopes

    def psi(self, t, q, v):
        """Velocities at which they slip, m/s."""
        return self.slips @ v


start = np.array([0.0, -(hole - pole) / height, -0.2788]), np.array([-0.3394786, 0.0, -7.4620947])
run = pi.solve(Woodpecker(), 0.45, pi.NonsmoothAlpha(h=1e-4), q0=start[0], v0=start[1])
print(run.events)

fig, axes = plt.subplots(3, 1, figsize=(8.0, 6.5), layout="constrained", sharex=True, height_ratios=[1.6, 1.6, 1.0])
motion, force, status = axes
motion.plot(run.t, run.q[:, 2], label="bird, rad")
motion.plot(run.t, run.q[:, 1], label="sleeve, rad")
motion.plot(run.t, 10 * run.q[:, 0], label="height of the sleeve, 0.1 m")
motion.legend(fontsize="small", loc="lower left")
for k, name in enumerate(("beak", "lower edge", "upper edge")):
    pressure, friction = -run.lam[:, k], np.abs(run.lam[:, 3 + k])
    force.semilogy(run.t, np.where(pressure > 0.0, pressure, np.nan), ".", ms=3, label=name)
    slips = friction > 0.3 * pressure * (1 - 1e-6)
    for which, color in ((~slips, "tab:green"), (slips, "tab:red")):
        shown = which & (pressure > 0.0)
        status.plot(run.t[shown], np.full(shown.sum(), k), "|", color=color, ms=12)
force.set(ylabel="mean force in a step, N")
force.legend(fontsize="small", ncols=3, loc="upper right")
status.plot([], [], "s", color="tab:green", label="sticks")
status.plot([], [], "s", color="tab:red", label="slips")
status.set(xlabel="t, s", yticks=range(3), yticklabels=["beak", "lower edge", "upper edge"], ylim=(-0.6, 3.2))
status.legend(ncols=2, fontsize="small", loc="upper right")
