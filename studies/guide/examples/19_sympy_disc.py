"""
A rolling disc in space from Kane's equations
=============================================

sympy's ``KanesMethod`` with three speeds, the components of the angular velocity; yaw, lean and spin are the coordinates.
"""

import numpy as np
import sympy as sp
from sympy.physics.mechanics import KanesMethod, Point, ReferenceFrame, RigidBody, dynamicsymbols, inertia

import polyida as pi

t = dynamicsymbols._t
q, u = dynamicsymbols("yaw lean spin"), dynamicsymbols("u1:4")
r, m, g = sp.symbols("r m g")
N = ReferenceFrame("N")
yawed = N.orientnew("Y", "Axis", [q[0], N.z])
leaning = yawed.orientnew("L", "Axis", [q[1], yawed.x])
disc = leaning.orientnew("D", "Axis", [q[2], leaning.y])
axes = leaning.x, leaning.y, leaning.z
kinematic = [disc.ang_vel_in(N).dot(axis) - speed for axis, speed in zip(axes, u)]
disc.set_ang_vel(N, u[0] * axes[0] + u[1] * axes[1] + u[2] * axes[2])
contact = Point("C")
contact.set_vel(N, 0)
centre = contact.locatenew("G", r * leaning.z)
centre.v2pt_theory(contact, N, disc)
body = RigidBody("disc", centre, disc, m, (inertia(leaning, m * r**2 / 4, m * r**2 / 2, m * r**2 / 4), centre))
kane = KanesMethod(N, q_ind=q, u_ind=u, kd_eqs=kinematic)
kane.kanes_equations([body], [(centre, -m * g * N.z)])

# %%
# A fast disc stays upright: its lean swings about a small angle.

model = pi.symbolic.mechanics(kane, values={r: 0.3, m: 1.0, g: 9.81})
run = pi.solve(model, 3.0, pi.RadauIIA(rtol=1e-8), q0=[0.0, 0.1, 0.0], v0=[0.0, 0.0, 12.0])
assert np.abs(model.evaluate(run, q[1])).max() < 0.3
energy = body.kinetic_energy(N) + m * g * r * sp.cos(q[1])
assert np.ptp(model.evaluate(run, energy)) < 1e-5
run.plot.expressions(q[1], u[2])
