"""What a scene answers a compiled driver: one function for each entry of its table (polyida/system/__init__.py), of arrays.

A step has one instant for each of the s stages of the method: one at its end (generalized-alpha, IDA), s stages (Radau IIA), or its middle and
its end (energy-momentum). Every stage has its own rotations of the nodes and places of the points. The factors are made in the frames of the
nodes: a correction of all stages together is solved for in the frame of the middle one. Residuals are rotated into it, R(q_k) R(q_i)^T node by
node, and the correction is rotated back.

Functions take the workspace of a scene (`SceneWork`, filled in scene.py) and the number of an instant, and return a status (errors.REASONS). `FUNCTIONS`
says for each entry which function answers it and how its arguments are read. A part that a scene or a method does not need has size 0, so
that all scenes have one type, and the functions are compiled once.
"""

from typing import NamedTuple

import numpy as np
from numba import carray

from polyida import system as table
from polyida.assembly import corotated, joints, reduced_kernels
from polyida.assembly import equilibrium as kernels
from polyida.assembly.condensation import ADD_FORCE_OF_REDUCED_PLATES, BEGIN_STRAINS, END_STRAINS, WORKSPACE, Condensation
from polyida.assembly.increments import Moves, take_step
from polyida.assembly.optional import DAMPING, LAW_DAMPING, LAW_FORCES, LAW_SLOPES, PARTS, RELAXING, RENEW
from polyida.assembly.projection import ConstraintProjection, constrain, velocity_rate
from polyida.assembly.projection import project as project_rows
from polyida.assembly.rate_multipliers import RateMultipliers
from polyida.assembly.strain_elimination import eliminate, recover
from polyida.errors import DONE, HALF_TURN, INVERTED, NOT_FINITE, SINGULAR
from polyida.jit import fast, pack, part, served
from polyida.jit.intrinsics import call, complex_pointer, pointer
from polyida.linear.dense import clear, copy_matrix, put
from polyida.system import scene_factors as factors
from polyida.system.scene_factors import C_V, Factor, SceneFactors

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
    """A view of the array (3 + s,) at an address: h, the begin of a step, the same or a time beside a kink, and the times of its stages."""
    return carray(pointer(at), (3 + work.c.shape[0],))


@part
def prepare(work, first, times):
    """Evaluate loads and motors for a step."""
    take_step(work.moves, times[0], times[1], times[2], times[3:], work.c, work.drives[first:], work.gains[first:])
    return DONE


@part
def begin(work, instant, moved, v, times):
    """Store the points at a step's beginning, and h, which is the first of the times at an address, or was prepared."""
    if times != 0:
        work.h[0] = carray(pointer(times), (1,))[0]
    joints.point_values(work.scene.links, moved, work.points[START])
    joints.point_values(work.scene.links, v, work.points[VX])
    return DONE


@part
def add_slowing(work, moved, v, still, residual):
    """Add the forces of damping and relaxation to the residual. still, 0 or 1: factor of the strain in the relaxing strains' equations."""
    optional = work.optional
    if optional[DAMPING] != 0:
        call(optional[DAMPING], (optional[PARTS], moved, v, work.damp, residual))
    if optional[RELAXING] != 0:
        call(optional[RELAXING], (optional[PARTS], still, moved, v, residual))


@part
def add_forces(work, drives, moved, v, residual):
    """Add the forces of damping, relaxation and force elements to the residual. Returns a status."""
    add_slowing(work, moved, v, 1, residual)
    if work.optional[LAW_FORCES] != 0:
        return call(work.optional[LAW_FORCES], (work.optional[PARTS], drives, moved, v, residual))
    return DONE


@part
def residual(work, instant, moved, v, a, lam, residual, phi):
    """Fill the residual `M a + g + B^T lam` and phi, both from positions. Returns a status."""
    k, drives = work.stage[instant], work.drives[instant]
    det, cosine = kernels.equilibrium(work.scene, drives, moved, a, lam, residual, phi, work.rotation[k], work.dz[k], work.forces)
    work.cosine[0] = cosine
    if not det > 0.0:
        return INVERTED if det <= 0.0 else NOT_FINITE
    if work.strict and not cosine > 0.0:
        return HALF_TURN
    status = add_forces(work, drives, moved, v, residual)
    if work.condensed.calls[WORKSPACE] != 0:
        call(work.condensed.calls[ADD_FORCE_OF_REDUCED_PLATES], (work.condensed.calls[WORKSPACE], moved, residual))
    if work.keeps_middle and k == work.rotation.shape[0] // 2:
        copy_matrix(moved[: work.u.shape[0]], work.u)
        joints.point_values(work.scene.links, v, work.vz)
    return status


@part
def constraints(work, instant, moved, du, dv, phi, rate):
    """Fill phi and its rate by increments du, dv since the step's beginning; or, without increments, phi from positions."""
    links, points = work.scene.links, work.points
    if work.incremental:
        joints.point_values(links, du, points[DX])
        joints.point_values(links, dv, points[DV])
        drives, gains, h = work.drives[work.begin[instant]], work.gains[instant], work.c[work.stage[instant]] * work.h[0]
        joints.joint_change(links, drives, gains, h, points, phi, rate)
    else:
        joints.point_values(links, moved, points[DX])
        joints.joint_forces(links, work.drives[instant], points[DX], work.level, phi, work.forces)
    return DONE


@part
def rate(work, instant, moved, v, out):
    """out = `phi_q v + phi_t`, at displacements and velocities of the nodes."""
    dz = work.dz[work.stage[instant]]
    joints.point_values(work.scene.links, moved, dz)
    velocity_rate(work.scene.links, work.drives[instant], dz, v, work.projection)
    put(1.0, work.projection.rate, out)
    return DONE


@part
def project(work, instant, changes, vector, from_zero):
    """Change a vector x by the least M-norm, so that B x falls by `changes`; from_zero: x becomes the least one with `B x = B x_before - changes`."""
    links, projection = work.scene.links, work.projection
    put(1.0, changes, projection.bias)
    if from_zero:
        joints.point_values(links, vector, projection.vz)
        for k in range(changes.shape[0]):
            projection.bias[k] -= joints.along(links, projection.slopes, k, projection.vz)
        clear(vector)
    return DONE if project_rows(links, projection, projection.bias, vector) else SINGULAR


@part
def accept(work, instant):
    """Reject a state if a motor is on the wrong half-turn; q is that of the last RESIDUAL up to one correction."""
    return DONE if work.cosine[0] > 0.0 else HALF_TURN


@part
def acceleration(work, instant, moved, v, a, lam):
    """Fill a and lam of `[[M, B^T], [B, 0]] (a, lam) = (-g, -phi_bias)`; a stays as it is if this is singular."""
    k, drives, g, free = work.stage[instant], work.drives[instant], work.nodal[0], work.nodal[1]
    kernels.equilibrium(work.scene, drives, moved, work.still, work.level, g, work.spare, work.rotation[k], work.dz[k], work.forces)
    add_forces(work, drives, moved, v, g)
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
    own, workspace = factor.workspace.element_slopes, factor.workspace
    own[:] = 0.0
    call(optional[LAW_SLOPES], (optional[PARTS], drives, dz, vz, factor.c[C_V:], own))
    corotated.condense_states(links.coupling, factor.factored, own)
    corotated.turn_frames(links, factor.factored, workspace, work.rotation[work.rotation.shape[0] - 1])
    corotated.turn_slopes(links, workspace, -1.0, own, own)
    return DONE


new_slopes = served(take_new_slopes, None, None)


@part
def solve(work, instant, moved, lam, residual, phi, dq, dlam):
    """Overwrite dq and dlam with one Newton correction, `S dq + B^T dlam = -residual`, `B dq = -phi`; return DONE, or SINGULAR.

    The factors are those in work. moved: displacements of nodes at the trial state; lam: its multipliers. Strains of viscoelastic
    plates are eliminated before, and recovered in dq after it.
    """
    strains, condensed = work.real.workspace.elimination, work.condensed.calls[WORKSPACE] != 0
    right = residual if condensed else eliminate(strains, moved, residual)
    regular = factors.solve(work, work.real, instant, right, phi, lam, dq, dlam)
    if not condensed:
        recover(strains, moved, dq)
    return DONE if regular else SINGULAR


@part
def strains(work, instant, past, now, state, numbers):
    """Begin a step of the strains if state is 0, or end it; addresses of arrays."""
    calls = work.condensed.calls
    if state == 0:
        return call(calls[BEGIN_STRAINS], (calls[WORKSPACE], past, numbers))
    return call(calls[END_STRAINS], (calls[WORKSPACE], now, past, state, numbers))


@part
def reaction(work, instant, moved, mu, dv):
    """Add B^T mu to dv, with B at the displacements `moved`."""
    links, dz = work.scene.links, work.dz[work.stage[instant]]
    joints.point_values(links, moved, dz)
    clear(work.forces)
    joints.joint_forces(links, work.drives[instant], dz, mu, work.spare, work.forces)
    joints.spread(links, work.forces, dv)
    return DONE


@part
def middle_rows(work, instant):
    """Mark the borders of constraints as out of date: the next solve computes them, for all iterations of a step."""
    work.anew[:] = 1
    return DONE


@part
def turn(work, first, residuals, back):
    """Rotate the residuals (s, nodes, 2) of all stages in place.

    back = 0 turns them into the frame of the middle stage and stores the rotations in work.turn; back = 1 turns corrections back by these.
    """
    for k in range(residuals.shape[0]):
        if back:
            turn_back(work.turn[k, : work.rotation.shape[1]], residuals[k])
        else:
            turn_to(work.rotation[k], work.rotation[residuals.shape[0] // 2], work.turn[k], residuals[k])
    return DONE


@fast
def turn_to(own, middle, turn, values):
    """Rotate the values (nodes, 2) from the frames `own` to the frames `middle`; turn (nodes, 2) becomes cosine and sine."""
    for i in range(own.shape[0]):
        mx, my, x, y = middle[i, 0], middle[i, 1], own[i, 0], own[i, 1]
        size = 1.0 / np.sqrt((mx * mx + my * my) * (x * x + y * y))
        c, n = (mx * x + my * y) * size, (my * x - mx * y) * size
        p, q = values[i, 0], values[i, 1]
        turn[i, 0], turn[i, 1] = c, n
        values[i, 0], values[i, 1] = c * p - n * q, n * p + c * q


@fast
def turn_back(turn, dq):
    """Rotate dq by the inverse of turn."""
    for i in range(turn.shape[0]):
        p, q, c, n = dq[i, 0], dq[i, 1], turn[i, 0], turn[i, 1]
        dq[i, 0], dq[i, 1] = c * p + n * q, c * q - n * p


@part
def real(work, instant, residual, closing, lam, dq, multipliers):
    """Fill dq and multipliers, the correction of the real mode."""
    return factors.solve_mode(work, instant, factors.REAL, work.real, residual, closing, lam, dq, multipliers)


@part
def pair(work, instant, residual, closing, lam, dq, multipliers):
    """Fill dq and multipliers, complex: the correction of the complex mode."""
    return factors.solve_mode(work, instant, factors.PAIR, work.pair, residual, closing, lam, dq, multipliers)


@part
def momentum(work, a, out):
    """Add the inertia force M a of all bodies and point masses to `out`."""
    kernels.momentum(work.scene, a, out)
    links = work.scene.links
    joints.point_values(links, a, work.points[DX])
    for p in range(work.forces.shape[0]):
        work.forces[p, 0] = links.point_mass[p] * work.points[DX, p, 0]
        work.forces[p, 1] = links.point_mass[p] * work.points[DX, p, 1]
    joints.spread(links, work.forces, out)


@part
def add_law_damping(work, drives, dz, v, residual):
    """Add C v of the force elements to the residual, with C at the places dz of the points and the velocities of the last residual."""
    moved, forces, optional = work.points[DX], work.forces, work.optional
    if optional[LAW_DAMPING] != 0:
        joints.point_values(work.scene.links, v, moved)
        clear(forces)
        call(optional[LAW_DAMPING], (optional[PARTS], drives, dz, work.vz, moved, forces))
        joints.spread(work.scene.links, forces, residual)


@part
def inertia(work, instant, v, a, force, momentum_at, moved, rates_at):
    """Fill force = `C v + M a`, C at the displacements `moved`; and M v and (0, B v) at their addresses, unless these are 0.

    B is that of the stage's last residual; rates_at: (2, m).
    """
    links, drives, dz = work.scene.links, work.drives[instant], work.dz[work.stage[instant]]
    clear(force)
    momentum(work, a, force)
    add_slowing(work, moved, v, 0, force)
    add_law_damping(work, drives, dz, v, force)
    if momentum_at:
        impulse = pairs(work, momentum_at)
        clear(impulse)
        momentum(work, v, impulse)
    if rates_at:
        joints.point_values(links, v, work.points[DX])
        out = both_rows(work, rates_at)
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
