"""The state of a run is where it ended, with all that the integrator goes on from, whatever ended it."""

import numpy as np
import pytest

import polyida as pi
from polyida.problems import plates

FRAMES = ("t", "q", "v", "a", "lam")
ALPHA = pi.GeneralizedAlpha(h=1e-3)


@pytest.fixture(scope="module")
def model():
    return plates.double_plate_motors(cells=6).build()


def ctrl_c(after):
    def progress(t):
        if t > after:
            raise KeyboardInterrupt

    return progress


def is_the_rest(rest, whole):
    return all(np.array_equal(getattr(rest, name), getattr(whole, name)[-len(rest) :]) for name in FRAMES)


ALPHAS = {
    "plain": ALPHA,
    "stabilised": pi.GeneralizedAlpha(h=1e-3, form="stabilised"),
    "phi from positions": pi.GeneralizedAlpha(h=1e-3, incremental_phi=False),
    "kkt": pi.GeneralizedAlpha(h=4e-3, linear="kkt"),
}


@pytest.mark.parametrize("name", ALPHAS)
def test_from_the_middle_of_a_stretch_bit_by_bit(model, name, tmp_path):
    whole = pi.solve(model, 0.5, ALPHAS[name])
    for after, out in ((0.1, None), (0.3105, tmp_path / "run.h5")):
        run = pi.solve(model, 0.5, ALPHAS[name], progress=ctrl_c(after), out=out)
        assert run.status == "interrupted" and run.state.t == run.t[-1] > after
        rest = pi.solve(model, 0.5, ALPHAS[name], state=run.state)
        assert len(rest) == len(whole) - len(run) + 1 and is_the_rest(rest, whole)
    again = pi.load(out)
    assert is_the_rest(pi.solve(model, 0.5, ALPHAS[name], state=again.state), whole)
    assert again.restart.frames == len(run) and is_the_rest(pi.resume(out), whole)


def test_from_where_a_step_failed(model):
    """A motor that jumps by half a turn fails in the middle of a stretch; the state is the last one that was accepted."""
    scene = plates.double_plate(cells=6)
    left = next(iter(scene.parts.values())).section("left")
    jump = pi.profile.from_function(lambda t: 0.0 if t < 0.0995 else np.pi, lambda t: 0.0, lambda t: 0.0)
    scene.add(pi.AngleMotor(pi.ground, left, angle=jump, name="drive"))
    model = scene.build()
    run = pi.solve(model, 0.2, ALPHA)
    assert not run.success and run.state.t == run.t[-1] == 0.099
    whole, rest = pi.solve(model, 0.0994, ALPHA), pi.solve(model, 0.0994, ALPHA, state=run.state)
    assert np.abs(rest.q[-1] - whole.q[-1]).max() < 1e-6


def test_from_where_until_stopped_to_second_order(scenes):
    """Smooth motion: what the stop costs falls as h^2."""
    pendulum, apart, steps = pi.problems.get("pendulum").model, [], (8e-3, 4e-3, 2e-3)
    for h in steps:
        alpha = pi.GeneralizedAlpha(h=h)
        run = pi.solve(pendulum, 1.0, alpha, q0=[-1.0, 0.0], until=lambda t, q, v: t - 0.37037)
        rest = pi.solve(pendulum, 1.0, alpha, state=run.state)
        apart.append(np.abs(rest.q[-1] - pi.solve(pendulum, 1.0, alpha, q0=[-1.0, 0.0]).q[-1]).max())
    assert scenes.slope(steps, apart) > 1.8


def test_extrapolated_and_adaptive_runs_go_on_to_their_tolerance(model):
    for integrator, error in ((pi.GeneralizedAlpha(h=1e-3, extrapolate=True), 1e-4), (pi.GeneralizedAlpha(h=0.01, rtol=1e-4), 1e-3)):
        whole = pi.solve(model, 0.3, integrator)
        run = pi.solve(model, 0.3, integrator, progress=ctrl_c(0.1))
        assert run.state.t == run.t[-1] > 0.1
        assert np.abs(pi.solve(model, 0.3, integrator, state=run.state).q[-1] - whole.q[-1]).max() < error
