"""The matrices of a small model with dense matrices: of one state and its step matrix S, and of several states and their modes.

The matrix of a mode with eigenvalue c, in blocks, with S = K + c C + c^2 M and G = B D^-1:

    |  S    B^T  (c M + C) G^T |
    |  R_0                     |
    |  R_1            B G^T    |

The rows of block k weigh phi, phi' and phi'' by (w0, w1, w2), row k of Slots.levels: `R_k = (w0 + c w1 + c^2 w2) B + (w1 + 2 c w2) H + w2 N`.
In Radau IIA levels are rows of the identity (radau/tables/python.py), in IDA those of its form (ida/tables.py). With one block there is no mu.
"""

from numba import carray

from polyida import system as of
from polyida.errors import DONE, NO_MATRIX, SINGULAR
from polyida.jit import entry, part, served
from polyida.jit.intrinsics import complex_pointer, pointer
from polyida.linear import dense as lu
from polyida.model.differences import NEAR
from polyida.system import dense

CHOSEN, FACTORS_MADE = range(2)  # of Slots.state: the slot in use, and whether its factors are made with the rows at hand


@part
def blocks(work, at):
    """The array (2 m,) at an address: rows of phi, and of phi'."""
    return carray(pointer(at), (2 * work.lam.shape[0],))


@part
def complex_coordinates(work, at):
    """The complex array (n,) at an address, a view."""
    return carray(complex_pointer(at), work.q.shape)


@part
def complex_blocks(work, at):
    """The complex array (2 m,) at an address."""
    return carray(complex_pointer(at), (2 * work.lam.shape[0],))


@part
def mode_values(work, at):
    """c of the real mode, and the real and imaginary part of that of the complex one, at an address."""
    return carray(pointer(at), (3,))


@part
def coefficients(work, at):
    """The array (2,) at an address, c_m and c_v."""
    return carray(pointer(at), work.coefficients.shape)


@part
def product_of(work, function, out):
    """Fill out: g for FORCE, M a for MASS, B^T lam for PHI_Q. MASS changes work.slope, PHI_Q work.B."""
    if function == dense.FORCE:
        ended = dense.evaluate(work, dense.FORCE, dense.INNER, work.g)
        lu.put(1.0, work.g, out)
        return ended
    if function == dense.MASS:
        ended = dense.evaluate(work, dense.MASS, dense.INNER, work.slope)
    else:
        ended = dense.evaluate(work, dense.PHI_Q, dense.INNER, work.B)
    for i in range(out.shape[0]):
        total = 0.0
        if function == dense.MASS:
            for j in range(work.a.shape[0]):
                total += work.slope[i, j] * work.a[j]
        else:
            for k in range(work.lam.shape[0]):
                total += work.B[k, i] * work.lam[k]
        out[i] = total
    return ended


@part
def add_difference(work, function, argument, factor):
    """S += factor d/dx of a function's value, by differences of fourth order (model/differences.py)."""
    for j in range(argument.shape[0]):
        at = argument[j]
        step = dense.REACH * max(1.0, abs(at))
        for e in range(4):
            argument[j] = at + (1.0, -1.0, 2.0, -2.0)[e] * step
            product_of(work, function, work.near[e])
        argument[j] = at
        for i in range(work.S.shape[0]):
            work.S[i, j] += factor * (8.0 * (work.near[0, i] - work.near[1, i]) - (work.near[2, i] - work.near[3, i])) / (12.0 * step)
    return work.flags[dense.ENDED]


@part
def add_slope(work, written, function, argument, factor):
    """Add to work.S factor times a derivative: the model's own, `written`, or else the difference of `function` in `argument`."""
    if not work.functions[written]:
        return add_difference(work, function, argument, factor)
    ended = dense.evaluate(work, written, dense.INNER, work.slope)
    for i in range(work.S.shape[0]):
        for j in range(work.S.shape[0]):
            work.S[i, j] += factor * work.slope[i, j]
    return ended


@part
def add_slopes(work):
    """Overwrite work.S with `c_m M + c_v C + K` at work.t, work.q, work.v, work.a, work.lam, c_m and c_v in work.coefficients.

    Returns the status. K and C are the sum of the derivatives of the terms of r.
    """
    if work.flags[dense.MASS_VARIES]:
        dense.evaluate(work, dense.MASS, dense.INNER, work.M)
    for i in range(work.S.shape[0]):
        lu.put(work.coefficients[0], work.M[i], work.S[i])
    add_slope(work, dense.FORCE_Q, dense.FORCE, work.q, 1.0)
    if work.flags[dense.VELOCITY]:
        add_slope(work, dense.FORCE_V, dense.FORCE, work.v, work.coefficients[1])
    if work.flags[dense.MASS_VARIES]:
        add_slope(work, dense.MASS_A_Q, dense.MASS, work.q, 1.0)
    if work.flags[dense.ROWS_VARY_WITH_Q] and work.lam.shape[0]:
        add_slope(work, dense.REACTION_Q, dense.PHI_Q, work.q, 1.0)
    return work.flags[dense.ENDED]


@part
def matrices_at(work, K, C, M):
    """Overwrite K = dr/dq, C = dr/dv and M, (n, n) each, at work.t, work.q, work.v, work.a, work.lam. Returns the status.

    If forces do not depend on v, C stays as it is. work.S, work.slope and work.coefficients are changed.
    """
    if work.flags[dense.VELOCITY]:
        lu.clear(work.S)
        add_slope(work, dense.FORCE_V, dense.FORCE, work.v, 1.0)
        lu.copy_matrix(work.S, C)
    if work.flags[dense.MASS_VARIES]:
        dense.evaluate(work, dense.MASS, dense.INNER, work.M)
    lu.copy_matrix(work.M, M)
    work.coefficients[0] = work.coefficients[1] = 0.0
    ended = dense.evaluate(work, dense.TANGENT, dense.INNER, work.S) if work.functions[dense.TANGENT] else add_slopes(work)
    lu.copy_matrix(work.S, K)
    return ended


@entry
def factor(work, instant, q, v, a, lam, factors):
    """Make S = factors[0] M + factors[1] C + K at a state; `solve` factors it with B."""
    n = work.q.shape[0]
    dense.set_state(work, instant, q, v)
    dense.set_a_lam(work, a, lam)
    lu.put(1.0, factors, work.coefficients)
    work.made_at[0] = work.t[dense.INNER]
    lu.put(1.0, work.q, work.made_at[1:])
    lu.put(1.0, work.v, work.made_at[1 + n :])
    lu.put(1.0, work.a, work.made_at[1 + 2 * n :])
    lu.put(1.0, work.lam, work.made_at[1 + 3 * n :])
    work.flags[dense.FACTORED] = 0
    return dense.evaluate(work, dense.TANGENT, dense.INNER, work.S) if work.functions[dense.TANGENT] else add_slopes(work)


@part
def solve(work, instant, q, lam, residual, phi, dq, dlam):
    """Fill dq and dlam of one Newton correction: `S dq + B^T dlam = -residual`, `B dq = -phi`; S is factored with B if that is not done yet."""
    n, size = work.q.shape[0], dense.typical(work.S)
    if not work.flags[dense.FACTORED]:
        dense.bordered(work.lu, work, work.S, size)
        if not lu.factor(work.lu, work.pivots):
            return SINGULAR
        work.flags[dense.FACTORED] = 1
    lu.put(-1.0, residual, work.x)
    lu.put(-1.0, phi, work.x[n:])
    dense.solve_bordered(work, work.lu, work.pivots, size)
    lu.put(1.0, work.x[:n], dq)
    lu.put(1.0, work.x[n:], dlam)
    return DONE


@part
def bend(work, q, a):
    """H and N of the middle stage: first and second derivative of B(t + s, q + s v + s^2 a/2) at s = 0; a: the address of a, or 0.

    At first N becomes B(+s) - B and H becomes B(+s), from which B(-s) then makes the differences.
    """
    slots, step, n = work.slots, NEAR * dense.reach(work), work.q.shape[0]
    towards = dense.vector(a, n if a else 0)
    t, ended = work.t[dense.INNER], DONE
    for e in range(2):
        s = (step, -step)[e]
        for i in range(work.q.shape[0]):
            work.q[i] = q[i] + s * work.v[i]
        for i in range(towards.shape[0]):
            work.q[i] += 0.5 * s * s * towards[i]
        work.t[dense.INNER] = t + s
        if ended == DONE:
            ended = dense.evaluate(work, dense.PHI_Q, dense.INNER, work.B)
        for k in range(slots.H.shape[0]):
            for i in range(slots.H.shape[1]):
                change = work.B[k, i] - slots.B[k, i]
                slots.N[k, i] = change if e == 0 else (slots.N[k, i] + change) / (step * step)
                slots.H[k, i] = work.B[k, i] if e == 0 else (slots.H[k, i] - work.B[k, i]) / (2.0 * step)
    work.t[dense.INNER] = t
    lu.put(1.0, q, work.q)
    lu.copy_matrix(slots.B, work.B)
    return ended


@part
def row_size(slots, eigenvalue, level):
    """Divisor of the rows of a block: the factor of B in them."""
    return abs(slots.levels[level, 0] + eigenvalue * (slots.levels[level, 1] + eigenvalue * slots.levels[level, 2]))


@part
def fill_matrix(matrix, slots, eigenvalue, size):
    """Overwrite matrix (N, N) with the matrix of a mode, in blocks as above, from K, C and M of the chosen slot and B, G, H, N of slots.

    eigenvalue: c of the mode, real or complex; size: the typical size of S. The rows of r are divided by size, the others by `row_size`.
    lam is in units of size, mu in those of |c|.
    """
    k, n, m, scale = slots.state[CHOSEN], slots.K.shape[1], slots.B.shape[0], abs(eigenvalue)
    K, C, M = slots.K[k], slots.C[k], slots.M[k]
    for i in range(n):
        for j in range(n):
            matrix[i, j] = (K[i, j] + eigenvalue * (C[i, j] + eigenvalue * M[i, j])) / size
        for e in range(m):
            matrix[i, n + e] = slots.B[e, i]
    for level in range(slots.levels.shape[0]):
        rate, second, at = slots.levels[level, 1], slots.levels[level, 2], n + level * m
        of_B, of_H, unit = (
            slots.levels[level, 0] + eigenvalue * (rate + eigenvalue * second),
            rate + 2.0 * eigenvalue * second,
            row_size(slots, eigenvalue, level),
        )
        for e in range(m):
            for i in range(n):
                matrix[at + e, i] = (of_B * slots.B[e, i] + of_H * slots.H[e, i] + second * slots.N[e, i]) / unit
            lu.zero(matrix[at + e, n:])
    if slots.levels.shape[0] == 2:
        for e in range(m):
            for i in range(n):
                total = 0.0 * eigenvalue
                for j in range(n):
                    total += (C[i, j] + eigenvalue * M[i, j]) * slots.G[e, j]
                matrix[i, n + m + e] = total * (scale / size)
            for o in range(m):
                total = 0.0 * eigenvalue
                for j in range(n):
                    total += slots.B[e, j] * slots.G[o, j]
                matrix[n + m + e, n + m + o] = total


@part
def factored(slots, eigenvalue, number, matrix):
    """Factor the matrix of a mode. False if it is singular."""
    k, total = slots.state[CHOSEN], 0.0
    for i in range(slots.K.shape[1]):
        total += abs(slots.K[k, i, i] + eigenvalue * (slots.C[k, i, i] + eigenvalue * slots.M[k, i, i]))
    slots.sizes[number] = total / slots.K.shape[1] if total > 0.0 else 1.0
    fill_matrix(matrix, slots, eigenvalue, slots.sizes[number])
    return lu.factor(matrix, slots.pivots[number])


@part
def rows(work, instant, q, v, a, known):
    """Compute B, G, H and N of the middle stage, and factor the matrices of the modes with them, unless nothing has changed."""
    slots, m = work.slots, work.lam.shape[0]
    if slots.state[FACTORS_MADE] and not (m and work.flags[dense.ROWS_VARY]):
        return DONE
    if m:
        dense.set_state(work, instant, q, v)
        ended = DONE if known else dense.evaluate_rows(work, instant, 0)
        lu.copy_matrix(work.B, slots.B)
        if ended == DONE and work.flags[dense.TIED] and work.flags[dense.ROWS_VARY]:
            ended = bend(work, q, a)
        for k in range(m):
            for i in range(slots.B.shape[1]):
                slots.G[k, i] = slots.B[k, i] * slots.D[i]
        if ended != DONE:
            return ended
    slots.state[FACTORS_MADE] = 1
    if slots.c[0] != 0.0 and not factored(slots, slots.c[0], 0, slots.real):
        return SINGULAR
    return DONE if slots.c[2] == 0.0 or factored(slots, complex(slots.c[1], slots.c[2]), 1, slots.pair) else SINGULAR


@part
def corrected(slots, matrix, number, eigenvalue, solution, residual, closing, dq, multipliers):
    """Fill dq (n,) and multipliers (2 m,) of a mode: its factored matrix times them is the negative of residual (n,) and closing (2 m,)."""
    n, m, size = slots.K.shape[1], slots.B.shape[0], slots.sizes[number]
    for i in range(n):
        solution[i] = -residual[i] / size
    for level in range(slots.levels.shape[0]):
        unit = row_size(slots, eigenvalue, level)
        for e in range(level * m, (level + 1) * m):
            solution[n + e] = -closing[e] / unit
    lu.solve(matrix, slots.pivots[number], solution)
    lu.put(1.0, solution[:n], dq)
    for e in range(m):
        multipliers[e] = size * solution[n + e]
        multipliers[m + e] = abs(eigenvalue) * solution[n + m + e] if slots.levels.shape[0] == 2 else 0.0 * solution[0]


@part
def real(work, instant, residual, closing, lam, dq, multipliers):
    """Fill dq and multipliers, the correction of the real mode."""
    slots = work.slots
    corrected(slots, slots.real, 0, slots.c[0], slots.real_x, residual, closing, dq, multipliers)
    return DONE


@part
def pair(work, instant, residual, closing, lam, dq, multipliers):
    """Fill dq and multipliers, complex: the correction of the complex mode."""
    slots = work.slots
    corrected(slots, slots.pair, 1, complex(slots.c[1], slots.c[2]), slots.pair_x, residual, closing, dq, multipliers)
    return DONE


@part
def inertia(work, instant, v, a, force, momentum_at, q, rows_at):
    """Fill force = `C v + M a`, and at their addresses, unless these are 0, the momentum `M v` and the constraint rows times v.

    rows_at: (2 m,); B v is written in place of a second block that is not there.

    w2 is not 0 in IDA only, whose c is real: slots.c[0].
    """
    slots, n, m = work.slots, work.q.shape[0], work.lam.shape[0]
    k = slots.state[CHOSEN]
    momentum = dense.vector(momentum_at, n if momentum_at else 0)
    for i in range(n):
        force[i] = 0.0
        for j in range(n):
            force[i] += slots.C[k, i, j] * v[j] + slots.M[k, i, j] * a[j]
    for i in range(momentum.shape[0]):
        momentum[i] = 0.0
        for j in range(n):
            momentum[i] += slots.M[k, i, j] * v[j]
    for level in range(2 if rows_at else 0):
        of_H, of_B, out = 0.0, 1.0, dense.vector(rows_at + 8 * level * m, m)
        if level < slots.levels.shape[0]:
            of_H, of_B = 2.0 * slots.levels[level, 2], slots.levels[level, 1] + slots.c[0] * slots.levels[level, 2]
        for e in range(m):
            out[e] = 0.0
            for i in range(n):
                out[e] += (of_B * slots.B[e, i] + of_H * slots.H[e, i]) * v[i]
    return DONE


@entry
def matrices(work, instant, q, v, a, lam, slot):
    """Evaluate K, C and M at a state, and store them in a slot; the status is NO_MATRIX if they are not finite."""
    slots, n = work.slots, work.q.shape[0]
    K, C, M = slots.K[slot], slots.C[slot], slots.M[slot]
    dense.set_state(work, instant, q, v)
    dense.set_a_lam(work, a, lam)
    ended = matrices_at(work, K, C, M)
    slots.state[FACTORS_MADE] = 0
    good = dense.finite(K.reshape(n * n)) and dense.finite(C.reshape(n * n)) and dense.finite(M.reshape(n * n))
    return ended if ended != DONE or good else NO_MATRIX


@part
def select(work, slot, new):
    """Use the matrices of a slot; new (3,): c of the real mode, real and imaginary part of that of the complex one."""
    slots = work.slots
    same = slots.state[CHOSEN] == slot
    for i in range(3):
        same = same and slots.c[i] == new[i]
        slots.c[i] = new[i]
    if not same:
        slots.state[CHOSEN], slots.state[FACTORS_MADE] = slot, 0
    return DONE


SERVED = {
    of.FACTOR: served(factor, dense.coordinates, dense.coordinates, dense.coordinates, dense.multipliers, coefficients),
    of.SOLVE: served(solve, None, None, dense.coordinates, dense.multipliers, dense.coordinates, dense.multipliers),
    of.ROWS: served(rows, dense.coordinates, dense.coordinates, None, None),
    of.REAL: served(real, dense.coordinates, blocks, None, dense.coordinates, blocks),
    of.PAIR: served(pair, complex_coordinates, complex_blocks, None, complex_coordinates, complex_blocks),
    of.INERTIA: served(inertia, dense.coordinates, dense.coordinates, dense.coordinates, None, None, None),
    of.MATRICES: served(matrices, dense.coordinates, dense.coordinates, dense.coordinates, dense.multipliers, None),
    of.SELECT: served(select, mode_values),
}
