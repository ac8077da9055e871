"""What lies between the straight line of a cut and the borders of cells that stand for it."""

import numpy as np
from scipy.sparse import csr_array

from polyida.assembly.loads import gravity_at

ROUND = 1e-9  # of a plate's size: cells that reach over a line by less end there


class Slivers:
    """The parts of cells on the wrong side of a line, as masses at their centroids.

    ahead (cells,): the cells that are taken as ahead of the line through `place` across `way`, (2,) in the scene at rest. Those ahead have
    slivers of negative mass behind the line, the others of positive mass ahead of it. Places and accelerations are interpolated
    with the mean gradient of the cell.
    """

    def __init__(self, body, gravity, place, way, ahead):
        material, mesh, operator = body.plate.material, body.mesh, body.operator
        distance = (body.points - place) @ way
        density, entries, masses = material.rho * body.plate.thickness, [], []
        for cell in np.flatnonzero(_crossed(mesh, distance)):
            corners = slice(mesh.offsets[cell], mesh.offsets[cell + 1])
            nodes, side = mesh.nodes[corners], -1.0 if ahead[cell] else 1.0
            points = body.points[nodes]
            area, centroid = _clipped(points, side * distance[nodes])
            weights = 1.0 / len(nodes) + operator.mean_gradients[corners] @ (centroid - points.mean(axis=0))
            entries += [(len(masses), node, weight) for node, weight in zip(nodes, weights)]
            masses.append(side * density * body.factors[1][cell] * area)
        rows, columns, values = np.array(entries, float).reshape(-1, 3).T
        self.weights = csr_array((values, (rows.astype(int), columns.astype(int))), (len(masses), mesh.n_nodes))
        self.mass, self.gravity, self.drag, self.rest = np.array(masses)[:, None], gravity, material.mass_damping, body.points

    def forces(self, t, v, a):
        """What moves them, weight and damping taken off, (slivers, 2), N, from the nodes' velocities and accelerations, (nodes, 2)."""
        return self.mass * (self.weights @ (a + self.drag * v) - gravity_at(self.gravity, t))

    def places(self, u):
        """Where they are, (slivers, 2), m, from the nodes' displacements."""
        return self.weights @ (self.rest + u)


def _crossed(mesh, distance):
    """Which cells the line crosses, (cells,)."""
    first, corners = mesh.offsets[:-1], distance[mesh.nodes]
    near = ROUND * np.ptp(distance)
    return (np.minimum.reduceat(corners, first) < -near) & (np.maximum.reduceat(corners, first) > near)


def _clipped(points, distance):
    """(area, centroid) of the part of a polygon where the distance of its corners from a line, interpolated, is positive."""
    kept = []
    for i in range(len(points)):
        if distance[i - 1] * distance[i] < 0:
            s = distance[i - 1] / (distance[i - 1] - distance[i])
            kept.append(points[i - 1] + s * (points[i] - points[i - 1]))
        if distance[i] >= 0:
            kept.append(points[i])
    arms = np.array(kept) - kept[0]
    parts = 0.5 * (arms[:-1, 0] * arms[1:, 1] - arms[:-1, 1] * arms[1:, 0])
    return parts.sum(), kept[0] + parts @ (arms[:-1] + arms[1:]) / (3.0 * parts.sum())
