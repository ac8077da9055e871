"""A mesh from elsewhere (triangles and quads in one Gmsh file, read through meshio) becomes a plate."""

import meshio
import numpy as np

import polyida as pi

x, y = np.meshgrid(np.linspace(0, 1, 21), np.linspace(0, 0.1, 5), indexing="ij")
points = np.c_[x.ravel(), y.ravel(), np.zeros(x.size)]
node = np.arange(x.size).reshape(x.shape)
cells = np.stack([node[:-1, :-1], node[1:, :-1], node[1:, 1:], node[:-1, 1:]], axis=-1).reshape(-1, 4)
half = len(cells) // 2
triangles = np.concatenate([cells[half:][:, [0, 1, 2]], cells[half:][:, [0, 2, 3]]])
meshio.Mesh(points, [("quad", cells[:half]), ("triangle", triangles)]).write("plate.msh", file_format="gmsh22")

mesh = pi.mesh.read("plate.msh")
assert abs(mesh.area - 0.1) < 1e-12
scene = pi.Scene(gravity=(0.0, -9.81))
plate = scene.add(pi.Plate(mesh, pi.Material(E=50e6, nu=0.3, rho=1100.0), thickness=0.01))
scene.add(pi.Revolute(pi.ground, plate.section(lambda points: np.isclose(points[:, 0], 0.0))))
run = pi.solve(scene.build(), 0.3, pi.GeneralizedAlpha(h=1e-3))
assert run.success, run.message
pi.export.vtu(run, "frames", overwrite=True)
print(run.summary())
