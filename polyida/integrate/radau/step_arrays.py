"""The arrays of a step of Radau IIA in compiled code: numbers of the method, unknowns of the stages, what steps remember, and workspace."""

from typing import NamedTuple

import numpy as np

from polyida.jit import pack

MAX_AGE = 10.0  # steps for which a measured contraction is used in the first iteration
UNKNOWN = np.array([1.0, MAX_AGE])  # CONTRACTION and AGE without a measured contraction
TERMS = 3  # prediction errors from which the next one is extrapolated
CONTRACTION, AGE, LAST, ERROR, MISSES = range(5)  # of Memory.marks; WEIGHTS, FITS and EXCESS follow
WEIGHTS = MISSES + 1
FITS = WEIGHTS + TERMS
EXCESS = FITS + TERMS**2
MARKS = EXCESS + TERMS
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
