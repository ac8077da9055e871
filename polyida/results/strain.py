"""Strain of the plates' elements."""

import numpy as np

from polyida.element import kernels


def strains(model, q):
    """Green's strain of every element of a scene at q, (cells, 3): Exx, Eyy, 2 Exy, means over the element at rest, plate after plate."""
    u, parts = model.nodal(q), [np.zeros((0, 3))]
    for body in model.drawn:
        operator = body.operator
        parts.append(np.empty((operator.n_cells, 3)))
        weighed = operator.areas * body.factors[0]
        kernels.green_strain(*operator.force_arrays, operator.lane_cells, weighed, body.nodes.start, u, parts[-1])
    return np.concatenate(parts)
