"""Moves along M^-1 phi_q^T in compiled code: of positions onto phi = 0, of velocities onto `phi_q v + phi_t = 0`; and the system of M and phi_q."""

import threading
from typing import NamedTuple

import numpy as np

from polyida.assembly import joints
from polyida.assembly.border import Border, BorderRoom, body_blocks, body_of_points, border, border_room, solve_border
from polyida.jit import entry, pack, part


@pack
class Tie(NamedTuple):
    """Columns M^-1 A^T, complex numbers (., 2), of each point those of the pairs from `place` (points, 3) on: first and last pair, and where
    they begin; the pattern of phi_q M^-1 phi_q^T, and scratch.
    """

    reach: np.ndarray
    place: np.ndarray
    border: Border
    room: BorderRoom
    eta: np.ndarray
    rate: np.ndarray
    bias: np.ndarray
    slopes: np.ndarray
    vz: np.ndarray
    pull: np.ndarray


def tie(model):
    """The Tie of a scene."""
    points, m = model.n_points, model.m
    rate, bias, vz, pull = map(np.empty, (m, m, (points, 2), (points, 2)))
    pattern, (reach, place, blocks) = model.once(border_of_rows, of_shape=True), model.once(point_columns)
    numbers = border_room(model, pattern)
    numbers.blocks[:] = blocks
    return Tie(reach, place, pattern, numbers, numbers.x, rate, bias, numbers.slopes, vz, pull)


def border_of_rows(model):
    """The Border of a scene with nothing but lam."""
    return border(model, active=False)


def point_columns(model):
    """`M^-1 A^T` as (., 2) and where its columns are, and `A M^-1 A^T` body by body; columns of different bodies are found together."""
    from scipy.sparse import csc_array

    pattern, weights, bodies = model.once(border_of_rows, of_shape=True), model.point_weights, body_of_points(model)
    local = np.empty(model.n_points, np.int64)
    for first, end in zip(pattern.point_start, pattern.point_start[1:]):
        local[pattern.points[first:end]] = np.arange(end - first)
    together = np.zeros((model.n_nodes, int(local.max(initial=-1)) + 1), complex)
    entries = weights.tocoo()
    together[entries.coords[1], local[entries.coords[0]]] = entries.data.conj()
    both = np.stack([together.real, together.imag], axis=1).reshape(model.n, -1)
    found = model.mass_inverse(both).reshape(model.n_nodes, 2, -1)
    first, end = model.first_pairs[bodies], model.first_pairs[bodies + 1]
    begin = np.concatenate([[0], np.cumsum(end - first)]).astype(np.int64)
    pairs = np.concatenate([*map(np.arange, first, end), np.zeros(0, np.int64)]).astype(np.int64)
    owner = np.repeat(np.arange(model.n_points), end - first)
    reach = np.ascontiguousarray(found[pairs, :, local[owner]])
    columns = csc_array((reach @ (1, 1j), pairs, begin), (model.n_nodes, model.n_points))
    place = np.stack([first, end, begin[:-1]], axis=1).astype(np.int64).reshape(-1, 3)
    return reach, place, body_blocks(pattern, weights, columns)


class MassSystem:
    """`[[M, B^T], [B, 0]]` of a scene at (t, q), B = phi_q; `solve` any number of right-hand sides. Scratch is made once in each thread."""

    def __init__(self, model, t, q):
        self.model, own = model, vars(model.once(_threads))
        self.tie = own.get("tie") or own.setdefault("tie", tie(model))
        self.slopes = model.slope_values(t, q)

    def solve(self, r, phi):
        """(dq, dlam) for the residuals r (n,) and phi (m,): `M dq + B^T dlam = -r`, `B dq = -phi`. Raises LinAlgError."""
        y = -self.model.mass_inverse(r) if r.any() else np.zeros(self.model.n)
        if not phi.size:
            return y, np.zeros(0)
        dlam, self.tie.slopes[:] = np.empty(len(phi)), self.slopes
        if not constrained(self.model.arrays.links, self.tie, np.array(phi, float), y.reshape(-1, 2), dlam):
            raise np.linalg.LinAlgError("the constraints' system is singular")
        return y, dlam


def _threads(model):
    return threading.local()


@entry
def constrained(s, t, phi, y, dlam):
    """y -= M^-1 B^T dlam with `B y = -phi` then. False where that is singular."""
    joints.point_values(s, y, t.vz)
    for k in range(phi.shape[0]):
        t.bias[k] = phi[k] + joints.along(s, t.slopes, k, t.vz)
    good = project(s, t, t.bias, y)
    for k in range(phi.shape[0]):
        dlam[k] = t.eta[k]
    return good


@part
def velocity_rate(s, drives, dz, v, t):
    """t.rate = phi_q v + phi_t; t.slopes with it."""
    joints.point_values(s, v, t.vz)
    joints.joint_rates(s, drives, dz, t.vz, t.eta, t.rate, t.bias)
    joints.joint_jacobian(s, drives, dz, t.slopes)


@part
def project(s, t, wanted, x):
    """x -= M^-1 phi_q^T eta with `phi_q M^-1 phi_q^T eta = wanted`. False where that is singular."""
    for i in range(wanted.shape[0]):
        t.room.right[i] = wanted[i]
    if not solve_border(t.border, t.room):
        return False
    t.pull[:] = 0.0
    for i in range(wanted.shape[0]):
        for e in range(s.row_start[i], s.row_start[i + 1]):
            p = s.row_columns[e]
            t.pull[p // 2, p % 2] += t.slopes[e] * t.eta[i]
    for f in range(t.pull.shape[0]):
        px, py = t.pull[f, 0], t.pull[f, 1]
        if px != 0.0 or py != 0.0:
            first, at = t.place[f, 0], t.place[f, 2]
            for i in range(first, t.place[f, 1]):
                re, im = t.reach[at + i - first, 0], t.reach[at + i - first, 1]
                x[i, 0] -= re * px - im * py
                x[i, 1] -= re * py + im * px
    return True


@part
def constrain(s, t, drives, dz, v, a, lam):
    """From a without constraint forces to a and lam with `phi_q a + phi_bias = 0`; t: None without constraints. False if that is singular."""
    if t is None:
        return True
    velocity_rate(s, drives, dz, v, t)
    return constrained(s, t, t.bias, a, lam)
