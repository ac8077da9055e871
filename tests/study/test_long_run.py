"""Energy and momentum of free and hanging plates, and the order of BDF."""

from bdf_order.order import run_order
from energy import long_run


def test_energy_momentum_keeps_what_its_name_says():
    row = long_run.balance("thrown", "energy-momentum", 2e-3, 0.1, 4)
    assert max(row["energy_drift"], row["linear_drift"], row["angular_drift"]) < 1e-10


def test_generalized_alpha_loses_a_little_energy():
    row = long_run.balance("swinging", "alpha, rho 0.5", 2e-3, 0.3, 4)
    assert row["outcome"] == "done" and 0 < row["energy_drift"] < 1e-2


def test_high_orders_cost_undamped_plates_many_steps():
    two, four = (run_order(20, 0.3, 0.0, order, cap=3000) for order in (2, 4))
    assert two["tip_error"] < 1e-4 and four["steps_per_s"] > 3 * two["steps_per_s"]
