"""The table of a scene: its compiled kernels as C functions."""

from contextlib import contextmanager, nullcontext
from functools import cache
from typing import NamedTuple

import numpy as np
from numba import carray, int64, typeof

from polyida.assembly import corotated, joints
from polyida.assembly import equilibrium as kernels
from polyida.assembly.compact import Compact
from polyida.assembly.condensation import Condensation, condensation
from polyida.assembly.increments import drive_table, gain_table
from polyida.assembly.optional import DAMPING, LAW_FORCES, LAW_SLOPES, PARTS, RELAXING, RENEW, optional_kernels
from polyida.assembly.projection import ConstraintProjection, constraint_projection, velocity_rate
from polyida.assembly.projection import project as project_rows
from polyida.assembly.relaxation import eliminate, recover
from polyida.environment import threads
from polyida.errors import DONE, HALF_TURN, INVERTED, NOT_FINITE, SINGULAR
from polyida.jit import entry, pack, part
from polyida.jit.intrinsics import address, call, pointer
from polyida.jit.user_functions import table_address
from polyida.linear.dense import clear, put
from polyida.linear.team import Helpers
from polyida.system import ACCEPT, BEGIN, CONSTRAINTS, ENTRIES, INSTANTS, PROJECT, RATE, RESIDUAL, SOLVE, STRAINS

SHARED = 20_000  # coordinates above which several threads share the solves
# constants of compiled code
# rows of SceneWork.points: displacements, forces; displacements and velocities at the start, increments
DZ, FORCES, START, VX, DX, DV = range(6)
H, TO_A, COSINE, INCREMENTAL, TO_V = range(5)  # of SceneWork.numbers


@pack
class Solid(NamedTuple):
    """The inverses of the bodies' masses, with masses at points, in the form of Compact; workspace (nodes, 2), and zeros."""

    inverse: Compact
    r: np.ndarray
    still: np.ndarray


@pack
class SceneWork(NamedTuple):
    """The workspace of a scene."""

    scene: tuple
    factored: corotated.Corotated
    workspace: corotated.SolveWorkspace
    projection: ConstraintProjection
    damp: np.ndarray  # (nodes, 2) workspace of the damping forces; (0, 2) without damping
    optional: np.ndarray  # of `optional_kernels`
    drives: np.ndarray  # (instants + 1, profiles, 3)
    gains: np.ndarray  # (instants, profiles, 3)
    rotation: np.ndarray  # (nodes, 2) at the last RESIDUAL
    points: np.ndarray  # (6, points, 2)
    numbers: np.ndarray  # the step, c_m of the factor, the least cosine of motors' angle errors, 1 if phi is computed by increments, c_v
    level: np.ndarray  # (m,)
    solid: Solid  # with empty arrays if no function reads it
    condensed: Condensation  # the pairs are then those without strains


@part
def pairs(w, at):
    """The coordinates at an address as (nodes, 2)."""
    return carray(pointer(at), w.rotation.shape)


@part
def rows(w, at):
    """The array (m,) at an address."""
    return carray(pointer(at), w.level.shape)


@part
def add_slowing(w, u, v, still, r):
    """Add damping and relaxation to r; still, 0 or 1: as of `add_relaxation`."""
    optional = w.optional
    if optional[DAMPING] != 0:
        call(optional[DAMPING], optional[PARTS], address(u), address(v), address(w.damp), address(r), 0, 0, 0)
    if optional[RELAXING] != 0:
        call(optional[RELAXING], optional[PARTS], still, address(u), address(v), address(r), 0, 0, 0)


@part
def add_forces(w, drives, u, v, r):
    """Add damping, relaxation and force elements to r. Returns a status."""
    add_slowing(w, u, v, 1, r)
    if w.optional[LAW_FORCES] != 0:
        return call(w.optional[LAW_FORCES], w.optional[PARTS], address(drives), address(u), address(v), address(r), 0, 0, 0)
    return DONE


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
    status = add_forces(w, drives, u, pairs(w, v), out)
    if w.condensed.calls[0] != 0:
        call(w.condensed.calls[2], w.condensed.calls[0], q, r, 0, 0, 0, 0, 0)
    return status


@entry
def begin(w, instant, q, v, c, d, e, f):
    """Store the points at a step's start."""
    joints.point_values(w.scene.links, pairs(w, q), w.points[START])
    joints.point_values(w.scene.links, pairs(w, v), w.points[VX])
    return DONE


@part
def renew_slopes(w, drives, dz, vz):
    """Renew the slopes of force elements on plates at the state of the last residual: points at dz with velocities vz."""
    if w.optional[RENEW] != 0:
        call(w.optional[RENEW], address(w), address(drives), address(dz), address(vz), 0, 0, 0, 0)


@entry
def new_slopes(w, drives, dz, vz, d, e, f, g):
    """`renew_slopes` of scenes with force elements and plates, in methods that ask for it; without plates, a solve costs less than the slopes."""
    own, optional = w.workspace.own, w.optional
    own[:] = 0.0
    call(optional[LAW_SLOPES], optional[PARTS], drives, dz, vz, address(w.numbers[TO_V:]), address(own), 0, 0)
    corotated.condense_states(w.scene.links.coupling, w.factored, own)
    corotated.turn_frames(w.scene.links, w.factored, w.workspace, w.rotation)
    corotated.turn_slopes(w.scene.links, w.workspace, -1.0, own, own)
    return DONE


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
    condensed = w.condensed.calls[0] != 0
    right = pairs(w, r) if condensed else eliminate(strains, pairs(w, q), pairs(w, r))
    state = rows(w, lam), right, rows(w, phi)
    regular = corotated.solve(
        s, w.factored, w.workspace, drives, w.rotation, w.points[DZ], state[0], state[1], state[2], w.numbers[TO_A], out[0], out[1]
    )
    if not condensed:
        recover(strains, pairs(w, q), out[0])
    return DONE if regular else SINGULAR


@entry
def rate(w, instant, q, v, out, d, e, f):
    """phi_q v + phi_t."""
    joints.point_values(w.scene.links, pairs(w, q), w.points[DX])
    velocity_rate(w.scene.links, w.drives[instant + 1], w.points[DX], pairs(w, v), w.projection)
    put(1.0, w.projection.rate, rows(w, out))
    return DONE


@entry
def project(w, instant, right, x, from_zero, d, e, f):
    """Change x by the least M-norm, so that B x falls by right; from_zero: x becomes the least x with B x = B x_before - right."""
    s, p, changes, vector = w.scene.links, w.projection, rows(w, right), pairs(w, x)
    put(1.0, changes, p.bias)
    if from_zero:
        joints.point_values(s, vector, p.vz)
        for k in range(changes.shape[0]):
            p.bias[k] -= joints.along(s, p.slopes, k, p.vz)
        clear(vector)
    return DONE if project_rows(s, p, p.bias, vector) else SINGULAR


@entry
def strains(w, instant, past, now, state, numbers, e, f):
    """Begin a step of the strains, or end it."""
    calls = w.condensed.calls
    if state == 0:
        return call(calls[3], calls[0], past, numbers, 0, 0, 0, 0, 0)
    return call(calls[4], calls[0], now, past, state, numbers, 0, 0, 0)


@entry
def idle(w, instant, b, c, d, e, f, g):
    """Do nothing: takes the place of a function that a scene does not need."""
    return DONE


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
        table[number] = table_address(function, int64 if function is idle else kind)
    return table


class SceneTable:
    """The table of a scene, with the methods of PythonTable.

    Several threads share the solves of more than SHARED coordinates, if the user allows them. condensed: True if the table serves steps of
    generalized-alpha, whose unknowns are the coordinates without strains.
    """

    longest, raised = INSTANTS, None
    entries = FUNCTIONS
    optional: tuple[int, ...] = LAW_FORCES, RELAXING, DAMPING

    def __init__(self, model, tied, incremental, condensed=False):
        self.model, links, condensed = model, model.arrays.links, condensed and bool(model.strains)
        self.unknowns = 2 * model.n_factored if condensed else model.n
        self.helpers = Helpers(threads()) if 2 * model.n_factored >= SHARED and threads() > 1 else None
        profiles, nodes, parts = len(model.profiles), (model.n_nodes, 2), condensation(model, condensed)
        self.w = {
            "scene": model.arrays._replace(relaxation=model.arrays.relaxation._replace(condensed=parts.calls[:2].copy())),
            "projection": constraint_projection(model),
            "damp": np.zeros(nodes if model.damped else (0, 2)),
            "optional": optional_kernels(model, *(number for number in self.optional if not (condensed and number == RELAXING))),
            "drives": np.zeros((INSTANTS + 1, profiles, 3)),
            "gains": np.zeros((INSTANTS, profiles, 3)),
            "rotation": np.zeros((self.unknowns // 2, 2)),
            "points": np.zeros((6, model.n_points, 2)),
            "numbers": np.array([0.0, 0.0, 1.0, float(incremental), 0.0]),
            "level": np.zeros(len(links.row_constant)),
            "solid": Solid(model.arrays.compact, *np.zeros((2, 0, 2))),
            "condensed": parts,
        }
        self.functions = self.work = None
        if not tied:
            self.entries = self.entries | {RATE: idle, PROJECT: idle}
        if condensed:
            self.entries = self.entries | {STRAINS: strains}

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
                    kind = typeof(self.work)
                    self.functions = addresses(kind, tuple(self.entries.items()))
                    if self.w["optional"][LAW_SLOPES] and self.model.bodies:
                        self.w["optional"][RENEW] = table_address(new_slopes, kind)
            yield self.functions, self.work.address
        self.raised = self.model.take_error()

    def take_error(self):
        """The exception of a Python function that compiled code called, or None."""
        error, self.raised = self.raised or self.model.take_error(), None
        return error

    def raise_error(self):
        """Raise that exception."""
        if (error := self.take_error()) is not None:
            raise error
