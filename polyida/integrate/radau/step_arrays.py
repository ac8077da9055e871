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
    """Options, tolerances and other numbers of the method."""

    tied: bool  # there is mu
    by_increments: bool  # phi is updated by increments
    moves_v: bool  # v at the end of the step is projected onto phi' = 0
    estimates_error: bool  # the local error is computed
    has_guess: bool  # the trial stages hold initial values
    max_iterations: int  # of Newton's method
    low: float  # s: limits of the model's times, low and high
    high: float
    renewal: float  # iterations that cost as much as a new factor: one is made if its excess iterations exceed this
    extent: float  # size of the model, m
    least: float  # round-off of q = 0
    tolerance: float  # of Newton's method; 0: by share
    share: float  # of atol + rtol |q| that Newton may leave; 0: by the error of the step before and the length
    rtol: float  # of the local error of q
    atol: float  # of the same
    length: float  # of the model
    velocity_rows: np.ndarray  # their numbers among the rows


@pack
class CompiledTableau(NamedTuple):
    """A Tableau for compiled code, with s stages."""

    c: np.ndarray  # (s,) nodes
    A: np.ndarray  # (s, s)
    W: np.ndarray  # (s, s) A^-1
    start: np.ndarray  # (s,) of Tableau
    real_row: np.ndarray  # (s,) of the real mode, or (0,) without one
    real_column: np.ndarray  # (s,) or (0,)
    pair_row: np.ndarray  # (s,) complex, of the complex mode
    pair_column: np.ndarray  # (s,) complex
    values: np.ndarray  # (3,) eigenvalue of the real mode, real and imaginary part of that of the complex one


@pack
class Memory(NamedTuple):
    """Quantities that a step takes from the step before, of s stages. Marks:

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

    q: np.ndarray  # (n,) q, v and a of the last stage, a = v'
    v: np.ndarray
    a: np.ndarray
    shares: np.ndarray  # (n,) of the coordinates in the mass
    places: np.ndarray  # (n,) in |q|: shares without the integrals of states
    lam: np.ndarray  # (m,) of the last stage
    stages_v: np.ndarray  # (s, n) of the last step
    stages_lam: np.ndarray  # (s, m)
    miss_e: np.ndarray  # (TERMS, s, n) prediction errors of the last equal steps, newest first: e minus its extrapolation
    miss_lam: np.ndarray  # (TERMS, s, m) the same of lam
    mu: np.ndarray  # (TERMS, s, m) the same of mu, which is extrapolated as zero
    phi_start: np.ndarray  # (2, m) phi and phi' at the start of the step, for increments
    marks: np.ndarray  # (MARKS,)


@pack
class Trial(NamedTuple):
    """Unknowns of Newton's method at the s stages."""

    e: np.ndarray  # (s, n) q - q_0 - c h v_0
    dv: np.ndarray  # (s, n) v - v_0
    a: np.ndarray  # (s, n) v'
    lam: np.ndarray  # (s, m)
    mu: np.ndarray  # (s, m), or (s, 0) without mu
    start_e: np.ndarray  # (s, n) e extrapolated from the last step
    start_lam: np.ndarray  # (s, m) lam extrapolated


@pack
class Scratch(NamedTuple):
    """Workspace of the compiled driver for one step."""

    times: np.ndarray  # (s + 6,) h, t, times of the instants and the argument of SELECT
    q: np.ndarray  # (n,) q, v, a and lam of one state
    v: np.ndarray
    a: np.ndarray
    lam: np.ndarray  # (m,)
    spare: np.ndarray  # (m,)
    inertia: np.ndarray  # (4, n)
    r: np.ndarray  # (s, n) residuals, then corrections
    rows: np.ndarray  # (2, s, m) phi and phi'
    psi: np.ndarray  # (s, m) phi' for v = q'
    rates: np.ndarray  # (2, 2, m)
    weights: np.ndarray  # (2, s, s)
    progress: np.ndarray  # (3,) MOVED, SPEED, EXTENDED
    right: np.ndarray  # (n,) right-hand side of the real mode
    dq: np.ndarray  # (n,) its solution
    closing: np.ndarray  # (2, m) its rows
    multipliers: np.ndarray  # (2, m) its multipliers
    right_pair: np.ndarray  # complex: the same of the complex mode
    dq_pair: np.ndarray
    closing_pair: np.ndarray
    multipliers_pair: np.ndarray


@pack
class Arrays(NamedTuple):
    """All that the steps of a run read and write."""

    tableau: CompiledTableau
    memory: Memory
    trial: Trial
    work: Scratch  # workspace
    slots: tuple  # FactorSlots of loop.py
    counts: np.ndarray  # (COUNTS,) what the steps cost


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
