"""The table of a small model with dense matrices: compiled code that calls the model's functions, compiled or Python.

A function of the model is called as `f(data, 0, t, q, v, a, lam, out)`, with the addresses of its arguments and of its result. Here are the
workspace and the entries that evaluate the model; system/dense_slots.py makes its matrices and solves with them.
"""

from typing import NamedTuple

import numpy as np
from numba import carray

from polyida import system as of
from polyida.assembly.own_laws import NOISE, POINTS
from polyida.errors import DONE, NOT_FINITE, SINGULAR
from polyida.jit import entry, pack, part, served
from polyida.jit.intrinsics import address, call, pointer
from polyida.linear import dense
from polyida.linear.lu import FACTORS
from polyida.model.differences import FIRST_ORDER_STEP

# constants of compiled code
MASS, FORCE, PHI, PHI_Q, PHI_T, WHOLE, ACCEPTED, TANGENT, FORCE_Q, FORCE_V, MASS_A_Q, REACTION_Q, PHI_BIAS, POTENTIAL = range(14)
FUNCTIONS = (
    "mass", "force", "phi", "phi_q", "phi_t", "residual", "rejection_reason", "tangent", "force_q", "force_v", "mass_a_q", "reaction_q", "phi_bias",
    "potential",
)  # fmt: skip
MASS_VARIES, VELOCITY, DRIVEN, ROWS_VARY, ROWS_VARY_WITH_Q, FACTORED, TIED, ENDED, OWN = range(9)  # of Dense.flags
# ROWS_VARY: B varies with t or q; FACTORED: the factors are those of the current S and B; TIED: a derivative of phi is a row, so that `reaction`
# comes before `residual` and keeps its B; ENDED: status of the calls since `set_state`; OWN: number of coordinates without those of states
FLAGS = 9
REACH = FIRST_ORDER_STEP
NO_LEVELS = np.zeros((0, 3))
INNER, END = range(2)  # of Dense.t: the end of the step, or, at a kink, a time beside it inside the step; and the end itself


@pack
class Slots(NamedTuple):
    """Matrices of several states, and the factors of the modes of one of them; arrays of size 0 if the method has none."""

    K: np.ndarray  # (slots, n, n) dr/dq
    C: np.ndarray  # (slots, n, n) dr/dv
    M: np.ndarray  # (slots, n, n)
    state: np.ndarray  # (2,) CHOSEN and FACTORS_MADE of system/dense_slots.py
    c: np.ndarray  # (3,) argument of SELECT: c of the real mode, real and imaginary part of that of the complex one
    levels: np.ndarray  # (k, 3) factors of phi, phi' and phi'' in each of k blocks of m rows; of two blocks the second belongs to mu
    D: np.ndarray  # (n,) diagonal of D^-1
    B: np.ndarray  # (m, n) rows of the middle stage
    H: np.ndarray  # (m, n) first derivative of B along the motion
    N: np.ndarray  # (m, n) second derivative
    G: np.ndarray  # (m, n) B D^-1
    sizes: np.ndarray  # (2,) typical size of S of each mode
    pivots: np.ndarray  # (2, N)
    real: np.ndarray  # (N, N) factored matrix of the real mode
    real_x: np.ndarray  # (N,) its solution
    pair: np.ndarray  # (N, N) complex: of the complex mode
    pair_x: np.ndarray  # (N,) complex


@pack
class Dense(NamedTuple):
    """The workspace of a model with n coordinates and m constraints, for all methods."""

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
    coefficients: np.ndarray  # (2,) c_m and c_v
    S: np.ndarray  # (n, n)
    made_at: np.ndarray  # t, q, v, a, lam of S
    slope: np.ndarray  # (n, n)
    near: np.ndarray  # (4, n) values of differences
    lu: np.ndarray  # of S and B
    pivots: np.ndarray
    masses: np.ndarray  # of M and B
    mass_pivots: np.ndarray
    x: np.ndarray  # (n + m,)
    kept_rows: np.ndarray  # (stages, m, n) B of the stages of a step; 0 stages if no method asks for `reaction`
    slots: Slots


def workspace(n, m, functions, data, flags, stages=0, levels=NO_LEVELS):
    """A Dense of n coordinates and m constraints, with Slots for methods of some stages.

    levels (k, 3): factors of phi, phi' and phi'' in each of k blocks of constraint rows.
    """
    size = n + m
    return Dense(
        functions=functions,
        data=data,
        flags=np.array(flags, np.int64),
        times=np.zeros((1, 2)),
        t=np.zeros(2),
        q=np.zeros(n),
        v=np.zeros(n),
        a=np.zeros(n),
        lam=np.zeros(m),
        M=np.zeros((n, n)),
        g=np.zeros(n),
        phi=np.zeros(m),
        B=np.zeros((m, n)),
        phi_t=np.zeros(m),
        phi_bias=np.zeros(m),
        coefficients=np.zeros(2),
        S=np.zeros((n, n)),
        made_at=np.zeros(1 + 3 * n + m),
        slope=np.zeros((n, n)),
        near=np.zeros((4, n)),
        lu=np.zeros((size, size)),
        pivots=np.zeros(size, np.int64),
        masses=np.zeros((size, size)),
        mass_pivots=np.zeros(size, np.int64),
        x=np.zeros(size),
        kept_rows=np.zeros((stages, m, n)),
        slots=workspace_of_slots(n, m, FACTORS if stages else 0, levels),
    )


def workspace_of_slots(n, m, count, levels):
    """Slots for `count` factors of n coordinates and m constraints. levels (k, 3): factors of phi, phi' and phi'' in k blocks of rows."""
    size = n + len(levels) * m if count else 0
    return Slots(
        K=np.zeros((count, n, n)),
        C=np.zeros((count, n, n)),
        M=np.zeros((count, n, n)),
        state=np.zeros(2, np.int64),
        c=np.zeros(3),
        levels=levels,
        D=np.ones(n),
        B=np.zeros((m, n)),
        H=np.zeros((m, n)),
        N=np.zeros((m, n)),
        G=np.zeros((m, n)),
        sizes=np.zeros(2),
        pivots=np.zeros((2, size), np.int64),
        real=np.zeros((size, size)),
        real_x=np.zeros(size),
        pair=np.zeros((size, size), complex),
        pair_x=np.zeros(size, complex),
    )


@part
def vector(at, size):
    """The array (size,) at an address."""
    return carray(pointer(at), (size,))


@part
def coordinates(work, at):
    """The array (n,) at an address."""
    return carray(pointer(at), work.q.shape)


@part
def multipliers(work, at):
    """The array (m,) at an address."""
    return carray(pointer(at), work.lam.shape)


@part
def step_times(work, at):
    """A view of the array at an address: h, the time at which a step begins, the same or beside a kink, and the times of its instants."""
    return carray(pointer(at), (3 + work.kept_rows.shape[0],))


@part
def five_states(work, at):
    """The vectors q_0, q_1, and q, v, a of the middle at an address, (5, n)."""
    return carray(pointer(at), (5, work.q.shape[0]))


@part
def evaluate(work, function, time, out):
    """Call function number `function` of the model at work.t[time], work.q, work.v, work.a, work.lam; it writes its result to `out`.

    Nothing is called if one failed since `set_state`. Returns the status, which work.flags keeps.
    """
    if work.flags[ENDED] == DONE:
        t = address(work.t) + 8 * time
        work.flags[ENDED] = call(work.functions[function], (work.data, 0, t, work.q, work.v, work.a, work.lam, out))
    return work.flags[ENDED]


@part
def set_state(work, instant, q, v):
    """Set t, q and v of the functions' arguments, t that of an instant; earlier failures of functions are forgotten."""
    work.flags[ENDED] = DONE
    work.t[INNER], work.t[END] = work.times[instant, INNER], work.times[instant, END]
    dense.put(1.0, q, work.q)
    dense.put(1.0, v, work.v)


@part
def set_a_lam(work, a, lam):
    """Set a and lam of the functions' arguments."""
    dense.put(1.0, a, work.a)
    dense.put(1.0, lam, work.lam)


@part
def kept_rows(work, instant):
    """The array for B of the stage at an instant."""
    return work.kept_rows[(instant - 1) % (work.kept_rows.shape[0] + 1)]


@part
def evaluate_rows(work, instant, known):
    """Make B at the state; known: that of the last `reaction` at this instant; else it is evaluated if it varies."""
    if known:
        dense.copy_matrix(kept_rows(work, instant), work.B)
    elif work.lam.shape[0] and work.flags[ROWS_VARY]:
        work.flags[FACTORED] = 0
        evaluate(work, PHI_Q, INNER, work.B)
    return work.flags[ENDED]


@part
def finite(values):
    """True if all entries are finite."""
    total = 0.0
    for i in range(values.shape[0]):
        total += 0.0 * values[i]
    return total == 0.0


@part
def equilibrium(work, residual):
    """Fill the residual `M a + g + B^T lam` at work.t, work.q, work.v, work.a, work.lam with work.B."""
    if work.functions[WHOLE]:
        evaluate(work, WHOLE, INNER, work.g)
        dense.put(1.0, work.g, residual)
        return work.flags[ENDED]
    if work.flags[MASS_VARIES]:
        evaluate(work, MASS, INNER, work.M)
    evaluate(work, FORCE, INNER, work.g)
    for i in range(residual.shape[0]):
        total = work.g[i]
        for j in range(residual.shape[0]):
            total += work.M[i, j] * work.a[j]
        for k in range(work.lam.shape[0]):
            total += work.B[k, i] * work.lam[k]
        residual[i] = total
    return work.flags[ENDED]


@part
def prepare(work, first, times):
    """Store the times of the instants of a step that begins at the instant `first`; times: h, t and these times."""
    for i in range(1 + work.kept_rows.shape[0]):
        work.times[first + i, INNER] = work.times[first + i, END] = times[2 + i]
    return DONE


@part
def begin(work, instant):
    """Do nothing: phi is computed from positions."""
    return DONE


@part
def reaction(work, instant, q, mu, dv, known):
    """dv += D^-1 B^T mu. B at q is kept for the residual there; known: B of the middle stage is used."""
    n, m, ended, B, D = work.q.shape[0], work.lam.shape[0], DONE, work.slots.B, work.slots.D
    if not known:
        set_state(work, instant, q, work.v)
        ended, B = evaluate_rows(work, instant, 0), work.B
        dense.copy_matrix(B, kept_rows(work, instant))
    for i in range(n):
        total = 0.0
        for e in range(m):
            total += B[e, i] * mu[e]
        dv[i] += D[i] * total
    return ended


@part
def residual(work, instant, q, v, a, lam, residual, phi):
    """Fill the residual at the time inside the step, and phi at that of its end."""
    set_state(work, instant, q, v)
    set_a_lam(work, a, lam)
    if phi.shape[0]:
        evaluate(work, PHI, END, work.phi)
        dense.put(1.0, work.phi, phi)
        evaluate_rows(work, instant, work.flags[TIED])
    ended = equilibrium(work, residual)
    return NOT_FINITE if ended == DONE and not (finite(residual) and finite(phi)) else ended


@part
def constraints(work, instant, q, dq, dv, phi, rate):
    """Fill phi at the end of the step, from q; the rate stays as it is, and the increments are not read."""
    if not work.lam.shape[0]:
        return DONE
    set_state(work, instant, q, work.v)
    ended = evaluate(work, PHI, END, work.phi)
    dense.put(1.0, work.phi, phi)
    return ended


@part
def rate(work, instant, q, v, rows, known):
    """rows = phi_q v + phi_t; known: with B of the last `reaction` of this stage."""
    set_state(work, instant, q, v)
    evaluate_rows(work, instant, known)
    if work.flags[DRIVEN]:
        evaluate(work, PHI_T, INNER, work.phi_t)
    for k in range(rows.shape[0]):
        total = work.phi_t[k]
        for i in range(work.q.shape[0]):
            total += work.B[k, i] * work.v[i]
        rows[k] = total
    return work.flags[ENDED]


@part
def bordered(whole, work, matrix, size):
    """whole = [[matrix, s B^T], [s B, 0]], s = size."""
    n, m = work.q.shape[0], work.lam.shape[0]
    for i in range(n):
        dense.put(1.0, matrix[i], whole[i])
        for k in range(m):
            whole[i, n + k] = size * work.B[k, i]
            whole[n + k, i] = size * work.B[k, i]
    for k in range(m):
        dense.zero(whole[n + k, n:])


@part
def typical(matrix):
    """Mean size of the diagonal; 1 if it is zero."""
    total = 0.0
    for i in range(matrix.shape[0]):
        total += abs(matrix[i, i])
    return total / matrix.shape[0] if total > 0.0 else 1.0


@part
def solve_bordered(work, whole, pivots, size):
    """work.x becomes the solution of a factored `bordered` system."""
    for k in range(work.q.shape[0], work.x.shape[0]):
        work.x[k] *= size
    dense.solve(whole, pivots, work.x)
    for k in range(work.q.shape[0], work.x.shape[0]):
        work.x[k] *= size


@part
def solve_masses(work):
    """work.x becomes the solution of the system of M and B. Returns the status."""
    size = typical(work.M)
    bordered(work.masses, work, work.M, size)
    if not dense.factor(work.masses, work.mass_pivots):
        return SINGULAR
    solve_bordered(work, work.masses, work.mass_pivots, size)
    return DONE


@part
def project(work, instant, right, moved, from_zero):
    """Change `moved` by the least M-norm, so that B moved falls by `right`; from_zero: the least one with B moved = B moved_before - right."""
    n, m = work.q.shape[0], work.lam.shape[0]
    if work.flags[MASS_VARIES] and evaluate(work, MASS, INNER, work.M) != DONE:
        return work.flags[ENDED]
    for k in range(m):
        total = right[k]
        if from_zero:
            for i in range(n):
                total -= work.B[k, i] * moved[i]
        work.x[n + k] = -total
    dense.zero(work.x[:n])
    if solve_masses(work) != DONE:
        return SINGULAR
    for i in range(n):
        moved[i] = work.x[i] if from_zero else moved[i] + work.x[i]
    return DONE


@part
def accept(work, instant, q):
    """Ask the model whether it accepts the state."""
    if not work.functions[ACCEPTED]:
        return DONE
    set_state(work, instant, q, work.v)
    return evaluate(work, ACCEPTED, END, work.x)


@part
def reach(work):
    """The s, at most 1, for which |s v| is 1 + |q|, in the maximum norm."""
    size = pace = 0.0
    for i in range(work.q.shape[0]):
        size, pace = max(size, abs(work.q[i])), max(pace, abs(work.v[i]))
    return (1.0 + size) / pace if pace > 1.0 + size else 1.0


@part
def fill_bias(work):
    """work.phi_bias at work.t, work.q, work.v: the model's, or, without drives, differences of fourth order of `phi_q v` along v. Changes work.B."""
    n, m = work.q.shape[0], work.lam.shape[0]
    if work.functions[PHI_BIAS]:
        return evaluate(work, PHI_BIAS, INNER, work.phi_bias)
    dense.zero(work.phi_bias)
    if not work.flags[ROWS_VARY]:
        return DONE
    at, step = work.near[0], REACH * reach(work)
    dense.put(1.0, work.q, at)
    for e in range(4):
        s, weight = (1.0, -1.0, 2.0, -2.0)[e] * step, (8.0, -8.0, -1.0, 1.0)[e] / (12.0 * step)
        for i in range(n):
            work.q[i] = at[i] + s * work.v[i]
        evaluate(work, PHI_Q, INNER, work.B)
        for k in range(m):
            for i in range(n):
                work.phi_bias[k] += weight * work.B[k, i] * work.v[i]
    dense.put(1.0, at, work.q)
    return work.flags[ENDED]


@part
def bias(work, instant, q, v, a, out):
    """out = `B a + phi_bias`, the second derivative of phi, with B of the last `reaction`."""
    set_state(work, instant, q, v)
    ended = fill_bias(work)
    evaluate_rows(work, instant, 1)
    for k in range(out.shape[0]):
        out[k] = work.phi_bias[k]
        for i in range(work.q.shape[0]):
            out[k] += work.B[k, i] * a[i]
    return ended


@part
def acceleration(work, instant, q, v, a, lam):
    """a and lam that are consistent with q and v: `[[M, B^T], [B, 0]] (a, lam) = (-g, -phi_bias)`."""
    n, m = work.q.shape[0], work.lam.shape[0]
    set_state(work, instant, q, v)
    if work.flags[MASS_VARIES]:
        evaluate(work, MASS, INNER, work.M)
    evaluate(work, FORCE, INNER, work.g)
    if m:
        fill_bias(work)
    if evaluate_rows(work, instant, 0) != DONE:
        return work.flags[ENDED]
    dense.put(-1.0, work.g, work.x)
    dense.put(-1.0, work.phi_bias, work.x[n:])
    if solve_masses(work) != DONE:
        return SINGULAR
    dense.put(1.0, work.x[:n], a)
    dense.put(1.0, work.x[n:], lam)
    return DONE


@part
def potential(work, start, direction, share):
    """The potential energy at start + share direction; changes work.q."""
    for i in range(work.q.shape[0]):
        work.q[i] = start[i] + share * direction[i]
    evaluate(work, POTENTIAL, INNER, work.x)
    return work.x[0]


@part
def add_discrete_derivative(work, states, residual):
    """Correct the force in the residual so that its work over the step is the change of the potential V. Returns the status.

    residual += (V(q_1) - V(q_0) - integral) / (d^T M d) M d, with d = q_1 - q_0 and the integral of the force's work along d at POINTS
    (Gonzalez 1996); the correction is left out where it is round-off. states: as of `middle`.
    """
    n, begin, end, at_middle, change = work.q.shape[0], states[0], states[1], states[2], work.near[0]
    for i in range(n):
        change[i] = end[i] - begin[i] if i < work.flags[OWN] else 0.0
    first, last, integral = potential(work, begin, change, 0.0), potential(work, end, change, 0.0), 0.0
    for share, weight in POINTS:
        integral += weight * (potential(work, at_middle, change, share) - potential(work, at_middle, change, -share)) / (2.0 * share)
    if work.flags[ENDED] != DONE:
        return work.flags[ENDED]
    metric, size = work.near[1], 0.0
    for i in range(n):
        metric[i] = 0.0
        for j in range(n):
            metric[i] += work.M[i, j] * change[j]
        size += change[i] * metric[i]
    missing = last - first - integral
    if size > 0.0 and not abs(missing) <= NOISE * max(abs(first), abs(last)):  # also if it is not a number
        for i in range(n):
            residual[i] += missing / size * metric[i]
    return DONE


@part
def middle(work, instant, states, lam, residual, phi):
    """Fill the residual at the middle of a step, and phi at its end; the middle's instant is the one before that of the end.

    states: q_0, q_1, and q, v, a of the middle.
    """
    set_state(work, instant - 1, states[2], states[3])
    set_a_lam(work, states[4], lam)
    evaluate_rows(work, instant - 1, 0)
    equilibrium(work, residual)
    ended = add_discrete_derivative(work, states, residual)
    if ended == DONE and phi.shape[0]:
        set_state(work, instant, states[1], states[3])
        ended = evaluate(work, PHI, END, work.phi)
        dense.put(1.0, work.phi, phi)
    return NOT_FINITE if ended == DONE and not (finite(residual) and finite(phi)) else ended


@entry
def values(work, states, results):
    """Fill the results r, phi, phi's rate and bias of states t, q, v, a, lam (k, .); results may be empty, (0, .). Returns how it ended."""
    t, q, v, a, lam = states
    r, phi, rates, biases = results
    ended = DONE
    for k in range(t.shape[0]):
        work.times[0, INNER] = work.times[0, END] = t[k]
        if r.shape[0]:
            ended = residual(work, 0, q[k], v[k], a[k], lam[k], r[k], work.phi)
        elif phi.shape[0]:
            set_state(work, 0, q[k], v[k])
            ended = evaluate(work, PHI, END, work.phi)
        if phi.shape[0]:
            dense.put(1.0, work.phi, phi[k])
        if ended == DONE and rates.shape[0]:
            ended = rate(work, 0, q[k], v[k], rates[k], 0)
        if ended == DONE and biases.shape[0]:
            set_state(work, 0, q[k], v[k])
            ended = fill_bias(work)
            dense.put(1.0, work.phi_bias, biases[k])
        if ended != DONE:
            return ended
    return DONE


SERVED = {
    of.PREPARE: served(prepare, step_times),
    of.BEGIN: served(begin),
    of.RESIDUAL: served(residual, coordinates, coordinates, coordinates, multipliers, coordinates, multipliers),
    of.CONSTRAINTS: served(constraints, coordinates, None, None, multipliers, None),
    of.RATE: served(rate, coordinates, coordinates, multipliers, None),
    of.BIAS: served(bias, coordinates, coordinates, coordinates, multipliers),
    of.REACTION: served(reaction, coordinates, multipliers, coordinates, None),
    of.PROJECT: served(project, multipliers, coordinates, None),
    of.ACCEPT: served(accept, coordinates),
    of.ACCELERATION: served(acceleration, coordinates, coordinates, coordinates, multipliers),
    of.MIDDLE: served(middle, five_states, multipliers, coordinates, multipliers),
}
