"""Order and round-off of generalized-alpha against runs that share no code with it."""

import pytest

from polyida.study.rows import fit_slope
from step_size_sensitivity import errors as sensitivity

STEPS = [1e-2 / 2**k for k in range(4)]


@pytest.mark.parametrize("kind", ["load", "motors"])
def test_second_order_from_the_first_step_on(kind):
    errors = [sensitivity.order_errors(kind, 4, 1e-2, k, 0.05) for k in range(4)]
    for part in ("q", "v", "lam"):
        assert fit_slope(STEPS, [error[part] for error in errors]) == pytest.approx(2.0, abs=0.12), part


def tiny(h, **settings):
    return sensitivity.tiny_steps("smooth motors", 4, h, 1e-9, 1e-8, **settings)


def test_carried_constraints_are_clean_at_tiny_steps():
    row = tiny(1e-9)
    assert row["outcome"] == "done" and row["error_lam"] < 1e-10 and row["error_a"] < 1e-7


def test_constraints_from_positions_are_not():
    row = tiny(1e-9, incremental_phi=False)
    assert row["error_lam"] > 1e-5 and row["error_a"] > 1e-2


def test_newton_stalls_at_round_off_over_h_squared():
    stalls = [tiny(1e-9, incremental_phi=carried)["stall_q"] for carried in (True, False)]
    assert stalls[0] < 1e-8 < 1e-6 < stalls[1]
