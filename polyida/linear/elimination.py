"""Elimination along a graph: sparse systems of one pattern, real or complex, whose order is found once and whose numbers change often.

The pattern is given by groups of unknowns that are all coupled to each other, like the bodies of a mechanism. Unknowns of the same groups
are eliminated together, those with the fewest neighbours first (minimum degree). Each elimination works on a small dense matrix, its front:
the eliminated unknowns, then their neighbours. Its Schur complement is added to the front of the next neighbour (Duff and Reid 1983). There
is no pivoting: a pivot that is small relative to the diagonal ends the elimination.
"""

import heapq
from typing import NamedTuple

import numpy as np

from polyida.jit import entry, pack
from polyida.linear.dense import magnitude, put

SMALL = 1e-10  # of a diagonal entry: a smaller pivot has lost most of its digits


@pack
class Elimination(NamedTuple):
    """The fronts in their order: number of eliminated unknowns, size, start of its square matrix in the values, first entry in `unknowns`, and
    parent, -1 without one.

    unknowns: of all fronts, the eliminated ones first. into: the place of each in the parent's front, after the eliminated ones. diagonal:
    the place of each unknown's diagonal entry in the values.
    """

    pivots: np.ndarray
    size: np.ndarray
    start: np.ndarray
    first: np.ndarray
    parent: np.ndarray
    unknowns: np.ndarray
    into: np.ndarray
    diagonal: np.ndarray


def elimination(count, groups):
    """The Elimination of `count` unknowns that are coupled within groups, sequences of their numbers."""
    fronts = _merged(_fronts(_supervariables(count, groups)))
    pivots, size = (np.array([len(part) for part in parts], np.int64) for parts in (zip(*fronts) if fronts else ((), ())))
    size = size + pivots
    start, first = (np.concatenate([[0], np.cumsum(numbers)]).astype(np.int64) for numbers in (size * size, size))
    unknowns = np.array([u for front in fronts for part in front for u in part], np.int64)
    result = Elimination(pivots, size, start, first, -np.ones_like(pivots), unknowns, np.zeros_like(unknowns), np.zeros(count, np.int64))
    front, place = _own(result)
    result.diagonal[:] = start[front] + place * (size[front] + 1)
    for f, (_, border) in enumerate(fronts):
        if border:
            result.parent[f] = front[border].min()
            result.into[first[f] + pivots[f] : first[f + 1]] = _places(result, np.full(len(border), result.parent[f]), np.array(border))
    return result


def positions(e, rows, columns):
    """Places in the values of the entries (rows, columns), arrays of unknowns that share a group."""
    front, _ = _own(e)
    of = np.minimum(front[rows], front[columns])
    return e.start[of] + _places(e, of, rows) * e.size[of] + _places(e, of, columns)


def _supervariables(count, groups):
    """[(unknowns, their groups)]: unknowns of the same groups together, each unknown once."""
    of = [[] for _ in range(count)]
    for number, group in enumerate(groups):
        for unknown in group:
            of[unknown].append(number)
    same_groups = {}
    for unknown, numbers in enumerate(of):
        same_groups.setdefault(tuple(numbers) or ("alone", unknown), []).append(unknown)
    return [(unknowns, set(numbers)) for numbers, unknowns in same_groups.items()]


def _fronts(supervariables):
    """[(unknowns eliminated, their neighbours)] in the order of least degree, neighbours in the order in which they are eliminated."""
    members, groups = [unknowns for unknowns, _ in supervariables], {}
    for number, (_, of) in enumerate(supervariables):
        for group in of:
            groups.setdefault(group, set()).add(number)
    of = [set(numbers) for _, numbers in supervariables]

    def degree(number):
        """Number of unknowns that share a group with a supervariable, its own ones included."""
        return sum(len(members[other]) for other in set().union(*(groups[group] for group in of[number])))

    waiting, order, borders = [(degree(number), number) for number in range(len(supervariables))], {}, []
    heapq.heapify(waiting)
    known = {number: size for size, number in waiting}
    while waiting:
        size, number = heapq.heappop(waiting)
        if number in order or size != known[number]:
            continue
        order[number] = len(order)
        gone, border = of[number], set().union(*(groups[group] for group in of[number])) - {number}
        for group in gone:
            del groups[group]
        borders.append((number, border))
        groups[name := ("made", number)] = border
        for other in border:
            of[other] = (of[other] - gone) | {name}
        for other in border:
            known[other] = degree(other)
            heapq.heappush(waiting, (known[other], other))
    return [(list(members[number]), [u for other in sorted(border, key=order.get) for u in members[other]]) for number, border in borders]


def _merged(fronts):
    """The fronts, each merged into its parent if all unknowns of the parent are its neighbours."""
    front_of, gone = {u: f for f, (own, _) in enumerate(fronts) for u in own}, {}
    for f, (own, border) in enumerate(fronts):
        if border:
            parent = front_of[border[0]]
            if len(border) == sum(map(len, fronts[parent])):
                fronts[parent] = (own + fronts[parent][0], fronts[parent][1])
                gone[f] = parent
                for u in own:
                    front_of[u] = parent
    return [front for f, front in enumerate(fronts) if f not in gone]


def _own(e):
    """The front in which each unknown is eliminated, and its place there."""
    front, place = np.zeros((2, len(e.diagonal)), np.int64)
    for f, (at, pivots) in enumerate(zip(e.first[:-1], e.pivots)):
        front[e.unknowns[at : at + pivots]], place[e.unknowns[at : at + pivots]] = f, np.arange(pivots)
    return front, place


def _places(e, fronts, unknowns):
    """The place (k,) of unknown number unknowns[i] among the unknowns of front number fronts[i], both (k,); it must be there.

    e: the pattern of the elimination.
    """
    count = len(e.diagonal)
    keys = np.repeat(np.arange(len(e.size)), e.size) * count + e.unknowns
    order = np.argsort(keys)
    at = order[np.searchsorted(keys, fronts * count + unknowns, sorter=order)]
    return at - e.first[fronts]


@entry
def eliminate(pattern, values, sizes):
    """Turn `values` into factors; `sizes` is scratch for a number of each unknown. False if a pivot is too small."""
    for u in range(sizes.shape[0]):
        sizes[u] = values[pattern.diagonal[u]]
    for f in range(pattern.size.shape[0]):
        n, at = pattern.size[f], pattern.start[f]
        for k in range(pattern.pivots[f]):
            top = at + k * n
            pivot = values[top + k]
            if not magnitude(pivot) > SMALL * magnitude(sizes[pattern.unknowns[pattern.first[f] + k]]):
                return False
            pivot = 1.0 / pivot
            values[top + k] = pivot
            for i in range(k + 1, n):
                row = at + i * n
                if values[row + k] != 0.0:
                    factor = values[row + k] * pivot
                    values[row + k] = factor
                    for j in range(k + 1, n):
                        values[row + j] -= factor * values[top + j]
        if pattern.parent[f] >= 0:  # add the Schur complement to the parent
            above, first, last = pattern.start[pattern.parent[f]], pattern.first[f], pattern.size[pattern.parent[f]]
            for i in range(pattern.pivots[f], n):
                row, to = at + i * n, above + pattern.into[first + i] * last
                for j in range(pattern.pivots[f], n):
                    values[to + pattern.into[first + j]] += values[row + j]
    return True


@entry
def solve(pattern, values, right, solution):
    """Fill the solution for a right-hand side, with the factors of `eliminate` in `values`."""
    put(1.0, right, solution)
    for f in range(pattern.size.shape[0]):
        n, at, first = pattern.size[f], pattern.start[f], pattern.first[f]
        for i in range(1, n):
            total = solution[pattern.unknowns[first + i]]
            for k in range(min(i, pattern.pivots[f])):
                total -= values[at + i * n + k] * solution[pattern.unknowns[first + k]]
            solution[pattern.unknowns[first + i]] = total
    for f in range(pattern.size.shape[0] - 1, -1, -1):
        n, at, first = pattern.size[f], pattern.start[f], pattern.first[f]
        for k in range(pattern.pivots[f] - 1, -1, -1):
            total = solution[pattern.unknowns[first + k]]
            for j in range(k + 1, n):
                total -= values[at + k * n + j] * solution[pattern.unknowns[first + j]]
            solution[pattern.unknowns[first + k]] = total * values[at + k * n + k]


@entry
def expand(pattern, values, matrix):
    """Fill the dense matrix of the system that `values` holds."""
    matrix[:] = 0.0
    for f in range(pattern.size.shape[0]):
        n, at, first = pattern.size[f], pattern.start[f], pattern.first[f]
        for i in range(n):
            for j in range(n):
                if i < pattern.pivots[f] or j < pattern.pivots[f]:
                    matrix[pattern.unknowns[first + i], pattern.unknowns[first + j]] = values[at + i * n + j]
