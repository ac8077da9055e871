"""Nested dissection of a nodal pattern, and the fronts of its multifrontal factor.

A set of nodes is halved across its longest axis; a minimum vertex cover of the edges that cross the cut separates the halves
(Koenig: it has as many nodes as a maximum matching has edges), and each half is divided in the same way (George 1973). A front is a
separator, or a set too small to divide, with the later nodes that its elimination couples.
"""

from typing import NamedTuple

import numpy as np

from polyida.jit import entry, pack, part

LEAF = 16  # nodes of a set that is not divided: more make a fuller factor, fewer make short loops


@pack
class Symbolic(NamedTuple):
    """The fronts of a pattern, children before parents. Places are positions in the order of elimination.

    order: (n,) coordinate -> place, n = 2 nodes; nodes: node at each nodal place; front f owns the nodal places
    first[f]:first[f + 1] and is coupled to rows[start[f]:start[f + 1]]; children: number of fronts whose updates it takes;
    panel: start of its part of the factor; size: coordinates of the largest front; depth: most entries of waiting updates.
    """

    order: np.ndarray
    nodes: np.ndarray
    first: np.ndarray
    start: np.ndarray
    rows: np.ndarray
    children: np.ndarray
    panel: np.ndarray
    indptr: np.ndarray
    indices: np.ndarray
    size: int
    depth: int


def symbolic_of(model):
    """The Symbolic of a scene's plates, the same for every factor of the model."""
    return symbolic(*model.pattern, model.reference[: len(model.pattern[0]) - 1])


def symbolic(indptr, indices, points):
    """Symbolic of a symmetric nodal pattern (CSR) with 2 x 2 blocks and nodes at points (nodes, 2)."""
    indptr, indices = (np.array(a, np.int32) for a in (indptr, indices))  # not read-only
    count = len(indptr) - 1
    nodes, fronts = np.arange(count, dtype=np.int32), np.empty((2 * count + 1, 3), np.int64)
    scratch = np.zeros(count, np.int8), np.empty(count), *np.empty((3, count), np.int32), *np.empty((2, count + 2), np.int64)
    n_fronts = dissect(indptr, indices, np.array(points, float).reshape(-1, 2), nodes, fronts, *scratch)
    fronts = fronts[:n_fronts][::-1]
    place = np.empty(count, np.int32)
    place[nodes] = np.arange(count, dtype=np.int32)
    order = np.stack([2 * place, 2 * place + 1], axis=1).ravel()
    first = np.append(fronts[:, 0], count).astype(np.int32)
    children = fronts[:, 2].astype(np.int32)
    start, rows, depth = _reached(indptr, indices, nodes, place, first, children)
    own, reach = 2 * np.diff(first).astype(np.int64), 2 * np.diff(start)
    wide, fours = own + reach, own // 4  # a panel has four rows of its front at a time, from their diagonal on
    panel = np.append(0, np.cumsum(4 * fours * wide - 8 * fours * (fours - 1) + (own % 4) * (wide - 4 * fours)))
    size = int(np.max(wide, initial=0))
    return Symbolic(order, nodes, first, start, rows, children, panel, indptr, indices, size, depth)


def _reached(indptr, indices, nodes, place, first, children):
    """(start, rows, depth) of `Symbolic`.

    rows of a front: the later places that couple to its own nodes or that are rows of its children; children (fronts,): how many
    each has; depth: most entries of updates that wait at a time.
    """
    count, begin = np.diff(indptr), np.append(0, np.cumsum(np.diff(indptr)[nodes]))
    joined = place[indices[np.argsort(np.repeat(place, count), kind="stable")]]  # neighbours of the node at each place
    reach, waiting, depth, deepest = [], [], 0, 0
    for low, high, n_children in zip(first[:-1], first[1:], children):
        taken, waiting = waiting[len(waiting) - n_children :], waiting[: len(waiting) - n_children]
        rows = np.unique(np.concatenate([joined[begin[low] : begin[high]], *taken]))
        rows = rows[np.searchsorted(rows, high) :]
        depth += _update_entries(rows) - sum(map(_update_entries, taken))
        deepest = max(deepest, depth)
        reach.append(rows)
        waiting.append(rows)
    start = np.append(0, np.cumsum([len(rows) for rows in reach], dtype=np.int64))
    return start, np.concatenate([np.zeros(0, np.int32), *reach]), deepest


def _update_entries(rows):
    """Number of entries of a packed upper triangle that couples the nodes `rows`, two unknowns each."""
    return len(rows) * (2 * len(rows) + 1)


@entry
def dissect(indptr, indices, points, nodes, fronts, side, distance, mate, came, queue, low_of, high_of):
    """Sort nodes (0, 1, 2 ...) in the order of elimination; fill fronts (:, 3) = first place, end, children; parents before children.

    The other arrays are scratch; side is 0. Returns the number of fronts.
    """
    count = nodes.shape[0]
    low_of[0], high_of[0], top, n_fronts = 0, count, min(count, 1), 0
    while top:
        top -= 1
        low, high = low_of[top], high_of[top]
        a = b = 0
        if high - low > LEAF:
            members = nodes[low:high]
            halve(indptr, indices, points, members, side, mate, queue, distance)
            cover_cut(indptr, indices, members, side, mate, came, queue)
            a, b = group(members, side, queue)
        fronts[n_fronts, 0], fronts[n_fronts, 1], fronts[n_fronts, 2] = low + a + b, high, (a > 0) + (b > 0)
        n_fronts += 1
        if a:
            low_of[top], high_of[top] = low, low + a
            top += 1
        if b:
            low_of[top], high_of[top] = low + a, low + a + b
            top += 1
    return n_fronts


@part
def halve(indptr, indices, points, members, side, distance, queue, values):
    """Set side to 1 and 2 on the halves of members, or on one connected component and the rest."""
    n = members.shape[0]
    c = values[:n]
    for i in members:
        side[i], distance[i] = 1, -1
    if hops(indptr, indices, members[0], side, distance, queue) < n:
        for k in range(n):
            c[k] = min(distance[members[k]], 0)
    else:
        along_axis(points, members, c)
    t = middle(c)
    for k in range(n):
        side[members[k]] = 1 if c[k] < t else 2


@part
def along_axis(points, members, coordinates):
    """coordinates = those of the nodes along the longest principal axis of members."""
    n, o = members.shape[0], members[0]
    x = y = xx = xy = yy = 0.0
    for i in members:
        p, q = points[i, 0] - points[o, 0], points[i, 1] - points[o, 1]
        x, y, xx, xy, yy = x + p, y + q, xx + p * p, xy + p * q, yy + q * q
    angle = 0.5 * np.arctan2(2.0 * (xy - x * y / n), (xx - x * x / n) - (yy - y * y / n))
    for k in range(n):
        coordinates[k] = np.cos(angle) * points[members[k], 0] + np.sin(angle) * points[members[k], 1]


@part
def hops(indptr, indices, root, side, distance, queue):
    """Fill distance (-1 before) with the number of edges from root on side 1; queue gets these nodes. Returns their number."""
    distance[root], queue[0] = 0, root
    head, tail = 0, 1
    while head < tail:
        i = queue[head]
        head += 1
        for p in range(indptr[i], indptr[i + 1]):
            j = indices[p]
            if distance[j] < 0 and side[j] == 1:
                distance[j] = distance[i] + 1
                queue[tail] = j
                tail += 1
    return tail


@part
def middle(coordinates):
    """A value with about half of the coordinates below it and some not below; if all are equal, they become 0, 1, 2 ... first."""
    n, low, high = coordinates.shape[0], np.inf, -np.inf
    for value in coordinates:
        low, high = min(low, value), max(high, value)
    if not low < high:
        low, high = 0.0, n - 1.0
        for k in range(n):
            coordinates[k] = k
    for _ in range(40):
        t, below = 0.5 * (low + high), 0
        for value in coordinates:
            below += value < t
        if abs(2 * below - n) <= 0.02 * n:
            return t
        low, high = (t, high) if 2 * below < n else (low, t)
    return high


@entry
def cover_cut(indptr, indices, members, side, mate, came, queue):
    """Set side to 3 on a minimum set of nodes that covers every edge between sides 1 and 2; mate, came, queue are scratch.

    The second round finds no path any more, but marks all nodes on alternating paths from unmatched nodes.
    """
    for i in members:
        mate[i] = -1
    for a in members:
        for p in range(indptr[a], indptr[a + 1] if side[a] == 1 else indptr[a]):
            b = indices[p]
            if side[b] == 2 and mate[b] < 0:
                mate[a], mate[b] = b, a
                break
    for _ in range(2):
        for i in members:
            came[i] = -1
        for i in members:
            if side[i] == 1 and mate[i] < 0:
                augment(indptr, indices, i, side, mate, came, queue)
    for i in members:
        if side[i] == 2 and came[i] >= 0:
            side[i] = 3
    for i in members:
        if side[i] == 1 and mate[i] >= 0 and side[mate[i]] != 3:
            side[i] = 3


@part
def augment(indptr, indices, root, side, mate, came, queue):
    """Match root along an alternating path; if there is none, came marks the visited nodes."""
    head, tail, end = 0, 1, -1
    queue[0] = root
    while head < tail and end < 0:
        a = queue[head]
        head += 1
        for p in range(indptr[a], indptr[a + 1]):
            b = indices[p]
            if side[b] == 2 and came[b] < 0:
                came[b] = a
                if mate[b] < 0:
                    end = b
                    break
                queue[tail] = mate[b]
                tail += 1
    if end < 0:
        return
    while end >= 0:
        a = came[end]
        before = mate[a]
        mate[a], mate[end] = end, a
        end = before
    for k in range(head):
        a = queue[k]
        for p in range(indptr[a], indptr[a + 1]):
            if side[indices[p]] == 2:
                came[indices[p]] = -1


@part
def group(members, side, copy):
    """Sort members by sides 1, 2, 3 and clear side. Returns the numbers on 1 and on 2."""
    n, at, a, ab = members.shape[0], 0, 0, 0
    for k in range(n):
        copy[k] = members[k]
    for number in range(1, 4):
        a, ab = ab, at
        for k in range(n):
            if side[copy[k]] == number:
                members[at] = copy[k]
                at += 1
    for i in members:
        side[i] = 0
    return a, ab - a
