"""IDA on a small model with dense matrices: F and `J^-1 F` in one compiled call, which calls the functions of the model's table.

The forms are those of `forms.py`, the matrix is that of `linear.py`, whose rows and columns of constraints are divided by their size here:

    |    S     columns | |dq|   |r2 + D r1|     D = cj M + C; columns: B^T of lam, D B^T of mu
    | P + cj Q  corner | |w | = |rc + Q r1|     corner: Q B^T of mu
"""

import math
from typing import NamedTuple

import numpy as np

from polyida.errors import DONE, NOT_FINITE, REASONS, SINGULAR, StepFailure
from polyida.integrate.ida.forms import NEAR
from polyida.integrate.ida.linear import Correction
from polyida.jit import entry, pack, part, typed
from polyida.linear import dense
from polyida.linear.dense import clear
from polyida.model.differences import FIRST_ORDER_STEP
from polyida.system.dense import (
    ACCEPTED,
    DRIVEN,
    END,
    FORCE,
    FORCE_V,
    INNER,
    MASS,
    MASS_VARIES,
    PHI,
    PHI_Q,
    PHI_T,
    TANGENT,
    VARIES,
    VELOCITY,
    add_slope,
    add_slopes,
    ask,
    bias,
    equilibrium,
    finite,
    take_rows,
    typical,
)

# constants of compiled code
STABILISED, INTEGRATED, BENDS, ANEW, MADE = range(5)  # of Room.flags; BENDS: phi is a row and not linear; ANEW: rows of every iterate
CJ, TIME = range(2)  # of Room.numbers
STEP = FIRST_ORDER_STEP


@pack
class Room(NamedTuple):
    """Scratch of a form with k rows of constraints.

    offsets (3,): the first row of phi, its first and its second derivative, or -1; weights (3,): theirs; r: F; q, B, phi: of the state;
    D (n, n): cj M + C; P, Q (k, n): slopes of the rows in q and v; matrix, pivots, x: the linear system; sizes (2, k): of rows and columns.
    """

    offsets: np.ndarray
    weights: np.ndarray
    flags: np.ndarray
    numbers: np.ndarray
    r: np.ndarray
    q: np.ndarray
    mu: np.ndarray
    B: np.ndarray
    phi: np.ndarray
    D: np.ndarray
    P: np.ndarray
    Q: np.ndarray
    slopes: np.ndarray
    matrix: np.ndarray
    pivots: np.ndarray
    right: np.ndarray
    x: np.ndarray
    sizes: np.ndarray


def room(system):
    """Room for a System."""
    form, n, m = system.form, system.model.n, system.model.m
    k, offsets, weights = system.size - 2 * n, np.full(3, -1), np.ones(3)
    for order, weight, at in system.levels:
        offsets[order], weights[order] = at.start, weight
    flags = form.stabilised, form.integrated, system.rows_vary and system.holds_phi, system.rows_vary, False
    shapes = (system.size,), (n,), (m,), (m, n), (m,), (n, n), (k, n), (k, n), (2, m, n), (n + k, n + k)
    numbers = offsets, weights, np.array(flags, np.int64), np.zeros(2)
    return Room(*numbers, *map(np.zeros, shapes), np.zeros(n + k, np.int64), np.zeros(n + k), np.zeros(n + k), np.zeros((2, k)))


@part
def product(matrix, k, x, n):
    """Row k of a matrix on the first n entries of x."""
    total = 0.0
    for i in range(n):
        total += matrix[k, i] * x[i]
    return total


@part
def evaluate(w, f, t, y, yp):
    """F(t, y, y') into f.r; what the solve needs of the state is kept."""
    n, m, r = w.q.shape[0], w.lam.shape[0], f.r
    multipliers = yp if f.flags[INTEGRATED] else y
    w.t[INNER] = w.t[END] = f.numbers[TIME] = t
    for i in range(n):
        w.q[i] = f.q[i] = y[i]
        w.v[i], w.a[i] = y[n + i], yp[n + i]
        r[i] = yp[i] - y[n + i]
    for k in range(m):
        w.lam[k] = multipliers[2 * n + k]
        f.mu[k] = multipliers[2 * n + m + k] if f.flags[STABILISED] else 0.0
    ended = take_rows(w)
    if ended == DONE:
        ended = equilibrium(w, r[n : 2 * n])
    if ended != DONE or not m:
        return ended
    for k in range(m):
        for i in range(n):
            f.B[k, i] = w.B[k, i]
            r[i] += w.B[k, i] * f.mu[k]
    for i in range(2 * n, r.shape[0]):
        r[i] = 0.0
    for order in range(3):
        if f.offsets[order] >= 0:
            ended = add_level(w, f, order, r[2 * n + f.offsets[order] :])
            if ended != DONE:
                return ended
    return DONE


@part
def add_level(w, f, order, rows):
    """Add a derivative of phi to its rows of F."""
    n, ended = w.q.shape[0], DONE
    if order == 0:
        ended = ask(w, PHI, END, w.phi)
    elif order == 1 and w.flags[DRIVEN]:
        ended = ask(w, PHI_T, INNER, w.phi_t)
    elif order == 2:
        ended = bias(w)
    for k in range(f.phi.shape[0]):
        if order == 0:
            value = f.phi[k] = w.phi[k]
        elif order == 1:
            value = w.phi_t[k] + product(f.B, k, w.v, n)
        else:
            value = w.phi_bias[k] + product(f.B, k, w.a, n)
        rows[k] += f.weights[order] * value
    return ended


@part
def factor(w, f, cj):
    """S and D at the state; rows and columns of constraints are those of a solve."""
    f.numbers[CJ], f.flags[MADE], n = cj, 0, w.q.shape[0]
    ended = ask(w, MASS, INNER, w.M) if w.flags[MASS_VARIES] else DONE
    clear(w.S)
    if ended == DONE and w.flags[VELOCITY]:
        ended = add_slope(w, FORCE_V, FORCE, w.v, 1.0)
    for i in range(n):
        for j in range(n):
            f.D[i, j] = cj * w.M[i, j] + w.S[i, j]
    w.c[0], w.c[1] = cj * cj, cj
    if ended == DONE:
        ended = ask(w, TANGENT, INNER, w.S) if w.functions[TANGENT] else add_slopes(w)
    return ended


@part
def along(w, f, time, direction, shift, out):
    """d/ds phi_q(t + s time, q + s direction) at s = 0 into out, `shift` (1, v) further than the state. Leaves w.t and w.q there."""
    n, m = w.q.shape[0], w.lam.shape[0]
    size, pace = 1.0, 0.0
    for i in range(n):
        size, pace = max(size, 1.0 + abs(f.q[i])), max(pace, abs(direction[i]))
    step = NEAR * (size / pace if pace > size else 1.0)
    for e in range(2):
        s = (step, -step)[e]
        w.t[INNER] = f.numbers[TIME] + shift + s * time
        for i in range(n):
            w.q[i] = f.q[i] + shift * w.v[i] + s * direction[i]
        ended = ask(w, PHI_Q, INNER, w.B)
        if ended != DONE:
            return ended
        for k in range(m):
            for i in range(n):
                out[k, i] = w.B[k, i] if e == 0 else (out[k, i] - w.B[k, i]) / (2.0 * step)
    return DONE


@part
def add_rows(f, order, source, c, out):
    """Rows of a derivative of phi in out += c source."""
    for k in range(source.shape[0]):
        for i in range(source.shape[1]):
            out[f.offsets[order] + k, i] += c * f.weights[order] * source[k, i]


@part
def curve(w, f, slope):
    """The slope in q of the rows of phi'' from those of B along the motion, by differences of fourth order."""
    n, size, pace = w.q.shape[0], 1.0, 0.0
    for i in range(n):
        size, pace = max(size, 1.0 + abs(f.q[i])), max(pace, abs(w.v[i]))
    step = STEP * (size / pace if pace > size else 1.0)
    for e in range(4):
        ended = along(w, f, 1.0, w.v, (1.0, -1.0, 2.0, -2.0)[e] * step, slope)
        if ended != DONE:
            return ended
        add_rows(f, 2, slope, (8.0, -8.0, -1.0, 1.0)[e] / (12.0 * step), f.P)
    ended = along(w, f, 0.0, w.a, 0.0, slope) if w.flags[VARIES] else DONE
    if w.flags[VARIES]:
        add_rows(f, 2, slope, 1.0, f.P)
    return ended


@part
def make_rows(w, f):
    """P and Q at the state."""
    n, m, cj, ended = w.q.shape[0], w.lam.shape[0], f.numbers[CJ], DONE
    clear(f.P)
    clear(f.Q)
    moves = (w.flags[VARIES] or w.flags[DRIVEN]) and (f.offsets[1] >= 0 or f.offsets[2] >= 0)
    slope = f.slopes[0]
    if moves:
        ended = along(w, f, 1.0, w.v, 0.0, slope)
    if f.offsets[0] >= 0:
        add_rows(f, 0, f.B, 1.0, f.P)
    if f.offsets[1] >= 0:
        add_rows(f, 1, f.B, 1.0, f.Q)
        if moves:
            add_rows(f, 1, slope, 1.0, f.P)
    if f.offsets[2] >= 0:
        add_rows(f, 2, f.B, cj, f.Q)
        if moves:
            add_rows(f, 2, slope, 2.0, f.Q)
            if ended == DONE:
                ended = curve(w, f, f.slopes[1])
    w.t[INNER] = f.numbers[TIME]
    for i in range(n):
        w.q[i] = f.q[i]
        for k in range(m):
            w.B[k, i] = f.B[k, i]
    return ended


@part
def fill(w, f):
    """The matrix of the linear system, its border divided by its sizes."""
    n, m, A, cj, size = w.q.shape[0], w.lam.shape[0], f.matrix, f.numbers[CJ], typical(w.S)
    for i in range(n):
        for j in range(n):
            A[i, j] = w.S[i, j]
    for k in range(f.P.shape[0]):
        for i in range(n):
            A[i, n + k] = f.B[k, i] if k < m else product(f.D, i, f.B[k - m], n)
            A[n + k, i] = f.P[k, i] + cj * f.Q[k, i]
    for k in range(f.P.shape[0]):
        row = column = 0.0
        for i in range(n):
            row, column = max(row, abs(A[n + k, i])), max(column, abs(A[i, n + k]))
        f.sizes[0, k], f.sizes[1, k] = size / row if row > 0.0 else 1.0, size / column if column > 0.0 else 1.0
        for i in range(n):
            A[n + k, i] *= f.sizes[0, k]
            A[i, n + k] *= f.sizes[1, k]
    for k in range(f.P.shape[0]):
        for j in range(f.P.shape[0]):
            A[n + k, n + j] = f.sizes[0, k] * f.sizes[1, j] * product(f.Q, k, f.B[j - m], n) if j >= m else 0.0


@part
def closed(w, f, r):
    """phi's rows of f.right with what phi bends by on the way to q - dq."""
    n, x = w.q.shape[0], f.x
    for i in range(n):
        w.q[i] = f.q[i] - x[i]
    ended = ask(w, PHI, END, w.phi)
    for i in range(n):
        w.q[i] = f.q[i]
    for k in range(f.phi.shape[0]):
        f.right[n + k] += f.sizes[0, k] * (w.phi[k] - f.phi[k] + r[2 * n + k])
    return ended


@part
def solved(f):
    """f.x from f.right."""
    for i in range(f.x.shape[0]):
        f.x[i] = f.right[i]
    dense.solve(f.matrix, f.pivots, f.x)


@entry
def solve(w, f, r, z):
    """z = J^-1 r, constraint rows and columns those of the last state."""
    n, m, cj = w.q.shape[0], w.lam.shape[0], f.numbers[CJ]
    if not f.flags[MADE] or f.flags[ANEW]:
        ended = make_rows(w, f) if m else DONE
        if ended != DONE:
            return ended
        fill(w, f)
        f.flags[MADE] = 0
        if not dense.factor(f.matrix, f.pivots):
            return SINGULAR
        f.flags[MADE] = 1
    for i in range(n):
        f.right[i] = r[n + i] + product(f.D, i, r, n)
    for k in range(f.P.shape[0]):
        f.right[n + k] = f.sizes[0, k] * (r[2 * n + k] + product(f.Q, k, r, n))
    solved(f)
    if f.flags[BENDS]:
        ended = closed(w, f, r)
        if ended != DONE:
            return ended
        solved(f)
    for k in range(f.P.shape[0]):
        f.x[n + k] *= f.sizes[1, k]
        z[2 * n + k] = f.x[n + k] / cj if f.flags[INTEGRATED] else f.x[n + k]
    for i in range(n):
        z[i] = f.x[i]
        z[n + i] = cj * f.x[i] - r[i]
        for k in range(m, f.P.shape[0] if f.flags[STABILISED] else m):
            z[n + i] += f.B[k - m, i] * f.x[n + k]
    return DONE


@entry
def correct(w, f, t, y, yp, cj, anew, z):
    """z = J^-1 F at (t, y, y'); anew: with S of this state and cj. Returns how it ended."""
    ended = evaluate(w, f, t, y, yp)
    if ended == DONE and not finite(f.r):
        ended = NOT_FINITE
    if ended == DONE and anew:
        ended = factor(w, f, cj)
    return solve(w, f, f.r, z) if ended == DONE else ended


class DenseSolve(Correction):
    """The correction of `system` by the table of its model (system/python.py)."""

    def __init__(self, system, counts, order, table):
        super().__init__(system, counts, order)
        self.table, self.room, self.kernel, self.again = table, room(system), typed(correct), typed(solve)
        self.objects = table.w.functions[ACCEPTED] != 0

    def begin(self, t, y):
        """IDA starts anew from y at t."""
        super().begin(t, y)
        self.table.hold_constant(t, y[: self.system.model.n].copy())

    def residual(self, t, y, yp, z):
        """z = J^-1 F; False where F is not finite, or the model objects."""
        anew, system = self.due(t, y), self.system
        if self.objects and system.objection(t, y[: system.model.n]):
            return False
        if math.isnan(self.cj):
            z[:] = math.nan
            return True
        if anew:
            self.counts.tangents += 1
            self.counts.factorizations += 1
        self.counts.solves += 1
        return self._took(self.kernel(self.table.w, self.room, system.clamp(t), y, yp, self.cj, anew, z), t, z)

    def reduced(self, t, y, yp, r, z):
        """z = J^-1 r."""
        self._took(self.again(self.table.w, self.room, r, z), t, z)

    def _took(self, ended, t, z):
        """Whether F is finite."""
        if ended in (DONE, SINGULAR):
            if ended == SINGULAR:
                z[:] = math.nan
            return True
        self.table.raise_left()
        if ended == NOT_FINITE:
            return False
        raise StepFailure(*REASONS[ended], t)
