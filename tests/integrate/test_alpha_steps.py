"""Newton and step policy: what converges is right, what does not is cut, what cannot be is told; starts of every
kind.
"""

import numpy as np
import pytest

import polyida as pi
from polyida.integrate import discontinuities
from polyida.problems import plates

BOTH = pytest.mark.parametrize("linear", ["auto", "kkt"])


@pytest.fixture(scope="module")
def swinging():
    """(model, its tip over 1 s every 0.1 s)."""
    model = plates.double_plate(cells=20).build()
    return model, pi.solve(model, 1.0, pi.GeneralizedAlpha(h=1e-3), every=100).position("tip")


@BOTH
@pytest.mark.parametrize("h", [0.2, 0.5])
def test_steps_far_too_large_are_cut(swinging, linear, h):
    """The grid is kept; what lies between is counted as rejected, not as steps; equilibrium holds at the end of
    each.
    """
    model, tip = swinging
    run = pi.solve(model, 1.0, pi.GeneralizedAlpha(h=h, linear=linear, tolerance=1e-6))
    assert run.success and run.counts.rejected > 0 and run.counts.steps == round(1.0 / h)
    assert np.allclose(np.diff(run.t), h)
    assert np.abs(run.position("tip") - tip[:: round(10 * h)]).max() < 0.3
    for k in range(1, len(run)):
        r = model.residual(run.t[k], run.q[k], run.v[k], run.a[k], run.lam[k])
        assert np.abs(r).max() < 0.1 and model.rejection_reason(run.t[k], run.q[k]) is None


@BOTH
def test_without_halvings_the_step_fails(swinging, linear):
    run = pi.solve(swinging[0], 1.0, pi.GeneralizedAlpha(h=0.5, linear=linear, max_halvings=0))
    assert not run.success and run.counts.rejected == 1 and "parts" not in run.message and len(run) == 1


@BOTH
def test_the_history_of_a_failure_is_told(scenes, linear, monkeypatch):
    """Of steps that meet a jump, where nobody has looked at the profile before."""
    monkeypatch.setattr(discontinuities, "between_kinks", lambda model, begin, end, h, samples, now: [(begin, end, np.inf)])
    scene, upper = scenes.hinged((0.0, 0.0))
    jump = pi.profile.from_function(lambda t: 0.0 if t < 0.0095 else np.pi, lambda t: 0.0, lambda t: 0.0)
    scene.add(pi.AngleMotor(pi.ground, upper.section("left"), angle=jump, name="drive"))
    run = pi.solve(scene.build(), 0.02, pi.GeneralizedAlpha(h=1e-3, linear=linear, max_halvings=2))
    assert not run.success and run.counts.rejected == 3
    assert "half-turn" in run.message and "the step in 2 to 4 parts fails too" in run.message


@BOTH
def test_going_on_after_a_cut_step_is_bit_by_bit(swinging, linear, tmp_path):
    model, integrator = swinging[0], pi.GeneralizedAlpha(h=0.2, linear=linear)
    whole = pi.solve(model, 1.0, integrator)
    seen = []

    def stop(t):
        seen.append(t)
        if t > 0.55:
            raise KeyboardInterrupt

    pi.solve(model, 1.0, integrator, out=tmp_path / "run.h5", flush_every=1, progress=stop)
    rest = pi.resume(tmp_path / "run.h5")
    assert whole.counts.rejected > 0 and np.array_equal(rest.q, whole.q) and np.array_equal(rest.lam, whole.lam)


@pytest.mark.parametrize("scale", [0.5, 1.7])
def test_another_step_goes_on_without_a_transient(scale):
    """What the method carries is scaled to the new step: lam stays as good as that of the steps themselves."""
    model, start = pi.problems.get("pendulum").model, dict(q0=[-1.0, 0.0], v0=[0.0, -3.0])
    first = pi.solve(model, 0.5, pi.GeneralizedAlpha(h=5e-3, tolerance=1e-8), **start)
    rest = pi.solve(model, 1.0, pi.GeneralizedAlpha(h=5e-3 * scale, tolerance=1e-8), state=first.state)
    error = lambda run: np.abs(run.lam[:, 0] - (9.0 - 3 * 9.81 * run.q[:, 1])).max()  # noqa: E731
    assert error(rest) < 2 * max(1.0, scale**2) * error(first)
