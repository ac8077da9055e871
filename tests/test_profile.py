"""Time profiles: derivatives, ends, smoothness, plain data."""

import numpy as np
import pytest

import polyida as pi
from polyida import profile
from polyida.model.differences import along

MOVES = {"quintic": profile.quintic, "ramp": profile.ramp, "linear": profile.linear}
PROFILES = {
    "constant": profile.constant(2.5),
    "polynomial": profile.polynomial([1.0, -2.0, 0.5, 3.0]),
    "sine": profile.sine(0.4, 2.0, 0.3),
    **{name: make(0.3, 1.7, duration=0.8, begin=0.1) for name, make in MOVES.items()},
    "function": profile.from_function(lambda t: np.exp(-t) * np.cos(3 * t)),
}


@pytest.mark.parametrize("name", PROFILES)
@pytest.mark.parametrize("t", [0.0, 0.2345, 0.5, 0.81, 1.3])
def test_derivatives(name, t):
    given = PROFILES[name]
    scale = 0.02
    assert given.d1(t) == pytest.approx(along(lambda s: given(t + s), scale), rel=1e-6, abs=1e-6)
    assert given.d2(t) == pytest.approx(along(lambda s: given.d1(t + s), scale), rel=1e-5, abs=1e-5)
    assert given.at(t) == (given(t), given.d1(t), given.d2(t))


@pytest.mark.parametrize("name", MOVES)
def test_a_move_holds_its_ends(name):
    given = PROFILES[name]
    assert [given(t) for t in (-5.0, 0.1, 0.9, 7.0)] == pytest.approx([0.3, 0.3, 1.7, 1.7], abs=1e-14)
    assert given(0.5) == pytest.approx(1.0)
    assert all(given.d1(t) == given.d2(t) == 0.0 for t in (-5.0, 7.0))
    assert given.kinks == pytest.approx((0.1, 0.9))


@pytest.mark.parametrize("name, order", [("quintic", 3), ("ramp", 5)])
def test_smoothness_at_the_start(name, order):
    given = MOVES[name](0.0, 1.0, duration=1.0)
    assert given(1e-2) / given(1e-3) == pytest.approx(10.0**order, rel=0.1)


@pytest.mark.parametrize("name", [name for name in PROFILES if name != "function"])
def test_plain_data_and_back(name):
    given = PROFILES[name]
    again = profile.from_formula(given.formula)
    assert again.formula == given.formula and again.kinks == given.kinks
    assert all(again.at(t) == given.at(t) for t in np.linspace(-0.5, 1.5, 9))


@pytest.mark.parametrize("apart", [1e-9, 1e-5, 3e-3, 0.0])
def test_differences_stay_on_their_side_of_a_kink(apart):
    """t^2 and, from 1 on, another parabola; between kinks that lie close too."""
    given = profile.from_function(lambda t: t * t if t < 1 else 3 * (t - 1) ** 2 + 7 * t, kinks=(1.5, 1.0, 0.999))
    for t, value in ((1 - apart - 1e-12, (2.0, 2.0)), (1 + apart, (7.0 + 6 * apart, 6.0))):
        assert (given.d1(t), given.d2(t)) == pytest.approx(value, abs=2e-6 + 2 * apart)


def test_a_function_has_no_formula():
    assert profile.from_formula(PROFILES["function"].formula) is None


@pytest.mark.parametrize("given", [3, 3.0, np.float64(3.0), np.int64(3), lambda t: 3.0, profile.constant(3.0)])
def test_what_becomes_a_profile(given):
    assert profile.as_profile(given, "part").at(0.5) == pytest.approx((3.0, 0.0, 0.0), abs=1e-4)


def test_a_function_of_more_than_time_is_named():
    body = pi.RigidBody.bar(1.0, 1.0)
    with pytest.raises(pi.InputError, match="Torque 'drive': .* is no function of time"):
        pi.Torque(body.at("left"), lambda t, x: 1.0, name="drive")


def waved(t):
    return np.sin(3.0 * t) + 0.5 * abs(t - 0.3)


def test_a_compiled_function_gives_the_same_values_at_many_times():
    times = np.append(np.linspace(-1.0, 1.0, 33), 0.3)
    made = [profile.from_function(function, kinks=(0.3,)) for function in (waved, pi.compiled(waved))]
    for order in range(3):
        one, other = (each.over(times, order) for each in made)
        single = [(made[0].value, made[0].d1, made[0].d2)[order](t) for t in times.tolist()]
        assert np.array_equal(one, single) and np.abs(other - single).max() < 1e-10 * np.abs(single).max()


def test_a_compiled_profile_that_numba_does_not_take_is_refused():
    with pytest.raises(pi.InputError, match="profile odd cannot be compiled by numba"):
        profile.from_function(pi.compiled(odd))


def odd(t):
    return float(eval("t"))


def driven(profile):
    scene = pi.Scene()
    bar = scene.add(pi.RigidBody.bar(1.0, 1.0, name="bar"))
    scene.add(pi.Revolute(pi.ground, bar.at("left"), name="pin"))
    scene.add(pi.AngleMotor(pi.ground, bar.at("left"), profile, name="motor"))
    return scene.build()


WRONG_RATES = {
    "a kink at the start": (dict(value=lambda t: float(np.interp(t, [0.0, 0.5, 1.0], [0.0, 1.0, 0.5])), kinks=[0.5]), r"give kinks=\[0\]"),
    "d1": (dict(value=lambda t: 0.5 * t**3, d1=lambda t: 3.0 * t**2), "correct d1"),
    "d2": (dict(value=lambda t: 0.5 * t**3, d1=lambda t: 1.5 * t**2, d2=lambda t: 6.0 * t), "correct d2"),
}


@pytest.mark.parametrize("case", WRONG_RATES)
def test_a_wrong_derivative_of_a_function_that_drives_a_joint_is_named(case):
    arguments, words = WRONG_RATES[case]
    with pytest.raises(pi.InputError, match=f"^motor: its profile has the derivative .*{words}"):
        pi.solve(driven(pi.profile.from_function(**arguments)), 1.0, pi.GeneralizedAlpha(h=1e-2))


@pytest.mark.parametrize("value", [lambda t: 0.0, lambda t: np.sin(200.0 * t), lambda t: 1e-6 * np.sin(t), lambda t: 1e3 * t])
def test_derivatives_by_differences_are_accepted(value):
    model = driven(pi.profile.from_function(value))
    assert pi.solve(model, 0.05, pi.GeneralizedAlpha(h=1e-3)).success
