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

from typing import NamedTuple

import numpy as np

from polyida.errors import DONE, NOT_FINITE, REFACTOR, SINGULAR
from polyida.integrate.sizes import ROUND_OFF
from polyida.jit import fast, pack, part
from polyida.linear.dense import clear, copy_matrix, put
from polyida.system import ACCELERATION, ACCEPT
from polyida.system import instant as ask

STALLED = 0.9  # contraction above which corrections below ROUND times the size are round-off
ROUND = 1e-11
MAX_AGE = 10.0  # steps for which a measured contraction is used in the first iteration
UNKNOWN = np.array([1.0, MAX_AGE])  # CONTRACTION and AGE without a measured contraction
SAME_STEP = 1e-9  # of h: steps that differ by less have the same length
MAX_EXTRAPOLATION = 4.0  # steps over the last one: longer steps start from q_0 + c h v_0, not from its polynomial
NOISE = 1e-15  # of the size: smaller later corrections are round-off of phi if this is computed from positions
MAX_PROJECTIONS = 3  # of q onto phi = 0
AGAIN = 1e-9  # of the model's size: if |phi| was larger, the rows are computed again at the projected q
CONTRACTION, AGE, LAST, ERROR, MISSES = range(5)  # of Memory.marks; WEIGHTS, FITS and EXCESS follow
TERMS = 3  # prediction errors from which the next one is extrapolated
WEIGHTS = MISSES + 1
FITS = WEIGHTS + TERMS
EXCESS = FITS + TERMS**2
MARKS = EXCESS + TERMS
FORGET = 0.7  # share of EXCESS that a step keeps
LARGEST_WEIGHT = 4.0  # of a prediction error, above the 3 of the extrapolation by differences
PARALLEL = 1e-9  # squared sine of the angle below which prediction errors are parallel
MOVED, SPEED, EXTENDED = range(3)  # of Scratch.progress
RESIDUALS, ITERATIONS, SOLVES, FACTORS = range(4)  # of the counts
PHI, PHI_RATE = range(2)  # of rows


@pack
class Method(NamedTuple):
    """Numbers of the method.

    tied: True if there is mu; by_increments: True if phi is updated by increments; moves_v: True if v at the end of the step is projected onto
    phi' = 0; estimates_error: True if the local error is computed; has_guess: True if the trial stages hold initial values. low, high: limits
    of the model's times. renewal: iterations that cost as much as a new factor: a factor is made anew when its excess iterations exceed
    this. extent: size of the model, m; least: round-off of q = 0. tolerance: Newton's tolerance; 0: `share` times (atol + rtol |q|), or if share
    is 0 by the error of the step before and the model's length. velocity_rows: their numbers among the rows.
    """

    tied: bool
    by_increments: bool
    moves_v: bool
    estimates_error: bool
    has_guess: bool
    max_iterations: int
    low: float
    high: float
    renewal: float
    extent: float
    least: float
    tolerance: float
    share: float
    rtol: float
    atol: float
    length: float
    velocity_rows: np.ndarray


@pack
class CompiledTableau(NamedTuple):
    """A Tableau for compiled code: c, A, W, `start`, row and column of the real mode, (s,) or (0,) without one, and of the complex mode.

    values: eigenvalue of the real mode, real and imaginary part of that of the complex one.
    """

    c: np.ndarray
    A: np.ndarray
    W: np.ndarray
    start: np.ndarray
    real_row: np.ndarray
    real_column: np.ndarray
    pair_row: np.ndarray
    pair_column: np.ndarray
    values: np.ndarray


@pack
class Memory(NamedTuple):
    """Quantities that a step takes from the step before.

    q, v, a (n,) and lam (m,): of the last stage, a = v'. shares, places (n,): shares of the coordinates in the mass, and in |q|, without the
    integrals of states. stages_v (s, n), stages_lam (s, m): of the last step. miss_e (TERMS, s, n), miss_lam, mu (TERMS, s, m): prediction errors of the last equal steps, newest first: e and lam
    of a step minus the extrapolation from the step before, and its mu, which is extrapolated as zero. phi_start (2, m): phi and phi' at the
    start of the step, for increments. marks:

    | mark | meaning | unknown |
    |---|---|---|
    | CONTRACTION | of Newton's method, so that a step may end after one iteration | 1 |
    | AGE | of the contraction, in steps | MAX_AGE |
    | LAST | length of the step before, s | 0 |
    | ERROR | of that step | -1 |
    | MISSES | number of known prediction errors | 0 |
    | WEIGHTS | of each of them in the expected next one | 0 |
    | FITS | weights that were fitted for 1 to TERMS errors | 0 |
    | EXCESS | squared distance of a prediction with each from recent steps, minus that without | 0 |
    """

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    shares: np.ndarray
    places: np.ndarray
    lam: np.ndarray
    stages_v: np.ndarray
    stages_lam: np.ndarray
    miss_e: np.ndarray
    miss_lam: np.ndarray
    mu: np.ndarray
    phi_start: np.ndarray
    marks: np.ndarray


@pack
class Trial(NamedTuple):
    """Unknowns of Newton's method: e, v - v_0 and v' of the stages (s, n), multipliers lam (s, m) and mu (s, m), or (s, 0) without mu.

    start_e (s, n), start_lam (s, m): e and lam extrapolated from the last step.
    """

    e: np.ndarray
    dv: np.ndarray
    a: np.ndarray
    lam: np.ndarray
    mu: np.ndarray
    start_e: np.ndarray
    start_lam: np.ndarray


@pack
class Scratch(NamedTuple):
    """Workspace of a step: times (s + 6,), h, t, times of the instants and the argument of SELECT; q, v, a, lam of one state; r (s, n); rows
    (2, s, m), phi and phi'; psi (s, m), phi' for v = q'; rates (2, 2, m); and of each mode right-hand sides, rows, dq and multipliers.
    """

    times: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    lam: np.ndarray
    spare: np.ndarray
    inertia: np.ndarray
    r: np.ndarray
    rows: np.ndarray
    psi: np.ndarray
    rates: np.ndarray
    weights: np.ndarray
    progress: np.ndarray
    right: np.ndarray
    dq: np.ndarray
    closing: np.ndarray
    multipliers: np.ndarray
    right_pair: np.ndarray
    dq_pair: np.ndarray
    closing_pair: np.ndarray
    multipliers_pair: np.ndarray


@pack
class Arrays(NamedTuple):
    """All that the steps of a run read and write: slots: FactorSlots of loop.py; counts: what the steps cost."""

    tableau: CompiledTableau
    memory: Memory
    trial: Trial
    work: Scratch
    slots: tuple
    counts: np.ndarray


def compiled_tableau(tableau):
    """The CompiledTableau of a Tableau."""
    modes = {mode.paired: mode for mode in tableau.modes}
    real, pair = modes.get(False), modes[True]
    rows = (np.zeros(0), np.zeros(0)) if real is None else (real.row.copy(), real.column.copy())
    values = np.array([0.0 if real is None else real.value, pair.value.real, pair.value.imag])
    return CompiledTableau(tableau.c, tableau.A, tableau.W, tableau.start, *rows, pair.row.copy(), pair.column.copy(), values)


def empty(stages, n, m, tied):
    """(Memory, Trial, Scratch) for n coordinates and m constraints."""
    each, closing, tie = (stages, n), (stages, m), (stages, m if tied else 0)
    misses = ((TERMS, *shape) for shape in (each, closing, tie))
    memory = Memory(*map(np.zeros, (n, n, n, n, n, m, each, closing, *misses, (2, m), (MARKS,))))
    trial = Trial(*map(np.zeros, (each, each, each, closing, tie, each, closing)))
    shapes = (stages + 6,), (n,), (n,), (n,), (m,), (m,), (4, n), each, (2, stages, m), closing, (2, 2, m), (2, stages, stages), (3,)
    kind = (n,), (n,), (2, m), (2, m)
    return memory, trial, Scratch(*map(np.zeros, (*shapes, *kind)), *(np.zeros(shape, complex) for shape in kind))


@fast
def mean_square(shares, values):
    """Sum of shares values^2."""
    total = 0.0
    for i in range(values.shape[0]):
        total += shares[i] * values[i] * values[i]
    return total


@part
def largest(values):
    """max |values|."""
    size = 0.0
    for i in range(values.shape[0]):
        size = max(size, abs(values[i]))
    return size


@part
def stage_rates(W, h, values, rates):
    """rates = W values / h, (s, n) each."""
    for k in range(values.shape[0]):
        row, first, weight = rates[k], values[0], W[k, 0] / h
        for i in range(row.shape[0]):
            row[i] = weight * first[i]
        for j in range(1, values.shape[0]):
            other, weight = values[j], W[k, j] / h
            for i in range(row.shape[0]):
                row[i] += weight * other[i]


@part
def weighted_sum(weights, values, out):
    """out = weights values, (s, k) each."""
    for k in range(values.shape[0]):
        for i in range(values.shape[1]):
            out[k, i] = weights[k, 0] * values[0, i]
        for j in range(1, values.shape[0]):
            for i in range(values.shape[1]):
                out[k, i] += weights[k, j] * values[j, i]


@part
def predict(tableau, h, memory, trial, work):
    """Set initial stages: the extrapolated polynomial of the last step through the new state, plus the expected prediction error.

    v is extrapolated and integrated, which is more accurate than the polynomial of q. At the start of a run, and after much shorter steps,
    q = q_0 + c h v_0.
    """
    stages, last, ahead, to_e = trial.e.shape[0], memory.marks[LAST], work.weights[0], work.weights[1]
    clear(trial.mu)
    work.progress[EXTENDED] = 0.0
    if last == 0.0 or h > MAX_EXTRAPOLATION * last:
        clear(trial.e)
        for k in range(stages):
            put(1.0, memory.lam, trial.lam[k])
        return
    for k in range(stages):
        at = 1.0 + tableau.c[k] * (h / last)
        for j in range(stages):
            ahead[k, j] = 1.0
            for o in range(stages):
                if o != j:
                    ahead[k, j] *= (at - tableau.c[o]) / (tableau.c[j] - tableau.c[o])
    weighted_sum(ahead, memory.stages_lam, trial.lam)
    for k in range(stages):
        at = 1.0 + tableau.c[k] * (h / last)
        for j in range(stages):
            ahead[k, j] *= at / tableau.c[j]
        ahead[k, stages - 1] -= 1.0
    for k in range(stages):
        for j in range(stages):
            to_e[k, j] = 0.0
            for o in range(stages):
                to_e[k, j] += h * tableau.A[k, o] * ahead[o, j]
    weighted_sum(to_e, memory.stages_v, trial.e)
    if abs(h - last) <= SAME_STEP * h:
        add_prediction_error(memory, trial, work)


@part
def add_prediction_error(memory, trial, work):
    """Store the extrapolated stages in start_e and start_lam, and add the expected prediction error for a step of the same length."""
    work.progress[EXTENDED] = 1.0
    copy_matrix(trial.e, trial.start_e)
    copy_matrix(trial.lam, trial.start_lam)
    for o in range(TERMS):
        weight = memory.marks[WEIGHTS + o]
        for k in range(trial.e.shape[0] if weight != 0.0 else 0):
            for i in range(trial.e.shape[1]):
                trial.e[k, i] += weight * memory.miss_e[o, k, i]
            for e in range(trial.lam.shape[1]):
                trial.lam[k, e] += weight * memory.miss_lam[o, k, e]
            for e in range(trial.mu.shape[1]):
                trial.mu[k, e] += weight * memory.mu[o, k, e]


@fast
def store_prediction_error(memory, trial, work):
    """Store the prediction error of the step, and the weights of the errors in the next one: of 1 to TERMS errors, as many as predicted best."""
    marks, known = memory.marks, int(memory.marks[MISSES])
    weights, fits, excess = marks[WEIGHTS:FITS], marks[FITS:EXCESS], marks[EXCESS:]
    if work.progress[EXTENDED] == 0.0:
        marks[MISSES:] = 0.0
        return
    products = np.zeros((TERMS, TERMS + 1))
    for k in range(trial.e.shape[0]):
        for i in range(trial.e.shape[1]):
            trial.start_e[k, i] = trial.e[k, i] - trial.start_e[k, i]
        for o in range(known):
            for j in range(o, known + 1):
                other, total = memory.miss_e[j, k] if j < known else trial.start_e[k], 0.0
                for i in range(trial.e.shape[1]):
                    total += memory.shares[i] * memory.miss_e[o, k, i] * other[i]
                products[o, j] += total
    best = 0.0
    for count in range(TERMS):
        excess[count] *= FORGET
        for o in range(known):
            weight = fits[TERMS * count + o]
            excess[count] += weight * (weight * products[o, o] - 2.0 * products[o, known])
            for j in range(o + 1, known):
                excess[count] += 2.0 * weight * fits[TERMS * count + j] * products[o, j]
        best = min(best, excess[count])
    fit(products, known, fits)
    weights[:] = 0.0
    for count in range(TERMS):
        if best < 0.0 and excess[count] == best:
            for o in range(TERMS):
                weights[o] = fits[TERMS * count + o]
    for k in range(trial.e.shape[0]):
        put_first(memory.miss_e[:, k], trial.start_e[k])
        for e in range(trial.lam.shape[1]):
            trial.start_lam[k, e] = trial.lam[k, e] - trial.start_lam[k, e]
        put_first(memory.miss_lam[:, k], trial.start_lam[k])
        put_first(memory.mu[:, k], trial.mu[k])
    marks[MISSES] = min(known + 1.0, TERMS)


@part
def put_first(rows, newest):
    """Move rows down by one, and put the newest first."""
    for o in range(rows.shape[0] - 1, 0, -1):
        put(1.0, rows[o - 1], rows[o])
    put(1.0, newest, rows[0])


@part
def fit(products, known, fits):
    """Weights of 1 to TERMS vectors in the least-squares fit to another one, TERMS each; those of fewer vectors if they are large or undetermined.

    products (o, j): of vectors o and j >= o, and in column `known` of vector o and the other one. They become L D L^T of the vectors' products,
    which is nested, and L^-1 of the column.
    """
    used = 0
    for o in range(known):
        pivot, right = products[o, o], products[o, known]
        for j in range(o):
            pivot -= products[j, o] * products[j, o] / products[j, j]
            right -= products[j, o] * products[j, known] / products[j, j]
        if not pivot > PARALLEL * products[o, o]:
            break
        for i in range(o + 1, known):
            for j in range(o):
                products[o, i] -= products[j, o] * products[j, i] / products[j, j]
        products[o, o], products[o, known], used = pivot, right, o + 1
    fits[:] = 0.0
    for count in range(TERMS):
        weights, most = fits[TERMS * count : TERMS * (count + 1)], 0.0
        for o in range(min(used, count + 1) - 1, -1, -1):
            weights[o] = products[o, known] / products[o, o]
            for j in range(o + 1, min(used, count + 1)):
                weights[o] -= products[o, j] / products[o, o] * weights[j]
            most = max(most, abs(weights[o]))
        if most > LARGEST_WEIGHT:
            for o in range(TERMS):
                weights[o] = fits[TERMS * (count - 1) + o] if count else 0.0


@part
def stage_state(tableau, h, memory, trial, work, stage):
    """Write q and v of a stage to the workspace."""
    c = tableau.c[stage] * h
    for i in range(work.q.shape[0]):
        work.q[i] = memory.q[i] + (c * memory.v[i] + trial.e[stage, i])
        work.v[i] = memory.v[i] + trial.dv[stage, i]


@part
def stage_velocities(model, first, method, arrays, h):
    """v and v' of the stages from e and mu, and psi."""
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
    """phi and phi' of a stage by increments from the start of the step; work.q is q of the stage."""
    phi, rate = work.rows[PHI, stage], work.rows[PHI_RATE, stage]
    put(1.0, memory.phi_start[PHI], phi)
    put(1.0, memory.phi_start[PHI_RATE], rate)
    return ask.constraints(model, first + 1 + stage, work.q, trial.e[stage], trial.dv[stage], phi, rate)


@part
def residuals(model, first, method, arrays, h):
    """r, phi and phi' of all stages."""
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
    """Transform the residuals of the stages to the modes. Velocity rows are divided by c."""
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
    """Transform the corrections of the modes to the stages, in work.r."""
    for k in range(work.r.shape[0]):
        real, pair = tableau.real_column[k] if tableau.real_row.shape[0] else 0.0, 2.0 * tableau.pair_column[k]
        for i in range(work.r.shape[1]):
            work.r[k, i] = real * work.dq[i] + (pair * work.dq_pair[i]).real


@part
def add_multipliers(tableau, work, kind, lam):
    """Add the modes' multipliers of one kind (0: lam, 1: mu) to those of the stages."""
    for k in range(lam.shape[0]):
        for e in range(lam.shape[1]):
            lam[k, e] += 2.0 * (tableau.pair_column[k] * work.multipliers_pair[kind, e]).real
            if tableau.real_row.shape[0]:
                lam[k, e] += tableau.real_column[k] * work.multipliers[kind, e]


@part
def iterate(model, first, method, arrays, h):
    """One Newton iteration: (status, norm of dq and h dv: root mean square over stages, weighted by mass)."""
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
    """Newton's method until the estimated error of q is at most `allowed`: (status, iterations). The stages are in `trial`."""
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
def local_error(model, first, method, arrays, h):
    """(status, local error of q at the step's end: the norm of its difference to a method of order s).

    It is the difference of v_0, and of v' at the end of the last step, to the stages' polynomial, filtered by a solve with the step matrix, so
    that unresolved stiff modes do not count. The solve removes what phi does not permit; psi permits an error along W, (v + v'/c)/c.
    """
    tableau, memory, trial, work = arrays.tableau, arrays.memory, arrays.trial, arrays.work
    count, n = trial.e.shape
    middle, lam, real = first + 1 + count // 2, trial.lam[count // 2], tableau.real_row.shape[0] > 0
    for i in range(n):
        v, a = 0.0, memory.a[i]
        for k in range(count):
            v += tableau.start[k] * trial.e[k, i] / h
            a += tableau.start[k] * trial.dv[k, i] / h
        work.inertia[0, i], work.inertia[1, i] = -v, -a
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
    clear(work.closing)
    clear(work.closing_pair)
    for k in range(method.velocity_rows.shape[0]):
        e = method.velocity_rows[k]
        if real:
            work.closing[PHI_RATE, e] = work.rates[0, 1, e] + work.rates[1, 1, e] * h / tableau.values[0]
            work.closing[PHI, e] = work.closing[PHI_RATE, e] * h / tableau.values[0]
        else:
            work.closing_pair[PHI_RATE, e] = work.rates[0, 1, e] + work.rates[1, 1, e] / c
            work.closing_pair[PHI, e] = work.closing_pair[PHI_RATE, e] / c
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
    """Write the state at the step's end to the workspace, with a and lam of the equations of motion, or of the last stage if these are singular."""
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
    """Make the step's end the start of the next step."""
    store_prediction_error(memory, trial, work)
    k = trial.e.shape[0] - 1
    for i in range(work.q.shape[0]):
        memory.q[i], memory.v[i], memory.a[i] = work.q[i], work.v[i], trial.a[k, i]
    put(1.0, trial.lam[k], memory.lam)
    copy_matrix(trial.dv, memory.stages_v)
    copy_matrix(trial.lam, memory.stages_lam)
    copy_matrix(work.rows[:, k], memory.phi_start)
    memory.marks[LAST], memory.marks[ERROR] = h, error
