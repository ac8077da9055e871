"""Factors of scenes of rigid and reduced bodies, made in compiled code and stored in slots: entries MATRICES and SELECT of their table.

The step matrix is that of a scene without full plates, force elements and damping, so that its parts are K and M of the bodies alone.
"""

from typing import NamedTuple

import numpy as np
from numba import carray

from polyida import system as of
from polyida.assembly import compact, corotated
from polyida.errors import DONE, SINGULAR
from polyida.jit import entry, pack, part, served, shared
from polyida.jit.intrinsics import pointer
from polyida.linear.dense import copy_matrix, put
from polyida.linear.fronts import fill_panels
from polyida.linear.lu import FACTORS

KINDS = {False: (np.float32, float), True: (np.complex64, complex)}  # of the factors of a real and of a complex mode, and of their blocks


@pack
class Solver(NamedTuple):
    """Factor and workspace of a mode for kernels; c (1,): c of the mode; slowing: C A^T, see RateMultipliers."""

    c: np.ndarray
    factored: corotated.Corotated
    workspace: corotated.SolveWorkspace
    slowing: np.ndarray


@pack
class StoredFactors(NamedTuple):
    """Factors of S of a mode of Radau IIA in each slot: panels, compliance columns and frames, (slots, .) each.

    Scratch of one factorization: blocks, S as (nnz, 2, 2), and numbers, both in double precision; x, of the type of the panels.
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

    chosen (1,): the slot in use. K, M (nnz, 2, 2): blocks. loads: unit forces at the points. places: scratch.
    """

    real: StoredFactors
    pair: StoredFactors
    chosen: np.ndarray
    K: np.ndarray
    M: np.ndarray
    loads: np.ndarray
    places: np.ndarray


@part
def coordinates(work, at):
    """The coordinates at an address as (nodes, 2)."""
    return carray(pointer(at), work.still.shape)


@part
def mode_values(work, at):
    """c of the real mode, and the real and imaginary part of that of the complex one, at an address."""
    return carray(pointer(at), (3,))


@entry
def matrices(work, instant, u, v, a, lam, slot, c):
    """Factor S of both modes at u, in the slot; v, a and lam are not read."""
    factors, bodies, turn = work.factors, work.scene.compact, work.turn[0]
    factors.K[:], factors.M[:], factors.chosen[0] = 0.0, 0.0, slot
    compact.blocks(bodies, u, u, 0.0, 0.0, 1.0, factors.K)
    compact.blocks(bodies, u, u, 1.0, 0.0, 0.0, factors.M)
    for b in range(bodies.drag.shape[0]):
        compact.turn(bodies, b, u, turn)
    good = factored(factors, factors.real, work.real, c[0], turn, slot)
    return DONE if good and factored(factors, factors.pair, work.pair, complex(c[1], c[2]), turn, slot) else SINGULAR


@shared
def factored(x, stored, mode, c, rotation, slot):
    """Factor S of a mode with the blocks at hand, and store it. False if it is singular; True without a mode."""
    if mode is None:
        return True
    s = mode.factored
    for k in range(x.K.shape[0]):
        for i in range(2):
            for j in range(2):
                stored.blocks[k, i, j] = x.K[k, i, j] + c * c * x.M[k, i, j]
    mode.c[0] = c
    if not fill_panels(s.fronts, stored.blocks, s.panels, stored.numbers, x.places):
        return False
    corotated.fill_compliance_columns(s, s.compliance_columns, rotation, x.loads, stored.x)
    put(1.0, s.panels, stored.panels[slot])
    copy_matrix(s.compliance_columns, stored.columns[slot])
    copy_matrix(s.frame, stored.frames[slot])
    return True


@part
def restored(stored, mode, c, slot):
    """Use the factors of a slot, unless mode is None."""
    if mode is not None:
        mode.c[0], s = c, mode.factored
        put(1.0, stored.panels[slot], s.panels)
        copy_matrix(stored.columns[slot], s.compliance_columns)
        copy_matrix(stored.frames[slot], s.frame)


@part
def select(work, slot, c):
    """Use the factors of a slot."""
    if work.factors.chosen[0] != slot:
        work.factors.chosen[0] = slot
        restored(work.factors.real, work.real, c[0], slot)
        restored(work.factors.pair, work.pair, complex(c[1], c[2]), slot)
    return DONE


FACTOR_FUNCTIONS = {of.MATRICES: served(matrices, coordinates, None, None, None, None, mode_values), of.SELECT: served(select, mode_values)}


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


def empty_solver(model, mode):
    """A Solver of a mode for factors that compiled code makes."""
    factors = corotated.empty_corotated(model, KINDS[mode.paired][0])
    return Solver(np.array([mode.value]), factors, corotated.solve_workspace(model, factors), np.zeros((0, 2, 2)))
