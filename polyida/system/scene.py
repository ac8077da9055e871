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
from polyida.jit import entry, pack, part, served
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
def pairs(work, at):
    """The coordinates at an address as (nodes, 2)."""
    return carray(pointer(at), work.rotation.shape)


@part
def rows(work, at):
    """The array (m,) at an address."""
    return carray(pointer(at), work.level.shape)


@part
def add_slowing(work, u, v, still, r):
    """Add damping and relaxation to r; still, 0 or 1: as of `add_relaxation`."""
    optional = work.optional
    if optional[DAMPING] != 0:
        call(optional[DAMPING], optional[PARTS], address(u), address(v), address(work.damp), address(r), 0, 0, 0)
    if optional[RELAXING] != 0:
        call(optional[RELAXING], optional[PARTS], still, address(u), address(v), address(r), 0, 0, 0)


@part
def add_forces(work, drives, u, v, r):
    """Add damping, relaxation and force elements to r. Returns a status."""
    add_slowing(work, u, v, 1, r)
    if work.optional[LAW_FORCES] != 0:
        return call(work.optional[LAW_FORCES], work.optional[PARTS], address(drives), address(u), address(v), address(r), 0, 0, 0)
    return DONE


@part
def residual(work, instant, u, v, a, lam, r, phi):
    """r and phi, from positions."""
    drives, points = work.drives[instant + 1], work.points
    det, cosine = kernels.equilibrium(work.scene, drives, u, a, lam, r, phi, work.rotation, points[DZ], points[FORCES])
    work.numbers[COSINE] = cosine
    if not det > 0.0:
        return INVERTED if det <= 0.0 else NOT_FINITE
    status = add_forces(work, drives, u, v, r)
    if work.condensed.calls[0] != 0:
        call(work.condensed.calls[2], work.condensed.calls[0], address(u), address(r), 0, 0, 0, 0, 0)
    return status


@part
def begin(work, instant, u, v):
    """Store the points at a step's start."""
    joints.point_values(work.scene.links, u, work.points[START])
    joints.point_values(work.scene.links, v, work.points[VX])
    return DONE


@part
def renew_slopes(work, drives, dz, vz):
    """Renew the slopes of force elements on plates at the state of the last residual: points at dz with velocities vz."""
    if work.optional[RENEW] != 0:
        call(work.optional[RENEW], address(work), address(drives), address(dz), address(vz), 0, 0, 0, 0)


@entry
def new_slopes(work, drives, dz, vz, d, e, f, g):
    """`renew_slopes` of scenes with force elements and plates, in methods that ask for it; without plates, a solve costs less than the slopes."""
    own, optional = work.workspace.own, work.optional
    own[:] = 0.0
    call(optional[LAW_SLOPES], optional[PARTS], drives, dz, vz, address(work.numbers[TO_V:]), address(own), 0, 0)
    corotated.condense_states(work.scene.links.coupling, work.factored, own)
    corotated.turn_frames(work.scene.links, work.factored, work.workspace, work.rotation)
    corotated.turn_slopes(work.scene.links, work.workspace, -1.0, own, own)
    return DONE


@part
def constraints(work, instant, u, du, dv, phi, rate):
    """phi and its rate, by increments since the step's start; or phi from positions."""
    links, points = work.scene.links, work.points
    if work.numbers[INCREMENTAL] != 0.0:
        joints.point_values(links, du, points[DX])
        joints.point_values(links, dv, points[DV])
        drives, gains = work.drives[instant], work.gains[instant]
        joints.joint_change(links, drives, gains, work.numbers[H], points[START], points[VX], points[DX], points[DV], phi, rate)
    else:
        joints.point_values(links, u, points[DX])
        joints.joint_forces(links, work.drives[instant + 1], points[DX], work.level, phi, points[FORCES])
    return DONE


@part
def solve(work, instant, u, lam, r, phi, dq, dlam):
    """dq and dlam of one Newton correction."""
    drives, strains = work.drives[instant + 1], work.workspace.elimination
    condensed = work.condensed.calls[0] != 0
    right = r if condensed else eliminate(strains, u, r)
    regular = corotated.solve(
        work.scene.links,
        work.factored,
        work.workspace,
        drives,
        work.rotation,
        work.points[DZ],
        lam,
        right,
        phi,
        work.numbers[TO_A],
        dq,
        dlam,
    )
    if not condensed:
        recover(strains, u, dq)
    return DONE if regular else SINGULAR


@part
def rate(work, instant, u, v, out):
    """phi_q v + phi_t."""
    joints.point_values(work.scene.links, u, work.points[DX])
    velocity_rate(work.scene.links, work.drives[instant + 1], work.points[DX], v, work.projection)
    put(1.0, work.projection.rate, out)
    return DONE


@part
def project(work, instant, changes, x, from_zero):
    """Change x by the least M-norm, so that B x falls by `changes`; from_zero: x becomes the least x with B x = B x_before - changes."""
    links, projection = work.scene.links, work.projection
    put(1.0, changes, projection.bias)
    if from_zero:
        joints.point_values(links, x, projection.vz)
        for k in range(changes.shape[0]):
            projection.bias[k] -= joints.along(links, projection.slopes, k, projection.vz)
        clear(x)
    return DONE if project_rows(links, projection, projection.bias, x) else SINGULAR


@part
def strains(work, instant, past, now, state, numbers):
    """Begin a step of the strains if state is 0, or end it; addresses of arrays."""
    calls = work.condensed.calls
    if state == 0:
        return call(calls[3], calls[0], past, numbers, 0, 0, 0, 0, 0)
    return call(calls[4], calls[0], now, past, state, numbers, 0, 0, 0)


@entry
def idle(work, instant, b, c, d, e, f, g):
    """Do nothing: takes the place of a function that a scene does not need."""
    return DONE


@part
def accept(work, instant):
    """Reject a state if a motor is on the wrong half-turn; q is that of the last RESIDUAL up to one correction."""
    return DONE if work.numbers[COSINE] > 0.0 else HALF_TURN


FUNCTIONS = {
    RESIDUAL: served(residual, pairs, pairs, pairs, rows, pairs, rows),
    BEGIN: served(begin, pairs, pairs),
    CONSTRAINTS: served(constraints, pairs, pairs, pairs, rows, rows),
    SOLVE: served(solve, pairs, rows, pairs, rows, pairs, rows),
    RATE: served(rate, pairs, pairs, rows),
    PROJECT: served(project, rows, pairs, None),
    ACCEPT: served(accept),
}
OF_STRAINS = {STRAINS: served(strains, None, None, None, None)}


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
            self.entries = self.entries | OF_STRAINS

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
