"""The transposed solve with the factor of one mode of a scene's step, as old as it may be.

For an eigenvalue c of the method, c_m = c^2 and c_v = c (generalized-alpha: one mode, c_m and c_v of its own), with K, M and C as old as
the factor `S = K + c_v C + c_m M`, in the frames of the nodes, and B of the middle stage, the corrections of w and of the multipliers solve

    | S                B^T  c B^T |  |w    |
    | B                           |  |mu   |  = residuals
    | B (c M + C)^T         B B^T |  |kappa|     the last row and column where there is mu in the step

so that w and mu + c kappa follow from the first two rows, and kappa from the last one. As in the steps (assembly/rate_multipliers.py) H is
left to the refinement (scene_table.py). Right-hand sides of several objectives are columns, solved for in single precision after a division
by their size.
"""

from typing import NamedTuple

import numpy as np

from polyida.adjoint.relaxation import eliminate_transposed, recover_transposed
from polyida.assembly import corotated, joints
from polyida.assembly.rate_multipliers import RateMultipliers, rate_values, solve_rates
from polyida.jit import fast, pack, part
from polyida.jit.intrinsics import COLUMNS
from polyida.linear.dense import magnitude, put
from polyida.system.scene_factors import C_M, C_V, Factor

# constants of compiled code
MU, KAPPA = range(2)  # of multipliers and of rows
LEAST = 1e-280  # a residual below that is taken as that large: single precision, in which the factor solves, ends at 1e-38


@pack
class Mode(NamedTuple):
    """A mode: its factor, its shares of the stages, and scratch for the columns."""

    factor: Factor
    row: np.ndarray  # (s,) what a correction of the mode adds to each stage
    column: np.ndarray  # (s,) shares of the stages' residuals in that of the mode
    r: np.ndarray  # (columns, nodes, 2) residuals; with one stage those of the step themselves
    dw: np.ndarray  # (columns, nodes, 2) corrections of w; with one stage those of the step themselves
    rows: np.ndarray  # (columns, 1 or 2, m) residuals of the rows
    multipliers: np.ndarray  # (columns, 1 or 2, m) corrections of mu and kappa
    sizes: np.ndarray  # (columns,) of r
    lanes: np.ndarray | None  # (n, COLUMNS) right-hand sides that are solved for together; None if the factor is complex


@pack
class MuTerms(NamedTuple):
    """Arrays of steps with mu."""

    mu: np.ndarray  # (count, s, m)
    curvature: np.ndarray  # (s, ., 2, 2) blocks of (B^T mu)_q on the coupled points
    rates: np.ndarray  # (s, .) slopes of the rates of the rows, H
    v: np.ndarray  # (s, nodes, 2) v*
    points: np.ndarray  # (2, points, 2) values and forces at the points
    system: RateMultipliers  # of B B^T


@part
def prepare_mode(links, mode, state, slopes):
    """Set the frames and the border of a mode's factor at a state, the Scratch of a stage, with phi_z = slopes; nothing without a mode."""
    if mode is not None:
        factored, workspace = mode.factor.factored, mode.factor.workspace
        corotated.turn_frames(links, factored, workspace, state.rotation)
        corotated.fill_point_compliance(links, factored, workspace)
        put(1.0, slopes, workspace.border.slopes)
        fill_curvature(links, mode.factor, state, workspace.border.curvature)
        workspace.keeps[0] = 0


@part
def fill_curvature(links, factor, state, curvature):
    """Fill the transposed blocks of c_v C + K on the coupled points, with the point masses."""
    mirror = links.coupling.mirror
    for e in range(mirror.shape[0]):
        for j in range(2):
            for o in range(2):
                curvature[e, j, o] = state.curvature[mirror[e], o, j]
                if state.slack.shape[0]:
                    curvature[e, j, o] += factor.c[C_V] * state.slack[mirror[e], o, j]
    corotated.condense_states(links.coupling, factor.factored, curvature)
    corotated.add_masses(links, factor.c[C_M], curvature)


@part
def correct(scene, mode, terms, displacements, residuals, rows, unconstrained, which):
    """Fill the corrections of a mode for the columns in `which`. False if the border is singular; True without a mode.

    displacements: displacements of the middle stage; residuals (s, columns, nodes, 2) and rows (1 or 2, s, columns, m): of the stages.
    unconstrained (columns,): increased by the size of w without constraints.
    """
    if mode is None:
        return True
    elimination, relaxation = mode.factor.workspace.elimination, scene.relaxation
    for c in which:
        mode.sizes[c] = collect(residuals, rows, mode, c)
        eliminate_transposed(scene, relaxation, elimination, displacements, mode.r[c])
    solve_columns(mode, mode.lanes, which)
    for c in which:
        recover_transposed(scene, relaxation, elimination, displacements, mode.r[c], mode.dw[c])
        unconstrained[c] += size_of(mode.dw[c])
        if not solve_border(scene.links, mode, terms, c):
            return False
        recover_transposed(scene, relaxation, elimination, displacements, mode.r[c], mode.dw[c])
    return True


@fast
def collect(residuals, rows, mode, column):
    """Set a mode's part of the residuals of a column, mode.r and mode.rows. Returns its size. With one stage mode.r is `residuals`."""
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
def solve_columns(mode, lanes, which):
    """mode.dw[c] = S^-1 mode.r[c] without rows: several columns with one pass through the factor, unless it is complex (lanes is None)."""
    factored, workspace, together = mode.factor.factored, mode.factor.workspace, 0
    if lanes is not None:
        together = which.shape[0] if which.shape[0] > 1 else 0
        for first in range(0, together, COLUMNS):
            corotated.solve_turned_columns(
                factored, workspace, lanes, mode.sizes, mode.r, mode.dw, which[first : min(first + COLUMNS, together)]
            )
    for c in which[together:]:
        corotated.solve_turned(factored, workspace, mode.sizes[c], mode.r[c], mode.dw[c])


@part
def solve_border(links, mode, terms, column):
    """Fill the multipliers of a mode in a column, and add the effect of their forces to dw. False if the border is singular."""
    factored, workspace, dw = mode.factor.factored, mode.factor.workspace, mode.dw[column]
    if not workspace.point_turn.shape[0]:
        return True
    joints.point_values(links, dw, workspace.moved)
    if not corotated.solve_multipliers(links, factored, workspace, mode.rows[column, MU], mode.multipliers[column, MU]):
        return False
    workspace.keeps[0] = 1
    corotated.apply_point_forces(links, factored, workspace, dw)
    corotated.settle_states(links, factored, workspace.border.curvature, workspace.moved, dw)
    return solve_kappa(links, mode, terms, column)


@part
def solve_kappa(links, mode, terms, column):
    """Fill kappa of a mode in a column, and subtract c kappa from mu, unless the step has no mu (terms is None). False if the system is
    singular.
    """
    if terms is None:
        return True
    c, values, rows, multipliers = mode.factor.c[C_V], mode.factor.workspace.moved, mode.rows[column], mode.multipliers[column]
    rate_values(links, terms.system, mode.factor.slowing, mode.factor.workspace, c, mode.dw[column], values)
    for e in range(rows.shape[1]):
        rows[KAPPA, e] = -rows[KAPPA, e] - joints.along(links, terms.system.workspace.slopes, e, values)
    good = solve_rates(terms.system, rows[KAPPA], multipliers[KAPPA])
    for e in range(rows.shape[1]):
        multipliers[MU, e] -= c * multipliers[KAPPA, e]
    return good


@part
def add_change(mode, twice, dw, change, column):
    """Add the part of a mode to the corrections dw and `change` of the stages in a column, twice that of a complex mode. With one stage
    mode.dw is dw.
    """
    if mode is not None:
        for i in range(dw.shape[0]):
            share = twice * mode.row[i]
            for a in range(dw.shape[2] if dw.shape[0] > 1 else 0):
                for e in range(2):
                    dw[i, column, a, e] += (share * mode.dw[column, a, e]).real
            for f in range(change.shape[0]):
                for e in range(change.shape[3]):
                    change[f, i, column, e] += (share * mode.multipliers[column, f, e]).real
