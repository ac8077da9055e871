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
def coordinates(work, at):
    """The array (n,) at an address."""
    return carray(pointer(at), work.D.shape)


@part
def multipliers(work, at):
    """The array (m,) at an address."""
    return carray(pointer(at), work.dense.lam.shape)


@part
def blocks(work, at):
    """The array (2 m,) at an address: rows of phi, and of phi'."""
    return carray(pointer(at), (2 * work.B.shape[0],))


@part
def complex_coordinates(work, at):
    """The complex array (n,) at an address."""
    return carray(complex_pointer(at), work.D.shape)


@part
def complex_blocks(work, at):
    """The complex array (2 m,) at an address."""
    return carray(complex_pointer(at), (2 * work.B.shape[0],))


@part
def step_times(work, at):
    """h, t and the times of the instants at an address."""
    return carray(pointer(at), (3 + work.rows.shape[0],))


@part
def mode_values(work, at):
    """c of the real mode, and the real and imaginary part of that of the complex one, at an address."""
    return carray(pointer(at), (3,))


@part
def prepare(work, first, times):
    """Store the times of a step."""
    for i in range(1 + work.rows.shape[0]):
        work.dense.times[first + i, dense.INNER] = work.dense.times[first + i, dense.END] = times[2 + i]
    return DONE


@part
def begin(work, first):
    """Do nothing: phi is computed from positions."""
    return DONE


@part
def reaction(work, instant, q, mu, dv, known):
    """dv += D^-1 B^T mu. B at q is stored for the residual there; known: B of the middle stage is used."""
    n, m, ended, B = work.K.shape[1], work.B.shape[0], DONE, work.B
    if not known:
        dense.set_state(work.dense, instant, q, work.dense.v)
        ended, B = dense.evaluate_rows(work.dense), work.dense.B
        lu.copy_matrix(B, work.rows[(instant - 1) % (work.rows.shape[0] + 1)])
    for i in range(n):
        total = 0.0
        for e in range(m):
            total += B[e, i] * mu[e]
        dv[i] += work.D[i] * total
    return ended


@part
def restore_rows(work, instant):
    """Use the stored B of a stage in the next call."""
    if work.state[TIED]:
        lu.copy_matrix(work.rows[(instant - 1) % (work.rows.shape[0] + 1)], work.dense.B)
        work.dense.flags[dense.ROWS_CURRENT] = 1


@part
def residual(work, instant, q, v, a, lam, r, phi):
    """r and phi."""
    restore_rows(work, instant)
    ended = dense.residual(work.dense, instant, q, v, a, lam, r, phi)
    work.dense.flags[dense.ROWS_CURRENT] = 0
    return ended


@part
def constraints(work, instant, q, dq, dv, phi, rate):
    """phi at a state."""
    return dense.constraints(work.dense, instant, q, phi)


@part
def rate(work, instant, q, v, out, known):
    """phi_q v + phi_t; known: with B of the last REACTION of this stage."""
    if known:
        restore_rows(work, instant)
    ended = dense.rate(work.dense, instant, q, v, out)
    work.dense.flags[dense.ROWS_CURRENT] = 0
    return ended


@part
def project(work, instant, rows, x, from_zero):
    """As `project` of system/dense.py."""
    return dense.project(work.dense, instant, rows, x, from_zero)


@part
def accept(work, instant, q):
    """Status of a state: accepted or rejected by the model."""
    return dense.accept(work.dense, instant, q)


@part
def bend(work, q, a):
    """work.H and work.N: first and second derivative of B(t + s, q + s v + s^2 a/2) at s = 0; a: the address of a, or 0."""
    d, step, n = work.dense, NEAR * dense.reach(work.dense), work.dense.q.shape[0]
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
        for k in range(work.H.shape[0]):
            for i in range(work.H.shape[1]):
                change = d.B[k, i] - work.B[k, i]
                work.N[k, i] = change if e == 0 else (work.N[k, i] + change) / (step * step)
                work.H[k, i] = d.B[k, i] if e == 0 else (work.H[k, i] - d.B[k, i]) / (2.0 * step)
    d.t[dense.INNER] = t
    lu.put(1.0, q, d.q)
    lu.copy_matrix(work.B, d.B)
    return ended


@part
def row_size(work, eigenvalue, level):
    """Divisor of the rows of a block: the factor of B in them."""
    return abs(work.levels[level, 0] + eigenvalue * (work.levels[level, 1] + eigenvalue * work.levels[level, 2]))


@part
def whole(matrix, work, eigenvalue, size):
    """Fill the matrix of a mode. lam is in units of the typical size of S, mu in those of |eigenvalue|; rows are divided by `row_size`."""
    k, n, m, scale = work.state[CHOSEN], work.K.shape[1], work.B.shape[0], abs(eigenvalue)
    K, C, M = work.K[k], work.C[k], work.M[k]
    for i in range(n):
        for j in range(n):
            matrix[i, j] = (K[i, j] + eigenvalue * (C[i, j] + eigenvalue * M[i, j])) / size
        for e in range(m):
            matrix[i, n + e] = work.B[e, i]
    for level in range(work.levels.shape[0]):
        rate, second, at = work.levels[level, 1], work.levels[level, 2], n + level * m
        of_B = work.levels[level, 0] + eigenvalue * (rate + eigenvalue * second)
        of_H, unit = rate + 2.0 * eigenvalue * second, row_size(work, eigenvalue, level)
        for e in range(m):
            for i in range(n):
                matrix[at + e, i] = (of_B * work.B[e, i] + of_H * work.H[e, i] + second * work.N[e, i]) / unit
            lu.zero(matrix[at + e, n:])
    if work.levels.shape[0] == 2:
        for e in range(m):
            for i in range(n):
                total = 0.0 * eigenvalue
                for j in range(n):
                    total += (C[i, j] + eigenvalue * M[i, j]) * work.G[e, j]
                matrix[i, n + m + e] = total * (scale / size)
            for o in range(m):
                total = 0.0 * eigenvalue
                for j in range(n):
                    total += work.B[e, j] * work.G[o, j]
                matrix[n + m + e, n + m + o] = total


@part
def factored(work, eigenvalue, number, matrix):
    """Factor the matrix of a mode. False if it is singular."""
    k, total = work.state[CHOSEN], 0.0
    for i in range(work.K.shape[1]):
        total += abs(work.K[k, i, i] + eigenvalue * (work.C[k, i, i] + eigenvalue * work.M[k, i, i]))
    work.sizes[number] = total / work.K.shape[1] if total > 0.0 else 1.0
    whole(matrix, work, eigenvalue, work.sizes[number])
    return lu.factor(matrix, work.pivots[number])


@part
def rows(work, instant, q, v, a, known):
    """B, G, H and N of the middle stage, and the factors with them."""
    m, own = work.B.shape[0], work.dense
    if work.state[FACTORED] and not (m and own.flags[dense.ROWS_VARY]):
        return DONE
    if m:
        dense.set_state(own, instant, q, v)
        own.flags[dense.ROWS_CURRENT] = known
        ended = dense.evaluate_rows(own)
        own.flags[dense.ROWS_CURRENT] = 0
        lu.copy_matrix(own.B, work.B)
        if ended == DONE and work.state[TIED] and own.flags[dense.ROWS_VARY]:
            ended = bend(work, q, a)
        for k in range(m):
            for i in range(work.B.shape[1]):
                work.G[k, i] = work.B[k, i] * work.D[i]
        if ended != DONE:
            return ended
    work.state[FACTORED] = 1
    if work.c[0] != 0.0 and not factored(work, work.c[0], 0, work.real):
        return SINGULAR
    return DONE if work.c[2] == 0.0 or factored(work, complex(work.c[1], work.c[2]), 1, work.pair) else SINGULAR


@part
def corrected(work, matrix, number, eigenvalue, solution, r, closing, dq, multipliers):
    """The correction of a mode."""
    n, m, size = work.K.shape[1], work.B.shape[0], work.sizes[number]
    for i in range(n):
        solution[i] = -r[i] / size
    for level in range(work.levels.shape[0]):
        unit = row_size(work, eigenvalue, level)
        for e in range(level * m, (level + 1) * m):
            solution[n + e] = -closing[e] / unit
    lu.solve(matrix, work.pivots[number], solution)
    lu.put(1.0, solution[:n], dq)
    for e in range(m):
        multipliers[e] = size * solution[n + e]
        multipliers[m + e] = abs(eigenvalue) * solution[n + m + e] if work.levels.shape[0] == 2 else 0.0 * solution[0]


@part
def real(work, instant, r, closing, lam, dq, multipliers):
    """The correction of the real mode."""
    corrected(work, work.real, 0, work.c[0], work.x, r, closing, dq, multipliers)
    return DONE


@part
def pair(work, instant, r, closing, lam, dq, multipliers):
    """The correction of the complex mode."""
    corrected(work, work.pair, 1, complex(work.c[1], work.c[2]), work.x_pair, r, closing, dq, multipliers)
    return DONE


@part
def bias(work, instant, q, v, a, out):
    """The second derivative of phi."""
    own, n = work.dense, work.K.shape[1]
    dense.set_state(own, instant, q, v)
    ended = dense.bias(own)
    restore_rows(work, instant)
    own.flags[dense.ROWS_CURRENT] = 0
    for k in range(work.B.shape[0]):
        out[k] = own.phi_bias[k]
        for i in range(n):
            out[k] += own.B[k, i] * a[i]
    return ended


@part
def inertia(work, instant, v, a, r, p, q, rows):
    """r = C v + M a, and unless their addresses are 0: p = M v, rows = the blocks of rows times v, B v in place of a second block that is not there."""
    k, n, m = work.state[CHOSEN], work.K.shape[1], work.B.shape[0]
    momentum = dense.vector(p, n if p else 0)
    for i in range(n):
        r[i] = 0.0
        for j in range(n):
            r[i] += work.C[k, i, j] * v[j] + work.M[k, i, j] * a[j]
    for i in range(momentum.shape[0]):
        momentum[i] = 0.0
        for j in range(n):
            momentum[i] += work.M[k, i, j] * v[j]
    for level in range(2 if rows else 0):
        of_H, of_B, out = 0.0, 1.0, dense.vector(rows + 8 * level * m, m)
        if level < work.levels.shape[0]:
            of_H, of_B = 2.0 * work.levels[level, 2], work.levels[level, 1] + work.c[0] * work.levels[level, 2]
        for e in range(m):
            out[e] = 0.0
            for i in range(n):
                out[e] += (of_B * work.B[e, i] + of_H * work.H[e, i]) * v[i]
    return DONE


@part
def acceleration(work, instant, q, v, a, lam):
    """As `acceleration` of system/dense.py."""
    return dense.acceleration(work.dense, instant, q, v, a, lam)


@entry
def factor(work, instant, q, v, a, lam, slot):
    """Evaluate K, C and M at a state."""
    d, n = work.dense, work.K.shape[1]
    K, C, M = work.K[slot], work.C[slot], work.M[slot]
    dense.set_state(d, instant, q, v)
    dense.set_a_lam(d, a, lam)
    ended = dense.matrices_at(d, K, C, M)
    work.state[FACTORED] = 0
    good = dense.finite(K.reshape(n * n)) and dense.finite(C.reshape(n * n)) and dense.finite(M.reshape(n * n))
    return ended if ended != DONE or good else NO_MATRIX


@part
def select(work, slot, new):
    """Use the matrices of a slot, with c of the modes."""
    same = work.state[CHOSEN] == slot
    for i in range(3):
        same = same and work.c[i] == new[i]
        work.c[i] = new[i]
    if not same:
        work.state[CHOSEN], work.state[FACTORED] = slot, 0
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
