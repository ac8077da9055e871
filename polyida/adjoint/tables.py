"""The tables for the backward sweep of generalized-alpha: the C functions that solve the adjoint of one step of any model, and of a small one."""

from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
from numba import carray, typeof

from polyida.errors import DONE, NOT_FINITE, SINGULAR
from polyida.jit import entry, pack, part
from polyida.jit.intrinsics import pointer
from polyida.linear import dense as compiled_lu
from polyida.linear.lu import LU, dense
from polyida.linear.saddle import ENOUGH, ExactSaddle
from polyida.system import ADJOINT, ENTRIES, c_address
from polyida.system import dense as small
from polyida.system.dense import BENT, END, FORCE, FORCE_V, INNER, MASS, MASS_VARIES, PHI_Q, TANGENT, VELOCITY, Dense, vector
from polyida.system.python import PythonTable

ROUNDS = 8  # solves, at most, for what eta turns with q


class AdjointTable:
    """What `adjoint.alpha.Sweep` asks of a table; one that keeps no factor needs no more of it than this.

    kappa, slips: of the stabilised form, which PythonAdjoint alone has.
    """

    kappa = slips = None

    def refresh(self, k):
        """Factor the step matrix at state k if the table keeps it and has none: True if the matrix is made there. Raises SingularSystem."""
        return True

    def drop(self):
        """Forget the factor: it is too old."""

    def raise_left(self):
        """Raise what a function of Python has raised."""


class PythonAdjoint(PythonTable, AdjointTable):
    """The table of any model for steps of h, and of the stabilised form.

    That form has one more unknown, eta in `q = Newmark's - M^-1 B^T eta`, and one more equation, psi = `B v + phi_t = 0`, with the
    multiplier kappa: `psi_q^T kappa + (B^T eta)_q^T M^-1 y` stands beside `B^T mu` in y, `B^T kappa` beside `C^T w` in z, and
    `B M^-1 y = 0`. kappa (count, m) and slips = (y', slip, eta) are filled: y' = M^-1 y, slip what eta adds to q.
    """

    def __init__(self, model, settings, h, counts):
        self.saddle = ExactSaddle(model, *settings.coefficients.rates(h), counts)
        self.stabilised = settings.form == "stabilised" and model.m > 0
        super().__init__(model, False)

    def _fill(self):
        self.functions[ADJOINT] = self._address(self._solve)

    def take(self, t, q, v, a, lam, slips=None):
        """Take the states at the ends of some steps; slips (count, n): of the stabilised form, what eta adds to q."""
        self.states = t, q, v, a, lam
        if self.stabilised:
            self.kappa, self.slips = np.empty_like(lam), (np.empty_like(q), np.array(slips), np.empty_like(lam))

    @contextmanager
    def at_work(self):
        """(addresses of the functions, address of the workspace)."""
        yield self.functions, 0

    def _solve(self, k, right, below, bar, w, mu, found):
        n, m, saddle = self.model.n, self.model.m, self.saddle
        w, mu, found = self._array(w, n), self._array(mu, m), self._array(found, 2 * n).reshape(2, n)
        right, below = self._array(right, n).copy(), self._array(below, m).copy()
        saddle.at(*(x[k] for x in self.states))
        damped = lambda: 0.0 if saddle.C is None else saddle.C.T @ w  # noqa: E731
        if self.stabilised:
            w[:], mu[:], found[0], kappa, more = self._stabilised(k, right, below, self._array(bar, n).copy())
            self.kappa[k], found[1] = kappa, damped() + saddle.B.T @ kappa
            for part, value in zip(self.slips, more):
                part[k] = value
        else:
            w[:], mu[:] = saddle.solve(right, below, transposed=True)
            found[0], found[1] = saddle.K.T @ w + saddle.B.T @ mu, damped()

    def _stabilised(self, k, right, below, bar):
        """(w, mu, what y loses beside bar, kappa, (y', slip, eta)).

        slip: the part of q that `M slip + B^T eta = 0` adds, as far as B tells it: by frames it has what Newton left.
        """
        saddle, model, (t, q, v, _, _) = self.saddle, self.model, self.saddle.here
        G, B, system = dense(model.phi_rate_q(t, q, v)), dense(saddle.B), model.mass_system(t, q)
        still, none = np.zeros(model.n), np.zeros(model.m)
        slip, eta = system.solve(still, -B @ self.slips[1][k])
        ties = np.stack([-system.solve(still, row)[0] for row in np.eye(model.m)], axis=1)  # M^-1 B^T (B M^-1 B^T)^-1: where eta moves q
        closed, turned, ahead = self._closed(B, G, ties), model.reaction_q(t, q, eta).T, still
        for _ in range(ROUNDS):
            more = turned @ ahead
            w, mu, kappa = closed(right - more, below, bar + more)
            lost, before = more + saddle.K.T @ w + B.T @ mu + G.T @ kappa, ahead
            ahead = system.solve(bar + lost, none)[0]
            if np.abs(ahead - before).max() <= ENOUGH * np.abs(ahead).max():
                break
        return w, mu, lost, kappa, (ahead, slip, eta)

    def _closed(self, B, G, ties):
        """A function (right, below, bar) -> (w, mu, kappa) with one factor of S^T and one border."""
        m, lu, saddle = len(B), LU(self.saddle.S.T), self.saddle
        saddle.counts.factorizations += 1
        saddle.counts.solves += 2 * m
        X, rows = lu.solve(np.hstack([B.T, G.T + saddle.c_v * B.T])), np.vstack([B, (saddle.K @ ties).T])
        corner = LU(np.vstack([np.zeros((m, 2 * m)), np.hstack([ties.T @ B.T, ties.T @ G.T])]) - rows @ X)

        def solve(right, below, bar):
            saddle.counts.solves += 1
            y = lu.solve(right)
            u = corner.solve(np.concatenate([below, -ties.T @ bar]) - rows @ y)
            return y - X @ u, u[:m], u[m:]

        return solve


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
    d.q[:], d.v[:], d.a[:], d.lam[:], d.c[:], d.flags[small.ENDED] = w.q[k], w.v[k], w.a[k], w.lam[k], 0.0, DONE
    if d.functions[TANGENT]:
        small.ask(d, TANGENT, INNER, d.S)
    else:
        small.add_slopes(d)
    w.K[:] = d.S
    if d.flags[VELOCITY]:
        d.S[:] = 0.0
        small.add_slope(d, FORCE_V, FORCE, d.v, 1.0)
        w.C[:] = d.S
    if d.lam.shape[0] and d.flags[BENT]:
        small.ask(d, PHI_Q, INNER, d.B)
    if d.flags[MASS_VARIES]:
        small.ask(d, MASS, INNER, d.M)
    return d.flags[small.ENDED]


@entry
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
    if not compiled_lu.factor(d.lu, d.pivots):
        return SINGULAR
    compiled_lu.put(1.0, vector(right, n), d.x)
    compiled_lu.put(1.0, vector(below, m), d.x[n:])
    small.solve_bordered(d, d.lu, d.pivots, size)
    if not small.finite(d.x):
        return NOT_FINITE
    x, mu, lost = vector(now, n), vector(multipliers, m), carray(pointer(found), (2, n))
    compiled_lu.put(1.0, d.x[:n], x)
    compiled_lu.put(1.0, d.x[n:], mu)
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


class DenseAdjoint(AdjointTable):
    """The table of a small model for steps of h; table: that of its functions. counts: what counts its work."""

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

    @contextmanager
    def at_work(self):
        """(addresses of the functions, address of the workspace)."""
        work, self.w["solved"][0] = DenseAdjointWork(**self.w), 0
        self.functions[ADJOINT] = c_address(solve, typeof(work))
        yield self.functions, work.address
        self.counts.factorizations += int(self.w["solved"][0])
        self.counts.solves += int(self.w["solved"][0])
