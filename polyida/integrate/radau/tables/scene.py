"""The table of a scene: its compiled kernels as C functions, one real and one complex solve for the corrections of all stages.

The factors are made in the frames of the nodes, and each stage has frames of its own: its residual is rotated to those of the middle stage,
R(q_k) R(q_i)^T node by node, and the correction is rotated back.
"""

import ctypes
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
from numba import carray, typeof

from polyida import system as of
from polyida.assembly import corotated, joints
from polyida.assembly import equilibrium as kernels
from polyida.assembly.equilibrium import symmetric_parts
from polyida.assembly.increments import Moves, moves, stage_tables, take_step
from polyida.assembly.optional import DAMPING, LAW_DAMPING, LAW_FORCES, PARTS, RELAXING, optional_kernels
from polyida.assembly.projection import ConstraintProjection, constrain, constraint_projection
from polyida.assembly.projection import project as project_rows
from polyida.assembly.rate_multipliers import (
    RateMultipliers,
    add_rate_forces,
    factor_rates,
    rate_multipliers,
    slowing,
    solve_rates,
    subtract_rates,
)
from polyida.assembly.relaxation import eliminate, recover
from polyida.errors import DONE, HALF_TURN, INVERTED, NOT_FINITE, RAISED, REASONS, SINGULAR
from polyida.integrate.discontinuities import inner_side
from polyida.integrate.radau.loop import STEP, TIME
from polyida.integrate.radau.step import compiled_tableau
from polyida.integrate.radau.tables.scene_factors import (
    FACTOR_FUNCTIONS,
    SceneFactors,
    Solver,
    empty_solver,
    makes_factors,
    matrices,
    scene_factors,
)
from polyida.jit import fast, pack, part, served
from polyida.jit.intrinsics import address, call, complex_pointer, pointer
from polyida.jit.user_functions import CALLBACK, table_address
from polyida.linear.dense import clear, copy_matrix
from polyida.linear.lu import SingularSystem
from polyida.system.scene import add_forces, add_slowing

START, VX, DX, DV = range(4)  # rows of SceneWork.points: displacements and velocities at the start of a step, and their increments
PAIR = 20.0  # iterations that cost as much as new factors of both modes, of large scenes
CALL = 4000.0  # the same for the Python code around a new factor, times the number of coordinates
FEW = 40  # nodes of a scene whose M^-1 is a full matrix
TIED = 2  # number of the system of mu in SceneWork.anew
NEVER = 1e8  # iterations: a new factor of rigid bodies, for the same step, is the old one


@pack
class SceneWork(NamedTuple):
    """The workspace of a scene and s stages: its arrays, the factors of the modes (None without one) and scratch.

    damp: (0, 2) without damping. optional: of `optional_kernels`. moves: profiles with formulas. drives, gains (instants, profiles, 3): values of the profiles at
    each instant, and their changes since the start of the step. rotation (s, ., 2): rotations of the pairs without relaxed strains; turn (s, nodes, 2): from those
    of a stage to the middle one. points (4, points, 2); dz (s, points, 2); vz (points, 2): velocities in the middle stage; u (nodes, 2): its displacements if plates relax, else (0, 2); c: of the tableau;
    h (1,); still (nodes, 2), level (m,): zeros; inverse (nodes, nodes): M^-1, complex, or (0, 0); tied: True if
    there is mu. anew (3,): 1 if the border of the real or complex mode, or the system of mu, must be computed at the next solve.
    """

    scene: tuple
    real: Solver | None
    pair: Solver | None
    tie: ConstraintProjection
    damp: np.ndarray
    optional: np.ndarray
    moves: Moves
    drives: np.ndarray
    gains: np.ndarray
    rotation: np.ndarray
    turn: np.ndarray
    points: np.ndarray
    forces: np.ndarray
    vz: np.ndarray
    u: np.ndarray
    dz: np.ndarray
    level: np.ndarray
    spare: np.ndarray
    factors: SceneFactors
    c: np.ndarray
    h: np.ndarray
    still: np.ndarray
    r: np.ndarray
    inverse: np.ndarray
    rates: RateMultipliers
    tied: bool
    anew: np.ndarray


@part
def pairs(work, at):
    """The coordinates at an address as (nodes, 2)."""
    return carray(pointer(at), work.turn.shape[1:])


@part
def complex_pairs(work, at):
    """The complex coordinates at an address as (nodes, 2)."""
    return carray(complex_pointer(at), work.turn.shape[1:])


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
def stage(work, instant):
    """Number of the stage of an instant."""
    return (instant - 1) % (work.c.shape[0] + 1)


@part
def prepare(work, first, times):
    """Evaluate loads and motors for a step."""
    take_step(work.moves, times[0], times[1], times[2], times[3:], work.c, work.drives[first:], work.gains[first:])
    return DONE


@part
def begin(work, first, u, v, times):
    """Store h, and positions and velocities of the points at the start of the step."""
    work.h[0] = times[0]
    joints.point_values(work.scene.links, u, work.points[START])
    joints.point_values(work.scene.links, v, work.points[VX])
    return DONE


@part
def reaction(work, instant, u, mu, dv):
    """dv += B^T mu."""
    links, dz = work.scene.links, work.dz[stage(work, instant)]
    joints.point_values(links, u, dz)
    clear(work.forces)
    joints.joint_forces(links, work.drives[instant], dz, mu, work.spare, work.forces)
    joints.spread(links, work.forces, dv)
    return DONE


@part
def residual(work, instant, u, v, a, lam, r, phi):
    """r and phi, from positions."""
    k, drives = stage(work, instant), work.drives[instant]
    det, cosine = kernels.equilibrium(work.scene, drives, u, a, lam, r, phi, work.rotation[k], work.dz[k], work.forces)
    if not det > 0.0:
        return INVERTED if det <= 0.0 else NOT_FINITE
    if not cosine > 0.0:
        return HALF_TURN
    status = add_forces(work, drives, u, v, r)
    if k == work.c.shape[0] // 2:
        copy_matrix(u[: work.u.shape[0]], work.u)
        joints.point_values(work.scene.links, v, work.vz)
    return status


@part
def constraints(work, instant, u, du, dv, phi, rate):
    """phi and phi' from those at the start of the step and the increments of q and v."""
    links, k, points = work.scene.links, stage(work, instant), work.points
    joints.point_values(links, du, points[DX])
    joints.point_values(links, dv, points[DV])
    drives, gains = work.drives[instant - 1 - k], work.gains[instant]
    joints.joint_change(links, drives, gains, work.c[k] * work.h[0], points[START], points[VX], points[DX], points[DV], phi, rate)
    return DONE


@part
def rate(work, instant, u):
    """Compute the slopes of the rows for `project`; phi_rate itself comes from increments."""
    links, dz = work.scene.links, work.dz[stage(work, instant)]
    joints.point_values(links, u, dz)
    joints.joint_jacobian(links, work.drives[instant], dz, work.tie.slopes)
    return DONE


@part
def project(work, instant, changes, x):
    """Change x by the least M-norm, so that B x falls by `changes`."""
    return DONE if project_rows(work.scene.links, work.tie, changes, x) else SINGULAR


@part
def middle_rows(work, instant):
    """Have the borders computed at the next solve, for all iterations of a step."""
    work.anew[0] = work.anew[1] = work.anew[TIED] = 1
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
def solve_mode(work, instant, number, mode, r, closing, lam, dq, multipliers):
    """Solve for dq and multipliers of one mode, rows and curvature being those of the middle stage. Returns a status; DONE if mode is None.

    number: 0 for the real mode, 1 for the complex one. r, closing: right-hand sides of the equations of motion and of the rows; they are overwritten.
    """
    if mode is None:
        return DONE
    k, s, drives, c = stage(work, instant), work.scene.links, work.drives[instant], mode.c[0]
    factored, workspace, rotation, dz = mode.factored, mode.workspace, work.rotation[k], work.dz[k]
    right = eliminate(workspace.elimination, work.u, r)
    if work.tied:
        if work.anew[TIED]:
            work.anew[TIED] = 0
            joints.joint_rate_jacobian(s, drives, dz, work.vz, work.rates.rates)
            if not factor_rates(s, work.rates, drives, dz):
                return SINGULAR
        for e in range(closing.shape[1]):
            closing[1, e] = c * closing[0, e] - closing[1, e]
        if not solve_rates(work.rates, closing[1], multipliers[1]):
            return SINGULAR
        if mode.slowing.shape[0]:
            corotated.turn_frames(s, factored, workspace, rotation)
        add_rate_forces(s, work.rates, mode.slowing, workspace, c, multipliers[1], right)
    workspace.keeps[0], work.anew[number] = 1 - work.anew[number], 0
    good = corotated.solve(s, factored, workspace, drives, rotation, dz, lam, right, closing[0], c * c, dq, multipliers[0])
    workspace.keeps[0] = 0
    if work.tied:
        joints.point_values(s, dq, workspace.moved)
        subtract_rates(s, work.rates, workspace.moved, closing[1])
        good = solve_rates(work.rates, closing[1], multipliers[1]) and good
    recover(workspace.elimination, work.u, dq)
    return DONE if good else SINGULAR


@part
def real(work, instant, r, closing, lam, dq, multipliers):
    """The correction of the real mode."""
    return solve_mode(work, instant, 0, work.real, r, closing, lam, dq, multipliers)


@part
def pair(work, instant, r, closing, lam, dq, multipliers):
    """The correction of the complex mode."""
    return solve_mode(work, instant, 1, work.pair, r, closing, lam, dq, multipliers)


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
        call(optional[LAW_DAMPING], optional[PARTS], address(drives), address(dz), address(work.vz), address(moved), address(forces), 0, 0)
        joints.spread(work.scene.links, forces, r)


@part
def inertia(work, instant, v, a, r, p, u, rates):
    """r = C v + M a, C at u. p = M v and rates (2, m) = (0, B v), B of the stage's last residual, unless their addresses are 0."""
    clear(r)
    momentum(work, a, r)
    add_slowing(work, u, v, 0, r)
    add_law_damping(work, work.drives[instant], work.dz[stage(work, instant)], v, r)
    if p:
        impulse = pairs(work, p)
        clear(impulse)
        momentum(work, v, impulse)
    if rates:
        joints.point_values(work.scene.links, v, work.points[DX])
        links, dz, out = work.scene.links, work.dz[stage(work, instant)], both_rows(work, rates)
        joints.joint_jacobian(links, work.drives[instant], dz, work.tie.slopes)
        for k in range(out.shape[1]):
            out[1, k] = joints.along(links, work.tie.slopes, k, work.points[DX])
    return DONE


@part
def acceleration(work, instant, u, v, a, lam):
    """a and lam of the equations of motion."""
    k, drives, forces = stage(work, instant), work.drives[instant], work.turn[0]
    kernels.equilibrium(work.scene, drives, u, work.still, work.level, forces, work.spare, work.rotation[k], work.dz[k], work.forces)
    add_forces(work, drives, u, v, forces)
    for i in range(a.shape[0]):
        total = 0.0j
        for j in range(a.shape[0]):
            total -= work.inverse[i, j] * complex(forces[j, 0], forces[j, 1])
        work.r[i, 0], work.r[i, 1] = total.real, total.imag
    if not constrain(work.scene.links, work.tie, drives, work.dz[k], v, work.r, lam):
        return SINGULAR
    copy_matrix(work.r, a)
    return DONE


FUNCTIONS = {
    of.BEGIN: served(begin, pairs, pairs, step_times),
    of.REACTION: served(reaction, pairs, rows, pairs),
    of.RESIDUAL: served(residual, pairs, pairs, pairs, rows, pairs, rows),
    of.CONSTRAINTS: served(constraints, pairs, pairs, pairs, rows, rows),
    of.RATE: served(rate, pairs),
    of.PROJECT: served(project, rows, pairs),
    of.ROWS: served(middle_rows),
    of.TURN: served(turn, stages, None),
    of.REAL: served(real, pairs, both_rows, rows, pairs, both_rows),
    of.PAIR: served(pair, complex_pairs, complex_rows, rows, complex_pairs, complex_rows),
    of.INERTIA: served(inertia, pairs, pairs, pairs, None, pairs, None),
}
PREPARE, ACCELERATION = served(prepare, step_times), served(acceleration, pairs, pairs, pairs, rows)
READS = {of.REAL: ("real",), of.PAIR: ("pair",), of.MATRICES: ("real", "pair"), of.SELECT: ("real", "pair")}  # modes that functions read


def inverse_mass(model):
    """M^-1 of a scene, (nodes, nodes), complex."""
    real = np.stack([np.eye(model.n_nodes), np.zeros((model.n_nodes, model.n_nodes))], axis=1)
    inverse = model.mass_inverse(real.reshape(model.n, model.n_nodes)).reshape(model.n_nodes, 2, model.n_nodes)
    return np.ascontiguousarray(inverse[:, 0] + 1j * inverse[:, 1])


class SceneStages:
    """The table of a scene without Python in it."""

    longest, lifts = of.STEPS, False

    def __init__(self, model, tableau, tied):
        self.model, self.tableau, self.tied, s = model, tableau, tied, tableau.stages
        nodes, points, instants = (model.n_nodes, 2), (model.n_points, 2), (of.STEPS * (s + 1), len(model.profiles), 3)
        small, (numbers, self.formulas) = model.n_nodes <= FEW, moves(model)
        self.entries = FUNCTIONS | ({of.ACCELERATION: ACCELERATION} if small else {})
        # whether the matrices of one slot are at hand only, because Python makes them
        self.single = s == 1 or not makes_factors(model)
        self.w = {
            "scene": model.arrays,
            "tie": constraint_projection(model),
            "damp": np.zeros(nodes if model.damped else (0, 2)),
            "optional": optional_kernels(model, LAW_FORCES, LAW_DAMPING, RELAXING, DAMPING),
            "moves": numbers,
            "drives": np.zeros(instants),
            "gains": np.zeros(instants),
            "rotation": np.zeros((s, model.n_factored, 2)),
            "turn": np.zeros((s, *nodes)),
            "points": np.zeros((4, *points)),
            "forces": np.zeros(points),
            "vz": np.zeros(points),
            "u": np.zeros((model.n_nodes if model.strains else 0, 2)),
            "dz": np.zeros((s, *points)),
            "level": np.zeros(model.m),
            "spare": np.zeros(model.m),
            "factors": scene_factors(model, not self.single),
            "c": tableau.c,
            "h": np.zeros(1),
            "still": np.zeros(nodes),
            "r": np.zeros(nodes),
            "rates": rate_multipliers(model),
            "tied": tied,
            "anew": np.ones(3, np.int64),
            "inverse": inverse_mass(model) if small else np.zeros((0, 0), complex),
        }
        self.functions, self.kind, self.work, self.workspace, self.slots = np.zeros(of.ENTRIES, np.int64), None, None, 0, {}
        self.renewal = PAIR + CALL / model.n if self.single else PAIR if model.flexible else NEVER
        self.callback, self.prepared, self.raised = CALLBACK(self._prepare), False, None

    def evaluate_constants(self, t, q):
        """No effect."""

    def begin(self, engine, state, control, ends):
        """Prepare a stretch: the loads and motors of equal steps are evaluated before it, those of adaptive ones in each step."""
        if self.work is None and not self.single:
            solvers = [empty_solver(self.model, mode) for mode in self.tableau.modes]
            self.entries = self.entries | FACTOR_FUNCTIONS
            self.set_solvers(*[None] * (2 - len(solvers)), *solvers)
            engine.counts.backend = corotated.SceneStepMatrix.backend
        if not self.model.profiles:
            return 0
        self.prepared, self.clamp = not control.adaptive, engine.clamp
        self.functions[of.PREPARE] = 0 if self.prepared else ctypes.cast(self.callback, ctypes.c_void_p).value
        self._compile_prepare()
        if self.prepared:
            starts = np.concatenate([[state.t], ends[:-1]])
            times = np.clip(np.column_stack([starts[:, None] + self.tableau.c[:-1] * control.h, ends]), *engine.limits)
            self._take_loads(starts, times, control.h)
        return 0

    def _compile_prepare(self):
        """Use the compiled PREPARE if steps need it, all profiles have formulas, and there is a workspace."""
        if self.functions[of.PREPARE] and self.formulas and self.kind:
            self.functions[of.PREPARE] = table_address(PREPARE, typeof(self.work._replace(real=None, pair=None)))

    def _prepare(self, model, first, times, *_):
        try:
            h, t, _, *at = (ctypes.c_double * (3 + self.tableau.stages)).from_address(times)
            self._take_loads(np.array([t]), np.array([at]), h)
        except BaseException as error:  # noqa: BLE001 it is raised when the loop has returned
            self.raised = error
            return RAISED
        return DONE

    def _take_loads(self, starts, times, h):
        drives, gains = stage_tables(self.model, starts, times, inner_side(self.model, starts[0], -h), self.tableau.c * h)
        shape = drives.shape
        self.w["drives"][: shape[0] * shape[1]].reshape(shape)[:] = drives
        self.w["gains"][: shape[0] * shape[1]].reshape(shape)[:, 1:] = gains

    def make(self, slot, h, made_at, counts):
        """Make the factors of a slot, unless they exist for this state, and use them. Raises SingularSystem."""
        if not self.single:
            c = compiled_tableau(self.tableau).values / h
            u = np.ascontiguousarray(made_at[1 : 1 + self.model.n]).reshape(-1, 2)
            if matrices(self.work, 0, u, 0, 0, 0, slot, c) != DONE:
                raise SingularSystem(REASONS[SINGULAR][1])
            return
        known = self.slots.get(slot)
        if known is None or known.h != h or not np.array_equal(known.made_at, made_at):
            known = self.slots[slot] = SceneMatrices(self.model, self.tableau.modes, h, made_at)
        counts.backend = known.backend
        self.set_solvers(known.real, known.pair)

    def set_solvers(self, real, pair):
        """Use these Solvers of the modes, or None; functions are compiled for the type of the workspace."""
        self.work = SceneWork(real=real, pair=pair, **self.w)
        self.workspace, kind = self.work.address, typeof(self.work)
        if kind != self.kind:
            self.kind = kind
            of_reads = {("real", "pair"): kind} | {
                read: typeof(self.work._replace(**dict.fromkeys({"real", "pair"}.difference(read)))) for read in ((), ("real",), ("pair",))
            }
            for number, function in self.entries.items():
                self.functions[number] = table_address(function, of_reads[READS.get(number, ())])
            self._compile_prepare()

    def end_reason(self, ended, engine, control):
        """(status, reason) for a status of the driver. For an invalid deformation, the model's reason at the first stage that it rejects."""
        status, reason = REASONS[ended]
        if ended not in (INVERTED, HALF_TURN):
            return status, reason
        q, v = engine.memory.q, engine.memory.v
        steps, t = self.tableau.c * control.now[STEP], control.now[TIME]
        stages = ((engine.clamp(t + step), q + (step * v + e)) for step, e in zip(steps, engine.trial.e))
        return status, next(filter(None, (self.model.rejection_reason(*at) for at in stages)), None) or reason

    @contextmanager
    def timed(self):
        """The time of a call of the driver, behind which an exception of a Python function is kept here."""
        yield
        self.raised = self.raised or self.model.take_error()

    def take_error(self):
        """The exception of a profile, or of a Python function that compiled code called, or None."""
        error, self.raised = self.raised or self.model.take_error(), None
        return error

    def raise_error(self):
        """Raise that exception."""
        if (error := self.take_error()) is not None:
            raise error


class SceneMatrices:
    """The co-rotated factors of both modes for steps of h, made at t, q, v, a and lam in one array; real, pair: their Solver, or None."""

    def __init__(self, model, modes, h, made_at):
        self.h, self.made_at, self.real = h, made_at, None
        at = (float(made_at[0]), *np.split(made_at[1:], np.cumsum([model.n] * 3)))
        parts = symmetric_parts(model, *at[1:3])
        for mode in modes:
            c, step = mode.value / h, model.step_matrix()
            step.factor(*at, c * c, c, parts)
            self.backend, solver = step.backend, Solver(np.array([c]), step.corotated, step.workspace, slowing(model, *at[:2]))
            self.real, self.pair = (self.real, solver) if mode.paired else (solver, None)
