"""The number of directions in which a matrix is negative on a null space, against its eigenvalues there."""

import numpy as np
import pytest
from scipy.linalg import null_space
from scipy.sparse import csc_array, csr_array

from polyida.linear.saddle import negative_directions


@pytest.mark.parametrize("m", [0, 1, 4])
@pytest.mark.parametrize("sparse", [False, True])
def test_it_counts_the_negative_eigenvalues_on_the_null_space(sparse, m):
    random = np.random.default_rng(7 + m)
    for shift in (0.0, 6.0, 20.0):
        matrix, border = random.standard_normal((20, 20)), random.standard_normal((m, 20))
        matrix = 1e6 * (matrix + matrix.T + shift * np.eye(20))
        space = null_space(border) if m else np.eye(20)
        expected = int(np.sum(np.linalg.eigvalsh(space.T @ matrix @ space) < 0))
        assert negative_directions(*(csc_array(matrix), csr_array(border)) if sparse else (matrix, border)) == expected


def test_a_floating_body_counts_as_held_by_its_constraints():
    """K alone is singular: a spring between two points that one row holds."""
    matrix = np.array([[1.0, -1.0], [-1.0, 1.0]])
    for border, expected in (([[1.0, 0.0]], 0), ([[1.0, 1.0]], 0)):
        assert negative_directions(csc_array(matrix), csr_array(np.array(border))) == expected
        assert negative_directions(csc_array(-matrix), csr_array(np.array(border))) == 1


def test_a_matrix_that_is_not_symmetric_is_not_judged():
    assert negative_directions(np.array([[1.0, 1.0], [0.0, 1.0]]), np.zeros((0, 2))) is None
