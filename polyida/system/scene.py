"""The table of a scene: its compiled kernels as C functions."""

from contextlib import contextmanager
from functools import cache
from typing import NamedTuple

import numpy as np
from numba import carray, typeof

from polyida.assembly import corotated, joints
from polyida.assembly import equilibrium as kernels
from polyida.assembly.compact import Compact
from polyida.assembly.equilibrium import add_damping
from polyida.assembly.increments import drive_table, gain_table
from polyida.assembly.own_laws import Laws, add_own_forces
from polyida.assembly.projection import Tie, velocity_rate
from polyida.assembly.projection import project as project_rows
from polyida.assembly.projection import tie as tie_of
from polyida.environment import threads
from polyida.errors import DONE, HALF_TURN, INVERTED, NOT_FINITE, SINGULAR
from polyida.jit import entry, pack, part
from polyida.jit.intrinsics import pointer
from polyida.linear.dense import clear
from polyida.linear.team import Helpers
from polyida.system import ACCEPT, CLOSE, ENTRIES, HOLD, INSTANTS, PROJECT, RATE, RESIDUAL, SOLVE, c_address

SHARED = 20_000  # coordinates from which on the threads that are asked for share the solves
# constants of compiled code
DZ, FORCES, START, VX, DX, DV = range(6)  # rows of SceneWork.points: displacements and forces; what a step begins from and adds
H, TO_A, COSINE, INCREMENTAL = range(4)  # of SceneWork.numbers


@pack
class Solid(NamedTuple):
    """Bodies' masses and the inverses of these, those at their points included, in the form of Compact; scratch (nodes, 2), and zeros."""

    mass: Compact
    inverse: Compact
    r: np.ndarray
    still: np.ndarray


@pack
class SceneWork(NamedTuple):
    """The workspace of a scene: its arrays, the factor with its scratch, and what is None if there is nothing of the kind.

    drives (instants + 1, profiles, 3), gains (instants, profiles, 3): of the profiles; rotation (nodes, 2): of the nodes at the last RESIDUAL;
    points (6, points, 2); numbers: the step, c_m of the factor, the least cosine of motors' angles, and whether phi is carried by increments.
    """

    scene: tuple
    factored: corotated.Corotated
    room: corotated.Room
    tie: Tie | None
    damp: np.ndarray | None
    laws: Laws | None
    drives: np.ndarray
    gains: np.ndarray
    rotation: np.ndarray
    points: np.ndarray
    numbers: np.ndarray
    level: np.ndarray
    solid: Solid | None


@part
def pairs(w, at):
    """The coordinates at an address as (nodes, 2)."""
    return carray(pointer(at), w.rotation.shape)


@part
def rows(w, at):
    """The array (m,) at an address."""
    return carray(pointer(at), w.level.shape)


@part
def add_forces(s, damp, laws, drives, u, v, r):
    """Damping and force elements; what is None is not compiled."""
    if damp is not None:
        add_damping(s, u, v, damp, r)
    if laws is not None:
        add_own_forces(laws, s.links, drives, u, v, r)


@entry
def residual(w, instant, q, v, a, lam, r, phi):
    """r and phi, from positions."""
    u, out, drives = pairs(w, q), pairs(w, r), w.drives[instant + 1]
    det, cosine = kernels.equilibrium(
        w.scene, drives, u, pairs(w, a), rows(w, lam), out, rows(w, phi), w.rotation, w.points[DZ], w.points[FORCES]
    )
    w.numbers[COSINE] = cosine
    if not det > 0.0:
        return INVERTED if det <= 0.0 else NOT_FINITE
    add_forces(w.scene, w.damp, w.laws, drives, u, pairs(w, v), out)
    return DONE


@entry
def hold(w, instant, q, v, c, d, e, f):
    """Take up the points at a step's start."""
    joints.point_values(w.scene.links, pairs(w, q), w.points[START])
    joints.point_values(w.scene.links, pairs(w, v), w.points[VX])
    return DONE


@entry
def close(w, instant, q, dd, dv, phi, rate, f):
    """phi and its rate, by what the step adds to those at its start; or phi from positions."""
    s, dx, vx = w.scene.links, w.points[DX], w.points[DV]
    if w.numbers[INCREMENTAL] != 0.0:
        joints.point_values(s, pairs(w, dd), dx)
        joints.point_values(s, pairs(w, dv), vx)
        given = w.points[START], w.points[VX]
        joints.joint_change(s, w.drives[instant], w.gains[instant], w.numbers[H], given[0], given[1], dx, vx, rows(w, phi), rows(w, rate))
    else:
        joints.point_values(s, pairs(w, q), dx)
        joints.joint_forces(s, w.drives[instant + 1], dx, w.level, rows(w, phi), w.points[FORCES])
    return DONE


@entry
def solve(w, instant, q, lam, r, phi, dq, dlam):
    """dq and dlam of one Newton correction."""
    drives = w.drives[instant + 1]
    good = corotated.solve(
        w.scene.links, w.factored, w.room, drives, w.rotation, w.points[DZ], rows(w, lam), pairs(w, r), rows(w, phi), w.numbers[TO_A],
        pairs(w, dq), rows(w, dlam),
    )  # fmt: skip
    return DONE if good else SINGULAR


@entry
def rate(w, instant, q, v, found, d, e, f):
    """phi_q v + phi_t."""
    joints.point_values(w.scene.links, pairs(w, q), w.points[DX])
    tied_rate(w.scene.links, w.tie, w.drives[instant + 1], w.points[DX], pairs(w, v), rows(w, found))
    return DONE


@part
def tied_rate(s, t, drives, dz, v, found):
    """The rate of the rows, with their slopes in t."""
    if t is not None:
        velocity_rate(s, drives, dz, v, t)
        for k in range(found.shape[0]):
            found[k] = t.rate[k]


@entry
def project(w, instant, wanted, x, anew, d, e, f):
    """B x falls by rows, by a change of x of the least M-norm; anew: x becomes the change that has the same B x."""
    return DONE if tied_project(w.scene.links, w.tie, rows(w, wanted), pairs(w, x), anew) else SINGULAR


@part
def tied_project(s, t, wanted, x, anew):
    """The same with the slopes in t. False if it is singular."""
    if t is None:
        return True
    for k in range(wanted.shape[0]):
        t.bias[k] = wanted[k]
    if anew:
        joints.point_values(s, x, t.vz)
        for k in range(wanted.shape[0]):
            t.bias[k] -= joints.along(s, t.slopes, k, t.vz)
        clear(x)
    return project_rows(s, t, t.bias, x)


@entry
def accept(w, instant, q, b, c, d, e, f):
    """Whether every motor stands on the right half-turn; q is that of the last RESIDUAL, but for one correction."""
    return DONE if w.numbers[COSINE] > 0.0 else HALF_TURN


FUNCTIONS = {RESIDUAL: residual, HOLD: hold, CLOSE: close, SOLVE: solve, RATE: rate, PROJECT: project, ACCEPT: accept}


@cache
def addresses(kind, entries):
    """The table of the functions (number, function) for workspaces of a type."""
    found = np.zeros(ENTRIES, np.int64)
    for number, function in entries:
        found[number] = c_address(function, kind)
    return found


class SceneTable:
    """The table of a scene without Python in it, its solves by several threads where it has `SHARED` coordinates and these are asked for."""

    longest = INSTANTS
    entries = FUNCTIONS

    def __init__(self, model, tied, incremental):
        self.model, links = model, model.arrays.links
        self.helpers = Helpers(threads() if model.n >= SHARED else 1)
        profiles, nodes = len(model.profiles), (model.n_nodes, 2)
        self.w = {
            "scene": model.arrays,
            "tie": tie_of(model) if tied else None,
            "damp": np.zeros(nodes) if model.damped else None,
            "laws": model.laws,
            "drives": np.zeros((INSTANTS + 1, profiles, 3)),
            "gains": np.zeros((INSTANTS, profiles, 3)),
            "rotation": np.zeros(nodes),
            "points": np.zeros((6, model.n_points, 2)),
            "numbers": np.array([0.0, 0.0, 1.0, float(incremental)]),
            "level": np.zeros(len(links.row_constant)),
            "solid": None,
        }
        self.functions = self.work = None

    def system(self, settings):
        """What factors the step matrix, not factored yet."""
        return settings.step_matrix(self.model)

    def prepare(self, times, ends, h):
        """Get ready for steps between the times; ends: the first and the last, beside them where there is a kink."""
        self.times, count = times, len(times)
        drives = drive_table(self.model, times, ends)
        self.w["drives"][:count], self.w["gains"][: count - 1] = drives, gain_table(self.model, times, drives, h)
        self.w["numbers"][H] = h

    def factor(self, system, t, *at):
        """Factor the system near t. Returns the number of residuals that it took."""
        system.factor(t, *at)
        return 1

    @contextmanager
    def at_work(self, system):
        """(addresses of the functions, address of the workspace) with a factored system."""
        with self.helpers.at_work(system.corotated, system.room) as room:
            self.w["numbers"][TO_A] = system.c_m
            if self.work is None or self.work.room is not room:
                self._take(SceneWork(factored=system.corotated, room=room, **self.w))
            yield self.functions, self.work.address

    def _take(self, work):
        """Take a workspace; functions are compiled for its type."""
        kind = typeof(work)
        if self.work is None or kind != typeof(self.work):
            self.functions = addresses(kind, tuple(self.entries.items()))
        self.work = work

    def raise_left(self):
        """Nothing: no function raises."""
