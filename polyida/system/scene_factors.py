"""Factors of a scene's step matrices `S = c_m M + c_v C + K`, and the solves with them.

Python makes the factors, or compiled code: those of scenes of rigid and reduced bodies without force elements and damping, whose S has the
parts K and M of the bodies alone. Such factors are stored in slots (entries MATRICES and SELECT of a table).
"""

from typing import NamedTuple

import numpy as np
from numba import carray

from polyida.assembly import corotated, joints, reduced_kernels
from polyida.assembly.equilibrium import symmetric_parts
from polyida.assembly.rate_multipliers import add_rate_forces, factor_rates, slowing, solve_rates, subtract_rates
from polyida.assembly.strain_elimination import eliminate, recover
from polyida.errors import DONE, SINGULAR
from polyida.jit import entry, pack, part, shared
from polyida.jit.intrinsics import pointer
from polyida.linear.dense import copy_matrix, put
from polyida.linear.fronts import fill_panels
from polyida.linear.lu import FACTORS

KINDS = {False: (np.float32, float), True: (np.complex64, complex)}  # of the factors of a real and of a complex mode, and of their blocks


# of compiled code
C_M, C_V = range(2)  # of Factor.c
REAL, PAIR, TIED = range(3)  # of SceneWork.anew: the real factor, the complex one, the system of mu


@pack
class Factor(NamedTuple):
    """A factor of S and its workspace; c = (c_m, c_v), real or complex; slowing: C A^T, see RateMultipliers, (0, 2, 2) without mu or damping."""

    c: np.ndarray
    factored: corotated.Corotated
    workspace: corotated.SolveWorkspace
    slowing: np.ndarray


@pack
class StoredFactors(NamedTuple):
    """Factors of S of a mode of Radau IIA in each slot: panels, compliance columns and frames, (slots, .) each.

    Scratch of one factorization: blocks, S as (nnz, 2, 2), and numbers, workspace of `fill_panels`, both in double precision; x, of the type of the panels.
    """

    panels: np.ndarray
    columns: np.ndarray
    frames: np.ndarray
    blocks: np.ndarray
    numbers: np.ndarray
    x: np.ndarray


@pack
class SceneFactors(NamedTuple):
    """Factors that compiled code makes and stores, of scenes without full plates, forces and damping; of other scenes all sizes are zero.

    chosen (1,): the slot in use. K, M (nnz, 2, 2): blocks. loads: unit forces at the points. places: workspace of `fill_panels`.
    """

    real: StoredFactors
    pair: StoredFactors
    chosen: np.ndarray
    K: np.ndarray
    M: np.ndarray
    loads: np.ndarray
    places: np.ndarray


@part
def mode_values(work, at):
    """c of the real mode, and the real and imaginary part of that of the complex one, at an address."""
    return carray(pointer(at), (3,))


@entry
def matrices(work, instant, moved, v, a, lam, slot, eigenvalues):
    """Factor S of both modes at the displacements `moved`, and store the factors in the slot; v, a and lam are not read."""
    factors, bodies, turn = work.stored, work.scene.reduced, work.turn[0]
    factors.K[:], factors.M[:], factors.chosen[0] = 0.0, 0.0, slot
    reduced_kernels.blocks(bodies, moved, moved, 0.0, 0.0, 1.0, factors.K)  # K
    reduced_kernels.blocks(bodies, moved, moved, 1.0, 0.0, 0.0, factors.M)  # M
    for b in range(bodies.drag.shape[0]):
        reduced_kernels.turn(bodies, b, moved, turn)
    good = factor_mode(factors, factors.real, work.real, eigenvalues[0], turn, slot)
    return DONE if good and factor_mode(factors, factors.pair, work.pair, complex(eigenvalues[1], eigenvalues[2]), turn, slot) else SINGULAR


@shared
def factor_mode(factors, stored, mode, eigenvalue, rotation, slot):
    """Factor S = K + eigenvalue^2 M of a mode from the blocks `factors`, with its columns of the constraints, and store it at `slot`.

    Returns False if S is singular; True without a mode.
    """
    if mode is None:
        return True
    s = mode.factored
    for k in range(factors.K.shape[0]):
        for i in range(2):
            for j in range(2):
                stored.blocks[k, i, j] = factors.K[k, i, j] + eigenvalue * eigenvalue * factors.M[k, i, j]
    mode.c[C_M], mode.c[C_V] = eigenvalue * eigenvalue, eigenvalue
    if not fill_panels(s.fronts, stored.blocks, s.panels, stored.numbers, factors.places):
        return False
    corotated.fill_compliance_columns(s, s.compliance_columns, rotation, factors.loads, stored.x)
    put(1.0, s.panels, stored.panels[slot])
    copy_matrix(s.compliance_columns, stored.columns[slot])
    copy_matrix(s.frame, stored.frames[slot])
    return True


@part
def use_stored(stored, mode, eigenvalue, slot):
    """Use the factors of a slot, unless mode is None."""
    if mode is not None:
        s = mode.factored
        mode.c[C_M], mode.c[C_V] = eigenvalue * eigenvalue, eigenvalue
        put(1.0, stored.panels[slot], s.panels)
        copy_matrix(stored.columns[slot], s.compliance_columns)
        copy_matrix(stored.frames[slot], s.frame)


@part
def select(work, slot, eigenvalues):
    """Use the factors of a slot. eigenvalues (3,): c of the real mode, real and imaginary part of that of the complex one."""
    if work.stored.chosen[0] != slot:
        work.stored.chosen[0] = slot
        use_stored(work.stored.real, work.real, eigenvalues[0], slot)
        use_stored(work.stored.pair, work.pair, complex(eigenvalues[1], eigenvalues[2]), slot)
    return DONE


@part
def solve(work, factor, instant, right, phi, lam, dq, dlam):
    """Fill dq and dlam: `S dq + B^T dlam = -right`, `B dq = -phi`, B and the rows' curvature those of the last residual. False if singular."""
    k, links, drives, c_m = work.stage[instant], work.scene.links, work.drives[instant], factor.c[C_M]
    return corotated.solve(links, factor.factored, factor.workspace, drives, work.rotation[k], work.dz[k], lam, right, phi, c_m, dq, dlam)


@part
def solve_mode(work, instant, number, factor, residual, closing, lam, dq, multipliers):
    """Solve for dq and multipliers of a mode, rows and curvature being those of the middle stage. Returns a status; DONE if factor is None.

    number: REAL or PAIR. residual, closing: right-hand sides of the equations of motion and of the rows; they are overwritten. With mu:

    1. closing[1] becomes c r3 - r4; a first dmu solves the system of mu (assembly/rate_multipliers.py) for it
    2. its forces are added to the right-hand side; S and B give dq and dlam
    3. closing[1] -= H dq; dmu solves the system again

    keeps: 1 if the border of this factor was made in this step and is used again.
    """
    if factor is None:
        return DONE
    k, links, drives, c = work.stage[instant], work.scene.links, work.drives[instant], factor.c[C_V]
    workspace, dz = factor.workspace, work.dz[k]
    right = eliminate(workspace.elimination, work.u, residual)
    if work.tied:
        if work.anew[TIED]:
            work.anew[TIED] = 0
            joints.joint_rate_jacobian(links, drives, dz, work.vz, work.rates.rates)
            if not factor_rates(links, work.rates, drives, dz):
                return SINGULAR
        for e in range(closing.shape[1]):
            closing[1, e] = c * closing[0, e] - closing[1, e]
        if not solve_rates(work.rates, closing[1], multipliers[1]):
            return SINGULAR
        if factor.slowing.shape[0]:
            corotated.turn_frames(links, factor.factored, workspace, work.rotation[k])
        add_rate_forces(links, work.rates, factor.slowing, workspace, c, multipliers[1], right)
    workspace.keeps[0], work.anew[number] = 1 - work.anew[number], 0
    good = solve(work, factor, instant, right, closing[0], lam, dq, multipliers[0])
    workspace.keeps[0] = 0
    if work.tied:
        joints.point_values(links, dq, workspace.moved)
        subtract_rates(links, work.rates, workspace.moved, closing[1])
        good = solve_rates(work.rates, closing[1], multipliers[1]) and good
    recover(workspace.elimination, work.u, dq)
    return DONE if good else SINGULAR


def makes_factors(model):
    """True if compiled code makes the factors of a scene."""
    return not (model.bodies or model.damped or model.strains or model.own_forces)


def scene_factors(model, used):
    """The SceneFactors of a scene. used: False if compiled code makes none."""
    panels = columns = nodes = blocks = numbers = places = 0
    loads = np.empty((0, 0, 2))
    if used:
        empty, nodes, blocks = corotated.empty_corotated(model, float), model.n_factored, len(model.pattern[1])
        fronts, panels, columns = empty.fronts, len(empty.panels), len(empty.compliance_columns)
        numbers, places = fronts.size**2 + fronts.depth, len(fronts.nodes) + len(fronts.children)
        loads = model.once(corotated.unit_loads, of_shape=True)
    modes = [
        StoredFactors(
            np.empty((FACTORS, panels), kind),
            np.empty((FACTORS, columns, 2), kind),
            np.empty((FACTORS, nodes, 2)),
            np.empty((blocks, 2, 2), wide),
            np.empty(numbers, wide),
            np.empty(2 * nodes, kind),
        )
        for kind, wide in KINDS.values()
    ]
    return SceneFactors(*modes, np.full(1, -1), *np.empty((2, blocks, 2, 2)), loads, np.empty(places, np.int32))


def empty_factor(model, mode):
    """The Factor of a mode of Radau IIA for numbers that compiled code makes."""
    factored = corotated.empty_corotated(model, KINDS[mode.paired][0])
    return Factor(np.array([mode.value**2, mode.value]), factored, corotated.solve_workspace(model, factored), np.zeros((0, 2, 2)))


def factors_of_modes(model, modes, h, made_at):
    """({"real", "pair"}: Factor or None of each mode for steps of h, backend), made at t, q, v, a and lam, which made_at holds in their order."""
    t, at, factors = float(made_at[0]), np.split(made_at[1:], np.cumsum([model.n] * 3)), {"real": None, "pair": None}
    parts = symmetric_parts(model, *at[:2])
    for mode in modes:
        c, step = mode.value / h, model.step_matrix()
        step.factor(t, *at, c * c, c, parts)
        factors["pair" if mode.paired else "real"] = Factor(np.array([c * c, c]), step.corotated, step.workspace, slowing(model, t, at[0]))
    return factors, step.backend
