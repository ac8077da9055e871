"""The table of a small model with dense matrices: compiled code around its functions, C functions or Python ones (system/dense.py)."""

from functools import cache
from typing import NamedTuple

import numpy as np
from numba import carray, typeof

from polyida import system as of
from polyida.errors import DONE, NO_MATRIX, SINGULAR
from polyida.jit import entry, pack, part, served
from polyida.jit.intrinsics import complex_pointer, pointer
from polyida.jit.user_functions import table_address
from polyida.linear import dense as lu
from polyida.linear.lu import FACTORS as SLOTS
from polyida.model.differences import NEAR
from polyida.system import dense

# of DenseStages.state: the slot in use, whether its matrices are made with the rows at hand, and whether a derivative of phi is a row
CHOSEN, FACTORED, TIED = range(3)


@pack
class DenseStages(NamedTuple):
    """The workspace of a model: a Dense; K, C, M (slots, n, n); the rows of the middle stage B, H, N, G (m, n).

    levels (k, 3): factors of phi, phi' and phi'' in each of k blocks of m rows; with two blocks the second belongs to mu. rows (s, m, n): B of
    the stages; D (n,): diagonal of D^-1; c (3,): argument of SELECT; sizes (2,): typical size of S of each mode; real, pair (N, N): factored
    matrices of the modes.
    """

    dense: dense.Dense
    K: np.ndarray
    C: np.ndarray
    M: np.ndarray
    state: np.ndarray
    c: np.ndarray
    levels: np.ndarray
    D: np.ndarray
    rows: np.ndarray
    B: np.ndarray
    H: np.ndarray
    N: np.ndarray
    G: np.ndarray
    near: np.ndarray
    sizes: np.ndarray
    pivots: np.ndarray
    real: np.ndarray
    x: np.ndarray
    pair: np.ndarray
    x_pair: np.ndarray


def workspace(d, stages, levels):
    """A DenseStages around a Dense."""
    n, m = len(d.q), len(d.lam)
    size = n + len(levels) * m
    matrices, row_blocks = [np.zeros((SLOTS, n, n)) for _ in range(3)], [np.zeros((m, n)) for _ in range(5)]
    return DenseStages(
        d, *matrices, np.array([0, 0, int(levels[:, 1:].any())]), np.zeros(3), levels, np.ones(n), np.zeros((stages, m, n)), *row_blocks, np.zeros(2),
        np.zeros((2, size), np.int64), np.zeros((size, size)), np.zeros(size), np.zeros((size, size), complex), np.zeros(size, complex),
    )  # fmt: skip


@part
def coordinates(w, at):
    """The array (n,) at an address."""
    return carray(pointer(at), w.D.shape)


@part
def multipliers(w, at):
    """The array (m,) at an address."""
    return carray(pointer(at), w.dense.lam.shape)


@part
def blocks(w, at):
    """The array (2 m,) at an address: rows of phi, and of phi'."""
    return carray(pointer(at), (2 * w.B.shape[0],))


@part
def complex_coordinates(w, at):
    """The complex array (n,) at an address."""
    return carray(complex_pointer(at), w.D.shape)


@part
def complex_blocks(w, at):
    """The complex array (2 m,) at an address."""
    return carray(complex_pointer(at), (2 * w.B.shape[0],))


@part
def step_times(w, at):
    """h, t and the times of the instants at an address."""
    return carray(pointer(at), (3 + w.rows.shape[0],))


@part
def mode_values(w, at):
    """c of the real mode, and the real and imaginary part of that of the complex one, at an address."""
    return carray(pointer(at), (3,))


@part
def prepare(w, first, times):
    """Store the times of a step."""
    for i in range(1 + w.rows.shape[0]):
        w.dense.times[first + i, dense.INNER] = w.dense.times[first + i, dense.END] = times[2 + i]
    return DONE


@part
def begin(w, first):
    """Do nothing: phi is computed from positions."""
    return DONE


@part
def reaction(w, instant, q, mu, dv, known):
    """dv += D^-1 B^T mu. B at q is stored for the residual there; known: B of the middle stage is used."""
    n, m, ended, B = w.K.shape[1], w.B.shape[0], DONE, w.B
    if not known:
        dense.set_state(w.dense, instant, q, w.dense.v)
        ended, B = dense.evaluate_rows(w.dense), w.dense.B
        lu.copy_matrix(B, w.rows[(instant - 1) % (w.rows.shape[0] + 1)])
    for i in range(n):
        total = 0.0
        for e in range(m):
            total += B[e, i] * mu[e]
        dv[i] += w.D[i] * total
    return ended


@part
def restore_rows(w, instant):
    """Use the stored B of a stage in the next call."""
    if w.state[TIED]:
        lu.copy_matrix(w.rows[(instant - 1) % (w.rows.shape[0] + 1)], w.dense.B)
        w.dense.flags[dense.ROWS_CURRENT] = 1


@part
def residual(w, instant, q, v, a, lam, r, phi):
    """r and phi."""
    restore_rows(w, instant)
    ended = dense.residual(w.dense, instant, q, v, a, lam, r, phi)
    w.dense.flags[dense.ROWS_CURRENT] = 0
    return ended


@part
def constraints(w, instant, q, dq, dv, phi, rate):
    """phi at a state."""
    return dense.constraints(w.dense, instant, q, phi)


@part
def rate(w, instant, q, v, out, known):
    """phi_q v + phi_t; known: with B of the last REACTION of this stage."""
    if known:
        restore_rows(w, instant)
    ended = dense.rate(w.dense, instant, q, v, out)
    w.dense.flags[dense.ROWS_CURRENT] = 0
    return ended


@part
def project(w, instant, rows, x, from_zero):
    """As `project` of system/dense.py."""
    return dense.project(w.dense, instant, rows, x, from_zero)


@part
def accept(w, instant, q):
    """Status of a state: accepted or rejected by the model."""
    return dense.accept(w.dense, instant, q)


@part
def bend(w, q, a):
    """w.H and w.N: first and second derivative of B(t + s, q + s v + s^2 a/2) at s = 0; a: the address of a, or 0."""
    d, step, n = w.dense, NEAR * dense.reach(w.dense), w.dense.q.shape[0]
    towards = dense.vector(a, n if a else 0)
    t, ended = d.t[dense.INNER], DONE
    for e in range(2):
        s = (step, -step)[e]
        for i in range(d.q.shape[0]):
            d.q[i] = q[i] + s * d.v[i]
        for i in range(towards.shape[0]):
            d.q[i] += 0.5 * s * s * towards[i]
        d.t[dense.INNER] = t + s
        if ended == DONE:
            ended = dense.evaluate(d, dense.PHI_Q, dense.INNER, d.B)
        for k in range(w.H.shape[0]):
            for i in range(w.H.shape[1]):
                change = d.B[k, i] - w.B[k, i]
                w.N[k, i] = change if e == 0 else (w.N[k, i] + change) / (step * step)
                w.H[k, i] = d.B[k, i] if e == 0 else (w.H[k, i] - d.B[k, i]) / (2.0 * step)
    d.t[dense.INNER] = t
    lu.put(1.0, q, d.q)
    lu.copy_matrix(w.B, d.B)
    return ended


@part
def row_size(w, c, level):
    """Divisor of the rows of a block: the factor of B in them."""
    return abs(w.levels[level, 0] + c * (w.levels[level, 1] + c * w.levels[level, 2]))


@part
def whole(A, w, c, size):
    """Fill A with the matrix of a mode. lam is in units of the typical size of S, mu in those of |c|; rows are divided by `row_size`."""
    k, n, m, scale = w.state[CHOSEN], w.K.shape[1], w.B.shape[0], abs(c)
    K, C, M = w.K[k], w.C[k], w.M[k]
    for i in range(n):
        for j in range(n):
            A[i, j] = (K[i, j] + c * (C[i, j] + c * M[i, j])) / size
        for e in range(m):
            A[i, n + e] = w.B[e, i]
    for level in range(w.levels.shape[0]):
        rate, second, at = w.levels[level, 1], w.levels[level, 2], n + level * m
        of_B, of_H, unit = w.levels[level, 0] + c * (rate + c * second), rate + 2.0 * c * second, row_size(w, c, level)
        for e in range(m):
            for i in range(n):
                A[at + e, i] = (of_B * w.B[e, i] + of_H * w.H[e, i] + second * w.N[e, i]) / unit
            lu.zero(A[at + e, n:])
    if w.levels.shape[0] == 2:
        for e in range(m):
            for i in range(n):
                total = 0.0 * c
                for j in range(n):
                    total += (C[i, j] + c * M[i, j]) * w.G[e, j]
                A[i, n + m + e] = total * (scale / size)
            for o in range(m):
                total = 0.0 * c
                for j in range(n):
                    total += w.B[e, j] * w.G[o, j]
                A[n + m + e, n + m + o] = total


@part
def factored(w, c, number, A):
    """Factor the matrix of a mode. False if it is singular."""
    k, total = w.state[CHOSEN], 0.0
    for i in range(w.K.shape[1]):
        total += abs(w.K[k, i, i] + c * (w.C[k, i, i] + c * w.M[k, i, i]))
    w.sizes[number] = total / w.K.shape[1] if total > 0.0 else 1.0
    whole(A, w, c, w.sizes[number])
    return lu.factor(A, w.pivots[number])


@part
def rows(w, instant, q, v, a, known):
    """B, G, H and N of the middle stage, and the factors with them."""
    m, own = w.B.shape[0], w.dense
    if w.state[FACTORED] and not (m and own.flags[dense.ROWS_VARY]):
        return DONE
    if m:
        dense.set_state(own, instant, q, v)
        own.flags[dense.ROWS_CURRENT] = known
        ended = dense.evaluate_rows(own)
        own.flags[dense.ROWS_CURRENT] = 0
        lu.copy_matrix(own.B, w.B)
        if ended == DONE and w.state[TIED] and own.flags[dense.ROWS_VARY]:
            ended = bend(w, q, a)
        for k in range(m):
            for i in range(w.B.shape[1]):
                w.G[k, i] = w.B[k, i] * w.D[i]
        if ended != DONE:
            return ended
    w.state[FACTORED] = 1
    if w.c[0] != 0.0 and not factored(w, w.c[0], 0, w.real):
        return SINGULAR
    return DONE if w.c[2] == 0.0 or factored(w, complex(w.c[1], w.c[2]), 1, w.pair) else SINGULAR


@part
def corrected(w, A, number, c, x, r, closing, dq, multipliers):
    """The correction of a mode."""
    n, m, size = w.K.shape[1], w.B.shape[0], w.sizes[number]
    for i in range(n):
        x[i] = -r[i] / size
    for level in range(w.levels.shape[0]):
        unit = row_size(w, c, level)
        for e in range(level * m, (level + 1) * m):
            x[n + e] = -closing[e] / unit
    lu.solve(A, w.pivots[number], x)
    lu.put(1.0, x[:n], dq)
    for e in range(m):
        multipliers[e] = size * x[n + e]
        multipliers[m + e] = abs(c) * x[n + m + e] if w.levels.shape[0] == 2 else 0.0 * x[0]


@part
def real(w, instant, r, closing, lam, dq, multipliers):
    """The correction of the real mode."""
    corrected(w, w.real, 0, w.c[0], w.x, r, closing, dq, multipliers)
    return DONE


@part
def pair(w, instant, r, closing, lam, dq, multipliers):
    """The correction of the complex mode."""
    corrected(w, w.pair, 1, complex(w.c[1], w.c[2]), w.x_pair, r, closing, dq, multipliers)
    return DONE


@part
def bias(w, instant, q, v, a, out):
    """The second derivative of phi."""
    own, n = w.dense, w.K.shape[1]
    dense.set_state(own, instant, q, v)
    ended = dense.bias(own)
    restore_rows(w, instant)
    own.flags[dense.ROWS_CURRENT] = 0
    for k in range(w.B.shape[0]):
        out[k] = own.phi_bias[k]
        for i in range(n):
            out[k] += own.B[k, i] * a[i]
    return ended


@part
def inertia(w, instant, v, a, r, p, q, rows):
    """r = C v + M a, and unless their addresses are 0: p = M v, rows = the blocks of rows times v, B v in place of a second block that is not there."""
    k, n, m = w.state[CHOSEN], w.K.shape[1], w.B.shape[0]
    momentum = dense.vector(p, n if p else 0)
    for i in range(n):
        r[i] = 0.0
        for j in range(n):
            r[i] += w.C[k, i, j] * v[j] + w.M[k, i, j] * a[j]
    for i in range(momentum.shape[0]):
        momentum[i] = 0.0
        for j in range(n):
            momentum[i] += w.M[k, i, j] * v[j]
    for level in range(2 if rows else 0):
        of_H, of_B, out = 0.0, 1.0, dense.vector(rows + 8 * level * m, m)
        if level < w.levels.shape[0]:
            of_H, of_B = 2.0 * w.levels[level, 2], w.levels[level, 1] + w.c[0] * w.levels[level, 2]
        for e in range(m):
            out[e] = 0.0
            for i in range(n):
                out[e] += (of_B * w.B[e, i] + of_H * w.H[e, i]) * v[i]
    return DONE


@part
def acceleration(w, instant, q, v, a, lam):
    """As `acceleration` of system/dense.py."""
    return dense.acceleration(w.dense, instant, q, v, a, lam)


@entry
def factor(w, instant, q, v, a, lam, slot):
    """Evaluate K, C and M at a state."""
    d, n = w.dense, w.K.shape[1]
    K, C, M = w.K[slot], w.C[slot], w.M[slot]
    dense.set_state(d, instant, q, v)
    dense.set_a_lam(d, a, lam)
    ended = dense.matrices_at(d, K, C, M)
    w.state[FACTORED] = 0
    good = dense.finite(K.reshape(n * n)) and dense.finite(C.reshape(n * n)) and dense.finite(M.reshape(n * n))
    return ended if ended != DONE or good else NO_MATRIX


@part
def select(w, slot, new):
    """Use the matrices of a slot, with c of the modes."""
    same = w.state[CHOSEN] == slot
    for i in range(3):
        same = same and w.c[i] == new[i]
        w.c[i] = new[i]
    if not same:
        w.state[CHOSEN], w.state[FACTORED] = slot, 0
    return DONE


SERVED = {
    of.PREPARE: served(prepare, step_times),
    of.BEGIN: served(begin),
    of.REACTION: served(reaction, coordinates, multipliers, coordinates, None),
    of.RESIDUAL: served(residual, coordinates, coordinates, coordinates, multipliers, coordinates, multipliers),
    of.CONSTRAINTS: served(constraints, coordinates, None, None, multipliers, None),
    of.RATE: served(rate, coordinates, coordinates, multipliers, None),
    of.PROJECT: served(project, multipliers, coordinates, None),
    of.ACCEPT: served(accept, coordinates),
    of.ROWS: served(rows, coordinates, coordinates, None, None),
    of.REAL: served(real, coordinates, blocks, None, coordinates, blocks),
    of.PAIR: served(pair, complex_coordinates, complex_blocks, None, complex_coordinates, complex_blocks),
    of.INERTIA: served(inertia, coordinates, coordinates, coordinates, None, None, None),
    of.ACCELERATION: served(acceleration, coordinates, coordinates, coordinates, multipliers),
    of.MATRICES: served(factor, coordinates, coordinates, coordinates, multipliers, None),
    of.SELECT: served(select, mode_values),
    of.BIAS: served(bias, coordinates, coordinates, coordinates, multipliers),
}


@cache
def addresses():
    """{number of the entry: address} of all functions, valid for every DenseStages."""
    example = workspace(dense.example(), 3, np.eye(1, 3))
    return {number: table_address(function, typeof(example)) for number, function in SERVED.items()}
