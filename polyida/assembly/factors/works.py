"""The virtual work of every cell's forces along w, summed over frames: the slope of `w . r` in the factors of the cells.

r is linear in the factors of each plate, `r = sum_e s_e f_e(q, v) + m_e M_e (a - g + d v) + ...`, g the gravity, d the mass damping, so
these works at factor 1 are its derivatives at any factors.
"""

import numpy as np

from polyida.assembly.factors.shares import Shares
from polyida.element.lanes import LANES
from polyida.element.paired import cells
from polyida.jit import entry


def stiffness_work(model, q, v, w):
    """{plate: (cells,)}, J: sums over frames of `w . f_e(q, v)`, f_e the elastic force of cell e at factor 1 with its viscosity and
    stabilisation; q, v, w (frames, n).
    """
    shares = model.once(Shares, of_shape=True)
    lanes, pairs = np.zeros(len(shares.lane_cells)), np.zeros(len(shares.plates.mass))
    _force_works(shares.plates, *(_nodal(model, x) for x in (q, v, w)), lanes, pairs)
    stabilising = shares.of_cells(shares.plates.body_stabilisation) * shares.stabilisation.slopes(pairs, shares.first[-1])
    return shares.by_plate(np.bincount(shares.lane_cells, lanes, shares.first[-1]) + stabilising)


def mass_work(model, b, w, pull=None):
    """{plate: (cells,)}: sums over frames of `w . M_e (b - pull)`, M_e the mass matrix of cell e at factor 1; b, w (frames, n), pull
    (frames, 2): the same everywhere.
    """
    shares = model.once(Shares, of_shape=True)
    pairs = np.zeros(len(shares.plates.mass))
    _mass_works(shares.plates, *(_nodal(model, x) for x in (b, w)), pairs)
    if pull is not None:
        _mass_works(shares.plates, _nodal(model, np.tile(np.eye(2), model.n_nodes)), _nodal(model, -(pull.T @ w)), pairs)
    return shares.by_plate(shares.of_cells(shares.plates.body_density) * shares.mass.slopes(pairs, shares.first[-1]))


def _nodal(model, x):
    return np.ascontiguousarray(x, float).reshape(-1, model.n_nodes, 2)


@entry
def _force_works(s, q, v, w, lanes, pairs):
    """Add up over frames: w . f of the cells in their lanes, products for the stabilisation on the pattern."""
    for frame in range(q.shape[0]):
        for o in range(s.body_operator.shape[0]):
            p, e = s.at[o], s.at[o + 1]
            cells.force_work(
                s.layout[p[0] : e[0]],
                s.corners[p[1] : e[1]],
                s.gradients[p[2] : e[2]],
                s.weights[p[3] : e[3]],
                s.body_node[o],
                s.body_c1[o],
                s.body_nu[o],
                s.body_viscosity[o],
                q[frame],
                v[frame],
                w[frame],
                lanes[LANES * p[0] : LANES * e[0]],
            )
            if s.body_stabilisation[o] != 0.0:
                cells.difference_products(
                    s.indptr[p[5] : e[5]], s.indices[p[6] : e[6]], s.body_node[o], q[frame], w[frame], pairs[p[6] : e[6]]
                )


@entry
def _mass_works(s, b, w, pairs):
    """Add up over frames: products for the mass on the pattern."""
    for frame in range(b.shape[0]):
        for o in range(s.body_operator.shape[0]):
            p, e = s.at[o], s.at[o + 1]
            cells.products(s.indptr[p[5] : e[5]], s.indices[p[6] : e[6]], s.body_node[o], b[frame], w[frame], pairs[p[6] : e[6]])
