"""Steps of Radau IIA solved once more and swept backward.

`solve_stages` solves the stages of steps between stored states to round-off, with the tables of the run. `sweep_back` is the driver of the
backward sweep. With c_i, W of the tableau, `q_i = q_0 + c_i h v_0 + e_i`, `v_i = v_0 + sum_j W_ij e_j / h + D^-1 B_i^T mu_i` and
`v_i' = sum_j W_ij (v_j - v_0) / h` the equations of a step are `r_i = 0`, `phi_i = 0` and, if there is mu, `B_i v_i + phi_t = 0`; their
multipliers are w_i, mu*_i and kappa_i. b_q and b_v are the adjoints of the step's end, which is the last stage:

    a*_i = M_i^T w_i
    v*_i = C_i^T w_i + B_i^T kappa_i + sum_j W_ji a*_j / h + [b_v]
    q*_i = K_i^T w_i + B_i^T mu*_i + H_i^T kappa_i + (B_i^T mu_i)_q^T D^-1 v*_i + [b_q]

and `q*_j + sum_i W_ij v*_i / h = 0`, `B_i w_i = 0`, `B_i D^-1 v*_i = 0` are the transposed system. To the step before go

    q*_0 = sum_i q*_i,    v*_0 = sum_i c_i h q*_i + v*_i - sum_ij W_ij a*_i / h

K, C and H are dr/dq, dr/dv and d(B v + phi_t)/dq. The entry ADJOINT of a table (adjoint/tables.py) solves the transposed system; it gets
right (s, n), the terms of b_q and b_v in the first equation, and b_v, and fills w (s, n), multipliers (mu*, and kappa if there is mu) and
products (3, s, n): q*, v* and a* without the terms [b_q], [b_v] and W.
"""

from typing import NamedTuple

import numpy as np

from polyida.errors import DONE
from polyida.integrate.radau.loop import MAKE, STEP, TARGET, TIME, attempt, make_factors, reserve_slot
from polyida.integrate.radau.step_arrays import FACTORS
from polyida.integrate.state import State
from polyida.jit import entry, fast, pack
from polyida.linear.dense import clear, copy_matrix, put
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
        """The State number k, 0 at the start of the first step."""
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


@pack
class Slopes(NamedTuple):
    """The objective's slopes at the steps' ends, (count, n), or (0, n) where they are zero."""

    q: np.ndarray
    v: np.ndarray


@pack
class Steps(NamedTuple):
    """What is known of the steps before the sweep."""

    h: float
    nodes: np.ndarray  # (s,) c of the tableau
    W: np.ndarray  # (s, s) of the tableau
    states: States
    stages: Stages
    slopes: Slopes


@pack
class Sweep(NamedTuple):
    """State and scratch of the sweep."""

    adjoints: np.ndarray  # (2, n) of q and v
    end: np.ndarray  # (2, n) the same with the objective's slopes at the end of a step: b_q, b_v
    right: np.ndarray  # (s, n)
    below: np.ndarray  # (s, m) zeros
    products: np.ndarray  # (3, s, n)


@pack
class SweepOutput(NamedTuple):
    """Results of the backward sweep over `count` steps of s stages."""

    w: np.ndarray  # (count, s, n)
    v: np.ndarray  # (count, s, n) v*
    multipliers: np.ndarray  # (count, 1 or 2, s, m) mu* and kappa
    slopes: np.ndarray  # (count,) slopes in h


@entry
def sweep_back(functions, workspace, first, last, steps, work, out):
    """Sweep backward over the steps from last - 1 to first: (the first step that is done, status of the one before)."""
    model = functions, workspace
    for k in range(last - 1, first - 1, -1):
        begin(steps, k, work, out)
        status = ask.adjoint(model, k, work.right, work.below, work.end[1], out.w[k], out.multipliers[k], work.products)
        if status != DONE:
            return k + 1, status
        finish(steps, k, work, out)
    return first, DONE


@fast
def begin(steps, step, work, out):
    """Add the objective's slopes to the adjoints of the end of a step, and set the right-hand side; the multipliers start from zero."""
    slopes, last = steps.slopes, steps.W.shape[0] - 1
    out.w[step], out.multipliers[step] = 0.0, 0.0
    for i in range(work.adjoints.shape[1]):
        work.end[0, i], work.end[1, i] = work.adjoints[0, i], work.adjoints[1, i]
        if slopes.q.shape[0]:
            work.end[0, i] += slopes.q[step, i]
        if slopes.v.shape[0]:
            work.end[1, i] += slopes.v[step, i]
    for s in range(last + 1):
        for i in range(work.adjoints.shape[1]):
            work.right[s, i] = -steps.W[last, s] / steps.h * work.end[1, i]
    for i in range(work.adjoints.shape[1]):
        work.right[last, i] -= work.end[0, i]


@fast
def finish(steps, step, work, out):
    """Write the adjoints of the step's start, v* and the slope in h."""
    h, nodes, W, states, stages = steps.h, steps.nodes, steps.W, steps.states, steps.stages
    q, v, a, last, slope = work.products[0], work.products[1], work.products[2], W.shape[0] - 1, 0.0
    for i in range(work.adjoints.shape[1]):
        q[last, i] += work.end[0, i]
        v[last, i] += work.end[1, i]
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
        work.adjoints[0, i], work.adjoints[1, i] = of_q, of_v
    out.slopes[step] = slope


@entry
def initial_stages(nodes, step_size, states, step, trial):
    """Initial stages for a step: e from the cubic through q and v of both ends, lam linear, mu zero."""
    for j in range(nodes.shape[0]):
        s = nodes[j]
        for i in range(states.q.shape[1]):
            way = states.q[step + 1, i] - states.q[step, i] - step_size * states.v[step, i]
            turn = step_size * (states.v[step + 1, i] - states.v[step, i])
            trial.e[j, i] = s * s * (3.0 * way - turn) + s * s * s * (turn - 2.0 * way)
        for i in range(states.lam.shape[1]):
            trial.lam[j, i] = (1.0 - s) * states.lam[step, i] + s * states.lam[step + 1, i]
    clear(trial.mu)


@entry
def solve_stages(functions, workspace, at, method, arrays, now, step_size, fresh, states, done, out):
    """Solve the stages of steps of step_size from number `done` on: (number of solved steps, status of the next one).

    functions, workspace, method, arrays, fresh: as of `loop.take_steps`; at: number of the instant at which the first step starts.
    """
    tableau, memory, trial, work = arrays.tableau, arrays.memory, arrays.trial, arrays.work
    model, apart = (functions, workspace), tableau.c.shape[0] + 1
    for k in range(done, out.e.shape[0]):
        put(1.0, states.q[k], memory.q)
        put(1.0, states.v[k], memory.v)
        put(1.0, states.a[k], memory.a)
        put(1.0, states.lam[k], memory.lam)
        initial_stages(tableau.c, step_size, states, k, trial)
        now[STEP], now[TIME], now[TARGET] = step_size, states.t[k], states.t[k + 1]
        first = at if ask.provides(model, PREPARE) else at + k * apart
        status, _ = attempt(functions, workspace, first, method, arrays, now, fresh)
        if status == MAKE and ask.provides(model, MATRICES):
            slot = reserve_slot(arrays.slots, step_size, states.t[k], memory)
            status = make_factors(model, first, tableau, memory, work, slot)
            arrays.counts[FACTORS] += 1
            if status == DONE:
                initial_stages(tableau.c, step_size, states, k, trial)
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
