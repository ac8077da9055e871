"""A compiled proof along a run that the rows of phi_q are independent. Redundant rows at the start are found in redundant.py.

B are the rows of phi_q with unit length, columns in units of the coordinates' sizes, G = B B^T, s the least singular value of B:
`s >= tr(G^-1)^(-1/2)`. If B changes by D, no singular value changes by more than the spectral norm |D|. With the bound s_0 at a reference state,
rows are independent while `|B - B_0| < s_0`. Beyond this the state becomes the reference, if s_0 + s_1 exceeds the distance, or if
`det(B_0 B_1^T)` shows that the row space has not returned reversed. With rows in an order of small bandwidth k (Cuthill, McKee 1969) factors
cost O(m k^2), and so does the trace, from the entries of G^-1 within the band (Takahashi 1973). If G - c^2 I has positive pivots, s > c.
"""

from typing import NamedTuple

import numpy as np
from numba import carray

from polyida.assembly import joints
from polyida.errors import DONE
from polyida.jit import entry, pack, part
from polyida.jit.intrinsics import address, call, pointer
from polyida.linear.dense import put
from polyida.linear.saddle import coordinate_sizes

CLOSE = 1e-5  # least singular value that proves independence
SHARE = 0.9  # of the bound: change of the rows that needs no new one; ZERO of a singular position is at most (1 - SHARE) CLOSE
RISE = 1.02  # factor of the bound, by which it approaches the least singular value from state to state
REVERSED = 0.5  # least cosine between the row spaces of two states


@pack
class Pattern(NamedTuple):
    """The entries of phi_q that may differ from zero, row after row in an order of small bandwidth, as sums of weights times slopes of phi_z."""

    start: np.ndarray  # first entry of each row
    columns: np.ndarray  # column of each entry
    terms: np.ndarray  # first term of each entry
    sources: np.ndarray  # slope of each term
    weights: np.ndarray  # weight of each term


@pack
class ProofWorkspace(NamedTuple):
    """The reference state, and workspace."""

    rows: np.ndarray  # (2, entries) unit rows at the reference state, and at the state examined
    slopes: np.ndarray
    points: np.ndarray  # (points, 2)
    row: np.ndarray  # (n,)
    band: np.ndarray  # (m, 2 k + 1) products of rows with those up to k before and after
    inverse: np.ndarray  # (m, k + 1) entries of G^-1
    least: np.ndarray  # (1,) bound of the least singular value at the reference state
    past: np.ndarray  # (2, 1 + n) t and q of the reference state, and of the one before


def pattern_of(model):
    """(Pattern, bandwidth, number of slopes, sizes of the coordinates) of a scene."""
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
    """The Pattern of a full phi_q."""
    n, m = model.n, model.m
    numbers = np.arange(m * n + 1)
    columns = np.tile(np.arange(n), m)
    return Pattern(n * np.arange(m + 1), columns, numbers, numbers[:-1].copy(), sizes[columns])


@part
def fill_slopes(links, drives, times, state, qs, work):
    """Fill work.slopes at a state: phi_z of a scene at its drives, or phi_q of a model without links by the C function at an address in drives."""
    n = qs.shape[1]
    at = address(qs) + 8 * n * state
    if links is None:
        return call(drives[0], (drives[1], 0, address(times) + 8 * state, at, 0, 0, 0, work.slopes)) == DONE
    joints.point_values(links, carray(pointer(at), (n // 2, 2)), work.points)
    joints.joint_jacobian(links, drives[state], work.points, work.slopes)
    return True


@part
def fill_rows(pattern, links, drives, times, at, qs, work):
    """Overwrite work.rows[1] with the rows of phi_q at state number `at`, each of length one; nan if the model raises."""
    rows = work.rows[1]
    if not fill_slopes(links, drives, times, at, qs, work):
        work.slopes[:] = np.nan
    for k in range(pattern.start.shape[0] - 1):
        square = 0.0
        for i in range(pattern.start[k], pattern.start[k + 1]):
            rows[i] = 0.0
            for e in range(pattern.terms[i], pattern.terms[i + 1]):
                rows[i] += pattern.weights[e] * work.slopes[pattern.sources[e]]
            square += rows[i] * rows[i]
        scale = 1.0 / np.sqrt(square) if square > 0.0 else 1.0
        for i in range(pattern.start[k], pattern.start[k + 1]):
            rows[i] *= scale


@part
def fill_band(pattern, left, right, below, work):
    """Overwrite work.band (m, 2 k + 1) with scalar products of the rows i of `left` with the rows j of `right`, at (i, j - i + k).

    They are made for i - below <= j <= i + k. left, right (entries,): two sets of unit rows of phi_q, stored after the pattern. k: half
    width of the band. Other entries stay.
    """
    m, k = work.band.shape[0], work.band.shape[1] // 2
    for i in range(m):
        for e in range(pattern.start[i], pattern.start[i + 1]):
            work.row[pattern.columns[e]] = left[e]
        for j in range(max(0, i - below), min(m, i + k + 1)):
            product = 0.0
            for e in range(pattern.start[j], pattern.start[j + 1]):
                product += work.row[pattern.columns[e]] * right[e]
            work.band[i, j - i + k] = product
        for e in range(pattern.start[i], pattern.start[i + 1]):
            work.row[pattern.columns[e]] = 0.0


@part
def eliminate(work, symmetric, shift):
    """Eliminate work.band - shift I without pivoting, its upper half if it is symmetric; False if a pivot is not positive."""
    m, k = work.band.shape[0], work.band.shape[1] // 2
    for i in range(m):
        work.band[i, k] -= shift
        if not work.band[i, k] > CLOSE * CLOSE:
            return False
        last = min(m, i + k + 1)
        for j in range(i + 1, last):
            share = (work.band[i, j - i + k] if symmetric else work.band[j, i - j + k]) / work.band[i, k]
            for e in range(j if symmetric else i + 1, last):
                work.band[j, e - j + k] -= share * work.band[i, e - i + k]
    return True


@part
def exceeds(pattern, size, work):
    """True if the least singular value of the rows work.rows[1] exceeds `size`: their Gram matrix G less size^2 I is positive definite.

    Overwrites work.band.
    """
    fill_band(pattern, work.rows[1], work.rows[1], 0, work)
    return eliminate(work, True, size * size)


@part
def bound(pattern, work):
    """A lower bound of the least singular value of the rows work.rows[1]; 0 if their Gram matrix G is not positive definite.

    Overwrites work.band.
    """
    if not exceeds(pattern, 0.0, work):
        return 0.0
    m, k, inverse, trace = work.band.shape[0], work.band.shape[1] // 2, work.inverse, 0.0
    for i in range(m - 1, -1, -1):  # inverse[i, j - i] is (G^-1)_ij, j >= i
        last, pivot = min(m - 1, i + k), work.band[i, k]
        for j in range(last, i - 1, -1):
            value = 1.0 if j == i else 0.0
            for e in range(i + 1, last + 1):
                value -= work.band[i, e - i + k] * inverse[min(e, j), abs(e - j)]
            inverse[i, j - i] = value / pivot
        trace += inverse[i, 0]
    return 1.0 / np.sqrt(trace)


@part
def log_determinant(pattern, left, right, work):
    """log det of the products of unit rows `left` with rows `right`; -inf if elimination without pivoting has a pivot that is not positive."""
    k, total = work.band.shape[1] // 2, 0.0
    fill_band(pattern, left, right, k, work)
    if not eliminate(work, False, 0.0):
        return -np.inf
    for i in range(work.band.shape[0]):
        total += np.log(work.band[i, k])
    return total


@part
def same_side(pattern, work):
    """True if elimination without pivoting proves that the row space has not turned far since the reference state."""
    before, after = work.rows[0], work.rows[1]
    volumes = 0.5 * (log_determinant(pattern, before, before, work) + log_determinant(pattern, after, after, work))
    return log_determinant(pattern, before, after, work) - volumes >= np.log(REVERSED)


@part
def distance(pattern, work):
    """Bound of the spectral norm of the change D of the rows: the smaller of `|D|_F` and `(|D|_1 |D|_inf)^(1/2)`; nan if D is."""
    square = largest_row = largest_column = 0.0
    for i in range(pattern.start.shape[0] - 1):
        total = 0.0
        for e in range(pattern.start[i], pattern.start[i + 1]):
            change = abs(work.rows[1, e] - work.rows[0, e])
            square += change * change
            total += change
            work.row[pattern.columns[e]] += change
        largest_row = max(largest_row, total)
    for e in range(work.rows.shape[1]):
        largest_column = max(largest_column, work.row[pattern.columns[e]])
        work.row[pattern.columns[e]] = 0.0
    frobenius, product = np.sqrt(square), np.sqrt(largest_row * largest_column)
    return product if product < frobenius else frobenius


@part
def refer(times, qs, state, size, work):
    """Make a state, the one examined, the reference, with this bound of its least singular value."""
    work.least[0] = size
    put(1.0, work.rows[1], work.rows[0])
    for i in range(work.past.shape[1]):
        work.past[1, i] = work.past[0, i]
        work.past[0, i] = qs[state, i - 1] if i else times[state]


@entry
def begin(pattern, links, drives, times, qs, work):
    """Make the only one of the states the reference; return True if its rows are proven independent."""
    fill_rows(pattern, links, drives, times, 0, qs, work)
    refer(times, qs, 0, bound(pattern, work), work)
    return work.least[0] > CLOSE


@entry
def unproven(pattern, links, drives, times, qs, first, work):
    """Number of the first state, of those from `first` on, at which the rows of phi_q are not proven independent; count without one.

    times (count,), qs (count, n): the states. work: has the reference state; a proven state replaces it unless it is near.
    Factors alone show that the least singular value exceeds the reference's bound, and make the bound larger; the trace costs more.
    """
    for k in range(first, qs.shape[0]):
        fill_rows(pattern, links, drives, times, k, qs, work)
        way, size = distance(pattern, work), RISE * work.least[0]
        if way < SHARE * work.least[0]:
            continue
        if not (way < work.least[0] + size and exceeds(pattern, size, work)):
            size = bound(pattern, work)
            if not (size > CLOSE and (way < work.least[0] + size or same_side(pattern, work))):
                return k
        refer(times, qs, k, size, work)
    return qs.shape[0]


class UnitRows:
    """The proof along a run of a scene, or of a small model with compiled functions (`compiled`, a model.guarded.Compiled)."""

    def __init__(self, model, state, compiled=None):
        """Begin the proof at a state. compiled: C functions of a user's model; None for a scene."""
        self.model, self.compiled, m, n = model, compiled, model.m, model.n
        if compiled is None:
            self.pattern, k, slopes, self.sizes = model.once(pattern_of)
            self.links, points, self.turning = model.arrays.links, model.n_points, model.motor_profiles.tolist()
        else:
            self.sizes = coordinate_sizes(model, state.q)
            self.pattern, k, slopes, self.links, points = dense_pattern(model, self.sizes), m - 1, m * n, None, 0
            self.drives = np.array([compiled.addresses["phi_q"], compiled.data])
        shapes = (2, len(self.pattern.columns)), slopes, (points, 2), n, (m, 2 * k + 1), (m, k + 1), 1, (2, 1 + n)
        self.workspace = ProofWorkspace(*map(np.zeros, shapes))
        self.workspace.past[:] = state.t, *state.q

    def begin(self, state):
        """Make a state the reference; return True if its rows are proven independent."""
        times = np.array([state.t])
        return begin(self.pattern, self.links, self._drives(times), times, np.array([state.q]), self.workspace)

    def unproven(self, stretch):
        """Yield the numbers of the states of a stretch without proof. Before it continues, the caller must have shown that state to be regular."""
        times, qs, k = np.ascontiguousarray(stretch.t), np.ascontiguousarray(stretch.q), 0
        drives = self._drives(times)
        while (k := unproven(self.pattern, self.links, drives, times, qs, k, self.workspace)) < len(times):
            yield k
            self.begin(stretch.state(k))
            k += 1

    def before(self, t):
        """(t, q) of the last reference state before t, or of the first one."""
        past = self.workspace.past[int(not self.workspace.past[0, 0] < t)]
        return float(past[0]), past[1:].copy()

    def _drives(self, times):
        """The angles that turn rows, (times, profiles, 3), with zero derivatives: phi_z does not depend on them."""
        if self.links is None:
            return self.drives
        drives = np.zeros((len(times), len(self.model.profiles), 3))
        for k in self.turning:
            drives[:, k, 0] = self.model.profiles[k].over(times)
        return drives
