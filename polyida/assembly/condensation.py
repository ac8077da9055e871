"""Steps of generalized-alpha of scenes with viscoelastic plates, without the relaxed strains x among the unknowns of Newton's method.

Strains are velocities v of coordinates, x = unit v (relaxation.py). Newmark's formulas make x and x' at the end of a step linear in the
acceleration a there, v = v_known + w a, w = TO_V / TO_A (`v_of_end` in the code). With `x' = (E - x) / tau` and E at the end

    a = (E / unit - v_known) / (tau + w),   sum g x = known + share E,   share = sum g w / (tau + w) = 1 - kappa

so that the stress is `D : (kappa E - known)`, `known` from the state at the step's beginning. Newton's method on the other coordinates has
the matrix with kappa D of strain_elimination.py. The strains are computed once, at the end of the step.
"""

from typing import NamedTuple

import numpy as np
from numba import carray, typeof

from polyida.assembly import reduced_kernels
from polyida.assembly.arrays import SceneArrays, cells_of, material_of
from polyida.assembly.relaxation import add_scaled, full_plates, strains_of
from polyida.element import kernels
from polyida.element.relaxation import strain_at_points
from polyida.errors import DONE
from polyida.jit import fast, pack, part, served
from polyida.jit.intrinsics import address, integer_of, pointer
from polyida.jit.user_functions import table_address
from polyida.linear.dense import put

# numbers of a step of generalized-alpha (alpha/steps.py); 0: start, 1: end of the step, alg: algorithmic acceleration
# alg_1 = ALG_OF_A a_0 + ALG_OF_ALG alg_0 + ALG_OF_END a_1
# v_1 = v_0 + V_OF_A a_0 + V_OF_ALG alg_0 + (TO_V / TO_A) a_1
# q_1 - q_0 = H v_0 + dd, dd = DD_OF_A a_0 + DD_OF_ALG alg_0 + a_1 / TO_A
TO_A, TO_V, H, V_OF_A, V_OF_ALG, DD_OF_A, DD_OF_ALG, ALG_OF_A, ALG_OF_ALG, ALG_OF_END = range(10)
WORKSPACE, CONDENSED_FORCE, ADD_FORCE_OF_REDUCED_PLATES, BEGIN_STRAINS, END_STRAINS = range(5)  # of Condensation.calls
TOGETHER = 512  # strains whose rows fit into the first cache


@pack
class Condensation(NamedTuple):
    """Workspace of the steps."""

    scene: SceneArrays
    known: np.ndarray  # (numbers of the strains,) `known` of each body, where its first term begins in Relaxation
    shares: np.ndarray  # (bodies,) 1 - kappa
    calls: np.ndarray  # (5,) address of this at WORKSPACE, then those of the C functions in FUNCTIONS; 0 if they are not wanted


def condensation(model, wanted):
    """The Condensation of a scene. Its functions are compiled if they are wanted and the scene has relaxed strains."""
    x, calls = model.arrays.relaxation, np.zeros(5, np.int64)
    used = wanted and len(x.share) > 0
    workspace = Condensation(scene=model.arrays, known=np.zeros(x.start[-1] if used else 0), shares=np.zeros(len(x.start) - 1), calls=calls)
    if used:
        calls[:] = workspace.address, *(table_address(function, typeof(workspace)) for function in FUNCTIONS)
    return workspace


@part
def take_strain(scene, body, moved, strain):
    """Store the strain E of a body at the displacements `moved`; in the last place, which an odd size of y leaves unused, 0."""
    full = full_plates(scene)
    if body >= full:
        strain[strain.shape[0] - 1] = 0.0
        reduced_kernels.strained(scene.reduced, body - full, moved, strain[: reduced_kernels.vectors(scene.reduced, body - full)[2]])
    else:
        strain_at_points(cells_of(scene.plates, body), moved, strain)


@part
def state_rows(work, at):
    """Return the rows (q, v, a, a_alg, change of a) at an address, (5, coordinates)."""
    x = work.scene.relaxation
    return carray(pointer(at), (5, 2 * x.first + x.start[x.start.shape[0] - 1]))


@part
def node_rows(work, at):
    """Return the array (nodes, 2) at an address."""
    return carray(pointer(at), (work.scene.relaxation.first, 2))


@part
def step_numbers(work, at):
    """The numbers of a step at an address, TO_A to ALG_OF_END."""
    return carray(pointer(at), (10,))


@part
def condensed_force(work, body, moved, residual, rotation):
    """Add to residual the force of full plate `body` with the stress D : (kappa E - known).

    Returns the least det F, a float of `kernels.internal_force`, as the integer with the same bits.
    """
    plates, x = work.scene.plates, work.scene.relaxation
    known = work.known[x.start[body] : x.start[body] + strains_of(x, body)]
    kappa = 1.0 - work.shares[body]
    return integer_of(kernels.relaxed_force(cells_of(plates, body), material_of(plates, body), moved, known, kappa, residual, rotation))


@part
def add_force_of_reduced_plates(work, moved, residual):
    """Add to residual the forces of relaxation of the reduced plates at the displacements `moved`, with sum g x = known + share E.

    Full plates have them in `condensed_force`.
    """
    scene, x = work.scene, work.scene.relaxation
    full = full_plates(scene)
    for b in range(full, x.start.shape[0] - 1):
        if x.terms[b] < x.terms[b + 1]:
            at, count = x.start[b], strains_of(x, b)
            viscous_strain, strain = work.known[at : at + count].copy(), np.empty(count)
            take_strain(scene, b, moved, strain)
            add_scaled(viscous_strain, work.shares[b], strain)
            reduced_kernels.relax(scene.reduced, b - full, moved, None, viscous_strain, residual, strain)
    return DONE


@part
def begin_strains(work, rows, numbers):
    """Fill `known` = sum g unit tau v_known / (tau + w), and the shares, of a step from the rows (q, v, a, a_alg) at its beginning."""
    x, v_of_end = work.scene.relaxation, numbers[TO_V] / numbers[TO_A]
    for b in range(x.start.shape[0] - 1):
        count, at = strains_of(x, b), 2 * x.first + x.start[b]
        known = work.known[x.start[b] : x.start[b] + count]
        known[:] = 0.0
        work.shares[b] = 0.0
        for k in range(x.terms[b], x.terms[b + 1]):
            share = x.share[k] / (x.time[k] + v_of_end)
            factor = share * x.time[k] * x.unit[b]
            work.shares[b] += share * v_of_end
            add_scaled(known, factor, rows[1, at : at + count])
            add_scaled(known, factor * numbers[V_OF_A], rows[2, at : at + count])
            add_scaled(known, factor * numbers[V_OF_ALG], rows[3, at : at + count])
            at += count
    return DONE


@part
def end_strains(work, moved, past, rows, numbers):
    """Fill the strains' columns in the rows (q, v, a, a_alg, change of a) at the end of a step, where the displacements are `moved`.

    past: the rows at the start of the step, maybe the same array.
    """
    scene, x = work.scene, work.scene.relaxation
    for b in range(x.start.shape[0] - 1):
        if x.terms[b] == x.terms[b + 1]:
            continue
        count, at = strains_of(x, b), 2 * x.first + x.start[b]
        strain = np.empty(count)
        take_strain(scene, b, moved, strain)
        for k in range(x.terms[b], x.terms[b + 1]):
            for i in range(0, count, TOGETHER):
                first, end = at + i, at + min(i + TOGETHER, count)
                if address(rows) != address(past):
                    for row in range(4):
                        put(1.0, past[row, first:end], rows[row, first:end])
                end_term(numbers, x.unit[b], x.time[k], strain[i : i + TOGETHER], rows, first, end)
            at += count
    return DONE


@fast
def end_term(numbers, unit, time, strain, rows, first, end):
    """Take one term of a body's strains from the start of the step to its end, in columns first to end of the rows.

    rows: q, v, a, a_alg and the change of a. strain: E at the end. Each loop has few arrays: LLVM makes loops over vectors of them.
    """
    q, v, a, a_alg, change = rows[0, first:end], rows[1, first:end], rows[2, first:end], rows[3, first:end], rows[4, first:end]
    v_of_a, v_of_alg, dd_of_a, dd_of_alg = numbers[V_OF_A], numbers[V_OF_ALG], numbers[DD_OF_A], numbers[DD_OF_ALG]
    alg_of_a, alg_of_alg, alg_of_end = numbers[ALG_OF_A], numbers[ALG_OF_ALG], numbers[ALG_OF_END]
    h, v_of_end, dd_of_end = numbers[H], numbers[TO_V] / numbers[TO_A], 1.0 / numbers[TO_A]
    factor, of_strain = 1.0 / (time + v_of_end), 1.0 / unit
    # `change` holds a_1 = (E / unit - v_known) / (tau + w) until it becomes a_1 - a_0; q_1, v_1 and alg_1 are as at TO_A
    for j in range(change.shape[0]):
        change[j] = factor * (of_strain * strain[j] - (v[j] + v_of_a * a[j] + v_of_alg * a_alg[j]))
    for j in range(change.shape[0]):
        q[j] += h * v[j] + (dd_of_end * change[j] + dd_of_a * a[j] + dd_of_alg * a_alg[j])
    for j in range(change.shape[0]):
        v[j] += v_of_a * a[j] + v_of_alg * a_alg[j] + v_of_end * change[j]
    for j in range(change.shape[0]):
        a_alg[j] = alg_of_end * change[j] + alg_of_a * a[j] + alg_of_alg * a_alg[j]
    for j in range(change.shape[0]):
        change[j] -= a[j]
    for j in range(change.shape[0]):
        a[j] += change[j]


FUNCTIONS = (
    served(condensed_force, node_rows, node_rows, node_rows),
    served(add_force_of_reduced_plates, node_rows, first=node_rows),
    served(begin_strains, step_numbers, first=state_rows),
    served(end_strains, state_rows, state_rows, step_numbers, first=node_rows),
)
