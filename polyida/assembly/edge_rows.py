"""Rows of contacts between edges of plates: their products at a position of the points.

What faces what changes with q, so that the arrays of a scene have no products of these rows; `links_at` appends them.
"""

import numpy as np

from polyida.joint.attachment import Ground
from polyida.validation import complex_of_pairs, pairs_of


class EdgeRows:
    """The rows of one contact between edges. first: number of its first row; far: gap of a point that faces nothing, m."""

    def __init__(self, first, contact, points, far):
        sides = self.sides = contact.edges
        self.first, self.far, self.step = first, far, 2 if contact.friction else 1
        self.held = isinstance(sides.first[0], Ground)  # it moves with any point, weighted by 0
        a, self.b = ([0 if isinstance(node, Ground) else points.add(node) for node in side] for side in (sides.first, sides.second))
        self.numbers, self.rest = np.array([*a, *self.b]), np.concatenate(sides.rest)
        self.rows, self.points = first + self.step * np.arange(sides.count), len(a)

    def products(self, dz):
        """(numbers of the rows of gaps, [(points (k, j), complex weights (k, j), values at rest (k,)) of three vectors of each product]).

        The vectors are the direction of the edge, the same turned by a right angle, and the mean vector from the edge to the first side.
        """
        count, at_rest = self.points, complex_of_pairs(self.rest)
        moves = self.rest + dz[self.numbers]
        moves[:count] = self.rest[:count] if self.held else moves[:count]
        pieces = self.sides.pieces(moves[:count], moves[count:])
        ends = count + self.sides.others[pieces.edge]
        along = complex_of_pairs(moves[ends[:, 0]] - moves[ends[:, 1]])
        direction = np.outer(1.0 / np.abs(along), (1.0 + 0j, -1.0))
        corners, weights = np.concatenate([pieces.points, ends], axis=1), pieces.weights + 0j
        vectors = [(ends, direction), (ends, 1j * direction), (corners, weights)]
        vectors = [(self.numbers[at], w, (w * at_rest[at]).sum(axis=1)) for at, w in vectors]
        if self.held:
            vectors[2][1][:, :2] = 0.0
        return self.rows[pieces.row], vectors


def links_at(links, contacts, dz):
    """Links with the products of the EdgeRows at displacements dz of the points."""
    constant, first = links.row_constant.copy(), len(links.vector_rest)
    product, vector = ([], [], [], []), ([], [], [], [])
    for contact in contacts:
        rows, vectors = contact.products(dz)
        constant[contact.rows] = contact.far
        constant[rows] = 0.0
        number = first + np.arange(3 * len(rows)).reshape(3, -1)
        first += number.size
        for points, weights, rest in vectors:
            for whole, each in zip(vector, (np.full(len(rows), points.shape[1]), points.ravel(), weights.ravel(), rest)):
                whole.append(each)
        for offset, one, rate in ((0, 1, False), (1, 0, True))[: contact.step]:  # the gap, and the slip
            for whole, each in zip(product, (rows + offset, number[one], number[2], np.full(len(rows), rate))):
                whole.append(each)
    rows, one, other, rate = map(np.concatenate, product)
    size, points, weights, rest = map(np.concatenate, vector)
    count = len(rows)
    return links._replace(
        row_constant=constant,
        product_row=np.append(links.product_row, rows),
        product_first=np.append(links.product_first, one),
        product_second=np.append(links.product_second, other),
        product_drive=np.append(links.product_drive, np.full(count, -1)),
        product_one_way=np.append(links.product_one_way, np.zeros(count, bool)),
        product_rate=np.append(links.product_rate, rate),
        vector_rest=np.concatenate([links.vector_rest, pairs_of(rest)]),
        vector_start=np.append(links.vector_start, links.vector_start[-1] + np.cumsum(size)),
        vector_points=np.append(links.vector_points, points),
        vector_weights=np.concatenate([links.vector_weights, pairs_of(weights)]),
    )
