"""The table of a scene: its compiled kernels as C functions, the same for every integrator.

A step has one instant for each of the s stages of the method: one at its end (generalized-alpha, IDA), s stages (Radau IIA), or its middle and
its end (energy-momentum). Every stage has its own rotations of the nodes and places of the points. The factors are made in the frames of the
nodes: a correction of all stages together is solved for in the frame of the middle one. Residuals are rotated into it, R(q_k) R(q_i)^T node by
node, and the correction is rotated back.

A part that a scene or a method does not need has size 0, so that all have one type, and the functions are compiled once.
"""

from contextlib import contextmanager, nullcontext
from functools import cache
from typing import NamedTuple

import numpy as np
from numba import carray, int64, typeof

from polyida import system as table
from polyida.assembly import corotated, joints, reduced_kernels
from polyida.assembly import equilibrium as kernels
from polyida.assembly.condensation import ADD_CONDENSED, BEGIN_STRAINS, END_STRAINS, WORKSPACE, Condensation, condensation
from polyida.assembly.increments import Moves, drive_table, gain_table, moves, take_step
from polyida.assembly.optional import DAMPING, LAW_DAMPING, LAW_FORCES, LAW_SLOPES, PARTS, RELAXING, RENEW, optional_kernels
from polyida.assembly.projection import ConstraintProjection, constrain, constraint_projection, velocity_rate
from polyida.assembly.projection import project as project_rows
from polyida.assembly.rate_multipliers import RateMultipliers
from polyida.assembly.relaxation import eliminate, recover
from polyida.environment import threads
from polyida.errors import DONE, HALF_TURN, INVERTED, NOT_FINITE, SINGULAR
from polyida.jit import fast, pack, part, served
from polyida.jit.intrinsics import call, complex_pointer, pointer
from polyida.jit.user_functions import table_address
from polyida.linear.dense import clear, copy_matrix, put
from polyida.linear.team import Helpers
from polyida.system import INSTANTS
from polyida.system import scene_factors as factors
from polyida.system.scene_factors import C_V, Factor, SceneFactors, scene_factors

SHARED = 20_000  # coordinates above which several threads share the solves
# constants of compiled code
# rows of SceneWork.points. `begin` stores displacements and velocities at a step's beginning in START and VX; `constraints` reads them. DX and DV
# are their increments there, elsewhere scratch. MIDDLE writes to all four.
START, VX, DX, DV = range(4)


@pack
class SceneWork(NamedTuple):
    """The workspace of a scene and the s stages of a method."""

    scene: tuple
    real: Factor | None
    pair: Factor | None  # the complex one
    stored: SceneFactors
    projection: ConstraintProjection
    rates: RateMultipliers  # of mu
    condensed: Condensation  # the pairs are then those without strains
    optional: np.ndarray  # of `optional_kernels`
    moves: Moves  # profiles with formulas
    c: np.ndarray  # (s,) times of the stages since the beginning of a step, over its length
    h: np.ndarray  # (1,) that length
    stage: np.ndarray  # (instants,) number of the stage of an instant
    begin: np.ndarray  # (instants,) row of drives at the beginning of its step
    drives: np.ndarray  # (instants + 1, profiles, 3) values of the profiles
    gains: np.ndarray  # (instants + 1, profiles, 3) their changes since the beginning of the step
    incremental: bool  # phi is computed by increments
    tied: bool  # there is mu
    keeps_middle: bool  # residuals store vz and u
    strict: bool  # a residual on the wrong half-turn of a motor is refused at once
    anew: np.ndarray  # (3,) 1 if the border of the real or complex factor, or the system of mu, is computed at the next solve
    cosine: np.ndarray  # (1,) the least of motors' angle errors at the last residual
    rotation: np.ndarray  # (s, ., 2) of the pairs without relaxed strains, at the last residual of a stage
    dz: np.ndarray  # (s, points, 2) places of the points there
    turn: np.ndarray  # (s, nodes, 2) rotations from a stage to the middle one; (0, nodes, 2) of methods with one factor a stage
    points: np.ndarray  # (4, points, 2)
    forces: np.ndarray  # (points, 2)
    vz: np.ndarray  # (points, 2) velocities in the middle stage; (0, 2) where nothing reads them
    u: np.ndarray  # (nodes, 2) displacements in the middle stage, if plates relax and the solve needs them; else (0, 2)
    damp: np.ndarray  # (nodes, 2) workspace of the damping forces; (0, 2) without damping
    nodal: np.ndarray  # (2, nodes, 2) scratch
    still: np.ndarray  # (nodes, 2) zeros
    level: np.ndarray  # (m,) zeros
    spare: np.ndarray  # (m,) scratch
    inverse: reduced_kernels.ReducedArrays  # inverse masses of the bodies, with masses at points, for `acceleration`
    inverse_matrix: np.ndarray  # (nodes, nodes) complex M^-1 in its place, or (0, 0)


@part
def pairs(work, at):
    """The coordinates at an address as (nodes, 2)."""
    return carray(pointer(at), work.still.shape)


@part
def complex_pairs(work, at):
    """The complex coordinates at an address as (nodes, 2)."""
    return carray(complex_pointer(at), work.still.shape)


@part
def rows(work, at):
    """The array (m,) at an address."""
    return carray(pointer(at), work.level.shape)


@part
def both_rows(work, at):
    """The array (2, m) at an address: rows of phi, and of phi'."""
    return carray(pointer(at), (2, work.level.shape[0]))


@part
def complex_rows(work, at):
    """The complex array (2, m) at an address."""
    return carray(complex_pointer(at), (2, work.level.shape[0]))


@part
def stages(work, at):
    """The coordinates of all stages at an address, (s, nodes, 2)."""
    return carray(pointer(at), work.turn.shape)


@part
def step_times(work, at):
    """h, t and the times of the stages at an address."""
    return carray(pointer(at), (3 + work.c.shape[0],))


@part
def prepare(work, first, times):
    """Evaluate loads and motors for a step."""
    take_step(work.moves, times[0], times[1], times[2], times[3:], work.c, work.drives[first:], work.gains[first:])
    return DONE


@part
def begin(work, instant, u, v, times):
    """Store the points at a step's beginning, and h, which is the first of the times at an address, or was prepared."""
    if times != 0:
        work.h[0] = carray(pointer(times), (1,))[0]
    joints.point_values(work.scene.links, u, work.points[START])
    joints.point_values(work.scene.links, v, work.points[VX])
    return DONE


@part
def add_slowing(work, u, v, still, r):
    """Add damping and relaxation to r; still, 0 or 1: as of `add_relaxation`."""
    optional = work.optional
    if optional[DAMPING] != 0:
        call(optional[DAMPING], (optional[PARTS], u, v, work.damp, r))
    if optional[RELAXING] != 0:
        call(optional[RELAXING], (optional[PARTS], still, u, v, r))


@part
def add_forces(work, drives, u, v, r):
    """Add damping, relaxation and force elements to r. Returns a status."""
    add_slowing(work, u, v, 1, r)
    if work.optional[LAW_FORCES] != 0:
        return call(work.optional[LAW_FORCES], (work.optional[PARTS], drives, u, v, r))
    return DONE


@part
def residual(work, instant, u, v, a, lam, r, phi):
    """r and phi, from positions."""
    k, drives = work.stage[instant], work.drives[instant]
    det, cosine = kernels.equilibrium(work.scene, drives, u, a, lam, r, phi, work.rotation[k], work.dz[k], work.forces)
    work.cosine[0] = cosine
    if not det > 0.0:
        return INVERTED if det <= 0.0 else NOT_FINITE
    if work.strict and not cosine > 0.0:
        return HALF_TURN
    status = add_forces(work, drives, u, v, r)
    if work.condensed.calls[WORKSPACE] != 0:
        call(work.condensed.calls[ADD_CONDENSED], (work.condensed.calls[WORKSPACE], u, r))
    if work.keeps_middle and k == work.rotation.shape[0] // 2:
        copy_matrix(u[: work.u.shape[0]], work.u)
        joints.point_values(work.scene.links, v, work.vz)
    return status


@part
def constraints(work, instant, u, du, dv, phi, rate):
    """phi and its rate, by increments since the step's beginning; or phi from positions."""
    links, points = work.scene.links, work.points
    if work.incremental:
        joints.point_values(links, du, points[DX])
        joints.point_values(links, dv, points[DV])
        drives, gains, h = work.drives[work.begin[instant]], work.gains[instant], work.c[work.stage[instant]] * work.h[0]
        joints.joint_change(links, drives, gains, h, points, phi, rate)
    else:
        joints.point_values(links, u, points[DX])
        joints.joint_forces(links, work.drives[instant], points[DX], work.level, phi, work.forces)
    return DONE


@part
def rate(work, instant, u, v, out):
    """phi_q v + phi_t."""
    dz = work.dz[work.stage[instant]]
    joints.point_values(work.scene.links, u, dz)
    velocity_rate(work.scene.links, work.drives[instant], dz, v, work.projection)
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
def accept(work, instant):
    """Reject a state if a motor is on the wrong half-turn; q is that of the last RESIDUAL up to one correction."""
    return DONE if work.cosine[0] > 0.0 else HALF_TURN


@part
def acceleration(work, instant, u, v, a, lam):
    """`[[M, B^T], [B, 0]] (a, lam) = (-g, -phi_bias)`; a stays as it is if this is singular."""
    k, drives, g, free = work.stage[instant], work.drives[instant], work.nodal[0], work.nodal[1]
    kernels.equilibrium(work.scene, drives, u, work.still, work.level, g, work.spare, work.rotation[k], work.dz[k], work.forces)
    add_forces(work, drives, u, v, g)
    for i in range(work.inverse_matrix.shape[0]):
        total = 0.0j
        for j in range(g.shape[0]):
            total -= work.inverse_matrix[i, j] * complex(g[j, 0], g[j, 1])
        free[i, 0], free[i, 1] = total.real, total.imag
    if not work.inverse_matrix.shape[0]:
        for i in range(g.shape[0]):
            g[i, 0], g[i, 1] = -g[i, 0], -g[i, 1]
        clear(free)
        reduced_kernels.momentum(work.inverse, g, free)
    if not constrain(work.scene.links, work.projection, drives, work.dz[k], v, free, lam):
        return SINGULAR
    copy_matrix(free, a)
    return DONE


@part
def renew_slopes(work, drives, dz, vz):
    """Renew the slopes of force elements on plates at the state of the last residual: points at dz with velocities vz."""
    if work.optional[RENEW] != 0:
        call(work.optional[RENEW], (work, drives, dz, vz))


@part
def take_new_slopes(work, drives, dz, vz):
    """`renew_slopes` by addresses, of scenes with force elements and plates; without plates, a solve costs less than the slopes."""
    factor, optional, links = work.real, work.optional, work.scene.links
    own, workspace = factor.workspace.own, factor.workspace
    own[:] = 0.0
    call(optional[LAW_SLOPES], (optional[PARTS], drives, dz, vz, factor.c[C_V:], own))
    corotated.condense_states(links.coupling, factor.factored, own)
    corotated.turn_frames(links, factor.factored, workspace, work.rotation[work.rotation.shape[0] - 1])
    corotated.turn_slopes(links, workspace, -1.0, own, own)
    return DONE


new_slopes = served(take_new_slopes, None, None)


@part
def solve(work, instant, u, lam, r, phi, dq, dlam):
    """dq and dlam of one Newton correction."""
    strains, condensed = work.real.workspace.elimination, work.condensed.calls[WORKSPACE] != 0
    right = r if condensed else eliminate(strains, u, r)
    regular = factors.solve(work, work.real, instant, right, phi, lam, dq, dlam)
    if not condensed:
        recover(strains, u, dq)
    return DONE if regular else SINGULAR


@part
def strains(work, instant, past, now, state, numbers):
    """Begin a step of the strains if state is 0, or end it; addresses of arrays."""
    calls = work.condensed.calls
    if state == 0:
        return call(calls[BEGIN_STRAINS], (calls[WORKSPACE], past, numbers))
    return call(calls[END_STRAINS], (calls[WORKSPACE], now, past, state, numbers))


@part
def reaction(work, instant, u, mu, dv):
    """dv += B^T mu."""
    links, dz = work.scene.links, work.dz[work.stage[instant]]
    joints.point_values(links, u, dz)
    clear(work.forces)
    joints.joint_forces(links, work.drives[instant], dz, mu, work.spare, work.forces)
    joints.spread(links, work.forces, dv)
    return DONE


@part
def middle_rows(work, instant):
    """Have the borders computed at the next solve, for all iterations of a step."""
    work.anew[:] = 1
    return DONE


@part
def turn(work, first, r, back):
    """Rotate r of all stages in place: back = 0 turns residuals into the frame of the middle stage and stores the rotations in work.turn, back
    = 1 turns corrections back by these."""
    for k in range(r.shape[0]):
        if back:
            turn_back(work.turn[k, : work.rotation.shape[1]], r[k])
        else:
            turn_to(work.rotation[k], work.rotation[r.shape[0] // 2], work.turn[k], r[k])
    return DONE


@fast
def turn_to(own, middle, turn, r):
    """Rotate r (nodes, 2) from the frames `own` to the frames `middle`; turn (nodes, 2) becomes cosine and sine."""
    for i in range(own.shape[0]):
        mx, my, x, y = middle[i, 0], middle[i, 1], own[i, 0], own[i, 1]
        size = 1.0 / np.sqrt((mx * mx + my * my) * (x * x + y * y))
        c, n = (mx * x + my * y) * size, (my * x - mx * y) * size
        p, q = r[i, 0], r[i, 1]
        turn[i, 0], turn[i, 1] = c, n
        r[i, 0], r[i, 1] = c * p - n * q, n * p + c * q


@fast
def turn_back(turn, dq):
    """Rotate dq by the inverse of turn."""
    for i in range(turn.shape[0]):
        p, q, c, n = dq[i, 0], dq[i, 1], turn[i, 0], turn[i, 1]
        dq[i, 0], dq[i, 1] = c * p + n * q, c * q - n * p


@part
def real(work, instant, r, closing, lam, dq, multipliers):
    """The correction of the real mode."""
    return factors.solve_mode(work, instant, factors.REAL, work.real, r, closing, lam, dq, multipliers)


@part
def pair(work, instant, r, closing, lam, dq, multipliers):
    """The correction of the complex mode."""
    return factors.solve_mode(work, instant, factors.PAIR, work.pair, r, closing, lam, dq, multipliers)


@part
def momentum(work, a, r):
    """r += M a."""
    kernels.momentum(work.scene, a, r)
    links = work.scene.links
    joints.point_values(links, a, work.points[DX])
    for p in range(work.forces.shape[0]):
        work.forces[p, 0] = links.point_mass[p] * work.points[DX, p, 0]
        work.forces[p, 1] = links.point_mass[p] * work.points[DX, p, 1]
    joints.spread(links, work.forces, r)


@part
def add_law_damping(work, drives, dz, v, r):
    """r += C v of the force elements, at the places dz of the points and the velocities of the last residual."""
    moved, forces, optional = work.points[DX], work.forces, work.optional
    if optional[LAW_DAMPING] != 0:
        joints.point_values(work.scene.links, v, moved)
        clear(forces)
        call(optional[LAW_DAMPING], (optional[PARTS], drives, dz, work.vz, moved, forces))
        joints.spread(work.scene.links, forces, r)


@part
def inertia(work, instant, v, a, r, p, u, rates):
    """r = C v + M a, C at u. p = M v and rates (2, m) = (0, B v), B of the stage's last residual, unless their addresses are 0."""
    links, drives, dz = work.scene.links, work.drives[instant], work.dz[work.stage[instant]]
    clear(r)
    momentum(work, a, r)
    add_slowing(work, u, v, 0, r)
    add_law_damping(work, drives, dz, v, r)
    if p:
        impulse = pairs(work, p)
        clear(impulse)
        momentum(work, v, impulse)
    if rates:
        joints.point_values(links, v, work.points[DX])
        out = both_rows(work, rates)
        joints.joint_jacobian(links, drives, dz, work.projection.slopes)
        for k in range(out.shape[1]):
            out[1, k] = joints.along(links, work.projection.slopes, k, work.points[DX])
    return DONE


@part
def do_nothing(work, instant):
    """Takes the place of a function that a scene does not need."""
    return DONE


idle = served(do_nothing)

FUNCTIONS = {
    table.PREPARE: served(prepare, step_times),
    table.BEGIN: served(begin, pairs, pairs, None),
    table.RESIDUAL: served(residual, pairs, pairs, pairs, rows, pairs, rows),
    table.CONSTRAINTS: served(constraints, pairs, pairs, pairs, rows, rows),
    table.RATE: served(rate, pairs, pairs, rows),
    table.PROJECT: served(project, rows, pairs, None),
    table.ACCEPT: served(accept),
    table.ACCELERATION: served(acceleration, pairs, pairs, pairs, rows),
    table.SOLVE: served(solve, pairs, rows, pairs, rows, pairs, rows),
    table.STRAINS: served(strains, None, None, None, None),
    table.REACTION: served(reaction, pairs, rows, pairs),
    table.ROWS: served(middle_rows),
    table.TURN: served(turn, stages, None),
    table.REAL: served(real, pairs, both_rows, rows, pairs, both_rows),
    table.PAIR: served(pair, complex_pairs, complex_rows, rows, complex_pairs, complex_rows),
    table.INERTIA: served(inertia, pairs, pairs, pairs, None, pairs, None),
    table.MATRICES: served(factors.matrices, pairs, None, None, None, None, factors.mode_values),
    table.SELECT: served(factors.select, factors.mode_values),
}
# factors that functions read: others are compiled for a workspace without any, once for all methods
BOTH = {"real": None, "pair": None}
READS = {table.SOLVE: ("real",), table.REAL: ("real",), table.PAIR: ("pair",), table.MATRICES: tuple(BOTH), table.SELECT: tuple(BOTH)}


def entries(*numbers):
    """{number: function} of some entries."""
    return {number: FUNCTIONS[number] for number in numbers}


@cache
def entry_address(function, kind):
    """The address of a function of a table as a C function for a type of workspaces."""
    return table_address(function, int64 if function is idle else kind)


class Scene:
    """A scene's workspace w and table. c: times of the stages; stage, begin: as of SceneWork; optional: numbers of the kernels that it calls.

    options: fields of the workspace in place of those that serve no method, and `pairs`, the number of the pairs of coordinates.

    Functions are compiled for the type of the workspace, which contains the types of the factors. To compile most of them once for all methods,
    each is compiled for the type with None in place of the factors that it does not read (`READS`): None takes one word of the block of a pack
    (jit/pack.py), as a factor does, so that all types find the other fields at the same places.
    """

    entries: dict = {}

    def __init__(self, model, c, stage, begin, optional, **options):
        self.model, self.work, self.workspace_type, self.raised = model, None, None, None
        self.workspace, self.functions = 0, np.zeros(table.ENTRIES, np.int64)
        s, m, nodes, points = len(c), model.m, (options.pop("pairs", model.n_nodes), 2), (model.n_points, 2)
        profiles, projection, (numbers, self.formulas) = (len(model.profiles), 3), constraint_projection(model), moves(model)
        nothing = np.zeros(0), *np.zeros((2, 0), np.int64), np.zeros((0, 2))
        self.w = {
            "scene": model.arrays,
            "stored": scene_factors(model, False),
            "projection": projection,
            "rates": RateMultipliers(projection.border, projection.workspace, *nothing),
            "condensed": options.get("condensed") or condensation(model, False),
            "optional": optional_kernels(model, *optional),
            "moves": numbers,
            "c": np.array(c, float),
            "h": np.zeros(1),
            "stage": stage,
            "begin": begin,
            "drives": np.zeros((len(stage) + 1, *profiles)),
            "gains": np.zeros((len(stage) + 1, *profiles)),
            "incremental": True,
            "tied": False,
            "keeps_middle": False,
            "strict": False,
            "anew": np.ones(3, np.int64),
            "cosine": np.ones(1),
            "rotation": np.zeros((s, model.n_factored, 2)),
            "dz": np.zeros((s, *points)),
            "turn": np.zeros((0, *nodes)),
            "points": np.zeros((4, *points)),
            "forces": np.zeros(points),
            "vz": np.zeros((0, 2)),
            "u": np.zeros((0, 2)),
            "damp": np.zeros((model.n_nodes if model.damped else 0, 2)),  # also where `pairs` are fewer: its kernel knows them all
            "nodal": np.zeros((2, *nodes)),
            "still": np.zeros(nodes),
            "level": np.zeros(m),
            "spare": np.zeros(m),
            "inverse": model.arrays.reduced,
            "inverse_matrix": np.zeros((0, 0), complex),
        } | options

    def set_factors(self, **used):
        """Use these factors, `real` or `pair` or both; functions are compiled for the type of the workspace."""
        self.work = SceneWork(**BOTH | used, **self.w)
        self.workspace, kind = self.work.address, typeof(self.work)
        if kind != self.workspace_type:
            self.workspace_type, self.types_by_factors = kind, {frozenset(BOTH): kind}
            for number, function in self.entries.items():
                self.functions[number] = entry_address(function, self.type_for(*READS.get(number, ())))

    def type_for(self, *read):
        """The type of the workspace for a function that reads these factors, by their names."""
        known = frozenset(read)
        if known not in self.types_by_factors:
            self.types_by_factors[known] = typeof(self.work._replace(**dict.fromkeys(BOTH.keys() - known)))
        return self.types_by_factors[known]

    def take_error(self):
        """The exception of a Python function that compiled code called, or None."""
        error, self.raised = self.raised or self.model.take_error(), None
        return error

    def raise_error(self):
        """Raise that exception."""
        if (error := self.take_error()) is not None:
            raise error


class OneFactorScene(Scene):
    """The table of a scene for methods with one real factor, which Python makes.

    Several threads share the solves of more than SHARED coordinates, if the user allows them.
    """

    longest = INSTANTS

    def __init__(self, model, *arguments, **options):
        super().__init__(model, *arguments, **options)
        self.helpers = Helpers(threads()) if 2 * model.n_factored >= SHARED and threads() > 1 else None
        self.c = np.zeros(2)

    def system(self, settings):
        return settings.step_matrix(self.model)

    def factor(self, system, t, *at):
        system.factor(t, *at)
        return 1

    @contextmanager
    def at_work(self, system):
        own = system.workspace
        with self.helpers.at_work(system.corotated, own) if self.helpers else nullcontext(own) as workspace:
            self.c[:] = system.c_m, system.c_v
            if self.work is None or self.work.real.workspace is not workspace:
                self.set_factors(real=Factor(self.c, system.corotated, workspace, np.zeros((0, 2, 2))))
                if self.w["optional"][LAW_SLOPES] and self.model.bodies:
                    self.w["optional"][RENEW] = entry_address(new_slopes, self.type_for("real"))
            yield self.functions, self.work.address
        self.raised = self.model.take_error()


class SceneTable(OneFactorScene):
    """The table of a scene for generalized-alpha, with the methods of PythonTable.

    projects: whether it needs rates and projections. condensed: True if the unknowns are the coordinates without strains.
    """

    def __init__(self, model, projects, incremental, condensed=False):
        condensed = condensed and bool(model.strains)
        self.unknowns = 2 * model.n_factored if condensed else model.n
        begin, wanted = np.arange(INSTANTS) - 1, {LAW_FORCES, DAMPING} | ({RELAXING} if not condensed else set())
        begin[0] = INSTANTS  # the last row
        options = {"pairs": self.unknowns // 2, "incremental": bool(incremental), "condensed": condensation(model, condensed)}
        super().__init__(model, np.ones(1), np.zeros(INSTANTS, np.int64), begin, wanted, **options)
        calls = self.w["condensed"].calls[:2].copy()
        self.w["scene"] = model.arrays._replace(relaxation=model.arrays.relaxation._replace(condensed=calls))
        self.entries = entries(table.BEGIN, table.RESIDUAL, table.CONSTRAINTS, table.SOLVE, table.ACCEPT)
        self.entries |= entries(table.RATE, table.PROJECT) if projects else {table.RATE: idle, table.PROJECT: idle}
        if condensed:
            self.entries |= entries(table.STRAINS)

    def prepare(self, times, ends, h):
        w, count, drives = self.w, len(times) - 1, drive_table(self.model, times, ends)
        w["drives"][:count], w["drives"][INSTANTS] = drives[1:], drives[0]
        w["gains"][:count], w["h"][0] = gain_table(self.model, times, drives, h), h
