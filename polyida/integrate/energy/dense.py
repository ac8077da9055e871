"""The table of a small model of one's own that numba compiles, for the energy-momentum method: by the discrete derivative (energy/general.py)."""

from functools import cache

import numpy as np
from numba import typeof

from polyida.assembly.own.laws import NOISE
from polyida.integrate.energy.general import SPAN
from polyida.integrate.kinks import inner_side
from polyida.jit import part
from polyida.model.differences import FIRST_ORDER_STEP
from polyida.system.dense import END, INNER, PHI, POTENTIAL, acceleration, ask, example, residual, take, vector  # fmt: skip
from polyida.system.python import CompiledTable
from polyida.system.table import ACCELERATION, DONE, INSTANTS, KINETIC, MIDDLE, c_address, c_entry

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


@cache
def more():
    """{number: address} of these functions, for every Dense."""
    return {
        number: c_address(function, typeof(example()))
        for number, function in ((MIDDLE, middle), (KINETIC, kinetic), (ACCELERATION, acceleration))
    }


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
