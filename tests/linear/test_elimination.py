"""The elimination along a graph, against numpy's dense solve."""

import numpy as np
import pytest

from polyida.linear.elimination import eliminate, elimination, expand, positions, solve

SHAPES = {
    "nothing": (0, []),
    "one": (1, []),
    "alone": (4, [[0, 2]]),
    "chain": (24, [range(3 * k, 3 * k + 6) for k in range(7)]),
    "loop": (24, [[(3 * k + i) % 24 for i in range(5)] for k in range(8)]),
    "star": (21, [[0, 1, *range(2 + 3 * k, min(5 + 3 * k, 21))] for k in range(7)]),
    "ladder": (60, [*([3 * k, 3 * k + 1, 3 * k + 3, 3 * k + 4] for k in range(19)), *(range(3 * k, 3 * k + 3) for k in range(20))]),
    "all": (9, [range(9)]),
}


def system(count, groups, turn, seed=0):
    """(Elimination, values, matrix, b) of a random system, each group adding a block with a large diagonal."""
    random, made = np.random.default_rng(seed), elimination(count, groups)
    values, matrix, b = np.zeros(made.start[-1], type(turn)), np.zeros((count, count), type(turn)), turn * random.standard_normal(count)
    for group in [*groups, *([u] for u in range(count))]:
        rows, columns = (each.ravel() for each in np.meshgrid(group, group))
        block = turn * (random.standard_normal(len(rows)) + 2.0 * len(group) * (rows == columns))
        np.add.at(values, positions(made, rows, columns), block)
        np.add.at(matrix, (rows, columns), block)
    return made, values, matrix, b


@pytest.mark.parametrize("turn", [1.0, 0.6 + 0.8j])
@pytest.mark.parametrize("shape", SHAPES)
def test_it_solves_what_numpy_solves(shape, turn):
    made, values, matrix, b = system(*SHAPES[shape], turn)
    found, x = np.empty_like(matrix), np.empty_like(b)
    expand(made, values, found)
    assert np.array_equal(found, matrix) and eliminate(made, values, x)
    solve(made, values, b, x)
    assert np.allclose(x, np.linalg.solve(matrix, b), rtol=1e-12, atol=1e-13)
    other = b[::-1] + 1.0
    solve(made, values, other, x)
    assert np.allclose(x, np.linalg.solve(matrix, other), rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("turn", [1.0, 0.6 + 0.8j])
def test_a_pivot_that_is_too_small_is_told(turn):
    made, values, matrix, b = system(*SHAPES["chain"], turn)
    rows, columns = (each.ravel() for each in np.meshgrid(range(3), range(3)))
    values[positions(made, rows, columns)] = turn  # the first three unknowns alike
    values[positions(made, *np.array([(i, j) for i in range(3) for j in range(3, 6)]).T)] = 0.0
    assert not eliminate(made, values, np.empty_like(b))
    made, values, *_ = system(*SHAPES["loop"], turn)
    assert not eliminate(made, np.full_like(values, np.nan), np.empty(24, type(turn)))
