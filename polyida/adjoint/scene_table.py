"""The adjoint of a step of a scene with s stages: one stale co-rotated factor for each mode, refined with the exact products (products.py).

The step's system is, with B, C, H, K and M of each stage (system/table.py, radau_sweep.py; generalized-alpha has one stage),

    K_i^T w_i + B_i^T mu_i + sum_j to_v_ij (C_j^T w_j + B_j^T kappa_j) + to_a_ij M w_j + H_i^T kappa_i + (B_i^T mu_i)_q^T v*_i = right_i
    B_i w_i = below_i,    B_i v*_i = 0,    v*_i = C_i^T w_i + B_i^T kappa_i + sum_j to_v_ij M w_j + [bar]

and the terms of kappa and mu_i are there where the step has mu. With `to_v = sum c row column^T`, to_a = to_v^2, it falls into one system for each
eigenvalue c, of K, M and C as old as the factor, in the frames of the nodes, each stage turned from its own to the middle one's, and B of the
middle stage; as in the steps (assembly/rate_multipliers.py) H is left to the refinement:

    | S                   B^T   c B^T |  |w    |     S = K + c C + c^2 M
    | B                               |  |mu   |
    | B (c M + C)^T             B B^T |  |kappa|     the last row and column where there is mu in the step

so that w and mu + c kappa follow from the first two rows, and kappa from the last one.

Several objectives are columns of the right-hand side. Columns that have converged are left out of further corrections.
"""

from contextlib import contextmanager, nullcontext
from copy import copy
from typing import Any, NamedTuple

import numpy as np
from numba import carray, typeof

from polyida.adjoint import products
from polyida.adjoint.products import DZ, VZ, Scratch, arrays_of, scratch, viscosity_of
from polyida.adjoint.relaxation import eliminate_transposed, recover_transposed
from polyida.adjoint.run import AdjointTable
from polyida.assembly import corotated, joints
from polyida.assembly.increments import drive_table
from polyida.assembly.own_laws import Laws
from polyida.assembly.rate_multipliers import RateMultipliers, factor_rates, rate_multipliers, rate_values, solve_rates
from polyida.environment import threads
from polyida.errors import DONE, REFACTOR, SINGULAR
from polyida.jit import entry, fast, pack, part
from polyida.jit.intrinsics import COLUMNS, pointer
from polyida.linear.dense import clear, magnitude, put
from polyida.linear.lu import FactorCache
from polyida.linear.team import Helpers
from polyida.system import ADJOINT, ENTRIES
from polyida.system import scene as forward

# constants of compiled code
SOLVES, SLOWEST, STEPS, WORK, LATELY = range(5)  # of SceneAdjointWork.marks
CONTRACTION, MEASURED, MOVED = range(3)  # of SceneAdjointWork.rates
LARGEST, UNCONSTRAINED = range(2)  # of SceneAdjointWork.sizes
MU, KAPPA = range(2)  # of multipliers and of rows
FRESHEN = 30  # steps after which the contraction is measured again
RENEWAL = 36.0  # solves, with their products, that a new factor must save: it takes the time of 12 at 1e3 coordinates, of 19 at 1e4
SMOOTHING = 0.125  # weight of the last step in LATELY
ROUND_OFF = 1e-9  # of |w|: below it a correction need not fall any more
NEGLIGIBLE = 1e-14  # of what w would be without constraints: below it corrections of a w that these hold to zero are nothing
LEAST = 1e-280  # a residual below that is taken as that large: single precision, in which the factor solves, ends at 1e-38
EXACT = 1e-11  # of |w|: refinement leaves no less
OF_MU = 100.0  # accepted relative error of mu over that of w: mu has the error of w times M / h^2
MAX_CORRECTIONS = 60  # corrections of a step with one factor
UNDAMPED = np.zeros((0, 2, 2))  # C A^T without damping or mu
OLD, FRESH = 0.5, 0.8  # contraction above which a factor is made anew, and above which one that was made for the step does not serve


@pack
class Mode(NamedTuple):
    """A mode: c = (c_m, c_v) of its S, row and column (s,), its factor, C A^T (see RateMultipliers), and scratch for columns: r, dw (columns, nodes, 2), rows, multipliers
    (columns, 1 or 2, m), sizes (columns,).

    lanes (n, COLUMNS): right-hand sides that are solved for together; None if the factor is complex.
    """

    c: np.ndarray
    row: np.ndarray
    column: np.ndarray
    factored: corotated.Corotated
    workspace: corotated.SolveWorkspace
    slowing: np.ndarray
    r: np.ndarray
    dw: np.ndarray
    rows: np.ndarray
    multipliers: np.ndarray
    sizes: np.ndarray
    lanes: np.ndarray | None


@pack
class MuTerms(NamedTuple):
    """Arrays of steps with mu: mu (count, s, m), blocks of (B^T mu)_q on the coupled points (s, ., 2, 2), slopes of the rates of the rows (s, .),
    v* (s, nodes, 2), values and forces at points (2, points, 2), and the system of B B^T.
    """

    mu: np.ndarray
    curvature: np.ndarray
    rates: np.ndarray
    v: np.ndarray
    points: np.ndarray
    system: RateMultipliers


@pack
class SceneAdjointWork(NamedTuple):
    """The workspace of a scene.

    real, pair, tied: None if the step has none; the code for it is then not compiled. viscosity: of `viscosity_of`. drives (count, s, profiles, 3),
    q, v, lam (count, s, .): of the stages. enough: accepted error of w over |w|. first, second, third: products of the stages and w.
    slopes (s, .): phi_z; turn (s, nodes, 2): rotation from a stage to the middle one; r, dw (s, columns, nodes, 2), rows, change (1 or 2, s, columns, m):
    residuals, and corrections of w and of the multipliers. which (columns,): first the numbers of the columns that have not converged;
    small (columns,): True for those of them that have in this iteration; left (columns,): the numbers of the others. M w of a column that has
    converged is not needed with one stage.
    marks, rates (columns, 3) belong to a factor: SOLVES; SLOWEST, the largest accepted contraction; STEPS, WORK, number of steps and of solves with
    the factor; LATELY, mean number of solves in the last steps; CONTRACTION, MEASURED at that number of steps; MOVED, |dw| of the last correction.
    sizes (columns, 2): LARGEST, the largest |w| of a solve without constraints, UNCONSTRAINED, that of the last one.
    """

    scene: tuple
    viscosity: np.ndarray
    laws: Laws
    real: Mode | None
    pair: Mode | None
    tied: MuTerms | None
    drives: np.ndarray
    q: np.ndarray
    v: np.ndarray
    lam: np.ndarray
    to_v: np.ndarray
    to_a: np.ndarray
    enough: float
    first: Scratch
    second: Scratch
    third: Scratch
    slopes: np.ndarray
    turn: np.ndarray
    r: np.ndarray
    dw: np.ndarray
    rows: np.ndarray
    change: np.ndarray
    which: np.ndarray
    small: np.ndarray
    left: np.ndarray
    marks: np.ndarray
    rates: np.ndarray
    sizes: np.ndarray


@part
def stage(work, number):
    """The Scratch of the stage with this number."""
    x = work.first
    if number == 1:
        x = work.second
    if number == 2:
        x = work.third
    return x


@part
def pairs(work, vector):
    """A vector (n,) as (nodes, 2)."""
    return vector.reshape(work.r.shape[2:])


@part
def evaluate_mu_terms(work, terms, step, number):
    """Evaluate the terms of mu at a stage, unless the step has none (terms is None)."""
    if terms is not None:
        s, x, drives = work.scene.links, stage(work, number), work.drives[step, number]
        joints.point_values(s, pairs(work, work.v[step, number]), x.points[VZ])
        joints.joint_rate_jacobian(s, drives, x.points[DZ], x.points[VZ], terms.rates[number])
        terms.curvature[number] = 0.0
        joints.joint_curvature(s, drives, terms.mu[step, number], terms.curvature[number])


@part
def prepare_mode(work, mode, number):
    """The frames of a mode's factor, and its border, at a stage."""
    if mode is not None:
        s, c, workspace = work.scene.links, mode.factored, mode.workspace
        corotated.turn_frames(s, c, workspace, stage(work, number).rotation)
        corotated.points_matrix(s, c, workspace)
        fill(work, mode, number, workspace.border.slopes, workspace.border.curvature)
        workspace.keeps[0] = 0


@part
def prepare_rates(work, terms, step, number):
    """Factor B B^T at a stage of a step, unless the step has no mu (terms is None). False if it is singular."""
    if terms is None:
        return True
    return factor_rates(work.scene.links, terms.system, work.drives[step, number], stage(work, number).points[DZ])


@part
def fill(work, mode, number, slopes, curvature):
    """phi_z of a stage, and the transposed curvature on the points with the point masses."""
    mirror, x = work.scene.links.coupling.mirror, stage(work, number)
    put(1.0, work.slopes[number], slopes)
    for e in range(mirror.shape[0]):
        for j in range(2):
            for o in range(2):
                curvature[e, j, o] = x.curvature[mirror[e], o, j]
                if x.slack.shape[0]:
                    curvature[e, j, o] += mode.c[1] * x.slack[mirror[e], o, j]
    corotated.condense_states(work.scene.links.coupling, mode.factored, curvature)
    corotated.add_masses(work.scene.links, mode.c[0], curvature)


@part
def correct(work, mode, u, which):
    """Corrections of w and of the multipliers of a mode for the residuals of the columns in `which`. False if the border is singular. u: in the middle."""
    if mode is None:
        return True
    for c in which:
        mode.sizes[c] = collect(work.r, work.rows, mode, c)
        eliminate_transposed(work.scene, work.scene.relaxation, mode.workspace.elimination, u, mode.r[c])
    solve_columns(mode.factored, mode.workspace, mode.lanes, mode.sizes, mode.r, mode.dw, which)
    for c in which:
        recover_transposed(work.scene, work.scene.relaxation, mode.workspace.elimination, u, mode.r[c], mode.dw[c])
        work.sizes[c, UNCONSTRAINED] += size_of(mode.dw[c])
        if not solve_border(work, mode, work.tied, c):
            return False
        recover_transposed(work.scene, work.scene.relaxation, mode.workspace.elimination, u, mode.r[c], mode.dw[c])
    return True


@fast
def collect(residuals, rows, mode, column):
    """A mode's part of the residuals of a column, in mode.r and mode.rows. Returns the sum of the sizes. With one stage mode.r is `residuals`."""
    stages, r, own = residuals.shape[0], mode.r[column], mode.rows[column]
    if stages > 1:
        for a in range(r.shape[0]):
            for e in range(2):
                r[a, e] = 0.0
                for i in range(stages):
                    r[a, e] += mode.column[i] * residuals[i, column, a, e]
    for f in range(own.shape[0]):
        for e in range(own.shape[1]):
            own[f, e] = 0.0
            for i in range(stages):
                own[f, e] += mode.column[i] * rows[f, i, column, e]
    return max(LEAST, size_of(r))


@fast
def size_of(values):
    """The sum of the sizes of the values (nodes, 2)."""
    total = 0.0
    for a in range(values.shape[0]):
        total += magnitude(values[a, 0]) + magnitude(values[a, 1])
    return total


@part
def solve_columns(factored, workspace, lanes, sizes, r, dw, which):
    """dw[c] = S^-1 r[c] of the plates: several columns with one pass through the factor, unless it is complex (lanes is None)."""
    together = 0
    if lanes is not None:
        together = which.shape[0] if which.shape[0] > 1 else 0
        for first in range(0, together, COLUMNS):
            corotated.solve_turned_columns(factored, workspace, lanes, sizes, r, dw, which[first : min(first + COLUMNS, together)])
    for c in which[together:]:
        corotated.solve_turned(factored, workspace, sizes[c], r[c], dw[c])


@part
def solve_border(work, mode, tied, column):
    """The multipliers of a mode in a column, and the effect of their forces on dw. False if the border is singular."""
    s, factored, workspace, dw = work.scene.links, mode.factored, mode.workspace, mode.dw[column]
    if not workspace.spin.shape[0]:
        return True
    joints.point_values(s, dw, workspace.moved)
    if not corotated.solve_multipliers(s, factored, workspace, mode.rows[column, MU], mode.multipliers[column, MU]):
        return False
    workspace.keeps[0] = 1
    corotated.apply_point_forces(s, factored, workspace, dw)
    corotated.settle_states(s, factored, workspace.border.curvature, workspace.moved, dw)
    return solve_kappa(work, mode, tied, column)


@part
def solve_kappa(work, mode, terms, column):
    """kappa of a mode in a column, and mu without c kappa, unless the step has no mu (terms is None). False if the system is singular."""
    if terms is None:
        return True
    s, values, rows, multipliers = work.scene.links, mode.workspace.moved, mode.rows[column], mode.multipliers[column]
    rate_values(s, terms.system, mode.slowing, mode.workspace, mode.c[1], mode.dw[column], values)
    for e in range(rows.shape[1]):
        rows[KAPPA, e] = -rows[KAPPA, e] - joints.along(s, terms.system.workspace.slopes, e, values)
    good = solve_rates(terms.system, rows[KAPPA], multipliers[KAPPA])
    for e in range(rows.shape[1]):
        multipliers[MU, e] -= mode.c[1] * multipliers[KAPPA, e]
    return good


@part
def add_change(work, mode, twice, column):
    """Add the part of a mode to the corrections of the stages in a column. With one stage mode.dw is work.dw."""
    if mode is not None:
        for i in range(work.dw.shape[0]):
            share = twice * mode.row[i]
            for a in range(work.dw.shape[2] if work.dw.shape[0] > 1 else 0):
                for e in range(2):
                    work.dw[i, column, a, e] += (share * mode.dw[column, a, e]).real
            for f in range(work.change.shape[0]):
                for e in range(work.change.shape[3]):
                    work.change[f, i, column, e] += (share * mode.multipliers[column, f, e]).real


@part
def add_mu_terms(work, terms, multipliers, bar, column):
    """Add the terms of kappa and mu to the products of a column, and B v* to work.rows, unless the step has no mu (terms is None)."""
    if terms is None:
        return
    s, stages, values, forces = work.scene.links, work.r.shape[0], terms.points[0], terms.points[1]
    for i in range(stages):
        slowing = stage(work, i).slowing[column]
        clear(forces)
        joints.add_rows(s, work.slopes[i], multipliers[KAPPA, i, column], forces)
        joints.spread(s, forces, slowing)
        for a in range(slowing.shape[0]):
            for e in range(2):
                terms.v[i, a, e] = slowing[a, e] + (bar[column, a, e] if i == stages - 1 else 0.0)
    for i in range(stages):
        for j in range(stages):
            heavy = stage(work, j).heavy[column]
            for a in range(heavy.shape[0]):
                for e in range(2):
                    terms.v[i, a, e] += work.to_v[i, j] * heavy[a, e]
        joints.point_values(s, terms.v[i], values)
        products.pull_back(s.coupling, terms.curvature[i], values, forces)
        for k in range(work.rows.shape[3]):
            work.rows[KAPPA, i, column, k] = joints.along(s, work.slopes[i], k, values)
        joints.add_rows(s, terms.rates[i], multipliers[KAPPA, i, column], forces)
        joints.spread(s, forces, stage(work, i).stiff[column])


@part
def multiply(work, step, now, multipliers, bar, which, moving, anew):
    """Compute the products of w and the multipliers at the stages in the columns of `which`, M w only in those of `moving`.

    anew: True if the bodies' rotations must be computed.
    """
    for i in range(work.r.shape[0]):
        x, u, v = stage(work, i), pairs(work, work.q[step, i]), pairs(work, work.v[step, i])
        products.body_products(work.scene, work.viscosity, u, v, (which, moving), now[i], x.rotation if anew else x.rotation[:0], x)
        for c in which:
            products.point_products(work.scene.links, work.slopes[i], c, now[i, c], multipliers[MU, i, c], x)
            for e in range(work.rows.shape[3]):
                work.rows[MU, i, c, e] = x.rows[c, e]
    for c in which:
        add_mu_terms(work, work.tied, multipliers, bar, c)


@fast
def set_residuals(work, right, below, column):
    """rows = residuals of the equations in a column, and r (s, columns, nodes, 2) = minus the residuals, rotated to the middle stage."""
    stages = work.r.shape[0]
    for i in range(stages):
        stiff, own, r = stage(work, i).stiff[column], stage(work, i).heavy[column], work.r[i, column]
        for a in range(r.shape[0]):
            for e in range(2):
                r[a, e] = right[i, column, a, e] - stiff[a, e] - work.to_a[i, i] * own[a, e]
        for j in range(stages):
            heavy, slowing, to_v, to_a = stage(work, j).heavy[column], stage(work, j).slowing[column], work.to_v[i, j], work.to_a[i, j]
            for a in range(r.shape[0] if j != i else 0):
                for e in range(2):
                    r[a, e] -= to_a * heavy[a, e]
            for a in range(slowing.shape[0]):
                for e in range(2):
                    r[a, e] -= to_v * slowing[a, e]
        for e in range(below.shape[2]):
            work.rows[MU, i, column, e] -= below[i, column, e]
        if stages > 1:
            for a in range(r.shape[0]):
                co, n, p, q = work.turn[i, a, 0], work.turn[i, a, 1], r[a, 0], r[a, 1]
                r[a, 0], r[a, 1] = co * p - n * q, n * p + co * q


@fast
def add_correction(work, now, multipliers, column):
    """w += dw in a column, rotated back, and the multipliers. Returns the sums of |dw| and |w|, since squares may underflow, and of |dmu| and |mu|."""
    moved = size = mu_moved = mu_size = 0.0
    for i in range(now.shape[0]):
        dw, own = work.dw[i, column], now[i, column]
        for a in range(own.shape[0]):
            p, q = dw[a, 0], dw[a, 1]
            if now.shape[0] > 1:
                co, n = work.turn[i, a, 0], work.turn[i, a, 1]
                p, q = co * p + n * q, co * q - n * p
            own[a, 0] += p
            own[a, 1] += q
            moved += abs(p) + abs(q)
            size += abs(own[a, 0]) + abs(own[a, 1])
    for f in range(multipliers.shape[0]):
        for i in range(multipliers.shape[1]):
            for e in range(multipliers.shape[3]):
                multipliers[f, i, column, e] += work.change[f, i, column, e]
                if f == MU:
                    mu_moved += abs(work.change[f, i, column, e])
                    mu_size += abs(multipliers[f, i, column, e])
    return moved, size, mu_moved, mu_size


@part
def convergence(work, column, moved, size, mu_moved, mu_size, iteration):
    """(True if the error of a column after a correction by `moved` is small enough or round-off, True if it will not become so).

    The error of mu is that of w times M / h^2, and an error of the bars of the state before: it is estimated by its own last correction.
    """
    marks, rates, last = work.marks, work.rates[column], work.rates[column, MOVED]
    rate, measured, rates[MOVED] = rates[CONTRACTION], iteration > 0 and last > 0.0, moved
    if measured:
        rate = moved / last
        rates[CONTRACTION], rates[MEASURED] = max(rate, (0.5 if iteration == 1 else 1.0) * rates[CONTRACTION]), marks[STEPS]
    elif rates[MEASURED] > 0.0 and marks[STEPS] < rates[MEASURED] + FRESHEN:
        rate *= marks[STEPS] / rates[MEASURED]  # it grows with the distance from the state of the factor
    else:
        rate = np.inf
    slow = measured and not rate <= marks[SLOWEST]
    factor = rate / (1.0 - rate) if rate < 1.0 else np.inf
    small = moved * factor <= work.enough * size and mu_moved * factor <= OF_MU * work.enough * mu_size
    return small or (slow and moved <= ROUND_OFF * size) or moved <= NEGLIGIBLE * work.sizes[column, LARGEST], slow


@part
def count_work(marks, solves):
    """Count a step with its solves."""
    marks[STEPS] += 1.0
    marks[WORK] += solves
    marks[LATELY] += (SMOOTHING if marks[STEPS] > 1.0 else 1.0) * (solves - marks[LATELY])


@entry
def solve(workspace, step, right, below, bar, now, multipliers, out):
    """Solve a step by refinement; the Scratches of the workspace write their results to the array `out`, SceneAdjoint.products.

    Returns a status: REFACTOR too if a step costs more than the mean of all steps with the factor, its making included.
    """
    if workspace.marks[LATELY] * workspace.marks[STEPS] > workspace.marks[WORK] + RENEWAL:
        return REFACTOR
    _, stages, columns, m = workspace.rows.shape
    middle, shape, work = stages // 2, workspace.r.shape, 0.0
    right_r, bar, right_rows = carray(pointer(right), shape), carray(pointer(bar), shape[1:]), carray(pointer(below), (stages, columns, m))
    now, multipliers = carray(pointer(now), shape), carray(pointer(multipliers), workspace.rows.shape)
    which = workspace.which
    for c in range(columns):
        which[c] = c
    for i in range(stages):
        x, drives = stage(workspace, i), workspace.drives[step, i]
        u, v = pairs(workspace, workspace.q[step, i]), pairs(workspace, workspace.v[step, i])
        products.hold_state(workspace.scene, workspace.laws, drives, u, v, workspace.lam[step, i], x)
        joints.joint_jacobian(workspace.scene.links, drives, x.points[DZ], workspace.slopes[i])
        evaluate_mu_terms(workspace, workspace.tied, step, i)
    multiply(workspace, step, now, multipliers, bar, which, which, True)
    for i in range(stages if stages > 1 else 0):
        own, mid = stage(workspace, i).rotation, stage(workspace, middle).rotation
        for a in range(shape[2]):
            size = 1.0 / np.sqrt((mid[a, 0] ** 2 + mid[a, 1] ** 2) * (own[a, 0] ** 2 + own[a, 1] ** 2))
            workspace.turn[i, a, 0] = (mid[a, 0] * own[a, 0] + mid[a, 1] * own[a, 1]) * size
            workspace.turn[i, a, 1] = (mid[a, 1] * own[a, 0] - mid[a, 0] * own[a, 1]) * size
    if not prepare_rates(workspace, workspace.tied, step, middle):
        return SINGULAR
    prepare_mode(workspace, workspace.real, middle)
    prepare_mode(workspace, workspace.pair, middle)
    for iteration in range(MAX_CORRECTIONS):
        for c in which:
            set_residuals(workspace, right_r, right_rows, c)
            workspace.sizes[c, UNCONSTRAINED] = 0.0
        u = pairs(workspace, workspace.q[step, middle])
        if not (correct(workspace, workspace.real, u, which) and correct(workspace, workspace.pair, u, which)):
            return SINGULAR
        workspace.marks[SOLVES] += which.shape[0]
        work += 0.5 * (1.0 + which.shape[0])  # each further column costs about half of the first
        for e in range(which.shape[0]):
            c = which[e]
            if stages > 1:
                workspace.dw[:, c] = 0.0
            workspace.change[:, :, c] = 0.0
            add_change(workspace, workspace.real, 1.0, c)
            add_change(workspace, workspace.pair, 2.0, c)
            workspace.sizes[c, LARGEST] = max(workspace.sizes[c, LARGEST], workspace.sizes[c, UNCONSTRAINED])
            moved, size, mu_moved, mu_size = add_correction(workspace, now, multipliers, c)
            small, hopeless = convergence(workspace, c, moved, size, mu_moved, mu_size, iteration)
            if hopeless and not small:
                return REFACTOR
            workspace.small[e] = small
        left = 0
        for e in range(which.shape[0]):
            if not workspace.small[e]:
                workspace.left[left] = which[e]
                left += 1
        multiply(workspace, step, now, multipliers, bar, which, which if stages > 1 else workspace.left[:left], False)
        for e in range(left):
            which[e] = workspace.left[e]
        which = which[:left]
        if not left:
            stage_products = carray(pointer(out), (3, *shape))
            for i in range(stages):
                for c in range(columns if not stage(workspace, i).slowing.shape[1] else 0):
                    clear(stage_products[1, i, c])  # the sweep of Radau IIA adds to them
            count_work(workspace.marks, work)
            workspace.marks[SLOWEST] = OLD
            return DONE
    return REFACTOR


class SceneAdjoint(AdjointTable):
    """The table of a compiled scene.

    to_v, to_a (s, s): of steps with h = 1 that `scale` is of; modes: (c_m, c_v, row, column) of each mode at h = 1. factor: a function
    (t, q, v, a, lam, c) of a stage and the pairs c = (c_m, c_v) of the modes that gives for each mode (Corotated, SolveWorkspace), and with mu
    C A^T. enough: as of SceneAdjointWork. counts: what counts its work. columns: number of right-hand sides.
    """

    def __init__(self, model, to_v, to_a, modes, factor, enough, counts, tied=False, columns=1):
        self.model, self.modes, self.factor, self.counts, self.tied, self.h = model, modes, factor, counts, tied, 1.0
        self.factors, self.factor_cache = (np.array(to_v, float), np.array(to_a, float)), FactorCache()
        self.columns, self.functions = columns, np.zeros(ENTRIES, np.int64)
        s, nodes, kinds, entries = len(to_v), (model.n_nodes, 2), 1 + tied, len(model.arrays.links.row_columns)
        each = s, columns
        self.helpers = Helpers(threads()) if s == 1 and model.n >= forward.SHARED and threads() > 1 else None
        self.products = np.zeros((3, *each, *nodes))
        scratches = [scratch(model, tied, self.products[:, i]) for i in range(s)]
        self.w: dict[str, Any] = {
            "scene": arrays_of(model),
            "viscosity": viscosity_of(model),
            "laws": model.laws,
            "enough": enough,
            **dict(zip(("first", "second", "third"), scratches + scratches[-1:] * 2)),
            "slopes": np.zeros((s, entries)),
            "turn": np.zeros((s, *nodes)),
            "r": np.zeros((*each, *nodes)),
            "dw": np.zeros((*each, *nodes)),
            "rows": np.zeros((kinds, *each, model.m)),
            "change": np.zeros((kinds, *each, model.m)),
            "which": np.zeros(columns, np.int64),
            "small": np.zeros(columns, bool),
            "left": np.zeros(columns, np.int64),
            "sizes": np.zeros((columns, 2)),
        }
        self.mu_terms = {}
        if tied:
            coupled, points = (s, len(model.arrays.links.coupling.columns), 2, 2), (2, model.n_points, 2)
            self.mu_terms = {
                "curvature": np.zeros(coupled),
                "rates": np.zeros((s, entries)),
                "v": np.zeros((s, *nodes)),
                "points": np.zeros(points),
                "system": rate_multipliers(model),
            }
        self.scale(1.0)

    def beside(self):
        """The same for the sweep of another objective, with the same factors."""
        other = copy(self)
        other.w = self.w | {"sizes": np.zeros_like(self.w["sizes"])}
        return other

    def scale(self, h):
        """Set the step h; to_v and to_a were given for h = 1."""
        self.h = h
        self.w |= {"to_v": self.factors[0] / h, "to_a": self.factors[1] / h**2}

    def set_states(self, t, q, v, a, lam, mu=None):
        """Set the states of the stages of some steps, (count, s, .) each, or (count, .) for one stage."""
        count, s = len(t), len(self.factors[0])
        self.states = [np.ascontiguousarray(x, float).reshape(count, s, *np.shape(x)[np.ndim(t) :]) for x in (t, q, v, a, lam)]
        t, self.w["q"], self.w["v"], _, self.w["lam"] = self.states
        self.w["drives"] = drive_table(self.model, t.ravel(), (t[0, 0], t[-1, -1])).reshape(count, s, -1, 3)
        self.w["tied"] = MuTerms(np.ascontiguousarray(mu, float), **self.mu_terms) if self.tied else None

    def refresh(self, k):
        key = f"{self.h:.9e}"
        if known := self.factor_cache.get(key):
            self._use(*known, OLD)
            return False
        middle = len(self.factors[0]) // 2
        factors = self.factor(*(x[k, middle].copy() for x in self.states), [(c_m / self.h**2, c_v / self.h) for c_m, c_v, *_ in self.modes])
        self.counts.factorizations += len(factors)
        modes = {"real": None, "pair": None}
        for (c_m, c_v, row, column), parts in zip(self.modes, factors):
            modes["pair" if np.iscomplexobj(row) else "real"] = self._mode((c_m / self.h**2, c_v / self.h), row, column, *parts)
        self.factor_cache.keep(key, known := (modes, {}))
        self._use(*known, FRESH)
        return True

    def _use(self, modes, known, slowest):
        """Use the modes of a factor. known: {number of a table: its marks and rates of this factor}."""
        if id(self) not in known:
            known[id(self)] = {"marks": np.zeros(5), "rates": np.zeros((self.columns, 3))}
            known[id(self)]["marks"][SLOWEST], known[id(self)]["rates"][:, CONTRACTION] = slowest, 1.0
        self.w |= modes | known[id(self)]

    def _mode(self, c, row, column, factored, workspace, slowing=UNDAMPED):
        kind, columns = np.asarray(row).dtype, self.columns
        rows = columns, 1 + self.tied, self.model.m
        vectors = [self.w[name][0] if len(self.w["r"]) == 1 else np.zeros(self.w["r"].shape[1:], kind) for name in ("r", "dw")]
        scratch = *vectors, np.zeros(rows, kind), np.zeros(rows, kind), np.zeros(columns)
        lanes = None if np.issubdtype(kind, complex) else np.zeros((2 * self.model.n_factored, COLUMNS), np.float32)
        return Mode(np.array(c, kind), np.array(row), np.array(column), factored, workspace, slowing, *scratch, lanes)

    def raise_error(self):
        self.model.raise_error()

    def drop(self):
        self.factor_cache.factors.pop(f"{self.h:.9e}", None)

    @contextmanager
    def at_work(self):
        """(addresses of the functions, address of the workspace)."""
        marks, real = self.w["marks"], self.w["real"]
        marks[SOLVES] = 0.0
        own = real and real.workspace
        with self.helpers.at_work(real.factored, own) if real and self.helpers else nullcontext(own) as workspace:
            work = SceneAdjointWork(**self.w | ({"real": real._replace(workspace=workspace)} if real else {}))
            self.functions[ADJOINT] = forward.entry_address(solve, typeof(work))
            yield self.functions, work.address
        self.counts.solves += int(marks[SOLVES]) * len(self.modes)
