"""Sparse solution of the constraint systems of scenes: unknown forces at points of the bodies.

The unknowns x are multipliers and forces on components of points. They cause the forces E x. Each body has a compliance matrix G and moves by
-G E x at its points. The equations measure these displacements by F: `(I_w + F G E) x = right`. The elimination follows the graph of the bodies.

| unknown | column of E | row of F |
|---|---|---|
| w, forces on active components | a unit vector | a row of C, the curvature of the rows of phi and the slopes of force elements |
| lam, multipliers of phi | a row of Bz = phi_z, and the slope of friction that it presses | the same row of Bz |

I_w is the unit matrix on w. All numbers of E and F are in one array: Bz, 1, C, slopes of friction. Their indices are called slots.
"""

from typing import NamedTuple

import numpy as np

from polyida.assembly.arrays import concatenated, starts
from polyida.jit import pack, part, shared
from polyida.linear.dense import magnitude, put, solve_small, zero
from polyida.linear.elimination import Elimination, eliminate, elimination, expand, positions, solve
from polyida.validation import on_pairs

ACCURATE = 1e-10  # residual of an equation over the sum of the sizes of its terms; elimination of a ladder of 200 windows leaves 1e-13


@pack
class Border(NamedTuple):
    """The pattern of a system.

    active: components with an unknown w. points: of body n from point_start[n] on. block: index at which the matrix of each body begins; it is
    square, of 2 components for each point. rows, columns: unknowns in F and E of body n, from row_start[n] and column_start[n] on; their
    entries begin at row_entry and column_entry and have components within the body and slots. into: where the values of each pair of row
    and column of a body are, from into_start on. slip_row, slip_component: of the slopes of friction, the row that presses and the component.
    """

    elimination: Elimination
    active: np.ndarray
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
    into_start: np.ndarray
    into: np.ndarray
    slip_row: np.ndarray
    slip_component: np.ndarray


@pack
class BorderWorkspace(NamedTuple):
    """Values of a system, float or complex.

    slots: numbers of E and F; slopes, curvature, friction: views of it, Bz, C and slopes of friction. blocks: matrices of the bodies. matrix, values: of the
    elimination, and its factors. right: right-hand side. x: unknowns. Scratch: row (columns,), responses (components, columns) of one body; left
    and terms of each equation, its left-hand side and the sum of the sizes of its terms; slip_rows, slopes of the rows of friction.
    """

    slots: np.ndarray
    slopes: np.ndarray
    curvature: np.ndarray
    friction: np.ndarray
    blocks: np.ndarray
    matrix: np.ndarray
    values: np.ndarray
    right: np.ndarray
    x: np.ndarray
    row: np.ndarray
    responses: np.ndarray
    left: np.ndarray
    terms: np.ndarray
    slip_rows: np.ndarray


class Entries:
    """Entries of E and F of a scene, body after body: {unknown: [(component within the body, slot)]} each.

    points: [numbers of the points] of each body with points.
    """

    def __init__(self, model):
        """Number the bodies of a scene that have points, and the points of each."""
        bodies = body_of_points(model)
        numbers, local = np.unique(bodies, return_inverse=True)[1], np.zeros(len(bodies), np.int64)
        self.points = [np.flatnonzero(numbers == body) for body in range(numbers.max(initial=-1) + 1)]
        for group in self.points:
            local[group] = np.arange(len(group))
        self._bodies, self._local = numbers.tolist(), local.tolist()
        self.E, self.F = ([{} for _ in self.points] for _ in range(2))

    def add(self, matrix, unknown, component, slot):
        """Add an entry to E or F: an unknown, a component of all points, and the slot of the number."""
        table = matrix[self._bodies[component // 2]]
        table.setdefault(unknown, []).append((2 * self._local[component // 2] + component % 2, slot))

    def add_active(self, coupling, components, one):
        """Add the unknowns w of active components: unit vectors in E, from the slot `one`, and rows of C in F, from the slots behind it."""
        start, other_points = coupling.start.tolist(), coupling.columns.tolist()
        for unknown, component in enumerate(components.tolist()):
            point, axis = divmod(component, 2)
            self.add(self.E, unknown, component, one)
            for block in range(start[point], start[point + 1]):
                for other in range(2):
                    self.add(self.F, unknown, 2 * other_points[block] + other, one + 1 + 4 * block + 2 * axis + other)

    def add_rows(self, links, first):
        """Add the multipliers of phi, unknowns from `first` on: rows of phi_z, without entries that are always zero."""
        columns, start, zero_slopes = links.row_columns.tolist(), links.row_start.tolist(), (links.row_slopes == 0.0).tolist()
        for k, turning in enumerate(turning_points(links)):
            for e in range(start[k], start[k + 1]):
                if not zero_slopes[e] or columns[e] // 2 in turning:
                    self.add(self.E, first + k, columns[e], e)
                    self.add(self.F, first + k, columns[e], e)


def border(model, active=True, rows=True):
    """The Border of a scene. active, rows: True for the unknowns w and lam; without w it is that of the masses alone, without friction."""
    s, entries = model.arrays.links, Entries(model)
    coupled = np.diff(s.coupling.start) > 0  # points on which a mass, the curvature of a row or a force element can act
    coupled[s.coupling.states] = False  # states are eliminated, see `condense_states`
    components = np.flatnonzero(np.repeat(coupled & active, 2))
    first, one = len(components), len(s.row_columns)  # unknown of the first multiplier; slot of the number 1
    entries.add_active(s.coupling, components, one)
    if rows:
        entries.add_rows(s, first)
    slip_row, slip_component = slip_entries(s.slips) if active and rows else np.zeros((2, 0), np.int64)
    for e, (row, component) in enumerate(zip(slip_row.tolist(), slip_component.tolist())):
        entries.add(entries.E, first + row, component, one + 1 + 4 * len(s.coupling.columns) + e)
    both = list(zip(entries.F, entries.E))
    order = elimination(first + rows * len(s.row_constant), [sorted({*force, *equation}) for equation, force in both])
    into = [_grid(order, list(equation), list(force)) for equation, force in both]
    return Border(
        order,
        components,
        starts(entries.points),
        concatenated(entries.points, np.int64),
        starts([range((2 * len(group)) ** 2) for group in entries.points]),
        *_listed(entries.F),
        *_listed(entries.E),
        starts(into),
        concatenated(into, np.int64),
        slip_row,
        slip_component,
    )


def turning_points(links):
    """For each row of phi the set of its points at which phi_z varies with q and t."""
    points, starts_of_vectors = links.vector_points.tolist(), links.vector_start.tolist()
    turning = [set() for _ in range(len(links.row_constant))]
    for row, *vectors in zip(links.product_row.tolist(), links.product_first.tolist(), links.product_second.tolist()):
        for vector in vectors:
            turning[row].update(points[starts_of_vectors[vector] : starts_of_vectors[vector + 1]])
    return turning


def slip_entries(slips):
    """(rows of phi, components) of the slopes of friction in the order of `slip_slopes`."""
    columns, rows, components = np.split(slips.row_columns, slips.row_start[1:-1]), [], []
    for k in range(len(slips.mu)):
        for row in slips.on[slips.on_start[k] : slips.on_start[k + 1]]:
            rows += [row] * len(columns[k])
            components += columns[k].tolist()
    return np.array(rows, np.int64), np.array(components, np.int64)


def _grid(order, rows, columns):
    """Indices of the values of all pairs of rows and columns."""
    if not rows or not columns:
        return np.zeros(0, np.int64)
    rows, columns = np.meshgrid(rows, columns, indexing="ij")
    return positions(order, rows.ravel(), columns.ravel())


def _listed(tables):
    """Starts and unknowns of the tables of all bodies; starts, components and slots of their entries."""
    each = [entries for table in tables for entries in table.values()]
    flat = np.array([entry for entries in each for entry in entries], np.int64).reshape(-1, 2)
    unknowns = np.array([unknown for table in tables for unknown in table], np.int64)
    return starts(tables), unknowns, starts(each), flat[:, 0].copy(), flat[:, 1].copy()


def body_of_points(model):
    """The number of the body of each point."""
    s = model.arrays.links
    return np.searchsorted(model.first_pairs, s.point_nodes[s.point_ptr[:-1]], side="right") - 1


def border_workspace(model, pattern, dtype=float):
    """A BorderWorkspace of a Border."""
    s, count = model.arrays.links, len(pattern.elimination.diagonal)
    first, blocks = len(s.row_columns) + 1, 4 * len(s.coupling.columns)
    slots = np.zeros(first + blocks + len(pattern.slip_row), dtype)
    slots[first - 1] = 1.0
    wide, columns = (int(np.diff(each).max(initial=0)) for each in (2 * pattern.point_start, pattern.column_start))
    return BorderWorkspace(
        slots,
        slots[: first - 1],
        slots[first : first + blocks].reshape(-1, 2, 2),
        slots[first + blocks :],
        np.zeros(pattern.block[-1], dtype),
        *np.zeros((2, pattern.elimination.start[-1]), dtype),
        np.zeros(count, dtype),
        np.zeros(count, dtype),
        np.zeros(columns, dtype),
        np.zeros((wide, columns), dtype),
        np.zeros(count, dtype),
        np.zeros(count),
        np.zeros(len(s.slips.row_columns), dtype),
    )


def body_blocks(pattern, left, right):
    """The product `left right` (points, points), complex and sparse, as real blocks of the bodies."""
    groups = np.split(pattern.points, pattern.point_start[1:-1])
    blocks = [on_pairs((left[group] @ right[:, group]).toarray()).ravel() for group in groups if len(group)]
    return np.concatenate([*blocks, np.zeros(0)])


@part
def measure(border, work, moved):
    """Set the right-hand side to F moved, moved (points, 2) the displacements of the points."""
    zero(work.right)
    for n in range(border.block.shape[0] - 1):
        for r in range(border.row_start[n], border.row_start[n + 1]):
            for e in range(border.row_entry[r], border.row_entry[r + 1]):
                at = border.row_component[e]
                work.right[border.rows[r]] += work.slots[border.row_slot[e]] * moved[border.points[border.point_start[n] + at // 2], at % 2]


@shared
def solve_border(border, work):
    """Solve for work.x, with work.right, work.slots and work.blocks. Returns False if the system is singular."""
    return solve_in_order(border, work) or solve_pivoted(border, work)


@part
def solve_in_order(border, work):
    """Solve for work.x by elimination in the fixed order. Returns False if the solution is not accurate."""
    assemble(border, work)
    put(1.0, work.matrix, work.values)
    if not eliminate(border.elimination, work.values, work.x):
        return False
    solve(border.elimination, work.values, work.right, work.x)
    return is_accurate(border.elimination, work)


@part
def solve_border_again(border, work):
    """Solve for work.x with another work.right and the factors of `solve_border`."""
    solve(border.elimination, work.values, work.right, work.x)
    total = 0.0
    for u in range(work.x.shape[0]):
        total += magnitude(work.x[u])
    return total < np.inf or solve_pivoted(border, work)


@part
def assemble(border, work):
    """Set work.matrix to I_w + F G E."""
    zero(work.matrix)
    row = work.row
    for n in range(border.block.shape[0] - 1):
        first, count = border.column_start[n], border.column_start[n + 1] - border.column_start[n]
        respond(border, work, n, first, count)
        for r in range(border.row_start[n], border.row_start[n + 1] if count else border.row_start[n]):
            for j in range(count):
                row[j] = 0.0
            for e in range(border.row_entry[r], border.row_entry[r + 1]):
                value, at = work.slots[border.row_slot[e]], border.row_component[e]
                for j in range(count):
                    row[j] += value * work.responses[at, j]
            at = border.into_start[n] + (r - border.row_start[n]) * count
            for j in range(count):
                work.matrix[border.into[at + j]] += row[j]
    for i in range(border.active.shape[0]):
        work.matrix[border.elimination.diagonal[i]] += 1.0


@part
def respond(border, work, body, first, count):
    """Set work.responses to G E of a body, (components, columns)."""
    wide, at = 2 * (border.point_start[body + 1] - border.point_start[body]), border.block[body]
    for j in range(count):
        for p in range(wide):
            work.responses[p, j] = 0.0
        for e in range(border.column_entry[first + j], border.column_entry[first + j + 1]):
            value, place = work.slots[border.column_slot[e]], at + border.column_component[e]
            for p in range(wide):
                work.responses[p, j] += work.blocks[place + p * wide] * value


@part
def is_accurate(border, work):
    """True if work.x solves the system of work.matrix with right side work.right up to round-off; False for nan.

    Overwrites work.left, work.terms.
    """
    for u in range(work.x.shape[0]):
        work.left[u], work.terms[u] = 0.0, magnitude(work.right[u])
    for f in range(border.size.shape[0]):
        n, at, first = border.size[f], border.start[f], border.first[f]
        for i in range(n):
            left, terms = 0.0 * work.x[0], 0.0
            for j in range(n if i < border.pivots[f] else border.pivots[f]):
                value = work.matrix[at + i * n + j] * work.x[border.unknowns[first + j]]
                left += value
                terms += magnitude(value)
            work.left[border.unknowns[first + i]] += left
            work.terms[border.unknowns[first + i]] += terms
    good = True
    for u in range(work.x.shape[0]):
        good = good and magnitude(work.right[u] - work.left[u]) <= ACCURATE * work.terms[u]
    return good


@shared
def solve_pivoted(border, work):
    """Solve for work.x by a dense elimination with pivoting. Returns False if the system is singular."""
    count = work.x.shape[0]
    matrix = np.empty((count, count), work.x.dtype)
    expand(border.elimination, work.matrix, matrix)
    put(1.0, work.right, work.x)
    work.values[:] = np.nan  # there are no factors for another right-hand side
    return solve_small(matrix, work.x)
