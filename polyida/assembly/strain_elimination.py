"""Elimination of the relaxed strains of viscoelastic plates from a step's system.

With `dv = c_v dq` and c = c_m/c_v the coordinates of the strains (relaxation.py) are eliminated. Their residuals r become the strains
`e = unit tau r / (mass (1 + c tau))`, and with B = dE/dq

    r of the nodes += B^T D sum g e,   D -> kappa D, kappa = 1 - sum g / (1 + c tau),   unit c_v dq = B dq / (1 + c tau) - e

so that the pattern and the frames of the plates' factor stay as they are: `eliminate` changes the residuals of the nodes, a solve with the
plates' factor follows, and `recover` gives the corrections dq of the strains.
"""

from typing import NamedTuple

import numpy as np
from numba import carray, typeof

from polyida.assembly.arrays import SceneArrays
from polyida.assembly.relaxation import add_real, add_scaled, change_strain, pairs_of_body, relax_body, strains_of
from polyida.errors import DONE
from polyida.jit import entry, pack, part, served
from polyida.jit.intrinsics import call, pointer
from polyida.jit.user_functions import table_address
from polyida.linear.dense import copy_matrix, put

WORKSPACE, ELIMINATE, RECOVER = range(3)  # of Elimination.calls


@pack
class Elimination(NamedTuple):
    """Workspace of the solves of a factor."""

    scene: SceneArrays
    rates: np.ndarray  # (2,) c and c_v
    parts: np.ndarray  # (1, i) if the numbers are complex, else (1,): factors of the real parts that make up a number
    strains: np.ndarray  # (numbers of the strains,) e
    r: np.ndarray  # (nodes, 2) residuals of the nodes without strains
    force: np.ndarray  # (nodes, 2) real; force or displacements of a body
    whole: np.ndarray  # (all nodes, 2) residuals or corrections of all coordinates
    calls: (
        np.ndarray
    )  # (3,) address of this at WORKSPACE, then those of the C functions ELIMINATE and RECOVER; 0 in a scene without strains


def elimination_of(model, dtype):
    """The Elimination of a scene for numbers of a dtype. Its functions are compiled if the scene has relaxed strains."""
    x = model.arrays.relaxation
    used = len(x.share) > 0
    nodes = (x.first, 2) if used else (0, 2)
    all_nodes = (model.n_nodes, 2) if used else (0, 2)
    workspace = Elimination(
        scene=model.arrays,
        rates=np.zeros(2, dtype),
        parts=np.array([1.0, 1j] if np.dtype(dtype).kind == "c" else [1.0]),
        strains=np.zeros(x.start[-1], dtype),
        r=np.zeros(nodes, dtype),
        force=np.zeros(nodes),
        whole=np.zeros(all_nodes, dtype),
        calls=np.zeros(3, np.int64),
    )
    if used:
        workspace.calls[:] = workspace.address, *(table_address(function, typeof(workspace)) for function in FUNCTIONS)
    return workspace


@entry
def eliminate(work, moved, residual):
    """Return the residuals of the nodes with the strains eliminated, (nodes, 2), from those of all coordinates.

    moved: displacements. In a scene without strains the result is residual itself.
    """
    if work.calls[WORKSPACE] == 0:
        return residual
    copy_matrix(residual, work.whole)
    call(work.calls[ELIMINATE], (work.calls[WORKSPACE], moved))
    return work.r


@entry
def recover(work, moved, dq):
    """Fill the corrections of the strains in dq (all nodes, 2), from those of the nodes there; work holds the e of `eliminate`."""
    if work.calls[WORKSPACE] != 0:
        copy_matrix(dq, work.whole)
        call(work.calls[RECOVER], (work.calls[WORKSPACE], moved))
        copy_matrix(work.whole, dq)


@part
def node_rows(work, at):
    """Return the array (all nodes, 2) at an address."""
    return carray(pointer(at), work.whole.shape)


@part
def eliminate_whole(work, moved):
    """Fill work.r, the residuals of the nodes, from those of all coordinates in work.whole, at the displacements `moved`."""
    scene, x = work.scene, work.scene.relaxation
    copy_matrix(work.whole[: x.first], work.r)
    residuals = work.whole.reshape(-1)[2 * x.first :]
    for body in range(x.start.shape[0] - 1):
        if x.terms[body] == x.terms[body + 1]:
            continue
        count = strains_of(x, body)
        first, end = pairs_of_body(scene, body)
        viscous_strain, strain = np.empty(count), np.empty(count)
        at = x.start[body]
        for k in range(x.terms[body], x.terms[body + 1]):  # e = unit tau r / (mass (1 + c tau))
            factor = x.unit[body] * x.time[k] / (x.mass * (1.0 + work.rates[0] * x.time[k]))
            put(factor, residuals[at : at + count], work.strains[at : at + count])
            at += count
        for p in range(work.parts.shape[0]):
            viscous_strain[:] = 0.0  # becomes sum g e
            work.force[:] = 0.0
            at = x.start[body]
            for k in range(x.terms[body], x.terms[body + 1]):
                add_real(viscous_strain, x.share[k], work.strains[at : at + count], p)
                at += count
            relax_body(scene, body, moved, None, viscous_strain, work.force, strain)
            for i in range(first, end):
                work.r[i, 0] -= work.parts[p] * work.force[i, 0]
                work.r[i, 1] -= work.parts[p] * work.force[i, 1]
    return DONE


@part
def recover_whole(work, moved):
    """Fill the corrections of the strains in work.whole, from those of the nodes there, at the displacements `moved`."""
    scene, x, dq = work.scene, work.scene.relaxation, work.whole
    changes = dq.reshape(-1)[2 * x.first :]
    c, c_v = work.rates[0], work.rates[1]
    for body in range(x.start.shape[0] - 1):
        if x.terms[body] == x.terms[body + 1]:
            continue
        count = strains_of(x, body)
        first, end = pairs_of_body(scene, body)
        strain = np.empty(count)
        for p in range(work.parts.shape[0]):
            for i in range(first, end):
                for k in range(2):
                    work.force[i, k] = dq[i, k].real if p == 0 else dq[i, k].imag
            change_strain(scene, body, moved, work.force, strain)
            at = x.start[body]
            for k in range(x.terms[body], x.terms[body + 1]):
                own = changes[at : at + count]  # (B dq / (1 + c tau) - e) / (unit c_v)
                if p == 0:
                    put(-1.0 / (x.unit[body] * c_v), work.strains[at : at + count], own)
                add_scaled(own, work.parts[p] / (x.unit[body] * c_v * (1.0 + c * x.time[k])), strain)
                at += count
    return DONE


FUNCTIONS = served(eliminate_whole, first=node_rows), served(recover_whole, first=node_rows)
