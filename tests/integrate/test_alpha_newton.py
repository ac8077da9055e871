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


@pytest.mark.parametrize("h, linear", [(2e-3, "auto"), (5e-4, "auto"), (2e-3, "kkt")])
def test_newton_s_share_of_the_error(scene, h, linear):
    """Error of the tip against a run whose Newton goes on to 1e-10, over its error against the reference."""
    model, exact = scene
    run, tight = (pi.solve(model, END, pi.GeneralizedAlpha(h=h, linear=linear, **more)) for more in ({}, {"tolerance": 1e-10}))
    left = np.abs(run.position("tip")[-1] - tight.position("tip")[-1]).max()
    assert left <= 0.01 * np.abs(run.position("tip")[-1] - exact).max()
    assert run.counts.newton_iterations < 0.75 * tight.counts.newton_iterations


class Pulse(pi.Model):
    """A mass of 1 kg under a force of 1 N that lasts 10 ms about t = 2 s: the changes of q'' before it are below 1e-80."""

    n, m = 1, 0

    def mass(self, q):
        return np.eye(1)

    def force(self, t, q, v):
        return np.array([-np.exp(-0.5 * ((t - 2.0) / 0.01) ** 2)])


@pytest.mark.parametrize("h", [0.1, 0.2])
def test_no_prediction_exceeds_what_the_last_steps_justify(h):
    """The impulse that a step of h sees is at most the force times h, so the mass moves by h in a second."""
    run = pi.solve(Pulse(), 3.0, pi.GeneralizedAlpha(h=h))
    assert run.success and np.abs(run.v).max() < 1.5 * h
