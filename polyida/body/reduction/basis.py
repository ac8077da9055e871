"""The fields of a reduced plate: static modes of what holds it, fixed-interface normal modes, and fields of a user's own."""

from dataclasses import dataclass

import numpy as np

from polyida.body.body import BodyPoint
from polyida.body.reduction.plate_matrices import rows_of
from polyida.given import complex_of_pairs
from polyida.linear.kkt import KKT, scaling_factors

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
    hold = KKT(K, C, scaling_factors("physical", 1.0, K))
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
    normal = max(0, min(count - len(C) + 3, n - len(C) - 1))
    span = np.stack([*static, *(_normal(K, M2, hold, len(C), normal).T if normal else ())], axis=1)
    rigid = _rigid(arms)
    rigid /= np.sqrt(np.einsum("ij,ij->j", rigid, M2 @ rigid))
    span -= rigid @ (rigid.T @ (M2 @ span))
    values, vectors = np.linalg.eigh(span.T @ (M2 @ span))
    good = values > SAME**2 * values[-1]
    span = span @ (vectors[:, good] / np.sqrt(values[good]))
    _, turned = np.linalg.eigh(span.T @ (K @ span))
    return span @ turned[:, :count]


def _normal(K, M2, hold, rows, count):
    """The lowest normal modes with all rows held, (2N, count)."""
    from scipy.sparse.linalg import LinearOperator, eigsh

    n, still = K.shape[0], np.zeros(rows)
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
