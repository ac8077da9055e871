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

v follows q and mu, dv = c dq + G^T dmu; B, H and G are those of the middle stage.

A velocity row psi is a row with phi = 0, phi' = psi and B = W. Its equation in place of phi is `psi(t, q, q') = 0`, so that mu keeps the
form of the others: r3 is psi(t, q, q')/c.
"""

from typing import NamedTuple

import numpy as np

from polyida.errors import DONE, NOT_FINITE, REFACTOR, SINGULAR
from polyida.integrate.sizes import ROUND_OFF
from polyida.jit import fast, pack, part
from polyida.jit.intrinsics import address, call
from polyida.linear.dense import clear, copy_matrix, put
from polyida.system import ACCELERATION, ACCEPT, BEGIN, CONSTRAINTS, INERTIA, PAIR, PROJECT, RATE, REACTION, REAL, RESIDUAL, ROWS, TURN

STALLED = 0.9  # contraction above which corrections below ROUND times the size are round-off
ROUND = 1e-11
MAX_AGE = 10.0  # steps for which a measured contraction is used in the first iteration
UNKNOWN = np.array([1.0, MAX_AGE])  # CONTRACTION and AGE without a measured contraction
SAME_STEP = 1e-9  # of h: steps that differ by less have the same length
MAX_EXTRAPOLATION = 4.0  # steps over the last one: longer steps start from q_0 + c h v_0, not from its polynomial
NOISE = 1e-15  # of the size: smaller later corrections are round-off of phi if this is computed from positions
MAX_PROJECTIONS = 3  # of q onto phi = 0
AGAIN = 1e-9  # of the model's size: if |phi| was larger, the rows are computed again at the projected q
Q, V, A, SHARES, PLACES = range(5)  # rows of Memory.past; PLACES: shares in |q|, without the integrals of states
CONTRACTION, AGE, LAST, ERROR, MISSES = range(5)  # of Memory.marks; the weights in use, FITS and EXCESS follow
TERMS = 3  # prediction errors from which the next one is extrapolated
FITS = MISSES + 1 + TERMS
EXCESS = FITS + TERMS**2
MARKS = EXCESS + TERMS
FORGET = 0.7  # share of EXCESS that a step keeps
LARGEST_WEIGHT = 4.0  # of a prediction error, above the 3 of the extrapolation by differences
PARALLEL = 1e-9  # squared sine of the angle below which prediction errors are parallel
MOVED, SPEED, EXTENDED = range(3)  # of Scratch.seen
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

    past (5, n): q, v, v' of the last stage, shares of the coordinates in the mass and in |q|. lam (m,): of the last stage. stages_v (s, n), stages_lam
    (s, m): of the last step. miss_e (TERMS, s, n), miss_lam, mu (TERMS, s, m): prediction errors of the last equal steps, newest first: e and lam
    of a step minus the extrapolation from the step before, and its mu, which is extrapolated as zero. phi_start (2, m): phi and phi' at the
    start of the step, for increments. marks: CONTRACTION of Newton's method and its AGE in steps, so that a step may end after one iteration;
    LAST, length of the step before, s, 0 if unknown; ERROR of that step, -1 if unknown; MISSES, number of known prediction errors, and the
    weight of each in the expected next one; FITS, weights that were fitted for 1 to TERMS errors; EXCESS, the squared distance that a
    prediction with each had from recent steps, minus that without.
    """

    past: np.ndarray
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
    memory = Memory(*map(np.zeros, ((5, n), (m,), each, closing, *misses, (2, m), (MARKS,))))
    trial = Trial(*map(np.zeros, (each, each, each, closing, tie, each, closing)))
    shapes = (stages + 6,), (n,), (n,), (n,), (m,), (m,), (4, n), each, (2, stages, m), closing, (2, 2, m), (2, stages, stages), (3,)
    modal = (n,), (n,), (2, m), (2, m)
    return memory, trial, Scratch(*map(np.zeros, (*shapes, *modal)), *(np.zeros(shape, complex) for shape in modal))


@fast
def mean_square(shares, x):
    """Sum of shares x^2."""
    total = 0.0
    for i in range(x.shape[0]):
        total += shares[i] * x[i] * x[i]
    return total


@part
def largest(x):
    """max |x|."""
    size = 0.0
    for i in range(x.shape[0]):
        size = max(size, abs(x[i]))
    return size


@part
def stage_rates(W, h, x, rates):
    """rates = W x / h, (s, n) each."""
    for k in range(x.shape[0]):
        row, first, weight = rates[k], x[0], W[k, 0] / h
        for i in range(row.shape[0]):
            row[i] = weight * first[i]
        for j in range(1, x.shape[0]):
            other, weight = x[j], W[k, j] / h
            for i in range(row.shape[0]):
                row[i] += weight * other[i]


@part
def weighted_sum(weights, x, out):
    """out = weights x, (s, k) each."""
    for k in range(x.shape[0]):
        for i in range(x.shape[1]):
            out[k, i] = weights[k, 0] * x[0, i]
        for j in range(1, x.shape[0]):
            for i in range(x.shape[1]):
                out[k, i] += weights[k, j] * x[j, i]


@part
def predict(t, h, y, x, z):
    """Set initial stages: the extrapolated polynomial of the last step through the new state, plus the expected prediction error.

    v is extrapolated and integrated, which is more accurate than the polynomial of q. At the start of a run, and after much shorter steps,
    q = q_0 + c h v_0.
    """
    stages, last, ahead, to_e = x.e.shape[0], y.marks[LAST], z.weights[0], z.weights[1]
    clear(x.mu)
    z.progress[EXTENDED] = 0.0
    if last == 0.0 or h > MAX_EXTRAPOLATION * last:
        clear(x.e)
        for k in range(stages):
            put(1.0, y.lam, x.lam[k])
        return
    for k in range(stages):
        at = 1.0 + t.c[k] * (h / last)
        for j in range(stages):
            ahead[k, j] = 1.0
            for o in range(stages):
                if o != j:
                    ahead[k, j] *= (at - t.c[o]) / (t.c[j] - t.c[o])
    weighted_sum(ahead, y.stages_lam, x.lam)
    for k in range(stages):
        at = 1.0 + t.c[k] * (h / last)
        for j in range(stages):
            ahead[k, j] *= at / t.c[j]
        ahead[k, stages - 1] -= 1.0
    for k in range(stages):
        for j in range(stages):
            to_e[k, j] = 0.0
            for o in range(stages):
                to_e[k, j] += h * t.A[k, o] * ahead[o, j]
    weighted_sum(to_e, y.stages_v, x.e)
    if abs(h - last) <= SAME_STEP * h:
        add_prediction_error(y, x, z)


@part
def add_prediction_error(y, x, z):
    """Store the extrapolated stages in start_e and start_lam, and add the expected prediction error for a step of the same length."""
    z.progress[EXTENDED] = 1.0
    copy_matrix(x.e, x.start_e)
    copy_matrix(x.lam, x.start_lam)
    for o in range(TERMS):
        weight = y.marks[MISSES + 1 + o]
        for k in range(x.e.shape[0] if weight != 0.0 else 0):
            for i in range(x.e.shape[1]):
                x.e[k, i] += weight * y.miss_e[o, k, i]
            for e in range(x.lam.shape[1]):
                x.lam[k, e] += weight * y.miss_lam[o, k, e]
            for e in range(x.mu.shape[1]):
                x.mu[k, e] += weight * y.mu[o, k, e]


@fast
def store_prediction_error(y, x, z):
    """Store the prediction error of the step, and the weights of the errors in the next one: of 1 to TERMS errors, as many as predicted best."""
    known, weights, fits, excess = int(y.marks[MISSES]), y.marks[MISSES + 1 : FITS], y.marks[FITS:EXCESS], y.marks[EXCESS:]
    if z.progress[EXTENDED] == 0.0:
        y.marks[MISSES:] = 0.0
        return
    products = np.zeros((TERMS, TERMS + 1))
    for k in range(x.e.shape[0]):
        for i in range(x.e.shape[1]):
            x.start_e[k, i] = x.e[k, i] - x.start_e[k, i]
        for o in range(known):
            for j in range(o, known + 1):
                other, total = y.miss_e[j, k] if j < known else x.start_e[k], 0.0
                for i in range(x.e.shape[1]):
                    total += y.past[SHARES, i] * y.miss_e[o, k, i] * other[i]
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
    for k in range(x.e.shape[0]):
        put_first(y.miss_e[:, k], x.start_e[k])
        for e in range(x.lam.shape[1]):
            x.start_lam[k, e] = x.lam[k, e] - x.start_lam[k, e]
        put_first(y.miss_lam[:, k], x.start_lam[k])
        put_first(y.mu[:, k], x.mu[k])
    y.marks[MISSES] = min(known + 1.0, TERMS)


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
def stage_state(t, h, y, x, z, k):
    """Write q and v of stage k to z."""
    c, past = t.c[k] * h, y.past
    for i in range(z.q.shape[0]):
        z.q[i] = past[Q, i] + (c * past[V, i] + x.e[k, i])
        z.v[i] = past[V, i] + x.dv[k, i]


@part
def stage_velocities(f, w, first, p, t, h, y, x, z):
    """v and v' of the stages from e and mu, and psi."""
    stage_rates(t.W, h, x.e, x.dv)
    for k in range(x.e.shape[0] if p.velocity_rows.shape[0] else 0):
        stage_state(t, h, y, x, z, k)
        if p.by_increments:
            ended = phi_by_increments(f, w, first, y, x, z, k)
        else:
            ended = call(f[RATE], w, first + 1 + k, address(z.q), address(z.v), address(z.rows[PHI_RATE, k]), 0, 0, 0)
        if ended != DONE:
            return ended
        put(1.0, z.rows[PHI_RATE, k], z.psi[k])
    if x.mu.shape[1]:
        for k in range(x.e.shape[0]):
            stage_state(t, h, y, x, z, k)
            ended = call(f[REACTION], w, first + 1 + k, address(z.q), address(x.mu[k]), address(x.dv[k]), 0, 0, 0)
            if ended != DONE:
                return ended
    stage_rates(t.W, h, x.dv, x.a)
    return DONE


@part
def phi_by_increments(f, w, first, y, x, z, k):
    """phi and phi' of stage k by increments from the start of the step; z.q is q of the stage."""
    phi, rate = z.rows[PHI, k], z.rows[PHI_RATE, k]
    put(1.0, y.phi_start[PHI], phi)
    put(1.0, y.phi_start[PHI_RATE], rate)
    return call(f[CONSTRAINTS], w, first + 1 + k, address(z.q), address(x.e[k]), address(x.dv[k]), address(phi), address(rate), 0)


@part
def residuals(f, w, first, p, t, h, y, x, z):
    """r, phi and phi' of all stages."""
    ended = stage_velocities(f, w, first, p, t, h, y, x, z)
    for k in range(x.e.shape[0]):
        if ended != DONE:
            return ended
        stage_state(t, h, y, x, z, k)
        state = address(z.q), address(z.v), address(x.a[k]), address(x.lam[k])
        ended = call(f[RESIDUAL], w, first + 1 + k, state[0], state[1], state[2], state[3], address(z.r[k]), address(z.rows[PHI, k]))
        if ended == DONE and p.by_increments:
            ended = phi_by_increments(f, w, first, y, x, z, k)
        elif ended == DONE and p.tied:
            ended = call(f[RATE], w, first + 1 + k, state[0], state[1], address(z.rows[PHI_RATE, k]), 1, 0, 0)
        for i in range(p.velocity_rows.shape[0]):
            z.rows[PHI, k, p.velocity_rows[i]] = z.psi[k, p.velocity_rows[i]]
    return ended


@fast
def into_modes(p, t, h, z):
    """Transform the residuals of the stages to the modes. Velocity rows are divided by c."""
    stages, real = z.r.shape[0], t.real_row.shape[0] > 0
    for i in range(z.right.shape[0]):
        one, pair = 0.0, 0.0j
        for k in range(stages):
            if real:
                one += t.real_row[k] * z.r[k, i]
            pair += t.pair_row[k] * z.r[k, i]
        z.right[i], z.right_pair[i] = one, pair
    for g in range(2):
        for e in range(z.closing.shape[1]):
            one, pair = 0.0, 0.0j
            for k in range(stages):
                if real:
                    one += t.real_row[k] * z.rows[g, k, e]
                pair += t.pair_row[k] * z.rows[g, k, e]
            z.closing[g, e], z.closing_pair[g, e] = one, pair
    for i in range(p.velocity_rows.shape[0]):
        e = p.velocity_rows[i]
        z.closing_pair[PHI, e] *= h / complex(t.values[1], t.values[2])
        if real:
            z.closing[PHI, e] *= h / t.values[0]


@fast
def from_modes(t, z):
    """Transform the corrections of the modes to the stages, in z.r."""
    for k in range(z.r.shape[0]):
        real, pair = t.real_column[k] if t.real_row.shape[0] else 0.0, 2.0 * t.pair_column[k]
        for i in range(z.r.shape[1]):
            z.r[k, i] = real * z.dq[i] + (pair * z.dq_pair[i]).real


@part
def add_multipliers(t, z, g, lam):
    """Add the modes' multipliers g (0: lam, 1: mu) to those of the stages."""
    for k in range(lam.shape[0]):
        for e in range(lam.shape[1]):
            lam[k, e] += 2.0 * (t.pair_column[k] * z.multipliers_pair[g, e]).real
            if t.real_row.shape[0]:
                lam[k, e] += t.real_column[k] * z.multipliers[g, e]


@part
def solve_real(f, w, middle, lam, z):
    """Correction of the real mode. Returns a status."""
    return call(f[REAL], w, middle, address(z.right), address(z.closing), address(lam), address(z.dq), address(z.multipliers), 0)


@part
def solve_pair(f, w, middle, lam, z):
    """Correction of the complex mode. Returns a status."""
    arguments = address(z.right_pair), address(z.closing_pair), address(lam), address(z.dq_pair), address(z.multipliers_pair)
    return call(f[PAIR], w, middle, arguments[0], arguments[1], arguments[2], arguments[3], arguments[4], 0)


@part
def iterate(f, w, first, p, t, h, y, x, z):
    """One Newton iteration: (status, norm of dq and h dv: root mean square over stages, weighted by mass)."""
    ended = residuals(f, w, first, p, t, h, y, x, z)
    if ended != DONE:
        return ended, 0.0
    stages, n = x.e.shape
    middle, lam = first + 1 + stages // 2, x.lam[stages // 2]
    if f[TURN]:
        call(f[TURN], w, first, address(z.r), 0, 0, 0, 0, 0)
    into_modes(p, t, h, z)
    if t.real_row.shape[0]:
        ended = solve_real(f, w, middle, lam, z)
    if ended == DONE:
        ended = solve_pair(f, w, middle, lam, z)
    if ended != DONE:
        return ended, 0.0
    from_modes(t, z)
    if f[TURN]:
        call(f[TURN], w, first, address(z.r), 1, 0, 0, 0, 0)
    stage_rates(t.W, 1.0, z.r, x.dv)
    total = 0.0
    for k in range(stages):
        for i in range(n):
            x.e[k, i] += z.r[k, i]
        total += mean_square(y.past[SHARES], z.r[k]) + mean_square(y.past[SHARES], x.dv[k])
    add_multipliers(t, z, 0, x.lam)
    add_multipliers(t, z, 1, x.mu)
    return DONE, np.sqrt(total / stages)


@part
def newton(f, w, first, p, t, h, y, x, z, allowed, counts):
    """Newton's method until the estimated error of q is at most `allowed`: (status, iterations). The stages are in x."""
    size = np.sqrt(mean_square(y.past[SHARES], y.past[Q])) + h * np.sqrt(mean_square(y.past[SHARES], y.past[V]))
    contraction = min(2.0 * y.marks[CONTRACTION], 1.0) if y.marks[AGE] < MAX_AGE else 1.0
    last, worst, round_off = np.inf, 0.0, max(ROUND * size, p.least)
    noise = 0.0 if p.by_increments else NOISE * size
    for iteration in range(1, p.max_iterations + 1):
        counts[RESIDUALS] += x.e.shape[0]
        counts[ITERATIONS] += 1
        counts[SOLVES] += 1 + (t.real_row.shape[0] > 0)
        ended, moved = iterate(f, w, first, p, t, h, y, x, z)
        if ended != DONE or not np.isfinite(moved):
            return (NOT_FINITE if ended == DONE else ended), iteration
        if iteration > 1:
            contraction = moved / last
            worst = max(worst, contraction) if moved > noise or worst == 0.0 else worst
        z.progress[MOVED], z.progress[SPEED] = moved, contraction
        left = contraction / (1.0 - contraction) * moved if contraction < 1.0 else np.inf
        spent, stalled = iteration == p.max_iterations, iteration > 1 and contraction > STALLED
        rounded = iteration > 1 and moved <= noise
        if left <= allowed or moved == 0.0 or rounded or (moved <= round_off and (stalled or spent)):
            if iteration > 1:
                y.marks[CONTRACTION], y.marks[AGE] = worst, 0.0
            else:
                y.marks[AGE] += 1.0
            return DONE, iteration
        if iteration > 1 and contraction ** (p.max_iterations - iteration) * left > max(allowed, round_off):
            break
        last = moved
    return REFACTOR, iteration


@part
def solve_stages(f, w, first, p, t, h, y, x, z, allowed, counts):
    """Solve the stages of a step from y: (status, iterations)."""
    ended = call(f[BEGIN], w, first, address(y.past[Q]), address(y.past[V]), address(z.times), 0, 0, 0)
    if ended != DONE:
        return ended, 0
    if not p.has_guess:
        predict(t, h, y, x, z)
    stage_rates(t.W, h, x.e, x.dv)
    k = x.e.shape[0] // 2
    stage_state(t, h, y, x, z, k)
    ended = call(f[ROWS], w, first + 1 + k, address(z.q), address(z.v), 0, 0, 0, 0)
    if ended != DONE:
        return ended, 0
    return newton(f, w, first, p, t, h, y, x, z, allowed, counts)


@part
def project_end(f, w, first, p, t, h, y, x, z):
    """Update v and v' after the last correction, and project q and v of the step's end onto phi = 0 and phi' = 0 in the metric of M."""
    ended = stage_velocities(f, w, first, p, t, h, y, x, z)
    if not x.lam.shape[1] or ended != DONE:
        return ended
    k = x.e.shape[0] - 1
    size, at = p.extent + largest(y.past[Q]), first + 1 + k
    phi, rate, has_rows = z.rows[PHI, k], z.rows[PHI_RATE, k], False
    stage_state(t, h, y, x, z, k)
    ended = phi_by_increments(f, w, first, y, x, z, k)
    for _ in range(MAX_PROJECTIONS):
        worst = largest(phi)
        if ended != DONE or worst <= ROUND_OFF * size:
            break
        if not has_rows:
            ended = call(f[RATE], w, at, address(z.q), address(z.v), address(z.spare), 0, 0, 0)
        if ended == DONE:
            ended = call(f[PROJECT], w, at, address(phi), address(x.e[k]), 0, 0, 0, 0)
        if ended != DONE:
            break
        stage_state(t, h, y, x, z, k)
        has_rows = worst <= AGAIN * size
        ended = phi_by_increments(f, w, first, y, x, z, k)
    if ended != DONE or not p.moves_v:
        return ended
    if not (p.by_increments and has_rows):
        rates = z.spare if p.by_increments else rate
        ended = call(f[RATE], w, at, address(z.q), address(z.v), address(rates), 0, 0, 0)
    if ended == DONE and largest(rate) > 0.0:
        ended = call(f[PROJECT], w, at, address(rate), address(x.dv[k]), 0, 0, 0, 0)
        if ended == DONE and p.by_increments:
            ended = phi_by_increments(f, w, first, y, x, z, k)
    return ended


@part
def local_error(f, w, first, p, t, h, y, x, z, counts):
    """(status, local error of q at the step's end: the norm of its difference to a method of order s).

    It is the difference of v_0, and of v' at the end of the last step, to the stages' polynomial, filtered by a solve with the step matrix, so
    that unresolved stiff modes do not count. The solve removes what phi does not permit; psi permits an error along W, (v + v'/c)/c.
    """
    count, n = x.e.shape
    middle, lam, real = first + 1 + count // 2, x.lam[count // 2], t.real_row.shape[0] > 0
    for i in range(n):
        v, a = 0.0, y.past[A, i]
        for k in range(count):
            v += t.start[k] * x.e[k, i] / h
            a += t.start[k] * x.dv[k, i] / h
        z.inertia[0, i], z.inertia[1, i] = -v, -a
    work, q, rates = z.inertia, address(y.past[Q]), address(z.rates[0]) if p.velocity_rows.shape[0] else 0
    ended = call(f[INERTIA], w, middle, address(work[0]), address(work[1]), address(work[2]), address(work[3]), q, rates)
    if ended == DONE and p.velocity_rows.shape[0]:
        ended = call(f[INERTIA], w, middle, address(work[1]), address(work[1]), address(z.a), 0, q, address(z.rates[1]))
    if ended != DONE:
        return ended, 0.0
    counts[SOLVES] += 1
    total, c = 0.0, complex(t.values[1], t.values[2]) / h
    for i in range(n):
        if real:
            z.right[i] = work[2, i] + t.values[0] / h * work[3, i]
        else:
            z.right_pair[i] = work[2, i] + c * work[3, i]
    clear(z.closing)
    clear(z.closing_pair)
    for k in range(p.velocity_rows.shape[0]):
        e = p.velocity_rows[k]
        if real:
            z.closing[PHI_RATE, e] = z.rates[0, 1, e] + z.rates[1, 1, e] * h / t.values[0]
            z.closing[PHI, e] = z.closing[PHI_RATE, e] * h / t.values[0]
        else:
            z.closing_pair[PHI_RATE, e] = z.rates[0, 1, e] + z.rates[1, 1, e] / c
            z.closing_pair[PHI, e] = z.closing_pair[PHI_RATE, e] / c
    ended = solve_real(f, w, middle, lam, z) if real else solve_pair(f, w, middle, lam, z)
    for i in range(n):
        dq = z.dq[i] if real else z.dq_pair[i].real
        total += y.past[SHARES, i] * dq * dq
    return ended, np.sqrt(total)


@part
def end_state(f, w, first, h, y, x, z):
    """The state at the step's end in z, with a and lam of the equations of motion, or of the last stage if these are singular."""
    k, n = x.e.shape[0] - 1, x.e.shape[1]
    total = 0.0
    for i in range(n):
        z.q[i], z.v[i], z.a[i] = y.past[Q, i] + (h * y.past[V, i] + x.e[k, i]), y.past[V, i] + x.dv[k, i], x.a[k, i]
        total += z.q[i] * z.v[i]
    put(1.0, x.lam[k], z.lam)
    if not np.isfinite(total):
        return NOT_FINITE
    if f[ACCEPT]:
        ended = call(f[ACCEPT], w, first + 1 + k, address(z.q), 0, 0, 0, 0, 0)
        if ended != DONE:
            return ended
    if f[ACCELERATION]:
        ended = call(f[ACCELERATION], w, first + 1 + k, address(z.q), address(z.v), address(z.a), address(z.lam), 0, 0)
        if ended != DONE and ended != SINGULAR:
            return ended
        for i in range(n):
            total += z.a[i] * 0.0
        for e in range(z.lam.shape[0]):
            total += z.lam[e] * 0.0
    return DONE if np.isfinite(total) else NOT_FINITE


@part
def advance(h, error, y, x, z):
    """Make the step's end the start of the next step."""
    store_prediction_error(y, x, z)
    k = x.e.shape[0] - 1
    for i in range(z.q.shape[0]):
        y.past[Q, i], y.past[V, i], y.past[A, i] = z.q[i], z.v[i], x.a[k, i]
    put(1.0, x.lam[k], y.lam)
    copy_matrix(x.dv, y.stages_v)
    copy_matrix(x.lam, y.stages_lam)
    copy_matrix(z.rows[:, k], y.phi_start)
    y.marks[LAST], y.marks[ERROR] = h, error
