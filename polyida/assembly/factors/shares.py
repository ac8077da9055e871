"""What every cell of a scene's plates gives to the arrays that kernels read: these are sums over cells, each times a factor of its own."""

from dataclasses import replace

import numpy as np

from polyida.assembly.arrays import starts
from polyida.assembly.build import operator_arrays
from polyida.element.lanes import LANES


class Shares:
    """The arrays of a model's plates, an operator of its own for each, as functions of one factor a cell, plate after plate.

    plates: the arrays of full cells. cells (plates + 1,): the first cell of each plate. weight_cells (len(weights),), lane_cells: the cell
    of every weight and of every lane. mass, stabilisation (nnz, cells), sparse: what each cell adds on the node pattern; a row's entries
    stand in the order in which they were added up at first, so that factors of 1 give the same numbers to the bit.
    """

    def __init__(self, model):
        bodies = [replace(body, operator=replace(body.operator)) for body in model.bodies]
        shared = len({id(body.operator) for body in model.bodies}) < len(bodies)
        plates = model.arrays.plates
        self.plates = plates._replace(**operator_arrays(bodies)) if shared else plates
        self.cells = starts([body.operator.areas for body in bodies])
        operators = [body.operator for body in bodies]
        self.weight_cells, self.lane_cells = (
            _joined([cells + first for cells, first in zip(each, self.cells)], np.int64)
            for each in (map(_weight_cells, operators), (o.lane_cells for o in operators))
        )
        self.mass, self.stabilisation = (self._by_cell(operators, name) for name in ("cell_mass", "cell_stabilisation"))

    def scaled(self, stiffness, mass):
        """The plates' arrays for factors (cells,) of all cells."""
        return self.plates._replace(
            weights=self.plates.weights * stiffness[self.weight_cells], mass=self.mass @ mass, stabilisation=self.stabilisation @ stiffness
        )

    def of_plates(self, values):
        """A number of each plate (plates,) for each of its cells, (cells,)."""
        return np.repeat(values, np.diff(self.cells))

    def by_plate(self, model, values):
        """{plate: (its cells,)} of numbers of all cells."""
        return dict(zip((body.name for body in model.bodies), np.split(values, self.cells[1:-1])))

    def _by_cell(self, operators, name):
        """The sparse matrix of that name on the patterns of all plates, one behind the other; empty rows where an element has none."""
        from scipy.sparse import csr_array

        entries = [
            (pairs + place, cells + first, values)
            for operator, place, first in zip(operators, self.plates.at[:, 6], self.cells)
            for pairs, cells, values in _entries(operator, name)
        ]
        rows, columns, values = (
            _joined([entry[k].ravel() for entry in entries], kind) for k, kind in enumerate((np.int64, np.int32, float))
        )
        order, count = np.argsort(rows, kind="stable"), len(self.plates.mass)
        begin = np.append(0, np.cumsum(np.bincount(rows, minlength=count))).astype(np.int32)
        return csr_array((values[order], columns[order], begin), shape=(count, self.cells[-1]))


def _joined(parts, dtype):
    return np.concatenate([np.zeros(0, dtype), *parts]).astype(dtype)


def _weight_cells(operator):
    """The cell of every weight of an operator."""
    found = np.empty(len(operator.weights), np.int64)
    for (_, points, *_, start, _), cells in zip(operator.layout, operator.lane_cells.reshape(-1, LANES)):
        found[start : start + points * LANES] = np.tile(cells, points)
    return found


def _entries(operator, name):
    """(place in the node pattern, cell, value) of the cells' matrices, all (n, n, cells): of cells of n corners, in turn."""
    matrices = getattr(operator, name)
    if matrices is None:
        return
    for n in np.unique(operator.layout[:, 0]):
        of_n = operator.layout[:, 0] == n
        blocks = operator.layout[of_n, 5]
        order = np.argsort(blocks)
        cells = operator.lane_cells.reshape(-1, LANES)[of_n][order].ravel()
        part = slice(blocks.min(), blocks.max() + n * n * LANES)
        pairs, values = (np.moveaxis(x[part].reshape(-1, n, n, LANES), 0, 2).reshape(n, n, -1) for x in (operator.pairs, matrices))
        yield pairs, np.broadcast_to(cells, pairs.shape), values
