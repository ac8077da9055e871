"""Half of the MBB beam: 60 m x 20 m, held by its symmetry on the left and by a roller at the bottom right, 1 N down at the top left.

E = 1 Pa, nu = 0.3, 1 m thick, in plane stress, small displacements: compliance is f.u. Three elements: this package's two, and the bilinear
square of the published codes.
"""

from functools import lru_cache

import numpy as np

import polyida as pi

LENGTH, HEIGHT, COLUMNS, ROWS = 60.0, 20.0, 60, 20
MATERIAL = pi.Material(E=1.0, nu=0.3, rho=1.0)
GAUSS = 0.5 + 0.5 / np.sqrt(3.0) * np.array([(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)])  # points in the square from 0 to 1
FAN = 0.5 + np.array([(0.0, -1.0), (1.0, 0.0), (0.0, 1.0), (-1.0, 0.0)]) / 3.0  # centroids of the triangles from the middle to the sides


@lru_cache(maxsize=2)
def mesh_of(kind, cells=COLUMNS * ROWS):
    """The mesh of a kind, "squares" or "polygons" of about as many."""
    if kind == "squares":
        return pi.mesh.quads(LENGTH, HEIGHT, COLUMNS, ROWS, origin=(0.0, HEIGHT / 2))
    return pi.mesh.rectangle(LENGTH, HEIGHT, cells=cells, seed=1, origin=(0.0, HEIGHT / 2))


def scene(mesh, element):
    """The Scene: a slot in the ground for each node that symmetry holds, one for the roller, the load."""
    made = pi.Scene()
    beam = made.add(pi.Plate(mesh, MATERIAL, thickness=1.0, element=element, name="beam"))
    for node in mesh.section("left").nodes:
        made.add(pi.Slot(pi.ground.at(mesh.points[node], direction=(0.0, 1.0)), beam.node(int(node)), name=f"symmetry {node}"))
    made.add(pi.Slot(pi.ground.at((LENGTH, 0.0), direction=(1.0, 0.0)), beam.node((LENGTH, 0.0)), name="roller"))
    made.add(pi.PointLoad(beam.node((0.0, HEIGHT)), (0.0, -1.0), name="load"))
    return made


def compliance_of(mesh, element):
    """Function of stiffness factors (cells,): (compliance, its slopes in them)."""
    if element == "bilinear":
        return bilinear(mesh)
    model = scene(mesh, element).build()

    def compliance(stiffness):
        result = pi.gradient(
            pi.static(model.with_factors(beam=(stiffness, 1.0)), linear=True), pi.objective.Compliance(), ["beam.stiffness"]
        )
        return result.value, result["beam.stiffness"]

    return compliance


def bilinear(mesh, places=GAUSS):
    """The same with bilinear squares, assembled and solved here: with GAUSS those of the published codes, with FAN Wachspress squares."""
    from scipy.sparse import coo_array
    from scipy.sparse.linalg import spsolve

    matrix, corners = square_stiffness(places), np.array([_from_lower_left(mesh, cell) for cell in range(mesh.n_cells)])
    dof = np.stack([2 * corners, 2 * corners + 1], axis=2).reshape(-1, 8)
    x, y = mesh.points.T
    fixed = np.r_[2 * np.flatnonzero(x == 0.0), 2 * np.flatnonzero((x == LENGTH) & (y == 0.0)) + 1]
    free = np.setdiff1d(np.arange(2 * mesh.n_nodes), fixed)
    load = np.zeros(2 * mesh.n_nodes)
    load[2 * np.flatnonzero((x == 0.0) & (y == HEIGHT)) + 1] = -1.0
    rows, columns = np.repeat(dof, 8, axis=1).ravel(), np.tile(dof, (1, 8)).ravel()

    def compliance(stiffness):
        whole = coo_array(((np.asarray(stiffness)[:, None, None] * matrix).ravel(), (rows, columns))).tocsc()
        u = np.zeros(len(load))
        u[free] = spsolve(whole[free][:, free], load[free])
        return float(load @ u), -np.einsum("ei,ij,ej->e", u[dof], matrix, u[dof])

    return compliance


def _from_lower_left(mesh, cell):
    nodes = mesh.cell(cell)
    return np.roll(nodes, -np.argmin(mesh.points[nodes].sum(axis=1)))


def square_stiffness(places=GAUSS):
    """Stiffness (8, 8) of a bilinear square of side 1, corners counter-clockwise from the lower left, by points (points, 2) of equal weight."""
    nu, total = MATERIAL.nu, np.zeros((8, 8))
    elastic = np.array([[1.0, nu, 0.0], [nu, 1.0, 0.0], [0.0, 0.0, (1.0 - nu) / 2.0]]) * MATERIAL.E / (1.0 - nu**2)
    for x, y in places:
        along_x, along_y = [y - 1.0, 1.0 - y, y, -y], [x - 1.0, -x, x, 1.0 - x]
        strain = np.zeros((3, 8))
        strain[0, 0::2], strain[1, 1::2], strain[2, 0::2], strain[2, 1::2] = along_x, along_y, along_y, along_x
        total += strain.T @ elastic @ strain / len(places)
    return total
