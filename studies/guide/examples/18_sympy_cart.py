"""
A cart with two links from SymPy
================================

sympy's ``LagrangesMethod`` derives the equations; ``pi.symbolic.mechanics`` makes a model of them for all integrators.
"""

import numpy as np
import sympy as sp
from sympy.physics.mechanics import LagrangesMethod, Particle, Point, ReferenceFrame, dynamicsymbols

import polyida as pi

t = dynamicsymbols._t
x, a, b = dynamicsymbols("x a b")
M, m, l, g, d = sp.symbols("M m l g d")
N, O = ReferenceFrame("N"), Point("O")
O.set_vel(N, 0)
places = [x * N.x]
for angle in (a, b):
    places.append(places[-1] + l * (sp.sin(angle) * N.x - sp.cos(angle) * N.y))
bodies = []
for k, place in enumerate(places):
    point = O.locatenew(f"P{k}", place)
    point.set_vel(N, place.dt(N))
    bodies.append(Particle(f"body {k}", point, M if k == 0 else m))
    bodies[-1].potential_energy = bodies[-1].mass * g * place.dot(N.y)

# %%
# Friction of the cart is a force that is no part of the Lagrangian.

L = sum(body.kinetic_energy(N) - body.potential_energy for body in bodies)
method = LagrangesMethod(L, [x, a, b], forcelist=[(bodies[0].point, -d * x.diff(t) * N.x)], frame=N)
model = pi.symbolic.mechanics(method, values={M: 2.0, m: 0.5, l: 0.6, g: 9.81, d: 0.3})
run = pi.solve(model, 3.0, pi.RadauIIA(rtol=1e-7), q0=[0.0, 2.0, 1.5])

# %%
# Expressions are evaluated along the run. The lost energy is the work of the friction.

tip = model.evaluate(run, [places[-1].dot(N.x), places[-1].dot(N.y)])
lost = run.energy.total[0] - run.energy.total
assert np.abs(lost + run.energy.work["forces"]).max() < 1e-4
run.plot.expressions(x, places[-1].dot(N.x))
