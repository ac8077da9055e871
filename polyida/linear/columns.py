"""The solve with a multifrontal factor (fronts.py) for COLUMNS right-hand sides at once, with one pass through the factor.

The right-hand sides stand beside each other, x (n, COLUMNS) float32. A vector holds the two rows of a node, 2 COLUMNS numbers; each entry of U is
spread over the columns. As in fronts.py, four rows of U are used at a time. Fronts on which x is zero cost as much as others.
"""

import numpy as np

from polyida.jit import part, shared
from polyida.jit.intrinsics import COLUMNS, columns, load_columns, load_spread, store, traced, zero_columns

NODE = 2 * COLUMNS  # numbers of a node
LOW, HIGH = list(range(COLUMNS)), list(range(COLUMNS, NODE))  # places of its rows


def both(row):
    """A function that writes one row of a node, at the places LOW or HIGH, to both rows."""
    return lambda x: x.shuffled(x, row + row)


first_row, second_row = both(LOW), both(HIGH)


def joined(a, b):
    """A node with the first row of a and the second row of b."""
    return a.shuffled(b, LOW + [NODE + k for k in HIGH])


def folded(x):
    """The sum of the rows of a node, in both rows."""
    return x + x.shuffled(x, HIGH + LOW)


@traced(6, columns)
def forward_rows(x, y, a1, a2, a3, b2, b3, c3):
    """(p, q, r, s, x, y): the four rows of two nodes after the forward solve with U^T, and the new nodes x and y.

    p, q, r and s stand in both rows of a vector each. a1, ..., c3: entries of U above its unit diagonal in its rows a, b, c, for the rows
    of the two nodes.
    """
    p, r = first_row(x), first_row(y)
    q = second_row(x) - a1 * p
    r = r - a2 * p - b2 * q
    s = second_row(y) - a3 * p - b3 * q - c3 * r
    return p, q, r, s, joined(p, q), joined(r, s)


@traced(1, columns)
def less_four(x, a, b, c, d, p, q, r, fronts):
    """The node `x - (a p + b q + c r + d fronts)`: entries of four rows of U times the solved rows p, q, r and, as the fourth, `fronts`."""
    return x - (a * p + b * q + c * r + d * fronts)


@traced(3, columns)
def forward_two_rows(x, a1):
    """(p, q, x): the two rows of a node after the forward solve with U^T, in both rows of a vector each, and the new x; a1: of U."""
    p = first_row(x)
    q = second_row(x) - a1 * p
    return p, q, joined(p, q)


@traced(1, columns)
def less_two(x, a, b, p, q):
    """The node `x - (a p + b q)`: entries a and b of two rows of U times the solved rows p and q."""
    return x - (a * p + b * q)


@traced(4, columns)
def products_of_four(sums, x, a, b, c, d):
    """The four sums, each plus an entry of U times x: `sums[0] + a x` to `sums[3] + d x`, as a new tuple."""
    return tuple(total + row * x for total, row in zip(sums, (a, b, c, d)))


@traced(2, columns)
def products_of_two(sums, x, a, b):
    """(sums[0] + a x, sums[1] + b x): two sums with the next entries a and b of two rows of U times x."""
    return sums[0] + a * x, sums[1] + b * x


@traced(2, columns)
def backward_rows(x, y, sums, a0, b1, c2, d3, a1, a2, a3, b2, b3, c3):
    """The two nodes (x, y) after the backward solve with U, from their old values times D^-1 less the sums over the places behind them.

    a0, b1, c2, d3: of D^-1; a1, ..., c3: entries of U above its diagonal; sums: four, of `products_of_four`.
    """
    p, q, r, s = (folded(total) for total in sums)
    s = second_row(y) * d3 - s
    r = first_row(y) * c2 - r - c3 * s
    q = second_row(x) * b1 - q - b2 * r - b3 * s
    p = first_row(x) * a0 - p - a1 * q - a2 * r - a3 * s
    return joined(p, q), joined(r, s)


@traced(1, columns)
def backward_two_rows(x, sums, a0, b1, a1):
    """The node x after the backward solve with U: its old value times D^-1 (a0, b1), less the sums of `products_of_two`; a1: of U."""
    p, q = (folded(total) for total in sums)
    q = second_row(x) * b1 - q
    p = first_row(x) * a0 - p - a1 * q
    return joined(p, q)


@traced(1, columns)
def sum_of(x, y):
    """The sum x + y of two values, column by column."""
    return x + y


@shared
def solve_columns(fronts, panels, columns):
    """Each of the columns <- S^-1 times it, in the places of fronts.order, columns (n, COLUMNS)."""
    work = np.empty((fronts.size, COLUMNS), np.float32)
    for f in range(fronts.children.shape[0]):
        descend(fronts, panels, columns, work, f)
    for f in range(fronts.children.shape[0] - 1, -1, -1):
        ascend(fronts, panels, columns, work, f)


@part
def descend(fronts, panels, columns, work, front):
    """The forward half of the solve on one front, for all columns."""
    first, own, low = fronts.first[front], fronts.first[front + 1] - fronts.first[front], fronts.start[front]
    nodes = own + fronts.start[front + 1] - low
    for k in range(own):
        store(work, k * NODE, (load_columns(columns, (first + k) * NODE),))
    for k in range(own, nodes):
        store(work, k * NODE, (zero_columns(),))
    forward(panels, fronts.panel[front], work, own, nodes)
    for k in range(own):
        store(columns, (first + k) * NODE, (load_columns(work, k * NODE),))
    for k in range(own, nodes):
        place = fronts.rows[low + k - own] * NODE
        store(columns, place, (sum_of(load_columns(columns, place), load_columns(work, k * NODE)),))


@part
def ascend(fronts, panels, columns, work, front):
    """The backward half of the solve on one front, for all columns."""
    first, own, low = fronts.first[front], fronts.first[front + 1] - fronts.first[front], fronts.start[front]
    nodes = own + fronts.start[front + 1] - low
    for k in range(own):
        store(work, k * NODE, (load_columns(columns, (first + k) * NODE),))
    for k in range(own, nodes):
        store(work, k * NODE, (load_columns(columns, fronts.rows[low + k - own] * NODE),))
    backward(panels, fronts.panel[front + 1], work, own, nodes)
    for k in range(own):
        store(columns, (first + k) * NODE, (load_columns(work, k * NODE),))


@part
def forward(panels, at, work, own, nodes):
    """work <- U^-T work on the front's own nodes, and less their part on the others, `nodes` in all; the panel starts at `at`."""
    for k in range(0, own - 1, 2):
        m = 2 * (nodes - k)
        b, c, d = at + m, at + 2 * m, at + 3 * m
        x, y = load_columns(work, k * NODE), load_columns(work, (k + 1) * NODE)
        a1, a2, a3, b2, b3, c3 = panels[at + 1], panels[at + 2], panels[at + 3], panels[b + 2], panels[b + 3], panels[c + 3]
        p, q, r, s, x, y = forward_rows(x, y, a1, a2, a3, b2, b3, c3)
        store(work, k * NODE, (x,))
        store(work, (k + 1) * NODE, (y,))
        for j in range(4, m, 2):
            here = (2 * k + j) * COLUMNS
            rows = load_spread(panels, at + j), load_spread(panels, b + j), load_spread(panels, c + j), load_spread(panels, d + j)
            store(work, here, (less_four(load_columns(work, here), rows[0], rows[1], rows[2], rows[3], p, q, r, s),))
        at += 4 * m
    if own % 2:
        k = own - 1
        m = 2 * (nodes - k)
        p, q, x = forward_two_rows(load_columns(work, k * NODE), panels[at + 1])
        store(work, k * NODE, (x,))
        for j in range(2, m, 2):
            here = (2 * k + j) * COLUMNS
            store(work, here, (less_two(load_columns(work, here), load_spread(panels, at + j), load_spread(panels, at + m + j), p, q),))


@part
def backward(panels, at, work, own, nodes):
    """work <- U^-1 D^-1 work on the front's own nodes, the others of `nodes` given; its panel ends at `at`."""
    if own % 2:
        k = own - 1
        m = 2 * (nodes - k)
        at -= 2 * m
        two = zero_columns(), zero_columns()
        for j in range(2, m, 2):
            x = load_columns(work, (2 * k + j) * COLUMNS)
            two = products_of_two(two, x, load_spread(panels, at + j), load_spread(panels, at + m + j))
        store(work, k * NODE, (backward_two_rows(load_columns(work, k * NODE), two, panels[at], panels[at + m + 1], panels[at + 1]),))
    for k in range(own // 2 * 2 - 2, -1, -2):
        m = 2 * (nodes - k)
        at -= 4 * m
        b, c, d = at + m, at + 2 * m, at + 3 * m
        sums = zero_columns(), zero_columns(), zero_columns(), zero_columns()
        for j in range(4, m, 2):
            x = load_columns(work, (2 * k + j) * COLUMNS)
            sums = products_of_four(
                sums, x, load_spread(panels, at + j), load_spread(panels, b + j), load_spread(panels, c + j), load_spread(panels, d + j)
            )
        x, y = load_columns(work, k * NODE), load_columns(work, (k + 1) * NODE)
        a1, a2, a3, b2, b3, c3 = panels[at + 1], panels[at + 2], panels[at + 3], panels[b + 2], panels[b + 3], panels[c + 3]
        x, y = backward_rows(x, y, sums, panels[at], panels[b + 1], panels[c + 2], panels[d + 3], a1, a2, a3, b2, b3, c3)
        store(work, k * NODE, (x,))
        store(work, (k + 1) * NODE, (y,))
