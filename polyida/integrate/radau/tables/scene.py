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
from polyida.jit import entry, fast, pack, part
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
def pairs(w, at):
    """The coordinates at an address as (nodes, 2)."""
    return carray(pointer(at), w.turn.shape[1:])


@part
def complex_pairs(w, at):
    """The complex coordinates at an address as (nodes, 2)."""
    return carray(complex_pointer(at), w.turn.shape[1:])


@part
def rows(w, at):
    """The array (m,) at an address."""
    return carray(pointer(at), w.level.shape)


@part
def stage(w, instant):
    """Number of the stage of an instant."""
    return (instant - 1) % (w.c.shape[0] + 1)


@entry
def prepare(w, first, times, b, c, d, e, f):
    """Evaluate loads and motors for a step."""
    values = carray(pointer(times), (3 + w.c.shape[0],))
    take_step(w.moves, values[0], values[1], values[2], values[3:], w.c, w.drives[first:], w.gains[first:])
    return DONE


@entry
def begin(w, first, q, v, times, d, e, f):
    """Store h, and positions and velocities of the points at the start of the step."""
    w.h[0] = carray(pointer(times), (1,))[0]
    joints.point_values(w.scene.links, pairs(w, q), w.points[START])
    joints.point_values(w.scene.links, pairs(w, v), w.points[VX])
    return DONE


@entry
def reaction(w, instant, q, mu, dv, d, e, f):
    """dv += B^T mu."""
    s, dz = w.scene.links, w.dz[stage(w, instant)]
    joints.point_values(s, pairs(w, q), dz)
    clear(w.forces)
    joints.joint_forces(s, w.drives[instant], dz, rows(w, mu), w.spare, w.forces)
    joints.spread(s, w.forces, pairs(w, dv))
    return DONE


@entry
def residual(w, instant, q, v, a, lam, r, phi):
    """r and phi, from positions."""
    s, k, drives, u, speed, out = w.scene, stage(w, instant), w.drives[instant], pairs(w, q), pairs(w, v), pairs(w, r)
    det, cosine = kernels.equilibrium(s, drives, u, pairs(w, a), rows(w, lam), out, rows(w, phi), w.rotation[k], w.dz[k], w.forces)
    if not det > 0.0:
        return INVERTED if det <= 0.0 else NOT_FINITE
    if not cosine > 0.0:
        return HALF_TURN
    status = add_forces(w, drives, u, speed, out)
    if k == w.c.shape[0] // 2:
        copy_matrix(u[: w.u.shape[0]], w.u)
        joints.point_values(s.links, speed, w.vz)
    return status


@entry
def constraints(w, instant, q, dd, dv, phi, rate, f):
    """phi and phi' from those at the start of the step and the increments of q and v."""
    s, k, points = w.scene.links, stage(w, instant), w.points
    joints.point_values(s, pairs(w, dd), points[DX])
    joints.point_values(s, pairs(w, dv), points[DV])
    drives, gains, values = w.drives[instant - 1 - k], w.gains[instant], (rows(w, phi), rows(w, rate))
    joints.joint_change(s, drives, gains, w.c[k] * w.h[0], points[START], points[VX], points[DX], points[DV], values[0], values[1])
    return DONE


@entry
def rate(w, instant, q, v, out, known, e, f):
    """Compute the slopes of the rows for `project`; phi_rate itself comes from increments."""
    s, dz = w.scene.links, w.dz[stage(w, instant)]
    joints.point_values(s, pairs(w, q), dz)
    joints.joint_jacobian(s, w.drives[instant], dz, w.tie.slopes)
    return DONE


@entry
def project(w, instant, changes, x, anew, d, e, f):
    """Change x by the least M-norm, so that B x falls by rows."""
    return DONE if project_rows(w.scene.links, w.tie, rows(w, changes), pairs(w, x)) else SINGULAR


@entry
def middle_rows(w, instant, q, v, c, d, e, f):
    """Have the borders computed at the next solve, for all iterations of a step."""
    w.anew[0] = w.anew[1] = w.anew[TIED] = 1
    return DONE


@entry
def turn(w, first, r, back, c, d, e, f):
    """Rotate r of all stages in place: back = 0 turns residuals into the frame of the middle stage and stores the rotations in w.turn, back = 1
    turns corrections back by these."""
    r = carray(pointer(r), w.turn.shape)
    for k in range(r.shape[0]):
        if back:
            turn_back(w.turn[k, : w.rotation.shape[1]], r[k])
        else:
            turn_to(w.rotation[k], w.rotation[r.shape[0] // 2], w.turn[k], r[k])
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
def solve_mode(w, instant, number, mode, r, closing, lam, dq, multipliers):
    """Solve for dq and multipliers of one mode, rows and curvature being those of the middle stage. Returns a status; DONE if mode is None.

    number: 0 for the real mode, 1 for the complex one. r, closing: right-hand sides of the equations of motion and of the rows; they are overwritten.
    """
    if mode is None:
        return DONE
    k, s, drives, c = stage(w, instant), w.scene.links, w.drives[instant], mode.c[0]
    factored, workspace, rotation, dz = mode.factored, mode.workspace, w.rotation[k], w.dz[k]
    right = eliminate(workspace.elimination, w.u, r)
    if w.tied:
        if w.anew[TIED]:
            w.anew[TIED] = 0
            joints.joint_rate_jacobian(s, drives, dz, w.vz, w.rates.rates)
            if not factor_rates(s, w.rates, drives, dz):
                return SINGULAR
        for e in range(closing.shape[1]):
            closing[1, e] = c * closing[0, e] - closing[1, e]
        if not solve_rates(w.rates, closing[1], multipliers[1]):
            return SINGULAR
        if mode.slowing.shape[0]:
            corotated.turn_frames(s, factored, workspace, rotation)
        add_rate_forces(s, w.rates, mode.slowing, workspace, c, multipliers[1], right)
    workspace.keeps[0], w.anew[number] = 1 - w.anew[number], 0
    good = corotated.solve(s, factored, workspace, drives, rotation, dz, lam, right, closing[0], c * c, dq, multipliers[0])
    workspace.keeps[0] = 0
    if w.tied:
        joints.point_values(s, dq, workspace.moved)
        subtract_rates(s, w.rates, workspace.moved, closing[1])
        good = solve_rates(w.rates, closing[1], multipliers[1]) and good
    recover(workspace.elimination, w.u, dq)
    return DONE if good else SINGULAR


@entry
def real(w, instant, r, closing, lam, dq, multipliers, f):
    """The correction of the real mode."""
    shape = (2, w.level.shape[0])
    arguments = pairs(w, r), carray(pointer(closing), shape), rows(w, lam), pairs(w, dq), carray(pointer(multipliers), shape)
    return solve_mode(w, instant, 0, w.real, arguments[0], arguments[1], arguments[2], arguments[3], arguments[4])


@entry
def pair(w, instant, r, closing, lam, dq, multipliers, f):
    """The correction of the complex mode."""
    shape = (2, w.level.shape[0])
    right, correction = complex_pairs(w, r), complex_pairs(w, dq)
    right_rows, changes = carray(complex_pointer(closing), shape), carray(complex_pointer(multipliers), shape)
    return solve_mode(w, instant, 1, w.pair, right, right_rows, rows(w, lam), correction, changes)


@part
def momentum(w, b, r):
    """r += M b."""
    kernels.momentum(w.scene, b, r)
    s = w.scene.links
    joints.point_values(s, b, w.points[DX])
    for f in range(w.forces.shape[0]):
        w.forces[f, 0] = s.point_mass[f] * w.points[DX, f, 0]
        w.forces[f, 1] = s.point_mass[f] * w.points[DX, f, 1]
    joints.spread(s, w.forces, r)


@part
def add_law_damping(w, drives, dz, v, r):
    """r += C v of the force elements, at the places dz of the points and the velocities of the last residual."""
    moved, forces, optional = w.points[DX], w.forces, w.optional
    if optional[LAW_DAMPING] != 0:
        joints.point_values(w.scene.links, v, moved)
        clear(forces)
        call(optional[LAW_DAMPING], optional[PARTS], address(drives), address(dz), address(w.vz), address(moved), address(forces), 0, 0)
        joints.spread(w.scene.links, forces, r)


@entry
def inertia(w, instant, v, a, r, p, q, rates):
    """r = C v + M a, p = M v, C at q; rates (2, m) = (0, B v), B of the stage's last residual."""
    slow, force = pairs(w, v), pairs(w, r)
    clear(force)
    momentum(w, pairs(w, a), force)
    add_slowing(w, pairs(w, q), slow, 0, force)
    add_law_damping(w, w.drives[instant], w.dz[stage(w, instant)], slow, force)
    if p:
        impulse = pairs(w, p)
        clear(impulse)
        momentum(w, slow, impulse)
    if rates:
        joints.point_values(w.scene.links, slow, w.points[DX])
        links, dz, out = w.scene.links, w.dz[stage(w, instant)], carray(pointer(rates), (2, w.level.shape[0]))
        joints.joint_jacobian(links, w.drives[instant], dz, w.tie.slopes)
        for k in range(out.shape[1]):
            out[1, k] = joints.along(links, w.tie.slopes, k, w.points[DX])
    return DONE


@entry
def acceleration(w, instant, q, v, a, lam, e, f):
    """a and lam of the equations of motion."""
    k, drives, u, speed, forces = stage(w, instant), w.drives[instant], pairs(w, q), pairs(w, v), w.turn[0]
    kernels.equilibrium(w.scene, drives, u, w.still, w.level, forces, w.spare, w.rotation[k], w.dz[k], w.forces)
    add_forces(w, drives, u, speed, forces)
    out = pairs(w, a)
    for i in range(out.shape[0]):
        total = 0.0j
        for j in range(out.shape[0]):
            total -= w.inverse[i, j] * complex(forces[j, 0], forces[j, 1])
        w.r[i, 0], w.r[i, 1] = total.real, total.imag
    if not constrain(w.scene.links, w.tie, drives, w.dz[k], speed, w.r, rows(w, lam)):
        return SINGULAR
    copy_matrix(w.r, out)
    return DONE


FUNCTIONS = {
    of.BEGIN: begin, of.REACTION: reaction, of.RESIDUAL: residual, of.CONSTRAINTS: constraints, of.RATE: rate, of.PROJECT: project, of.ROWS: middle_rows,
    of.TURN: turn, of.REAL: real, of.PAIR: pair, of.INERTIA: inertia,
}  # fmt: skip
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
        self.entries = FUNCTIONS | ({of.ACCELERATION: acceleration} if small else {})
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
            self.functions[of.PREPARE] = table_address(prepare, typeof(self.work._replace(real=None, pair=None)))

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
            q, v, a, lam = (np.ascontiguousarray(x) for x in np.split(made_at[1:], np.cumsum([self.model.n] * 3)))
            if matrices(self.work, 0, q.ctypes.data, v.ctypes.data, a.ctypes.data, lam.ctypes.data, slot, c.ctypes.data) != DONE:
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
