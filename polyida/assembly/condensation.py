"""Steps of generalized-alpha of scenes with viscoelastic plates, without the relaxed strains x among the unknowns of Newton's method.

Newmark's formulas make x and x' at the end of a step linear in q'' there, v = v_known + w a. With `x' = (E - x) / tau` and E at the end

    a = (E / unit - v_known) / (tau + w),   sum g x = known + share E,   share = sum g w / (tau + w) = 1 - kappa

so that the stress is `D : (kappa E - known)`, `known` from the state at the step's beginning. Newton's method on the other coordinates has the
matrix with kappa D of relaxation.py. The strains are computed once, at the end of the step.
"""

from typing import NamedTuple

import numpy as np
from numba import carray, typeof

from polyida.assembly import compact
from polyida.assembly.arrays import SceneArrays, cells
from polyida.assembly.relaxation import add_scaled, strains_of
from polyida.element import kernels
from polyida.element.relaxation import strain_at_points
from polyida.errors import DONE
from polyida.jit import entry, fast, pack, part
from polyida.jit.intrinsics import integer_of, pointer
from polyida.jit.user_functions import table_address
from polyida.linear.dense import put

# of the numbers of a step
TO_A, TO_V, H, V_OF_A, V_OF_ALG, DD_OF_A, DD_OF_ALG, ALG_OF_A, ALG_OF_ALG, ALG_OF_END = range(10)
TOGETHER = 512  # strains whose rows fit into the first cache


@pack
class Condensation(NamedTuple):
    """Workspace of the steps.

    calls: addresses of this and of the four C functions, which are compiled if the scene has such strains; else zero.
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
        functions = condensed_force, add_condensed, begin_strains, end_strains
        calls[:] = workspace.address, *(table_address(function, typeof(workspace)) for function in functions)
    return workspace


@part
def take_strain(scene, body, u, strain):
    """Store the strain of a body at u; in the last place, which an odd size of y leaves unused, 0."""
    s = scene.plates
    o = s.body_node.shape[0] - 1
    if body >= o:
        strain[strain.shape[0] - 1] = 0.0
        compact.strained(scene.compact, body - o, u, strain[: compact.vectors(scene.compact, body - o)[2]])
    else:
        layout, corners, gradients, _ = cells(s, s.body_operator[body])
        strain_at_points(layout, corners, gradients, s.body_node[body], u, strain)


@part
def rows_of(relaxation, at):
    """(q, v, a, a_alg, change of a) at an address, (5, coordinates)."""
    return carray(pointer(at), (5, 2 * relaxation.first + relaxation.start[relaxation.start.shape[0] - 1]))


@entry
def condensed_force(work, body, displacements, forces, rotations, e, f, g):
    """Add the force of a full plate to r (nodes, 2); the rest as of `kernels.internal_force`."""
    s, x = work.scene.plates, work.scene.relaxation
    shape = (x.first, 2)
    u, r, rotation = carray(pointer(displacements), shape), carray(pointer(forces), shape), carray(pointer(rotations), shape)
    at, place = x.start[body], (s.body_node[body], s.body_c1[body], s.body_nu[body])
    pull = work.known[at : at + strains_of(x, body)]
    return integer_of(kernels.relaxed_force(*cells(s, s.body_operator[body]), *place, u, pull, 1.0 - work.shares[body], r, rotation))


@entry
def add_condensed(work, displacements, forces, c, d, e, f, g):
    """Add the forces of relaxation of the reduced plates to r (nodes, 2)."""
    scene, x, full = work.scene, work.scene.relaxation, work.scene.plates.body_operator.shape[0]
    u, r = carray(pointer(displacements), (x.first, 2)), carray(pointer(forces), (x.first, 2))
    for b in range(full, x.start.shape[0] - 1):
        if x.terms[b] < x.terms[b + 1]:
            at, count = x.start[b], strains_of(x, b)
            pull, strain = work.known[at : at + count].copy(), np.empty(count)
            take_strain(scene, b, u, strain)
            add_scaled(pull, work.shares[b], strain)
            compact.relax(scene.compact, b - full, u, None, pull, r, strain)
    return DONE


@entry
def begin_strains(work, before, numbers, c, d, e, f, g):
    """Fill `known` and the shares of a step from the state at its beginning."""
    x, p = work.scene.relaxation, carray(pointer(numbers), (10,))
    rows, v_of_end = rows_of(x, before), p[TO_V] / p[TO_A]
    for b in range(x.start.shape[0] - 1):
        count, at = strains_of(x, b), 2 * x.first + x.start[b]
        known, work.shares[b] = work.known[x.start[b] : x.start[b] + count], 0.0
        known[:] = 0.0
        for k in range(x.terms[b], x.terms[b + 1]):
            share = x.share[k] / (x.time[k] + v_of_end)
            factor = share * x.time[k] * x.unit[b]
            work.shares[b] += share * v_of_end
            add_scaled(known, factor, rows[1, at : at + count])
            add_scaled(known, factor * p[V_OF_A], rows[2, at : at + count])
            add_scaled(known, factor * p[V_OF_ALG], rows[3, at : at + count])
            at += count
    return DONE


@entry
def end_strains(work, displacements, before, state, numbers, d, e, f):
    """Fill the rows of the strains in `state` at the end of a step, from those before, maybe the same, and the displacements at the end."""
    scene, x, p = work.scene, work.scene.relaxation, carray(pointer(numbers), (10,))
    u, past, rows = carray(pointer(displacements), (x.first, 2)), rows_of(x, before), rows_of(x, state)
    for b in range(x.start.shape[0] - 1):
        if x.terms[b] == x.terms[b + 1]:
            continue
        count, at = strains_of(x, b), 2 * x.first + x.start[b]
        strain = np.empty(count)
        take_strain(scene, b, u, strain)
        for k in range(x.terms[b], x.terms[b + 1]):
            for i in range(0, count, TOGETHER):
                first, end = at + i, at + min(i + TOGETHER, count)
                if state != before:
                    for row in range(4):
                        put(1.0, past[row, first:end], rows[row, first:end])
                q, v, a, a_alg = rows[0, first:end], rows[1, first:end], rows[2, first:end], rows[3, first:end]
                end_term(p, x.unit[b], x.time[k], strain[i : i + TOGETHER], q, v, a, a_alg, rows[4, first:end])
            at += count
    return DONE


@fast
def end_term(numbers, unit, time, strain, q, v, a, a_alg, change):
    """`end_strains` of a part of a term. Loops of few arrays each: LLVM makes loops over vectors of them."""
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
