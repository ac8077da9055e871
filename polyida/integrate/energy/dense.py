"""The tables of models of one's own for the energy-momentum method, by the discrete derivative.

The work of the force at the middle is not the difference of the potential; Gonzalez (J. Nonlinear Sci. 6 (1996) 449-467) adds what is
missing, along M dq:

    M (v_1 - v_0)/h + g(t_m, q_m, v_m) + [V_1 - V_0 - V'] M dq / (dq^T M dq) + phi_q(q_m)^T lam = 0,     V' = grad V(q_m) . dq

Forces beyond the potential act at the middle. With a constraint that is at most quadratic `phi_q(q_m) dq = phi_1 - phi_0`, so it does
no work. The matrix leaves out the derivative of the bracket, which is of second order in dq: Newton contracts without.
"""

from functools import cache

import numpy as np
from numba import typeof

from polyida.assembly.own_laws import NOISE
from polyida.errors import DONE, NOT_FINITE
from polyida.jit import entry, part
from polyida.model.differences import FIRST_ORDER_STEP, along
from polyida.model.guarded import OF_STEPS, unguarded
from polyida.system import ACCELERATION, INSTANTS, KINETIC, MIDDLE, c_address
from polyida.system.dense import (
    END,
    ENDED,
    INNER,
    PHI,
    POTENTIAL,
    acceleration,
    ask,
    equilibrium,
    example,
    finite,
    take,
    take_forces,
    take_rows,
    vector,
)  # fmt: skip
from polyida.system.python import CompiledTable, DenseTable, PythonTable, small_own

SPAN = 0.125 / FIRST_ORDER_STEP  # V' from values at +-1/8 and +-1/4 of dq: the nearer, the more round-off
STEP = FIRST_ORDER_STEP * SPAN  # of dq: V' from values at one and two of them to each side
ENDS = 2 * INSTANTS  # first instant of frames, behind those of steps
OF_ENERGY = (*OF_STEPS, "potential")


@part
def potential(w, x, d, s):
    """V at x + s d."""
    for i in range(w.q.shape[0]):
        w.q[i] = x[i] + s * d[i]
    ask(w, POTENTIAL, INNER, w.x)
    return w.x[0]


@entry
def middle(w, instant, states, lam, r, phi, e, f):
    """r at the middle of a step, whose time is that before the instant of its end, and phi there."""
    n, m = w.q.shape[0], w.lam.shape[0]
    take(w, instant - 1, states + 16 * n, states + 24 * n)
    take_forces(w, states + 32 * n, lam)
    found, rows = vector(r, n), vector(phi, m)
    take_rows(w)
    equilibrium(w, found)
    x0, x1, x, d = vector(states, n), vector(states + 8 * n, n), vector(states + 16 * n, n), w.near[0]
    for i in range(n):
        d[i] = x1[i] - x0[i]
    first, last, work = potential(w, x0, d, 0.0), potential(w, x1, d, 0.0), 0.0
    for k in range(4):
        work += (8.0, -8.0, -1.0, 1.0)[k] * potential(w, x, d, (1.0, -1.0, 2.0, -2.0)[k] * STEP) / (12.0 * STEP)
    if w.flags[ENDED] != DONE:
        return w.flags[ENDED]
    metric, size = w.near[1], 0.0
    for i in range(n):
        metric[i] = 0.0
        for j in range(n):
            metric[i] += w.M[i, j] * d[j]
        size += d[i] * metric[i]
    bracket = last - first - work
    if size > 0.0 and abs(bracket) > NOISE * max(abs(first), abs(last)):
        for i in range(n):
            found[i] += bracket / size * metric[i]
    if m:
        take(w, instant, states + 8 * n, states + 24 * n)
        ended = ask(w, PHI, END, w.phi)
        for k in range(m):
            rows[k] = w.phi[k]
    return NOT_FINITE if ended == DONE and not (finite(found) and finite(rows)) else ended


@entry
def kinetic(w, instant, v, energy, c, d, e, f):
    """v^T M v."""
    n, total = w.q.shape[0], 0.0
    given = vector(v, n)
    for i in range(n):
        for j in range(n):
            total += given[i] * w.M[i, j] * given[j]
    vector(energy, 1)[0] = total
    return DONE


@cache
def more():
    """{number: address} of these functions, for every Dense."""
    kind = typeof(example())
    return {number: c_address(function, kind) for number, function in ((MIDDLE, middle), (KINETIC, kinetic), (ACCELERATION, acceleration))}


class OfMiddles:
    """What tables with times of their own need of the method: instants of a step's middle and of its end."""

    instants = 3 * INSTANTS
    complete = False  # whether v, a and lam of frames are made by entries of the table

    def prepare(self, times, last, h):
        """Get ready for steps between the times; last: the last one, beside it where there is a kink."""
        steps, self.h, at = len(times) - 1, h, np.repeat(times[1:], 2)
        at[::2] -= 0.5 * h
        self.times[: 2 * steps] = at[:, None]
        self.times[2 * steps - 1, INNER] = last

    def prepare_ends(self, times, last):
        """Get ready for frames at the times; the number of the first one's instant."""
        end = ENDS + len(times)
        self.times[ENDS:end] = times[:, None]
        self.times[end - 1, INNER] = last
        return ENDS

    def _entries(self):
        return super()._entries() | {MIDDLE: self._middle}


class PythonOwn(OfMiddles, PythonTable):
    """The table of a model of one's own in Python that is large, or solves its systems itself."""

    def _middle(self, instant, states, lam, r, phi, *_):
        model, (t, _), (end, _) = self.model, self._at(instant - 1), self._at(instant)
        x0, x1, q, v, a = self._array(states, 5 * model.n).copy().reshape(5, -1)
        found, rows = self._array(r, model.n), self._array(phi, model.m)
        found[:], rows[:] = model.residual(t, q, v, a, self._array(lam, model.m).copy()), model.phi(end, x1)
        if not (np.isfinite(found).all() and np.isfinite(rows).all()):
            return NOT_FINITE
        found += missing(model.potential, x0, x1, model.mass(q) @ (x1 - x0))
        return DONE


class DenseOwn(OfMiddles, DenseTable):
    """The table of a small model of one's own in Python."""

    def __init__(self, model):
        super().__init__(model, False)
        self.functions[MIDDLE] = more()[MIDDLE]

    def _functions(self, w):
        def potential(*_):
            w.x[0] = self.model.potential(w.q.copy())

        return super()._functions(w) | {"potential": potential}


class CompiledOwn(OfMiddles, CompiledTable):
    """The table of a small model of one's own that numba compiles; v, a and lam of frames where nothing drives."""

    names = OF_ENERGY

    def __init__(self, model):
        super().__init__(model, False)
        self.complete = not model.needs.driven
        for number, at in more().items():
            self.functions[number] = at if number == MIDDLE or self.complete else 0


def own_table(model):
    """The table of a model of one's own."""
    if not small_own(model):
        return PythonOwn(model)
    return (CompiledOwn if unguarded(model).by_numba else DenseOwn)(model)


def missing(potential, x0, x1, metric, slope=None):
    """`[V_1 - V_0 - V'] M dx / (dx^T M dx)` from x0 to x1, metric being M dx; zero where round-off is all there is.

    slope: grad V at the middle, in the shape of x; None: V' by differences, which a kink of V near the middle makes wrong.
    """
    dx, middle = x1 - x0, 0.5 * (x0 + x1)
    size, first, last = np.vdot(dx, metric), potential(x0), potential(x1)
    along_dx = along(lambda s: potential(middle + s * dx), SPAN) if slope is None else np.vdot(slope, dx)
    bracket = last - first - along_dx
    if not (size > 0.0 and abs(bracket) > NOISE * max(abs(first), abs(last))):
        return np.zeros_like(dx)
    return bracket / size * metric
