"""Energy and momentum of free and hanging plates, and the order of BDF."""

import numpy as np
import pytest

from bdf_order.order import run_order
from energy import long_run
from polyida.integrate.start import consistent_state


def test_the_thrown_plates_start_on_their_constraints():
    model, v0 = long_run.thrown(4)
    assert np.abs(model.phi_q(0.0, np.zeros(model.n)) @ v0).max() < 1e-14
    assert consistent_state(model, 0.0, None, v0).v == pytest.approx(v0)


def test_energy_momentum_keeps_what_its_name_says():
    row = long_run.balance("thrown", "energy-momentum", 2e-3, 0.1, 4)
    assert max(row["energy_drift"], row["linear_drift"], row["angular_drift"]) < 1e-10


def test_generalized_alpha_loses_a_little_energy():
    row = long_run.balance("swinging", "alpha, rho 0.5", 2e-3, 0.3, 4)
    assert row["outcome"] == "done" and 0 < row["energy_drift"] < 1e-2


def test_momenta_of_a_rigid_translation():
    model, _ = long_run.thrown(4)
    mass = float(model.mass().sum()) / 2
    found = model.momenta(np.zeros(model.n), np.tile([1.0, 2.0], model.n // 2))
    assert found[:2] == pytest.approx([mass, 2 * mass])


def test_high_orders_cost_undamped_plates_many_steps():
    two, four = (run_order(20, 0.3, 0.0, order, cap=3000) for order in (2, 4))
    assert two["tip_error"] < 1e-4 and four["steps_per_s"] > 3 * two["steps_per_s"]
