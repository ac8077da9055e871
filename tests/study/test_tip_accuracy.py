"""Figures of what the defaults give: each is formed of all points above what is known, or not at all."""

import pytest

from work_precision import tip_accuracy
from work_precision.tip_accuracy import ALPHA, IDA_DEFAULT, ida_error_slope, newton_share


def rows(known=1e-12):
    """Made-up rows of all tasks: errors h^2 and rtol^0.7, Newton's part 1e-3 of it, twice that at the second step."""
    made = []
    for task in tip_accuracy.tasks(True):
        x = task["x"]
        error = x**2 if task["integrator"] == ALPHA else x**0.7
        part = 2e-3 if x == tip_accuracy.STEPS[1] else 1e-3
        made.append(task | {"error_tip": error, "newton_tip": part * error, "known_tip": known, "outcome": "done"})
    return made


def test_the_share_is_the_largest_and_the_slope_that_of_all_tolerances():
    assert newton_share(rows()) == {"newton_share": pytest.approx(2e-3)}
    assert ida_error_slope(rows()) == {"ida_error_slope": pytest.approx(0.7)}


def test_a_point_is_measured_against_the_digits():
    row = tip_accuracy.measure("scene 1, 1 s", ALPHA, 2e-3)
    assert 1e-5 < row["error_tip"] < 1e-3 and 0 < row["newton_tip"] < row["error_tip"] and row["known_tip"] < 1e-9
    row = tip_accuracy.measure("scene 1, 1 s", IDA_DEFAULT, 1e-3)
    assert row["outcome"] == "done" and 1e-7 < row["error_tip"] < 0.2 and "newton_tip" not in row
