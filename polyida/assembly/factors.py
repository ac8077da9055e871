"""Plates whose cells have factors of stiffness and mass, and the derivatives of a run's work in these factors.

r is linear in the factors, `r = sum_e s_e f_e(q, v) + m_e M_e (a - g + d v) + ...`, g the gravity, d the mass damping: the derivatives of `w . r`
are the virtual works of each cell's forces at factor 1 along w.
"""

from dataclasses import replace

import numpy as np

from polyida.assembly.arrays import INDICES, INDPTR, LAYOUT, WEIGHTS, cells_of, concatenated, material_of, starts
from polyida.assembly.build import operator_arrays
from polyida.assembly.placement import dead_loads, steady
from polyida.element import cell_products as kernels
from polyida.errors import InputError
from polyida.jit import entry
from polyida.jit.intrinsics import LANES
from polyida.validation import LARGEST, read_only, reals

OF_FACTORS = ("_mass", "_even_mass", "_mass_factor", "drawn")  # cached properties of a model that depend on the factors
WHAT = ("stiffness", "mass")


def scaled(model, factors):
    """A copy of the model with the factors {plate: (stiffness, mass)}; other plates keep theirs. Raises InputError."""
    contributions, checked = model.once(CellContributions, of_shape=True), _checked(model, factors)
    of_bodies = [checked.get(body.name, body.factors) for body in model.bodies]
    plates = contributions.scaled(*(concatenated(each, float) for each in zip(*of_bodies))) if of_bodies else contributions.plates
    other = model.altered(OF_FACTORS, bodies=[], _rotated=[(None, None)])
    for body, factor, first, last in zip(model.bodies, of_bodies, plates.at, plates.at[1:]):
        pattern, operator = slice(first[INDICES], last[INDICES]), body.operator
        stabilisation = None if operator.stabilisation is None else plates.stabilisation[pattern]
        operator = replace(
            operator, weights=plates.weights[first[WEIGHTS] : last[WEIGHTS]], mass=plates.mass[pattern], stabilisation=stabilisation
        )
        other.bodies.append(body.scaled(operator, factor))
    other.places = model.places | {id(body.plate): body for body in other.bodies}
    loads = dead_loads(other.parts, other.gravity, other.places)
    weight = np.concatenate(
        [placed.weight(steady(other.gravity)) for placed in (*other.all_bodies, *other.states.values(), *other.strains.values())]
    )
    plates = plates._replace(weight=weight, load_values=concatenated([load.forces for load in loads], float, (2,)))
    other.arrays, other._derived = model.arrays._replace(plates=plates), {}
    return other


def given_factors(model):
    """{plate: (stiffness, mass)} of the plates with factors other than 1."""
    return {name: factors for name, factors in model.factors.items() if not all((factor == 1.0).all() for factor in factors)}


def _checked(model, factors):
    """{plate: (stiffness, mass)}, (cells,) each, read-only. Raises InputError."""
    known, checked = {body.name: body for body in model.bodies}, {}
    for name, pair in factors.items():
        if name not in known:
            part = model.parts.get(name)
            what = "no part of the scene" if part is None else f"a {type(part).__name__}"
            advice = f"; plates: {', '.join(map(repr, known)) or 'none'}"
            if any(placed.name == name for placed in model.reduced_bodies):
                advice = ": only the cells of full plates have factors, take its plate into the scene itself"
            raise InputError(f"with_factors: {name!r} is {what}{advice}")
        if not isinstance(pair, (tuple, list)) or len(pair) != 2:
            raise InputError(f"with_factors: {name} = {pair!r:.100} must be a pair (stiffness, mass); None for a factor of 1")
        checked[name] = tuple(_factor(name, what, one, known[name].mesh.n_cells) for what, one in zip(WHAT, pair))
    return checked


def _factor(name, what, factor, cells):
    """A factor of each cell, (cells,), read-only."""
    label = f"with_factors: the {what} of {name!r}"
    array = np.ones(()) if factor is None else reals(factor)
    if array is None or array.shape not in ((), (cells,)):
        shape = "" if array is None else f", of shape {array.shape},"
        raise InputError(f"{label} = {factor!r:.100}{shape} must be a positive number, or one for each of its {cells} cells, ({cells},)")
    wrong = np.flatnonzero(~((array > 0) & (array <= LARGEST)))
    if wrong.size:
        raise InputError(f"{label} is {array.flat[wrong[0]]:g}{f' in cell {wrong[0]}' * array.ndim}: factors must be positive and finite")
    return read_only(np.array(np.broadcast_to(array, cells)))


class CellContributions:
    """The arrays of a model's plates, each with its own operator, as functions of one factor per cell, plate after plate.

    plates: the arrays at factor 1. first (plates + 1,): first cell of each plate. lane_cells, weight_cells: the cell of each lane and of
    each weight. mass, stabilisation: the matrices on the node pattern as CellSums.
    """

    def __init__(self, model):
        """Gather the arrays of a scene's cells with the factors of their stiffness and mass."""
        bodies = [body.scaled(replace(body.operator), body.factors) for body in model.bodies]
        operators, plates = [body.operator for body in bodies], model.arrays.plates
        shared = len({id(body.operator) for body in model.bodies}) < len(bodies)
        self.plates = plates._replace(**operator_arrays(bodies)) if shared else plates
        self.names, self.first = [body.name for body in bodies], starts([o.areas for o in operators])
        self.lane_cells = self._cells([o.lane_cells for o in operators])
        self.weight_cells = self._cells([_cells_of(o, 4, o.layout[:, 1]) for o in operators])
        entries = concatenated([o.pairs + first for o, first in zip(operators, self.plates.at[:, INDICES])], np.int32)
        cells = self._cells([_cells_of(o, 5, o.layout[:, 0] ** 2) for o in operators])
        self.mass = CellSums(entries, cells, concatenated([o.cell_mass for o in operators], float))
        stabilised = [np.zeros(len(o.pairs)) if o.cell_stabilisation is None else o.cell_stabilisation for o in operators]
        self.stabilisation = CellSums(entries, cells, concatenated(stabilised, float))

    def _cells(self, parts):
        """Cell numbers within plates as numbers of all cells."""
        return concatenated([cells + first for cells, first in zip(parts, self.first)], np.int32)

    def scaled(self, stiffness, mass):
        """The plates' arrays for factors (cells,)."""
        return self.plates._replace(
            weights=self.plates.weights * stiffness[self.weight_cells],
            mass=self.mass(mass, np.zeros_like(self.plates.mass)),
            stabilisation=self.stabilisation(stiffness, np.zeros_like(self.plates.stabilisation)),
        )

    def of_cells(self, values):
        """A number of each plate, (plates,), for each of its cells, (cells,)."""
        return np.repeat(values, np.diff(self.first))

    def by_plate(self, values):
        """{plate: (..., its cells)} of numbers of all cells."""
        return dict(zip(self.names, np.split(values, self.first[1:-1], axis=-1)))


class CellSums:
    """Numbers on the node pattern as sums over cells: `out[entry] = sum of values * factors[cell]`.

    The order of summation is that of the operator: factors of 1 give identical numbers. Empty if all values are zero.
    """

    def __init__(self, entries, cells, values):
        """Store entry of `out`, cell and value of each summand, (summands,) each; empty arrays if all values are zero."""
        some = slice(None if values.any() else 0)
        self.entries, self.cells, self.values = entries[some], cells[some], values[some]

    def __call__(self, factors, out):
        """Add `values * factors[cell]` of each summand to out[entry], in place, and return out (nnz,); factors (cells,)."""
        kernels.sums(self.entries, self.cells, self.values, factors, out)
        return out

    def slopes(self, work, count):
        """A new array (count,): derivatives of `work . out` in the factors of the `count` cells; work (nnz,): weights of out."""
        out = np.zeros(count)
        kernels.sums(self.cells, self.entries, self.values, work, out)
        return out


def _cells_of(operator, column, vectors):
    """The cells of the lanes of all vectors, in blocks that begin at the values of a column of the layout, with `vectors` vectors each."""
    order = np.argsort(operator.layout[:, column])
    return np.repeat(operator.lane_cells.reshape(-1, LANES)[order], vectors[order], axis=0).ravel()


def stiffness_work(model, q, v, w):
    """{plate: (..., cells)}, J: sums over frames of `w . f_e(q, v)`; q, v (frames, n), w (frames, ..., n).

    f_e: elastic force of cell e at factor 1, with its viscosity and stabilisation.
    """
    contributions, along = model.once(CellContributions, of_shape=True), _nodal(model, w)
    lanes, pairs = (np.zeros((along.shape[1], len(x))) for x in (contributions.lane_cells, contributions.plates.mass))
    _force_works(contributions.plates, *(_nodal(model, x)[:, 0] for x in (q, v)), along, lanes, pairs)
    count = contributions.first[-1]
    factors = contributions.of_cells(contributions.plates.body_stabilisation)
    works = np.array([np.bincount(contributions.lane_cells, each, count) for each in lanes])
    works += [factors * contributions.stabilisation.slopes(each, count) for each in pairs]
    return contributions.by_plate(works.reshape(*np.shape(w)[1:-1], count))


def mass_work(model, b, w, gravity=None):
    """{plate: (..., cells)}: sums over frames of `w . M_e (b - gravity)`; b (frames, n), w (frames, ..., n), gravity (frames, 2): the same at all nodes.

    M_e: mass matrix of cell e at factor 1.
    """
    contributions, along = model.once(CellContributions, of_shape=True), _nodal(model, w)
    pairs = np.zeros((along.shape[1], len(contributions.plates.mass)))
    _mass_works(contributions.plates, _nodal(model, b), np.zeros((len(along), 2)) if gravity is None else gravity, along, pairs)
    density = contributions.of_cells(contributions.plates.body_density)
    works = np.array([density * contributions.mass.slopes(each, contributions.first[-1]) for each in pairs])
    return contributions.by_plate(works.reshape(*np.shape(w)[1:-1], -1))


def _nodal(model, x):
    """x (frames, ..., n) as (frames, columns, nodes, 2)."""
    return np.ascontiguousarray(x, float).reshape(len(x), -1, model.n_nodes, 2)


@entry
def _force_works(plates, q, v, fields, lanes, pairs):
    """Add over frames: fields[c] . f of the cells in their lanes, products for the stabilisation on the pattern."""
    for frame in range(q.shape[0]):
        u, speed, along = q[frame], v[frame], fields[frame]
        for o in range(plates.body_operator.shape[0]):
            first, end, node = plates.at[o], plates.at[o + 1], plates.body_node[o]
            own = lanes[:, LANES * first[LAYOUT] : LANES * end[LAYOUT]]
            kernels.force_work(cells_of(plates, o), material_of(plates, o), u, speed, along, own)
            if plates.body_stabilisation[o] != 0.0:
                indptr, pattern = plates.indptr[first[INDPTR] : end[INDPTR]], slice(first[INDICES], end[INDICES])
                kernels.difference_products(indptr, plates.indices[pattern], node, u, along, pairs[:, pattern])


@entry
def _mass_works(plates, accelerations, gravity, fields, pairs):
    """Add sums over frames of products of fields with accelerations - gravity for the mass on the pattern."""
    right, still = kernels.by_node(accelerations, 0, gravity), np.zeros((fields.shape[0], 2))
    for c in range(fields.shape[1]):
        left = kernels.by_node(fields, c, still)
        for o in range(plates.body_operator.shape[0]):
            first, end = plates.at[o], plates.at[o + 1]
            indptr, pattern = plates.indptr[first[INDPTR] : end[INDPTR]], slice(first[INDICES], end[INDICES])
            kernels.products(indptr, plates.indices[pattern], plates.body_node[o], right, left, pairs[c, pattern])
