"""What Newton leaves, where its tolerance follows the local error: no hundredth of the steps' own error, on either path."""

import numpy as np
import pytest

import polyida as pi
from polyida.problems import plates

END = 0.25


@pytest.fixture(scope="module", params=[plates.double_plate, plates.double_plate_motors])
def scene(request):
    """(model, its tip at END by small steps, extrapolated)."""
    model = request.param(cells=20).build()
    fine = pi.GeneralizedAlpha(h=1e-4, tolerance=1e-9, extrapolate=True)
    return model, pi.solve(model, END, fine, every=10**9).position("tip")[-1]


@pytest.mark.parametrize("linear", ["auto", "kkt"])
@pytest.mark.parametrize("h", [2e-3, 1e-3, 5e-4])
def test_newton_s_share_of_the_error(scene, h, linear):
    """Error of the tip against a run whose Newton goes on to 1e-10, over its error against the reference."""
    model, exact = scene
    run, tight = (pi.solve(model, END, pi.GeneralizedAlpha(h=h, linear=linear, **more)) for more in ({}, {"tolerance": 1e-10}))
    left = np.abs(run.position("tip")[-1] - tight.position("tip")[-1]).max()
    assert left <= 0.01 * np.abs(run.position("tip")[-1] - exact).max()
    assert run.counts.newton_iterations < 0.75 * tight.counts.newton_iterations


@pytest.mark.parametrize("linear", ["auto", "kkt"])
def test_a_tolerance_by_hand_is_kept(scenes, linear):
    model = scenes.jointed("revolute").build()
    work = [
        pi.solve(model, 0.05, pi.GeneralizedAlpha(h=1e-3, linear=linear, tolerance=tolerance)).counts.newton_iterations
        for tolerance in (1e-3, 1e-6, 1e-9)
    ]
    assert work[0] < work[1] < work[2]


def test_free_fall_is_cheap(scenes):
    """q'' does not change, and an error of it that did not would never be met: at least 1e-7 of q'' is allowed."""
    run = pi.solve(scenes.single((0.0, -9.81))[0].build(), 0.05, pi.GeneralizedAlpha(h=1e-3))
    assert run.success and run.counts.newton_iterations <= 1.1 * run.counts.steps


@pytest.mark.parametrize("tolerance", [0.0, 1.0, -1e-4, "tight", float("nan")])
def test_a_tolerance_out_of_range(tolerance):
    with pytest.raises(pi.InputError, match="tolerance = .* None"):
        pi.GeneralizedAlpha(1e-3, tolerance=tolerance)
