"""IDA's callbacks for a scene: the residual of the stabilised forms in one compiled pass, and one co-rotated solve an iteration.

The iteration matrix is that of `ida_linear`; all joints act through the points z = A q, so with B = Bz A, H = d(B v + phi_t)/dq = Hz A

    S dq + A^T (w + Bz^T dlam + cj m A A^T Bz^T dmu) + cj M B^T dmu = r2 + cj M r1,   w = (C + cj^2 m) A dq
    Bz A dq = r3,   (Hz + cj Bz) A dq + Bz A A^T Bz^T dmu = r4 + Bz A r1,   dv = cj dq + A^T Bz^T dmu - r1

S and M being those of the plates, m the masses at points, C the curvature of the motors.
"""

import math
from typing import NamedTuple

import numpy as np

from polyida.assembly import equilibrium as kernels
from polyida.assembly import joints
from polyida.compiled import entry, part
from polyida.integrate.ida_forms import System
from polyida.linear import corotated
from polyida.linear.dense import solve_small
from polyida.linear.factor import NotFactorable

SAME_CJ = 1e-3  # relative change of cj below which the factor serves on


class Room(NamedTuple):
    """Scratch and the state of the last residual that a solve refers to."""

    u: np.ndarray
    rotation: np.ndarray
    dz: np.ndarray
    vz: np.ndarray
    forces: np.ndarray
    lam: np.ndarray
    mu: np.ndarray
    phi: np.ndarray
    rate: np.ndarray
    bias: np.ndarray
    right: np.ndarray
    dq: np.ndarray
    swing: np.ndarray
    moved: np.ndarray
    rate_z: np.ndarray
    own: np.ndarray
    cross: np.ndarray
    hb: np.ndarray
    place: np.ndarray
    small: np.ndarray
    unknown: np.ndarray
    last: np.ndarray


def room(model):
    """Room for a model."""
    nodes, points, m = (model.n_nodes, 2), (model.n_points, 2), model.m
    active = corotated.active_components(model.arrays.links)
    place = order_along_joints(active, corotated.row_columns(model.arrays.links, m))
    wide, size = 2 * model.n_points, len(place)
    return Room(np.empty(nodes), np.empty(nodes), np.empty(points), np.empty(points), np.empty(points), np.empty(m), np.empty(m),
                np.empty(m), np.empty(m), np.empty(m), np.empty(nodes), np.empty(nodes), np.zeros(points), np.empty(points),
                np.empty((m, wide)), overlap(model.arrays.links, model.n_points, model.n_nodes), np.empty((wide, wide)), np.empty((wide, m)),
                place, np.empty((size, size)),
                np.empty(size), np.empty(size, np.int64))


def order_along_joints(active, columns):
    """Place of the unknowns (active components, lam, mu): mu beside lam."""
    m, single = len(columns), corotated.order_along_joints(active, columns)
    before = np.argsort(np.argsort(single * 2.0))
    multipliers = single[len(active):]
    shift = np.array([(multipliers < at).sum() for at in before])
    place = before + shift
    return np.concatenate([place, place[len(active):] + 1]) if m else place


def overlap(links, points, nodes):
    """A A^T of one direction, (points, points)."""
    dense = np.zeros((points, nodes))
    for f in range(points):
        part = slice(links.point_ptr[f], links.point_ptr[f + 1])
        dense[f, links.point_nodes[part]] = links.point_weights[part]
    return dense @ dense.T


@entry
def residual(s, w, drives, y, yp, integrated, res):
    """IDA's F(t, y, y') of ggl2 (integrated False) or ggl1 into res; returns the least det F."""
    n, m = 2 * w.u.shape[0], w.phi.shape[0]
    multipliers = yp if integrated else y
    for k in range(m):
        w.lam[k], w.mu[k] = multipliers[2 * n + k], multipliers[2 * n + m + k]
    for i in range(n // 2):
        w.u[i, 0], w.u[i, 1] = y[2 * i], y[2 * i + 1]
        w.dq[i, 0], w.dq[i, 1] = yp[n + 2 * i], yp[n + 2 * i + 1]
    det, cosine = kernels.equilibrium(s, drives, w.u, w.dq, w.lam, w.right, w.phi, w.rotation, w.dz, w.forces)
    for i in range(n // 2):
        res[n + 2 * i], res[n + 2 * i + 1] = w.right[i, 0], w.right[i, 1]
        w.right[i, 0], w.right[i, 1] = yp[2 * i] - y[n + 2 * i], yp[2 * i + 1] - y[n + 2 * i + 1]
        w.dq[i, 0], w.dq[i, 1] = y[n + 2 * i], y[n + 2 * i + 1]
    joints.point_values(s.links, w.dq, w.vz)
    joints.joint_rates(s.links, drives, w.dz, w.vz, w.rate, w.bias)
    joints.joint_velocities(s.links, drives, w.dz, w.vz, w.rate)
    w.forces[:] = 0.0
    joints.joint_forces(s.links, drives, w.dz, w.mu, w.phi, w.forces)
    joints.spread(s.links, w.forces, w.right)
    for i in range(n // 2):
        res[2 * i], res[2 * i + 1] = w.right[i, 0], w.right[i, 1]
    for k in range(m):
        res[2 * n + k] = w.phi[k]
        res[2 * n + m + k] = w.rate[k]
    return det if cosine > 0.0 else -1.0


@entry
def momentum_reach(s, c, cr, w, reach):
    """Fill reach = S_ref^-1 M A^T like `Corotated.reach`, M of the plates."""
    for f in range(w.dz.shape[0]):
        for axis in range(2):
            w.dq[:] = 0.0
            w.right[:] = 0.0
            for k in range(s.links.point_ptr[f], s.links.point_ptr[f + 1]):
                w.dq[s.links.point_nodes[k], axis] = s.links.point_weights[k]
            kernels.momentum(s.plates, w.dq, w.right)
            cr.x[:] = np.float32(0.0)
            for i in range(w.right.shape[0]):
                cr.x[c.factor.order[2 * i]] = w.right[i, 0]
                cr.x[c.factor.order[2 * i + 1]] = w.right[i, 1]
            corotated.triangular(c.factor, cr.x)
            for i in range(c.point_body[f, 0], c.point_body[f, 1]):
                reach[2 * f + axis, i, 0] = cr.x[c.factor.order[2 * i]]
                reach[2 * f + axis, i, 1] = cr.x[c.factor.order[2 * i + 1]]


@entry
def solve(s, c, cm, cr, w, drives, cj, integrated, r, z):
    """z = J^-1 r; c and cm (its reach that of M A^T) at this cj. False where it is singular."""
    n, m = 2 * w.u.shape[0], w.phi.shape[0]
    for i in range(n // 2):
        w.dq[i, 0], w.dq[i, 1] = cj * r[2 * i], cj * r[2 * i + 1]
        w.right[i, 0], w.right[i, 1] = r[n + 2 * i], r[n + 2 * i + 1]
    kernels.momentum(s.plates, w.dq, w.right)
    joints.point_values(s.links, w.dq, w.moved)
    for f in range(w.moved.shape[0]):
        w.moved[f, 0] *= s.links.point_mass[f]
        w.moved[f, 1] *= s.links.point_mass[f]
    joints.spread(s.links, w.moved, w.right)
    corotated.solve_plates(s.links, c, cr, w.rotation, w.right, w.dq)
    if m + c.active.shape[0] and not stabilised_border(s, c, cm, cr, w, drives, cj, r, n, m):
        return False
    for i in range(n // 2):
        for k in range(2):
            z[2 * i + k] = w.dq[i, k]
            w.right[i, k] = cj * w.dq[i, k] - r[2 * i + k]
    if m:
        joints.spread(s.links, w.swing, w.right)
    for i in range(n // 2):
        z[n + 2 * i], z[n + 2 * i + 1] = w.right[i, 0], w.right[i, 1]
    count = c.active.shape[0]
    scale = 1.0 / cj if integrated else 1.0
    for k in range(2 * m):
        z[2 * n + k] = w.unknown[w.place[count + k]] * scale
    return True


@part
def stabilised_border(s, c, cm, cr, w, drives, cj, r, n, m):
    """Solve for w, dlam, dmu; move w.dq by them; leave A's forces Bz^T dmu in w.swing."""
    wide = w.rate_z.shape[1]
    corotated.points_matrix(s.links, c, cr)
    for i in range(wide):
        for j in range(wide):
            w.cross[i, j] = cr.g[i, j]
    corotated.points_matrix(s.links, cm, cr)
    g, h = w.cross, cr.g
    joints.joint_jacobian(s.links, drives, w.dz, cr.phi_z)
    joints.joint_rate_jacobian(s.links, drives, w.dz, w.vz, w.rate_z)
    corotated.fill_curvature(s.links, cr, drives, w.lam, cj * cj)
    for i in range(wide):
        for j in range(wide):
            h[i, j] *= cj
        for f in range(w.own.shape[0]):
            if s.links.point_mass[f] != 0.0:
                for k in range(2):
                    for e in range(w.own.shape[0]):
                        h[i, 2 * e + k] += cj * g[i, 2 * f + k] * s.links.point_mass[f] * w.own[f, e]
    times_jacobian(c, cr, g, cr.gb)
    times_jacobian(c, cr, h, w.hb)
    fill_stabilised(s, c, cr, w, cj, r, n, m)
    if not solve_small(w.small, w.unknown, w.last):
        return False
    apply_border(s, c, cm, cr, w, cj, m)
    return True


@part
def times_jacobian(c, cr, matrix, product):
    """product (2 points, m) = matrix Bz^T."""
    for k in range(product.shape[1]):
        for p in range(product.shape[0]):
            total = 0.0
            for j in c.row_columns[k]:
                if j >= 0:
                    total += matrix[p, j] * cr.phi_z[k, j]
            product[p, k] = total


@part
def fill_stabilised(s, c, cr, w, cj, r, n, m):
    """The border's system: curvature, position and velocity rows, each a combination of components of A dq."""
    count = c.active.shape[0]
    joints.point_values(s.links, w.dq, w.moved)
    w.small[:] = 0.0
    w.unknown[:] = 0.0
    for i in range(count):
        w.small[w.place[i], w.place[i]] = 1.0
        for j in c.active:
            if cr.curvature[c.active[i], j] != 0.0:
                add_row(c, cr, w, w.place[i], cr.curvature[c.active[i], j], j, m)
    for k in range(m):
        for j in c.row_columns[k]:
            if j >= 0:
                add_row(c, cr, w, w.place[count + k], cr.phi_z[k, j], j, m)
                add_row(c, cr, w, w.place[count + m + k], w.rate_z[k, j] + cj * cr.phi_z[k, j], j, m)
    close_stabilised(s, c, cr, w, r, n, m, count)


@part
def add_row(c, cr, w, at, value, j, m):
    """Add value times component j of `A dq = A y - g (w + Bz^T dlam) - h Bz^T dmu` to equation `at`."""
    count = c.active.shape[0]
    if value == 0.0:
        return
    w.unknown[at] += value * w.moved[j // 2, j % 2]
    for l in range(count):
        w.small[at, w.place[l]] += value * w.cross[j, c.active[l]]
    for k in range(m):
        w.small[at, w.place[count + k]] += value * cr.gb[j, k]
        w.small[at, w.place[count + m + k]] += value * w.hb[j, k]


@part
def close_stabilised(s, c, cr, w, r, n, m, count):
    """Right-hand sides r3, r4 + Bz A r1 and the block -Bz A A^T Bz^T of the velocity constraint."""
    for i in range(w.right.shape[0]):
        w.right[i, 0], w.right[i, 1] = r[2 * i], r[2 * i + 1]
    joints.point_values(s.links, w.right, w.moved)
    for k in range(m):
        at = w.place[count + m + k]
        w.unknown[w.place[count + k]] -= r[2 * n + k]
        w.unknown[at] -= r[2 * n + m + k]
        for p in c.row_columns[k]:
            if p < 0:
                continue
            value = cr.phi_z[k, p]
            w.unknown[at] -= value * w.moved[p // 2, p % 2]
            for l in range(m):
                for q in c.row_columns[l]:
                    if q >= 0 and q % 2 == p % 2:
                        w.small[at, w.place[count + m + l]] -= value * w.own[p // 2, q // 2] * cr.phi_z[l, q]


@part
def apply_border(s, c, cm, cr, w, cj, m):
    """dq -= X (w + Bz^T dlam + cj m A A^T Bz^T dmu) + cj S^-1 M A^T Bz^T dmu; w.swing = Bz^T dmu."""
    cr.pull[:] = 0.0
    w.swing[:] = 0.0
    count = c.active.shape[0]
    for i in range(count):
        cr.pull[c.active[i]] = w.unknown[w.place[i]]
    for k in range(m):
        for p in c.row_columns[k]:
            if p >= 0:
                cr.pull[p] += cr.phi_z[k, p] * w.unknown[w.place[count + k]]
                w.swing[p // 2, p % 2] += cr.phi_z[k, p] * w.unknown[w.place[count + m + k]]
    for f in range(w.own.shape[0]):
        if s.links.point_mass[f] != 0.0:
            for e in range(w.own.shape[0]):
                cr.pull[2 * f] += cj * s.links.point_mass[f] * w.own[f, e] * w.swing[e, 0]
                cr.pull[2 * f + 1] += cj * s.links.point_mass[f] * w.own[f, e] * w.swing[e, 1]
    corotated.pull_points(s.links, c, cr, w.dq)
    for p in range(cr.pull.shape[0]):
        cr.pull[p] = cj * w.swing[p // 2, p % 2]
    corotated.pull_points(s.links, cm, cr, w.dq)


class SceneSystem(System):
    """`System` of a stabilised form on a scene, with its residual compiled."""

    def __init__(self, model, form, rate):
        super().__init__(model, form, rate)
        self.room = room(model)

    def residual(self, t, y, yp, res):
        """IDA's F(t, y, y') into `res`; nan, IDA's sign to try a smaller step, where an element is inside out or a motor flipped."""
        det = residual(self.model.arrays, self.room, self.model.drives(self.clamp(t)), y, yp, self.form.integrated, res)
        if not det > 0:
            res[:] = math.nan


class SceneSolve:
    """IDA's linear callbacks for a SceneSystem; the same interface as `ida_linear.ReducedSolve`."""

    def __init__(self, system, counts):
        self.system, self.model, self.counts = system, system.model, counts
        self.cj, self.echo = math.nan, False
        self._blocks = np.empty((len(self.model.pattern[1]), 2, 2))

    def setup(self, t, y, yp, res, cj):
        """Factor `S = K + cj^2 M` at y, in the frame of the rotations that the last residual saw."""
        model, w = self.model, self.system.room
        kernels.tangent_blocks(model.arrays.plates, w.u, cj * cj, 1.0, self._blocks)
        self.counts.tangents += 1
        self.counts.factorizations += 1
        self.cj = cj
        try:
            self.plain, self.counts.backend = corotated.corotated(model, self._blocks, w.rotation)
        except NotFactorable:
            self.cj = math.nan
            return
        self.scratch = corotated.room(model, self.plain)
        self.massive = self.plain._replace(reach=np.zeros_like(self.plain.reach))
        momentum_reach(model.arrays, self.plain, self.scratch, w, self.massive.reach)
        self.counts.solves += 4 * model.n_points

    def product(self, t, y, yp, res, vector, result, cj):
        """IDA's matrix times vector: hand it through, and have the next `solve` echo it."""
        self.echo = True
        result[:] = vector

    def solve(self, t, y, yp, res, r, z, cj, delta):
        """z = J^-1 r, or the echo of r where `product` came before."""
        if self.echo:
            self.echo = False
            z[:] = r
            return
        if not abs(cj - self.cj) <= SAME_CJ * cj:
            self.setup(t, y, yp, res, cj)
        self.counts.newton_iterations += 1
        self.counts.solves += 1
        drives = self.model.drives(self.system.clamp(t))
        done = math.isfinite(self.cj) and solve(self.model.arrays, self.plain, self.massive, self.scratch, self.system.room, drives,
                                                cj, self.system.form.integrated, r, z)
        if not done:
            z[:] = math.nan
