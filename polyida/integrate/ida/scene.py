"""IDA's callbacks for a scene: the residual of the stabilised forms in one compiled pass, and one co-rotated solve an iteration.

The iteration matrix is that of `linear.py`; its border on the points z = A q is in `assembly/stabilised_border.py`.
"""

import math
from typing import NamedTuple

import numpy as np

from polyida.assembly import corotated
from polyida.assembly import equilibrium as kernels
from polyida.assembly.bodies.damping import add_damping
from polyida.assembly.own.laws import add_own_forces
from polyida.assembly.rows import joints
from polyida.assembly.stabilised_border import StabilisedRoom, massive, stabilised_border, stabilised_room
from polyida.integrate.ida.forms import System
from polyida.integrate.ida.linear import Correction
from polyida.jit import entry, pack, typed
from polyida.linear.dense import clear
from polyida.linear.lu import SingularSystem


@pack
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
    moved: np.ndarray
    border: StabilisedRoom


def room(model):
    """Room for a model."""
    nodes, points, m = (model.n_nodes, 2), (model.n_points, 2), model.m
    shapes = [nodes] * 2 + [points] * 3 + [m] * 5 + [nodes] * 2 + [points]
    return Room(*map(np.empty, shapes), stabilised_room(model))


@entry
def residual(s, w, drives, y, yp, integrated, damp, laws, res):
    """IDA's F(t, y, y') of ggl2 (integrated False) or ggl1 into res; returns the least det F.

    damp: scratch (nodes, 2) of a damped scene, or None; laws: of force elements, or None.
    """
    n, m = 2 * w.u.shape[0], w.phi.shape[0]
    multipliers = yp if integrated else y
    for k in range(m):
        w.lam[k], w.mu[k] = multipliers[2 * n + k], multipliers[2 * n + m + k]
    for i in range(n // 2):
        w.u[i, 0], w.u[i, 1] = y[2 * i], y[2 * i + 1]
        w.dq[i, 0], w.dq[i, 1] = yp[n + 2 * i], yp[n + 2 * i + 1]
    det, cosine = kernels.equilibrium(s, drives, w.u, w.dq, w.lam, w.right, w.phi, w.rotation, w.dz, w.forces)
    for i in range(n // 2):
        w.dq[i, 0], w.dq[i, 1] = y[n + 2 * i], y[n + 2 * i + 1]
    if damp is not None:
        add_damping(s, w.u, w.dq, damp, w.right)
    if laws is not None:
        add_own_forces(laws, s.links, drives, w.u, w.dq, w.right)
    for i in range(n // 2):
        res[n + 2 * i], res[n + 2 * i + 1] = w.right[i, 0], w.right[i, 1]
        w.right[i, 0], w.right[i, 1] = yp[2 * i] - y[n + 2 * i], yp[2 * i + 1] - y[n + 2 * i + 1]
    joints.point_values(s.links, w.dq, w.vz)
    joints.joint_rates(s.links, drives, w.dz, w.vz, w.phi, w.rate, w.bias)
    clear(w.forces)
    joints.joint_forces(s.links, drives, w.dz, w.mu, w.phi, w.forces)
    joints.spread(s.links, w.forces, w.right)
    for i in range(n // 2):
        res[2 * i], res[2 * i + 1] = w.right[i, 0], w.right[i, 1]
    for k in range(m):
        res[2 * n + k] = w.phi[k]
        res[2 * n + m + k] = w.rate[k]
    return det if cosine > 0.0 else -1.0


@entry
def solve(s, c, cm, cr, w, drives, cj, integrated, damp, r, z):
    """z = J^-1 r; c and cm (its reach that of M A^T) at this cj. False where it is singular.

    Of the damping C, linear in v, it lacks C B^T dmu, as good as zero, and what S lacks (`SceneSolve`).
    """
    n, m = 2 * w.u.shape[0], w.phi.shape[0]
    r1, dlam, dmu = r[:n].reshape((n // 2, 2)), z[2 * n : 2 * n + m], z[2 * n + m :]
    for i in range(n // 2):
        w.dq[i, 0], w.dq[i, 1] = cj * r1[i, 0], cj * r1[i, 1]
        w.right[i, 0], w.right[i, 1] = r[n + 2 * i], r[n + 2 * i + 1]
    kernels.momentum(s, w.dq, w.right)
    joints.point_values(s.links, w.dq, w.moved)
    if damp is not None:
        add_damping(s, w.u, r1, damp, w.right)
    for f in range(w.moved.shape[0]):
        w.moved[f, 0] *= s.links.point_mass[f]
        w.moved[f, 1] *= s.links.point_mass[f]
    joints.spread(s.links, w.moved, w.right)
    corotated.solve_plates(s.links, c, cr, w.rotation, w.right, w.dq)
    if w.border.room.x.shape[0] and not stabilised_border(
        s.links, c, cm, cr, w.border, drives, w.dz, w.vz, w.lam, cj, True, w.dq, r1, r[2 * n : 2 * n + m], r[2 * n + m :], dlam, dmu
    ):
        return False
    for i in range(n // 2):
        for k in range(2):
            z[2 * i + k] = w.dq[i, k]
            w.right[i, k] = cj * w.dq[i, k] - r1[i, k]
    if m:
        joints.spread(s.links, w.border.swing, w.right)
    for i in range(n // 2):
        z[n + 2 * i], z[n + 2 * i + 1] = w.right[i, 0], w.right[i, 1]
    if integrated:
        for k in range(2 * n, z.shape[0]):
            z[k] *= 1.0 / cj
    return True


class SceneSystem(System):
    """`System` of a stabilised form on a scene, with its residual compiled."""

    def __init__(self, model, form, rate):
        super().__init__(model, form, rate)
        self.room, self.kernel = room(model), typed(residual)
        self.damp = np.empty((model.n_nodes, 2)) if model.damped else None

    def residual(self, t, y, yp, res):
        """IDA's F(t, y, y') into `res`; nan, IDA's sign to try a smaller step, where an element is inside out or a motor flipped."""
        det = self.kernel(
            self.model.arrays, self.room, self.model.drives(self.clamp(t)), y, yp, self.form.integrated, self.damp, self.model.laws, res
        )
        if not det > 0:
            res[:] = math.nan

    def objection(self, t, q):
        """None: the residual of the accepted step has looked already."""
        return None


class SceneSolve(Correction):
    """IDA's correction for a SceneSystem: a co-rotated factor of the plates and the border."""

    def __init__(self, system, counts, order):
        super().__init__(system, counts, order)
        self.step, self.kernel, self.massive = system.model.step_matrix(), typed(solve), None

    def setup(self, t, y, yp, cj):
        """Factor S at y."""
        step = self.step
        self.counts.tangents += 1
        self.counts.factorizations += 1
        at = self.system.at(t, y, yp)
        try:
            step.factor(*at, cj * cj, cj)
        except SingularSystem:
            self.cj = math.nan
            return
        self.cj, self.counts.backend = cj, step.backend
        damping = step.model.force_v(*at[:2], np.zeros_like(at[2])) / cj if step.model.damped else None
        before = self.massive if self.massive and self.massive.factor is step.corotated.factor else None
        self.massive = massive(step.model, step.corotated, damping, before)
        self.counts.solves += 2 * step.solves

    def reduced(self, t, y, yp, r, z):
        """z = J^-1 r, joints as the last residual saw them."""
        model, system, step = self.step.model, self.system, self.step
        where = model.arrays, step.corotated, self.massive, step.room, system.room, model.drives(system.clamp(t))
        if not self.kernel(*where, self.cj, system.form.integrated, system.damp, r, z):
            z[:] = math.nan
