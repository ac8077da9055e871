"""A step of the energy-momentum method: residual at the middle, constraints at the end, solved by one co-rotated factor.

Newton on dq of the end: `(2/h^2) M + K/2` stands for the derivative of the residual, which is not symmetric, and the Jacobian of phi at
the end for that at the middle. Both are near enough for Newton to contract, and what it converges to is the exact residual's root.
"""

from typing import NamedTuple

import numpy as np

from polyida.assembly import corotated
from polyida.assembly import equilibrium as kernels
from polyida.assembly.bodies import compact
from polyida.assembly.bodies.damping import damped_blocks
from polyida.assembly.rows import joints
from polyida.element import kernels as elements
from polyida.element import stabilisation
from polyida.element.paired import two_states
from polyida.integrate.energy.steps import SLOW, Steps
from polyida.integrate.state import StepFailure
from polyida.integrate.stepping.ended import DONE, HALF_TURN, INVERTED, NOT_FINITE, REFACTOR, SINGULAR
from polyida.jit import entry, pack, part
from polyida.linear.cholesky.factor import NotFactorable


@pack
class Step(NamedTuple):
    """Displacements, velocities at the start (0) and end (1) of a step, multipliers, and scratch."""

    u0: np.ndarray
    v0: np.ndarray
    u1: np.ndarray
    um: np.ndarray
    vm: np.ndarray
    a: np.ndarray
    lam: np.ndarray
    half_lam: np.ndarray
    r: np.ndarray
    phi: np.ndarray
    rotation: np.ndarray
    dz: np.ndarray
    forces: np.ndarray
    dq: np.ndarray
    dlam: np.ndarray


def room(model):
    """Scratch for steps of a model."""
    nodes, points, m = (model.n_nodes, 2), (model.n_points, 2), model.m
    shapes = [nodes] * 6 + [m] * 2 + [nodes, m, nodes, points, points, nodes, m]
    return Step(*(np.zeros(shape) for shape in shapes))


@entry
def middle(scene, drives, h, w):
    """Fill r at the middle of the step, with the forces of the plates, loads, masses and joints; returns the least det F at the end."""
    s, links = scene.plates, scene.links
    for i in range(w.r.shape[0]):
        for k in range(2):
            w.vm[i, k] = (w.u1[i, k] - w.u0[i, k]) / h
            w.a[i, k] = 2.0 * (w.vm[i, k] - w.v0[i, k]) / h
            w.um[i, k] = 0.5 * (w.u0[i, k] + w.u1[i, k])
            w.r[i, k] = -s.weight[i, k]
    w.rotation[:] = 0.0
    few = compact.forces_middle(scene.compact, h, w.u0, w.u1, w.um, w.vm, w.a, w.r, w.rotation)
    least = compact.lesser(plates_middle(s, h, w), few)
    for k in range(s.load_drive.shape[0]):
        factor = drives[s.load_drive[k], 0]
        for i in range(s.load_ptr[k], s.load_ptr[k + 1]):
            w.r[s.load_nodes[i], 0] -= factor * s.load_values[i, 0]
            w.r[s.load_nodes[i], 1] -= factor * s.load_values[i, 1]
    joints.point_values(links, w.a, w.dz)
    for f in range(w.dz.shape[0]):
        for k in range(2):
            w.forces[f, k] = links.point_mass[f] * (w.dz[f, k] - links.gravity[k])
    joints.point_values(links, w.um, w.dz)
    joints.joint_forces(links, drives, w.dz, w.lam, w.phi, w.forces)
    joints.spread(links, w.forces, w.r)
    return least


@part
def plates_middle(s, h, w):
    """Inner, inertia and damping forces of all plates into w.r."""
    least = 1e300
    for b in range(s.body_operator.shape[0]):
        o, n0 = s.body_operator[b], s.body_node[b]
        p, e = s.at[o], s.at[o + 1]
        indptr, indices, mass = s.indptr[p[5] : e[5]], s.indices[p[6] : e[6]], s.mass[p[6] : e[6]]
        det = two_states.internal_force_midpoint(
            s.layout[p[0] : e[0]],
            s.corners[p[1] : e[1]],
            s.gradients[p[2] : e[2]],
            s.weights[p[3] : e[3]],
            n0,
            s.body_c1[b],
            s.body_nu[b],
            s.body_viscosity[b] / h,
            w.u0,
            w.u1,
            w.r,
            w.rotation,
        )
        least = compact.lesser(least, det)
        elements.mass_product(indptr, indices, mass, s.body_density[b], n0, w.a, w.r)
        if s.body_drag[b] != 0.0:
            elements.mass_product(indptr, indices, mass, s.body_drag[b] * s.body_density[b], n0, w.vm, w.r)
        if s.body_stabilisation[b] != 0.0:
            stabilisation.force(indptr, indices, s.stabilisation[p[6] : e[6]], s.body_stabilisation[b], n0, w.um, w.r)
    return least


@part
def correct(h, w):
    """Move the end by dq, the multipliers by dlam; the largest entries of dq, u and the acceleration."""
    moved = size = pull = 0.0
    for i in range(w.u1.shape[0]):
        for k in range(2):
            w.u1[i, k] += w.dq[i, k]
            moved = max(moved, abs(w.dq[i, k]))
            size = max(size, abs(w.u1[i, k]))
            pull = max(pull, abs(w.a[i, k]))
    for k in range(w.lam.shape[0]):
        w.lam[k] += w.dlam[k]
        w.half_lam[k] = 0.5 * w.lam[k]
    return moved, size, pull


@entry
def newton(scene, c, scratch, drives_middle, drives_end, h, tolerance, most, extent, w, counts):
    """Newton's iteration from w.u1, w.lam. Returns how it ended and the last |dq|."""
    before = 0.0
    for iteration in range(most):
        det = middle(scene, drives_middle, h, w)
        counts[0] += 1
        if not det > 0.0:
            return (INVERTED if det <= 0.0 else NOT_FINITE), before
        joints.point_values(scene.links, w.u1, w.dz)
        w.forces[:] = 0.0
        cosine = joints.joint_forces(scene.links, drives_end, w.dz, w.lam, w.phi, w.forces)
        if not corotated.solve(scene.links, c, scratch, drives_end, w.rotation, w.dz, w.half_lam, w.r, w.phi, 2.0 / (h * h), w.dq, w.dlam):
            return SINGULAR, before
        counts[1] += 1
        moved, size, pull = correct(h, w)
        floor = 4.0 * 2.2e-16 * size
        rate = moved / before if before > 0.0 else 1.0
        if moved <= floor or (iteration > 0 and rate < 1.0 and moved * rate / (1.0 - rate) <= tolerance * h * h * pull):
            return (DONE if cosine > 0.0 else HALF_TURN), moved
        if iteration > 1 and rate > SLOW:
            return (DONE if moved <= 256.0 * 2.2e-16 * (size + extent) and cosine > 0.0 else REFACTOR), moved
        before = moved
    return REFACTOR, before


class Midpoint(Steps):
    """Steps of a scene whose forces are all compiled."""

    def _room(self):
        self.extent = float(np.ptp(self.model.reference, axis=0).max())
        return room(self.model)

    def _solve(self, state, t):
        w, h, model = self.room, self.h, self.model
        self._begin(state)
        w.half_lam[:] = 0.5 * w.lam
        drives, seen = [model.drives(min(s, self.until)) for s in (t - h / 2, t)], np.zeros(2, np.int64)
        self.fresh = self.system is None
        if self.fresh:
            self._factor(drives[0], t)
        ended = newton(
            model.arrays, self.system, self.scratch, *drives, h, self.settings.tolerance, self.settings.max_iterations, self.extent, w, seen
        )
        self.counts.residuals += int(seen[0])
        self.counts.solves += int(seen[1])
        self.counts.newton_iterations += int(seen[1])
        return ended

    def _damping(self):
        blocks, still = np.empty((len(self.model.pattern[1]), 2, 2)), np.zeros_like(self.room.um)
        damped_blocks(self.model.arrays, self.room.um, still, 1.0 / self.h, 0.0, blocks)
        return blocks

    def _factor(self, drives, t):
        model, w, h = self.model, self.room, self.h
        middle(model.arrays, drives, h, w)
        blocks = np.empty((len(model.pattern[1]), 2, 2))
        kernels.tangent_blocks(model.arrays, w.um, 2.0 / (h * h), 0.5, blocks)
        if model.damped:
            blocks += self._damping()
        self.counts.residuals += 1
        self.counts.tangents += 1
        self.counts.factorizations += 1
        try:
            self.system, self.counts.backend = corotated.corotated(model, blocks, w.rotation)
        except NotFactorable as error:
            raise StepFailure("singular", str(error), t) from None
        self.scratch = corotated.room(model, self.system)
        self.counts.solves += corotated.columns_together(self.system.border)
