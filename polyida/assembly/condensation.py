"""Steps of generalized-alpha of scenes with viscoelastic plates, without the relaxed strains x among the unknowns of Newton's method.

Newmark's formulas make x and x' at the end of a step linear in q'' there, v = v_known + w a. With `x' = (E - x) / tau` and E at the end

    a = (E / unit - v_known) / (tau + w),   sum g x = known + share E,   share = sum g w / (tau + w) = 1 - kappa

so that the stress is `D : (kappa E - known)`, `known` from the state at the step's beginning. Newton's method on the other coordinates has the
matrix with kappa D of relaxation.py. The strains are computed once, at the end of the step.
"""

from typing import NamedTuple

import numpy as np
from numba import carray, typeof

from polyida.assembly import reduced_kernels
from polyida.assembly.arrays import SceneArrays, cells_of, material_of
from polyida.assembly.relaxation import add_scaled, strains_of
from polyida.element import kernels
from polyida.element.relaxation import strain_at_points
from polyida.errors import DONE
from polyida.jit import fast, pack, part, served
from polyida.jit.intrinsics import address, integer_of, pointer
from polyida.jit.user_functions import table_address
from polyida.linear.dense import put

# of the numbers of a step
TO_A, TO_V, H, V_OF_A, V_OF_ALG, DD_OF_A, DD_OF_ALG, ALG_OF_A, ALG_OF_ALG, ALG_OF_END = range(10)
WORKSPACE, CONDENSED_FORCE, ADD_CONDENSED, BEGIN_STRAINS, END_STRAINS = range(5)  # of Condensation.calls
TOGETHER = 512  # strains whose rows fit into the first cache


@pack
class Condensation(NamedTuple):
    """Workspace of the steps.

    calls: WORKSPACE, address of this, and addresses of the four C functions, which are compiled if the scene has such strains; else zero.
    """

    scene: SceneArrays
    known: np.ndarray  # of each body where its first term begins in Relaxation
    shares: np.ndarray  # of the bodies
    calls: np.ndarray


def condensation(model, condensed):
    """The Condensation of a scene; without functions unless condensed."""
    x, calls = model.arrays.relaxation, np.zeros(5, np.int64)
    used = condensed and len(x.share) > 0
    workspace = Condensation(model.arrays, np.zeros(x.start[-1] * used), np.zeros(len(x.start) - 1), calls)
    if used:
        calls[:] = workspace.address, *(table_address(function, typeof(workspace)) for function in FUNCTIONS)
    return workspace


@part
def take_strain(scene, body, moved, strain):
    """Overwrite strain with the strains of a body at the displacements `moved` (nodes, 2): of a full plate E at its points, else y - y_0.

    The last place, which an odd size of y leaves unused, becomes 0.
    """
    s = scene.plates
    o = s.body_node.shape[0] - 1
    if body >= o:
        strain[strain.shape[0] - 1] = 0.0
        reduced_kernels.strained(scene.reduced, body - o, moved, strain[: reduced_kernels.vectors(scene.reduced, body - o)[2]])
    else:
        strain_at_points(cells_of(s, body), moved, strain)


@part
def coordinates(work, at):
    """(q, v, a, a_alg, change of a) at an address, (5, coordinates)."""
    x = work.scene.relaxation
    return carray(pointer(at), (5, 2 * x.first + x.start[x.start.shape[0] - 1]))


@part
def nodal(work, at):
    """The array (nodes, 2) at an address."""
    return carray(pointer(at), (work.scene.relaxation.first, 2))


@part
def step_numbers(work, at):
    """The numbers of a step at an address, TO_A to ALG_OF_END."""
    return carray(pointer(at), (10,))


@part
def condensed_force(work, body, moved, residual, rotation):
    """Add to residual (nodes, 2) the force of a full plate with the stress D : (kappa E - known) at the displacements `moved` (nodes, 2).

    rotation: as in `kernels.internal_force`. Returns the bits of the least det F, as an integer, as this does.
    """
    plates, x = work.scene.plates, work.scene.relaxation
    known, kappa = work.known[x.start[body] : x.start[body] + strains_of(x, body)], 1.0 - work.shares[body]
    return integer_of(kernels.relaxed_force(cells_of(plates, body), material_of(plates, body), moved, known, kappa, residual, rotation))


@part
def add_condensed(work, moved, residual):
    """Add to residual (nodes, 2) what relaxation adds to the elastic forces of all viscoelastic reduced plates; return DONE.

    moved (nodes, 2): the displacements at the step's end. The change of the strain is -(known + share E), with work.known and work.shares.
    """
    scene, x, full = work.scene, work.scene.relaxation, work.scene.plates.body_operator.shape[0]
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
    """Overwrite work.known (strains) and work.shares (bodies,) for a step, from the state at its beginning; return DONE.

    rows (5, coordinates): q, v, a, a_alg, change of a. numbers: of the step, TO_A to ALG_OF_END.
    """
    x, v_of_end = work.scene.relaxation, numbers[TO_V] / numbers[TO_A]
    for b in range(x.start.shape[0] - 1):
        count, at = strains_of(x, b), 2 * x.first + x.start[b]
        known, work.shares[b] = work.known[x.start[b] : x.start[b] + count], 0.0
        known[:] = 0.0
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
    """Fill the strains in the rows at the end of a step from the past rows, maybe the same ones, and the displacements `moved` at the end."""
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
    """`end_strains` of a part of a term, columns first to end of the rows. Loops of few arrays each: LLVM makes loops over vectors of them."""
    q, v, a, a_alg, change = rows[0, first:end], rows[1, first:end], rows[2, first:end], rows[3, first:end], rows[4, first:end]
    v_of_a, v_of_alg, dd_of_a, dd_of_alg = numbers[V_OF_A], numbers[V_OF_ALG], numbers[DD_OF_A], numbers[DD_OF_ALG]
    alg_of_a, alg_of_alg, alg_of_end = numbers[ALG_OF_A], numbers[ALG_OF_ALG], numbers[ALG_OF_END]
    h, v_of_end, dd_of_end = numbers[H], numbers[TO_V] / numbers[TO_A], 1.0 / numbers[TO_A]
    factor, of_strain = 1.0 / (time + v_of_end), 1.0 / unit
    for j in range(change.shape[0]):  # a at the end
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
    served(condensed_force, nodal, nodal, nodal),
    served(add_condensed, nodal, first=nodal),
    served(begin_strains, step_numbers, first=coordinates),
    served(end_strains, coordinates, coordinates, step_numbers, first=nodal),
)
