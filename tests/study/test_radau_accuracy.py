"""Figures of Radau IIA in the work-precision study: orders are fitted where one cause of error alone is seen."""

import pytest

from work_precision import radau_accuracy as accuracy
from work_precision.selection import tasks


def rows(floor=0.0):
    """Made-up rows: errors of order 5, 1e-5 at the largest step that is fitted, no smaller than a floor; known to 1e-14."""
    made = []
    for task in [task for task in tasks(True) if task["integrator"] == accuracy.FIXED and task["problem"] in accuracy.ASYMPTOTIC]:
        share = task["x"] / accuracy.ASYMPTOTIC[task["problem"]]
        errors = {f"error_{part}": max(1e-5 * share**5, floor) for part in accuracy.PARTS}
        made.append(task | errors | {"steps": 1 / share, "known": dict.fromkeys(accuracy.PARTS, 1e-14)})
    return made


def test_the_order_is_the_one_farthest_from_five():
    made = rows()
    for row in made:
        if row["problem"] == "pendulum":
            row["error_v"] = 1e-5 * row["steps"] ** -4.8
    found = accuracy.orders(made)
    assert found["radau_order_v"] == found["radau_order_v_pendulum"] == pytest.approx(4.8)
    assert [found["radau_order_q"], found["radau_order_lam_damped_ramp"]] == pytest.approx([5.0, 5.0])


def test_errors_near_what_is_known_and_steps_that_are_too_long_are_not_fitted():
    problem = "damped-ramp"
    made = [row | {"known": {"q": 1e-8}} for row in rows(floor=9e-8) if row["problem"] == problem]
    for row in made:
        if row["x"] > 1.1 * accuracy.ASYMPTOTIC[problem]:
            row["error_q"] = 1.0
    assert accuracy.order(made, problem, "q") == pytest.approx(5.0)
    assert 1 < len(accuracy.fitted_rows(made, problem, "q")) < accuracy.FINER
