"""LU factors: dense and sparse, real and complex, as they are and transposed, singular and not finite."""

import numpy as np
import pytest
from scipy.sparse import csc_array

from polyida.linear.lu import LU, SingularSystem

KINDS = {"dense": np.asarray, "sparse": csc_array}


@pytest.mark.parametrize("pivoting", [False, True])
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("unit", [1.0, 1.0 + 2.0j])
def test_solves(kind, unit, pivoting):
    random = np.random.default_rng(0)
    matrix = unit * (5 * np.eye(4) + random.standard_normal((4, 4)))
    b = random.standard_normal((4, 2)).astype(matrix.dtype)
    lu = LU(KINDS[kind](matrix), pivoting)
    assert np.allclose(matrix @ lu.solve(b), b, rtol=0, atol=1e-13)
    assert np.allclose(matrix.T @ lu.solve(b[:, 0], transposed=True), b[:, 0], rtol=0, atol=1e-13)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("value", [1.0, np.nan, np.inf])
def test_what_has_no_inverse(kind, value):
    with pytest.raises(SingularSystem):
        LU(KINDS[kind](np.full((2, 2), value)))


def test_a_pivot_of_round_off_is_doubtful():
    x = np.linspace(1.0, 2.0, 5)
    for kind in KINDS.values():
        assert not LU(kind(np.eye(5))).doubtful() and LU(kind(np.diag([1e3, 1e3, 1.0, 1.0, 0.0]) + 1e-17 * np.eye(5))).doubtful()
    low = np.tril(np.outer(x, x), -1) / 4 + np.eye(5)  # of few binary digits, so that elimination is exact whatever library does it
    for last, doubtful in ((2.0**-49, True), (2.0**-30, False)):
        assert LU(low @ np.diag([1.0, 1.0, 1.0, 1.0, last]) @ low.T).doubtful() is doubtful
