"""Andrews' mechanism from parts, the rigid double pendulum and the N-four-bar: known motions of rigid bodies."""

import numpy as np
import pytest

import polyida as pi
from polyida import problems
from polyida.problems import andrews, literature

TIGHT = {"IDA": pi.IDA(rtol=1e-11, atol=1e-14), "RadauIIA": pi.RadauIIA(rtol=1e-10)}
LEVEL = {1: 0.708450008836, 2: 0.714355529293}  # s, by windows: when the bars are level


@pytest.mark.parametrize("name", TIGHT)
def test_andrews_from_parts_comes_to_the_published_digits(name):
    p = problems.get("andrews-parts")
    run = pi.solve(p.model, p.t_end, TIGHT[name])
    assert run.success, run.message
    angles, rates = andrews.angles(run)[-1], andrews.rates(run)[-1]
    assert np.abs(angles - andrews.PRINTED["q"]).max() < 1e-7
    assert np.abs(rates / andrews.PRINTED["v"] - 1.0).max() < 1e-6
    assert p.compare(run)["angles"] < 1e-7


@pytest.mark.parametrize("meshed", [True, False])
@pytest.mark.parametrize("name", TIGHT)
def test_a_rigid_double_pendulum_follows_its_differential_equation(name, meshed):
    p = problems.get("rigid-pendulum", meshed=meshed)
    run = pi.solve(p.model, p.t_end, TIGHT[name])
    errors = p.compare(run)
    assert run.success and errors["point"] < 1e-8 and errors["velocity"] < 1e-7, errors


@pytest.mark.parametrize("name", TIGHT)
def test_windows_fall_as_their_one_angle_says(name):
    p = problems.get("n-four-bar")
    errors = p.compare(pi.solve(p.model, p.t_end, TIGHT[name]))
    assert errors["point"] < 1e-8 and errors["velocity"] < 1e-7, errors


INTEGRATORS = {"alpha": pi.GeneralizedAlpha(h=1e-3), "IDA": pi.IDA(rtol=1e-8), "RadauIIA": pi.RadauIIA(rtol=1e-6)}


@pytest.mark.parametrize("windows", [1, 2])
@pytest.mark.parametrize("name", INTEGRATORS)
def test_past_the_singular_position_windows_are_right_or_stopped_with_its_joints(name, windows):
    """Over 3 s the bars are level twice. Frames are on the parallelograms' branch with their energy; a run that ends early ends where bars are level."""
    p = problems.get("n-four-bar", windows=windows, t_end=3.0)
    run = pi.solve(p.model, p.t_end, INTEGRATORS[name])
    angles = np.array([literature.turning(t, windows)[0] for t in run.t[1 :: len(run) // 20]])
    places = run.position("B0")[1 :: len(run) // 20]
    assert np.abs(places - np.stack([np.cos(angles), np.sin(angles)], axis=1)).max() < 1e-3
    assert np.ptp(run.energy.total) < 2e-3 * np.ptp(run.energy.kinetic)
    if not run.success:
        assert run.status == "singular" and "the motion can branch" in run.message and abs(run.t[-1] - LEVEL[windows]) < 0.02, run.message
