"""Generalized-alpha: order, the compiled path against the plain one, counts, what it runs on and how it stops."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import polyida as pi
from polyida.integrate import moves

STEP = pi.GeneralizedAlpha(h=1e-3)
SMOOTH = pi.profile.ramp(0.0, 1.0, duration=0.25)
FRAMES = ("t", "q", "v", "a", "lam")


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


def test_second_order_on_the_pendulum(scenes):
    errors = np.array(list(swings("consistent")))
    steps = [1.0, 0.5, 0.25]
    assert [scenes.slope(steps, column) for column in errors.T] == pytest.approx([2.0, 2.0], abs=0.1)


def test_the_perturbed_start_is_what_makes_lam_second_order(scenes):
    errors = np.array(list(swings("plain")))
    assert scenes.slope([1.0, 0.5, 0.25], errors[:, 1]) == pytest.approx(1.0, abs=0.2)


def test_compiled_and_plain_paths_agree(scenes, kind):
    model = scenes.jointed(kind).build()
    compiled, plain = (pi.solve(model, 0.1, pi.GeneralizedAlpha(h=1e-3, tolerance=1e-7, linear=linear)) for linear in ("auto", "kkt"))
    assert compiled.success and plain.success
    assert np.array_equal(compiled.t, plain.t)
    for name, size in (("q", 1e-9), ("v", 1e-6), ("lam", 1e-5)):
        one, other = getattr(compiled, name), getattr(plain, name)
        assert np.abs(one - other).max() < size * max(1.0, np.abs(other).max()), name


@pytest.mark.parametrize("linear", ["auto", "kkt"])
def test_scalings_agree(scenes, linear):
    model = scenes.jointed("motor between").build()
    runs = [
        pi.solve(model, 0.03, pi.GeneralizedAlpha(h=1e-3, tolerance=1e-6, linear=linear, scaling=scaling))
        for scaling in ("none", "bottasso", "physical")
    ]
    for run in runs[1:]:
        assert np.abs(run.q - runs[0].q).max() < 1e-10 and np.abs(run.lam - runs[0].lam).max() < 1e-4


@pytest.mark.parametrize("linear", ["auto", "kkt"])
def test_runs_are_reproducible_to_the_bit(scenes, linear):
    scene = scenes.jointed("motor between")
    runs = [pi.solve(scene.build(), 0.05, pi.GeneralizedAlpha(h=1e-3, linear=linear)) for _ in range(2)]
    assert runs[0].counts == runs[1].counts
    assert all(np.array_equal(getattr(runs[0], name), getattr(runs[1], name)) for name in FRAMES)


def test_runs_in_threads_are_the_same_as_one_after_the_other(scenes):
    models = [scenes.jointed(kind).build() for kind in ("revolute", "clamp between", "motor between") for _ in range(2)]
    alone = [pi.solve(model, 0.1, STEP) for model in models]
    with ThreadPoolExecutor(3) as pool:
        together = list(pool.map(lambda model: pi.solve(model, 0.1, STEP), models))
    for one, other in zip(alone, together):
        assert one.counts == other.counts and np.array_equal(one.q, other.q) and np.array_equal(one.lam, other.lam)


def test_one_factorization_for_the_free_double_plate():
    from polyida.problems.plates import double_plate

    run = pi.solve(double_plate(cells=40).build(), 0.5, STEP)
    assert run.success and run.counts.steps == 500
    assert run.counts.factorizations == run.counts.tangents == 1


@pytest.mark.parametrize("h", [1e-3, 2e-3])
def test_few_factorizations_with_motors(h):
    from polyida.problems.plates import double_plate_motors

    run = pi.solve(double_plate_motors(cells=40).build(), 1.0, pi.GeneralizedAlpha(h=h))
    assert run.success and run.counts.factorizations <= 0.02 * run.counts.steps


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


def test_drift_stays_at_round_off(scenes, kind):
    run = pi.solve(scenes.jointed(kind).build(), 0.2, STEP)
    assert run.success, run.message
    assert run.drift.max() < 1e-11 and run.velocity_drift.max() < 1e-2


@pytest.mark.parametrize(
    "build",
    [
        lambda scenes: scenes.single((0.0, -9.81))[0],
        lambda scenes: scenes.pair((0.0, -9.81))[0],
        lambda scenes: scenes.cantilever((0.0, -9.81))[0],
        lambda scenes: scenes.hinged()[0],
    ],
    ids=["free", "two free", "clamp", "hinge"],
)
def test_scenes_with_few_joints(scenes, build):
    run = pi.solve(build(scenes).build(), 0.05, STEP)
    assert run.success and np.isfinite(run.q).all() and run.lam.shape == (51, run.model.m)


def test_free_fall_is_exact(scenes):
    """Newmark's formulas are exact for a constant acceleration."""
    run = pi.solve(scenes.single((1.0, -9.81))[0].build(), 0.1, STEP)
    fall = 0.5 * run.t[:, None] ** 2 * [1.0, -9.81]
    assert np.abs(run.q.reshape(len(run), -1, 2) - fall[:, None]).max() < 1e-12
    assert np.abs(run.stress(-1)).max() < 1e-3


def test_a_link_on_pins(scenes):
    """A plate with two holes: hinged at one rim, a mass in the other; a physical pendulum for small swings."""
    scene = pi.Scene(gravity=(0.0, -9.81))
    mesh = pi.mesh.polygonize(pi.mesh.Link(1.0, 0.2, 0.05), cells=100, seed=2)
    link = scene.add(scenes.plate("link", mesh=mesh, material={"E": 1e9}, angle=-np.pi / 2 + 0.05))
    scene.add(pi.Revolute(pi.ground, link.rim(0), name="pin"))
    scene.add(pi.PointMass(link.rim(1), 2.0, name="bob"))
    model = scene.build()
    offset = model.reference - link.rim(0).point
    spin = np.column_stack([-offset[:, 1], offset[:, 0]]).ravel()
    inertia = spin @ (model.mass() @ spin)
    moment = (model.mass() @ np.tile([1.0, 0.0], model.n_nodes)).reshape(-1, 2)[:, 0] @ offset
    angle = np.arctan2(moment[0], -moment[1])
    period = 2 * np.pi * np.sqrt(inertia / (9.81 * np.linalg.norm(moment))) * (1 + angle**2 / 16)
    run = pi.solve(model, period, pi.GeneralizedAlpha(h=period / 500))
    path = run.position("bob") - link.rim(0).point
    assert run.success and angle == pytest.approx(0.05, rel=0.05)
    assert np.abs(path[-1] - path[0]).max() < 2e-4
    assert np.abs(path[250] - scenes.rotation(-2 * angle) @ path[0]).max() < 2e-4


@pytest.mark.parametrize("h", [0.02, 0.05])
@pytest.mark.parametrize("linear", ["auto", "kkt"])
def test_large_steps_are_taken_by_full_newton(scenes, h, linear):
    """A matrix from the prediction of a large step does not contract; one made anew in every iteration does."""
    from polyida.problems.plates import double_plate

    run = pi.solve(double_plate(cells=40).build(), 0.5, pi.GeneralizedAlpha(h=h, linear=linear))
    fine = pi.solve(double_plate(cells=40).build(), 0.5, STEP)
    assert run.success, run.message
    assert np.abs(run.position("tip")[-1] - fine.position("tip")[-1]).max() < 0.05


@pytest.mark.parametrize("h", [1e-5, 1e-6, 1e-7])
def test_small_steps(scenes, h):
    model = scenes.jointed("motor between").build()
    run = pi.solve(model, 20 * h, pi.GeneralizedAlpha(h=h))
    assert run.success, run.message
    assert np.abs(run.q[-1] + 0.5 * 9.81 * run.t[-1] ** 2 * np.tile([0.0, 1.0], model.n_nodes)).max() < 6 * run.t[-1] ** 2


@pytest.mark.parametrize("tolerance", [1e-8, 1e-10, 1e-12])
@pytest.mark.parametrize("linear", ["auto", "kkt"])
def test_a_tolerance_below_round_off_is_met_as_well_as_can_be(scenes, linear, tolerance):
    run = pi.solve(scenes.jointed("motor between").build(), 0.03, pi.GeneralizedAlpha(h=1e-3, tolerance=tolerance, linear=linear))
    assert run.success, run.message


def test_steps_divide_the_run_evenly():
    run = pi.solve(pi.problems.get("pendulum").model, 0.5, pi.GeneralizedAlpha(h=0.03), q0=[-1.0, 0.0])
    assert run.t[-1] == 0.5 and np.allclose(np.diff(run.t), 0.5 / 17)


def test_kinks_are_hit(scenes):
    model = scenes.jointed("motor to ground", pi.profile.quintic(0.0, 0.2, duration=0.03, begin=0.0105)).build()
    run = pi.solve(model, 0.1, STEP)
    assert all(np.abs(run.t - kink).min() < 1e-15 for kink in (0.0105, 0.0405))
    assert np.diff(run.t).max() <= 1e-3 + 1e-15


@pytest.mark.parametrize("begin", [0.0, 0.01])
def test_a_jump_of_the_imposed_velocity_does_not_ring(scenes, begin):
    """Behind such a kink v starts anew on the velocity constraint; otherwise it swings about it from step to step."""
    scene, upper = scenes.hinged()
    turn = pi.profile.linear(0.0, 0.02, duration=0.02, begin=begin)
    scene.add(pi.AngleMotor(pi.ground, upper.section("left"), angle=turn, name="drive"))
    run = pi.solve(scene.build(), begin + 0.02, STEP)
    assert run.success, run.message
    between = (run.t > begin) & (run.t < begin + 0.0199)  # at the far kink itself phi_t may be that of its other side
    assert run.velocity_drift[between].max() < 0.1


def test_every_and_progress():
    seen = []
    run = pi.solve(pi.problems.get("pendulum").model, 0.5, pi.GeneralizedAlpha(h=0.01), q0=[-1.0, 0.0], every=7, progress=seen.append)
    assert len(seen) == 50 == run.counts.steps
    assert np.allclose(run.t, [*np.arange(0.0, 0.5, 0.07), 0.5])


@pytest.mark.parametrize("linear", ["auto", "kkt"])
def test_a_plate_that_collapses_stops_in_good_order(scenes, linear):
    """St. Venant-Kirchhoff fails in strong compression: the run says so and keeps what it has."""
    scene, upper = scenes.cantilever(material={"E": 1e6})
    scene.add(pi.PointLoad(upper.section("right"), (-1e3, 0.0), pi.profile.ramp(0.0, 1.0, duration=0.1), name="squash"))
    run = pi.solve(scene.build(), 0.5, pi.GeneralizedAlpha(h=5e-4, linear=linear))
    assert not run.success and len(run) > 10
    assert np.isfinite(run.q).all() and "inside out" in run.message and "t = 0." in run.message
    assert run.status in run.summary() and run.message in run.summary()


@pytest.mark.parametrize("linear", ["auto", "kkt"])
def test_a_motor_that_jumps_half_a_turn_is_stopped(scenes, linear, monkeypatch):
    """By the steps themselves, where nobody has looked at the profile before."""
    monkeypatch.setattr(moves, "parts", lambda model, begin, end, h, fine, now: [moves.Part(begin, end, np.inf)])
    scene, upper = scenes.hinged((0.0, 0.0))
    jump = pi.profile.from_function(lambda t: 0.0 if t < 0.0095 else np.pi, lambda t: 0.0, lambda t: 0.0)
    scene.add(pi.AngleMotor(pi.ground, upper.section("left"), angle=jump, name="drive"))
    run = pi.solve(scene.build(), 0.02, pi.GeneralizedAlpha(h=1e-3, linear=linear))
    assert not run.success and "half-turn" in run.message and run.t[-1] == pytest.approx(0.009)


def test_blas_threads_are_given_back(scenes):
    """Also where runs overlap."""
    from threadpoolctl import threadpool_info, threadpool_limits

    blas = lambda: [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]  # noqa: E731
    with threadpool_limits(limits=2, user_api="blas"):
        before, model = blas(), scenes.hinged()[0].build()
        with ThreadPoolExecutor(4) as pool:
            list(pool.map(lambda end: pi.solve(model, end, STEP), [0.01, 0.05, 0.02, 0.08, 0.03, 0.01]))
        assert blas() == before
