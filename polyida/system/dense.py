"""The table of a small model with dense matrices: compiled code that calls the model's functions, compiled or Python.

A function of the model is called as `f(data, 0, t, q, v, a, lam, out)`, with the addresses of its arguments and of its result.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
from numba import carray, typeof

from polyida.errors import DONE, NOT_FINITE, SINGULAR
from polyida.jit import entry, pack, part, served
from polyida.jit.intrinsics import address, call, pointer
from polyida.jit.user_functions import table_address
from polyida.linear import dense
from polyida.model.differences import FIRST_ORDER_STEP
from polyida.system import ACCELERATION, ACCEPT, BEGIN, CONSTRAINTS, FACTOR, PROJECT, RATE, RESIDUAL, SOLVE

# constants of compiled code
MASS, FORCE, PHI, PHI_Q, PHI_T, WHOLE, ACCEPTED, TANGENT, FORCE_Q, FORCE_V, MASS_A_Q, REACTION_Q, PHI_BIAS, POTENTIAL = range(14)
FUNCTIONS = (
    "mass", "force", "phi", "phi_q", "phi_t", "residual", "rejection_reason", "tangent", "force_q", "force_v", "mass_a_q", "reaction_q", "phi_bias",
    "potential",
)  # fmt: skip
MASS_VARIES, VELOCITY, DRIVEN, ROWS_VARY, ROWS_VARY_WITH_Q, FACTORED, ROWS_CURRENT, ENDED, OWN = range(9)  # of Dense.flags
# ROWS_VARY: B varies with t or q; FACTORED: the factors are those of the current S and B; ROWS_CURRENT: B is that of the state;
# ENDED: status of the calls since `set_state`; OWN: number of coordinates without those of states
FLAGS = 9
REACH = FIRST_ORDER_STEP
INNER, END = range(2)  # of Dense.t: the end of the step, or, at a kink, a time beside it inside the step; and the end itself


@pack
class Dense(NamedTuple):
    """The workspace of a model with n coordinates and m constraints."""

    functions: np.ndarray  # addresses of FUNCTIONS; 0 without
    data: int  # address of the values that compiled functions read as self
    flags: np.ndarray
    times: np.ndarray  # (instants, 2) INNER and END
    t: np.ndarray  # (2,) t, q, v, a, lam: the functions' arguments
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    lam: np.ndarray
    M: np.ndarray  # (n, n)
    g: np.ndarray
    phi: np.ndarray
    B: np.ndarray  # (m, n)
    phi_t: np.ndarray
    phi_bias: np.ndarray
    c: np.ndarray  # (2,) c_m and c_v
    S: np.ndarray  # (n, n)
    made_at: np.ndarray  # t, q, v, a, lam of S
    slope: np.ndarray  # (n, n)
    near: np.ndarray  # (4, n) values of differences
    lu: np.ndarray  # of S and B
    pivots: np.ndarray
    masses: np.ndarray  # of M and B
    mass_pivots: np.ndarray
    x: np.ndarray  # (n + m,)


def workspace(n, m, functions, data, flags):
    """A Dense of n coordinates and m constraints."""
    N = n + m
    shapes = (2,), n, n, n, m, (n, n), n, m, (m, n), m, m, 2, (n, n), 1 + 3 * n + m, (n, n), (4, n), (N, N)
    matrices = *map(np.zeros, shapes), np.zeros(N, np.int64), np.zeros((N, N)), np.zeros(N, np.int64), np.zeros(N)
    return Dense(functions, data, np.array(flags, np.int64), np.zeros((1, 2)), *matrices)


@part
def vector(at, size):
    """The array (size,) at an address."""
    return carray(pointer(at), (size,))


@part
def coordinates(w, at):
    """The array (n,) at an address."""
    return carray(pointer(at), w.q.shape)


@part
def multipliers(w, at):
    """The array (m,) at an address."""
    return carray(pointer(at), w.lam.shape)


@part
def factors(w, at):
    """The array (2,) at an address, c_m and c_v."""
    return carray(pointer(at), w.c.shape)


@part
def evaluate(w, function, time, out):
    """Call a function of the model at w.t[time], w.q, w.v, w.a, w.lam, unless one failed since `set_state`. Returns the status."""
    if w.flags[ENDED] == DONE:
        t = address(w.t) + 8 * time
        w.flags[ENDED] = call(w.functions[function], w.data, 0, t, address(w.q), address(w.v), address(w.a), address(w.lam), address(out))
    return w.flags[ENDED]


@part
def set_state(w, instant, q, v):
    """Set t, q and v of the functions' arguments."""
    w.flags[ENDED] = DONE
    w.t[INNER], w.t[END] = w.times[instant, INNER], w.times[instant, END]
    dense.put(1.0, q, w.q)
    dense.put(1.0, v, w.v)


@part
def set_a_lam(w, a, lam):
    """Set a and lam of the functions' arguments."""
    dense.put(1.0, a, w.a)
    dense.put(1.0, lam, w.lam)


@part
def evaluate_rows(w):
    """Evaluate B at the state if it varies."""
    if w.lam.shape[0] and w.flags[ROWS_VARY] and not w.flags[ROWS_CURRENT]:
        w.flags[FACTORED] = 0
        evaluate(w, PHI_Q, INNER, w.B)
    return w.flags[ENDED]


@part
def finite(x):
    """True if all entries are finite."""
    total = 0.0
    for i in range(x.shape[0]):
        total += 0.0 * x[i]
    return total == 0.0


@part
def equilibrium(w, r):
    """r = `M a + g + B^T lam` at w.t, w.q, w.v, w.a, w.lam with w.B."""
    if w.functions[WHOLE]:
        evaluate(w, WHOLE, INNER, w.g)
        dense.put(1.0, w.g, r)
        return w.flags[ENDED]
    if w.flags[MASS_VARIES]:
        evaluate(w, MASS, INNER, w.M)
    evaluate(w, FORCE, INNER, w.g)
    for i in range(r.shape[0]):
        total = w.g[i]
        for j in range(r.shape[0]):
            total += w.M[i, j] * w.a[j]
        for k in range(w.lam.shape[0]):
            total += w.B[k, i] * w.lam[k]
        r[i] = total
    return w.flags[ENDED]


@part
def residual(w, instant, q, v, a, lam, r, phi):
    """r at the state inside the step, phi at its end."""
    set_state(w, instant, q, v)
    set_a_lam(w, a, lam)
    if phi.shape[0]:
        evaluate(w, PHI, END, w.phi)
        dense.put(1.0, w.phi, phi)
        evaluate_rows(w)
    ended = equilibrium(w, r)
    return NOT_FINITE if ended == DONE and not (finite(r) and finite(phi)) else ended


@part
def begin(w, instant):
    """Do nothing: phi is computed from positions."""
    return DONE


@part
def constraints(w, instant, q, phi):
    """phi at the end; the rate is unchanged."""
    if not w.lam.shape[0]:
        return DONE
    set_state(w, instant, q, w.v)
    ended = evaluate(w, PHI, END, w.phi)
    dense.put(1.0, w.phi, phi)
    return ended


@part
def constraints_behind(w, instant, q, dq, dv, phi, rate):
    """`constraints`, which needs no increments."""
    return constraints(w, instant, q, phi)


@part
def bordered(A, w, matrix, size):
    """A = [[matrix, s B^T], [s B, 0]], s = size."""
    n, m = w.q.shape[0], w.lam.shape[0]
    for i in range(n):
        dense.put(1.0, matrix[i], A[i])
        for k in range(m):
            A[i, n + k] = size * w.B[k, i]
            A[n + k, i] = size * w.B[k, i]
    for k in range(m):
        dense.zero(A[n + k, n:])


@part
def combined(w, function, out):
    """The value of a function: M a for "mass", B^T lam for "phi_q"."""
    if function == FORCE:
        ended = evaluate(w, FORCE, INNER, w.g)
        dense.put(1.0, w.g, out)
        return ended
    ended = evaluate(w, MASS, INNER, w.slope) if function == MASS else evaluate(w, PHI_Q, INNER, w.B)
    for i in range(out.shape[0]):
        total = 0.0
        if function == MASS:
            for j in range(w.a.shape[0]):
                total += w.slope[i, j] * w.a[j]
        else:
            for k in range(w.lam.shape[0]):
                total += w.B[k, i] * w.lam[k]
        out[i] = total
    return ended


@part
def add_difference(w, function, x, c):
    """S += c d/dx of a function's value, by differences of fourth order (model/differences.py)."""
    for j in range(x.shape[0]):
        at = x[j]
        step = REACH * max(1.0, abs(at))
        for e in range(4):
            x[j] = at + (1.0, -1.0, 2.0, -2.0)[e] * step
            combined(w, function, w.near[e])
        x[j] = at
        for i in range(w.S.shape[0]):
            w.S[i, j] += c * (8.0 * (w.near[0, i] - w.near[1, i]) - (w.near[2, i] - w.near[3, i])) / (12.0 * step)
    return w.flags[ENDED]


@part
def add_slope(w, written, function, x, c):
    """S += c times a derivative that the model writes, or its difference."""
    if not w.functions[written]:
        return add_difference(w, function, x, c)
    ended = evaluate(w, written, INNER, w.slope)
    for i in range(w.S.shape[0]):
        for j in range(w.S.shape[0]):
            w.S[i, j] += c * w.slope[i, j]
    return ended


@part
def add_slopes(w):
    """S as the sum of the model's terms at w.t, w.q, w.v, w.a, w.lam."""
    if w.flags[MASS_VARIES]:
        evaluate(w, MASS, INNER, w.M)
    for i in range(w.S.shape[0]):
        dense.put(w.c[0], w.M[i], w.S[i])
    add_slope(w, FORCE_Q, FORCE, w.q, 1.0)
    if w.flags[VELOCITY]:
        add_slope(w, FORCE_V, FORCE, w.v, w.c[1])
    if w.flags[MASS_VARIES]:
        add_slope(w, MASS_A_Q, MASS, w.q, 1.0)
    if w.flags[ROWS_VARY_WITH_Q] and w.lam.shape[0]:
        add_slope(w, REACTION_Q, PHI_Q, w.q, 1.0)
    return w.flags[ENDED]


@part
def matrices_at(w, K, C, M):
    """Fill K = dr/dq, C = dr/dv, unless that is zero, and M at w.t, w.q, w.v, w.a, w.lam. Returns the status."""
    if w.flags[VELOCITY]:
        dense.clear(w.S)
        add_slope(w, FORCE_V, FORCE, w.v, 1.0)
        dense.copy_matrix(w.S, C)
    if w.flags[MASS_VARIES]:
        evaluate(w, MASS, INNER, w.M)
    dense.copy_matrix(w.M, M)
    w.c[0] = w.c[1] = 0.0
    ended = evaluate(w, TANGENT, INNER, w.S) if w.functions[TANGENT] else add_slopes(w)
    dense.copy_matrix(w.S, K)
    return ended


@entry
def factor(w, instant, q, v, a, lam, c):
    """S at a state; `solve` factors it with B."""
    n = w.q.shape[0]
    set_state(w, instant, q, v)
    set_a_lam(w, a, lam)
    dense.put(1.0, c, w.c)
    w.made_at[0] = w.t[INNER]
    dense.put(1.0, w.q, w.made_at[1:])
    dense.put(1.0, w.v, w.made_at[1 + n :])
    dense.put(1.0, w.a, w.made_at[1 + 2 * n :])
    dense.put(1.0, w.lam, w.made_at[1 + 3 * n :])
    w.flags[FACTORED] = 0
    return evaluate(w, TANGENT, INNER, w.S) if w.functions[TANGENT] else add_slopes(w)


@part
def typical(matrix):
    """Mean size of the diagonal; 1 if it is zero."""
    total = 0.0
    for i in range(matrix.shape[0]):
        total += abs(matrix[i, i])
    return total / matrix.shape[0] if total > 0.0 else 1.0


@part
def solve_bordered(w, A, pivots, size):
    """w.x becomes the solution of a factored `bordered` system."""
    for k in range(w.q.shape[0], w.x.shape[0]):
        w.x[k] *= size
    dense.solve(A, pivots, w.x)
    for k in range(w.q.shape[0], w.x.shape[0]):
        w.x[k] *= size


@part
def solve_masses(w):
    """w.x becomes the solution of the system of M and B. Returns the status."""
    size = typical(w.M)
    bordered(w.masses, w, w.M, size)
    if not dense.factor(w.masses, w.mass_pivots):
        return SINGULAR
    solve_bordered(w, w.masses, w.mass_pivots, size)
    return DONE


@part
def solve(w, instant, q, lam, r, phi, dq, dlam):
    """dq and dlam of one Newton correction."""
    n, size = w.q.shape[0], typical(w.S)
    if not w.flags[FACTORED]:
        bordered(w.lu, w, w.S, size)
        if not dense.factor(w.lu, w.pivots):
            return SINGULAR
        w.flags[FACTORED] = 1
    dense.put(-1.0, r, w.x)
    dense.put(-1.0, phi, w.x[n:])
    solve_bordered(w, w.lu, w.pivots, size)
    dense.put(1.0, w.x[:n], dq)
    dense.put(1.0, w.x[n:], dlam)
    return DONE


@part
def rate(w, instant, q, v, rows):
    """rows = phi_q v + phi_t."""
    set_state(w, instant, q, v)
    evaluate_rows(w)
    if w.flags[DRIVEN]:
        evaluate(w, PHI_T, INNER, w.phi_t)
    for k in range(rows.shape[0]):
        total = w.phi_t[k]
        for i in range(w.q.shape[0]):
            total += w.B[k, i] * w.v[i]
        rows[k] = total
    return w.flags[ENDED]


@part
def project(w, instant, right, moved, from_zero):
    """Change `moved` by the least M-norm, so that B moved falls by `right`; from_zero: the least one with B moved = B moved_before - right."""
    n, m = w.q.shape[0], w.lam.shape[0]
    if w.flags[MASS_VARIES] and evaluate(w, MASS, INNER, w.M) != DONE:
        return w.flags[ENDED]
    for k in range(m):
        total = right[k]
        if from_zero:
            for i in range(n):
                total -= w.B[k, i] * moved[i]
        w.x[n + k] = -total
    dense.zero(w.x[:n])
    if solve_masses(w) != DONE:
        return SINGULAR
    for i in range(n):
        moved[i] = w.x[i] if from_zero else moved[i] + w.x[i]
    return DONE


@part
def accept(w, instant, q):
    """Ask the model whether it accepts the state."""
    if not w.functions[ACCEPTED]:
        return DONE
    set_state(w, instant, q, w.v)
    return evaluate(w, ACCEPTED, END, w.x)


@part
def reach(w):
    """The s, at most 1, for which |s v| is 1 + |q|, in the maximum norm."""
    size = pace = 0.0
    for i in range(w.q.shape[0]):
        size, pace = max(size, abs(w.q[i])), max(pace, abs(w.v[i]))
    return (1.0 + size) / pace if pace > 1.0 + size else 1.0


@part
def bias(w):
    """w.phi_bias at w.t, w.q, w.v: the model's, or, without drives, differences of fourth order of `phi_q v` along v. Changes w.B."""
    n, m = w.q.shape[0], w.lam.shape[0]
    if w.functions[PHI_BIAS]:
        return evaluate(w, PHI_BIAS, INNER, w.phi_bias)
    dense.zero(w.phi_bias)
    if not w.flags[ROWS_VARY]:
        return DONE
    at, step = w.near[0], REACH * reach(w)
    dense.put(1.0, w.q, at)
    for e in range(4):
        s, weight = (1.0, -1.0, 2.0, -2.0)[e] * step, (8.0, -8.0, -1.0, 1.0)[e] / (12.0 * step)
        for i in range(n):
            w.q[i] = at[i] + s * w.v[i]
        evaluate(w, PHI_Q, INNER, w.B)
        for k in range(m):
            for i in range(n):
                w.phi_bias[k] += weight * w.B[k, i] * w.v[i]
    dense.put(1.0, at, w.q)
    return w.flags[ENDED]


@part
def acceleration(w, instant, q, v, a, lam):
    """a and lam that are consistent with q and v: `[[M, B^T], [B, 0]] (a, lam) = (-g, -phi_bias)`."""
    n, m = w.q.shape[0], w.lam.shape[0]
    set_state(w, instant, q, v)
    if w.flags[MASS_VARIES]:
        evaluate(w, MASS, INNER, w.M)
    evaluate(w, FORCE, INNER, w.g)
    if m:
        bias(w)
    if evaluate_rows(w) != DONE:
        return w.flags[ENDED]
    dense.put(-1.0, w.g, w.x)
    dense.put(-1.0, w.phi_bias, w.x[n:])
    if solve_masses(w) != DONE:
        return SINGULAR
    dense.put(1.0, w.x[:n], a)
    dense.put(1.0, w.x[n:], lam)
    return DONE


@entry
def values(d, t, q, v, a, lam, r, phi, rates, biases):
    """Fill r, phi, phi's rate and bias of states (k, .); each may be empty, (0, .). Returns how it ended."""
    ended = DONE
    for k in range(t.shape[0]):
        d.times[0, INNER] = d.times[0, END] = t[k]
        if r.shape[0]:
            ended = residual(d, 0, q[k], v[k], a[k], lam[k], r[k], d.phi)
        elif phi.shape[0]:
            set_state(d, 0, q[k], v[k])
            ended = evaluate(d, PHI, END, d.phi)
        if phi.shape[0]:
            dense.put(1.0, d.phi, phi[k])
        if ended == DONE and rates.shape[0]:
            ended = rate(d, 0, q[k], v[k], rates[k])
        if ended == DONE and biases.shape[0]:
            set_state(d, 0, q[k], v[k])
            ended = bias(d)
            dense.put(1.0, d.phi_bias, biases[k])
        if ended != DONE:
            return ended
    return DONE


SERVED = {
    RESIDUAL: served(residual, coordinates, coordinates, coordinates, multipliers, coordinates, multipliers),
    BEGIN: served(begin),
    CONSTRAINTS: served(constraints_behind, coordinates, None, None, multipliers, None),
    FACTOR: served(factor, coordinates, coordinates, coordinates, multipliers, factors),
    SOLVE: served(solve, None, None, coordinates, multipliers, coordinates, multipliers),
    RATE: served(rate, coordinates, coordinates, multipliers),
    PROJECT: served(project, multipliers, coordinates, None),
    ACCEPT: served(accept, coordinates),
}
OF_FRAMES = {ACCELERATION: served(acceleration, coordinates, coordinates, coordinates, multipliers)}


@cache
def example():
    """A Dense; all of them have one type."""
    return workspace(1, 0, np.zeros(len(FUNCTIONS), np.int64), 0, (0,) * FLAGS)


@cache
def addresses():
    """{number: address} of the entries, for all Dense."""
    return {number: table_address(function, typeof(example())) for number, function in SERVED.items()}
