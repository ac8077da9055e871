"""From a plate and what holds it to few fields: its matrices at rest, static, normal and own modes, and the exact energy of their span."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from polyida.body.body import BodyPoint
from polyida.element import kernels
from polyida.element import stabilisation as virtual
from polyida.element.choose import operator_of, stabilisation_factor
from polyida.jit.intrinsics import LANES
from polyida.linear.saddle import KKT
from polyida.validation import complex_of_pairs


@dataclass(frozen=True, eq=False)
class PlateMatrices:
    """Of a plate: its operator, M (N, N) of one direction, kg, and K (2N, 2N), N/m, on (x, y) node by node."""

    plate: Any
    operator: Any

    @classmethod
    def of(cls, plate):
        """Those of a plate."""
        return cls(plate, operator_of(plate))

    @property
    def c1(self):
        """`t E / (1 - nu^2)`, N/m, and the ratio, in the plane."""
        modulus, nu = self.plate.material.in_plane
        return self.plate.thickness * modulus / (1 - nu**2), nu

    @cached_property
    def mass(self):
        """M, (N, N) sparse."""
        from scipy.sparse import csr_array

        o = self.operator
        density = self.plate.material.rho * self.plate.thickness
        return csr_array((o.mass * density, o.indices, o.indptr), shape=(o.n_nodes,) * 2)

    @cached_property
    def stabilisation(self):
        """The stabilisation of one direction, (N, N) sparse, N/m, or None."""
        from scipy.sparse import csr_array

        o = self.operator
        factor = stabilisation_factor(self.plate, o)
        return csr_array((o.stabilisation * factor, o.indices, o.indptr), shape=(o.n_nodes,) * 2) if factor else None

    @cached_property
    def stiffness(self):
        """K at rest, (2N, 2N) sparse."""
        from scipy.sparse import bsr_array, eye_array, kron

        o = self.operator
        blocks = np.zeros((len(o.indices), 2, 2))
        kernels.tangent(o.layout, o.corners, o.gradients, o.weights, o.pairs, 0, 0, *self.c1, np.zeros((o.n_nodes, 2)), 1.0, blocks)
        K = bsr_array((blocks, o.indices, o.indptr), shape=(2 * o.n_nodes,) * 2).tocsc()
        return K if self.stabilisation is None else (K + kron(self.stabilisation, eye_array(2))).tocsc()

    def force(self, moved):
        """Internal force (N, 2), N, at displacements (N, 2), m."""
        o, f = self.operator, np.zeros_like(moved)
        kernels.internal_force(*o.force_arrays, 0, *self.c1, np.ascontiguousarray(moved), f, np.empty((0, 2)))
        if self.stabilisation is not None:
            virtual.force(o.indptr, o.indices, o.stabilisation, stabilisation_factor(self.plate, o), 0, np.ascontiguousarray(moved), f)
        return f


def rows_of(plate, sides):
    """What the attachments to nodes hold of a plate at rest, (rows, 2N) dense: mean x, mean y and, where they have a direction, rotation;
    and how these directions grow longer, which nothing holds.
    """
    n = plate.mesh.n_nodes
    held, longer = [np.zeros((0, 2 * n))], [np.zeros((0, 2 * n))]
    for side in {(side.nodes.tobytes(), side.weights.tobytes()): side for side in sides}.values():
        held += [_row(n, side.nodes, side.weights, *way) for way in ((1.0, 0.0), (0.0, 1.0))]
        if side.turn_weights is not None:
            x, y = side.direction
            held.append(_row(n, side.nodes, side.turn_weights, -y, x))
            longer.append(_row(n, side.nodes, side.turn_weights, x, y))
    return np.concatenate(held), np.concatenate(longer)


def _row(n, nodes, weights, x, y):
    row = np.zeros((1, n, 2))
    row[0, nodes, 0], row[0, nodes, 1] = x * weights, y * weights
    return row.reshape(1, -1)


SAME = 1e-6  # of a field, that the others do not give: as good as nothing


@dataclass(frozen=True, eq=False)
class Basis:
    """shapes (N, pairs) complex: 1, (X - X_S) / s and further ones, `f_i^H M f_k = mass delta_ik`; centre: X_S, m; mass, kg, and radius of
    gyration s, m, of the plate's M. hold: what keeps it where it is held.
    """

    shapes: np.ndarray
    centre: complex
    mass: float
    gyration: float
    hold: "Hold"


class Hold:
    """The factor of `[[K, C^T], [C, 0]]` with `rows` in C, and further rows (k, 2N) that are held beside, in `still`."""

    def __init__(self, factor, rows, further):
        self.factor, self.rows, self.further, self._reach = factor, rows, further, None

    def still(self, r):
        """d with `K d + forces on what is held = -r`, C d = 0 and the further rows too, (2N,)."""
        d, none = self.factor.solve(r, np.zeros(self.rows))[0], np.zeros(self.rows)
        if not len(self.further):
            return d
        if self._reach is None:
            self._reach = np.stack([self.factor.solve(-row, none)[0] for row in self.further], axis=1)
        return d - self._reach @ np.linalg.solve(self.further @ self._reach, self.further @ d)


def basis_of(matrices, sides, count, own=None, made=None):
    """The Basis of a plate held by attachments, with `count` modes beside the fields `own` (N, k), complex, or with those that are `made`.

    Static modes: displacement one of a mean x, y or rotation, zero of all others. Normal modes: of the plate with all of these held.
    Both together, freed of rigid motion, come by their frequencies. Rows of what holds it are completed by mean motion where it is free,
    or held by its centre of mass, a BodyPoint.
    """
    plate, M = matrices.plate, matrices.mass
    ones = np.ones(plate.mesh.n_nodes)
    mass = float(ones @ (M @ ones))
    places = plate.placed.points
    middle = (ones @ (M @ places)) / mass
    arms = complex_of_pairs(places - middle)
    gyration = float(np.sqrt(np.vdot(arms, M @ arms).real / mass))
    K = matrices.stiffness
    nodal = [side for side in sides if not isinstance(side, BodyPoint)]
    rows, longer = rows_of(plate, nodal)
    C = _independent(_completed(rows, M, arms, len(nodal) < len(sides)))
    hold = KKT(K, C)
    if made is None:
        fields = [np.zeros((len(arms), 0)), *(() if own is None else (own,))]
        if count:
            modes = _modes(K, M, hold, C, arms, count)
            fields.insert(0, complex_of_pairs(modes.reshape(-1, 2, modes.shape[1]).transpose(2, 0, 1)).T)
        made = np.sqrt(mass) * _orthogonal(M, [ones.astype(complex), arms], np.concatenate(fields, axis=1))
    shapes = np.concatenate([np.stack([ones, arms / gyration], axis=1), made], axis=1)
    return Basis(shapes, complex(*(middle + plate.origin)), mass, gyration, Hold(hold, len(C), longer))


def _completed(rows, M, arms, whole):
    """The rows, with means of the whole plate where they leave it free to move, or where it is held as a `whole`."""
    rigid = _rigid(arms)
    sizes = np.linalg.norm(rigid, axis=0)
    held = np.linalg.matrix_rank(rows @ (rigid / sizes), tol=SAME * np.abs(rows).max(initial=0.0)) if len(rows) else 0
    if held == 3 and not whole:
        return rows
    weighted = np.repeat(M @ np.ones(len(arms)), 2)[:, None] * rigid
    return np.concatenate([rows, (weighted / np.linalg.norm(weighted, axis=0)).T])


def _rigid(arms):
    """Small rigid motions, (2N, 3)."""
    found = np.zeros((len(arms), 2, 3))
    found[:, 0, 0] = found[:, 1, 1] = 1.0
    found[:, 0, 2], found[:, 1, 2] = -arms.imag, arms.real
    return found.reshape(-1, 3)


def _independent(rows):
    """Those of the rows that are linearly independent, in their order."""
    from scipy.linalg import qr

    unit = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    _, R, order = qr(unit.T, mode="economic", pivoting=True)
    rank = int((np.abs(np.diag(R)) > SAME).sum())
    return rows[np.sort(order[:rank])]


def _modes(K, M, hold, C, arms, count):
    """The lowest `count` modes, (2N, count), of the span of static and normal ones, freed of rigid motion."""
    from scipy.sparse import eye_array, kron

    n, M2 = K.shape[0], kron(M, eye_array(2)).tocsr()
    static = [hold.solve(np.zeros(n), -unit)[0] for unit in np.eye(len(C))]
    normal = min(max(0, count - len(C) + 3), n - len(C))
    span = np.stack([*static, *(_normal(K, M2, hold, C, normal).T if normal else ())], axis=1)
    rigid = _rigid(arms)
    rigid /= np.sqrt(np.einsum("ij,ij->j", rigid, M2 @ rigid))
    span -= rigid @ (rigid.T @ (M2 @ span))
    values, vectors = np.linalg.eigh(span.T @ (M2 @ span))
    good = values > SAME**2 * values[-1]
    span = span @ (vectors[:, good] / np.sqrt(values[good]))
    _, turned = np.linalg.eigh(span.T @ (K @ span))
    return span @ turned[:, :count]


def _normal(K, M2, hold, C, count):
    """The lowest normal modes with all rows held, (2N, count); where they are most of what the mesh has, of dense matrices."""
    from scipy.linalg import eigh, null_space
    from scipy.sparse.linalg import LinearOperator, eigsh

    n, still = K.shape[0], np.zeros(len(C))
    if 2 * count >= n:
        free = null_space(C)
        return free @ eigh(free.T @ (K @ free), free.T @ (M2 @ free))[1][:, :count]
    inverse = LinearOperator((n, n), matvec=lambda r: hold.solve(-r, still)[0], dtype=float)
    start = inverse @ (M2 @ np.random.default_rng(0).standard_normal(n))
    return eigsh(K, k=count, M=M2, sigma=0.0, OPinv=inverse, v0=start)[1]


def _orthogonal(M, rigid, fields):
    """The fields made orthogonal in M, complex, to the rigid ones and each other, of length one; those that add nothing left out."""
    kept = [field / np.sqrt(np.vdot(field, M @ field).real) for field in rigid]
    for field in fields.T:
        size = np.sqrt(np.vdot(field, M @ field).real)
        for _ in range(2):
            for other in kept:
                field = field - np.vdot(other, M @ field) * other
        left = np.sqrt(np.vdot(field, M @ field).real)
        if left > SAME * size:
            kept.append(field / left)
    return np.array(kept[len(rigid) :]).reshape(-1, len(fields)).T


CHUNK = 512  # blocks of cells whose strains are held at a time


def form_of_fields(matrices, fields):
    """(form, shift): `W = d^T form d / 2 + shift^T d`, d the gain of y = (Re conj(z_i) z_j, i <= j; Im conj(z_i) z_j, i < j), for
    `x = sum z_k f_k`, fields (N, K).

    With a_k, b_k the slopes of f_k along x and y, conj(z_i) z_j is multiplied in Exx by conj(a_i) a_j / 2, in Eyy by conj(b_i) b_j / 2,
    in 2 Exy by `conj(a_i) b_j + conj(b_i) a_j`, /2; `form = sum weight t Q^T C Q` over the points, Q from y to (Exx, Eyy, 2 Exy).
    shift: of the stabilisation, which is quadratic in z.
    """
    c1, nu = matrices.c1
    C = c1 * np.array([[1.0, nu, 0.0], [nu, 1.0, 0.0], [0.0, 0.0, (1.0 - nu) / 2.0]])
    size = fields.shape[1] ** 2
    form = np.zeros((size, size))
    for weights, slopes in _points(matrices.operator, fields):
        Q = _strains(slopes)
        weighted = np.einsum("ab,bpy->apy", C, Q) * weights[:, None]
        form += Q.reshape(-1, size).T @ weighted.reshape(-1, size)
    if matrices.stabilisation is None:
        return (form + form.T) / 2, np.zeros(size)
    H = fields.conj().T @ (matrices.stabilisation @ fields)
    i, j = np.triu_indices(len(H))
    p, q = np.triu_indices(len(H), 1)
    return (form + form.T) / 2, np.concatenate([np.where(i == j, 0.5, 1.0) * H[i, j].real, -H[p, q].imag])


def _strains(slopes):
    """Q, (3, points, K^2), from the fields' slopes (points, 2, K)."""
    a, b = slopes[:, 0], slopes[:, 1]
    i, j = np.triu_indices(a.shape[1])
    p, q = np.triu_indices(a.shape[1], 1)
    half = np.where(i == j, 0.5, 1.0)
    found = []
    for left, right in ((a, a), (b, b)):
        found.append(np.concatenate([half * (left[:, i].conj() * right[:, j]).real, -(left[:, p].conj() * right[:, q]).imag], axis=1))
    mixed = a[:, i].conj() * b[:, j] + b[:, i].conj() * a[:, j]
    across = a[:, p].conj() * b[:, q] + b[:, p].conj() * a[:, q]
    found.append(np.concatenate([half * mixed.real, -across.imag], axis=1))
    return np.stack(found)


def _points(operator, fields):
    """Pieces of all integration points: their areas (points,) and the slopes of the fields there (points, 2, K)."""
    layout = operator.layout
    for n, points in np.unique(layout[:, :2], axis=0):
        blocks = layout[(layout[:, 0] == n) & (layout[:, 1] == points)]
        for k in range(0, len(blocks), CHUNK):
            _, _, corner, gradient, weight = blocks[k : k + CHUNK].T[:5]
            corners = _taken(operator.corners, corner, (n, LANES))
            gradients = _taken(operator.gradients, gradient, (points, n - 1, 2, LANES))
            values = fields[corners]
            values = values[:, :-1] - values[:, -1:]
            slopes = np.einsum("bpcdl,bclk->bpldk", gradients, values, optimize=True)
            yield _taken(operator.weights, weight, (points, LANES)).ravel(), slopes.reshape(-1, 2, fields.shape[1])


def _taken(array, starts, shape):
    """Rows of an array from each of the starts, (starts, *shape)."""
    return array[starts[:, None] + np.arange(np.prod(shape))].reshape(len(starts), *shape)
