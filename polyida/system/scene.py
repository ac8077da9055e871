"""The table of a scene: its compiled kernels as C functions."""

from contextlib import contextmanager, nullcontext
from functools import cache
from typing import NamedTuple

import numpy as np
from numba import carray, typeof

from polyida.assembly import corotated, joints
from polyida.assembly import equilibrium as kernels
from polyida.assembly.compact import Compact
from polyida.assembly.equilibrium import add_damping
from polyida.assembly.increments import drive_table, gain_table
from polyida.assembly.own_laws import Laws, add_own_curvature, add_own_forces
from polyida.assembly.projection import ConstraintProjection, constraint_projection, velocity_rate
from polyida.assembly.projection import project as project_rows
from polyida.assembly.relaxation import add_relaxation, eliminate, recover
from polyida.environment import threads
from polyida.errors import DONE, HALF_TURN, INVERTED, NOT_FINITE, SINGULAR
from polyida.jit import entry, pack, part
from polyida.jit.intrinsics import pointer
from polyida.linear.dense import clear
from polyida.linear.team import Helpers
from polyida.system import ACCEPT, BEGIN, CONSTRAINTS, ENTRIES, INSTANTS, PROJECT, RATE, RESIDUAL, SOLVE, c_address

SHARED = 20_000  # coordinates above which several threads share the solves
# constants of compiled code
DZ, FORCES, START, VX, DX, DV = range(
    6
)  # rows of SceneWork.points: displacements, forces; displacements and velocities at the start, increments
H, TO_A, COSINE, INCREMENTAL, TO_V = range(5)  # of SceneWork.numbers


@pack
class Solid(NamedTuple):
    """The bodies' masses and their inverses, with masses at points, in the form of Compact; workspace (nodes, 2), and zeros."""

    mass: Compact
    inverse: Compact
    r: np.ndarray
    still: np.ndarray


@pack
class SceneWork(NamedTuple):
    """The workspace of a scene."""

    scene: tuple
    factored: corotated.Corotated
    workspace: corotated.SolveWorkspace
    projection: ConstraintProjection | None
    damp: np.ndarray | None  # (nodes, 2) workspace of the damping forces; None without damping
    laws: Laws | None
    drives: np.ndarray  # (instants + 1, profiles, 3)
    gains: np.ndarray  # (instants, profiles, 3)
    rotation: np.ndarray  # (nodes, 2) at the last RESIDUAL
    points: np.ndarray  # (6, points, 2)
    numbers: np.ndarray  # the step, c_m of the factor, the least cosine of motors' angle errors, 1 if phi is computed by increments, c_v
    level: np.ndarray  # (m,)
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
def add_forces(s, damp, laws, drives, u, v, still, r):
    """Add damping, relaxation (`still` as of add_relaxation) and force elements to r. An argument that is None: its branch is not compiled."""
    if damp is not None:
        add_damping(s, u, v, damp, r)
    add_relaxation(s, s.relaxation, u, None, v, still, r)
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
    add_forces(w.scene, w.damp, w.laws, drives, u, pairs(w, v), 1.0, out)
    return DONE


@entry
def begin(w, instant, q, v, c, d, e, f):
    """Store the points at a step's start, and renew the slopes of force elements on plates there: those of the factor turn with the bodies."""
    joints.point_values(w.scene.links, pairs(w, q), w.points[START])
    joints.point_values(w.scene.links, pairs(w, v), w.points[VX])
    renew_slopes(w, w.laws, w.drives[instant + 1], w.points[START], w.points[VX])
    return DONE


@part
def renew_slopes(w, laws, drives, dz, vz):
    """The same for points at dz with velocities vz; nothing if laws is None or without plates, whose solves cost more than the slopes."""
    if laws is not None:  # noqa: SIM102  numba drops the branch only if the condition stands alone
        if w.scene.plates.body_operator.shape[0] > 0:
            coupling, own = w.scene.links.coupling, w.workspace.own
            own[:] = 0.0
            add_own_curvature(laws, coupling, drives, dz, vz, 1.0, w.numbers[TO_V], own)
            corotated.condense_states(coupling, w.factored, own)


@entry
def constraints(w, instant, q, dd, dv, phi, rate, f):
    """phi and its rate, by increments since the step's start; or phi from positions."""
    s, dx, vx = w.scene.links, w.points[DX], w.points[DV]
    if w.numbers[INCREMENTAL] != 0.0:
        joints.point_values(s, pairs(w, dd), dx)
        joints.point_values(s, pairs(w, dv), vx)
        start = w.points[START], w.points[VX]
        joints.joint_change(s, w.drives[instant], w.gains[instant], w.numbers[H], start[0], start[1], dx, vx, rows(w, phi), rows(w, rate))
    else:
        joints.point_values(s, pairs(w, q), dx)
        joints.joint_forces(s, w.drives[instant + 1], dx, w.level, rows(w, phi), w.points[FORCES])
    return DONE


@entry
def solve(w, instant, q, lam, r, phi, dq, dlam):
    """dq and dlam of one Newton correction."""
    s, drives, out, strains = w.scene.links, w.drives[instant + 1], (pairs(w, dq), rows(w, dlam)), w.workspace.elimination
    right = eliminate(w.scene, w.scene.relaxation, strains, pairs(w, q), pairs(w, r))
    state = rows(w, lam), right, rows(w, phi)
    regular = corotated.solve(
        s, w.factored, w.workspace, drives, w.rotation, w.points[DZ], state[0], state[1], state[2], w.numbers[TO_A], out[0], out[1]
    )
    recover(w.scene, w.scene.relaxation, strains, pairs(w, q), out[0])
    return DONE if regular else SINGULAR


@entry
def rate(w, instant, q, v, out, d, e, f):
    """phi_q v + phi_t."""
    joints.point_values(w.scene.links, pairs(w, q), w.points[DX])
    projected_rate(w.scene.links, w.projection, w.drives[instant + 1], w.points[DX], pairs(w, v), rows(w, out))
    return DONE


@part
def projected_rate(s, p, drives, dz, v, out):
    """The same with a ConstraintProjection or None. Its own function: numba drops a branch only if an argument is None."""
    if p is not None:
        velocity_rate(s, drives, dz, v, p)
        for k in range(out.shape[0]):
            out[k] = p.rate[k]


@entry
def project(w, instant, right, x, from_zero, d, e, f):
    """Change x by the least M-norm, so that B x falls by right; from_zero: x becomes the least x with B x = B x_before - right."""
    return DONE if projected(w.scene.links, w.projection, rows(w, right), pairs(w, x), from_zero) else SINGULAR


@part
def projected(s, p, right, x, from_zero):
    """The same with a ConstraintProjection or None. Returns False if it is singular."""
    if p is None:
        return True
    for k in range(right.shape[0]):
        p.bias[k] = right[k]
    if from_zero:
        joints.point_values(s, x, p.vz)
        for k in range(right.shape[0]):
            p.bias[k] -= joints.along(s, p.slopes, k, p.vz)
        clear(x)
    return project_rows(s, p, p.bias, x)


@entry
def accept(w, instant, q, b, c, d, e, f):
    """Reject a state if a motor is on the wrong half-turn; q is that of the last RESIDUAL up to one correction."""
    return DONE if w.numbers[COSINE] > 0.0 else HALF_TURN


FUNCTIONS = {RESIDUAL: residual, BEGIN: begin, CONSTRAINTS: constraints, SOLVE: solve, RATE: rate, PROJECT: project, ACCEPT: accept}


@cache
def addresses(kind, entries):
    """The table of functions (number, function) for a type of workspaces."""
    table = np.zeros(ENTRIES, np.int64)
    for number, function in entries:
        table[number] = c_address(function, kind)
    return table


class SceneTable:
    """The table of a scene without Python, with the methods of PythonTable.

    Several threads share the solves of more than SHARED coordinates, if the user allows them.
    """

    longest = INSTANTS
    entries = FUNCTIONS

    def __init__(self, model, tied, incremental):
        self.model, links = model, model.arrays.links
        self.helpers = Helpers(threads()) if 2 * model.n_factored >= SHARED and threads() > 1 else None
        profiles, nodes = len(model.profiles), (model.n_nodes, 2)
        self.w = {
            "scene": model.arrays,
            "projection": constraint_projection(model) if tied else None,
            "damp": np.zeros(nodes) if model.damped else None,
            "laws": model.laws,
            "drives": np.zeros((INSTANTS + 1, profiles, 3)),
            "gains": np.zeros((INSTANTS, profiles, 3)),
            "rotation": np.zeros(nodes),
            "points": np.zeros((6, model.n_points, 2)),
            "numbers": np.array([0.0, 0.0, 1.0, float(incremental), 0.0]),
            "level": np.zeros(len(links.row_constant)),
            "solid": None,
        }
        self.functions = self.work = None

    def system(self, settings):
        return settings.step_matrix(self.model)

    def prepare(self, times, ends, h):
        self.times, count = times, len(times)
        drives = drive_table(self.model, times, ends)
        self.w["drives"][:count], self.w["gains"][: count - 1] = drives, gain_table(self.model, times, drives, h)
        self.w["numbers"][H] = h

    def factor(self, system, t, *at):
        system.factor(t, *at)
        return 1

    @contextmanager
    def at_work(self, system):
        own = system.workspace
        with self.helpers.at_work(system.corotated, own) if self.helpers else nullcontext(own) as workspace:
            self.w["numbers"][[TO_A, TO_V]] = system.c_m, system.c_v
            if self.work is None or self.work.workspace is not workspace:
                before, self.work = self.work, SceneWork(factored=system.corotated, workspace=workspace, **self.w)
                if before is None or typeof(self.work) != typeof(before):
                    self.functions = addresses(typeof(self.work), tuple(self.entries.items()))
            yield self.functions, self.work.address

    def raise_error(self):
        """Do nothing: no function raises."""
