"""Sparse solution of the constraint systems of scenes: unknown forces at points of the bodies.

The unknowns x are multipliers and forces on components of points. They cause the forces E x. Each body has a compliance matrix G and moves
by -G E x at its points. The equations measure these displacements by F: `(I_w + F G E) x = right`. The elimination follows the graph of the
bodies.

| unknown | column of E | row of F |
|---|---|---|
| w, forces on active components | a unit vector | a row of C, the curvature of the rows of phi and the slopes of force elements |
| lam, multipliers of phi | a row of Bz = phi_z, and the slope of friction that it presses | the same row of Bz |

I_w is the unit matrix on w. All numbers of E and F are in one array, and their indices are called slots:

    slots = [phi_z (entries of row_columns) | 1 | C, 4 for each block of the coupling | slopes of friction]
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
    """The pattern of a system. List k of entries or unknowns reaches from start k to start k + 1."""

    elimination: Elimination
    active: np.ndarray  # (w,) components with an unknown w
    point_start: np.ndarray  # (bodies + 1,) starts in points
    points: np.ndarray  # numbers of the points of all bodies
    block: np.ndarray  # (bodies + 1,) where the matrix G of each body starts in `blocks`: square, 2 components for each point
    row_start: np.ndarray  # (bodies + 1,) starts in rows
    rows: np.ndarray  # unknowns whose equations have entries of F on a body, of all bodies
    row_entry: np.ndarray  # (rows + 1,) starts in row_component and row_slot
    row_component: np.ndarray  # component within the body of each entry of F
    row_slot: np.ndarray  # slot of each entry of F
    column_start: np.ndarray  # (bodies + 1,) starts in columns
    columns: np.ndarray  # unknowns whose forces E act on a body, of all bodies
    column_entry: np.ndarray  # (columns + 1,) starts in column_component and column_slot
    column_component: np.ndarray  # component within the body of each entry of E
    column_slot: np.ndarray  # slot of each entry of E
    target_start: np.ndarray  # (bodies + 1,) starts in target
    target: np.ndarray  # index in `matrix` of each pair (row, column) of a body, row by row
    slip_row: np.ndarray  # (slopes of friction,) row of phi that presses
    slip_component: np.ndarray  # (slopes of friction,) component of the points on which the force of friction acts


@pack
class BorderWorkspace(NamedTuple):
    """Values of a system, float or complex."""

    slots: np.ndarray  # numbers of E and F
    slopes: np.ndarray  # view of slots: Bz
    curvature: np.ndarray  # view of slots: C, (blocks of the coupling, 2, 2)
    friction: np.ndarray  # view of slots: slopes of friction
    blocks: np.ndarray  # matrices G of the bodies
    matrix: np.ndarray  # I_w + F G E, in the order of `elimination`
    values: np.ndarray  # factors of `matrix`; nan if there are none
    right: np.ndarray  # (unknowns,) right-hand side
    x: np.ndarray  # (unknowns,)
    row: np.ndarray  # (columns,) scratch: a row of F G E of a body
    responses: np.ndarray  # (components, columns) scratch: G E of a body
    left: np.ndarray  # (unknowns,) scratch: left-hand side of each equation
    terms: np.ndarray  # (unknowns,) scratch: sum of the sizes of its terms
    slip_rows: np.ndarray  # slopes of the rows of friction


class Slots(NamedTuple):
    """First slots of the kinds of numbers of E and F; phi_z begins at 0."""

    one: int  # of the number 1
    curvature: int  # of C
    friction: int  # of the slopes of friction


def slots_of(model):
    """Return the Slots of a scene."""
    s = model.arrays.links
    one = len(s.row_columns)
    curvature = one + 1
    return Slots(one, curvature, curvature + 4 * len(s.coupling.columns))


class Entries:
    """Entries of E (`forces`) and F (`equations`) of a scene, body after body: {unknown: [(component within the body, slot)]} each.

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
        self.forces = [{} for _ in self.points]  # columns of E
        self.equations = [{} for _ in self.points]  # rows of F

    def add(self, tables, unknown, component, slot):
        """Add an entry to `self.forces` or `self.equations`: an unknown, a component of all points, and the slot of the number."""
        table = tables[self._bodies[component // 2]]
        table.setdefault(unknown, []).append((2 * self._local[component // 2] + component % 2, slot))

    def add_active(self, coupling, components, slots):
        """Add the unknowns w of active components: unit vectors in E and rows of C in F. slots: Slots."""
        start, other_points = coupling.start.tolist(), coupling.columns.tolist()
        for unknown, component in enumerate(components.tolist()):
            point, axis = divmod(component, 2)
            self.add(self.forces, unknown, component, slots.one)
            for block in range(start[point], start[point + 1]):
                for other in range(2):
                    self.add(self.equations, unknown, 2 * other_points[block] + other, slots.curvature + 4 * block + 2 * axis + other)

    def add_rows(self, links, first):
        """Add the multipliers of phi, unknowns from `first` on: rows of phi_z, without entries that are always zero."""
        columns, start, zero_slopes = links.row_columns.tolist(), links.row_start.tolist(), (links.row_slopes == 0.0).tolist()
        for k, turning in enumerate(turning_points(links)):
            for e in range(start[k], start[k + 1]):
                if not zero_slopes[e] or columns[e] // 2 in turning:
                    self.add(self.forces, first + k, columns[e], e)
                    self.add(self.equations, first + k, columns[e], e)


def border(model, point_forces=True, multipliers=True):
    """Return the Border of a scene.

    point_forces: with the unknowns w. Without them the system is Bz G Bz^T alone (G: M^-1 at the points, or A A^T), without friction.
    multipliers: with the unknowns lam.
    """
    s, entries, slots = model.arrays.links, Entries(model), slots_of(model)
    coupled = np.diff(s.coupling.start) > 0  # points on which a mass, the curvature of a row or a force element can act
    coupled[s.coupling.states] = False  # states are eliminated, see `condense_states`
    components = np.flatnonzero(np.repeat(coupled & point_forces, 2))
    entries.add_active(s.coupling, components, slots)
    first_multiplier = unknowns = len(components)
    if multipliers:
        entries.add_rows(s, first_multiplier)
        unknowns += len(s.row_constant)
    slip_row, slip_component = slip_entries(s.slips) if point_forces and multipliers else np.zeros((2, 0), np.int64)
    for e, (row, component) in enumerate(zip(slip_row.tolist(), slip_component.tolist())):
        entries.add(entries.forces, first_multiplier + row, component, slots.friction + e)
    both = list(zip(entries.equations, entries.forces))
    order = elimination(unknowns, [sorted({*force, *equation}) for equation, force in both])
    target = [_grid(order, list(equation), list(force)) for equation, force in both]
    rows, columns = _listed(entries.equations), _listed(entries.forces)
    return Border(
        elimination=order,
        active=components,
        point_start=starts(entries.points),
        points=concatenated(entries.points, np.int64),
        block=starts([range((2 * len(group)) ** 2) for group in entries.points]),
        row_start=rows["start"],
        rows=rows["unknowns"],
        row_entry=rows["entry"],
        row_component=rows["component"],
        row_slot=rows["slot"],
        column_start=columns["start"],
        columns=columns["unknowns"],
        column_entry=columns["entry"],
        column_component=columns["component"],
        column_slot=columns["slot"],
        target_start=starts(target),
        target=concatenated(target, np.int64),
        slip_row=slip_row,
        slip_component=slip_component,
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
    """Return {name: array} of the tables {unknown: [(component, slot)]} of all bodies, one list after another.

    start: first unknown of each body; unknowns; entry: first entry of each unknown; component and slot of the entries.
    """
    each = [entries for table in tables for entries in table.values()]
    flat = np.array([entry for entries in each for entry in entries], np.int64).reshape(-1, 2)
    unknowns = np.array([unknown for table in tables for unknown in table], np.int64)
    components, slots = flat.T.copy()
    return {"start": starts(tables), "unknowns": unknowns, "entry": starts(each), "component": components, "slot": slots}


def body_of_points(model):
    """The number of the body of each point."""
    s = model.arrays.links
    return np.searchsorted(model.first_pairs, s.point_nodes[s.point_ptr[:-1]], side="right") - 1


def border_workspace(model, pattern, dtype=float):
    """Return a BorderWorkspace of a Border, zeros but for the number 1."""
    s, first = model.arrays.links, slots_of(model)
    unknowns = len(pattern.elimination.diagonal)
    slots = np.zeros(first.friction + len(pattern.slip_row), dtype)
    slots[first.one] = 1.0
    components = int(np.diff(2 * pattern.point_start).max(initial=0))  # most of one body
    columns = int(np.diff(pattern.column_start).max(initial=0))
    return BorderWorkspace(
        slots=slots,
        slopes=slots[: first.one],
        curvature=slots[first.curvature : first.friction].reshape(-1, 2, 2),
        friction=slots[first.friction :],
        blocks=np.zeros(pattern.block[-1], dtype),
        matrix=np.zeros(pattern.elimination.start[-1], dtype),
        values=np.zeros(pattern.elimination.start[-1], dtype),
        right=np.zeros(unknowns, dtype),
        x=np.zeros(unknowns, dtype),
        row=np.zeros(columns, dtype),
        responses=np.zeros((components, columns), dtype),
        left=np.zeros(unknowns, dtype),
        terms=np.zeros(unknowns),
        slip_rows=np.zeros(len(s.slips.row_columns), dtype),
    )


def body_blocks(pattern, left, right):
    """The product `left right` (points, points), complex and sparse, as real blocks of the bodies."""
    groups = np.split(pattern.points, pattern.point_start[1:-1])
    blocks = [on_pairs((left[group] @ right[:, group]).toarray()).ravel() for group in groups if len(group)]
    return np.concatenate([*blocks, np.zeros(0)])


@part
def fill_right_side(border, work, moved):
    """Set work.right to F moved, moved (points, 2)."""
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
    fill_matrix(border, work)
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
def fill_matrix(border, work):
    """Set work.matrix to I_w + F G E, body by body."""
    zero(work.matrix)
    row = work.row
    for n in range(border.block.shape[0] - 1):
        first = border.column_start[n]
        count = border.column_start[n + 1] - first
        fill_responses(border, work, n, first, count)
        for r in range(border.row_start[n], border.row_start[n + 1] if count else border.row_start[n]):
            for j in range(count):
                row[j] = 0.0
            for e in range(border.row_entry[r], border.row_entry[r + 1]):
                value, at = work.slots[border.row_slot[e]], border.row_component[e]
                for j in range(count):
                    row[j] += value * work.responses[at, j]
            at = border.target_start[n] + (r - border.row_start[n]) * count
            for j in range(count):
                work.matrix[border.target[at + j]] += row[j]
    for i in range(border.active.shape[0]):
        work.matrix[border.elimination.diagonal[i]] += 1.0


@part
def fill_responses(border, work, body, first, count):
    """Set work.responses to G E of a body, (components, columns); its `count` columns begin with number `first`."""
    wide = 2 * (border.point_start[body + 1] - border.point_start[body])
    at = border.block[body]
    for j in range(count):
        for p in range(wide):
            work.responses[p, j] = 0.0
        for e in range(border.column_entry[first + j], border.column_entry[first + j + 1]):
            value, place = work.slots[border.column_slot[e]], at + border.column_component[e]
            for p in range(wide):
                work.responses[p, j] += work.blocks[place + p * wide] * value


@part
def is_accurate(border, work):
    """True if work.x solves the system with right side work.right, up to round-off in each row; False for nan.

    work.matrix: the matrix before it is factored, by the fronts of `border`. work.left is overwritten with the matrix times x,
    work.terms with the sums of the magnitudes of its terms and of work.right.
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
