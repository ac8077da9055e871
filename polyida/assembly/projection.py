"""Projections along M^-1 phi_q^T in compiled code, of positions onto phi = 0 and velocities onto `phi_q v + phi_t = 0`; the system of M and phi_q."""

import threading
from typing import NamedTuple

import numpy as np

from polyida.assembly import joints
from polyida.assembly.border import Border, BorderWorkspace, body_blocks, body_of_points, border, border_workspace, solve_border
from polyida.jit import entry, pack, part
from polyida.linear.dense import put


@pack
class ConstraintProjection(NamedTuple):
    """M^-1 A^T by columns, the pattern and the workspace of the system `phi_q M^-1 phi_q^T eta = right`."""

    columns: np.ndarray  # (., 2) complex: M^-1 A^T of each point on the pairs of its body
    place: np.ndarray  # (points, 3) of each point: first and last pair, and where its column begins
    border: Border
    workspace: BorderWorkspace
    eta: np.ndarray  # (m,) solution, a view of the workspace
    rate: np.ndarray  # (m,) phi_q v + phi_t
    bias: np.ndarray  # (m,)
    slopes: np.ndarray  # phi_z, a view of the workspace
    vz: np.ndarray  # (points, 2) velocities of the points
    point_forces: np.ndarray  # (points, 2)


def constraint_projection(model):
    """The ConstraintProjection of a scene."""
    points, m = model.n_points, model.m
    rate, bias, vz, forces = map(np.empty, (m, m, (points, 2), (points, 2)))
    pattern, (columns, place, blocks) = model.once(border, of_shape=True, point_forces=False), model.once(point_columns)
    numbers = border_workspace(model, pattern)
    numbers.blocks[:] = blocks
    return ConstraintProjection(columns, place, pattern, numbers, numbers.x, rate, bias, numbers.slopes, vz, forces)


def point_columns(model):
    """(columns and place of ConstraintProjection, `A M^-1 A^T` by bodies). One solve finds one column of each body."""
    from scipy.sparse import csc_array

    pattern, weights, bodies = model.once(border, of_shape=True, point_forces=False), model.point_weights, body_of_points(model)
    local = np.empty(model.n_points, np.int64)
    for first, end in zip(pattern.point_start, pattern.point_start[1:]):
        local[pattern.points[first:end]] = np.arange(end - first)
    right = np.zeros((model.n_nodes, int(local.max(initial=-1)) + 1), complex)
    entries = weights.tocoo()
    right[entries.coords[1], local[entries.coords[0]]] = entries.data.conj()
    solution = model.mass_inverse(np.stack([right.real, right.imag], axis=1).reshape(model.n, -1)).reshape(model.n_nodes, 2, -1)
    first, end = model.first_pairs[bodies], model.first_pairs[bodies + 1]
    begin = np.concatenate([[0], np.cumsum(end - first)]).astype(np.int64)
    pairs = np.concatenate([*map(np.arange, first, end), np.zeros(0, np.int64)]).astype(np.int64)
    owner = np.repeat(np.arange(model.n_points), end - first)
    columns = np.ascontiguousarray(solution[pairs, :, local[owner]])
    matrix = csc_array((columns @ (1, 1j), pairs, begin), (model.n_nodes, model.n_points))
    place = np.stack([first, end, begin[:-1]], axis=1).astype(np.int64).reshape(-1, 3)
    return columns, place, body_blocks(pattern, weights, matrix)


class MassSystem:
    """`[[M, B^T], [B, 0]]` of a scene at (t, q), B = phi_q. Each thread has its own workspace."""

    def __init__(self, model, t, q):
        """Take phi_q at (t, q), in the points of the joints, and the workspace of this thread."""
        self.model, own = model, vars(model.once(_threads))
        self.projection = own.get("projection") or own.setdefault("projection", constraint_projection(model))
        self.slopes = model.slope_values(t, q)

    def solve(self, r, phi):
        """(dq, dlam) with `M dq + B^T dlam = -r`, `B dq = -phi`, for r (n,) and phi (m,), or (n, k) and (m, k). Raises LinAlgError."""
        y = -self.model.mass_inverse(r) if r.any() else np.zeros(r.shape)
        dlam, self.projection.slopes[:] = np.empty(phi.shape), self.slopes
        for k in np.ndindex(r.shape[1:] if phi.size else (0,)):
            one, forces = np.ascontiguousarray(y[:, *k]), np.empty(len(phi))
            if not constrained(self.model.arrays.links, self.projection, np.array(phi[:, *k], float), one.reshape(-1, 2), forces):
                raise np.linalg.LinAlgError("the constraints' system is singular")
            y[:, *k], dlam[:, *k] = one, forces
        return y, dlam


def _threads(model):
    """Storage of a model for the workspace of each thread."""
    return threading.local()


@entry
def constrained(links, projection, phi, y, dlam):
    """y -= M^-1 B^T dlam, so that `B y = -phi`. Returns False if this is singular."""
    joints.point_values(links, y, projection.vz)
    for k in range(phi.shape[0]):
        projection.bias[k] = phi[k] + joints.along(links, projection.slopes, k, projection.vz)
    regular = project(links, projection, projection.bias, y)
    put(1.0, projection.eta, dlam)
    return regular


@part
def velocity_rate(links, drives, dz, v, projection):
    """projection.rate = phi_q v + phi_t; projection.slopes and projection.bias too."""
    joints.point_values(links, v, projection.vz)
    joints.joint_rates(links, drives, dz, projection.vz, projection.eta, projection.rate, projection.bias)
    joints.joint_jacobian(links, drives, dz, projection.slopes)


@part
def project(links, projection, right, x):
    """x -= M^-1 phi_q^T eta with `phi_q M^-1 phi_q^T eta = right`. Returns False if this is singular."""
    put(1.0, right, projection.workspace.right)
    if not solve_border(projection.border, projection.workspace):
        return False
    projection.point_forces[:] = 0.0
    joints.add_rows(links, projection.slopes, projection.eta, projection.point_forces)
    for f in range(projection.point_forces.shape[0]):
        px, py = projection.point_forces[f, 0], projection.point_forces[f, 1]
        if px != 0.0 or py != 0.0:
            first, at = projection.place[f, 0], projection.place[f, 2]
            for i in range(first, projection.place[f, 1]):
                re, im = projection.columns[at + i - first, 0], projection.columns[at + i - first, 1]
                x[i, 0] -= re * px - im * py
                x[i, 1] -= re * py + im * px
    return True


@part
def constrain(links, projection, drives, dz, v, a, lam):
    """From a without constraint forces to a and lam with `phi_q a + phi_bias = 0`. Returns False if it is singular."""
    velocity_rate(links, drives, dz, v, projection)
    return constrained(links, projection, projection.bias, a, lam)
