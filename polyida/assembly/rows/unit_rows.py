"""The rows of phi_q made of length one, along a run: a compiled proof, state by state, that they stay independent of each other.

B are the unit rows of phi_q, its columns in the sizes of the coordinates, G = B B^T and s the least singular value of B, so that
`s >= tr(G^-1)^(-1/2)`. No singular value changes by more than B in the Frobenius norm. From a state that is referred to, with the bound s_0, all is well
as long as B is nearer than s_0 / 2 to B_0. Beyond that the state becomes the one that is referred to, if s_0 + s_1 is more than the way or
`det(B_0 B_1^T)` says that the space of the rows has not come back reversed. With rows in an order of small bandwidth k (Cuthill, McKee 1969)
factors cost O(m k^2), and so does the trace, from the entries of G^-1 within the band (Takahashi 1973).
"""

from typing import NamedTuple

import numpy as np

from polyida.assembly.rows import joints
from polyida.errors import DONE
from polyida.jit import entry, pack, part
from polyida.jit.intrinsics import address, call
from polyida.linear.saddle import coordinate_sizes

CLOSE = 1e-5  # a bound of the least singular value that proves enough
SHARE = 0.5  # of that bound: how far rows may go before they are looked at more closely
REVERSED = 0.5  # cosine of the turn of the rows' space that proves enough
LEAST, VOLUME = range(2)  # of Scratch.marks: the bound at the state that is referred to, and half of log det G


@pack
class Pattern(NamedTuple):
    """The numbers of phi_q that may not be zero, row after row in an order of small bandwidth: row k has those from start[k] to start[k + 1].

    Number i is in column columns[i], the sum of weights x slopes[sources] over terms[i] to terms[i + 1], slopes those of phi in the points.
    """

    start: np.ndarray
    columns: np.ndarray
    terms: np.ndarray
    sources: np.ndarray
    weights: np.ndarray


@pack
class Scratch(NamedTuple):
    """rows (2, numbers): the unit rows of the state that is referred to and of that which is looked at. band (m, 2 k + 1): products of rows with
    those up to k before and behind; lower (m, k + 1): factors, inverse (m, k + 1): entries of an inverse. past (2, 1 + n): t and q of
    the state that is referred to and of the one before it.
    """

    rows: np.ndarray
    slopes: np.ndarray
    points: np.ndarray
    row: np.ndarray
    band: np.ndarray
    lower: np.ndarray
    inverse: np.ndarray
    marks: np.ndarray
    past: np.ndarray


def pattern_of(model):
    """(Pattern, bandwidth, number of slopes in the points, sizes of the coordinates) of a scene."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    links, n, m = model.arrays.links, model.n, model.m
    slopes, sizes = len(links.row_columns), coordinate_sizes(model, np.zeros(n))
    points = model._points_of_q[links.row_columns].tocoo()
    row = np.repeat(np.arange(m), np.diff(links.row_start))
    touched = csr_array((np.ones(points.nnz), (row[points.row], points.col)))
    order = reverse_cuthill_mckee(csr_array(touched @ touched.T), symmetric_mode=True).astype(np.int64)
    place = np.empty(m, np.int64)
    place[order] = np.arange(m)
    keys = place[row[points.row]] * n + points.col
    numbers, which = np.unique(keys, return_inverse=True)
    sort = np.argsort(which, kind="stable")
    rows, columns = np.divmod(numbers, n)
    pattern = Pattern(
        np.searchsorted(rows, np.arange(m + 1)),
        columns,
        np.searchsorted(which[sort], np.arange(len(numbers) + 1)),
        points.row[sort].astype(np.int64),
        (points.data * sizes[points.col])[sort],
    )
    by_column = np.argsort(columns, kind="stable")
    rows, first = rows[by_column], np.flatnonzero(np.diff(columns[by_column], prepend=-1))  # a column's entries side by side
    apart = np.maximum.reduceat(rows, first) - np.minimum.reduceat(rows, first) if len(rows) else np.zeros(0)
    return pattern, int(apart.max(initial=0)), slopes, sizes


def dense_pattern(model, sizes):
    """The Pattern of a phi_q without zeros, its numbers row after row."""
    n, m = model.n, model.m
    numbers = np.arange(m * n + 1)
    columns = np.tile(np.arange(n), m)
    return Pattern(n * np.arange(m + 1), columns, numbers, numbers[:-1].copy(), sizes[columns])


@part
def fill_slopes(links, drives, times, k, q, w):
    """Those of a scene at its drives; of a model without links phi_q, by a C function at an address that reads data at another one."""
    if links is None:
        return call(drives[0], drives[1], 0, address(times) + 8 * k, address(q), 0, 0, 0, address(w.slopes)) == DONE
    joints.point_values(links, q.reshape((q.shape[0] // 2, 2)), w.points)
    joints.joint_jacobian(links, drives[k], w.points, w.slopes)
    return True


@part
def fill_rows(u, links, drives, times, at, q, w):
    """The unit rows at q, nan where the model does not give them."""
    rows = w.rows[1]
    if not fill_slopes(links, drives, times, at, q, w):
        w.slopes[:] = np.nan
    for k in range(u.start.shape[0] - 1):
        square = 0.0
        for i in range(u.start[k], u.start[k + 1]):
            rows[i] = 0.0
            for e in range(u.terms[i], u.terms[i + 1]):
                rows[i] += u.weights[e] * w.slopes[u.sources[e]]
            square += rows[i] * rows[i]
        scale = 1.0 / np.sqrt(square) if square > 0.0 else 1.0
        for i in range(u.start[k], u.start[k + 1]):
            rows[i] *= scale


@part
def fill_band(u, x, y, w):
    """The products of unit rows x with rows y that are near them."""
    m, k = w.band.shape[0], w.band.shape[1] // 2
    for i in range(m):
        for e in range(u.start[i], u.start[i + 1]):
            w.row[u.columns[e]] = x[e]
        for j in range(max(0, i - k), min(m, i + k + 1)):
            product = 0.0
            for e in range(u.start[j], u.start[j + 1]):
                product += w.row[u.columns[e]] * y[e]
            w.band[i, j - i + k] = product
        for e in range(u.start[i], u.start[i + 1]):
            w.row[u.columns[e]] = 0.0


@part
def bound(u, w):
    """(bound from below of the least singular value of the rows looked at, half of log det G); (0, -inf) where G is not positive definite."""
    fill_band(u, w.rows[1], w.rows[1], w)
    m, k, low, inverse = w.band.shape[0], w.band.shape[1] // 2, w.lower, w.inverse
    volume = 0.0
    for i in range(m):  # G = L D L^T: low[i, i - j] is L_ij, low[i, 0] is D_i
        for j in range(max(0, i - k), i + 1):
            value = w.band[i, j - i + k]
            for e in range(max(0, i - k, j - k), j):
                value -= low[i, i - e] * low[e, 0] * low[j, j - e]
            low[i, i - j] = value / low[j, 0] if j < i else value
        if not low[i, 0] > 0.0:
            return 0.0, -np.inf
        volume += 0.5 * np.log(low[i, 0])
    trace = 0.0
    for i in range(m - 1, -1, -1):  # inverse[i, j - i] is (G^-1)_ij, j >= i
        last = min(m - 1, i + k)
        for j in range(last, i - 1, -1):
            value = 1.0 / low[i, 0] if j == i else 0.0
            for e in range(i + 1, last + 1):
                value -= low[e, e - i] * inverse[min(e, j), abs(e - j)]
            inverse[i, j - i] = value
        trace += inverse[i, 0]
    return 1.0 / np.sqrt(trace), volume


@part
def same_side(u, w, volume):
    """Whether elimination without exchanges proves that the space of the rows has not turned far."""
    fill_band(u, w.rows[0], w.rows[1], w)
    m, k, turned = w.band.shape[0], w.band.shape[1] // 2, -w.marks[VOLUME] - volume
    for i in range(m):
        pivot = w.band[i, k]
        if not pivot > CLOSE * CLOSE:
            return False
        turned += np.log(pivot)
        for j in range(i + 1, min(m, i + k + 1)):
            share = w.band[j, i - j + k] / pivot
            for e in range(i + 1, min(m, i + k + 1)):
                w.band[j, e - j + k] -= share * w.band[i, e - i + k]
    return turned >= np.log(REVERSED)


@part
def refer(t, q, size, volume, w):
    """Refer to the state that is looked at from now on."""
    w.marks[LEAST], w.marks[VOLUME] = size, volume
    w.rows[0] = w.rows[1]
    w.past[1] = w.past[0]
    w.past[0, 0] = t
    w.past[0, 1:] = q


@entry
def begin(u, links, drives, times, q, w):
    """Refer to a state, whatever it is, at the one of the times; whether it is proven sound."""
    fill_rows(u, links, drives, times, 0, q, w)
    size, volume = bound(u, w)
    refer(times[0], q, size, volume, w)
    return size > CLOSE


@entry
def unproven(u, links, drives, times, qs, first, w):
    """The first of the states (count,), from number `first` on, for which nothing is proven, or their number."""
    for k in range(first, qs.shape[0]):
        fill_rows(u, links, drives, times, k, qs[k], w)
        square = 0.0
        for i in range(w.rows.shape[1]):
            square += (w.rows[1, i] - w.rows[0, i]) ** 2
        way = np.sqrt(square)
        if way < SHARE * w.marks[LEAST]:
            continue
        size, volume = bound(u, w)
        if not (size > CLOSE and (way < w.marks[LEAST] + size or same_side(u, w, volume))):
            return k
        refer(times[k], qs[k], size, volume, w)
    return qs.shape[0]


class UnitRows:
    """The unit rows of phi_q along a run, of a scene or of a small model whose functions are `compiled` (a Compiled)."""

    def __init__(self, model, state, compiled=None):
        self.model, self.compiled, m, n = model, compiled, model.m, model.n
        if compiled is None:
            self.pattern, k, slopes, self.sizes = model.once(pattern_of)
            self.links, points, self.turning = model.arrays.links, model.n_points, model.motor_profiles.tolist()
        else:
            self.sizes = coordinate_sizes(model, state.q)
            self.pattern, k, slopes, self.links, points = dense_pattern(model, self.sizes), m - 1, m * n, None, 0
            self.drives = np.array([compiled.addresses["phi_q"], compiled.data])
        shapes = (2, len(self.pattern.columns)), slopes, (points, 2), n, (m, 2 * k + 1), (m, k + 1), (m, k + 1), 2, (2, 1 + n)
        self.scratch = Scratch(*map(np.zeros, shapes))
        self.scratch.past[:] = state.t, *state.q

    def begin(self, state):
        """Refer to a state from now on, whatever it is; whether it is proven sound."""
        times = np.array([state.t])
        return begin(self.pattern, self.links, self._drives(times), times, np.array(state.q), self.scratch)

    def unproven(self, stretch):
        """Yield the numbers of the states of a stretch for which nothing is proven; who asks for the next one has found that one to be sound."""
        times, qs, k = np.ascontiguousarray(stretch.t), np.ascontiguousarray(stretch.q), 0
        drives = self._drives(times)
        while (k := unproven(self.pattern, self.links, drives, times, qs, k, self.scratch)) < len(times):
            yield k
            self.begin(stretch.state(k))
            k += 1

    def before(self, t):
        """(t, q) of the last state referred to before t, or of the first one."""
        past = self.scratch.past[int(not self.scratch.past[0, 0] < t)]
        return float(past[0]), past[1:].copy()

    def _drives(self, times):
        """The angles that turn rows, (times, profiles, 3), without derivatives, which the slopes of rows do not ask for."""
        if self.links is None:
            return self.drives
        drives = np.zeros((len(times), len(self.model.profiles), 3))
        for k in self.turning:
            drives[:, k, 0] = self.model.profiles[k].over(times)
        return drives
