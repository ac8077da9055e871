"""Matrices made of blocks."""

import numpy as np
import pytest
from scipy.sparse import csr_array

from polyida.linear.lu import block_matrix


@pytest.mark.parametrize("m", [2, 0])
@pytest.mark.parametrize("first", [np.asarray, csr_array])
@pytest.mark.parametrize("other", [np.asarray, csr_array])
def test_blocks_are_put_where_they_belong_in_a_matrix_of_the_kind_of_the_first(first, other, m):
    random, n = np.random.default_rng(1), 3
    S, B = random.standard_normal((n, n)) * (1 + 2j), random.standard_normal((m, n))
    found = block_matrix([[first(S), other(B.T)], [other(B), None]])
    assert hasattr(found, "tocsc") == (first is csr_array) and found.dtype == complex
    dense = found.toarray() if first is csr_array else found
    assert (dense == np.block([[S, B.T], [B, np.zeros((m, m))]])).all()
