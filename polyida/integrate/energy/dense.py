"""The table of a small model of one's own that numba compiles, for the energy-momentum method: by the discrete derivative (energy/general.py)."""

from functools import cache

import numpy as np
from numba import typeof

from polyida.assembly.own.laws import NOISE
from polyida.integrate.energy.general import SPAN
from polyida.integrate.kinks import inner_side
from polyida.jit import part
from polyida.linear import dense
from polyida.model.differences import FIRST_ORDER_STEP
from polyida.system.dense import (
    BENT,
    END,
    FORCE,
    FUNCTIONS,
    INNER,
    MASS,
    MASS_VARIES,
    PHI,
    PHI_Q,
    POTENTIAL,
    WHOLE,
    ask,
    bordered,
    residual,
    take,
    typical,
    vector,
    workspace,
)  # fmt: skip
from polyida.system.python import CompiledTable
from polyida.system.table import ACCELERATION, DONE, INSTANTS, KINETIC, MIDDLE, SINGULAR, c_address, c_entry

STEP = FIRST_ORDER_STEP * SPAN  # of dq: V' from values at one and two of them to each side


@part
def potential(w, x, d, s):
    """(how it ended, V at x + s d)."""
    for i in range(w.q.shape[0]):
        w.q[i] = x[i] + s * d[i]
    ended = ask(w, POTENTIAL, INNER, w.x)
    return ended, w.x[0]


@c_entry
def middle(w, instant, states, lam, r, phi, e, f):
    """r at the middle of a step, whose time is that before the instant of its end, and phi there."""
    n, m = w.q.shape[0], w.lam.shape[0]
    ended = residual(w, instant - 1, states + 16 * n, states + 24 * n, states + 32 * n, lam, r, phi)
    if ended != DONE:
        return ended
    x0, x1, x, found, d = vector(states, n), vector(states + 8 * n, n), vector(states + 16 * n, n), vector(r, n), w.near[0]
    for i in range(n):
        d[i] = x1[i] - x0[i]
    ended, first = potential(w, x0, d, 0.0)
    if ended != DONE:
        return ended
    _, last = potential(w, x1, d, 0.0)
    work = 0.0
    for k in range(4):
        ended, value = potential(w, x, d, (1.0, -1.0, 2.0, -2.0)[k] * STEP)
        if ended != DONE:
            return ended
        work += (8.0, -8.0, -1.0, 1.0)[k] * value / (12.0 * STEP)
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
    if not m:
        return DONE
    take(w, instant, states + 8 * n, states + 24 * n)
    ended, rows = ask(w, PHI, END, w.phi), vector(phi, m)
    for k in range(m):
        rows[k] = w.phi[k]
    return ended


@c_entry
def kinetic(w, instant, v, energy, c, d, e, f):
    """v^T M v."""
    n, total = w.q.shape[0], 0.0
    given = vector(v, n)
    for i in range(n):
        for j in range(n):
            total += given[i] * w.M[i, j] * given[j]
    vector(energy, 1)[0] = total
    return DONE


@part
def fill_bias(w, q, v, out):
    """out = `(phi_q v)_q v`, by differences along v, and B at q."""
    n, m = w.q.shape[0], w.lam.shape[0]
    size = pace = 0.0
    for i in range(n):
        size, pace = max(size, abs(q[i])), max(pace, abs(v[i]))
    step = FIRST_ORDER_STEP * min(1.0, (1.0 + size) / pace if pace > 0.0 else 1.0)
    for k in range(m):
        out[k] = 0.0
    for e in range(5):
        for i in range(n):
            w.q[i] = q[i] + (1.0, -1.0, 2.0, -2.0, 0.0)[e] * step * v[i]
        ended = ask(w, PHI_Q, INNER, w.B)
        if ended != DONE:
            return ended
        for k in range(m):
            for i in range(n):
                out[k] += (8.0, -8.0, -1.0, 1.0, 0.0)[e] * w.B[k, i] * v[i] / (12.0 * step)
    return DONE


@c_entry
def acceleration(w, instant, q, v, a, lam, e, f):
    """`[[M, B^T], [B, 0]] (a, lam) = (-g, -phi_bias)`, of constraints that nothing drives."""
    n, m = w.q.shape[0], w.lam.shape[0]
    take(w, instant, q, v)
    for i in range(n):
        w.a[i] = 0.0
    for k in range(m):
        w.lam[k] = 0.0
    ended = ask(w, MASS, INNER, w.M) if w.flags[MASS_VARIES] else DONE
    if ended == DONE:
        ended = ask(w, WHOLE if w.functions[WHOLE] else FORCE, INNER, w.g)
    bias, size = w.phi_t, typical(w.M)
    for k in range(m):
        bias[k] = 0.0
    if ended == DONE and m and w.flags[BENT]:
        ended = fill_bias(w, vector(q, n), vector(v, n), bias)
    if ended != DONE:
        return ended
    bordered(w.masses, w, w.M, size)
    if not dense.factor(w.masses, w.mass_pivots):
        return SINGULAR
    for i in range(n):
        w.x[i] = -w.g[i]
    for k in range(m):
        w.x[n + k] = -size * bias[k]
        bias[k] = 0.0
    dense.solve(w.masses, w.mass_pivots, w.x)
    out, found = vector(a, n), vector(lam, m)
    for i in range(n):
        out[i] = w.x[i]
    for k in range(m):
        found[k] = size * w.x[n + k]
    return DONE


@cache
def more():
    """{number: address} of these functions, for every Dense."""
    kind = typeof(workspace(1, 0, np.zeros(len(FUNCTIONS), np.int64), 0, (0,) * 6))
    return {number: c_address(function, kind) for number, function in ((MIDDLE, middle), (KINETIC, kinetic), (ACCELERATION, acceleration))}


class EnergyOfOwn(CompiledTable):
    """The same table with what the energy-momentum method needs; a and lam of frames where nothing drives."""

    longest = (INSTANTS - 1) // 2
    names = (*CompiledTable.names, "potential")

    def __init__(self, model):
        super().__init__(model, False)
        self.complete = not model.needs.driven
        for number, at in more().items():
            self.functions[number] = at if number == MIDDLE or self.complete else 0

    def prepare(self, times, h):
        """Get ready for steps between the times: that of a step's middle, and that of its end."""
        steps, model = len(times) - 1, self.model
        at = np.repeat(times[1:], 2)
        at[::2] -= 0.5 * h
        self.times[: 2 * steps] = at[:, None]
        self.times[2 * steps - 1, INNER] = inner_side(model, times[-1], h)
