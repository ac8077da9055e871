"""Constraints carried by increments: exact changes, clean multipliers and accelerations down to h = 1e-9, no drift."""

import numpy as np
import pytest

import polyida as pi
from polyida.assembly import increments, joints
from polyida.integrate.start import consistent_acceleration
from polyida.integrate.state import State
from polyida.problems import plates


@pytest.fixture(scope="module")
def driven():
    return plates.double_plate_motors(cells=20).build()


@pytest.fixture(scope="module")
def moving(driven):
    """The driven double plate in the midst of its motion, on its constraints."""
    s = pi.solve(driven, 0.45, pi.GeneralizedAlpha(h=1e-3)).state
    rate = driven.phi_q(s.t, s.q) @ s.v + driven.phi_t(s.t, s.q)
    v = s.v + driven.mass_system(s.t, s.q).solve(np.zeros(driven.n), rate)[0]
    return State(s.t, s.q, v, *consistent_acceleration(driven, s.t, s.q, v))


def errors(model, run):
    """Largest relative deviation of a and lam from consistent ones at the run's own states."""
    found = []
    for k in range(1, len(run)):
        a, lam = consistent_acceleration(model, run.t[k], run.q[k], run.v[k])
        found.append([np.abs(run.a[k] - a).max() / np.abs(a).max(), np.abs(run.lam[k] - lam).max() / np.abs(lam).max()])
    return np.max(found, axis=0)


@pytest.mark.parametrize("form", ["index3", "stabilised"])
@pytest.mark.parametrize("linear", ["auto", "kkt"])
def test_clean_at_1e_9(driven, moving, linear, form):
    run = pi.solve(driven, moving.t + 20e-9, pi.GeneralizedAlpha(h=1e-9, tolerance=1e-10, linear=linear, form=form), state=moving)
    a, lam = errors(driven, run)
    assert run.success and a < 1e-7 and lam < 1e-9  # 1.1e-10 on one kind of processor


@pytest.mark.parametrize("linear", ["auto", "kkt"])
def test_polluted_where_phi_comes_from_positions(driven, moving, linear):
    for h, expected in ((1e-7, 1e-2), (1e-9, 1e2)):
        run = pi.solve(driven, moving.t + 20 * h, pi.GeneralizedAlpha(h=h, linear=linear, incremental_phi=False), state=moving)
        assert run.success and errors(driven, run)[0] > expected


def test_no_drift_over_many_steps(driven):
    run = pi.solve(driven, 1.0, pi.GeneralizedAlpha(h=1e-4), every=100)
    assert run.drift.max() < 1e-12


def test_change_of_phi_and_rate(scenes, kind):
    """Against values at both ends of a large move, where nothing cancels."""
    model, random, h = scenes.jointed(kind, pi.profile.sine(0.5, 1.0, 0.1)).build(), np.random.default_rng(3), 0.05
    q, v, dd, dv = (0.1 * random.standard_normal(model.n) for _ in range(4))
    times = np.array([0.2, 0.2 + h])
    drives = increments.drive_table(model, times, times[[0, -1]])
    gains = increments.gain_table(model, times, drives, h)
    level = lambda t, q, v: (model.phi(t, q), model.phi_q(t, q) @ v + model.phi_t(t, q))  # noqa: E731
    phi, rate = (np.array(x) for x in level(times[0], q, v))
    joints.joint_change(model.arrays.links, drives[0], gains[0], h, np.stack([model.dz(x) for x in (q, v, dd, dv)]), phi, rate)
    expected = level(times[1], q + h * v + dd, v + dv)
    assert np.allclose(phi, expected[0], atol=1e-13) and np.allclose(rate, expected[1], atol=1e-12)
