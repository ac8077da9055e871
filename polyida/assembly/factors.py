"""Plates whose cells are scaled, each by factors of its own, and the slopes of a run's work in these factors.

r is linear in the factors of each plate, `r = sum_e s_e f_e(q, v) + m_e M_e (a - g + d v) + ...`, g the gravity, d the mass damping: the
virtual works of every cell's forces along w at factor 1 are the derivatives of `w . r` at any factors.
"""

from dataclasses import replace

import numpy as np

from polyida.assembly.arrays import concatenated, starts
from polyida.assembly.build import operator_arrays
from polyida.assembly.equilibrium import cells
from polyida.assembly.placement import dead_loads, steady
from polyida.element import cell_products as kernels
from polyida.errors import InputError
from polyida.jit import entry
from polyida.jit.intrinsics import LANES
from polyida.validation import read_only, reals

OF_FACTORS = ("_mass", "_even_mass", "_mass_factor", "drawn")  # what a model keeps that follows from them, its arrays and bodies apart
WHAT = ("stiffness", "mass")


def scaled(model, given):
    """A copy of the model with the factors `given`, {plate: (stiffness, mass)}; other plates keep theirs. Raises InputError."""
    shares, checked = model.once(Shares, of_shape=True), _checked(model, given)
    factors = [checked.get(body.name, body.factors) for body in model.bodies]
    plates = shares.scaled(*(concatenated(each, float) for each in zip(*factors))) if factors else shares.plates
    other = object.__new__(type(model))
    other.__dict__.update({name: value for name, value in model.__dict__.items() if name not in OF_FACTORS})
    other.bodies = []
    for body, factor, first, last in zip(model.bodies, factors, plates.at, plates.at[1:]):
        pattern, operator = slice(first[6], last[6]), body.operator
        stabilisation = None if operator.stabilisation is None else plates.stabilisation[pattern]
        operator = replace(operator, weights=plates.weights[first[3] : last[3]], mass=plates.mass[pattern], stabilisation=stabilisation)
        other.bodies.append(replace(body, operator=operator, factors=factor))
    other.places = model.places | {id(body.plate): body for body in other.bodies}
    loads = dead_loads(other.parts, other.gravity, other.places)
    weight = np.concatenate([placed.weight(steady(other.gravity)) for placed in (*other.bodies, *other.few)])
    plates = plates._replace(weight=weight, load_values=concatenated([load.forces for load in loads], float, (2,)))
    other.arrays, other._kept = model.arrays._replace(plates=plates), {}
    return other


def factors_of(model):
    """{plate: (stiffness, mass)} of all its full plates."""
    return {body.name: body.factors for body in model.bodies}


def told(model):
    """{plate: (stiffness, mass)} of the plates that are not full."""
    return {name: factors for name, factors in factors_of(model).items() if not all((factor == 1.0).all() for factor in factors)}


def _checked(model, given):
    """{plate: (stiffness, mass)}, each (cells,), of what was given. Raises InputError."""
    known, found = {body.name: body for body in model.bodies}, {}
    for name, pair in given.items():
        if name not in known:
            raise InputError(_unknown(model, name, known))
        if not isinstance(pair, (tuple, list)) or len(pair) != 2:
            raise InputError(f"with_factors: {name} = {pair!r:.100} must be a pair (stiffness, mass); None for a factor of 1")
        found[name] = tuple(_factor(name, what, one, known[name].mesh.n_cells) for what, one in zip(WHAT, pair))
    return found


def _unknown(model, name, known):
    part = model.parts.get(name)
    if any(placed.name == name for placed in model.few):
        return f"with_factors: {name!r} is a {type(part).__name__}: only the cells of full plates have factors, take its plate into the scene itself"
    what = "no part of the scene" if part is None else f"a {type(part).__name__}"
    return f"with_factors: {name!r} is {what}; plates: {', '.join(map(repr, known)) or 'none'}"


def _factor(name, what, given, cells):
    """A factor of every cell, (cells,), that nobody can write."""
    label = f"with_factors: the {what} of {name!r}"
    array = np.ones(()) if given is None else reals(given)
    if array is None or array.shape not in ((), (cells,)):
        shape = "" if array is None else f", of shape {array.shape},"
        raise InputError(f"{label} = {given!r:.100}{shape} must be a positive number, or one for each of its {cells} cells, ({cells},)")
    wrong = np.flatnonzero(~((array > 0) & (array < np.inf)))
    if wrong.size:
        raise InputError(f"{label} is {array.flat[wrong[0]]:g}{f' in cell {wrong[0]}' * array.ndim}: factors must be positive and finite")
    return read_only(np.array(np.broadcast_to(array, cells)))


class Shares:
    """The arrays of a model's plates, an operator of its own for each, as functions of one factor a cell, plate after plate.

    plates: the arrays of full cells. first (plates + 1,): the first cell of each plate. lane_cells, weight_cells: the cell of every lane
    and of every weight. mass, stabilisation: matrices on the node pattern as Sums.
    """

    def __init__(self, model):
        bodies = [replace(body, operator=replace(body.operator)) for body in model.bodies]
        operators, plates = [body.operator for body in bodies], model.arrays.plates
        shared = len({id(body.operator) for body in model.bodies}) < len(bodies)
        self.plates = plates._replace(**operator_arrays(bodies)) if shared else plates
        self.names, self.first = [body.name for body in bodies], starts([o.areas for o in operators])
        self.lane_cells = self._cells([o.lane_cells for o in operators])
        self.weight_cells = self._cells([_cells_of(o, 4, o.layout[:, 1]) for o in operators])
        places = concatenated([o.pairs + place for o, place in zip(operators, self.plates.at[:, 6])], np.int32)
        cells = self._cells([_cells_of(o, 5, o.layout[:, 0] ** 2) for o in operators])
        self.mass = Sums(places, cells, concatenated([o.cell_mass for o in operators], float))
        stabilised = [np.zeros(len(o.pairs)) if o.cell_stabilisation is None else o.cell_stabilisation for o in operators]
        self.stabilisation = Sums(places, cells, concatenated(stabilised, float))

    def _cells(self, parts):
        """Numbers of cells of each plate as such of all."""
        return concatenated([cells + first for cells, first in zip(parts, self.first)], np.int32)

    def scaled(self, stiffness, mass):
        """The plates' arrays for factors (cells,) of all cells."""
        return self.plates._replace(
            weights=self.plates.weights * stiffness[self.weight_cells],
            mass=self.mass(mass, np.zeros_like(self.plates.mass)),
            stabilisation=self.stabilisation(stiffness, np.zeros_like(self.plates.stabilisation)),
        )

    def of_cells(self, values):
        """A number of each plate, (plates,), for each of its cells, (cells,)."""
        return np.repeat(values, np.diff(self.first))

    def by_plate(self, values):
        """{plate: (its cells,)} of numbers of all cells."""
        return dict(zip(self.names, np.split(values, self.first[1:-1])))


class Sums:
    """Numbers on the node pattern as sums over cells: `out[place] = sum of values * factors[cell]`.

    They are added up as the operator's own were: factors of 1 give the same to the bit. Where all values are zero there are none.
    """

    def __init__(self, places, cells, values):
        some = slice(None if values.any() else 0)
        self.places, self.cells, self.values = places[some], cells[some], values[some]

    def __call__(self, factors, out):
        """out (nnz,), zero before."""
        kernels.sums(self.places, self.cells, self.values, factors, out)
        return out

    def slopes(self, work, count):
        """Slopes of `work . out` in the factors of that many cells."""
        return np.bincount(self.cells, self.values * work[self.places], count)


def _cells_of(operator, column, vectors):
    """The cells of the lanes of all vectors in blocks that begin where a column of the layout says, each with so many vectors."""
    order = np.argsort(operator.layout[:, column])
    return np.repeat(operator.lane_cells.reshape(-1, LANES)[order], vectors[order], axis=0).ravel()


def stiffness_work(model, q, v, w):
    """{plate: (cells,)}, J: sums over frames of `w . f_e(q, v)`, f_e the elastic force of cell e at factor 1 with its viscosity and
    stabilisation; q, v, w (frames, n).
    """
    shares = model.once(Shares, of_shape=True)
    lanes, pairs = np.zeros(len(shares.lane_cells)), np.zeros(len(shares.plates.mass))
    _force_works(shares.plates, *(_nodal(model, x) for x in (q, v, w)), lanes, pairs)
    stabilising = shares.of_cells(shares.plates.body_stabilisation) * shares.stabilisation.slopes(pairs, shares.first[-1])
    return shares.by_plate(np.bincount(shares.lane_cells, lanes, shares.first[-1]) + stabilising)


def mass_work(model, b, w, pull=None):
    """{plate: (cells,)}: sums over frames of `w . M_e (b - pull)`, M_e the mass matrix of cell e at factor 1; b, w (frames, n), pull
    (frames, 2): the same everywhere.
    """
    shares = model.once(Shares, of_shape=True)
    pairs = np.zeros(len(shares.plates.mass))
    _mass_works(shares.plates, *(_nodal(model, x) for x in (b, w)), pairs)
    if pull is not None:
        _mass_works(shares.plates, _nodal(model, np.tile(np.eye(2), model.n_nodes)), _nodal(model, -(pull.T @ w)), pairs)
    return shares.by_plate(shares.of_cells(shares.plates.body_density) * shares.mass.slopes(pairs, shares.first[-1]))


def _nodal(model, x):
    return np.ascontiguousarray(x, float).reshape(-1, model.n_nodes, 2)


@entry
def _force_works(s, q, v, w, lanes, pairs):
    """Add up over frames: w . f of the cells in their lanes, products for the stabilisation on the pattern."""
    for frame in range(q.shape[0]):
        for o in range(s.body_operator.shape[0]):
            p, e = s.at[o], s.at[o + 1]
            kernels.force_work(
                *cells(s, o),
                s.body_node[o],
                s.body_c1[o],
                s.body_nu[o],
                s.body_viscosity[o],
                q[frame],
                v[frame],
                w[frame],
                lanes[LANES * p[0] : LANES * e[0]],
            )
            if s.body_stabilisation[o] != 0.0:
                kernels.difference_products(
                    s.indptr[p[5] : e[5]], s.indices[p[6] : e[6]], s.body_node[o], q[frame], w[frame], pairs[p[6] : e[6]]
                )


@entry
def _mass_works(s, b, w, pairs):
    """Add up over frames: products for the mass on the pattern."""
    for frame in range(b.shape[0]):
        for o in range(s.body_operator.shape[0]):
            p, e = s.at[o], s.at[o + 1]
            kernels.products(s.indptr[p[5] : e[5]], s.indices[p[6] : e[6]], s.body_node[o], b[frame], w[frame], pairs[p[6] : e[6]])
