"""Generalized-alpha: order, the compiled path against the plain one, counts, what it runs on and how it stops."""

import numpy as np
import pytest

import polyida as pi

STEP = pi.GeneralizedAlpha(h=1e-3)
SMOOTH = pi.profile.ramp(0.0, 1.0, duration=0.25)


def bending(scenes, **options):
    """A clamped plate, bent by a tip load that grows smoothly over 0.25 s."""
    scene, upper = scenes.cantilever(**options)
    scene.add(pi.PointLoad(upper.section("right"), (0.0, -8.0), SMOOTH, name="push"))
    return scene.build()


@pytest.mark.parametrize("rho_inf, linear", [(0.9, "auto"), (0.5, "auto"), (0.0, "auto"), (0.9, "kkt")])
def test_second_order_on_a_smooth_load(scenes, rho_inf, linear):
    """In q, v and lam, as the largest deviation over all times, from the first step on."""
    model, end, counts, finest = bending(scenes), 0.3, (60, 120, 240), 960
    runs = {
        n: pi.solve(model, end, pi.GeneralizedAlpha(h=end / n, rho_inf=rho_inf, tolerance=1e-6, linear=linear)) for n in (*counts, finest)
    }
    for name in ("q", "v", "lam"):
        errors = [np.abs(getattr(runs[n], name) - getattr(runs[finest], name)[:: finest // n]).max() for n in counts]
        assert scenes.slope([end / n for n in counts], errors) == pytest.approx(2.0, abs=0.1), name


def swings(start, counts=(100, 200, 400), end=0.5):
    """[(error of q at the end, largest error of lam over all times)] of a pendulum thrown down at 3 m/s."""
    model, given = pi.problems.get("pendulum").model, dict(q0=[-1.0, 0.0], v0=[0.0, -3.0])
    reference = pi.solve(model, end, pi.GeneralizedAlpha(h=end / 3200, tolerance=1e-7), **given)
    for n in counts:
        run = pi.solve(model, end, pi.GeneralizedAlpha(h=end / n, tolerance=1e-9, start=start), **given)
        tension = 9.0 - 3 * 9.81 * run.q[:, 1]
        yield np.abs(run.q[-1] - reference.q[-1]).max(), np.abs(run.lam[:, 0] - tension).max()


def test_the_perturbed_start_is_what_makes_lam_second_order(scenes):
    errors = np.array(list(swings("plain")))
    assert scenes.slope([1.0, 0.5, 0.25], errors[:, 1]) == pytest.approx(1.0, abs=0.2)


def test_one_factorization_for_the_free_double_plate():
    from polyida.problems.plates import double_plate

    run = pi.solve(double_plate(cells=40).build(), 0.5, STEP)
    assert run.success and run.counts.steps == 500
    assert run.counts.factorizations == run.counts.tangents == 1


def test_counts_are_of_the_work_done():
    class Counting(type(pi.problems.get("pendulum").model)):
        calls = 0

        def residual(self, *given):
            self.calls += 1
            return super().residual(*given)

    model = Counting()
    run = pi.solve(model, 0.5, pi.GeneralizedAlpha(h=1e-2), q0=[-1.0, 0.0])
    c = run.counts
    assert c.steps == 50 == run.steps and c.residuals == model.calls
    assert c.newton_iterations == c.solves == c.residuals and c.tangents == c.factorizations <= c.steps


def test_free_fall_is_exact(scenes):
    """Newmark's formulas are exact for a constant acceleration."""
    run = pi.solve(scenes.single((1.0, -9.81))[0].build(), 0.1, STEP)
    fall = 0.5 * run.t[:, None] ** 2 * [1.0, -9.81]
    assert np.abs(run.q.reshape(len(run), -1, 2) - fall[:, None]).max() < 1e-12
    assert np.abs(run.stress(-1)).max() < 1e-3


@pytest.mark.parametrize("linear", ["auto", "kkt"])
def test_a_plate_that_collapses_stops_in_good_order(scenes, linear):
    """St. Venant-Kirchhoff fails in strong compression: the run says so and keeps what it has."""
    scene, upper = scenes.cantilever(material={"E": 1e6})
    scene.add(pi.PointLoad(upper.section("right"), (-1e3, 0.0), pi.profile.ramp(0.0, 1.0, duration=0.1), name="squash"))
    run = pi.solve(scene.build(), 0.5, pi.GeneralizedAlpha(h=5e-4, linear=linear))
    assert not run.success and len(run) > 10
    assert np.isfinite(run.q).all() and "inside out" in run.message and "t = 0." in run.message
    assert run.status in run.summary() and run.message in run.summary()
