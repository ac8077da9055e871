"""The saddle-point solve of a scene with an old factor in the frame of the nodal rotations and current constraints.

```
[ S + A^T C A    A^T Bz^T ] [ dq   ]     [ r   ]     S = c_m M + K of the plates, A: q -> points, C = curvature of the rows
[ Bz A           0        ] [ dlam ] = - [ phi ]         + c_m masses at points, Bz = phi_z
```
Where friction slips, the slopes of its forces in the multipliers that press are added to A^T Bz^T.

`S^-1 ~ P S_ref^-1 P^T` with P = R(q) R(q_ref)^T at each node: the factor of an elastic plate stays valid while it turns. Joints act through
few points z = A q: the border costs `X = S^-1 A^T` once for each factor, and one small sparse system (border.py) for each solve. X is as
old as the factor, but `G = A X` uses the same X: therefore dq satisfies `Bz A dq = -phi` to round-off. S, r and phi may be complex; S is
then symmetric, not Hermitian. Frames and Bz are real.
"""

from typing import NamedTuple

import numpy as np

from polyida.assembly import joints
from polyida.assembly.border import (
    Border,
    BorderWorkspace,
    body_of_points,
    border,
    border_workspace,
    fill_right_side,
    solve_border,
    solve_border_again,
)
from polyida.assembly.strain_elimination import Elimination, elimination_of
from polyida.jit import entry, leaf, pack, part, shared
from polyida.linear.columns import solve_columns
from polyida.linear.dense import clear, factor, put
from polyida.linear.dense import solve as solve_factored
from polyida.linear.dissection import Symbolic, symbolic_of
from polyida.linear.fronts import factorize, single, solve_fronts
from polyida.linear.team import Team, solve_together


@pack
class Corotated(NamedTuple):
    """A factor with its frame, and the columns X of the points."""

    fronts: Symbolic
    panels: np.ndarray
    frame: np.ndarray  # (nodes, 2) cos and sin of the nodal rotations
    place: np.ndarray  # (points, 3) first and last node of the point's body, and where its two columns X begin in compliance_columns
    compliance_columns: np.ndarray  # (., 2) columns X, each on the nodes of one body
    border: Border  # the pattern of the unknowns at the points
    turns: bool = True  # False: P = I, for comparisons


@pack
class SolveWorkspace(NamedTuple):
    """Workspace of a solve with the factor of a scene and its border."""

    x: np.ndarray  # (2 nodes,) right-hand side and solution in the order of the factor
    turn: np.ndarray  # (nodes, 2) cos and sin of P
    point_turn: np.ndarray  # (points, 2) the same, averaged at the points
    moved: np.ndarray  # (points, 2) A y
    border: BorderWorkspace
    point_forces: np.ndarray  # (points, 2) forces at the points
    summed: np.ndarray  # (2 nodes,) sum of columns X of one body, in the factor's frame
    element_slopes: (
        np.ndarray
    )  # (blocks, 2, 2) of the coupling: derivatives of the force elements in the factor's frames; (0, 2, 2) without
    keeps: np.ndarray  # (1,) 1 if the border of the last solve is used again
    team: Team | None = None  # of threads that share the solves
    elimination: Elimination | None = None  # of relaxed strains


def corotated(model, blocks, rotation, before=None):
    """The Corotated of tangent blocks and raw nodal rotations. Raises SingularSystem.

    before: a Corotated of the model that is overwritten, if its numbers have the same type.
    """
    if before is None or before.panels.dtype != single(blocks):
        before = empty_corotated(model, single(blocks))
    factorize(before.fronts, blocks, panels=before.panels)
    loads, x = model.once(unit_loads, of_shape=True), np.empty(2 * model.n_factored, before.panels.dtype)
    fill_compliance_columns(before, before.compliance_columns, rotation, loads, x)
    return before


def empty_corotated(model, dtype):
    """A Corotated of a model without numbers. dtype: of the panels."""
    fronts, place = model.once(symbolic_of, of_shape=True), model.once(_column_places, of_shape=True)
    columns = np.zeros((int(2 * (place[:, 1] - place[:, 0]).sum()), 2), dtype)
    panels, frame = np.empty(fronts.panel[-1], dtype), np.empty((model.n_factored, 2))
    return Corotated(fronts, panels, frame, place, columns, model.once(border, of_shape=True))


def _column_places(model):
    """(first pair, end, first column) of the body of each point whose force couples columns: `place` of Corotated, (points, 3)."""
    bodies = body_of_points(model)
    first, end = model.first_pairs[bodies], model.first_pairs[bodies + 1]
    return np.stack([first, end, 2 * (np.cumsum(end - first) - (end - first))], axis=1).astype(np.int64).reshape(-1, 3)


def columns_together(border):
    """Largest number of columns X on one body: the number of solves, because one solve finds a column of each body."""
    return 2 * int(np.diff(border.point_start).max(initial=0))


def unit_loads(model):
    """A^T of unit forces at points, (columns, nodes, 2): column k of all bodies together, because bodies are not coupled in S."""
    pattern, weights = model.once(border, of_shape=True), model.point_weights.conj()[:, : model.n_factored]
    groups, loads = np.split(pattern.points, pattern.point_start[1:-1]), np.zeros((columns_together(pattern), model.n_factored), complex)
    for k in range(0, len(loads), 2):
        loads[k] = weights[[group[k // 2] for group in groups if len(group) > k // 2]].sum(axis=0)
        loads[k + 1] = 1j * loads[k]
    return loads.view(float).reshape(*loads.shape, 2)


@entry
def fill_compliance_columns(factored, compliance_columns, rotation, loads, solution):
    """compliance_columns = S_ref^-1 loads, by the columns of the points, in the factor's frame.

    rotation: raw nodal rotations, which become that frame; may be empty.
    """
    for i in range(rotation.shape[0]):
        size = np.sqrt(rotation[i, 0] ** 2 + rotation[i, 1] ** 2)
        factored.frame[i, 0], factored.frame[i, 1] = rotation[i, 0] / size, rotation[i, 1] / size
    order, b = factored.fronts.order, factored.border
    for column in range(loads.shape[0]):
        for i in range(loads.shape[1]):
            solution[order[2 * i]], solution[order[2 * i + 1]] = loads[column, i, 0], loads[column, i, 1]
        solve_panels(factored.fronts, factored.panels, solution)
        for n in range(b.point_start.shape[0] - 1):
            e = b.point_start[n] + column // 2
            if e < b.point_start[n + 1]:
                first, end, at = factored.place[b.points[e], 0], factored.place[b.points[e], 1], factored.place[b.points[e], 2]
                at += column % 2 * (end - first) - first
                for i in range(first, end):
                    compliance_columns[at + i, 0], compliance_columns[at + i, 1] = solution[order[2 * i]], solution[order[2 * i + 1]]


def solve_workspace(model, system):
    """The SolveWorkspace of a factor."""
    dtype, blocks = np.result_type(system.panels, float), len(model.arrays.links.coupling.columns)
    return SolveWorkspace(
        x=np.zeros(2 * model.n_factored, system.panels.dtype),
        turn=np.empty((model.n_factored, 2)),
        point_turn=np.empty((model.n_points, 2)),
        moved=np.empty((model.n_points, 2), dtype),
        border=border_workspace(model, system.border, dtype),
        point_forces=np.empty((model.n_points, 2), dtype),
        summed=np.empty(2 * model.n_factored, dtype),
        element_slopes=np.zeros((blocks if len(model.laws.energies) else 0, 2, 2), dtype),
        keeps=np.zeros(1, np.int64),
        elimination=elimination_of(model, dtype),
    )


@shared
def solve_panels(fronts, panels, solution):
    """solution <- S_ref^-1 solution in the factor's order: `solve_fronts`, compiled once for all callers."""
    solve_fronts(fronts, panels, solution)


@part
def solve_in_place(factored, team, solution):
    """Solve by a team of threads, or alone if it is None. Its own function: numba drops a branch only if an argument is None."""
    if team is None:
        solve_panels(factored.fronts, factored.panels, solution)
    else:
        solve_together(factored.fronts, factored.panels, solution, team)


@part
def solve_turned(factored, work, size, residual, solution):
    """solution (nodes, 2) = P S_ref^-1 P^T residual.

    size: of residual, by which it is divided in the solve, so that it fits into single precision.
    """
    order, b, turn, part = factored.fronts.order, work.x, work.turn, 1.0 / size
    for i in range(turn.shape[0]):
        p, q = part * residual[i, 0], part * residual[i, 1]
        b[order[2 * i]] = turn[i, 0] * p + turn[i, 1] * q
        b[order[2 * i + 1]] = turn[i, 0] * q - turn[i, 1] * p
    solve_in_place(factored, work.team, b)
    for i in range(turn.shape[0]):
        p, q = size * b[order[2 * i]], size * b[order[2 * i + 1]]
        solution[i, 0] = turn[i, 0] * p - turn[i, 1] * q
        solution[i, 1] = turn[i, 1] * p + turn[i, 0] * q


@part
def solve_turned_columns(factored, work, lanes, sizes, residual, solution, which):
    """solution = P S_ref^-1 P^T residual for the columns in `which`, at most COLUMNS, with one pass through the factor.

    residual, solution: (columns, nodes, 2). sizes (columns,): of the residuals, by which they are divided in the solve. lanes: workspace.
    """
    order, turn, count, parts = factored.fronts.order, work.turn, which.shape[0], np.empty(lanes.shape[1])
    for e in range(count):
        parts[e] = 1.0 / sizes[which[e]]
    for i in range(turn.shape[0]):
        first, second, co, si = lanes[order[2 * i]], lanes[order[2 * i + 1]], turn[i, 0], turn[i, 1]
        for e in range(count):
            p, q = parts[e] * residual[which[e], i, 0], parts[e] * residual[which[e], i, 1]
            first[e], second[e] = co * p + si * q, co * q - si * p
        for e in range(count, lanes.shape[1]):
            first[e] = second[e] = 0.0
    solve_columns(factored.fronts, factored.panels, lanes)
    for i in range(turn.shape[0]):
        first, second, co, si = lanes[order[2 * i]], lanes[order[2 * i + 1]], turn[i, 0], turn[i, 1]
        for e in range(count):
            p, q = sizes[which[e]] * first[e], sizes[which[e]] * second[e]
            solution[which[e], i, 0], solution[which[e], i, 1] = co * p - si * q, si * p + co * q


@shared
def solve(links, factored, work, drives, rotation, dz, lam, residual, phi, c_m, dq, dlam):
    """Solve the saddle-point system of the module's head for dq (nodes, 2) and dlam (m,).

    1. y = -S^-1 r. 2. The matrices of the border, unless work.keeps. 3. A y. 4. Multipliers and forces s at the points. 5. dq = y - X s.

    rotation (nodes, 2), dz (points, 2): of `equilibrium` at the current q. residual (nodes, 2), phi (m,): r and phi. c_m: of the masses at
    points. Returns False if the system is singular.
    """
    turn_frames(links, factored, work, rotation)
    solve_turned(factored, work, 1.0, residual, dq)
    for i in range(work.turn.shape[0]):
        dq[i, 0], dq[i, 1] = -dq[i, 0], -dq[i, 1]
    if work.point_turn.shape[0] == 0:
        return True
    if not work.keeps[0]:
        fill_border(links, factored, work, drives, dz, lam, c_m)
    joints.point_values(links, dq, work.moved)
    if not solve_multipliers(links, factored, work, phi, dlam):
        return False
    apply_point_forces(links, factored, work, dq)
    settle_states(links, factored, work.border.curvature, work.moved, dq)
    return True


@part
def fill_border(links, factored, work, drives, dz, lam, c_m):
    """Fill the numbers of work.border at the current q: G = A X, Bz, the curvature C and the slopes of friction.

    C: of rows, force elements and masses at points.
    """
    fill_point_compliance(links, factored, work)
    joints.joint_jacobian(links, drives, dz, work.border.slopes)
    if work.element_slopes.shape[0]:
        turn_slopes(links, work, 1.0, work.element_slopes, work.border.curvature)
    else:
        work.border.curvature[:] = 0.0
    joints.joint_curvature(links, drives, lam, work.border.curvature)
    if work.border.friction.shape[0]:
        joints.slip_slopes(links.slips, drives, dz, lam, work.border.slip_rows, work.border.friction)
    add_masses(links, c_m, work.border.curvature)


@part
def turn_frames(links, factored, work, rotation):
    """turn = R(q) R(q_ref)^T at the nodes, point_turn = its mean over the nodes of a point, as (cos, sin)."""
    if not factored.turns:
        for frames in (work.turn, work.point_turn):
            for i in range(frames.shape[0]):
                frames[i, 0], frames[i, 1] = 1.0, 0.0
        return
    for i in range(work.turn.shape[0]):
        x, y = rotation[i, 0], rotation[i, 1]
        size = 1.0 / np.sqrt(x * x + y * y)
        x, y = x * size, y * size
        work.turn[i, 0] = x * factored.frame[i, 0] + y * factored.frame[i, 1]
        work.turn[i, 1] = y * factored.frame[i, 0] - x * factored.frame[i, 1]
    for f in range(work.point_turn.shape[0]):
        x = y = 0.0
        for k in range(links.point_ptr[f], links.point_ptr[f + 1]):
            x += work.turn[links.point_nodes[k], 0]
            y += work.turn[links.point_nodes[k], 1]
        size = 1.0 / np.sqrt(x * x + y * y)
        work.point_turn[f, 0] = x * size
        work.point_turn[f, 1] = y * size


@part
def fill_point_compliance(links, factored, work):
    """Fill work.border.blocks with G = A X at the current rotations, body by body: (2 points, 2 points) each, row by row."""
    border, blocks = factored.border, work.border.blocks
    for n in range(border.block.shape[0] - 1):
        first, end = border.point_start[n], border.point_start[n + 1]
        wide = 2 * (end - first)
        for e in range(first, end):
            for o in range(first, end):
                row_point, column_point = border.points[e], border.points[o]
                first_node, end_node, column = (
                    factored.place[column_point, 0],
                    factored.place[column_point, 1],
                    factored.place[column_point, 2],
                )
                # both columns X of the point at node i: at along + i and across + i
                along = column - first_node
                across = along + end_node - first_node
                xx = xy = yx = yy = 0.0
                for k in range(links.point_ptr[row_point], links.point_ptr[row_point + 1]):
                    i, re, im = links.point_nodes[k], links.point_weights[k, 0], links.point_weights[k, 1]
                    co, si = re * work.turn[i, 0] - im * work.turn[i, 1], re * work.turn[i, 1] + im * work.turn[i, 0]
                    p, q = factored.compliance_columns[along + i, 0], factored.compliance_columns[along + i, 1]
                    xx += co * p - si * q
                    yx += si * p + co * q
                    p, q = factored.compliance_columns[across + i, 0], factored.compliance_columns[across + i, 1]
                    xy += co * p - si * q
                    yy += si * p + co * q
                co, si = work.point_turn[column_point, 0], work.point_turn[column_point, 1]
                target = border.block[n] + 2 * (e - first) * wide + 2 * (o - first)
                blocks[target], blocks[target + 1] = xx * co - xy * si, xx * si + xy * co
                blocks[target + wide], blocks[target + wide + 1] = yx * co - yy * si, yx * si + yy * co


@leaf
def blocks_of_element(coupling, number):
    """Return (first block, other points, points) of a force element, from the number of its first state among those of the coupling.

    The blocks of its states follow each other from the first block on, row after row of `points` blocks, those of its other points first.
    """
    state = coupling.states[number]
    first_block, other_points = coupling.start[state], 0
    while coupling.columns[first_block + other_points] != state:
        other_points += 1
    return first_block, other_points, coupling.start[state + 1] - first_block


@leaf
def entry_of(first_block, points, i, j):
    """Return (block, row, column) of components i and j in the rows of blocks that begin at first_block, `points` blocks in each row."""
    return first_block + i // 2 * points + j // 2, i % 2, j % 2


@leaf
def block_of(coupling, point, other):
    """The block of two points."""
    block = coupling.start[point]
    while coupling.columns[block] != other:
        block += 1
    return block


@entry
def condense_states(coupling, factored, curvature):
    """Eliminate the states s of force elements from the blocks C of the coupling, z being their other points.

    No row holds a state, which moves by `ds = y - g (C_sz dz + C_ss ds)`, g = 1/(c_m mass), its entry of X. C_zz, C_zs, C_sz, C_ss are the
    blocks of C. With `T = (1 + g C_ss)^-1` it is `ds = T y - g T C_sz dz`, and the force on z is
    `(C_zz - g C_zs T C_sz) dz + C_zs T y`. So C becomes ((C_zz - g C_zs T C_sz, C_zs T), (T C_sz, T)).
    """
    number = 0
    while number < coupling.states.shape[0]:
        first_block, other_points, points = blocks_of_element(coupling, number)
        count = 2 * (points - other_points)  # components of states
        g = factored.compliance_columns[factored.place[coupling.states[number], 2], 0]
        below = np.empty((count, 2 * points), curvature.dtype)
        fill_below(first_block, other_points, points, g, curvature, below)
        correct_others(coupling, first_block, other_points, points, g, below, curvature)
        number += points - other_points


@part
def fill_below(first_block, other_points, points, g, curvature, below):
    """below = (T C_sz, T), (components of states, components of all points of an element), also stored in the rows of the states."""
    count, others = below.shape[0], 2 * other_points
    inverse = np.empty((count, count), curvature.dtype)  # 1 + g C_ss, the inverse of T; then its factors
    column, pivots = np.empty(count, curvature.dtype), np.empty(count, np.int64)
    for i in range(count):
        for j in range(count):
            block, row, other = entry_of(first_block, points, i, others + j)
            inverse[i, j] = g * curvature[block, row, other] + (1.0 if i == j else 0.0)
    factor(inverse, pivots)
    for j in range(2 * points):
        for i in range(count):
            block, row, other = entry_of(first_block, points, i, j)
            column[i] = curvature[block, row, other] if j < others else (1.0 if others + i == j else 0.0)
        solve_factored(inverse, pivots, column)
        for i in range(count):
            block, row, other = entry_of(first_block, points, i, j)
            below[i, j] = curvature[block, row, other] = column[i]


@part
def correct_others(coupling, first_block, other_points, points, g, below, curvature):
    """C_zz -= g C_zs T C_sz, and C_zs becomes C_zs T, for one element; below = (T C_sz, T)."""
    count, others = below.shape[0], 2 * other_points
    column = np.empty(count, curvature.dtype)
    for n in range(others):
        for i in range(count):
            block, row, other = entry_of(first_block, points, i, n)
            column[i] = curvature[coupling.mirror[block], other, row]
        for j in range(2 * points):
            total = 0.0 * g  # of the type of g, real or complex
            for i in range(count):
                total += column[i] * below[i, j]
            if j < others:
                block = block_of(coupling, coupling.columns[first_block + n // 2], coupling.columns[first_block + j // 2])
                curvature[block, n % 2, j % 2] -= g * total
            else:
                block, row, other = entry_of(first_block, points, j - others, n)
                curvature[coupling.mirror[block], other, row] = total


@part
def settle_states(links, factored, curvature, y, dq):
    """Fill dq of the states from that of the other points and from y (points, 2); curvature: of `condense_states`."""
    coupling, number = links.coupling, 0
    while number < coupling.states.shape[0]:
        first_block, others, points = blocks_of_element(coupling, number)
        g = factored.compliance_columns[factored.place[coupling.states[number], 2], 0]
        for i in range(points - others):
            ds = dq[links.point_nodes[links.point_ptr[coupling.states[number + i]]]]
            ds[0] = ds[1] = 0.0
            for j in range(points):
                block, point = curvature[first_block + i * points + j], coupling.columns[first_block + j]
                p, q = y[point, 0], y[point, 1]
                if j < others:
                    p, q = joints.point_value(links, dq, point)
                    p, q = -g * p, -g * q
                ds[0] += block[0, 0] * p + block[0, 1] * q
                ds[1] += block[1, 0] * p + block[1, 1] * q
        number += points - others


@part
def turn_slopes(links, work, sense, slopes, out):
    """out = R_f slopes R_h^T for the blocks of points f and h, R the rotation of a direction since the factor, 1 of other points.

    sense -1: backwards, from the frames of work.point_turn into those of the factor.
    """
    for f in range(work.point_turn.shape[0]):
        for k in range(links.coupling.start[f], links.coupling.start[f + 1]):
            block, h = out[k], links.coupling.columns[k]
            c, n = (work.point_turn[f, 0], sense * work.point_turn[f, 1]) if links.point_turns[f] else (1.0, 0.0)
            for j in range(2):
                x, y = slopes[k, 0, j], slopes[k, 1, j]
                block[0, j], block[1, j] = c * x - n * y, n * x + c * y
            c, n = (work.point_turn[h, 0], sense * work.point_turn[h, 1]) if links.point_turns[h] else (1.0, 0.0)
            for i in range(2):
                block[i, 0], block[i, 1] = c * block[i, 0] - n * block[i, 1], n * block[i, 0] + c * block[i, 1]


@part
def add_masses(links, c_m, curvature):
    """Blocks of the coupling += c_m times the masses at points."""
    for f in range(links.point_mass.shape[0]):
        k = links.coupling.mass[f]
        if k >= 0:
            curvature[k, 0, 0] += c_m * links.point_mass[f]
            curvature[k, 1, 1] += c_m * links.point_mass[f]


@part
def solve_multipliers(links, factored, work, phi, dlam):
    """Fill work.point_forces and dlam from work.moved = A y, y = -S^-1 r, the border and its curvature. Returns False if it is singular.

    `dq = y - X s`, `s = w + Bz^T dlam`, `w = C A dq`: unknowns w on the active components and dlam,
    `(I + C G) w + C G Bz^T dlam = C A y`, `Bz G w + Bz G Bz^T dlam = Bz A y + phi`.
    """
    fill_right_side(factored.border, work.border, work.moved)
    count = factored.border.active.shape[0]
    for k in range(phi.shape[0]):
        work.border.right[count + k] += phi[k]
    if not (solve_border_again(factored.border, work.border) if work.keeps[0] else solve_border(factored.border, work.border)):
        return False
    clear(work.point_forces)
    for i in range(count):
        component = factored.border.active[i]
        work.point_forces[component >> 1, component & 1] = work.border.x[i]
    put(1.0, work.border.x[count:], dlam)
    joints.add_rows(links, work.border.slopes, dlam, work.point_forces)
    for e in range(work.border.friction.shape[0]):
        i = factored.border.slip_component[e]
        work.point_forces[i >> 1, i & 1] += work.border.friction[e] * dlam[factored.border.slip_row[e]]
    return True


@part
def apply_point_forces(links, factored, work, dq):
    """dq -= X point_forces at the current rotations: the columns are added up in the factor's frame of each body."""
    b = factored.border
    for n in range(b.point_start.shape[0] - 1):
        first = end = 0
        for e in range(b.point_start[n], b.point_start[n + 1]):
            f = b.points[e]
            co, si = work.point_turn[f, 0], work.point_turn[f, 1]
            x, y = work.point_forces[f, 0], work.point_forces[f, 1]
            p, q = co * x + si * y, co * y - si * x
            if p == 0.0 and q == 0.0:
                continue
            fresh, first, end = end == 0, factored.place[f, 0], factored.place[f, 1]
            add_columns(factored.compliance_columns, factored.place[f, 2], end - first, p, q, fresh, work.summed)
        for i in range(first, end):
            gx, gy = work.summed[2 * (i - first)], work.summed[2 * (i - first) + 1]
            dq[i, 0] -= work.turn[i, 0] * gx - work.turn[i, 1] * gy
            dq[i, 1] -= work.turn[i, 1] * gx + work.turn[i, 0] * gy


@part
def add_columns(columns, at, count, p, q, fresh, out):
    """out = or, unless `fresh`, += p times the column of `count` nodes that begins at `at`, + q times the next one."""
    flat, wide = columns.reshape(-1), 2 * count  # loops over pairs take three times as long
    along, across = flat[2 * at : 2 * at + wide], flat[2 * at + wide : 2 * at + 2 * wide]
    if fresh:
        for i in range(wide):
            out[i] = along[i] * p + across[i] * q
    else:
        for i in range(wide):
            out[i] += along[i] * p + across[i] * q
