"""The small dense solve of compiled code."""

import numpy as np
import pytest

from polyida.linear.dense import solve_small


@pytest.mark.parametrize("turn", [1.0, 0.6 + 0.8j])
def test_a_small_system_real_or_complex(turn):
    """With a column that is zero but for its last row, so that rows are exchanged."""
    random = np.random.default_rng(4)
    matrix, b = turn * random.standard_normal((6, 6)), turn * random.standard_normal(6)
    matrix[:-1, 0] = 0.0
    exact, x = np.linalg.solve(matrix, b), b.copy()
    assert solve_small(matrix.copy(), x) and np.allclose(x, exact, rtol=1e-10)
    assert not solve_small(np.zeros_like(matrix), x)
