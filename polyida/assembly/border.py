"""The systems by which joints act: unknowns at the points of bodies, coupled body by body, solved by one elimination along the graph.

An unknown x_j pulls at components of points, s = E x, its body answers with A dq = -G s, G one matrix a body, and each equation looks at
components of points: `(I_w + F G E) x = right`. Unknowns are the forces w on the active components (those of the coupling; I_w is the unit
matrix on them, and rows of F those of the curvature), lam of the rows of phi, and mu of their rates.

    E   of w: a unit; of lam: its row of Bz = phi_z; of mu: the same in a second layer of components
    F   of w: a row of C; of lam: its row of Bz; of mu: its row of Hz, and that of Bz in the second layer

In the second layer a body's matrix is ((G, H), (0, -A A^T)). Every number of E and F has a slot: Bz, then 1, C, and Hz. In the transposed
system Hz belongs to E, and the second layer comes first: ((-A A^T, H^T), (0, G)).
"""

from typing import NamedTuple

import numpy as np

from polyida.assembly.arrays import starts
from polyida.jit import pack, part
from polyida.linear.dense import magnitude, put, solve_small
from polyida.linear.elimination import Elimination, eliminate, elimination, expand, positions, solve
from polyida.validation import on_pairs

ACCURATE = (
    1e-10  # of the sum of an equation's terms: 1e-13 is what elimination leaves of 200 windows of a ladder, more where pivots are too small
)


@pack
class Border(NamedTuple):
    """The pattern. active: components of points with an unknown w. points: those of each body, from `point_start` on; block: where the
    body's matrix begins, square, `layers` times 2 components a point wide.

    rows, columns: the unknowns of the body's part of F and E from `row_start`, `column_start` on, and of each its components within the body
    and slots, `*_entry` on; single: how many columns begin the body's part that are of the first layer alone. into: where the values of each
    row and column are, from `into_start` on.
    """

    elimination: Elimination
    active: np.ndarray
    layers: int
    point_start: np.ndarray
    points: np.ndarray
    block: np.ndarray
    row_start: np.ndarray
    rows: np.ndarray
    row_entry: np.ndarray
    row_component: np.ndarray
    row_slot: np.ndarray
    column_start: np.ndarray
    columns: np.ndarray
    column_entry: np.ndarray
    column_component: np.ndarray
    column_slot: np.ndarray
    single: np.ndarray
    into_start: np.ndarray
    into: np.ndarray


@pack
class BorderWorkspace(NamedTuple):
    """Numbers of a Border, float or complex: slots of E and F, the bodies' matrices, values of the elimination, right-hand side, unknowns;
    scratch, vectors (3, .) and answers of a body, and of equations their left-hand sides and the sums of their terms. slopes, curvature, rates:
    views of the slots of Bz, C and Hz.
    """

    slots: np.ndarray
    slopes: np.ndarray
    curvature: np.ndarray
    rates: np.ndarray
    blocks: np.ndarray
    values: np.ndarray
    right: np.ndarray
    x: np.ndarray
    vectors: np.ndarray
    answers: np.ndarray
    left: np.ndarray
    terms: np.ndarray


def border(model, active=True, rows=True, rates=False, transposed=False):
    """The Border of a scene with unknowns w, lam and mu, or without; transposed: that of the backward sweep, with rates."""
    s, bodies = model.arrays.links, body_of_points(model)
    number, local = np.unique(bodies, return_inverse=True)[1], np.zeros(len(bodies), np.int64)
    points = [np.flatnonzero(number == body) for body in range(number.max(initial=-1) + 1)]
    for group in points:
        local[group] = np.arange(len(group))
    layers, wide = 1 + rates, [2 * len(group) for group in points]
    coupled = np.diff(s.coupling.start) > 0  # points on which a mass, the curvature of a row or a force element can act
    components = np.flatnonzero(np.repeat(coupled & active, 2))
    m, first, slots = len(s.row_constant) if rows else 0, len(components), len(s.row_columns)
    pulls, looks = ([{} for _ in points] for _ in range(2))

    def note(table, unknown, component, slot, layer=0):
        body = number[component // 2]
        place = 2 * local[component // 2] + component % 2 + (layer != transposed) * wide[body]
        table[body].setdefault(unknown, []).append((place, slot))

    for unknown, component in enumerate(components.tolist()):
        point, axis = divmod(component, 2)
        note(pulls, unknown, component, slots)
        for block in range(s.coupling.start[point], s.coupling.start[point + 1]):
            for other in range(2):
                note(looks, unknown, 2 * s.coupling.columns[block] + other, slots + 1 + 4 * block + 2 * axis + other)
    turning = np.zeros(len(s.row_columns), bool)  # entries of phi_z that vary with q and t
    for row, *vectors in zip(s.product_row, s.product_first, s.product_second):
        of_row = np.arange(s.row_start[row], s.row_start[row + 1])
        for i in vectors:
            turning[of_row[np.isin(s.row_columns[of_row] // 2, s.vector_points[s.vector_start[i] : s.vector_start[i + 1]])]] = True
    behind = slots + 1 + 4 * len(s.coupling.columns)
    entries = [(k, e) for k in range(m) for e in range(s.row_start[k], s.row_start[k + 1])]
    for layer in range(layers):
        for k, e in entries:
            unknown, component = first + layer * m + k, s.row_columns[e]
            if s.row_slopes[e] != 0 or turning[e]:
                note(pulls, unknown, component, e, layer)
                note(looks, unknown, component, e, layer)
            if layer and turning[e]:
                note(pulls if transposed else looks, unknown, component, behind + e)
    groups = [sorted({*pull, *look}) for pull, look in zip(pulls, looks)]
    order = elimination(first + layers * m, groups)
    into = [_grid(order, list(look), list(pull)) for pull, look in zip(pulls, looks)]
    return Border(
        order,
        components,
        layers,
        starts(points),
        np.concatenate([*points, np.zeros(0, np.int64)]).astype(np.int64),
        np.concatenate([[0], np.cumsum([(layers * size) ** 2 for size in wide])]).astype(np.int64),
        *_listed(looks),
        *_listed(pulls),
        np.array([0 if transposed else sum(unknown < first + m for unknown in pull) for pull in pulls], np.int64),
        starts(into),
        np.concatenate([*into, np.zeros(0, np.int64)]).astype(np.int64),
    )


def _grid(order, rows, columns):
    """Where the values of all pairs of rows and columns are."""
    if not rows or not columns:
        return np.zeros(0, np.int64)
    rows, columns = np.meshgrid(rows, columns, indexing="ij")
    return positions(order, rows.ravel(), columns.ravel())


def _listed(tables):
    """Unknowns, components and slots of bodies' tables, each with its starts."""
    each = [entries for table in tables for entries in table.values()]
    flat = np.array([entry for entries in each for entry in entries], np.int64).reshape(-1, 2)
    unknowns = np.array([unknown for table in tables for unknown in table], np.int64)
    return starts(tables), unknowns, starts(each), flat[:, 0].copy(), flat[:, 1].copy()


def body_of_points(model):
    """The number of the body that each point is on."""
    s = model.arrays.links
    return np.searchsorted(model.first_pairs, s.point_nodes[s.point_ptr[:-1]], side="right") - 1


def border_workspace(model, pattern, dtype=float):
    """Numbers of a Border."""
    s, count = model.arrays.links, len(pattern.elimination.diagonal)
    first, blocks = len(s.row_columns) + 1, 4 * len(s.coupling.columns)
    slots = np.zeros(first + blocks + len(s.row_columns), dtype)
    slots[first - 1] = 1.0
    wide, columns = (int(np.diff(each).max(initial=0)) for each in (2 * pattern.layers * pattern.point_start, pattern.column_start))
    return BorderWorkspace(
        slots,
        slots[: first - 1],
        slots[first : first + blocks].reshape(-1, 2, 2),
        slots[first + blocks :],
        np.zeros(pattern.block[-1], dtype),
        np.zeros(pattern.elimination.start[-1], dtype),
        np.zeros(count, dtype),
        np.zeros(count, dtype),
        np.zeros((3, max(wide, columns)), dtype),
        np.zeros((wide, columns), dtype),
        np.zeros(count, dtype),
        np.zeros(count),
    )


def body_blocks(pattern, left, right):
    """left right (points, points), complex and sparse, as it acts on pairs, body by body."""
    groups = np.split(pattern.points, pattern.point_start[1:-1])
    blocks = [on_pairs((left[group] @ right[:, group]).toarray()).ravel() for group in groups if len(group)]
    return np.concatenate([*blocks, np.zeros(0)])


@part
def look(b, w, moved, behind):
    """right = F moved, moved (points, 2) the values of the components that come first, behind of the others, or (0, 2) if these are zero."""
    for u in range(w.right.shape[0]):
        w.right[u] = 0.0
    for n in range(b.block.shape[0] - 1):
        layer = width(b, n) // b.layers
        for r in range(b.row_start[n], b.row_start[n + 1]):
            for e in range(b.row_entry[r], b.row_entry[r + 1]):
                at = b.row_component[e]
                if at < layer:
                    w.right[b.rows[r]] += w.slots[b.row_slot[e]] * moved[b.points[b.point_start[n] + at // 2], at % 2]
                elif behind.shape[0]:
                    at -= layer
                    w.right[b.rows[r]] += w.slots[b.row_slot[e]] * behind[b.points[b.point_start[n] + at // 2], at % 2]


@part
def solve_border(b, w):
    """w.x from w.right, slots and blocks. False where the system is singular."""
    assemble(b, w)
    if eliminate(b.elimination, w.values, w.x):
        solve(b.elimination, w.values, w.right, w.x)
        if is_accurate(b, w):
            return True
    return solve_pivoted(b, w)


@part
def solve_border_again(b, w):
    """The same for another right-hand side; the elimination was accurate for the one before."""
    solve(b.elimination, w.values, w.right, w.x)
    total = 0.0
    for u in range(w.x.shape[0]):
        total += magnitude(w.x[u])
    return total < np.inf or solve_pivoted(b, w)


@part
def assemble(b, w):
    """w.values = I_w + F G E."""
    w.values[:] = 0.0
    row = w.vectors[0]
    for n in range(b.block.shape[0] - 1):
        first, count = b.column_start[n], b.column_start[n + 1] - b.column_start[n]
        layer = width(b, n) // b.layers
        answer(b, w, n, first, count)
        for r in range(b.row_start[n], b.row_start[n + 1]):
            for j in range(count):
                row[j] = 0.0
            for e in range(b.row_entry[r], b.row_entry[r + 1]):
                value, at = w.slots[b.row_slot[e]], b.row_component[e]
                for j in range(0 if at < layer else b.single[n], count):
                    row[j] += value * w.answers[at, j]
            at = b.into_start[n] + (r - b.row_start[n]) * count
            for j in range(count):
                w.values[b.into[at + j]] += row[j]
    for i in range(b.active.shape[0]):
        w.values[b.elimination.diagonal[i]] += 1.0


@part
def width(b, n):
    """Of the matrix of body n."""
    return 2 * b.layers * (b.point_start[n + 1] - b.point_start[n])


@part
def answer(b, w, n, first, count):
    """w.answers = G E of body n, by components and columns; nothing where a column of the first layer meets the second one."""
    wide = width(b, n)
    for p in range(wide):
        line = b.block[n] + p * wide
        for j in range(0 if p < wide // b.layers else b.single[n], count):
            total = 0.0
            for e in range(b.column_entry[first + j], b.column_entry[first + j + 1]):
                total += w.blocks[line + b.column_component[e]] * w.slots[b.column_slot[e]]
            w.answers[p, j] = total


@part
def is_accurate(b, w):
    """Whether w.x solves the system to round-off, body by body; nan is not."""
    for u in range(w.x.shape[0]):
        w.left[u], w.terms[u] = 0.0, magnitude(w.right[u])
    for i in range(b.active.shape[0]):
        w.left[i] = w.x[i]
        w.terms[i] += magnitude(w.x[i])
    for n in range(b.block.shape[0] - 1):
        wide, pull, moved, size = width(b, n), w.vectors[0], w.vectors[1], w.vectors[2]
        for p in range(wide):
            pull[p], moved[p], size[p] = 0.0, 0.0, 0.0
        for c in range(b.column_start[n], b.column_start[n + 1]):
            for e in range(b.column_entry[c], b.column_entry[c + 1]):
                pull[b.column_component[e]] += w.slots[b.column_slot[e]] * w.x[b.columns[c]]
        for p in range(wide):
            for q in range(0 if p < wide // b.layers else wide // b.layers, wide):
                value = w.blocks[b.block[n] + p * wide + q] * pull[q]
                moved[p] += value
                size[p] += magnitude(value)
        for r in range(b.row_start[n], b.row_start[n + 1]):
            u = b.rows[r]
            for e in range(b.row_entry[r], b.row_entry[r + 1]):
                w.left[u] += w.slots[b.row_slot[e]] * moved[b.row_component[e]]
                w.terms[u] += magnitude(w.slots[b.row_slot[e]] * size[b.row_component[e]])
    good = True
    for u in range(w.x.shape[0]):
        good = good and magnitude(w.right[u] - w.left[u]) <= ACCURATE * w.terms[u]
    return good


@part
def solve_pivoted(b, w):
    """The same by a dense elimination with pivoting. False where the system is singular."""
    count = w.x.shape[0]
    assemble(b, w)
    matrix = np.empty((count, count), w.x.dtype)
    expand(b.elimination, w.values, matrix)
    put(1.0, w.right, w.x)
    w.values[:] = np.nan  # no factors are there for another right-hand side
    return solve_small(matrix, w.x)
