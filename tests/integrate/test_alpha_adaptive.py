"""Error-controlled steps: cheap where an event is sudden, as good as fixed steps elsewhere, clean where h jumps."""

import numpy as np
import pytest

import polyida as pi
from polyida.integrate.alpha.step_size import LEVELS

FROM, TO, PULSE = 9.4, 10.0, 9.5


def sudden_event(scenes, cells=20):
    """A clamped plate with a tip mass that bends slowly for 9 s under a smooth load, and is hit by a pulse of 10 ms at
    9.5 s.
    """
    scene, plate = scenes.cantilever(cells=cells)
    tip = plate.section("right")
    scene.add(pi.PointMass(tip, 0.1, name="tip"))
    scene.add(pi.PointLoad(tip, (0.0, -5.0), pi.profile.ramp(0.0, 1.0, duration=9.0), name="bend"))
    for name, change, begin in (("hit", 1.0, PULSE), ("release", -1.0, PULSE + 5e-3)):
        scene.add(pi.PointLoad(tip, (0.0, -40.0), pi.profile.quintic(0.0, change, duration=5e-3, begin=begin), name=name))
    return scene.build()


def test_half_the_work_of_fixed_steps_on_a_sudden_event(scenes):
    """At equal error: adaptive steps are more accurate than fixed ones that take twice as many Newton iterations."""
    model, times = sudden_event(scenes), np.linspace(FROM, TO, 301)
    exact = pi.solve(model, TO, pi.GeneralizedAlpha(h=2e-4), output=times)
    fixed = pi.solve(model, TO, pi.GeneralizedAlpha(h=1e-3), output=times)
    free = pi.solve(model, TO, pi.GeneralizedAlpha(h=0.05, atol=1e-6), output=times)
    assert fixed.success and free.success
    error = lambda run: np.abs(run.q - exact.q).max()  # noqa: E731
    assert error(free) < error(fixed)
    work = lambda run: run.counts.newton_iterations + 10 * run.counts.factorizations  # noqa: E731
    assert 2 * work(free) < work(fixed) and free.counts.rejected > 0


@pytest.mark.parametrize("form", ["index3", "stabilised"])
def test_error_follows_the_tolerance_and_lam_is_clean(scenes, form):
    """Also lam, which is not in the estimate, and sees every jump of h."""
    model, start = pi.problems.get("pendulum").model, dict(q0=[-1.0, 0.0], v0=[0.0, -3.0])
    exact = pi.solve(model, 1.0, pi.GeneralizedAlpha(h=1e-3, tolerance=1e-7, extrapolate=True), every=1000, **start)
    errors = []
    for atol in (1e-3, 1e-4, 1e-5):
        run = pi.solve(model, 1.0, pi.GeneralizedAlpha(h=0.1, atol=atol, tolerance=1e-6, form=form), **start)
        tension = 9.0 - 3 * 9.81 * run.q[:, 1]
        errors.append([np.abs(run.q[-1] - exact.q[-1]).max(), np.abs(run.lam[:, 0] - tension).max()])
        assert len(set(np.round(np.log2(np.diff(run.t)) * LEVELS, 6))) < 0.1 * len(run)
    slopes = [scenes.slope([1e-3, 1e-4, 1e-5], column) for column in np.transpose(errors)]
    assert slopes == pytest.approx([2 / 3, 2 / 3], abs=0.15) and errors[-1][1] < 0.05


def test_a_tolerance_that_no_step_meets_is_told(scenes):
    model = pi.problems.get("pendulum").model
    run = pi.solve(model, 1.0, pi.GeneralizedAlpha(h=0.1, atol=1e-300), q0=[-1.0, 0.0])
    assert run.status == "step size" and "rtol and atol" in run.message


class Unlike(pi.Model):
    """A four-bar of three bars of 1 kg and its ground of 2 m by the joints' places, each coordinate in a unit of its own:
    the model's q is `units` times metres.
    """

    n, m = 4, 3

    def __init__(self, units):
        self.units = np.array(units)
        self.start = np.array([0.0, 1.0, 2.0, 1.0]) * self.units

    def mass(self, q):
        one = np.array([[4.0, 0, 1, 0], [0, 4, 0, 1], [1, 0, 4, 0], [0, 1, 0, 4]]) / 6
        return one / np.outer(self.units, self.units)

    def force(self, t, q, v):
        return np.array([-9.81, 9.81, 0.0, 9.81]) / self.units

    def phi(self, t, q):
        a, b = (q / self.units).reshape(2, 2)
        return np.array([a @ a - 1.0, (b - a) @ (b - a) - 4.0, (b - [2.0, 0.0]) @ (b - [2.0, 0.0]) - 1.0])

    def phi_q(self, t, q):
        (a, b), no = (q / self.units).reshape(2, 2), [0.0, 0.0]
        rows = [[*a, *no], [*(a - b), *(b - a)], [*no, *(b - [2.0, 0.0])]]
        return 2 * np.array(rows) / self.units


@pytest.mark.parametrize("units", [(1.0, 1.0, 1e4, 1e4), (1e-4, 1.0, 1e-4, 1e4)])
def test_units_of_the_coordinates_do_not_matter(units):
    """The same steps and errors; by a plain root mean square only the coordinates in large numbers were looked at."""
    runs = []
    for model in (Unlike((1.0,) * 4), Unlike(units)):
        settings = pi.GeneralizedAlpha(h=0.1, rtol=1e-5, atol=0.0)
        runs.append(pi.solve(model, 0.6, settings, q0=model.start))  # flat, and so singular, at 0.628 s
        assert runs[-1].success, runs[-1].message
    assert len(runs[0]) == len(runs[1]) > 40 and np.allclose(runs[0].t, runs[1].t)
    assert np.abs(runs[1].q / runs[1].model.units - runs[0].q).max() < 1e-6


def test_a_step_at_the_round_off_of_t_is_told():
    """At t = 1e12 s neighbouring numbers are 1e-4 s apart."""
    model = pi.problems.get("pendulum").model
    run = pi.solve(model, 1e12 + 1.0, pi.GeneralizedAlpha(h=0.1, atol=1e-9), t0=1e12, q0=[-1.0, 0.0])
    assert run.status == "step too small" and "round-off of t" in run.message


def test_no_step_is_longer_than_an_eighth_of_the_longest_beside_a_fast_input():
    """A hum of 50 Hz is too small to need short steps; steps are as long as its samples allow, and not longer."""
    scene = pi.Scene()
    body = scene.add(pi.RigidBody(1.0, 1.0, {"c": (0.0, 0.0)}, name="body"))
    hum = pi.profile.from_function(lambda t: 1e-3 * np.sin(100 * np.pi * t), shortest=0.02)
    scene.add(pi.PointLoad(body.at("c"), (1.0, 0.0), hum, name="hum"))
    run = pi.solve(scene.build(), 0.3, pi.GeneralizedAlpha(h=0.03, rtol=1e-3))
    assert run.success and np.diff(run.t).max() == pytest.approx(0.03 / 8, rel=1e-9)
