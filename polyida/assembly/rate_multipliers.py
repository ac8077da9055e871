"""The multipliers mu of the rates of phi (GGL stabilisation) in the corrections by a scene's step matrix.

Points of the bodies are z = A q; B = Bz A is phi_q, and v = q' + B^T mu. For a real or complex number c the corrections solve

    S dq + B^T dlam + (c M + C) B^T dmu = -r,    B dq = -r3,    c B dq + B B^T dmu = -r4

Newton's matrix also has `H = d(B v + phi_t)/dq` in the last row. Beside c B it is of the size of the angle by which bodies turn in a step,
as are the differences of B between the stages, which Newton's method neglects too. One sweep over the rows is therefore enough: dmu from
`B B^T dmu = c r3 - r4`, whose factor is real and the same for all c, then dq and dlam (corotated.py), then dmu again with H dq in its
right side.
"""

from typing import NamedTuple

import numpy as np

from polyida.assembly import joints
from polyida.assembly.border import Border, BorderWorkspace, body_blocks, border, border_workspace, solve_border, solve_border_again
from polyida.jit import pack, part
from polyida.linear.dense import clear, zero


@pack
class RateMultipliers(NamedTuple):
    """The system of mu, and the pairs of q on which (c M + C) B^T mu acts.

    border, workspace: of `B B^T`, with mu as the only unknowns. rates: slopes of B v + phi_t. start, pairs: numbers of the pairs on which
    M A^T and C A^T of point f act, from start[f] on; mass (., 2): M A^T there, complex.
    """

    border: Border
    workspace: BorderWorkspace
    rates: np.ndarray
    start: np.ndarray
    pairs: np.ndarray
    mass: np.ndarray


def rate_multipliers(model):
    """The RateMultipliers of a scene."""
    pattern, (start, pairs, mass) = model.once(border, of_shape=True, point_forces=False), model.once(_point_masses)
    workspace = border_workspace(model, pattern)
    workspace.blocks[:] = model.once(_overlaps, of_shape=True)
    return RateMultipliers(pattern, workspace, np.zeros_like(workspace.slopes), start, pairs, mass)


def _overlaps(model):
    """The blocks A A^T of the bodies."""
    weights = model.point_weights
    return body_blocks(model.once(border, of_shape=True, point_forces=False), weights, weights.conj().T.tocsc())


def _point_masses(model):
    """start, pairs and mass of RateMultipliers."""
    from scipy.sparse import csr_array

    indptr, indices = model.pattern
    near, M = csr_array((np.ones(len(indices)), indices, indptr)), model.mass(np.zeros(model.n)).tocsr()
    forces = model.point_weights[:, : model.n_factored].conj().T.tocsc()
    touched = (near @ abs(forces)).tocsc()
    touched.sort_indices()
    end = 2 * model.n_factored
    columns = ((M[0:end:2, 0:end:2] + 1j * M[1:end:2, 0:end:2]) @ forces).tocsr()
    points = np.repeat(np.arange(model.n_points), np.diff(touched.indptr))
    values = _entries(columns, touched.indices, points)
    return touched.indptr.astype(np.int64), touched.indices.astype(np.int64), values.view(float).reshape(-1, 2)


def slowing(model, t, q):
    """C A^T of the points at (t, q) on the pairs of RateMultipliers, (., 2, 2); (0, 2, 2) without damping."""
    if not model.damped:
        return np.zeros((0, 2, 2))
    from scipy.sparse import kron

    start, pairs, _ = model.once(_point_masses)
    weights, points = model.point_weights.T, np.repeat(np.arange(model.n_points), np.diff(start))
    forces = model.force_v(t, q, np.zeros(model.n)) @ (kron(weights.real, np.eye(2)) + kron(weights.imag, [[0.0, 1.0], [-1.0, 0.0]]))
    rows, columns = 2 * pairs[:, None, None] + np.arange(2)[:, None], 2 * points[:, None, None] + np.arange(2)
    return _entries(forces, *np.broadcast_arrays(rows, columns))


def _entries(matrix, rows, columns):
    """The entries of a sparse matrix at rows and columns, arrays of one shape."""
    values = matrix.tocsc()
    values.sum_duplicates()
    own = values.indices + matrix.shape[0] * np.repeat(np.arange(matrix.shape[1]), np.diff(values.indptr))
    wanted = rows + matrix.shape[0] * columns
    at = np.minimum(np.searchsorted(own, wanted), max(0, len(own) - 1))
    return np.where(own[at] == wanted, values.data[at], 0.0) if len(own) else np.zeros(wanted.shape, matrix.dtype)


@part
def factor_rates(links, rates, drives, dz):
    """Factor B B^T at places dz of the points. False if it is singular."""
    joints.joint_jacobian(links, drives, dz, rates.workspace.slopes)
    zero(rates.workspace.right)
    return solve_border(rates.border, rates.workspace)


@part
def solve_rates(rates, right, mu):
    """mu = (B B^T)^-1 right, (m,) real or complex, with the factor of `factor_rates`. False if the system is singular."""
    w, m, numbers, out = rates.workspace, right.shape[0], right.view(np.float64), mu.view(np.float64)
    parts = numbers.shape[0] // max(m, 1)
    for p in range(parts):
        size = 0.0
        for k in range(m):
            w.right[k] = numbers[parts * k + p]
            size += abs(w.right[k])
        if size != 0.0 and not solve_border_again(rates.border, w):
            return False
        for k in range(m):
            out[parts * k + p] = w.x[k] if size != 0.0 else 0.0
    return True


@part
def subtract_rates(links, rates, dz, right):
    """right -= H dq. dz: dq at the points, (points, 2)."""
    for k in range(right.shape[0]):
        right[k] -= joints.along(links, rates.rates, k, dz)


@part
def add_rate_forces(links, rates, slowing, work, factor, mu, residual):
    """residual += (c M + C) B^T mu. slowing: C A^T of the points or empty; work: SolveWorkspace with the frames of the nodes and points."""
    forces = work.point_forces
    clear(forces)
    joints.add_rows(links, rates.workspace.slopes, mu, forces)
    for f in range(forces.shape[0]):
        px, py = forces[f, 0], forces[f, 1]
        if px == 0.0 and py == 0.0:
            continue
        for e in range(rates.start[f], rates.start[f + 1]):
            i, a, b = rates.pairs[e], rates.mass[e, 0], rates.mass[e, 1]
            residual[i, 0] += factor * (a * px - b * py)
            residual[i, 1] += factor * (a * py + b * px)
        if slowing.shape[0]:
            co, si = work.point_turn[f, 0], work.point_turn[f, 1]
            p, q = co * px + si * py, co * py - si * px
            for e in range(rates.start[f], rates.start[f + 1]):
                i = rates.pairs[e]
                gx, gy = slowing[e, 0, 0] * p + slowing[e, 0, 1] * q, slowing[e, 1, 0] * p + slowing[e, 1, 1] * q
                residual[i, 0] += work.turn[i, 0] * gx - work.turn[i, 1] * gy
                residual[i, 1] += work.turn[i, 1] * gx + work.turn[i, 0] * gy


@part
def rate_values(links, rates, slowing, work, factor, dw, values):
    """values (points, 2) = A (c M + C)^T dw."""
    for f in range(values.shape[0]):
        px, py, qx, qy = 0.0 * factor, 0.0 * factor, 0.0 * factor, 0.0 * factor
        for e in range(rates.start[f], rates.start[f + 1]):
            i, a, b = rates.pairs[e], rates.mass[e, 0], rates.mass[e, 1]
            px += factor * (a * dw[i, 0] + b * dw[i, 1])
            py += factor * (a * dw[i, 1] - b * dw[i, 0])
            if slowing.shape[0]:
                gx = work.turn[i, 0] * dw[i, 0] + work.turn[i, 1] * dw[i, 1]
                gy = work.turn[i, 0] * dw[i, 1] - work.turn[i, 1] * dw[i, 0]
                qx += slowing[e, 0, 0] * gx + slowing[e, 1, 0] * gy
                qy += slowing[e, 0, 1] * gx + slowing[e, 1, 1] * gy
        if slowing.shape[0]:
            px, py = (
                px + work.point_turn[f, 0] * qx - work.point_turn[f, 1] * qy,
                py + work.point_turn[f, 1] * qx + work.point_turn[f, 0] * qy,
            )
        values[f, 0], values[f, 1] = px, py
