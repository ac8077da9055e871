"""The runs of the study of what integrators choose: their errors are those of published digits, over the size."""

import numpy as np
import pytest

import polyida as pi
from defaults.runs import case, measure


def test_errors_are_those_of_published_digits():
    p, own, given = pi.problems.get("andrews"), measure("andrews", "ida"), measure("andrews", "ida", 1e-7)
    size = case("andrews").size
    assert size == pytest.approx(np.abs(p.reference["q"]).max(), rel=1e-3)
    run = pi.solve(p.model, p.t_end, pi.IDA(), q0=p.q0, v0=p.v0)
    assert own["error_end"] == pytest.approx(p.compare(run)["q"] / size, rel=1e-3) and own["steps"] == run.counts.steps
    assert own["known"]["q"] < 1e-8 and 10 * given["error_end"] < own["error_end"] <= own["error_max"] < 1e-3
