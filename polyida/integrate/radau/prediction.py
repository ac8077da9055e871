"""The initial stages of a step of Radau IIA: the polynomial of the last step extrapolated, plus the prediction error that is expected.

Steps of equal length repeat nearly the same prediction error. The errors of the last TERMS steps are kept, newest first. Each new error is
fitted by those before it, in the least-squares sense, and the weights that would have predicted best predict the next one.

With x_o the prediction error o steps ago, x that of this step, <., .> weighted by `shares`, and w_o the weights of the last `count` errors that
were known before this step, each step updates for count = 1 to TERMS

    EXCESS[count] = FORGET EXCESS[count] + |x - sum_o w_o x_o|^2 - |x|^2

which is below 0 if `count` errors predict better than none. New weights w minimise |x - sum_o w_o x_o|^2 (`fit`). The next prediction takes those
of the count with the least EXCESS below 0, or none.
"""

import numpy as np

from polyida.integrate.radau.step_arrays import EXCESS, EXTENDED, FITS, LAST, MISSES, TERMS, WEIGHTS
from polyida.jit import fast, part
from polyida.linear.dense import clear, copy_matrix, put

SAME_STEP = 1e-9  # of h: steps that differ by less have the same length
MAX_EXTRAPOLATION = 4.0  # steps over the last one: longer steps start from q_0 + c h v_0, not from its polynomial
FORGET = 0.7  # share of EXCESS that a step keeps
LARGEST_WEIGHT = 4.0  # of a prediction error, above the 3 of the extrapolation by differences
PARALLEL = 1e-9  # squared sine of the angle below which prediction errors are parallel


@part
def weighted_sum(weights, values, out):
    """Overwrite out (s, k) with the matrix product of weights (s, s) and values (s, k)."""
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

    `ahead` (s, s) has the Lagrange polynomials through the nodes of the last step at 1 + c_k h/last, column j that of node j: first those of lam,
    then, with a zero at the step's begin, those of v, minus the last row, for its change from the end. `to_e` = h A ahead integrates it.
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
    """Store the prediction error of the step, and the weights of the errors in the next one: of 1 to TERMS errors, as many as predicted best.

    1. start_e becomes the error; products (TERMS, TERMS + 1): <x_o, x_j>, and <x_o, x> in column `known`. 2. EXCESS by the old weights. 3. New
    weights by `fit`, and those of the best count. 4. The error becomes the newest one that is kept. o, j: numbers of errors, k: of stages.
    """
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
    """Least-squares weights of the last 1, 2, ... TERMS errors: fits[TERMS count + o] solve `sum_j <x_o, x_j> w_j = <x_o, x>`.

    Where weights are above LARGEST_WEIGHT or not determined, those of fewer errors are taken.

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
