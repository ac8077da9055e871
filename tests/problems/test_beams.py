"""The spin-up beam and the rigid limit against their references."""

import numpy as np
import pytest

from polyida import problems
from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.problems import literature
from polyida.run.solve import solve


def test_spin_up_profile_is_smooth_and_its_derivatives_are_right():
    turn = literature.turn()
    for t in (3.0, 14.9, 17.0):
        assert turn.d1(t) == pytest.approx((turn.value(t + 1e-5) - turn.value(t - 1e-5)) / 2e-5, abs=1e-8)
        assert turn.d2(t) == pytest.approx((turn.d1(t + 1e-5) - turn.d1(t - 1e-5)) / 2e-5, abs=1e-8)
    before, after = (turn.at(15.0 + s) for s in (-1e-9, 1e-9))
    assert np.allclose(before, after, atol=1e-7) and turn.d1(15.0) == 6.0


def test_spin_up_beam_comes_to_its_steady_extension():
    p = problems.get("spin-up-beam", nx=65)
    run = solve(p.model, p.t_end, GeneralizedAlpha(h=1e-2))
    assert run.success and p.reference["extension"] == pytest.approx(5.142857e-4, rel=1e-6)
    assert literature.steady_extension(run) == pytest.approx(p.reference["extension"], rel=1e-2)


def test_plates_come_near_to_rigid_ones_as_their_compliance():
    p = problems.get("rigid-limit", cells=8, modulus=1e12)
    errors = p.compare(solve(p.model, p.t_end, GeneralizedAlpha(h=1.25e-4, rho_inf=0.5, extrapolate=True), every=10**9))
    assert all(p.known_to[part] / 10 < error < p.known_to[part] for part, error in errors.items()), errors


def test_stiff_plates_move_as_rigid_bodies():
    p = problems.get("rigid-limit", cells=8)
    run = solve(p.model, p.t_end, GeneralizedAlpha(h=5e-4, rho_inf=0.5))
    errors = p.compare(run)
    assert errors["q"] < 2e-5 and errors["v"] < 2e-4 and errors["lam"] < 2e-3
