"""The adjoint of a step of a small model: compiled code around the model's functions, its exact matrix eliminated with partial pivoting."""

from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
from numba import carray, typeof

from polyida.errors import DONE, NOT_FINITE, SINGULAR
from polyida.jit import pack, part
from polyida.jit.intrinsics import pointer
from polyida.linear import dense
from polyida.system import dense as small
from polyida.system.dense import BENT, END, FORCE, FORCE_V, INNER, MASS, MASS_VARIES, PHI_Q, TANGENT, VELOCITY, Dense
from polyida.system.table import ADJOINT, ENTRIES, c_address, c_entry


@pack
class DenseAdjointWork(NamedTuple):
    """The workspace of a model; t (count,), q, v, a, lam: its states; K, C (n, n): scratch; solved (1,): the number of steps."""

    model: Dense
    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    lam: np.ndarray
    to_a: float
    to_v: float
    K: np.ndarray
    C: np.ndarray
    solved: np.ndarray


@part
def evaluate(w, k):
    """K, C, and the model's B and M at state k. Returns how it ended."""
    d = w.model
    d.t[INNER] = d.t[END] = w.t[k]
    d.q[:], d.v[:], d.a[:], d.lam[:], d.c[:] = w.q[k], w.v[k], w.a[k], w.lam[k], 0.0
    ended = small.ask(d, TANGENT, INNER, d.S) if d.functions[TANGENT] else small.add_slopes(d)
    w.K[:] = d.S
    if ended == DONE and d.flags[VELOCITY]:
        d.S[:] = 0.0
        ended = small.add_slope(d, FORCE_V, FORCE, d.v, 1.0)
        w.C[:] = d.S
    if ended == DONE and d.lam.shape[0] and d.flags[BENT]:
        ended = small.ask(d, PHI_Q, INNER, d.B)
    if ended == DONE and d.flags[MASS_VARIES]:
        ended = small.ask(d, MASS, INNER, d.M)
    return ended


@c_entry
def solve(w, k, right, below, bar, now, multipliers, found):
    """Solve step k. Returns how it ended."""
    d, n, m = w.model, w.model.q.shape[0], w.model.lam.shape[0]
    ended = evaluate(w, k)
    if ended != DONE:
        return ended
    for i in range(n):
        for j in range(n):
            d.S[i, j] = w.K[j, i] + w.to_a * d.M[j, i] + w.to_v * w.C[j, i]
    size = small.typical(d.S)
    small.bordered(d.lu, d, d.S, size)
    if not dense.factor(d.lu, d.pivots):
        return SINGULAR
    right, below, lost = carray(pointer(right), (n,)), carray(pointer(below), (m,)), carray(pointer(found), (2, n))
    x, mu = carray(pointer(now), (n,)), carray(pointer(multipliers), (m,))
    for i in range(n):
        d.x[i] = right[i]
    for i in range(m):
        d.x[n + i] = size * below[i]
    dense.solve(d.lu, d.pivots, d.x)
    if not small.finite(d.x):
        return NOT_FINITE
    for i in range(n):
        x[i] = d.x[i]
    for i in range(m):
        mu[i] = size * d.x[n + i]
    for j in range(n):
        stiff = damped = 0.0
        for i in range(n):
            stiff += w.K[i, j] * x[i]
            damped += w.C[i, j] * x[i]
        for i in range(m):
            stiff += d.B[i, j] * mu[i]
        lost[0, j], lost[1, j] = stiff, damped
    w.solved[0] += 1
    return DONE


class DenseAdjoint:
    """The table of a small model for steps of h; table: that of its functions. counts: what counts its work."""

    kappa = slips = None

    def __init__(self, table, settings, h, counts):
        n, (to_a, to_v) = table.model.n, settings.coefficients.rates(h)
        self.table, self.counts, self.functions = table, counts, np.zeros(ENTRIES, np.int64)
        self.w = {
            "model": table.w,
            "to_a": to_a,
            "to_v": to_v,
            "K": np.zeros((n, n)),
            "C": np.zeros((n, n)),
            "solved": np.zeros(1, np.int64),
        }
        self.raise_left = table.raise_left

    def take(self, t, q, v, a, lam, slips=None):
        """Take the states at the ends of some steps."""
        self.w |= {name: np.ascontiguousarray(x, float) for name, x in (("t", t), ("q", q), ("v", v), ("a", a), ("lam", lam))}
        self.table.hold_constant(float(t[0]), self.w["q"][0])

    def prepare(self, k):
        """True: the matrix is made anew in each step."""
        return True

    def drop(self):
        """Nothing."""

    @contextmanager
    def at_work(self):
        """(addresses of the functions, address of the workspace)."""
        work, self.w["solved"][0] = DenseAdjointWork(**self.w), 0
        self.functions[ADJOINT] = c_address(solve, typeof(work))
        yield self.functions, work.address
        self.counts.factorizations += int(self.w["solved"][0])
        self.counts.solves += int(self.w["solved"][0])
