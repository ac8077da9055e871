"""Multifrontal factor `S = U^T D U` of a symmetric nodal block matrix: eliminated in double precision, stored and solved in single.

Each front is a small dense matrix (Duff & Reid 1983): blocks and the children's updates are added, its own nodes are eliminated, rows of U,
whose diagonal is 1, are stored in the panel, and the Schur complement is passed to the parent. A panel holds four rows of U at a time, from their diagonal
block on, with the reciprocal of D on the diagonal: a solve runs through it once forward, once backward. There is no pivoting: S need not be
positive definite, but a pivot that is zero ends the elimination.
"""

from functools import partial

import numpy as np

from polyida import jit
from polyida.linear.lu import SingularSystem

entry = partial(jit.entry, fastmath=jit.FAST)
part = partial(jit.part, fastmath=jit.FAST)
shared = partial(jit.shared, fastmath=jit.FAST)


def factorize(symbolic, blocks, dtype=None, panels=None):
    """Panels, float32 or complex64, of the factor of blocks (nnz, 2, 2) on symbolic's pattern. Raises SingularSystem.

    Complex blocks are symmetric, not Hermitian, and so is their factor. Of each pair of blocks only the one in the row of the node that is
    eliminated first is read. dtype: that of the panels, single precision by default; panels: those to fill.
    """
    blocks = np.ascontiguousarray(blocks, np.result_type(blocks, float))
    panels = np.empty(symbolic.panel[-1], dtype or single(blocks)) if panels is None else panels
    numbers = np.empty(symbolic.size**2 + symbolic.depth, blocks.dtype)
    places = np.empty(len(symbolic.nodes) + len(symbolic.children), np.int32)
    if not fill_panels(symbolic, blocks, panels, numbers, places):
        raise SingularSystem("the tangent is singular or not finite")
    return panels


def single(values):
    """The dtype of single precision, float32 or complex64, for values of double."""
    return np.complex64 if np.iscomplexobj(values) else np.float32


@shared
def fill_panels(fronts, blocks, panels, numbers, places):
    """Eliminate front after front; numbers, places are scratch. False if a pivot is zero or not finite."""
    workspace, updates = numbers[: fronts.size * fronts.size], numbers[fronts.size * fronts.size :]
    local, waiting = places[: fronts.nodes.shape[0]], places[fronts.nodes.shape[0] :]
    top = behind = 0
    for f in range(fronts.children.shape[0]):
        first, last, rows = fronts.first[f], fronts.first[f + 1], fronts.rows[fronts.start[f] : fronts.start[f + 1]]
        own = 2 * (last - first)
        n = own + 2 * rows.shape[0]
        front = workspace[: n * n].reshape((n, n))
        for i in range(n):
            for j in range(i - i % 2, n):
                front[i, j] = 0.0
        for k in range(first, last):
            local[k] = 2 * (k - first)
        for k in range(rows.shape[0]):
            local[rows[k]] = own + 2 * k
        add_blocks(fronts, blocks, first, last, local, front)
        for _ in range(fronts.children[f]):
            behind -= 1
            c = waiting[behind]
            reach = fronts.rows[fronts.start[c] : fronts.start[c + 1]]
            top -= reach.shape[0] * (2 * reach.shape[0] + 1)
            add_update(updates[top:], reach, local, front)
        if not eliminate(front, own):
            return False
        store_rows(front, own, panels[fronts.panel[f] : fronts.panel[f + 1]])
        top += store_update(front, own, updates[top:])
        waiting[behind] = f
        behind += 1
    return True


@part
def add_blocks(fronts, blocks, first, last, local, front):
    """Add the blocks of the front's own nodes with themselves and later ones."""
    for k in range(first, last):
        i = fronts.nodes[k]
        a = local[k]
        for p in range(fronts.indptr[i], fronts.indptr[i + 1]):
            j = fronts.order[2 * fronts.indices[p]] // 2
            if j >= k:
                b = local[j]
                front[a, b] += blocks[p, 0, 0]
                front[a, b + 1] += blocks[p, 0, 1]
                front[a + 1, b] += blocks[p, 1, 0]
                front[a + 1, b + 1] += blocks[p, 1, 1]


@part
def add_update(update, reach, local, front):
    """Add a child's update, packed upper triangle by rows."""
    q = 0
    for i in range(reach.shape[0]):
        a = local[reach[i]]
        row, next_row = front[a], front[a + 1]
        for j in range(i, reach.shape[0]):
            b = local[reach[j]]
            row[b] += update[q]
            row[b + 1] += update[q + 1]
            q += 2
        next_row[a + 1] += update[q]
        q += 1
        for j in range(i + 1, reach.shape[0]):
            b = local[reach[j]]
            next_row[b] += update[q]
            next_row[b + 1] += update[q + 1]
            q += 2


@part
def eliminate(front, own):
    """Eliminate the first `own` rows of `front` in place: they become rows of U with D on the diagonal, the rest of the upper triangle the
    Schur complement. False if a pivot is zero or not finite."""
    for i in range(0, front.shape[0], 2):
        top = min(i, own)
        for k in range(0, top - 3, 4):
            subtract_four(front, k, i)
        if top % 4:
            subtract_two(front, top - 2, i)
        if i < own and not finish(front, i):
            return False
    return True


@part
def subtract_four(front, top, row):
    """Take rows top .. top + 3 of U from rows row and row + 1, of a node: eight products for six loads keep the processor busy."""
    x, y = front[row, row:], front[row + 1, row:]
    a, b, c, d = front[top, row:], front[top + 1, row:], front[top + 2, row:], front[top + 3, row:]
    da, db, dc, dd = (front[top, top], front[top + 1, top + 1], front[top + 2, top + 2], front[top + 3, top + 3])
    xa, xb, xc, xd = da * a[0], db * b[0], dc * c[0], dd * d[0]
    ya, yb, yc, yd = da * a[1], db * b[1], dc * c[1], dd * d[1]
    for j in range(x.shape[0]):
        p, q, r, s = a[j], b[j], c[j], d[j]
        x[j] -= xa * p + xb * q + xc * r + xd * s
        y[j] -= ya * p + yb * q + yc * r + yd * s


@part
def subtract_two(front, top, row):
    """Take rows top and top + 1 of U from rows row and row + 1, of a node."""
    x, y, a, b = front[row, row:], front[row + 1, row:], front[top, row:], front[top + 1, row:]
    da, db = front[top, top], front[top + 1, top + 1]
    xa, xb, ya, yb = da * a[0], db * b[0], da * a[1], db * b[1]
    for j in range(x.shape[0]):
        p, q = a[j], b[j]
        x[j] -= xa * p + xb * q
        y[j] -= ya * p + yb * q


@part
def finish(front, row):
    """Turn rows row and row + 1 of front, in place, into rows of U with D on the diagonal; False if a pivot is zero or not finite.

    Both rows are of one node. All rows above them must have been subtracted. Only the upper triangle is read and written.
    """
    x, y = front[row, row:], front[row + 1, row:]
    if not 0.0 < abs(x[0]) < np.inf:
        return False
    share, scale = x[1], 1.0 / x[0]
    for j in range(1, x.shape[0]):
        x[j] *= scale
    for j in range(1, x.shape[0]):
        y[j] -= share * x[j]
    if not 0.0 < abs(y[1]) < np.inf:
        return False
    scale = 1.0 / y[1]
    for j in range(2, y.shape[0]):
        y[j] *= scale
    return True


@part
def store_rows(front, own, panel):
    """Copy the rows of U to the panel, four (at last two) at a time, with reciprocal diagonal."""
    n, at = front.shape[0], 0
    for k in range(0, own, 4):
        for i in range(k, min(k + 4, own)):
            row, stored = front[i, i:], panel[at + i - k : at + n - k]
            for j in range(row.shape[0]):
                stored[j] = row[j]
            stored[0] = 1.0 / row[0]
            at += n - k


@part
def store_update(front, own, updates):
    """Copy the Schur complement to updates, packed upper triangle by rows. Returns its entries."""
    at = 0
    for i in range(own, front.shape[0]):
        row = front[i, i:]
        for j in range(row.shape[0]):
            updates[at + j] = row[j]
        at += row.shape[0]
    return at


@entry
def solve_fronts(fronts, panels, vector):
    """vector <- S^-1 vector in float32 or complex64, (n,) or longer, in the places of fronts.order. Fronts on which it is zero cost nothing."""
    work = np.empty(fronts.size, vector.dtype)
    for f in range(fronts.children.shape[0]):
        if descend(fronts, panels, vector, work, f):
            spread(fronts, vector, work, f)
    for f in range(fronts.children.shape[0] - 1, -1, -1):
        ascend(fronts, panels, vector, work, f)


@part
def descend(fronts, panels, vector, work, front):
    """The forward half of a solve on a front: its part in vector, that of later fronts in work. False if vector is zero there; work is not filled."""
    at, own = 2 * fronts.first[front], 2 * (fronts.first[front + 1] - fronts.first[front])
    low, high = fronts.start[front], fronts.start[front + 1]
    n = own + 2 * (high - low)
    if zero(vector, at, own):
        return False
    for k in range(own):
        work[k] = vector[at + k]
    for k in range(own, n):
        work[k] = 0.0
    forward(panels, fronts.panel[front], work, own, n)
    for k in range(own):
        vector[at + k] = work[k]
    return True


@part
def spread(fronts, vector, work, front):
    """Add the part of later fronts in work, from a front, to vector."""
    own, low = 2 * (fronts.first[front + 1] - fronts.first[front]), fronts.start[front]
    for k in range(low, fronts.start[front + 1]):
        i, q = 2 * fronts.rows[k], own + 2 * (k - low)
        vector[i] += work[q]
        vector[i + 1] += work[q + 1]


@part
def ascend(fronts, panels, vector, work, front):
    """The backward half of a solve on a front."""
    at, own = 2 * fronts.first[front], 2 * (fronts.first[front + 1] - fronts.first[front])
    low, high = fronts.start[front], fronts.start[front + 1]
    n = own + 2 * (high - low)
    for k in range(own):
        work[k] = vector[at + k]
    for k in range(low, high):
        i, q = 2 * fronts.rows[k], own + 2 * (k - low)
        work[q], work[q + 1] = vector[i], vector[i + 1]
    if not zero(work, 0, n):
        backward(panels, fronts.panel[front + 1], work, own, n)
        for k in range(own):
            vector[at + k] = work[k]


@part
def zero(values, at, count):
    """True if `count` values from `at` on are zero; it mostly ends at the first."""
    for k in range(at, at + count):  # noqa: SIM110, compiled code has no `all`
        if values[k] != 0.0:
            return False
    return True


@part
def forward(panels, at, work, own, size):
    """work <- U^-T work on the front's own places, and less their part on the others, `size` in all; the panel starts at `at`."""
    for k in range(0, own - 3, 4):
        m = size - k
        a, b = panels[at : at + m], panels[at + m : at + 2 * m]
        c, d = panels[at + 2 * m : at + 3 * m], panels[at + 3 * m : at + 4 * m]
        p = work[k]
        q = work[k + 1] - a[1] * p
        r = work[k + 2] - a[2] * p - b[2] * q
        s = work[k + 3] - a[3] * p - b[3] * q - c[3] * r
        work[k + 1], work[k + 2], work[k + 3] = q, r, s
        v, a, b, c, d = work[k + 4 :], a[4:], b[4:], c[4:], d[4:]
        for j in range(m - 4):
            v[j] -= a[j] * p + b[j] * q + c[j] * r + d[j] * s
        at += 4 * m
    if own % 4:
        m = size - own + 2
        a, b = panels[at : at + m], panels[at + m : at + 2 * m]
        p = work[own - 2]
        q = work[own - 1] - a[1] * p
        work[own - 1] = q
        v, a, b = work[own:], a[2:], b[2:]
        for j in range(m - 2):
            v[j] -= a[j] * p + b[j] * q


@part
def backward(panels, at, work, own, size):
    """work <- U^-1 D^-1 work on the front's own places, the others of `size` given; its panel ends at `at`."""
    if own % 4:
        m = size - own + 2
        at -= 2 * m
        a, b, v = panels[at : at + m], panels[at + m : at + 2 * m], work[own:]
        p, q, e, f = work[own - 2] * a[0], work[own - 1] * b[1], a[2:], b[2:]
        for j in range(m - 2):
            p -= e[j] * v[j]
            q -= f[j] * v[j]
        work[own - 2], work[own - 1] = p - a[1] * q, q
    for k in range(own // 4 * 4 - 4, -1, -4):
        m = size - k
        at -= 4 * m
        a, b = panels[at : at + m], panels[at + m : at + 2 * m]
        c, d = panels[at + 2 * m : at + 3 * m], panels[at + 3 * m : at + 4 * m]
        e, f, g, h, v = a[4:], b[4:], c[4:], d[4:], work[k + 4 :]
        p, q, r, s = work[k] * a[0], work[k + 1] * b[1], work[k + 2] * c[2], work[k + 3] * d[3]
        for j in range(m - 4):
            value = v[j]
            p -= e[j] * value
            q -= f[j] * value
            r -= g[j] * value
            s -= h[j] * value
        r -= c[3] * s
        q -= b[2] * r + b[3] * s
        p -= a[1] * q + a[2] * r + a[3] * s
        work[k], work[k + 1], work[k + 2], work[k + 3] = p, q, r, s
