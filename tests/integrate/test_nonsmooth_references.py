"""Contact and friction against references: closed forms, published states, and DOP853 between located events."""

from functools import cache

import numpy as np
import pytest
from scipy.optimize import brentq

import polyida as pi
from nonsmooth.random_scenes import kept
from nonsmooth.references import crank_angle, place_of_slider
from nonsmooth.references import slips_of_rod as by_dop853
from nonsmooth.scenes import Belt, Woodpecker, slider_crank, sliding_rod

slips_of_rod = cache(by_dop853)


def name_of(x):
    return type(x).__name__ if isinstance(x, pi.Integrator) else None


def short(x):
    return f"{name_of(x)}-{x.fixed_step() or x.rtol:g}" if isinstance(x, pi.Integrator) else None


@pytest.mark.parametrize(
    "integrator, error",
    [(pi.RadauIIA(rtol=1e-9), 1e-9), (pi.IDA(rtol=1e-9), 1e-6), (pi.GeneralizedAlpha(h=5e-3), 5e-6), (pi.NonsmoothAlpha(h=5e-3), 5e-6)],
    ids=name_of,
)
def test_stick_and_slip_on_a_belt(integrator, error):
    run = pi.solve(Belt(), 5.0, integrator)
    assert run.success, run.message
    assert abs(run.q[-1, 0] - 3.0 - np.sin(5.0 - Belt.slips)) < error
    k = np.searchsorted(run.t, 2.0)
    assert abs(run.v[k, 0] - 1.0) < 1e-9 and abs(run.q[k, 0] - 3.0 + Belt.slips - run.t[k]) < error
    if run.events:
        assert [one.name for one in run.events] == ["belt sticks", "belt slips"]
        assert np.abs(np.array([one.t for one in run.events]) - [Belt.sticks, Belt.slips]).max() < error


def test_order_through_stick_and_slip():
    errors = [pi.solve(Belt(), 5.0, pi.NonsmoothAlpha(h=h)).q[-1, 0] - 3.0 - np.sin(5.0 - Belt.slips) for h in 0.04 / 2.0 ** np.arange(3)]
    order = -np.polyfit(np.arange(3), np.log2(np.abs(errors)), 1)[0]
    assert order >= 1.7


@pytest.fixture(scope="module")
def end_of_slider():
    """Place of the slider at 0.3 s, behind two reversals."""
    return place_of_slider(crank_angle(0.2, 0.3)[0])


def slider(integrator):
    """(run to 0.3 s, its last place of the slider)."""
    scene = slider_crank()
    run = pi.solve(scene.build(), 0.3, integrator)
    return run, run.position(scene.parts["slider"].at("c"))[-1, 0]


@pytest.mark.parametrize("integrator, error", [(pi.RadauIIA(rtol=1e-7), 1e-6), (pi.GeneralizedAlpha(h=1e-3), 1e-3)], ids=name_of)
def test_a_slider_crank_with_friction_in_its_guide(integrator, error, end_of_slider):
    """The slip reverses at dead points, where friction cannot hold the slider."""
    run, end = slider(integrator)
    assert run.success, run.message
    assert [one.name for one in run.events] == ["guide slips"] * 2
    assert abs(end - end_of_slider) < error


def test_time_stepping_to_second_order_through_dead_points(end_of_slider):
    """At a dead point the slip reverses by the motion of the crank alone: friction must not be given an impulse that it does not have."""
    errors = [slider(pi.NonsmoothAlpha(h=h))[1] - end_of_slider for h in (1e-3, 5e-4)]
    assert abs(np.log2(abs(errors[0] / errors[1])) - 2.0) < 0.15


def test_without_friction_time_stepping_needs_no_laws():
    run = pi.solve(slider_crank(0.0).build(), 0.02, pi.NonsmoothAlpha(h=1e-3))
    other = pi.solve(slider_crank(0.0).build(), 0.02, pi.GeneralizedAlpha(h=1e-3))
    assert run.success and np.abs(run.q[-1] - other.q[-1]).max() < 1e-5


def test_a_rod_after_painleve():
    """Friction of mu = 5/3 has no unique force at 45 degrees; time stepping goes on through it, and energy never grows."""
    scene = sliding_rod()
    run = pi.solve(scene.build(), 0.5, pi.NonsmoothAlpha(h=2e-3))
    assert run.success, run.message
    rod = scene.parts["rod"]
    low, middle = run.position(rod.at("low")), run.position(rod.at("c"))
    assert low[:, 1].min() > -1e-9
    assert np.arctan2(*(middle - low).T[::-1]).max() > np.pi / 4
    assert np.diff(run.energy.total).max() < 1e-6 * run.energy.total[0]


def test_a_rod_jams_behind_the_point_of_painleve():
    """While it slides, friction has no unique force at 45 degrees, 0.8145 s; an impact without collision then turns it with 8.7 rad/s."""
    scene = sliding_rod(np.radians(31.0), 0.0, speed=-30.0)
    run = pi.solve(scene.build(), 0.83, pi.NonsmoothAlpha(h=1e-3))
    assert run.success, run.message
    low, middle = (run.position(scene.parts["rod"].at(name)) for name in ("low", "c"))
    rate = np.gradient(np.arctan2(*(middle - low).T[::-1]), run.t)
    assert abs(run.t[np.argmax(np.diff(rate))] - 0.8145) < 2.5e-3 and rate[-2] == pytest.approx(8.7, abs=0.1)
    assert low[:, 1].min() > -1e-9 and np.diff(run.energy.total).max() < 1e-6 * run.energy.total[0]


def test_events_end_where_friction_has_no_unique_force():
    """A rod at rest at 31 degrees but for its slip: 0.5551961971 rad at 0.5 s by DOP853 on its angle, 45 degrees at 0.8145 s."""
    scene = sliding_rod(np.radians(31.0), 0.0)
    run = pi.solve(scene.build(), 1.0, pi.GeneralizedAlpha(h=5e-3))
    assert run.status == "singular" and "the slip of 'tip' is singular" in run.message and "NonsmoothAlpha" in run.message
    assert abs(run.t[-1] - 0.8145) < 1e-2
    k = np.searchsorted(run.t, 0.5)
    low, middle = (run.position(scene.parts["rod"].at(name))[k] for name in ("low", "c"))
    assert abs(np.arctan2(*(middle - low)[::-1]) - 0.5551961971) < 1e-5


def error_by_tolerance(run, integrator, angle, spin, speed, what):
    """Bound of an error of the time of `what`: what one of rtol (L + |q|) in the angle does to it at the start, where it grows most, in every step."""
    times = [slips_of_rod(start, spin, speed)[0][what] for start in (angle, angle + 1e-6)]
    return abs(times[1] - times[0]) / 1e-6 * integrator.rtol * (2.0 + np.abs(run.q).max()) * run.counts.steps


def located(run):
    """The time in the message of a run that ended where friction had no unique force."""
    assert run.status == "singular" and "the slip of 'tip' is singular" in run.message, run.message
    return float(run.message.split(" at t = ")[1].split()[0])


RADAU, IDA = (pi.RadauIIA(rtol=1e-6), pi.RadauIIA(rtol=1e-8)), (pi.IDA(rtol=1e-5), pi.IDA(rtol=1e-7))


@pytest.mark.parametrize(
    "integrator, speed, held",
    [
        (pi.GeneralizedAlpha(h=2e-3), -40.0, False),
        (pi.GeneralizedAlpha(h=5e-4), -30.0, True),
        (RADAU[0], -20.0, False),
        (RADAU[1], -30.0, True),
        (IDA[0], -40.0, False),
        (IDA[1], -30.0, True),
    ],
    ids=short,
)
def test_the_point_of_painleve_is_located(integrator, speed, held):
    """From 35 degrees and 0.5 rad/s a rod comes to 45 degrees, D = 0, at 0.1300920 s, whatever its slip, on the ground and in a slot.

    Its rate grows as (t_s - t)^(2/3) there. Fixed steps do not resolve what the angle gains by that within a step.
    """
    at = np.radians(35.0), 0.5, speed
    run = pi.solve(sliding_rod(*at, held=held).build(), 0.2, integrator)
    ends, reference = slips_of_rod(*at)
    if isinstance(integrator, pi.GeneralizedAlpha):
        h = integrator.h
        before = reference.sol(brentq(lambda s: reference.sol(s)[3] - ends["singular"] + h, 0.0, reference.t[-1]))
        error = (reference.y[0, -1] - before[0] - h * before[1]) / reference.y[1, -1]
    else:
        error = error_by_tolerance(run, integrator, *at, "singular")
    assert not len(run.events) and run.t[-1] < located(run) + 1e-9 and abs(located(run) - ends["singular"]) < error


@pytest.mark.parametrize("integrator", [pi.RadauIIA(rtol=1e-9), *(pi.IDA(rtol=rtol) for rtol in (1e-8, 3e-9, 1e-9, 3e-10))], ids=short)
def test_a_point_of_painleve_beside_an_unstable_state(integrator):
    """At 30.96 degrees a sliding rod does not turn: 31 degrees from rest amplify errors of the angle by 207 s/rad, until 0.8145 s."""
    at = np.radians(31.0), 0.0, -30.0
    run = pi.solve(sliding_rod(*at).build(), 0.9, integrator)
    assert (
        abs(located(run) - slips_of_rod(*at)[0]["singular"]) < error_by_tolerance(run, integrator, *at, "singular") < 2e6 * integrator.rtol
    )


@pytest.mark.parametrize("h", [7e-3, 5e-3, 4e-3])
def test_steps_that_have_no_solution_at_the_point_of_painleve(h):
    """Long steps before it fail, or end at another solution of the step's equations with forces of 1e5 N."""
    at = np.radians(28.65), 0.5, -20.0
    run = pi.solve(sliding_rod(*at).build(), 0.4, pi.GeneralizedAlpha(h=h))
    assert abs(located(run) - slips_of_rod(*at)[0]["singular"]) < 0.1 * h and np.abs(run.lam).max() < 1e3


@pytest.mark.parametrize("integrator", [pi.GeneralizedAlpha(h=1e-3), RADAU[0], *IDA], ids=short)
def test_a_slip_that_reverses_before_the_point_of_painleve(integrator):
    """A slower tip comes to rest 2 ms before that point, slips to the other side with a unique force, and opens."""
    at = np.radians(31.0), 0.0, -20.0
    run, ends = pi.solve(sliding_rod(*at).build(), 0.95, integrator), slips_of_rod(*at)[0]
    assert run.success, run.message
    assert [one.name for one in run.events][:3] == ["tip slips", "tip opens", "tip is free"]
    for one, what in zip(run.events, ("slips", "opens")):
        error = 1e-3 if integrator.fixed_step() else error_by_tolerance(run, integrator, *at, what)
        assert abs(one.t - ends[what]) < error


def test_a_slot_jams_where_its_force_ends():
    """Behind 45 degrees a tip that slips to the right has a force from one side of its slot alone: it ends where that is zero, and jams."""
    at, integrator = (np.radians(31.0), 0.0, -20.0), pi.RadauIIA(rtol=1e-9)
    run = pi.solve(sliding_rod(*at, held=True).build(), 0.95, integrator)
    assert [one.name for one in run.events] == ["tip slips"]
    assert abs(located(run) - slips_of_rod(*at)[0]["opens"]) < error_by_tolerance(run, integrator, *at, "opens") < 1e-2


def test_the_woodpecker_returns_to_its_periodic_state():
    """Data of Glocker and Studer (2005); the state differs from theirs by 0.5 % in y' and 0.05 % in the bird's rate.

    IDA agrees with Radau IIA: events are located on IDA's own polynomial, as on a cubic its error was 23 times as large.
    """
    (q0, v0), model = Woodpecker.begin, Woodpecker()
    methods = (pi.RadauIIA(rtol=1e-11), 2e-6), (pi.IDA(rtol=1e-11), 2e-6), (pi.NonsmoothAlpha(h=5e-5), 1e-4)
    runs = [pi.solve(model, Woodpecker.period, integrator, q0=q0, v0=v0) for integrator, _ in methods]
    for run, (_, error) in zip(runs, methods):
        assert run.success, run.message
        assert np.abs(run.q[-1] - q0 + [Woodpecker.fall, 0.0, 0.0]).max() < error
        assert np.abs((run.v[-1] - v0) / [1.0, 1.0, 20.0]).max() < 10 * error
        assert min(model.phi(0.0, q).min() for q in run.q) > -1e-9
    assert np.abs(runs[0].q[-1] - runs[1].q[-1]).max() < 1e-9 and np.abs(runs[0].v[-1] - runs[1].v[-1]).max() < 1e-8


@pytest.mark.parametrize("seed", range(6))
def test_random_bodies_on_a_rough_floor(seed):
    """No penetration, forces within their cones, no energy beyond that of the start; impulses are the change of momentum to the order of h.

    Newton's law of impact beside friction, and the change of lam in a step, may add a little energy in one step.
    """
    row = kept(seed)
    assert row["outcome"] == "done" and row["impacts"], row
    assert row["lowest_gap"] >= -1e-9 and row["pull"] <= 0.0 and row["beyond_cone"] <= 1e-12
    assert row["energy_growth"] < 1e-4 and row["energy_growth_in_all"] < 1e-12
    assert row["momentum_in_a_step"] < 1.5e-3 and row["momentum_in_all"] < 4e-3
