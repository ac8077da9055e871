"""Generalized-alpha: its start, the compiled path against the plain one, counts, what it runs on and how it stops."""

import numpy as np
import pytest

import polyida as pi

STEP = pi.GeneralizedAlpha(h=1e-3)


def test_the_perturbed_start_is_what_makes_lam_second_order(scenes):
    """Of a pendulum thrown down at 3 m/s; without it lam is of first order."""
    model, errors = pi.problems.get("pendulum").model, []
    for n in (100, 200, 400):
        run = pi.solve(model, 0.5, pi.GeneralizedAlpha(h=0.5 / n, tolerance=1e-9, start="plain"), q0=[-1.0, 0.0], v0=[0.0, -3.0])
        errors.append(np.abs(run.lam[:, 0] - (9.0 - 3 * 9.81 * run.q[:, 1])).max())
    assert scenes.slope([1.0, 0.5, 0.25], errors) == pytest.approx(1.0, abs=0.2)


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
