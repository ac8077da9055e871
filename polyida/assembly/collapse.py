"""Which cell of a scene is pressed together most, for messages."""

import numpy as np


def deepest(bodies, u):
    """"cell 3 of 'upper' at (x, y)": that of the least mean det F at displacements u (nodes, 2), and its centre at rest, m."""
    found = []
    for body in bodies:
        operator = body.operator
        outer = u[body.nodes][operator.nodes][:, :, None] * operator.mean_gradients[:, None, :]
        gradient = np.eye(2) + np.add.reduceat(outer, operator.offsets[:-1])
        det = np.linalg.det(gradient)
        cell = int(np.argmin(det))
        found.append((det[cell], cell, body))
    _, cell, body = min(found, key=lambda entry: entry[0])
    x, y = body.points[body.mesh.cell(cell)].mean(axis=0)
    return f"cell {cell} of {body.name!r} at ({x:.6g}, {y:.6g})"
