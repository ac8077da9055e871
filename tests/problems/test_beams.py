"""The spin-up beam and the rigid limit against their references."""

import numpy as np
import pytest

from polyida import problems
from polyida.integrate.alpha.generalized_alpha import GeneralizedAlpha
from polyida.integrate.start import consistent_state
from polyida.problems import rigid_limit, spin_up_beam
from polyida.run.solve import solve


def test_spin_up_profile_is_smooth_and_its_derivatives_are_right():
    turn = spin_up_beam.turn()
    for t in (3.0, 14.9, 17.0):
        assert turn.d1(t) == pytest.approx((turn.value(t + 1e-5) - turn.value(t - 1e-5)) / 2e-5, abs=1e-8)
        assert turn.d2(t) == pytest.approx((turn.d1(t + 1e-5) - turn.d1(t - 1e-5)) / 2e-5, abs=1e-8)
    before, after = (turn.at(15.0 + s) for s in (-1e-9, 1e-9))
    assert np.allclose(before, after, atol=1e-7) and turn.d1(15.0) == 6.0


def test_spin_up_beam_comes_to_its_steady_extension():
    p = problems.get("spin-up-beam", nx=65)
    run = solve(p.model, p.t_end, GeneralizedAlpha(h=1e-2))
    assert run.success and p.reference["extension"] == pytest.approx(5.142857e-4, rel=1e-6)
    assert spin_up_beam.steady_extension(run) == pytest.approx(p.reference["extension"], rel=1e-2)


def test_rigid_pendulum_keeps_its_energy():
    a1, a2, w1, w2 = rigid_limit.rigid_motion(1.0)
    m, M, L, g = rigid_limit.PLATE_MASS, rigid_limit.TIP_MASS, rigid_limit.LENGTH, rigid_limit.WEIGHT
    inertia = m * (L**2 + rigid_limit.HEIGHT**2) / 12
    first = L * w1 * np.array([-np.sin(a1), np.cos(a1)])
    second = L * w2 * np.array([-np.sin(a2), np.cos(a2)])
    speeds = m * (first / 2) @ (first / 2) + m * (first + second / 2) @ (first + second / 2) + M * (first + second) @ (first + second)
    kinetic = (speeds + inertia * (w1**2 + w2**2)) / 2
    heights = m * np.sin(a1) / 2 + m * (np.sin(a1) + np.sin(a2) / 2) + M * (np.sin(a1) + np.sin(a2))
    assert kinetic + g * L * heights == pytest.approx(0.0, abs=1e-10)


def test_the_rigid_state_meets_the_constraints_of_the_plates():
    p = problems.get("rigid-limit", cells=8)
    q, v = p.reference["q"], p.reference["v"]
    assert np.abs(p.model.phi(1.0, q)).max() < 1e-14 and np.abs(p.model.phi_q(1.0, q) @ v).max() < 1e-13


def test_rigid_joint_forces_are_those_at_the_start():
    p = problems.get("rigid-limit", cells=8, t_end=1e-6)
    started = consistent_state(p.model)
    assert started.lam == pytest.approx(p.reference["lam"], abs=5.0)  # sudden release: the plates' inertia is not yet rigid


def test_plates_come_near_to_rigid_ones_as_their_compliance():
    p = problems.get("rigid-limit", cells=8, modulus=1e12)
    errors = p.compare(solve(p.model, p.t_end, GeneralizedAlpha(h=1.25e-4, rho_inf=0.5, extrapolate=True), every=10**9))
    assert all(p.known_to[part] / 10 < error < p.known_to[part] for part, error in errors.items()), errors


def test_stiff_plates_move_as_rigid_bodies():
    p = problems.get("rigid-limit", cells=8)
    run = solve(p.model, p.t_end, GeneralizedAlpha(h=5e-4, rho_inf=0.5))
    errors = p.compare(run)
    assert errors["q"] < 2e-5 and errors["v"] < 2e-4 and errors["lam"] < 2e-3
