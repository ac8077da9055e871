"""Runs whose last states and counts stay as they are when code is rewritten (`golden.py`), as far as rounding allows.

`python tests/golden.py --check` compares bits, on the machine that wrote the file. Machines with equal processors may differ in their last
bits, so tests do not ask for them: with other kernels of BLAS and without fused multiply-add the states change by 1.5e-8 of the largest.
"""

import json

import numpy as np
import pytest
from golden import FILE, RUNS, result

KNOWN = json.loads(FILE.read_text())
BOUND = 1e-6  # a factor of 60 above what was seen


@pytest.mark.parametrize("name", RUNS)
def test_a_run_is_as_it_was(name):
    found, known = result(name), KNOWN[name]
    for what, (largest, total) in known["sizes"].items():
        np.testing.assert_allclose(found["sizes"][what], [largest, total], rtol=0.0, atol=BOUND * largest + 1e-15, err_msg=what)
    for count, number in known["counts"].items():  # another rounding may end Newton's method an iteration earlier or later
        assert abs(found["counts"][count] - number) <= 1 + number // 20, count
