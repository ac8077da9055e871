"""Matrices of a plate, its static and normal modes, and the exact elastic energy in the span of few fields."""

from functools import cached_property

import numpy as np

from polyida.element import kernels
from polyida.element.choice import operator_of
from polyida.element.elements import stabilisation_factor
from polyida.element.operator import Blocks, Material
from polyida.jit.intrinsics import LANES

INDEPENDENT = 1e-6  # a field or row counts as zero if a smaller part of it is independent of the others
CHUNK = 512  # blocks of cells whose strains are in memory at once


class PlateMatrices:
    """Matrices of a plate in the reference configuration: M (N, N) of one direction, kg, and K (2N, 2N), N/m, on (x, y) node by node."""

    def __init__(self, plate):
        """Take a Plate; store its operator and its membrane stiffness `h E / (1 - nu^2)`, N/m, with nu."""
        self.plate, self.operator = plate, operator_of(plate)
        modulus, nu = plate.material.in_plane
        self.membrane = plate.thickness * modulus / (1 - nu**2), nu  # membrane stiffness, N/m, and the ratio

    @cached_property
    def mass(self):
        """The mass matrix of the plate's nodes for (x, y) as one complex number, sparse."""
        return self._on_nodes(self.operator.mass * (self.plate.material.rho * self.plate.thickness))

    @cached_property
    def stabilisation(self):
        """The stabilisation of one direction, (N, N) sparse, N/m, or None."""
        factor = stabilisation_factor(self.plate, self.operator)
        return self._on_nodes(self.operator.stabilisation * factor) if factor else None

    def _on_nodes(self, values):
        """The csr matrix (N, N), N nodes, with these values in the pattern of the operator: pairs of nodes of a common cell, row by row."""
        from scipy.sparse import csr_array

        return csr_array((values, self.operator.indices, self.operator.indptr), shape=(self.operator.n_nodes,) * 2)

    @cached_property
    def stiffness(self):
        """Tangent stiffness of the full plate at zero displacement, stabilisation included: (2 N, 2 N) csc, N/m."""
        from scipy.sparse import bsr_array, eye_array, kron

        o = self.operator
        blocks = np.zeros((len(o.indices), 2, 2))
        kernels.tangent(o.cells(), Blocks(o.pairs, 0, blocks), Material(*self.membrane), np.zeros((o.n_nodes, 2)), 1.0)
        K = bsr_array((blocks, o.indices, o.indptr), shape=(2 * o.n_nodes,) * 2).tocsc()
        return K if self.stabilisation is None else (K + kron(self.stabilisation, eye_array(2))).tocsc()

    def force(self, moved):
        """A new array (N, 2): internal force on the nodes of the plate, N, stabilisation included, at displacements `moved` (N, 2), m."""
        o, f, moved = self.operator, np.zeros_like(moved), np.ascontiguousarray(moved)
        kernels.internal_force(o.cells(), Material(*self.membrane), moved, f, np.empty((0, 2)))
        if self.stabilisation is not None:
            kernels.stabilisation_force(o.indptr, o.indices, o.stabilisation, stabilisation_factor(self.plate, o), 0, moved, f)
        return f


def rows_of(n, sides):
    """Return rows (k, 2n) of the mean x, mean y and rotation that attachments hold, and rows of the stretch of their directions.

    Their length is one, so that rows of means and of rotations, which have different units, compare in any unit of length.
    """

    def row(side, weights, x, y):
        """Row (1, 2n) of length one with the weights of an attachment, times x in the x direction and times y in the y direction."""
        array = np.zeros((1, n, 2))
        array[0, side.nodes, 0], array[0, side.nodes, 1] = x * weights, y * weights
        return array.reshape(1, -1) / np.linalg.norm(array)

    rotations, stretches = [np.zeros((0, 2 * n))], [np.zeros((0, 2 * n))]
    for side in {(side.nodes.tobytes(), side.weights.tobytes()): side for side in sides}.values():
        rotations += [row(side, side.weights, 1.0, 0.0), row(side, side.weights, 0.0, 1.0)]
        if side.turn_weights is not None:
            x, y = side.direction
            rotations.append(row(side, side.turn_weights, -y, x))
            stretches.append(row(side, side.turn_weights, x, y))
    return np.concatenate(rotations), np.concatenate(stretches)


def completed_rows(rows, M, arms, whole):
    """The rows, plus the plate's mean rigid motion if they leave a rigid motion free, or if the centre of mass is used (`whole`)."""
    rigid = rigid_fields(arms)
    rank = np.linalg.matrix_rank(rows @ (rigid / np.abs(rigid).max(axis=0)), tol=INDEPENDENT) if len(rows) else 0
    if rank == 3 and not whole:
        return rows
    weighted = np.repeat(M @ np.ones(len(arms)), 2)[:, None] * rigid
    return np.concatenate([rows, (weighted / np.linalg.norm(weighted, axis=0)).T])


def rigid_fields(arms):
    """Infinitesimal rigid motions (2N, 3) of nodes at arms (N,), complex, m: translations along x and y, and a rotation."""
    motions = np.zeros((len(arms), 2, 3))
    motions[:, 0, 0] = motions[:, 1, 1] = 1.0
    motions[:, 0, 2], motions[:, 1, 2] = -arms.imag, arms.real
    return motions.reshape(-1, 3)


def independent_rows(rows):
    """A maximal set of linearly independent rows, in their order."""
    from scipy.linalg import qr

    _, R, order = qr(rows.T, mode="economic", pivoting=True)
    rank = int((np.abs(np.diag(R)) > INDEPENDENT).sum())
    return rows[np.sort(order[:rank])]


def modes_of(K, M, kkt, C, arms, count):
    """The lowest `count` modes, (2N, count), of the span of static and normal modes, without rigid motion."""
    from scipy.linalg import eigh, null_space
    from scipy.sparse import eye_array, kron
    from scipy.sparse.linalg import LinearOperator, eigsh

    n, M2, none = K.shape[0], kron(M, eye_array(2)).tocsr(), np.zeros(len(C))
    span = [np.stack([kkt.solve(np.zeros(n), -unit)[0] for unit in np.eye(len(C))], axis=1)]
    normal = min(max(0, count - len(C) + 3), n - len(C))
    if 2 * normal >= n:  # most of the spectrum: dense
        free = null_space(C)
        span.append(free @ eigh(free.T @ (K @ free), free.T @ (M2 @ free))[1][:, :normal])
    elif normal:
        inverse = LinearOperator((n, n), matvec=lambda r: kkt.solve(-r, none)[0], dtype=float)
        start = inverse @ (M2 @ np.random.default_rng(0).standard_normal(n))
        span.append(eigsh(K, k=normal, M=M2, sigma=0.0, OPinv=inverse, v0=start)[1])
    rigid, span = (
        fields / np.sqrt(np.einsum("ij,ij->j", fields, M2 @ fields)) for fields in (rigid_fields(arms), np.concatenate(span, axis=1))
    )
    span -= rigid @ (rigid.T @ (M2 @ span))
    values, vectors = np.linalg.eigh(span.T @ (M2 @ span))
    good = values > INDEPENDENT**2
    span = span @ (vectors[:, good] / np.sqrt(values[good]))
    _, turned = np.linalg.eigh(span.T @ (K @ span))
    return span @ turned[:, :count]


def orthogonal_fields(M, rigid, fields):
    """The fields made orthonormal in M, complex, to the rigid ones and each other; dependent ones are dropped."""
    basis = [f / np.sqrt(np.vdot(f, M @ f).real) for f in rigid]
    for f in fields.T:
        size = np.sqrt(np.vdot(f, M @ f).real)
        for _ in range(2):
            for other in basis:
                f = f - np.vdot(other, M @ f) * other
        rest = np.sqrt(np.vdot(f, M @ f).real)
        if rest > INDEPENDENT * size:
            basis.append(f / rest)
    return np.array(basis[len(rigid) :]).reshape(-1, len(fields)).T


def form_of_fields(matrices, fields):
    """Return (form, shift) of the elastic energy for `x = sum z_k f_k`, fields (N, K): `form = sum weight t Q^T C Q` over the points.

    With a_k, b_k the x and y derivatives of f_k, Q maps y to (Exx, Eyy, 2 Exy): conj(z_i) z_j has the factors conj(a_i) a_j / 2,
    conj(b_i) b_j / 2 and (conj(a_i) b_j + conj(b_i) a_j) / 2. shift: of the stabilisation, which is quadratic in z.
    """
    membrane_stiffness, nu = matrices.membrane
    C = membrane_stiffness * np.array([[1.0, nu, 0.0], [nu, 1.0, 0.0], [0.0, 0.0, (1.0 - nu) / 2.0]])
    i, j = np.triu_indices(fields.shape[1])
    p, q = np.triu_indices(fields.shape[1], 1)
    half = np.where(i == j, 0.5, 1.0)
    size = fields.shape[1] ** 2
    form = np.zeros((size, size))
    for weights, slopes in _points(matrices.operator, fields):
        a, b = slopes[:, 0], slopes[:, 1]
        Q = [np.concatenate([half * (s[:, i].conj() * s[:, j]).real, -(s[:, p].conj() * s[:, q]).imag], axis=1) for s in (a, b)]
        mixed = a[:, i].conj() * b[:, j] + b[:, i].conj() * a[:, j]
        across = a[:, p].conj() * b[:, q] + b[:, p].conj() * a[:, q]
        Q = np.stack([*Q, np.concatenate([half * mixed.real, -across.imag], axis=1)])
        weighted = np.einsum("ab,bpy->apy", C, Q) * weights[:, None]
        form += Q.reshape(-1, size).T @ weighted.reshape(-1, size)
    if matrices.stabilisation is None:
        return (form + form.T) / 2, np.zeros(size)
    H = fields.conj().T @ (matrices.stabilisation @ fields)
    return (form + form.T) / 2, np.concatenate([half * H[i, j].real, -H[p, q].imag])


def _points(operator, fields):
    """Yield, for chunks of cells of an operator, (weights (points,), derivatives (points, 2, K)) of their integration points.

    The weights are areas. The derivatives in x and y are of K fields (nodes, K), one column each, real or complex.
    """

    def rows(array, starts, shape):
        """Parts of a flat array from each of `starts` on, reshaped: (starts, *shape)."""
        return array[starts[:, None] + np.arange(np.prod(shape))].reshape(len(starts), *shape)

    layout = operator.layout
    for n, points in np.unique(layout[:, :2], axis=0):
        blocks = layout[(layout[:, 0] == n) & (layout[:, 1] == points)]
        for k in range(0, len(blocks), CHUNK):
            _, _, corner, gradient, weight = blocks[k : k + CHUNK].T[:5]
            values = fields[rows(operator.corners, corner, (n, LANES))]
            values = values[:, :-1] - values[:, -1:]
            gradients = rows(operator.gradients, gradient, (points, n - 1, 2, LANES))
            slopes = np.einsum("bpcdl,bclk->bpldk", gradients, values, optimize=True)
            yield rows(operator.weights, weight, (points, LANES)).ravel(), slopes.reshape(-1, 2, fields.shape[1])
