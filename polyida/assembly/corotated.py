"""The saddle-point solve of a scene with a stale factor in the frame of the nodal rotations, constraints exact.

```
[ S + A^T C A    A^T Bz^T ] [ dq   ]     [ r   ]     S = c_m M + K of the plates, A: q -> points, C = curvature of the rows
[ Bz A           0        ] [ dlam ] = - [ phi ]         + c_m masses at points, Bz = phi_z
```
`S^-1 ~ P S_ref^-1 P^T` with P = R(q) R(q_ref)^T node by node: elastic plates that turn keep their factor. All joints act through the
few points z = A q, so the border costs `X = S^-1 A^T`, made once a factor, and a dense system of its own size a solve. X is as stale
as the factor, but `G = A X` is taken from that same X: dq satisfies `Bz A dq = -phi` to round-off however stale it is.
S, r and phi may be complex, and are symmetric then, not Hermitian; frames and Bz stay real.
"""

from typing import NamedTuple

import numpy as np

from polyida.assembly.arrays import bilinear
from polyida.assembly.rows import joints
from polyida.jit import entry, pack, part, shared
from polyida.linear.cholesky.factor import BAND, FRONTS, Factor, factor
from polyida.linear.cholesky.fronts import solve_fronts
from polyida.linear.cholesky.team import Team, solve_together
from polyida.linear.cholesky.triangular import solve_band, solve_columns
from polyida.linear.dense import clear, solve_small

UNIT = (lambda c, n: np.stack([c, -n], axis=1), lambda c, n: np.stack([n, c], axis=1))  # A^T of a unit along x and along y


@pack
class Corotated(NamedTuple):
    """A factor with its frame (cos, sin of the nodal rotations, (nodes, 2)), and the points' columns X.

    point_body: first and last node of the body that each point is on; reach: X, (2 per point, nodes, 2), zero off the body;
    active: the components of the points that curvature or mass can act on. place: the order of the unknowns (active, multipliers) along
    the joints. turns: whether the factor turns with the nodes, P, or stays as it was made, P = I, which is there to be compared with.
    """

    factor: Factor
    frame: np.ndarray
    point_body: np.ndarray
    reach: np.ndarray
    active: np.ndarray
    place: np.ndarray
    turns: bool = True


@pack
class Room(NamedTuple):
    """Scratch of a solve; own: slopes of the force elements on the points, as old as the factor, or (0, 0). team: of threads that serve it."""

    x: np.ndarray
    turn: np.ndarray
    spin: np.ndarray
    moved: np.ndarray
    g: np.ndarray
    slopes: np.ndarray
    curvature: np.ndarray
    gb: np.ndarray
    small: np.ndarray
    right: np.ndarray
    last: np.ndarray
    pull: np.ndarray
    own: np.ndarray
    team: Team | None = None


def corotated(model, blocks, rotation, backend="auto", phase=1.0):
    """(Corotated, name of its back-end) for the tangent blocks and raw nodal rotations at hand; phase as `factor` has it.

    Raises NotFactorable.
    """
    made, name = factor(model, blocks, backend, phase)
    frame = rotation / np.linalg.norm(rotation, axis=1, keepdims=True)
    reach, (point_body, active, place) = np.zeros((2 * model.n_points, model.n_nodes, 2), made.band.dtype), model.once(_of_points)
    result = Corotated(made, frame, point_body, reach, active, place)
    fill_reach(model.arrays.links, result)
    return result, name


def _of_points(model):
    """(point_body, active, place) of a model's factors."""
    s, first = model.arrays.links, model.first_pairs
    bodies = np.searchsorted(first, s.point_nodes[s.point_ptr[:-1]], side="right") - 1
    active = active_components(s, model.laws)
    return np.stack([first[bodies], first[bodies + 1]], axis=1).astype(np.int64).reshape(-1, 2), active, order_along_joints(active, s)


def fill_reach(s, c, product=None):
    """X = S_ref^-1 A^T in the factor's own frame, one column a component of a point; S_ref^-1 M A^T with M's `product`."""
    order, behind = c.factor.order, c.factor.band.shape[1]
    x = np.zeros((len(c.reach), len(order) + behind), c.reach.dtype)
    points, pairs = np.repeat(np.arange(len(c.reach) // 2), np.diff(s.point_ptr)), order.reshape(-1, 2)
    for axis, unit in enumerate(UNIT):
        if product is None:
            x[2 * points[:, None] + axis, pairs[s.point_nodes]] = unit(*s.point_weights.T)
            continue
        for f in range(len(c.reach) // 2):
            load, part = np.zeros(c.reach.shape[1:]), points == f
            load[s.point_nodes[part]] = unit(*s.point_weights[part].T)
            x[2 * f + axis, order] = product(load).ravel()
    all_triangular(c.factor, x)
    for column, (values, found) in enumerate(zip(c.reach, x)):
        body = slice(*c.point_body[column // 2])
        values[body] = found[pairs[body]]


def active_components(s, laws):
    """Components of the points on which a mass, the curvature of a row or a force element can act."""
    acts = s.point_mass != 0
    if laws is not None:
        acts[laws.points[laws.points >= 0]] = True
    for p in np.flatnonzero(bilinear(s)):
        for i in (s.product_first[p], s.product_second[p]):
            acts[s.vector_points[s.vector_start[i] : s.vector_start[i + 1]]] = True
    return np.flatnonzero(np.repeat(acts, 2))


def order_along_joints(active, s):
    """Place of each unknown (active components, then multipliers): every row of phi after the components it touches."""
    number, order, m = {int(p): i for i, p in enumerate(active)}, [], len(s.row_constant)
    for row in range(m):
        columns = s.row_columns[s.row_start[row] : s.row_start[row + 1]]
        order += [number.pop(p) for p in columns.tolist() if p in number]
        order.append(len(active) + row)
    order += number.values()
    place = np.empty(len(active) + m, np.int64)
    place[order] = np.arange(len(order))
    return place


def room(model, system):
    """Scratch for solves with `system`."""
    points, m, size = 2 * model.n_points, model.m, len(system.active) + model.m
    band = system.factor.band
    dtype = np.result_type(band, float)
    return Room(
        np.zeros(model.n + band.shape[1], band.dtype),
        np.empty((model.n_nodes, 2)),
        np.empty((model.n_points, 2)),
        np.empty((model.n_points, 2), dtype),
        np.empty((points, points), dtype),
        np.empty(len(model.arrays.links.row_columns)),
        np.empty((points, points), dtype),
        np.empty((points, m), dtype),
        *small_room(size, dtype),
        np.empty(points, dtype),
        np.zeros((0, 0) if model.laws is None else (points, points), dtype),
    )


def small_room(size, dtype=float):
    """Of the dense system of the border: matrix, right-hand side, last columns."""
    return np.empty((size, size), dtype), np.empty(size, dtype), np.empty(size, np.int64)


@shared
def triangular(f, x):
    """x <- S_ref^-1 x in the factor's order."""
    if f.kind == FRONTS:
        solve_fronts(f.fronts, f.panels, x)
    elif f.kind == BAND:
        solve_band(f.band, x)
    else:
        solve_columns(f.start, f.rows, f.values, f.reciprocal, x)


@entry
def all_triangular(f, x):
    """Each row of x <- S_ref^-1 x in the factor's order; behind a row's n numbers it holds as many zeros as the band is wide."""
    for column in x:
        triangular(f, column)


@part
def solve_in_place(f, team, x):
    """The same, by a team where there is one."""
    if team is None:
        triangular(f, x)
    else:
        solve_together(f.fronts, f.panels, x, team)


@part
def solve_plates(s, c, w, rotation, r, x):
    """x (nodes, 2) = P S_ref^-1 P^T r, and the frames of nodes and points for what follows."""
    turn_frames(s, c, w, rotation)
    order, b, turn = c.factor.order, w.x, w.turn
    for i in range(r.shape[0]):
        b[order[2 * i]] = turn[i, 0] * r[i, 0] + turn[i, 1] * r[i, 1]
        b[order[2 * i + 1]] = turn[i, 0] * r[i, 1] - turn[i, 1] * r[i, 0]
    for k in range(2 * r.shape[0], b.shape[0]):
        b[k] = np.float32(0.0)
    solve_in_place(c.factor, w.team, b)
    for i in range(r.shape[0]):
        p, q = b[order[2 * i]], b[order[2 * i + 1]]
        x[i, 0] = turn[i, 0] * p - turn[i, 1] * q
        x[i, 1] = turn[i, 1] * p + turn[i, 0] * q


@shared
def solve(s, c, w, drives, rotation, dz, lam, r, phi, c_m, dq, dlam):
    """Fill dq (nodes, 2) and dlam (m,); rotation, dz as `equilibrium` left them at the current q. False where it is singular."""
    solve_plates(s, c, w, rotation, r, dq)
    for i in range(r.shape[0]):
        dq[i, 0], dq[i, 1] = -dq[i, 0], -dq[i, 1]
    if w.g.shape[0] == 0:
        return True
    if not border(s, c, w, drives, dz, lam, phi, c_m, dq, dlam):
        return False
    pull_points(s, c, w, dq)
    return True


@part
def turn_frames(s, c, w, rotation):
    """turn = R(q) R(q_ref)^T at the nodes, spin = its mean at the points, as (cos, sin)."""
    if not c.turns:
        for frames in (w.turn, w.spin):
            for i in range(frames.shape[0]):
                frames[i, 0], frames[i, 1] = 1.0, 0.0
        return
    for i in range(rotation.shape[0]):
        x, y = rotation[i, 0], rotation[i, 1]
        size = 1.0 / np.sqrt(x * x + y * y)
        x, y = x * size, y * size
        w.turn[i, 0] = x * c.frame[i, 0] + y * c.frame[i, 1]
        w.turn[i, 1] = y * c.frame[i, 0] - x * c.frame[i, 1]
    for f in range(w.spin.shape[0]):
        x = y = 0.0
        for k in range(s.point_ptr[f], s.point_ptr[f + 1]):
            x += w.turn[s.point_nodes[k], 0]
            y += w.turn[s.point_nodes[k], 1]
        size = 1.0 / np.sqrt(x * x + y * y)
        w.spin[f, 0] = x * size
        w.spin[f, 1] = y * size


@part
def points_matrix(s, c, w):
    """G = A X at the present rotations, (2 points, 2 points), zero between bodies."""
    for f in range(w.spin.shape[0]):
        for h in range(w.spin.shape[0]):
            xx = xy = yx = yy = 0.0
            end = s.point_ptr[f + 1] if c.point_body[f, 0] == c.point_body[h, 0] else s.point_ptr[f]
            for k in range(s.point_ptr[f], end):
                i, c0, n0 = s.point_nodes[k], s.point_weights[k, 0], s.point_weights[k, 1]
                co, si = c0 * w.turn[i, 0] - n0 * w.turn[i, 1], c0 * w.turn[i, 1] + n0 * w.turn[i, 0]
                p, q = c.reach[2 * h, i, 0], c.reach[2 * h, i, 1]
                xx += co * p - si * q
                yx += si * p + co * q
                p, q = c.reach[2 * h + 1, i, 0], c.reach[2 * h + 1, i, 1]
                xy += co * p - si * q
                yy += si * p + co * q
            co, si = w.spin[h, 0], w.spin[h, 1]
            w.g[2 * f, 2 * h], w.g[2 * f, 2 * h + 1] = xx * co - xy * si, xx * si + xy * co
            w.g[2 * f + 1, 2 * h], w.g[2 * f + 1, 2 * h + 1] = yx * co - yy * si, yx * si + yy * co


@part
def fill_curvature(s, w, drives, lam, c_m):
    """w.curvature = C: that of the rows, c_m times the masses at points, slopes of force elements."""
    clear(w.curvature)
    for i in range(w.own.shape[0]):
        for j in range(w.own.shape[0]):
            w.curvature[i, j] = w.own[i, j]
    joints.joint_curvature(s, drives, lam, w.curvature)
    for f in range(w.spin.shape[0]):
        w.curvature[2 * f, 2 * f] += c_m * s.point_mass[f]
        w.curvature[2 * f + 1, 2 * f + 1] += c_m * s.point_mass[f]


@part
def border(s, c, w, drives, dz, lam, phi, c_m, y, dlam):
    """Solve for the points' forces w.pull and dlam, y = -S^-1 r at hand.

    `dq = y - X s`, `s = w + Bz^T dlam`, `w = C A dq`: unknowns w on the active components and dlam,
    `(I + C G) w + C G Bz^T dlam = C A y`, `Bz G w + Bz G Bz^T dlam = Bz A y + phi`.
    """
    hold_border(s, c, w, drives, dz)
    fill_curvature(s, w, drives, lam, c_m)
    joints.point_values(s, y, w.moved)
    return close(s, c, w, phi, dlam)


@part
def hold_border(s, c, w, drives, dz):
    """w.g = G, w.slopes = Bz and w.gb = G Bz^T of a state, whose frames are at hand."""
    points_matrix(s, c, w)
    joints.joint_jacobian(s, drives, dz, w.slopes)
    for k in range(w.gb.shape[1]):
        for i in range(w.g.shape[0]):
            total = 0.0
            for e in range(s.row_start[k], s.row_start[k + 1]):
                total += w.g[i, s.row_columns[e]] * w.slopes[e]
            w.gb[i, k] = total


@part
def close(s, c, w, phi, dlam):
    """w.pull and dlam from w.moved = A y, the border and w.curvature. False where it is singular."""
    fill_small(s, c, w, phi)
    if not solve_small(w.small, w.right, w.last):
        return False
    count = c.active.shape[0]
    for i in range(w.pull.shape[0]):
        w.pull[i] = 0.0
    for i in range(count):
        w.pull[c.active[i]] = w.right[c.place[i]]
    for k in range(phi.shape[0]):
        dlam[k] = w.right[c.place[count + k]]
        for e in range(s.row_start[k], s.row_start[k + 1]):
            w.pull[s.row_columns[e]] += w.slopes[e] * dlam[k]
    return True


@part
def fill_small(s, c, w, phi):
    """The system of `border`, its unknowns in the order of `place`: along the joints, so that chains give a band."""
    count = c.active.shape[0]
    clear(w.small)
    for i in range(count):
        at = c.place[i]
        w.right[at] = 0.0
        w.small[at, at] = 1.0
        for j in c.active:
            if w.curvature[c.active[i], j] != 0.0:
                add_row(c, w, at, w.curvature[c.active[i], j], j, phi.shape[0])
    for k in range(phi.shape[0]):
        at = c.place[count + k]
        w.right[at] = phi[k]
        for e in range(s.row_start[k], s.row_start[k + 1]):
            if w.slopes[e] != 0.0:
                add_row(c, w, at, w.slopes[e], s.row_columns[e], phi.shape[0])


@part
def add_row(c, w, at, value, j, m):
    """Add value times component j of `A dq = A y - G w - G Bz^T dlam` to equation `at`."""
    count = c.active.shape[0]
    w.right[at] += value * w.moved[j // 2, j % 2]
    for e in range(count):
        w.small[at, c.place[e]] += value * w.g[j, c.active[e]]
    for k in range(m):
        w.small[at, c.place[count + k]] += value * w.gb[j, k]


@part
def pull_points(s, c, w, dq):
    """dq -= X pull at the present rotations."""
    for f in range(w.spin.shape[0]):
        co, si = w.spin[f, 0], w.spin[f, 1]
        x, y = w.pull[2 * f], w.pull[2 * f + 1]
        p, q = co * x + si * y, co * y - si * x
        if p == 0.0 and q == 0.0:
            continue
        for i in range(c.point_body[f, 0], c.point_body[f, 1]):
            gx = c.reach[2 * f, i, 0] * p + c.reach[2 * f + 1, i, 0] * q
            gy = c.reach[2 * f, i, 1] * p + c.reach[2 * f + 1, i, 1] * q
            dq[i, 0] -= w.turn[i, 0] * gx - w.turn[i, 1] * gy
            dq[i, 1] -= w.turn[i, 1] * gx + w.turn[i, 0] * gy
