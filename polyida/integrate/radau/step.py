"""A step of Radau IIA in compiled code, of any model through its table (polyida.system).

With `q_i = q_0 + c_i h v_0 + e_i` the unknowns of the stages are e, lam and mu; v and v' follow from them,

    v_i = q_i' + D^-1 B^T mu_i,   q_i' = v_0 + sum_j W_ij e_j / h,   v_i' = sum_j W_ij (v_j - v_0) / h

and at each node `r(t, q, v, v', lam) = 0`, phi = 0 and, in the form "ggl", `B v + phi_t = 0`; "index3" has neither that nor mu.
D, the diagonal of M over its mean, makes it the same in all units. Where phi is linear in q and not driven, mu is zero and the two
forms are one: v = q' is on its constraint with q. In a simplified Newton iteration the transformed stages of each mode of the tableau, with
c = l/h, l its eigenvalue, solve

    |  S    B^T  (c M + C) G^T |  |dq  |     |r |     M v' + g + B^T lam           S = K + c C + c^2 M
    |  B                       |  |dlam| = - |r3|     phi                          G = B D^-1
    |  c B + H         B G^T   |  |dmu |     |r4|     phi' = B v + phi_t           H = d phi'/dq

v follows q and mu, dv = c dq + G^T dmu; B, H and G are those of the middle stage. A step (radau/loop.py) calls `solve_stages` (predict, then
`newton` with one `iterate` for each iteration), `project_end`, `local_error`, `end_state` and, if it is accepted, `advance`.

A velocity row psi is a row with phi = 0, phi' = psi and B = W. Its equation in place of phi is `psi(t, q, q') = 0`, so that mu keeps the
form of the others: r3 is psi(t, q, q')/c.
"""

import numpy as np

from polyida.errors import DONE, NOT_FINITE, REFACTOR
from polyida.integrate.radau.prediction import predict
from polyida.integrate.radau.step_arrays import AGE, CONTRACTION, ITERATIONS, MAX_AGE, MOVED, PHI, PHI_RATE, RESIDUALS, SOLVES, SPEED
from polyida.jit import fast, part
from polyida.linear.dense import put
from polyida.system import instant as ask

STALLED = 0.9  # contraction above which corrections below ROUND times the size are round-off
ROUND = 1e-11
NOISE = 1e-15  # of the size: smaller later corrections are round-off of phi if this is computed from positions


@fast
def mean_square(shares, values):
    """The mean square of values (n,) with weights, `sum shares_i values_i^2`."""
    total = 0.0
    for i in range(values.shape[0]):
        total += shares[i] * values[i] * values[i]
    return total


@part
def stage_rates(inverse, h, values, rates):
    """Fill rates = A^-1 values / h, (s, n) each; inverse: A^-1 of the tableau."""
    for k in range(values.shape[0]):
        row, first, weight = rates[k], values[0], inverse[k, 0] / h
        for i in range(row.shape[0]):
            row[i] = weight * first[i]
        for j in range(1, values.shape[0]):
            other, weight = values[j], inverse[k, j] / h
            for i in range(row.shape[0]):
                row[i] += weight * other[i]


@part
def stage_state(tableau, h, memory, trial, work, stage):
    """Overwrite work.q and work.v (n,) with q and v of a stage: the step's start in memory, and e and v - v_0 of the stage in trial."""
    c = tableau.c[stage] * h
    for i in range(work.q.shape[0]):
        work.q[i] = memory.q[i] + (c * memory.v[i] + trial.e[stage, i])
        work.v[i] = memory.v[i] + trial.dv[stage, i]


@part
def stage_velocities(model, first, method, arrays, h):
    """Overwrite trial.dv = v - v_0 and trial.a = v' (s, n) of the stages, from trial.e and trial.mu; return a status.

    With velocity rows work.psi (s, m) is filled, by the rates at v = q'; without these it stays as it is.
    """
    tableau, memory, trial, work = arrays.tableau, arrays.memory, arrays.trial, arrays.work
    stage_rates(tableau.W, h, trial.e, trial.dv)
    for k in range(trial.e.shape[0] if method.velocity_rows.shape[0] else 0):
        stage_state(tableau, h, memory, trial, work, k)
        if method.by_increments:
            status = phi_by_increments(model, first, memory, trial, work, k)
        else:
            status = ask.rate(model, first + 1 + k, work.q, work.v, work.rows[PHI_RATE, k], 0)
        if status != DONE:
            return status
        put(1.0, work.rows[PHI_RATE, k], work.psi[k])
    if trial.mu.shape[1]:
        for k in range(trial.e.shape[0]):
            stage_state(tableau, h, memory, trial, work, k)
            status = ask.reaction(model, first + 1 + k, work.q, trial.mu[k], trial.dv[k], 0)
            if status != DONE:
                return status
    stage_rates(tableau.W, h, trial.dv, trial.a)
    return DONE


@part
def phi_by_increments(model, first, memory, trial, work, stage):
    """Overwrite work.rows[:, stage] (2, m) with phi and phi' of a stage, by increments from the start of the step; return a status.

    work.q is q of the stage, e and v - v_0 are in trial.
    """
    phi, rate = work.rows[PHI, stage], work.rows[PHI_RATE, stage]
    put(1.0, memory.phi_start[PHI], phi)
    put(1.0, memory.phi_start[PHI_RATE], rate)
    return ask.constraints(model, first + 1 + stage, work.q, trial.e[stage], trial.dv[stage], phi, rate)


@part
def residuals(model, first, method, arrays, h):
    """Overwrite work.r (s, n) and work.rows (2, s, m) with r, phi and phi' of all stages in trial; return a status.

    trial.dv and trial.a are made from e and mu first. In velocity rows psi stands in place of phi; phi' is filled only if it is an equation
    or computed by increments.
    """
    tableau, memory, trial, work = arrays.tableau, arrays.memory, arrays.trial, arrays.work
    status = stage_velocities(model, first, method, arrays, h)
    for k in range(trial.e.shape[0]):
        if status != DONE:
            return status
        stage_state(tableau, h, memory, trial, work, k)
        status = ask.residual(model, first + 1 + k, work.q, work.v, trial.a[k], trial.lam[k], work.r[k], work.rows[PHI, k])
        if status == DONE and method.by_increments:
            status = phi_by_increments(model, first, memory, trial, work, k)
        elif status == DONE and method.tied:
            status = ask.rate(model, first + 1 + k, work.q, work.v, work.rows[PHI_RATE, k], 1)
        for i in range(method.velocity_rows.shape[0]):
            work.rows[PHI, k, method.velocity_rows[i]] = work.psi[k, method.velocity_rows[i]]
    return status


@fast
def into_modes(method, tableau, h, work):
    """Transform the residuals of the stages, work.r (s, n) and work.rows (2, s, m), to those of the modes: overwrite four arrays of work.

    right (n,) and closing (2, m) are of the real mode, right_pair and closing_pair of the complex one. A velocity row in the block of phi
    is divided by c = l/h of its mode.
    """
    stages, real = work.r.shape[0], tableau.real_row.shape[0] > 0
    for i in range(work.right.shape[0]):
        one, pair = 0.0, 0.0j
        for k in range(stages):
            if real:
                one += tableau.real_row[k] * work.r[k, i]
            pair += tableau.pair_row[k] * work.r[k, i]
        work.right[i], work.right_pair[i] = one, pair
    for g in range(2):
        for e in range(work.closing.shape[1]):
            one, pair = 0.0, 0.0j
            for k in range(stages):
                if real:
                    one += tableau.real_row[k] * work.rows[g, k, e]
                pair += tableau.pair_row[k] * work.rows[g, k, e]
            work.closing[g, e], work.closing_pair[g, e] = one, pair
    for i in range(method.velocity_rows.shape[0]):
        e = method.velocity_rows[i]
        work.closing_pair[PHI, e] *= h / complex(tableau.values[1], tableau.values[2])
        if real:
            work.closing[PHI, e] *= h / tableau.values[0]


@fast
def from_modes(tableau, work):
    """Overwrite work.r (s, n) with the corrections de of the stages, from the corrections of the modes in work."""
    for k in range(work.r.shape[0]):
        real, pair = tableau.real_column[k] if tableau.real_row.shape[0] else 0.0, 2.0 * tableau.pair_column[k]
        for i in range(work.r.shape[1]):
            work.r[k, i] = real * work.dq[i] + (pair * work.dq_pair[i]).real


@part
def add_multipliers(tableau, work, kind, lam):
    """Add the corrections of multipliers in work, those of the modes, to lam (s, m) of the stages; kind: 0 for lam, 1 for mu."""
    for k in range(lam.shape[0]):
        for e in range(lam.shape[1]):
            lam[k, e] += 2.0 * (tableau.pair_column[k] * work.multipliers_pair[kind, e]).real
            if tableau.real_row.shape[0]:
                lam[k, e] += tableau.real_column[k] * work.multipliers[kind, e]


@part
def iterate(model, first, method, arrays, h):
    """Correct e, lam and mu of the stages in trial by one Newton iteration; return (status, norm of dq and h dv).

    The norm is the root mean square over the stages, weighted by mass.
    """
    tableau, memory, trial, work = arrays.tableau, arrays.memory, arrays.trial, arrays.work
    status = residuals(model, first, method, arrays, h)
    if status != DONE:
        return status, 0.0
    stages, n = trial.e.shape
    middle, lam = first + 1 + stages // 2, trial.lam[stages // 2]
    ask.turn(model, first, work.r, 0)
    into_modes(method, tableau, h, work)
    if tableau.real_row.shape[0]:
        status = ask.solve_real(model, middle, work.right, work.closing, lam, work.dq, work.multipliers)
    if status == DONE:
        status = ask.solve_pair(model, middle, work.right_pair, work.closing_pair, lam, work.dq_pair, work.multipliers_pair)
    if status != DONE:
        return status, 0.0
    from_modes(tableau, work)
    ask.turn(model, first, work.r, 1)
    stage_rates(tableau.W, 1.0, work.r, trial.dv)
    total = 0.0
    for k in range(stages):
        for i in range(n):
            trial.e[k, i] += work.r[k, i]
        total += mean_square(memory.shares, work.r[k]) + mean_square(memory.shares, trial.dv[k])
    add_multipliers(tableau, work, 0, trial.lam)
    add_multipliers(tableau, work, 1, trial.mu)
    return DONE, np.sqrt(total / stages)


@part
def newton(model, first, method, arrays, h, allowed):
    """Newton's method until the estimated error of q is at most `allowed`: (status, iterations). The stages are in `trial`.

    The error left by a correction is estimated by its contraction, |dq| k/(1 - k). It ends too where corrections are round-off, and fails (REFACTOR)
    where the contraction says that the iterations which are left do not suffice.
    """
    tableau, memory, trial, work, counts = arrays.tableau, arrays.memory, arrays.trial, arrays.work, arrays.counts
    size = np.sqrt(mean_square(memory.shares, memory.q)) + h * np.sqrt(mean_square(memory.shares, memory.v))
    contraction = min(2.0 * memory.marks[CONTRACTION], 1.0) if memory.marks[AGE] < MAX_AGE else 1.0
    last, worst, round_off = np.inf, 0.0, max(ROUND * size, method.least)
    noise = 0.0 if method.by_increments else NOISE * size
    for iteration in range(1, method.max_iterations + 1):
        counts[RESIDUALS] += trial.e.shape[0]
        counts[ITERATIONS] += 1
        counts[SOLVES] += 1 + (tableau.real_row.shape[0] > 0)
        status, moved = iterate(model, first, method, arrays, h)
        if status != DONE or not np.isfinite(moved):
            return (NOT_FINITE if status == DONE else status), iteration
        if iteration > 1:
            contraction = moved / last
            worst = max(worst, contraction) if moved > noise or worst == 0.0 else worst
        work.progress[MOVED], work.progress[SPEED] = moved, contraction
        left = contraction / (1.0 - contraction) * moved if contraction < 1.0 else np.inf
        spent, stalled = iteration == method.max_iterations, iteration > 1 and contraction > STALLED
        rounded = iteration > 1 and moved <= noise
        if left <= allowed or moved == 0.0 or rounded or (moved <= round_off and (stalled or spent)):
            if iteration > 1:
                memory.marks[CONTRACTION], memory.marks[AGE] = worst, 0.0
            else:
                memory.marks[AGE] += 1.0
            return DONE, iteration
        if iteration > 1 and contraction ** (method.max_iterations - iteration) * left > max(allowed, round_off):
            break
        last = moved
    return REFACTOR, iteration


@part
def solve_stages(model, first, method, arrays, h, allowed):
    """Solve the stages of a step from the state in `memory`: (status, iterations)."""
    tableau, memory, trial, work = arrays.tableau, arrays.memory, arrays.trial, arrays.work
    status = ask.begin(model, first, memory.q, memory.v, work.times)
    if status != DONE:
        return status, 0
    if not method.has_guess:
        predict(tableau, h, memory, trial, work)
    stage_rates(tableau.W, h, trial.e, trial.dv)
    k = trial.e.shape[0] // 2
    stage_state(tableau, h, memory, trial, work, k)
    status = ask.rows(model, first + 1 + k, work.q, work.v, None, 0)
    if status != DONE:
        return status, 0
    return newton(model, first, method, arrays, h, allowed)
