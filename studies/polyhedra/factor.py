"""A multifrontal factor of symmetric matrices of nodal 3 x 3 blocks, and a step matrix that turns with the nodes.

Nested dissection: a set of nodes is halved across its longest axis, the nodes of one half that neighbour the other separate the two, and the
halves are divided in the same way. A front is a separator or a set too small to divide, `((A, B), (B^T, C))` with the later nodes that it
is coupled to; A^-1 and Y = A^-1 B are stored, C - B^T Y goes to the parent. Source: Duff and Reid, ACM TOMS 9 (1983) 302-325.

The step matrix of a body that turns by nodal rotations T is nearly `T S T^T`, S that of the state where it was factored: a factor serves for
many steps. The constraints are means over nodes that turn together: the columns S^-1 B^T are turned likewise.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack, solve_triangular

import polyida as pi

LEAF = 90  # nodes of a set that is not divided
SINGLE = 1e-5  # share of the masses in S: above it single precision keeps more than a digit


class Front(NamedTuple):
    """places: of its own nodes in the order of elimination, then of the later nodes that these are coupled to, its rest. parent: the number of
    the front that takes its update. rows, columns: where in its matrix the blocks with these numbers are."""

    own: slice
    places: np.ndarray
    rest: np.ndarray
    parent: int
    rows: np.ndarray
    columns: np.ndarray
    numbers: np.ndarray


def fronts_of(indptr, indices, points):
    """(the nodes in the order of elimination, the Fronts) of a symmetric pattern (CSR) of nodes at points (nodes, 3)."""
    side, sets, of = np.zeros(len(points), np.int8), [], lambda i: slice(indptr[i], indptr[i + 1])

    def divide(nodes):
        if len(nodes) > LEAF:
            along = points[nodes, np.ptp(points[nodes], axis=0).argmax()]
            low, high = np.split(nodes[np.argsort(along, kind="stable")], [len(nodes) // 2])
            side[low], side[high] = 1, 2
            nodes = min(([i for i in half if (side[indices[of(i)]] == far).any()] for half, far in ((low, 2), (high, 1))), key=len)
            side[low], side[high] = 0, 0
            divide(np.setdiff1d(low, nodes))
            divide(np.setdiff1d(high, nodes))
        if len(nodes):
            sets.append(np.array(nodes))

    divide(np.arange(len(points)))
    order, first = np.concatenate(sets), np.append(0, np.cumsum([len(one) for one in sets]))
    place, number, fronts, waiting = np.argsort(order), np.repeat(np.arange(len(sets)), np.diff(first)), [], [[] for _ in sets]
    for f, nodes in enumerate(sets):
        numbers = np.concatenate([np.arange(indptr[i], indptr[i + 1]) for i in nodes])
        rows, columns = np.repeat(np.arange(len(nodes)), np.diff(indptr)[nodes]), place[indices[numbers]]
        rest = np.unique(np.concatenate([columns, *waiting[f]]))
        rest, right = rest[rest >= first[f + 1]], columns >= first[f]
        places, parent = np.append(np.arange(first[f], first[f + 1]), rest), number[rest[0]] if len(rest) else -1
        if len(rest):
            waiting[parent].append(rest)
        at = rows[right], np.searchsorted(places, columns[right]), numbers[right]
        fronts.append(Front(slice(first[f], first[f + 1]), places, rest, parent, *at))
    return order, fronts


def factored(fronts, blocks, dtype):
    """([(A^-1, Y) of each front] of blocks (nnz, 3, 3) in a precision, True if these are positive definite). Raises SingularSystem."""
    definite, panels, updates = True, [], [[] for _ in fronts]
    for f, front in enumerate(fronts):
        size, own = len(front.places), 3 * (front.own.stop - front.own.start)
        S = np.zeros((size, 3, size, 3), blocks.dtype)
        S[front.rows, :, front.columns, :] = blocks[front.numbers]
        for rest, update in updates[f]:
            at = np.searchsorted(front.places, rest)
            S[at[:, None], :, at, :] += update
        updates[f], S = None, S.reshape(3 * size, 3 * size)
        inverse, positive = inverted(S[:own, :own])
        Y, definite = inverse @ S[:own, own:], definite and positive
        panels.append((inverse.astype(dtype), Y.astype(dtype)))
        if size > own // 3:
            left = (S[own:, own:] - S[:own, own:].T @ Y).reshape(size - own // 3, 3, -1, 3)
            updates[front.parent].append((front.rest, left.transpose(0, 2, 1, 3)))
    return panels, definite


def inverted(A):
    """(the inverse of a symmetric matrix, True if it is positive definite). Raises SingularSystem."""
    if not np.isfinite(A).all():
        raise pi.SingularSystem("the step matrix is not finite")
    if A.dtype == float:
        lower, info = lapack.dpotrf(A, lower=1)
        if not info:
            half = solve_triangular(lower, np.eye(len(A)), lower=True, check_finite=False)
            return half.T @ half, True
    try:
        return np.linalg.inv(A), False
    except np.linalg.LinAlgError:
        raise pi.SingularSystem("the step matrix is singular") from None


class Turned(pi.StepMatrix):
    """`S = c_m M + K` of a Polyhedra model, turned with its nodes; in single precision, or in double where masses are a small part of it."""

    backend = "multifrontal, numpy"
    near_any_state, caution = True, 1.0

    def factor(self, t, q, v, a, lam, c_m, c_v):
        self.made_at = np.concatenate([[t], q, v, a, lam])
        self._make(self.model.stiffness_blocks(q), self.model.rotations(q), c_m)

    def _make(self, K, frame, c_m):
        self.K, self.frame, blocks, (self.order, self.fronts) = K, frame, K.astype(np.result_type(K, c_m)), self.model.fronts
        blocks[:, range(3), range(3)] += c_m * self.model.nodal_mass[:, None]
        single = abs(c_m) * self.model.M.diagonal().mean() > SINGLE * np.abs(blocks).max()
        self.dtype = np.dtype((np.complex64 if np.iscomplexobj(blocks) else np.float32) if single else blocks.dtype)
        self.panels, self.definite = factored(self.fronts, blocks, self.dtype)
        self.q, self.turns = None, np.broadcast_to(np.eye(3, dtype=self.dtype.type(0).real.dtype), frame.shape)
        self.pulls = [self._apply(pull.T).reshape(-1, 3, 3).astype(self.dtype) for pull in self.model.pulls]
        self.solves = 3 * len(self.pulls)

    def beside(self, c_m, c_v, change):
        other = type(self)(self.model)
        other.made_at = self.made_at
        other._make(self.K, self.frame, c_m)
        return other

    def stands_alone(self):
        return True

    def positive_definite(self):
        return self.definite

    def _turn(self, q):
        if self.q is None or not np.array_equal(q, self.q):
            self.q, self.turns = np.array(q), (self.model.rotations(q) @ self.frame.transpose(0, 2, 1)).astype(self.turns.dtype)

    def _apply(self, b):
        """T S^-1 T^T b, b (n,) or (n, k)."""
        x = (self.turns.transpose(0, 2, 1) @ np.reshape(b, (len(self.order), 3, -1)).astype(self.dtype))[self.order]
        k = x.shape[2]
        for front, (_, Y) in zip(self.fronts, self.panels):
            x[front.rest] -= (Y.T @ x[front.own].reshape(-1, k)).reshape(-1, 3, k)
        for front, (inverse, Y) in zip(reversed(self.fronts), reversed(self.panels)):
            here = inverse @ x[front.own].reshape(-1, k) - Y @ x[front.rest].reshape(-1, k)
            x[front.own] = here.reshape(-1, 3, k)
        x[self.order] = x.copy()
        return (self.turns @ x).astype(np.result_type(self.dtype, float)).reshape(np.shape(b))

    def solve(self, q, b, transposed=False):
        self._turn(q)
        return self._apply(b)

    def columns(self, q, B):
        """S^-1 B^T of the model's own B from the columns of the factor, turned like their points."""
        self._turn(q)
        X = np.zeros((self.model.n, self.model.m), np.result_type(self.dtype, float))
        for (rows, sign, nodes, weights), pull in zip(self.model.attachments, self.pulls):
            spin = np.tensordot(sign * weights, self.turns[nodes], 1).astype(self.turns.dtype)
            X[:, rows] += (self.turns @ (pull @ spin.T)).reshape(-1, 3)
        return X
