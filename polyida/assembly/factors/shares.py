"""What every cell of a scene's plates gives to the arrays that kernels read: these are sums over cells, each times a factor of its own."""

from dataclasses import replace

import numpy as np

from polyida.assembly.arrays import concatenated, starts
from polyida.assembly.build import operator_arrays
from polyida.element.lanes import LANES
from polyida.element.paired import cells as kernels


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
