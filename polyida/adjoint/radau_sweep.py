"""Steps of Radau IIA solved once more and swept backward.

`again` solves the stages of steps between stored states to round-off, with the tables of the run. `sweep_back` is the driver of the backward
sweep. With c_i, W of the tableau, `q_i = q_0 + c_i h v_0 + e_i`, `v_i = v_0 + sum_j W_ij e_j / h + D^-1 B_i^T mu_i` and
`v_i' = sum_j W_ij (v_j - v_0) / h` the equations of a step are `r_i = 0`, `phi_i = 0` and, if there is mu, `B_i v_i + phi_t = 0`; their
multipliers are w_i, mu*_i and kappa_i. b_q and b_v are the bars of the step's end, which is the last stage:

    a*_i = M_i^T w_i
    v*_i = C_i^T w_i + B_i^T kappa_i + sum_j W_ji a*_j / h + [b_v]
    q*_i = K_i^T w_i + B_i^T mu*_i + H_i^T kappa_i + (B_i^T mu_i)_q^T D^-1 v*_i + [b_q]

and `q*_j + sum_i W_ij v*_i / h = 0`, `B_i w_i = 0`, `B_i D^-1 v*_i = 0` are the transposed system. To the step before go

    q*_0 = sum_i q*_i,    v*_0 = sum_i c_i h q*_i + v*_i - sum_ij W_ij a*_i / h

K, C and H are dr/dq, dr/dv and d(B v + phi_t)/dq. The entry ADJOINT of a table (adjoint/tables.py) solves the transposed system; it gets
right (s, n), the terms of b_q and b_v in the first equation, bar = b_v, and fills w (s, n), multipliers (mu*, and kappa if there is mu) and
products (3, s, n): q*, v* and a* without the terms [b_q], [b_v] and W.
"""

from typing import NamedTuple

import numpy as np
from scipy.sparse import block_array, block_diag, csr_array, diags_array, eye_array, kron

from polyida.adjoint.tables import CallbackAdjoint
from polyida.errors import DONE
from polyida.integrate.radau.loop import MAKE, STEP, TARGET, TIME, attempt, make_factors, reserve_slot
from polyida.integrate.radau.step_arrays import FACTORS
from polyida.integrate.state import State
from polyida.jit import entry, fast, pack
from polyida.linear.dense import clear, copy_matrix, put
from polyida.linear.lu import ScaledLU
from polyida.system import MATRICES, PREPARE
from polyida.system import instant as ask


@pack
class States(NamedTuple):
    """States at the ends of steps and at the start of the first one: t (count + 1,), q, v, a (count + 1, n), lam (count + 1, m)."""

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    lam: np.ndarray

    def state(self, k):
        """The State number k."""
        return State(float(self.t[k]), self.q[k], self.v[k], self.a[k], self.lam[k])


@pack
class Stages(NamedTuple):
    """The stages of steps: t (count, s), e, `v - v_0`, v' (count, s, n), lam (count, s, m), mu (count, s, m) or (count, s, 0) without."""

    t: np.ndarray
    e: np.ndarray
    dv: np.ndarray
    a: np.ndarray
    lam: np.ndarray
    mu: np.ndarray


@entry
def initial_stages(nodes, h, states, step, trial):
    """Initial stages for a step: e from the cubic through q and v of both ends, lam linear, mu zero."""
    for j in range(nodes.shape[0]):
        s = nodes[j]
        for i in range(states.q.shape[1]):
            way, turn = states.q[step + 1, i] - states.q[step, i] - h * states.v[step, i], h * (states.v[step + 1, i] - states.v[step, i])
            trial.e[j, i] = s * s * (3.0 * way - turn) + s * s * s * (turn - 2.0 * way)
        for i in range(states.lam.shape[1]):
            trial.lam[j, i] = (1.0 - s) * states.lam[step, i] + s * states.lam[step + 1, i]
    clear(trial.mu)


@entry
def solve_stages(functions, workspace, at, method, arrays, now, h, fresh, states, done, out):
    """Solve the stages of steps of h from number `done` on: (number of solved steps, status of the next one).

    functions, workspace, method, arrays, fresh: as of `loop.take_steps`; at: number of the instant at which the first step starts.
    """
    tableau, memory, trial, work = arrays.tableau, arrays.memory, arrays.trial, arrays.work
    model, apart = (functions, workspace), tableau.c.shape[0] + 1
    for k in range(done, out.e.shape[0]):
        put(1.0, states.q[k], memory.q)
        put(1.0, states.v[k], memory.v)
        put(1.0, states.a[k], memory.a)
        put(1.0, states.lam[k], memory.lam)
        initial_stages(tableau.c, h, states, k, trial)
        now[STEP], now[TIME], now[TARGET] = h, states.t[k], states.t[k + 1]
        first = at if ask.provides(model, PREPARE) else at + k * apart
        status, _ = attempt(functions, workspace, first, method, arrays, now, fresh)
        if status == MAKE and ask.provides(model, MATRICES):
            slot = reserve_slot(arrays.slots, h, states.t[k], memory)
            status = make_factors(model, first, tableau, memory, work, slot)
            arrays.counts[FACTORS] += 1
            if status == DONE:
                initial_stages(tableau.c, h, states, k, trial)
                status, _ = attempt(functions, workspace, first, method, arrays, now, True)
        if status != DONE:
            return k, status
        fresh = False
        put(1.0, work.times[3 : 2 + apart], out.t[k])
        copy_matrix(trial.e, out.e[k])
        copy_matrix(trial.dv, out.dv[k])
        copy_matrix(trial.a, out.a[k])
        copy_matrix(trial.lam, out.lam[k])
        copy_matrix(trial.mu, out.mu[k])
        clear(memory.phi_start)  # the next step begins on its constraints
    return out.e.shape[0], DONE


@pack
class Slopes(NamedTuple):
    """The objective's slopes at the steps' ends, (count, n), or (0, n) where they are zero."""

    q: np.ndarray
    v: np.ndarray


@pack
class Sweep(NamedTuple):
    """State and scratch of the sweep: bars (2, n) of q and v, those of the current step, right (s, n), below (s, m), products (3, s, n)."""

    bars: np.ndarray
    trial: np.ndarray
    right: np.ndarray
    below: np.ndarray
    products: np.ndarray


@pack
class SweepOutput(NamedTuple):
    """Results of the sweep: w, v* (count, s, n); multipliers mu* and kappa (count, 1 or 2, s, m); slopes in h (count,)."""

    w: np.ndarray
    v: np.ndarray
    multipliers: np.ndarray
    slopes: np.ndarray


@fast
def begin(W, h, objective, step, work, out):
    """Add the objective's slopes to the bars of the end of a step, and set the right-hand side; the multipliers start from zero."""
    out.w[step], out.multipliers[step] = 0.0, 0.0
    for i in range(work.bars.shape[1]):
        work.trial[0, i], work.trial[1, i] = work.bars[0, i], work.bars[1, i]
        if objective.q.shape[0]:
            work.trial[0, i] += objective.q[step, i]
        if objective.v.shape[0]:
            work.trial[1, i] += objective.v[step, i]
    last = W.shape[0] - 1
    for s in range(last + 1):
        for i in range(work.bars.shape[1]):
            work.right[s, i] = -W[last, s] / h * work.trial[1, i]
    for i in range(work.bars.shape[1]):
        work.right[last, i] -= work.trial[0, i]


@fast
def finish(nodes, W, h, states, stages, step, work, out):
    """The bars of the step's start, v* and the slope in h."""
    q, v, a, last, slope = work.products[0], work.products[1], work.products[2], W.shape[0] - 1, 0.0
    for i in range(work.bars.shape[1]):
        q[last, i] += work.trial[0, i]
        v[last, i] += work.trial[1, i]
        of_q = of_v = 0.0
        for s in range(last + 1):
            for j in range(last + 1):
                v[s, i] += W[j, s] / h * a[j, i]
        for s in range(last + 1):
            rate = total = 0.0
            for j in range(last + 1):
                rate += W[s, j] * stages.e[step, j, i]
                total += W[s, j]
            of_q += q[s, i]
            of_v += nodes[s] * h * q[s, i] + v[s, i] - total * a[s, i] / h
            slope += nodes[s] * q[s, i] * states.v[step, i] - rate * v[s, i] / (h * h) - stages.a[step, s, i] * a[s, i] / h
            out.v[step, s, i] = v[s, i]
        work.bars[0, i], work.bars[1, i] = of_q, of_v
    out.slopes[step] = slope


@entry
def sweep_back(functions, workspace, first, last, nodes, W, h, objective, states, stages, work, out):
    """Sweep backward over the steps from last - 1 to first: (the first step that is done, status of the one before)."""
    model = functions, workspace
    for k in range(last - 1, first - 1, -1):
        begin(W, h, objective, k, work, out)
        status = ask.adjoint(model, k, work.right, work.below, work.trial[1], out.w[k], out.multipliers[k], work.products)
        if status != DONE:
            return k + 1, status
        finish(nodes, W, h, states, stages, k, work, out)
    return first, DONE


ROUNDS = 2  # solves with a step's own factor: the second takes what round-off left


class StageEquations(CallbackAdjoint):
    """The equations, linearised at the stages of one step after another, by a sparse factor of their whole matrix; and the table of any model.

    For models in Python, and for steps at which refinement with the factors of the run does not converge.

    lift (n,): the diagonal of D^-1; tied: True if there is mu.

    A velocity row has psi(q_i, u_i) = 0 in place of phi, with `u_i = v_0 + sum_j W_ij e_j / h`, v_i without mu. Its multiplier stands among mu*,
    and its `W^T mu*` in v*, which the term of D^-1 in q* does not get.
    """

    def __init__(self, model, tableau, lift, tied, counts):
        self.tableau, self.tied, self.counts, self.h = tableau, tied, counts, 1.0
        self.L = diags_array(np.tile(lift, tableau.stages))
        super().__init__(model)

    def scale(self, h):
        """Set the step h."""
        self.h = h

    def set_states(self, *stages):
        """Set the stages of some steps, (count, s, .) each."""
        self.stages = stages

    def at(self, t, q, v, a, lam, mu):
        """Factor the matrix of a step at its stages, (s, .) each. Raises SingularSystem.

        Rows r, phi and `B v + phi_t` of all stages on e, lam and mu of all of them: `dr/de = K + C dv/de + M da/de`,
        `dv/de = W/h + D^-1 T`, `da/de = W/h dv/de`. r and lam are measured in the size of `K + M / h^2`, mu in 1/h, `B v + phi_t` too.
        """
        model, h, s, n, m = self.model, self.h, len(t), self.model.n, self.model.m
        here = t.tolist(), q
        stacked = lambda function, *states: block_diag([csr_array(function(*state)) for state in zip(*states)], format="csr")  # noqa: E731
        self.R = kron(self.tableau.W / h, eye_array(n), format="csr")
        self.K = stacked(lambda *state: model.tangent(*state, 0.0, 0.0, 1.0), *here, v, a, lam)
        self.M = stacked(model.mass, q)
        self.C = stacked(model.force_v, *here, v) if model.needs.velocity_forces else csr_array(self.M.shape)
        by_v, by_q, sizes = self.C + self.M @ self.R, self.R, [n, m, m if self.tied else 0]
        self.B = stacked(model.phi_q, *here) if m else csr_array((0, s * n))
        self.held, self.bent, self.slid = self.B, self.B, None  # the rows of phi or psi: their slopes in e, in q, and in u
        if model.velocity_rows.size:
            of_psi = np.tile(np.isin(np.arange(m), model.velocity_rows), s).astype(float)
            self.u = v - (self.L @ (self.B.T @ mu.ravel())).reshape(v.shape) if self.tied else v
            self.slid = diags_array(of_psi) @ self.B
            self.bent = self.B - self.slid + diags_array(of_psi) @ stacked(model.phi_rate_q, *here, self.u)
            self.held = self.bent + self.slid @ self.R
        if self.tied:
            self.H, self.T = stacked(model.phi_rate_q, *here, v), stacked(model.reaction_q, *here, mu)
            by_q, G = by_q + self.L @ self.T, self.L @ self.B.T
        blocks = [[self.K + by_v @ by_q, self.B.T], [self.held, None]]
        if self.tied:
            blocks = [[*blocks[0], by_v @ G], [self.held, None, None], [self.H + self.B @ by_q, None, self.B @ G]]
        self.matrix = block_array(blocks, format="csc") if m else blocks[0][0].tocsc()
        size = float(np.mean(np.abs(self.K.diagonal()[:n] + self.M.diagonal()[:n] / h**2))) or 1.0
        self.cuts, self.shapes = np.cumsum(sizes)[:-1] * s, [(s, size) for size in sizes]
        self.lu = ScaledLU(
            self.matrix, np.repeat([1 / size, 1.0, h], s * np.array(sizes)), np.repeat([1.0, size, 1 / h], s * np.array(sizes))
        )
        self.counts.factorizations += 1

    def parts(self, x):
        """Split a solution into (w, mu, kappa), or (e, lam, mu)."""
        return [part.reshape(shape) for part, shape in zip(np.split(x, self.cuts), self.shapes)]

    def newton(self, t, q, v, a, lam, mu):
        """The corrections of e, lam and mu of the stages, (s, .) each, to be subtracted by Newton's method. Raises SingularSystem."""
        self.at(t, q, v, a, lam, mu)
        model, here = self.model, (t.tolist(), q)
        r = [model.residual(*state) for state in zip(*here, v, a, lam)]
        phi = [model.phi(*state) for state in zip(*here)]
        for values, *state in zip(phi, *here, self.u) if model.velocity_rows.size else ():
            values[model.velocity_rows] = model.phi_rate(*state)[model.velocity_rows]
        rate = [model.phi_rate(*state) for state in zip(*here, v)] if self.tied else []
        self.counts.solves += 1
        return self.parts(self.lu.solve(np.concatenate([*r, *phi, *rate])))

    def _solve(self, k, right, below, bar, w, multipliers, out):
        n, m, s = self.model.n, self.model.m, self.tableau.stages
        self.at(*(x[k] for x in self.stages))
        rhs, last = np.zeros(self.matrix.shape[0]), np.zeros(s * n)
        rhs[: s * n], last[-n:] = self._array(right, s * n), self._array(bar, n)
        if self.tied:
            rhs[: s * n] -= self.T @ (self.L @ last)  # T is symmetric
            rhs[s * (n + m) :] -= self.B @ (self.L @ last)
        x = np.zeros_like(rhs)
        for _ in range(ROUNDS):
            x -= self.lu.solve(self.matrix.T @ x - rhs, transposed=True)
        self.counts.solves += ROUNDS
        now, mu, kappa = np.split(x, self.cuts)
        a, v, q = self.M.T @ now, self.C.T @ now, self.K.T @ now + self.bent.T @ mu
        if self.tied:
            v = v + self.B.T @ kappa
            q = q + self.H.T @ kappa + self.T @ (self.L @ (v + self.R.T @ a + last))
        if self.slid is not None:
            v = v + self.slid.T @ mu
        self._array(w, s * n)[:], self._array(multipliers, len(x) - s * n)[:] = now, x[s * n :]
        self._array(out, 3 * s * n)[:] = np.concatenate([q, v, a])
