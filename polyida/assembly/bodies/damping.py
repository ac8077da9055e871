"""Forces of the bodies that depend on v, and their derivatives: Kelvin-Voigt and mass-proportional damping.

They stand apart from the undamped pass: a scene without damping neither evaluates nor compiles them.
"""

import numpy as np

from polyida.assembly.bodies import compact
from polyida.assembly.equilibrium import cells, on_pattern, tangent_blocks
from polyida.element import kernels, two_states
from polyida.jit import entry


def symmetric_blocks(model, u, c_m, c_v):
    """Blocks (nnz, 2, 2) of `c_m M + c_v C + K` of a scene's bodies at u (nodes, 2), c_m and c_v both real or both complex.

    C and K are those at rest there: what K has of velocities beside is not symmetric, and small; Newton does without.
    """
    if isinstance(c_v, complex):
        return combined(c_m, c_v, *symmetric_parts(model, u))
    blocks = _blocks(model)
    tangent_blocks(model.arrays, u, c_m, 0.0 if model.damped else 1.0, blocks)
    if model.damped:
        viscous = np.empty_like(blocks)
        damped_blocks(model.arrays, u, np.zeros_like(u), c_v, 1.0, viscous)
        blocks += viscous
    return blocks


def symmetric_parts(model, u):
    """K (nnz, 2, 2), C alike or None where there is no damping, and the complex numbers m (nnz,) that M's blocks stand for: their real
    parts, and their imaginary parts or None where there are none.
    """
    scene, K, C, M = model.arrays, _blocks(model), None, _blocks(model)
    tangent_blocks(scene, u, 1.0, 0.0, M)
    tangent_blocks(scene, u, 0.0, 1.0, K)
    if model.damped:
        C = _blocks(model)
        damped_blocks(scene, u, np.zeros_like(u), 1.0, 0.0, C)
    return K, C, M[:, 0, 0].copy(), M[:, 1, 0].copy() if M[:, 1, 0].any() else None


def combined(c_m, c_v, K, C, m, across):
    """Blocks of `c_m M + c_v C + K` from symmetric_parts."""
    blocks = K + c_v * (0.0 if C is None else C)
    for i in range(2):
        blocks[:, i, i] += c_m * m
    if across is not None:
        blocks[:, 0, 1] -= c_m * across
        blocks[:, 1, 0] += c_m * across
    return blocks


def _blocks(model):
    return np.empty((len(model.pattern[1]), 2, 2))


@entry
def add_damping(scene, u, v, elastic, r):
    """r (nodes, 2) += the damping forces of all bodies; elastic (nodes, 2) is scratch, rotation is not wanted."""
    s = scene.plates
    compact.damping(scene.compact, u, v, r)
    for b in range(s.body_operator.shape[0]):
        o, n0 = s.body_operator[b], s.body_node[b]
        if s.body_drag[b] != 0.0:
            kernels.mass_product(*on_pattern(s, o, s.mass), s.body_drag[b] * s.body_density[b], n0, v, r)
        if s.body_viscosity[b] == 0.0:
            continue
        none = elastic[:0]
        elastic[:] = 0.0
        kernels.internal_force(*cells(s, o), n0, s.body_c1[b], s.body_nu[b], u, elastic, none)
        for i in range(n0, s.body_node[b + 1]):
            r[i, 0] -= elastic[i, 0]
            r[i, 1] -= elastic[i, 1]
        two_states.internal_force_viscous(*cells(s, o), n0, s.body_c1[b], s.body_nu[b], s.body_viscosity[b], u, v, r, none)


@entry
def damped_blocks(scene, u, v, c_v, c_q, blocks):
    """Fill blocks (nnz, 2, 2) = c_v dg/dv + c_q dg/dq of all bodies; dg/dq is not symmetric where v is not zero."""
    s = scene.plates
    blocks[:] = 0.0
    compact.blocks(scene.compact, u, v, 0.0, c_v, c_q, blocks)
    for b in range(s.body_operator.shape[0]):
        o, first = s.body_operator[b], s.body_block[b]
        p, e = s.at[o], s.at[o + 1]
        two_states.tangent_viscous(
            *cells(s, o),
            s.pairs[p[4] : e[4]],
            s.body_node[b],
            first,
            s.body_c1[b],
            s.body_nu[b],
            s.body_viscosity[b],
            u,
            v,
            c_q,
            c_v,
            blocks,
        )
        drag, stiff = c_v * s.body_drag[b] * s.body_density[b], c_q * s.body_stabilisation[b]
        for k in range(e[6] - p[6]):
            value = drag * s.mass[p[6] + k] + stiff * s.stabilisation[p[6] + k]
            blocks[first + k, 0, 0] += value
            blocks[first + k, 1, 1] += value
