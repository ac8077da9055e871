"""The end of a step of Radau IIA: projection of q and v onto the constraints, the local error, a and lam of the end, and the next start."""

import numpy as np

from polyida.errors import DONE, NOT_FINITE, SINGULAR
from polyida.integrate.radau.prediction import store_prediction_error
from polyida.integrate.radau.step import phi_by_increments, stage_state, stage_velocities
from polyida.integrate.radau.step_arrays import ERROR, LAST, PHI, PHI_RATE, SOLVES
from polyida.integrate.sizes import ROUND_OFF
from polyida.jit import part
from polyida.linear.dense import clear, copy_matrix, put
from polyida.system import ACCELERATION, ACCEPT
from polyida.system import instant as ask

MAX_PROJECTIONS = 3  # of q onto phi = 0
AGAIN = 1e-9  # of the model's size: if |phi| was larger, the rows are computed again at the projected q


@part
def largest(values):
    """The largest magnitude of the values."""
    size = 0.0
    for i in range(values.shape[0]):
        size = max(size, abs(values[i]))
    return size


@part
def project_end(model, first, method, arrays, h):
    """Update v and v' after the last correction, and project q and v of the step's end onto phi = 0 and phi' = 0 in the metric of M."""
    tableau, memory, trial, work = arrays.tableau, arrays.memory, arrays.trial, arrays.work
    status = stage_velocities(model, first, method, arrays, h)
    if not trial.lam.shape[1] or status != DONE:
        return status
    k = trial.e.shape[0] - 1
    size, at = method.extent + largest(memory.q), first + 1 + k
    phi, rate, rows_are_current = work.rows[PHI, k], work.rows[PHI_RATE, k], False
    stage_state(tableau, h, memory, trial, work, k)
    status = phi_by_increments(model, first, memory, trial, work, k)
    for _ in range(MAX_PROJECTIONS):
        worst = largest(phi)
        if status != DONE or worst <= ROUND_OFF * size:
            break
        if not rows_are_current:
            status = ask.rate(model, at, work.q, work.v, work.spare, 0)
        if status == DONE:
            status = ask.project(model, at, phi, trial.e[k], 0)
        if status != DONE:
            break
        stage_state(tableau, h, memory, trial, work, k)
        rows_are_current = worst <= AGAIN * size
        status = phi_by_increments(model, first, memory, trial, work, k)
    if status != DONE or not method.moves_v:
        return status
    if not (method.by_increments and rows_are_current):
        # with increments `rate` is phi' already: the request only makes B for `project`, and its output goes to spare
        rates = work.spare if method.by_increments else rate
        status = ask.rate(model, at, work.q, work.v, rates, 0)
    if status == DONE and largest(rate) > 0.0:
        status = ask.project(model, at, rate, trial.dv[k], 0)
        if status == DONE and method.by_increments:
            status = phi_by_increments(model, first, memory, trial, work, k)
    return status


@part
def defects(tableau, h, memory, trial, work):
    """Overwrite work.inertia[0] with p' - v_0 and work.inertia[1] with w' - v', (n,) each, the defects at the step's start.

    p and w: the polynomials of q and v through the step's start and its stages, by e and v - v_0 of the stages in trial; v': that at the
    end of the last step, memory.a.
    """
    for i in range(trial.e.shape[1]):
        v, a = 0.0, memory.a[i]
        for k in range(trial.e.shape[0]):
            v += tableau.start[k] * trial.e[k, i] / h
            a += tableau.start[k] * trial.dv[k, i] / h
        work.inertia[0, i], work.inertia[1, i] = -v, -a


@part
def close_velocity_rows(method, tableau, h, work):
    """Fill work.closing, or work.closing_pair without a real mode, for the filter of the local error: zero, but for velocity rows.

    c: the mode's eigenvalue over h. In the rows of phi' stands (v + v'/c) of each velocity row, from work.rates, in those of phi this over
    c; the other of the two arrays is zero.
    """
    c = complex(tableau.values[1], tableau.values[2]) / h
    clear(work.closing)
    clear(work.closing_pair)
    for k in range(method.velocity_rows.shape[0]):
        e = method.velocity_rows[k]
        if tableau.real_row.shape[0]:
            work.closing[PHI_RATE, e] = work.rates[0, 1, e] + work.rates[1, 1, e] * h / tableau.values[0]
            work.closing[PHI, e] = work.closing[PHI_RATE, e] * h / tableau.values[0]
        else:
            work.closing_pair[PHI_RATE, e] = work.rates[0, 1, e] + work.rates[1, 1, e] / c
            work.closing_pair[PHI, e] = work.closing_pair[PHI_RATE, e] / c


@part
def local_error(model, first, method, arrays, h):
    """(status, local error of q at the step's end: the norm of its difference to a method of order s).

    It is the difference of v_0, and of v' at the end of the last step, to the stages' polynomial, filtered by a solve with the step matrix, so
    that unresolved stiff modes do not count. The solve removes what phi does not permit; psi permits an error along W, (v + v'/c)/c.
    """
    tableau, memory, trial, work = arrays.tableau, arrays.memory, arrays.trial, arrays.work
    count, n = trial.e.shape
    middle, lam, real = first + 1 + count // 2, trial.lam[count // 2], tableau.real_row.shape[0] > 0
    defects(tableau, h, memory, trial, work)
    change_v, change_a, inertia, momentum = work.inertia[0], work.inertia[1], work.inertia[2], work.inertia[3]
    if method.velocity_rows.shape[0]:
        status = ask.inertia(model, middle, change_v, change_a, inertia, momentum, memory.q, work.rates[0])
        if status == DONE:
            status = ask.inertia(model, middle, change_a, change_a, work.a, None, memory.q, work.rates[1])
    else:
        status = ask.inertia(model, middle, change_v, change_a, inertia, momentum, memory.q, None)
    if status != DONE:
        return status, 0.0
    arrays.counts[SOLVES] += 1
    total, c = 0.0, complex(tableau.values[1], tableau.values[2]) / h
    for i in range(n):
        if real:
            work.right[i] = inertia[i] + tableau.values[0] / h * momentum[i]
        else:
            work.right_pair[i] = inertia[i] + c * momentum[i]
    close_velocity_rows(method, tableau, h, work)
    if real:
        status = ask.solve_real(model, middle, work.right, work.closing, lam, work.dq, work.multipliers)
    else:
        status = ask.solve_pair(model, middle, work.right_pair, work.closing_pair, lam, work.dq_pair, work.multipliers_pair)
    for i in range(n):
        dq = work.dq[i] if real else work.dq_pair[i].real
        total += memory.shares[i] * dq * dq
    return status, np.sqrt(total)


@part
def end_state(model, first, h, memory, trial, work):
    """Overwrite work.q, work.v, work.a and work.lam with the state at the step's end; return a status.

    a and lam are those of the equations of motion, or of the last stage if these are singular.
    """
    k, n = trial.e.shape[0] - 1, trial.e.shape[1]
    total = 0.0
    for i in range(n):
        work.q[i], work.v[i], work.a[i] = memory.q[i] + (h * memory.v[i] + trial.e[k, i]), memory.v[i] + trial.dv[k, i], trial.a[k, i]
        total += work.q[i] * work.v[i]
    put(1.0, trial.lam[k], work.lam)
    if not np.isfinite(total):
        return NOT_FINITE
    if ask.provides(model, ACCEPT):
        status = ask.accept(model, first + 1 + k, work.q)
        if status != DONE:
            return status
    if ask.provides(model, ACCELERATION):
        status = ask.acceleration(model, first + 1 + k, work.q, work.v, work.a, work.lam)
        if status != DONE and status != SINGULAR:
            return status
        for i in range(n):
            total += work.a[i] * 0.0
        for e in range(work.lam.shape[0]):
            total += work.lam[e] * 0.0
    return DONE if np.isfinite(total) else NOT_FINITE


@part
def advance(h, error, memory, trial, work):
    """Copy the state at the step's end, in work and trial, to memory, as the start of the next step, with h and `error`, the local error.

    memory also takes the error of the prediction, and v - v_0 and lam of the stages, from which the next stages are extrapolated.
    """
    store_prediction_error(memory, trial, work)
    k = trial.e.shape[0] - 1
    for i in range(work.q.shape[0]):
        memory.q[i], memory.v[i], memory.a[i] = work.q[i], work.v[i], trial.a[k, i]
    put(1.0, trial.lam[k], memory.lam)
    copy_matrix(trial.dv, memory.stages_v)
    copy_matrix(trial.lam, memory.stages_lam)
    copy_matrix(work.rows[:, k], memory.phi_start)
    memory.marks[LAST], memory.marks[ERROR] = h, error
