"""Strain of the plates' elements."""

import numpy as np

from polyida.element import kernels
from polyida.results.drawn import drawn, nodal


def strains(model, q):
    """Green's strain of every element of a scene at q, (cells, 3): Exx, Eyy, 2 Exy, means over the element at rest, plate after plate."""
    u, parts = np.ascontiguousarray(nodal(model, q), float), [np.zeros((0, 3))]
    for body in drawn(model):
        operator = body.operator
        parts.append(np.empty((operator.n_cells, 3)))
        kernels.green_strain(*operator.force_arrays, operator.lane_cells, operator.areas, body.nodes.start, u, parts[-1])
    return np.concatenate(parts)
