"""
A column that buckles
=====================

`pi.buckling` gives the factors by which a load must grow until a straight column has another equilibrium, and the shapes that branch off: here
of a column that is clamped at one end, beside Euler's load.
"""

import matplotlib.pyplot as plt
import numpy as np

import polyida as pi

length, height, thickness, E = 1.0, 0.02, 0.05, 2e9
scene = pi.Scene()
mesh = pi.mesh.quads(length, height, 12, 1, order=2)
column = scene.add(pi.Plate(mesh, pi.Material(E=E, nu=0.0, rho=1200.0), thickness, name="column"))
scene.add(pi.Clamp(column.section("left"), name="clamp"))
scene.add(pi.PointLoad(column.section("right"), (-1.0, 0.0), name="push"))

found = pi.buckling(scene.build(), load="push", count=3)
euler = np.pi**2 * E * thickness * height**3 / 12 / (4 * length**2)
print(found.summary())
print(f"Euler's load: {euler:.2f} N")
assert abs(found.factors[0] / euler - 1.0) < 0.005
found.plot()
plt.show()
