"""Means over time of runs of Radau IIA, whose states are more accurate than the trapezoidal rule over the frames."""

import numpy as np
import pytest

import polyida as pi
from polyida.problems.plates import double_plate

P = pi.objective


@pytest.fixture(scope="module")
def model():
    return double_plate(cells=20).build()


def trapezoid(objective, run):
    """The mean over the frames of values at each frame."""
    values = [
        objective(pi.objective.objective.OneFrame(run.model, *(x[k : k + 1] for x in (run.t, run.q, run.v, run.a, run.lam))))
        for k in range(len(run))
    ]
    return float(np.trapezoid(values, run.t) / np.ptp(run.t))


@pytest.mark.parametrize(("settings", "every"), [({"h": 0.01}, 1), ({"h": 5e-3}, 2), ({"rtol": 1e-5}, 1)])
def test_the_rule_is_as_accurate_as_the_states(model, settings, every):
    tip = P.Deviation("tip", (0.3, -0.1))
    exact = tip(pi.solve(model, 0.5, pi.RadauIIA(rtol=1e-8)))
    run = pi.solve(model, 0.5, pi.RadauIIA(**settings), every=every)
    assert abs(tip(run) - exact) < 2e-3 * abs(trapezoid(tip, run) - exact)


def test_slopes_of_slices_are_those_of_the_run(model):
    run, goal = pi.solve(model, 0.1, pi.RadauIIA(h=0.01, tolerance=1e-12)), P.Deviation("tip", (0.3, -0.1)) + P.StrainEnergy()
    slopes = goal.slopes(run)
    whole, parts = slopes(slice(None)), [slopes(slice(k, k + 3)) for k in range(0, len(run), 3)]
    for name in ("q", "v"):
        assert np.allclose(getattr(whole, name), np.concatenate([getattr(one, name) for one in parts]), rtol=1e-9, atol=1e-12)
    assert np.allclose(whole.by_time(), np.concatenate([one.by_time() for one in parts]))
    assert max(pi.check_gradient(run, goal, parameters=["upper.stiffness", "tip.mass", "v0"]).values()) < 1e-6


def test_a_motor_whose_rate_jumps():
    """v of a frame is not that of the interval behind it."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    bar = scene.add(pi.RigidBody.bar(1.0, 0.5, name="bar"))
    scene.add(pi.Revolute(pi.ground, bar.at("left"), name="pin"))
    scene.add(pi.AngleMotor(pi.ground.at((0.0, 0.0)), bar.at("left"), pi.profile.linear(0.0, 1.0, duration=0.2, begin=0.1), name="motor"))
    scene.add(pi.PointMass(bar.at("right"), 0.1, name="tip"))
    run, goal = pi.solve(scene.build(), 0.4, pi.RadauIIA(h=0.01, tolerance=1e-12)), P.Deviation("tip", (1.0, 0.5))
    exact = (
        0.1 * 0.25 + 0.2 * (2.25 - 2 * np.sin(1.0) - (1 - np.cos(1.0))) + 0.1 * np.hypot(np.cos(1.0) - 1.0, np.sin(1.0) - 0.5) ** 2
    ) / 0.4
    assert abs(goal(run) - exact) < 0.03 * abs(trapezoid(goal, run) - exact)
    assert max(pi.check_gradient(run, goal, parameters=["motor.begin", "motor.end"]).values()) < 1e-6
